"""Thumbnails against sums by hand, and their positions in the focal plane against the chips' WCS."""

import io
import re
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image
from report_page import Reader
from support.csst import LOOKS
from support.readout_state import flat_state, plain_layers, run

from csstsim.instrument.chip import Window
from csstsim.io.level0 import read_level0
from csstsim.io.level0_writing import write_level0
from csstsim.optics.geometry.wcs import ChipWCS
from csstsim.report.mosaic import _corners, mosaic, take_exposure
from csstsim.report.parts import draw
from csstsim.report.thumbnail import any_in_blocks, binned, brightest_window, step_for, stretch, window_around

PROVENANCE = {
    "recipe": dict.fromkeys(("campaign", "camera", "layers", "exposure"), "c0ffee"), "truth_hash": "7", "psf_hash": "9",
    "seed": 11, "campaign_name": "demo", "layers": [], "stages": [],
}  # fmt: skip


def level0(camera, path, change=lambda image: None, level=300.0, **fields):
    """Return an open Level-0 file of a 256 x 64 chip: a flat image that `change` alters."""
    state = flat_state(camera, level, **fields)
    change(state.image)
    write_level0(path, run(state, plain_layers()), camera.keywords, PROVENANCE, "channels")
    return read_level0(path)


@pytest.mark.parametrize("window, step", [(None, 1), (None, 7), ((31, 234, 10, 51), 5), ((100, 101, 63, 64), 4)])
def test_binned_is_the_mean_of_electrons_across_channels(small, tmp_path, window, step):
    """Noise 5 e- and sqrt(level): blocks at the borders of channels as good as others; 5 sigma of a block's mean."""

    def ramp(image):
        image += np.arange(image.shape[1]) * 3

    file = level0(small, tmp_path / "x.fits", ramp, window=window)
    got = binned(file, file.window, step)
    ny, nx = file.window.shape
    assert got.shape == (-(-ny // step), -(-nx // step))
    for row in range(got.shape[0]):
        for column in range(got.shape[1]):
            part = np.arange(nx)[column * step : (column + 1) * step]
            n = len(part) * len(range(ny)[row * step : (row + 1) * step])
            expected = 300 + 3 * part.mean()
            # 150 s of dark current are 3 e-; the level of 7 x 32 overscan pixels is known to 0.4 e-: 5 sigma are 2
            assert abs(got[row, column] - expected - 3) < 5 * np.sqrt((expected + 26) / n) + 2


def test_part_of_a_file_and_pixels_that_were_not_read(small, tmp_path):
    file = level0(small, tmp_path / "x.fits", window=(40, 80, 8, 40))
    whole, part = binned(file, file.window, 1), binned(file, Window(50, 60, 10, 20), 1)
    assert np.array_equal(part, whole[2:12, 10:20])
    beyond = binned(file, Window(30, 50, 8, 18), 10)
    assert np.isnan(beyond[0, 0]) and np.isfinite(beyond[0, 1])


def test_stretch_of_noise_a_star_nothing_and_a_constant():
    noise = np.random.default_rng(2).normal(100.0, 5.0, (50, 50))
    noise[20, 20] = 1e6
    greys = stretch(noise)
    assert greys[20, 20] == 255 and 30 < np.median(greys) < 90
    assert not stretch(np.full((3, 4), np.nan)).any()
    assert len(np.unique(stretch(np.full((3, 4), 7.0)))) == 1
    holes = noise.copy()
    holes[0, 0] = np.nan
    assert stretch(holes)[0, 0] == 0 and stretch(np.full((1, 1), -3.0)).shape == (1, 1)


def test_steps_and_the_busiest_place():
    assert step_for(Window(0, 9216, 0, 9232)) == 25 and step_for(Window(5, 389, 0, 3)) == 1
    window = Window(1000, 5000, 2000, 6000)
    greys = np.zeros((364, 364), np.uint8)
    greys[300:310, 50:60] = 255
    found = brightest_window(greys, window, 11)
    assert found.shape == (384, 384) and found.contains(1000 + 55 * 11, 2000 + 305 * 11)
    corner = brightest_window(np.eye(364, dtype=np.uint8)[::-1] * 0, window, 11)
    assert corner.x0 >= 1000 and corner.y1 <= 6000 and corner.shape == (384, 384)
    assert brightest_window(np.ones((4, 30), np.uint8), Window(0, 60, 0, 8), 2).shape == (
        8,
        60,
    )  # no larger than there is


def test_a_window_about_a_place_has_it_in_its_middle():
    window = Window(1000, 5000, 2000, 6000)
    for x, y, found in (
        (3000, 4000, (2900, 3100, 3900, 4100)), (3000.4, 2010, (2900, 3100, 2000, 2200)),
        (4990, 5901, (4800, 5000, 5800, 6000)),
    ):  # fmt: skip
        assert window_around(x, y, window, 200) == Window(*found)


@pytest.mark.parametrize("step", [1, 3, 7])
def test_a_block_is_marked_if_any_of_its_pixels_is(step):
    """The blocks are those of `binned`; the last ones are smaller."""
    mask = np.zeros((8, 11), bool)
    mask[[0, 7, 4], [10, 0, 5]] = True
    expected = [[mask[i : i + step, j : j + step].any() for j in range(0, 11, step)] for i in range(0, 8, step)]
    np.testing.assert_array_equal(any_in_blocks(mask, step), expected)


def test_corners_lie_on_the_plane_as_on_the_sky(small):
    """A turned grating chip's and an imaging chip's windows, both through the nominal WCS of the mosaic; 1 px."""
    pointing = flat_state(small).pointing
    flat = ChipWCS(small.chips[8], pointing)
    for number in (8, 29, 1):
        chip, window = small.chips[number], Window(10, 200, 5, 60)
        x, y = _corners(chip, window).T
        ra, dec = ChipWCS(chip, pointing).pixel_to_world(
            np.repeat([window.x0, window.x1], 2) - 0.5, np.tile([window.y0, window.y1], 2) - 0.5
        )
        there = flat.world_to_pixel(ra, dec)
        eight = small.chips[8]
        assert np.allclose(x, there[0] + eight.xc - eight.detector.nx / 2 + 0.5, atol=1.0)
        assert np.allclose(-y, there[1] + eight.yc - eight.detector.ny / 2 + 0.5, atol=1.0)


def test_outlines_and_images_are_drawn_on_their_corners(small, tmp_path):
    """SVG's rotate(angle, cx, cy) is clockwise on the screen, whose y points down."""
    window = (10, 200, 5, 60)
    for number in (8, 29, 1):
        chip = small.chips[number]
        file = level0(small, tmp_path / f"{number}.fits", chip=number, window=window)
        reader = Reader(draw(mosaic([chip], [take_exposure("x", 0.0, [(chip, file)])], LOOKS)))
        for drawn, expected in (("window", file.window), ("chip", chip.full_window), (None, file.window)):
            (found,) = (a for tag, a in reader.tags if tag in ("rect", "image") and a.get("class") == drawn)
            x, y, width, height = (float(found[key]) for key in ("x", "y", "width", "height"))
            turn = [float(v) for v in re.findall(r"[-\d.]+", found.get("transform", "0 0 0"))]
            angle, centre = np.radians(turn[0]), np.array(turn[1:])
            matrix = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
            places = np.array([(x + i * width, y + (1 - j) * height) for i in (0, 1) for j in (0, 1)])
            assert np.allclose((places - centre) @ matrix.T + centre, _corners(chip, expected), atol=0.1)


def test_mosaic_of_30_chips_and_of_calibration(small, tmp_path):
    files = [(chip, level0(small, tmp_path / f"{chip.id}.fits", chip=chip.id)) for chip in small.chips.values()]
    one = take_exposure("science", -113.4333, files)
    dark = take_exposure("<bias>", 0.0, [(small.chips[9], level0(small, tmp_path / "b.fits", level=0.0, type="BIAS"))])
    assert one.detail is None  # already at full resolution
    text = draw(mosaic(list(small.chips.values()), [one, dark], LOOKS))
    reader = Reader(text)
    assert len(reader.values("image", "href")) == 31 and "<bias>" in " ".join(reader.text)
    assert [attrs["data-number"] for tag, attrs in reader.tags if tag == "g" and "data-box" in attrs] == ["0", "1"]
    labels = re.findall(r"<text[^>]*>(\d\d \w+)</text>", text)
    assert sorted(labels) == sorted(f"{c.label} {c.filter}" for c in small.chips.values())


def test_names_of_chips_are_off_their_pixels(small, tmp_path):
    """Text rises from its baseline by less than its size; its foot is above the chip, or above the window's pixels."""
    window = (40, 104, 8, 40)
    chip = small.chips[9]
    file = level0(small, tmp_path / "x.fits", window=window)
    reader = Reader(draw(mosaic(list(small.chips.values()), [take_exposure("x", 0.0, [(chip, file)])], LOOKS)))
    texts = [attrs for tag, attrs in reader.tags if tag == "text" and "font-size" in attrs]
    rows = sorted({float(attrs["y"]) for tag, attrs in reader.tags if tag == "rect" and attrs["class"] == "idle"})
    (picture,) = (attrs for tag, attrs in reader.tags if tag == "image")
    assert len(texts) == len(small.chips) + 1
    for attrs in texts:
        y, size = float(attrs["y"]), float(attrs["font-size"])
        tops = [top for top in (*rows, float(picture["y"])) if top >= y]
        assert tops and size > 0
        above = [row + chip.detector.ny for row in rows if row + chip.detector.ny <= tops[0]]
        if min(abs(top - y) for top in rows) < size:  # a chip's, not the window's
            assert not above or y - 0.8 * size >= above[-1] - 1


def test_the_place_at_full_resolution_is_the_one_that_is_asked_for(small, tmp_path):
    chip, asked = small.chips[9], Window(100, 120, 20, 40)
    file = level0(small, tmp_path / "x.fits")
    places = []
    for spot in (lambda *_: asked, lambda *_: None, None):
        exposure = take_exposure("x", 0.0, [(chip, file)], max_side=20, choose_cutout=spot)
        places.append(exposure.detail.window)
    assert places[0] == asked and places[1] == places[2] != asked
    assert window_around(3, 30, file.window, 20) == Window(0, 20, 20, 40)


@pytest.mark.parametrize("pa, north", [(0.0, 90.0), (30.0, 60.0), (-113.4333, -156.5667)])
def test_the_compass_points_north_and_east(small, tmp_path, pa, north):
    """pa is the angle of mosaic +y, north through east; on the screen east is where the WCS has it."""
    file = level0(small, tmp_path / "x.fits")
    text = draw(mosaic(list(small.chips.values()), [take_exposure("x", pa, [(small.chips[9], file)])], LOOKS))
    angles = [float(v) for v in re.findall(r"<path [^>]*rotate\(([-\d.]+)\)", text)]
    wcs = ChipWCS(small.chips[9], flat_state(small, pa=pa).pointing)
    here = wcs.pixel_to_world(100.0, 30.0)
    steps = wcs.jacobian(*here)  # px per arcsec, columns east and north
    for drawn, (x, y) in zip(angles, steps.T, strict=True):
        assert abs((drawn - np.degrees(np.arctan2(-y, x)) + 180) % 360 - 180) < 0.1
    east, north = np.radians(angles)
    mirrored = np.sin(east - north) > 0  # on the screen y is down: east is clockwise of north
    assert ("is shown mirrored" in text) is bool(mirrored)


def channels_of(*parts):
    """A file of channels: (Window, its DN, DN of its overscan, gain)."""
    names = "window", "active", "serial_overscan", "gain"
    return SimpleNamespace(channels=lambda: [SimpleNamespace(**dict(zip(names, part, strict=True))) for part in parts])


def test_each_channel_has_its_own_level_and_gain():
    """Blocks of 3 across the border of two channels: 100 + x + 10 y DN of gain 2, 500 + y DN of unknown gain."""
    y, x = np.mgrid[0:4, 0:10]
    left = Window(0, 4, 0, 4), (100 + x + 10 * y)[:, :4], np.full((4, 3), 90), 2.0
    right = Window(4, 10, 0, 4), (500 + y)[:, 4:], np.full((4, 3), 400), None
    electrons = np.where(x < 4, 2.0 * (10 + x + 10 * y), 100.0 + y)
    got = binned(channels_of(left, right), Window(1, 9, 1, 4), 3)
    part = electrons[1:4, 1:9]
    expected = [[part[:, k : k + 3].mean() for k in (0, 3, 6)]]
    np.testing.assert_allclose(got, expected)


def test_the_overscans_level_is_a_mean_without_outliers():
    """4 robust sigmas, at least 4 DN: half 100, half 101, and one far off; no overscan is level 0."""

    def level(values):
        window, active = Window(0, 1, 0, 1), np.full((1, 1), 200)
        return 200.0 - binned(channels_of((window, active, np.array([values]), None)), window, 1)[0, 0]

    assert level([100] * 50 + [101] * 50 + [500, -300]) == pytest.approx(100.5)
    assert level([100] * 99 + [104]) == pytest.approx(100.04) and level([100] * 99 + [105]) == pytest.approx(100.0)
    ramp = [100, 110, 120, 130, 140] * 9  # 4 x 1.4826 x 10 = 59.3 about 120
    assert level([*ramp, 170]) == pytest.approx((45 * 120 + 170) / 46) and level([*ramp, 189]) == pytest.approx(120.0)
    assert level([]) == 0.0


def test_the_stretch_is_asinh_from_black_to_white():
    """Median 50, noise 2: -3 sigma is black, 30 sigma white; the background (asinh 1 of asinh 1 + asinh 10) is 58."""
    values = np.full(5005, 50.0)
    values[5:2503] -= 2 * 0.67449
    values[2503:5001] += 2 * 0.67449
    values[:6] = 44.0, 40.0, 110.0, 80.0, 50.0, np.nan
    greys = stretch(values)
    expected = [np.arcsinh(sigma / 3) + np.arcsinh(1.0) for sigma in (-3, -3, 30, 15, 0)]
    expected = np.rint(255 * np.array(expected) / (np.arcsinh(1.0) + np.arcsinh(10.0)))
    assert np.abs(greys[:5] - expected).max() <= 1 and greys[5] == 0 and greys[2] == 255
    bright = values.copy()
    bright[3000:3020] = 450.0  # 0.4% at 200 sigma: white begins there
    assert stretch(bright)[3000] == 255
    share = (np.arcsinh(5) + np.arcsinh(1)) / (np.arcsinh(200 / 3) + np.arcsinh(1))
    assert stretch(bright)[3] == pytest.approx(255 * share, abs=1)
    star = np.zeros(1000)
    star[7] = 5.0  # no median deviation
    assert stretch(star)[7] == 255 and stretch(star)[0] < 100


def test_the_place_at_full_resolution_is_of_the_image_of_most_contrast(small, tmp_path):
    """An imaging chip comes before a spectrum, however bright; without blocks there is nothing to show."""

    def patch(electrons):
        def put(image):
            image[30:60, 180:220] += electrons

        return put

    shown = {29: patch(40_000), 8: patch(0), 9: patch(9_000), 14: patch(0)}
    files = [(small.chips[n], level0(small, tmp_path / f"{n}.fits", put, chip=n)) for n, put in shown.items()]
    exposure = take_exposure("x", 12.5, files, max_side=32)
    assert (exposure.title, exposure.pa, len(exposure.pictures)) == ("x", 12.5, 4)
    assert exposure.detail.chip.id == 9 and exposure.detail.step == 1
    assert exposure.detail.window.shape == (32, 32) and exposure.detail.window.contains(200, 45)
    assert [picture.chip.id for picture in exposure.pictures] == [29, 8, 9, 14]
    assert {picture.step for picture in exposure.pictures} == {8}
    picture = np.asarray(Image.open(io.BytesIO(exposure.pictures[2].image)).convert("L"))
    assert picture.shape == (8, 32) and picture[7 - 45 // 8, 200 // 8] > 200 > 100 > picture[7 - 45 // 8, 170 // 8]
    assert picture[7 - 12 // 8, 200 // 8] < 100, "the first row is at the bottom"
    assert take_exposure("x", 0.0, files[:1], max_side=32).detail.chip.id == 29
    assert take_exposure("x", 0.0, files, max_side=256).detail is None


def test_boxes_enclose_the_windows_and_the_whole_plane(small, tmp_path):
    """Of chips that are not turned: from the chips' centres by hand, y down."""
    window, nx, ny = (40, 80, 8, 24), small.detector.nx, small.detector.ny
    chips = [small.chips[n] for n in (8, 9)]
    files = [(chip, level0(small, tmp_path / f"{chip.id}.fits", chip=chip.id, window=window)) for chip in chips]
    plane = mosaic(chips, [take_exposure("a title", 0.0, files, max_side=20)], LOOKS)
    left, low = (np.array([getattr(c, name) for c in chips]) for name in ("xc", "yc"))
    left, low = left - nx / 2, low - ny / 2
    (group,) = plane.groups
    expected = left.min() + 40, -(low.max() + 24), np.ptp(left) + 40, np.ptp(low) + 16
    assert [float(v) for v in group["box"].split()] == pytest.approx(expected, abs=0.06)
    assert group["title"] == "a title" and len(group["detail"].split()) == 4
    detail = [float(v) for v in group["detail"].split()]
    assert detail[2:] == [20.0, 16.0]  # as wide as asked, no higher than the window
    x, y, width, height = (float(v) for v in plane.box.split())
    edge = 0.01 * (np.ptp(left) + nx)
    assert (x, x + width) == pytest.approx((left.min() - edge, left.max() + nx + edge), abs=0.11)
    assert y + height == pytest.approx(-low.min() + edge, abs=0.11)
    assert y < -(low.max() + ny) - edge, "names of the upper row have room"
    assert [label["text"] for label in plane.labels] == [f"{c.label} {c.filter}" for c in chips]
    assert len(plane.outlines) == 2 and {outline["style"] for outline in plane.outlines} == {"idle"}
    styles = [shape.get("style", shape["kind"]) for shape in group["shapes"]]
    assert styles == ["image"] * 3 + ["chip"] * 2 + ["window", "label"] * 2 + ["cutout"]
    colours = {outline["colour"] for outline in plane.outlines}
    assert colours <= {LOOKS[c.filter.lower()].colour for c in chips} | {"#FFFFFF", "#888888"}
