"""Pictures of the sky: places through the exposures' geometry, cosmic rays, colours; what the report shows of them."""

import io
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image
from report_page import Reader

from csstsim.base.rng import stream
from csstsim.base.shipped import SHIPPED
from csstsim.campaign.opened import OpenCampaign
from csstsim.catalog.astrometry.reduction import apparent, icrs
from csstsim.instrument.chip import Window
from csstsim.io.level0 import read_level0
from csstsim.report import sky_picture as sky
from csstsim.stages.level0 import truth_of
from csstsim.stages.parts.report_pictures import (
    CUTOUT,
    bright_objects,
    chosen,
    colour_frames,
    detail,
    middle,
    sky_pictures,
)


@pytest.fixture(scope="module")
def demo():
    return OpenCampaign(SHIPPED / "campaign.yaml")


def test_the_picture_of_the_demo_has_three_bands_twice_on_the_middle_ones_pixels(demo):
    anchor, bands = colour_frames(demo)
    assert list(bands) == ["g", "r", "i"] and anchor.chip.filter == "r"
    assert [len({job.obsid for job in jobs}) for jobs in bands.values()] == [2, 2, 2]
    assert [job.chip.filter for job in demo.first_frames] == ["r"]


def test_places_on_another_exposure_are_those_of_its_geometry(demo):
    """A quarter turn, another band's chip, distortion and other aberration: 0.01 px."""
    anchor, bands = colour_frames(demo)
    other = bands["g"][1]
    assert abs(other.pointing.pa - anchor.pointing.pa) == pytest.approx(90.0)
    grid = sky.Grid(anchor.exposure, middle(anchor.window, 1500), 3)
    x, y = grid.on(other)
    assert x.shape == grid.shape == (500, 500)
    rows, columns = stream(5, "places").integers(0, 500, (2, 200))
    here = grid.window.x0 + 3 * (499 - columns) + 1.0, grid.window.y0 + 3 * rows + 1.0
    there = other.wcs.world_to_pixel(
        *apparent(*icrs(*anchor.wcs.pixel_to_world(*here), anchor.observer), other.observer)
    )
    assert np.abs(x[rows, columns] - there[0]).max() < 0.01 and np.abs(y[rows, columns] - there[1]).max() < 0.01
    same = grid.on(anchor)
    assert np.abs(same[0][rows, columns] - here[0]).max() < 0.01


def test_north_and_east_are_those_of_the_world_coordinates(demo):
    for job in (demo.jobs[0], demo.slitless_jobs[0]):
        x, y = job.window.x0, job.window.y0
        steps = job.wcs.jacobian(*job.wcs.pixel_to_world(x, y))  # px per arcsec, columns east and north
        north, east = sky.Grid(job.exposure, job.window).north_east()
        for drawn, true in zip((north, east), steps.T[::-1], strict=True):
            assert drawn * (-1, 1) @ true / np.hypot(*true) > 0.9999  # the picture's columns count against the chip's
        assert north[0] * east[1] - north[1] * east[0] > 0.9999  # east is left of north


def test_rays_vanish_from_two_planes_and_stars_do_not():
    rng = stream(6, "planes")
    planes = rng.normal(0.0, 1.0, (2, 64, 64))
    planes[:, 20, 20] += 200.0, 170.0  # a star, whose peak depends on its place in the pixel
    planes[0, 40, 40] += 300.0
    planes[1, :, 63] = np.nan
    planes[:, 0, 0] = np.nan
    both = sky.combined(list(planes))
    assert both[20, 20] == pytest.approx(185.0, abs=4) and abs(both[40, 40]) < 5
    assert both[5, 63] == planes[0, 5, 63] and both[0, 0] == 0.0
    three = sky.combined([*planes, rng.normal(0.0, 1.0, (64, 64))])
    assert abs(three[40, 40]) < 5


def test_colours_are_those_of_the_fluxes_and_the_first_row_is_at_the_bottom():
    planes = np.zeros((3, 8, 8))  # the bluest first
    planes[:, 1, 1], planes[2, 4, 4], planes[0, 6, 6] = 100.0, 100.0, 100.0
    rgb = sky.colours(list(planes), 1.0)
    white, red, blue = (rgb[k, k].astype(int) for k in (1, 4, 6))
    assert np.ptp(white) < 3 and white[0] > 150
    assert red[0] > red[2] + 100 and blue[2] > blue[0] + 100
    grey = sky.colours([planes[0]], 1.0)
    assert (grey[..., 0] == grey[..., 2]).all()
    tall = np.zeros((40, 20, 3), np.uint8)
    tall[:10] = 255
    picture = np.asarray(Image.open(io.BytesIO(sky.jpeg(tall))))
    assert picture.shape == (40, 20, 3) and picture[-5].min() > 200 and picture[5].max() < 50


def test_the_marks_are_drawn_where_they_belong(demo):
    job = demo.jobs[0]
    grid = sky.Grid(job.exposure, middle(job.window, 800), 2)
    bare, marked = (
        np.asarray(Image.open(io.BytesIO(sky.jpeg(np.zeros((400, 400, 3), np.uint8), marks)))).max(axis=2)
        for marks in ((), (sky.compass(grid), sky.ruler(grid)))
    )
    assert bare.max() < 10
    rows, columns = np.nonzero(marked > 200)
    assert rows.min() > 200 and {bool(c < 200) for c in columns} == {True, False}  # both lower corners
    assert not ((columns > 130) & (columns < 250)).any()


def test_a_campaign_of_one_band_has_a_grey_picture_and_cutouts_of_stars(reported):
    _, run, _ = reported
    picture, gallery = sky_pictures(run)
    image = np.asarray(Image.open(io.BytesIO(picture.png))).astype(int)
    assert np.ptp(image, axis=2).max() < 12 and picture.caption.startswith("r in grey: 1 exposure")
    assert picture.style == "photo"
    window = run.jobs[0].window
    job, file = run.jobs[0], read_level0(run.paths.level0(run.jobs[0]))
    found = list(chosen(run, job, window, file))
    assert len(gallery.figures) == len(found)
    for label, place in found:
        assert label.startswith("star, r 20") and place.shape == (CUTOUT, CUTOUT)


def test_only_objects_that_are_alone_unsaturated_and_inside_are_chosen(reported):
    _, run, _ = reported
    job = run.jobs[0]
    file, truth = read_level0(run.paths.level0(job)), truth_of(run, job)
    window, every = job.window, np.ones(len(truth_of(run, job)), bool)
    small = Window(window.x0, window.x1, window.y0, window.y0 + CUTOUT - 2)
    assert list(bright_objects(run, truth, every, small, file)) == []  # no room for a cutout
    found = [row for row, _ in bright_objects(run, truth, every, window, file)]
    light = truth["electrons"][found]
    assert len(found) and (np.diff(light) <= 0).all()
    faint_full_well = replace_full_well(run, 1.0)
    assert list(bright_objects(faint_full_well, truth, every, window, file)) == []


def replace_full_well(run, value):
    class Run:
        camera = replace(run.camera, detector=replace(run.camera.detector, full_well=value))

    return Run


def test_a_field_without_a_galaxy_has_no_place_to_show_at_full_resolution(reported):
    _, run, _ = reported
    job = run.jobs[0]
    assert detail(run, job, read_level0(run.paths.level0(job)), 64) is None


def test_the_picture_comes_before_any_table(reported):
    _, run, _ = reported
    reader = Reader(run.paths.report.read_text(encoding="utf-8"))
    tags = [(tag, attrs.get("src", "")[:16]) for tag, attrs in reader.tags if tag in ("img", "table")]
    assert tags[0] == ("img", "data:image/jpeg;")


def exposure_of(window, exptime=50.0, zeropoint=25.0):
    """What `plane` asks of an exposure, with a filter of a given zero point [AB mag of 1 e-/s]."""
    filter_ = SimpleNamespace(zeropoint=lambda telescope: zeropoint)
    return SimpleNamespace(window=window, exptime=exptime, filter=filter_, telescope=None)


def grid_of(x, y, step):
    return SimpleNamespace(on=lambda exposure: (x, y), step=step, shape=x.shape)


def test_a_plane_is_the_ab_flux_of_a_second_at_the_places_asked_for():
    """5 x + 20 y DN, gain 2, on the chip's columns 100..180: bilinear in blocks of 3 px, above the median, / 50 s."""
    window = Window(100, 180, 40, 90)
    rows, columns = np.mgrid[40:90, 100:180]
    channel = SimpleNamespace(
        window=window, active=5 * columns + 20 * rows, serial_overscan=np.full((9, 9), 0), gain=2.0
    )
    x, y = np.meshgrid(np.linspace(110.3, 170.7, 21), np.linspace(50.1, 80.2, 11))
    x = x[:, ::-1]
    file = SimpleNamespace(channels=lambda: [channel])
    for step in (1, 3):
        got = sky.plane(grid_of(x, y, step), exposure_of(window), file)
        # The part in use is 108..173 by 48..83; the median of a ramp is its value in the middle
        expected = 2.0 * (5 * (x - 140.5) + 20 * (y - 65.5)) * 1e-10 / 50.0
        np.testing.assert_allclose(got, expected, atol=1e-9 * expected.max())
    beyond = x.copy()
    beyond[:, 0] = 185.0
    got = sky.plane(grid_of(beyond, y, 1), exposure_of(window), file)
    assert np.isnan(got[:, 0]).all() and np.isfinite(got[:, 1:]).all()
    assert np.isnan(sky.plane(grid_of(x + 500, y, 1), exposure_of(window), file)).all()


def test_the_part_in_use_has_a_margin_of_two_within_the_window():
    window = Window(100, 180, 40, 90)
    x, y = np.array([110.3, 120.7]), np.array([41.2, 60.0])
    assert sky._around(x, y, window) == Window(108, 124, 40, 63)
    assert sky._around(x + 60, y + 40, window) == Window(168, 180, 79, 90)
    assert sky._around(x - 30, y, window) is None and sky._around(x, y + 60, window) is None


def test_noise_is_that_of_a_gaussian_and_its_outliers_and_holes_do_not_count():
    """5 sigma of the median deviation of 40 000 values: 5 x 1.17 / sqrt(40 000)."""
    image = stream(8, "noise").normal(7.0, 3.0, (200, 200))
    image[:10, :3] = np.nan
    image[50, :9] = 1e6
    assert sky.noise_of(image) == pytest.approx(3.0, rel=0.03)
    assert sky.noise_of(np.full((3, 3), np.nan)) == 0.0


def test_a_ray_is_three_sigma_of_a_difference_and_three_times_the_fainter():
    """Noise 1 in one plane and 0.1 in the other: the noisier counts, 3 sqrt 2 = 4.24."""
    checks = np.where(np.indices((20, 20)).sum(axis=0) % 2, 0.67449, -0.67449)
    first, second = checks.copy(), 0.1 * checks
    cases = (((0, 0), 1.0, 5.0, 3.0), ((0, 2), 1.0, 5.5, 1.0), ((0, 4), 0.5, 4.5, 2.5), ((5, 5), 100.0, 300.0, 200.0),
             ((7, 7), 100.0, 350.0, 100.0))  # fmt: skip
    for (row, column), low, high, _ in cases:
        first[row, column], second[row, column] = (low, high) if row else (high, low)
    both = sky.combined([first, second])
    for place, _, _, expected in cases:
        assert both[place] == pytest.approx(expected), place
    assert both[19, 0] == pytest.approx(0.55 * checks[19, 0])
    three = sky.combined([np.full((2, 2), v) for v in (1.0, 4.0, np.nan)] + [np.full((2, 2), 10.0)])
    assert three == pytest.approx(4.0) or (three == np.median([1.0, 1.0, 4.0, 10.0])).all()


def test_the_stretch_follows_the_noise():
    """Below -1 sigma is black, and what is 7 times as large with 7 times the noise looks the same."""
    plane_ = stream(9, "grey").normal(0.0, 1.0, (16, 16))
    plane_[5, 5] = 40.0
    rgb = sky.colours([plane_], 1.0)
    assert np.abs(rgb.astype(int) - sky.colours([7.0 * plane_], 7.0)).max() <= 1
    assert (rgb[plane_ < -1.0] == 0).all() and rgb[5, 5].min() > 100
    assert rgb[plane_ > 0].min() > 5, "the background is above black"


class Pen:
    """An ImageDraw that notes what is drawn."""

    def __init__(self):
        self.lines, self.texts = [], []

    def line(self, places, **_):
        self.lines.append(places)

    def text(self, place, text, **_):
        self.texts.append((text, place))


def test_arrows_point_north_and_east_on_the_screen():
    """The picture's y is up, the screen's down: north (0.6, 0.8) goes right and up, east (-0.8, 0.6) left and up."""
    pen = Pen()
    grid = SimpleNamespace(north_east=lambda: np.array([(0.6, 0.8), (-0.8, 0.6)]))
    sky.compass(grid)(pen, (600, 400))
    corner, length = (60.0, 340.0), 36.0
    np.testing.assert_allclose(pen.lines[0], [*corner, 60 + 0.6 * length, 340 - 0.8 * length])
    np.testing.assert_allclose(pen.lines[1], [*corner, 60 - 0.8 * length, 340 - 0.6 * length])
    assert [text for text, _ in pen.texts] == ["N", "E"]
    np.testing.assert_allclose(pen.texts[1][1], [60 - 0.8 * 1.35 * length, 340 - 0.6 * 1.35 * length])


@pytest.mark.parametrize(
    ("scale", "step", "text", "pixels"),
    [(0.074, 2, '10"', 10 / 0.148), (1.0, 1, "1'", 60.0), (0.5, 6, "5'", 100.0), (0.001, 1, '0.1"', 100.0)],
)
def test_the_ruler_is_a_round_length_of_at_most_a_sixth(scale, step, text, pixels):
    pen = Pen()
    exposure = SimpleNamespace(telescope=SimpleNamespace(pixel_scale=scale))
    sky.ruler(SimpleNamespace(exposure=exposure, step=step, shape=(500, 600)))(pen, (600, 500))
    ((x0, y0, x1, y1),) = pen.lines
    assert (x1 - x0, x1, y0, y1) == pytest.approx((pixels, 576.0, 480.0, 480.0))
    ((said, (x, _)),) = pen.texts
    assert said == text and x == pytest.approx(576.0 - pixels / 2)
