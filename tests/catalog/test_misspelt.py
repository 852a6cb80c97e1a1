"""Names that are slips for csstsim's columns, and those that are other surveys'."""

import pytest
from support.csst import BANDS

from csstsim.catalog.misspelt import closest_name, unused_magnitude

KNOWN = {"ra", "dec", "type", "size", "pmra", "parallax", "bulge_frac", "e1", *(f"mag_{band}" for band in BANDS)}


@pytest.mark.parametrize("name, column", [
    ("siez", "size"), ("RA", "ra"), ("typ", "type"), ("R_MAG", "mag_r"), ("rmag", "mag_r"), ("mag-G", "mag_g"),
    ("pm_ra", "pmra"), ("PARALAX", "parallax"), ("bulge_fraction", "bulge_frac"), ("nuv_mag", "mag_nuv"),
    ("decl", "dec"),
    # one letter of another system's band, and words too far from any
    ("mag_v", None), ("mag_j", None), ("mag.k", None), ("magb", None), ("name", None), ("colour", None), ("x", None),
    ("e", None), ("tile", None),
])  # fmt: skip
def test_the_column_that_is_meant(name, column):
    assert closest_name(name, KNOWN) == column


def test_of_names_with_the_same_letters_the_first_in_the_alphabet():
    assert closest_name("cab", {"bca", "acb"}) == "acb"


@pytest.mark.parametrize("name, text", [
    ("r", "r is not used; did you mean mag_r"),
    ("NUV", "NUV is not used; did you mean mag_nuv"),
    ("mag_V", "mag_V is not used: the camera's magnitudes are mag_nuv, mag_u, mag_g, mag_r, mag_i, mag_z, mag_y"),
    ("W1_mag", "W1_mag is not used: the camera's magnitudes are mag_nuv, "),
    ("mag", "mag is not used: the camera's"), ("kp.mag", "kp.mag is not used"),
    ("mag_norm", None), ("MAG_NORM", None), ("mag_r_err", None), ("magerr_g", None), ("magnet", None),
    ("image", None), ("v", None), ("omag1", None),
])  # fmt: skip
def test_magnitudes_that_are_not_used(name, text):
    said = unused_magnitude(name, BANDS)
    assert said is None if text is None else said.startswith(text)
