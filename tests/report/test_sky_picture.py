"""Pictures of the sky: places through the exposures' geometry, cosmic rays, colours; what the report shows of them."""

import io
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from astropy.wcs import WCS
from PIL import Image
from report_page import Reader

from csstsim.base.rng import stream
from csstsim.base.shipped import SHIPPED
from csstsim.campaign.opened import OpenCampaign
from csstsim.catalog.astrometry.reduction import apparent
from csstsim.instrument.chip import Window
from csstsim.io.level0 import read_level0
from csstsim.report import sky_picture as sky
from csstsim.report.pictures import photograph
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


def test_places_on_an_exposure_are_those_of_its_geometry(demo):
    """Two exposures a quarter turn apart, against astropy's tangent plane; distortion, aberration of each: 0.01 px."""
    anchor, bands = colour_frames(demo)
    other = bands["g"][1]
    assert abs(other.pointing.pa - anchor.pointing.pa) == pytest.approx(90.0)
    window = middle(anchor.window, 1500)
    grid = sky.Grid.around(anchor.exposure, window, 3)
    assert grid.shape == (500, 500) and grid.scale == 3 * anchor.exposure.telescope.pixel_scale
    wcs = WCS(naxis=2)
    wcs.wcs.ctype, wcs.wcs.crval, wcs.wcs.crpix = ["RA---TAN", "DEC--TAN"], grid.centre, [250.5, 250.5]
    wcs.wcs.cdelt = [-grid.scale / 3600, grid.scale / 3600]  # east to the left, north up
    rows, columns = stream(5, "places").integers(0, 500, (2, 200))
    there = wcs.all_pix2world(columns, rows, 0)
    np.testing.assert_allclose(grid.sky(rows, columns), there, atol=1e-9)
    for job in (anchor, other):
        x, y = grid.on(job)
        expected = job.wcs.world_to_pixel(*apparent(*there, job.observer))
        assert np.abs(x[rows, columns] - expected[0]).max() < 0.01
        assert np.abs(y[rows, columns] - expected[1]).max() < 0.01
    x, y = (values[249:251, 249:251].mean() for values in grid.on(anchor))
    assert (x, y) == pytest.approx((window.x0 + 749.5, window.y0 + 749.5), abs=0.01)


def test_a_source_to_the_north_east_is_up_and_to_the_left(demo):
    """Of the demo's exposures at both position angles, 20 arcsec from the middle."""
    anchor, bands = colour_frames(demo)
    window = middle(anchor.window, 1000)
    grid = sky.Grid.around(anchor.exposure, window, 2)
    ra, dec = grid.centre
    step = 20 / 3600 / np.sqrt(2)
    source = ra + step / np.cos(np.radians(dec)), dec + step
    for job in (anchor, bands["g"][1]):
        x, y = job.wcs.world_to_pixel(*apparent(*source, job.observer))
        w = job.window
        pixels = np.zeros((w.ny, w.nx))
        pixels[round(float(y)) - w.y0, round(float(x)) - w.x0] = 4000.0
        channel = SimpleNamespace(window=w, active=pixels, serial_overscan=np.zeros((1, 1)), gain=1.0)
        shown = sky.plane(grid, job.exposure, SimpleNamespace(channels=lambda c=channel: [c]))
        drawn = np.asarray(
            Image.open(io.BytesIO(photograph(sky.colours([np.nan_to_num(shown)], np.nanmax(shown) / 50))))
        )
        row, column = np.unravel_index(drawn[..., 0].argmax(), drawn.shape[:2])
        off = step * 3600 / grid.scale
        assert (column - 249.5, row - 249.5) == pytest.approx((-off, -off), abs=2)


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


def test_next_to_a_peak_nothing_is_a_ray():
    """A star whose image of the other plane lies a pixel further: no dark pixel about its peak."""
    planes = np.zeros((2, 9, 9))
    planes[:] = stream(10, "sky").normal(0.0, 1.0, planes.shape)
    planes[0, 4, 4], planes[1, 4, 5] = 500.0, 500.0
    both = sky.combined(list(planes))
    assert both[4, 4] == pytest.approx(250.0, abs=2) and both[4, 5] == pytest.approx(250.0, abs=2)
    planes[1, 4, 5] = np.inf
    assert sky.combined(list(planes))[4, 4] == pytest.approx(250.0, abs=2)


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
    picture = np.asarray(Image.open(io.BytesIO(photograph(tall))))
    assert picture.shape == (40, 20, 3) and picture[-5].min() > 200 and picture[5].max() < 50


@pytest.mark.parametrize("single", [0, 1, 2])
def test_a_saturated_core_is_white_without_a_coloured_ring(single):
    """A galaxy of one colour, 1 : 2 : 3, whose core saturates in one band or in all; its colour is kept outside."""
    rows, columns = np.mgrid[-40:41, -40:41]
    galaxy = 4000.0 * np.exp(-np.hypot(rows, columns) / 6)
    planes = [flux * galaxy for flux in (1.0, 2.0, 3.0)]
    core = np.hypot(rows, columns) < 5
    for number, plane_ in enumerate(planes):
        plane_[core if number == single else np.hypot(rows, columns) < 2] = np.inf
    rgb = sky.colours(planes, 1.0).astype(int)
    assert (rgb[core] == 255).all()
    outside = (np.hypot(rows, columns) > 7) & (galaxy > 20)
    red, green, blue = (rgb[outside][:, k] + 1 for k in range(3))
    np.testing.assert_allclose(green / red, 2 / 3, atol=0.05)
    np.testing.assert_allclose(blue / red, 1 / 3, atol=0.05)


def test_pixels_near_the_full_well_are_infinite_unless_another_exposure_has_them():
    """Blocks of 2 px with one full pixel, and what is interpolated from them; full well 1000, half of it counts."""
    window = Window(0, 40, 0, 40)
    pixels = np.zeros((40, 40))
    pixels[20, 20], pixels[8, 8] = 501.0, 499.0
    channel = SimpleNamespace(window=window, active=pixels, serial_overscan=np.zeros((2, 2)), gain=1.0)
    file = SimpleNamespace(channels=lambda: [channel])
    x, y = np.meshgrid(np.arange(4.5, 35, 2), np.arange(4.5, 35, 2))
    exposure = exposure_of(window, full_well=1000.0)
    got = sky.plane(grid_of(x, y, 2), exposure, file)
    assert np.argwhere(np.isinf(got)).tolist() == [[8, 8]] and np.isfinite(got).sum() == got.size - 1
    shifted = sky.plane(grid_of(x + 0.5, y, 2), exposure, file)
    assert np.argwhere(np.isinf(shifted)).tolist() == [[8, 7], [8, 8]]
    short = np.zeros_like(got)
    short[8, 8] = 7.0
    assert sky.combined([got, short])[8, 8] == 7.0
    both = sky.combined([got, got])
    assert np.isinf(both[8, 8]) and np.isinf(both).sum() == 1
    assert np.isinf(sky.combined([np.where(got == np.inf, got, np.nan), np.full_like(got, np.nan)])[8, 8])


def test_the_marks_are_drawn_where_they_belong(demo):
    job = demo.jobs[0]
    grid = sky.Grid.around(job.exposure, middle(job.window, 800), 2)
    bare, marked = (
        np.asarray(Image.open(io.BytesIO(photograph(np.zeros((400, 400, 3), np.uint8), marks)))).max(axis=2)
        for marks in ((), (sky.compass, sky.ruler(grid)))
    )
    assert bare.max() < 10
    rows, columns = np.nonzero(marked > 200)
    assert rows.min() > 200 and {bool(c < 200) for c in columns} == {True, False}  # both lower corners
    assert not ((columns > 130) & (columns < 250)).any()


def test_a_campaign_of_one_band_has_a_grey_picture_and_cutouts_of_stars(reported):
    _, run, _ = reported
    picture, gallery = sky_pictures(run)
    image = np.asarray(Image.open(io.BytesIO(picture.image))).astype(int)
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
    assert tags[0] == ("img", "data:image/webp;")


def exposure_of(window, exptime=50.0, zeropoint=25.0, full_well=1e9):
    """What `plane` asks of an exposure, with a filter of a given zero point [AB mag of 1 e-/s]."""
    filter_ = SimpleNamespace(zeropoint=lambda telescope: zeropoint)
    chip = SimpleNamespace(detector=SimpleNamespace(full_well=full_well))
    return SimpleNamespace(window=window, exptime=exptime, filter=filter_, telescope=None, chip=chip)


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
    """North goes up, where y of the screen is smaller; east to the left."""
    pen = Pen()
    sky.compass(pen, (600, 400))
    corner, length = (60.0, 340.0), 36.0
    np.testing.assert_allclose(pen.lines, [[*corner, 60, 340 - length], [*corner, 60 - length, 340]])
    assert [text for text, _ in pen.texts] == ["N", "E"]
    np.testing.assert_allclose(pen.texts[1][1], [60 - 1.35 * length, 340])


@pytest.mark.parametrize(
    ("scale", "step", "text", "pixels"),
    [(0.074, 2, '10"', 10 / 0.148), (1.0, 1, "1'", 60.0), (0.5, 6, "5'", 100.0), (0.001, 1, '0.1"', 100.0)],
)
def test_the_ruler_is_a_round_length_of_at_most_a_sixth(scale, step, text, pixels):
    pen = Pen()
    sky.ruler(SimpleNamespace(scale=scale * step, shape=(500, 600)))(pen, (600, 500))
    ((x0, y0, x1, y1),) = pen.lines
    assert (x1 - x0, x1, y0, y1) == pytest.approx((pixels, 576.0, 480.0, 480.0))
    ((said, (x, _)),) = pen.texts
    assert said == text and x == pytest.approx(576.0 - pixels / 2)
