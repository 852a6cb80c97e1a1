"""Chips and windows that a campaign selects, on a flat sky: ra, dec are the pixel, but for an offset of each chip."""

import math
import re
from pathlib import Path
from types import SimpleNamespace

import pytest

from csstsim.base.errors import InputError
from csstsim.campaign import selection
from csstsim.campaign.sections import PixelWindow, Select
from csstsim.instrument.chip import Window

SCALE = 0.5  # arcsec per px: a radius of 0.1 arcmin is 12 px
OFFSET = {7: (0.0, 0.0), 8: (500.0, 0.0), 9: (0.0, -900.0), 1: (2000.0, 3000.0)}
SPAN = -30.0, 40.0, -2.0, 5.0


@pytest.fixture(autouse=True)
def flat_sky(monkeypatch):
    """Places are apparent as they are."""
    for name in ("apparent", "icrs"):
        monkeypatch.setattr(selection, name, lambda ra, dec, craft: (ra, dec))


def chip(number, name, kind="imaging"):
    return SimpleNamespace(id=number, filter=name, kind=kind, full_window=Window(0, 300, 0, 400))


CHIPS = {
    number: chip(number, name, kind)
    for number, name, kind in ((1, "GI", "slitless"), (7, "i", "imaging"), (8, "g", "imaging"), (9, "r", "imaging"))
}


def opened(region=None, window=None, types=("SCIE",), chips=(7, 8, 9), obsids=("11", "12")):
    """Return what selection reads of an OpenCampaign; exposure 12 is 50 px further along x."""

    def maps(pointing, chip):
        x, y = OFFSET[chip.id]
        x += pointing.shift
        wcs = SimpleNamespace(
            world_to_pixel=lambda ra, dec: (ra - x, dec - y), pixel_to_world=lambda i, j: (i + x, j + y)
        )
        return wcs, None

    gratings = {1: SimpleNamespace(span=lambda x, y: SPAN)}
    camera = SimpleNamespace(telescope=SimpleNamespace(pixel_scale=SCALE), gratings=gratings)
    exposures = {obsid: SimpleNamespace(type="SCIE", shift=50.0 * (obsid == "12")) for obsid in obsids}
    select = SimpleNamespace(types=types, filters=None, region=region and SimpleNamespace(**region))
    config = SimpleNamespace(window=window, select=select)
    return SimpleNamespace(
        config=config, camera=camera, maps=maps, exposures=exposures, pointings=exposures, file=Path("c.yaml"),
        table="t.csv", chips=[CHIPS[number] for number in chips],
    )  # fmt: skip


def window_of(run, number=7, kind="SCIE", obsid="11"):
    chip = CHIPS[number]
    return selection.window_of(run, SimpleNamespace(type=kind), chip, *run.maps(run.exposures[obsid], chip))


def about(x, y, radius=0.1):
    return {"ra": x, "dec": y, "radius": radius}


def test_chips_are_those_of_a_group_or_a_list_behind_the_filters():
    camera = SimpleNamespace(chips=CHIPS, imaging_chips=[CHIPS[k] for k in (7, 8, 9)], slitless_chips=[CHIPS[1]])
    for given, wanted in (
        ({"chips": "all"}, [1, 7, 8, 9]), ({"chips": "slitless"}, [1]), ({}, [7, 8, 9]), ({"chips": [9, 1, 9]}, [1, 9]),
        ({"chips": "all", "filters": ["r", "GI"]}, [1, 9]), ({"chips": [8], "filters": ["r"]}, []),
    ):  # fmt: skip
        assert [one.id for one in selection.selected_chips(Select(**given), camera)] == wanted


def test_a_window_is_the_chip_the_pixels_or_the_square_about_the_region():
    pixels = PixelWindow(x0=100, x1=200, y0=50, y1=90)
    assert window_of(opened()) == Window(0, 300, 0, 400) and window_of(opened(window=pixels)) == Window(
        100, 200, 50, 90
    )
    region = about(120.3, 80.7)
    assert window_of(opened(region)) == Window(0, 300, 0, 400)
    assert window_of(opened(region, pixels)) == Window(100, 200, 50, 90)
    assert window_of(opened(region, "region")) == Window(108, 134, 68, 94)
    assert window_of(opened(region, "region"), obsid="12") == Window(58, 84, 68, 94)
    assert window_of(opened(region, "region"), kind="DARK") == Window(0, 300, 0, 400)
    assert window_of(opened(about(5.5, 395.0), "region")) == Window(0, 19, 383, 400)  # cut at two edges
    assert window_of(opened(about(296.0, 3.0), "region")) == Window(284, 300, 0, 16)


def test_behind_a_grating_a_window_holds_the_spectra_too():
    region = about(2120.3, 3080.7)  # of chip 1: 120.3, 80.7
    assert window_of(opened(region, "region"), 1) == Window(78, 174, 66, 99)


@pytest.mark.parametrize(("x", "y", "touches"), [
    (-8.0, 200.0, True), (-14.0, 200.0, False), (308.0, 200.0, True), (314.0, 200.0, False), (150.0, -8.0, True),
    (150.0, -14.0, False), (150.0, 408.0, True), (150.0, 414.0, False), (-9.0, -9.0, False), (-8.0, 408.0, True),
    (math.nan, 200.0, False),
])  # fmt: skip
def test_a_circle_of_12_px_touches_a_chip_or_does_not(x, y, touches):
    run = opened({"ra": 0.0, "dec": 0.0, "radius": 0.1})
    wcs = SimpleNamespace(world_to_pixel=lambda ra, dec: (x, y))
    found = selection.window_of(run, SimpleNamespace(type="SCIE"), CHIPS[7], wcs, None)
    assert found == (Window(0, 300, 0, 400) if touches else None)


def test_of_a_region_that_touches_nothing_the_nearest_three_are_named():
    """Chip 7 ends at 300: 354 is missed by 42 px, or 0.35 arcmin."""
    region = {"ra": 354.0, "dec": 0.0, "radius": 0.1}
    run = opened(region, obsids=("11",))
    said = str(selection.nothing_selected(run))
    assert said.startswith("c.yaml: select.region: the region touches no chip; it misses chip 7 (i) of exposure 11 by")
    far = re.findall(r"chip (\d) \(\w\) of exposure (\d+) by ([\d.]+)'", said)
    assert [(a, b) for a, b, _ in far] == [("7", "11"), ("8", "11"), ("9", "11")]
    # 54 - 12, 146 - 12 and hypot(54, 500) - 12 px of half an arcsec
    assert [float(c) for *_, c in far] == pytest.approx([42 / 120, 134 / 120, 490.9 / 120], abs=0.06)
    assert (
        '(got "0.1\' about 354, 0")' in said and "about 149.5000, 199.5000, the centre of chip 7 in exposure 11" in said
    )


def test_one_of_many_pairs_is_left_out_and_the_next_exposure_is_nearer():
    run = opened({"ra": 354.0, "dec": 30.0, "radius": 0.05})
    said = str(selection.nothing_selected(run))
    found = re.findall(r"chip (\d) \(\w\) of exposure (\d+) by", said)
    assert found == [("7", "12"), ("7", "11"), ("8", "11")]  # 354 is 4, 54 and -146 px from a chip
    said = str(selection.pair_missed(run, "12", CHIPS[8]))
    assert said.count("of exposure") == 1 and "the region misses chip 8 (g) of exposure 12" in said
    assert "as about 699.5000, 199.5000, the centre of chip 8" in said  # 149.5 + 500 + 50


def test_a_window_that_the_region_misses_is_at_fault():
    """The region is on chip 7, 100 px from the window; of chip 8 it misses the chip itself."""
    run = opened(about(150.0, 200.0), PixelWindow(x0=0, x1=38, y0=190, y1=210), obsids=("11",))
    for error in (selection.nothing_selected(run), selection.pair_missed(run, "11", CHIPS[7])):
        said = "c.yaml: window: the region touches chip 7 (i) of exposure 11, but not this window of it (got {'x0': 0"
        assert str(error).startswith(said) and "allowed: region, or a window near x 150, y 200" in str(error)
    assert "select.region: the region misses chip 8" in str(selection.pair_missed(run, "11", CHIPS[8]))


def test_the_place_that_works_is_the_middle_of_the_window():
    run = opened(about(54.0, 0.0), PixelWindow(x0=10, x1=20, y0=100, y1=201), obsids=("11",))
    assert "a region about 14.5000, 150.0000, the centre of this window" in str(selection.nothing_selected(run))


def test_calibrations_do_not_see_the_region_that_is_missed():
    run = opened(about(354.0, 0.0))
    run.exposures["12"].type = "BIAS"
    run.exposures["12"].shift = 50.0
    assert "of exposure 12" not in str(selection.nothing_selected(run))


def test_what_selects_nothing_is_named():
    run = opened(types=("DARK",), obsids=())
    run.pointings = {"1": SimpleNamespace(type="SCIE"), "2": SimpleNamespace(type="BIAS")}
    said = str(selection.nothing_selected(run))
    assert "select.types: no exposure has one of these types (got ('DARK',)); allowed: those in t.csv: BIAS, S" in said
    run = opened(chips=())
    run.config.select = Select(filters=["y"])
    assert "select.filters: none of the chips is behind one of the filters (got ('y',))" in str(
        selection.nothing_selected(run)
    )
    assert "window: no pixels are selected" in str(selection.nothing_selected(opened()))


def test_the_other_side_of_the_sky_is_no_distance():
    run = opened(about(10.0, 0.0), obsids=("11",))
    run.maps = lambda pointing, chip: (
        SimpleNamespace(
            world_to_pixel=lambda ra, dec: (math.nan, math.nan), pixel_to_world=lambda x, y: (x, y)
        ), None,
    )  # fmt: skip
    said = str(selection.nothing_selected(run))
    assert "the region is far from every pointing" in said and "chip 7 in exposure 11" in said


def test_bad_pairs_raise():
    with pytest.raises(InputError, match="misses chip 9"):
        raise selection.pair_missed(opened(about(354.0, 0.0)), "11", CHIPS[9])


def test_distances_in_words():
    assert selection._angle(119.94) == "119.9'" and selection._angle(120.0) == "about 2 deg"
    assert selection._angle(60 * math.degrees(math.tan(math.radians(80)))) == "about 80 deg"
