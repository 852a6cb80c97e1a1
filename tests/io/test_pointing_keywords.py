"""Pointing keywords of a header against the boresight, and its WCS against the chip's."""

from types import SimpleNamespace

import numpy as np
import pytest

from csstsim.instrument.camera import load_camera
from csstsim.io.pointing_keywords import Boresight, boresight_of, pointing_offsets, sky_offset, wcs_offset
from csstsim.optics.geometry.distortion import load_distortion
from csstsim.optics.geometry.sip import sip_header
from csstsim.optics.geometry.wcs import ChipWCS

RA, DEC, PA = 359.9999, -89.2, 133.0
HEADER = {
    "RA_OBJ": RA, "DEC_OBJ": DEC, "RA_PNT0": RA, "DEC_PNT0": DEC, "RA_PNT1": RA, "DEC_PNT1": DEC, "POS_ANG0": PA,
    "POS_ANG1": PA, "EULER0_1": RA, "EULER0_2": -DEC, "EULER0_3": -PA, "EULER1_1": RA, "EULER1_2": -DEC,
    "EULER1_3": -PA,
}  # fmt: skip
BORESIGHT = Boresight(RA, DEC, PA)


def test_a_right_header_is_right_however_its_angles_are_written():
    assert len(pointing_offsets(HEADER, BORESIGHT)) == 9
    for other in (HEADER, HEADER | {"RA_OBJ": RA - 360.0, "POS_ANG0": PA - 360.0, "EULER0_3": 360.0 - PA}):
        assert max(pointing_offsets(other, BORESIGHT).values()) < 1e-6


@pytest.mark.parametrize(
    ("keyword", "off", "named", "arcsec"),
    [
        ("POS_ANG0", 0.05, "POS_ANG0", 180.0), ("EULER1_3", 0.05, "EULER1_3", 180.0),
        ("DEC_PNT1", 0.01, "RA_PNT1", 36.0),
        ("EULER0_2", -0.01, "EULER0_1", 36.0), ("RA_PNT0", 0.01, "RA_PNT0", 36.0 * np.cos(np.radians(DEC))),
    ],
)  # fmt: skip
def test_one_keyword_that_is_off_is_named(keyword, off, named, arcsec):
    found = pointing_offsets(HEADER | {keyword: HEADER[keyword] + off}, BORESIGHT)
    assert found.pop(named) == pytest.approx(arcsec, rel=1e-6)
    assert max(found.values()) < 1e-6


@pytest.mark.parametrize("value", ["", "north", None, float("nan")])
def test_what_is_no_number_is_infinitely_far_off(value):
    assert pointing_offsets({"RA_OBJ": value, "DEC_OBJ": DEC, "POS_ANG0": value}, BORESIGHT) == {
        "RA_OBJ": np.inf, "POS_ANG0": np.inf,
    }  # fmt: skip


def test_without_a_campaign_angles_are_compared_with_each_other():
    boresight = boresight_of({"CTYPE1": "RA---TAN", "CRVAL1": RA, "CRVAL2": DEC})
    assert boresight == Boresight(RA, DEC, None)
    assert max(pointing_offsets(HEADER, boresight).values()) < 1e-6
    assert pointing_offsets(HEADER | {"POS_ANG1": PA + 0.05}, boresight)["POS_ANG1"] == pytest.approx(180.0)
    assert boresight_of({"CTYPE1": "RA---TAN-SIP", "CRVAL1": RA, "CRVAL2": DEC}) is None and boresight_of({}) is None


def test_the_wcs_of_both_forms():
    camera = load_camera()
    distortion = load_distortion(camera.folder / "distortion.fits")
    wcs = ChipWCS(camera.chips[30], SimpleNamespace(ra=RA, dec=DEC, pa=PA), distortion)
    other = ChipWCS(camera.chips[30], SimpleNamespace(ra=RA, dec=DEC, pa=PA + 0.05), distortion)
    for header in (wcs.header, lambda: sip_header(wcs)):
        assert wcs_offset(header(), wcs) < 1e-3
        assert wcs_offset(header(), other) > 1.0
        moved = header() | {"CRVAL2": header()["CRVAL2"] + 0.01}
        assert wcs_offset(moved, wcs) == pytest.approx(36.0, rel=3e-3)
    assert wcs_offset({}, wcs) == np.inf


@pytest.mark.parametrize(("keyword", "off", "named", "arcsec"), [
    ("RA_OBJ", -0.01, "RA_OBJ", 36.0 * np.cos(np.radians(DEC))), ("DEC_OBJ", 0.01, "RA_OBJ", 36.0),
    ("DEC_PNT0", -0.01, "RA_PNT0", 36.0), ("RA_PNT1", 0.01, "RA_PNT1", 36.0 * np.cos(np.radians(DEC))),
    ("EULER0_1", 0.01, "EULER0_1", 36.0 * np.cos(np.radians(DEC))), ("EULER1_2", 0.01, "EULER1_1", 36.0),
    ("EULER1_1", 0.01, "EULER1_1", 36.0 * np.cos(np.radians(DEC))), ("POS_ANG1", -0.05, "POS_ANG1", 180.0),
    ("EULER0_3", 0.05, "EULER0_3", 180.0), ("POS_ANG0", 180.0, "POS_ANG0", 180 * 3600.0),
])  # fmt: skip
def test_every_other_keyword_that_is_off(keyword, off, named, arcsec):
    found = pointing_offsets(HEADER | {keyword: HEADER[keyword] + off}, BORESIGHT)
    assert found.pop(named) == pytest.approx(arcsec, rel=1e-6) and max(found.values()) < 1e-6


def test_keywords_that_a_header_lacks_are_left_out():
    assert pointing_offsets({"RA_OBJ": RA, "EULER0_2": -DEC, "EULER1_3": -PA - 0.01}, BORESIGHT) == {
        "EULER1_3": pytest.approx(36.0)
    }
    assert boresight_of({"CTYPE1": "RA---TAN", "CRVAL1": 1.0}) is None


def test_the_largest_distance_counts():
    cards = {"CTYPE1": "RA---TAN", "CTYPE2": "DEC--TAN", "CRVAL1": 10.0, "CRVAL2": 60.0, "CRPIX1": 1.0, "CRPIX2": 1.0}
    cards |= {"CD1_1": -1e-4, "CD1_2": 0.0, "CD2_1": 0.0, "CD2_2": 1e-4}
    zero = np.zeros(3)
    for ra, dec, arcsec in ((0.001, 0.0, 1.8), (0.0, -0.001, 3.6), (-0.001, 0.001, np.hypot(1.8, 3.6))):
        true = np.array([10.0, 10.0 + ra, 10.0]), np.array([60.0, 60.0 + dec, 60.0])
        assert sky_offset(cards, zero, zero, true) == pytest.approx(arcsec, rel=1e-3)
    assert sky_offset(cards, zero, zero, (np.array([10.0, np.nan, 10.0]), np.full(3, 60.0))) == np.inf
