"""aXe's configuration files: written files are read back, HST's files are read or refused."""

import os
from pathlib import Path

import numpy as np
import pytest

from csstsim.base.errors import InputError
from csstsim.base.shipped import SHIPPED
from csstsim.instrument.axe import BEAMS, COEFFICIENTS, axe_text, field_range, field_terms, read_axe, sensitivity_file

HST = Path(os.environ.get("CSSTSIM_DATA", SHIPPED.parents[1] / "shared" / "data")) / "grism"
ONE = """BEAMA 10 200 ; extent
DYDX_ORDER_A 1
DISP_ORDER_A 1 # linear
XOFF_A 0
YOFF_A 0.5
DYDX_A_0 1 2e-3 -1e-3 ; three
DYDX_A_1 0.01 1e-6 2e-6 3e-10 4e-10 5e-10
DLDP_A_0 4000
# a line of its own
DLDP_A_1 8.5 1e-4 2e-4
; SENSITIVITY_A old.fits
SENSITIVITY_A a.fits
"""


def read(tmp_path, text):
    path = tmp_path / "one.conf"
    path.write_text(text, encoding="utf-8")
    return read_axe(path)


def test_comments_and_one_three_six_numbers(tmp_path):
    order = read(tmp_path, "INSTRUMENT HST\nFFNAME a.fits\nFFNAME b.fits\nBEAMF 1 2\n" + ONE)[1]
    assert order["extent"] == (10.0, 200.0) and order["sensitivity"] == "a.fits"
    assert order["yoff"].tolist() == [0.5, 0, 0, 0, 0, 0]
    assert order["a0"].tolist() == [1, 2e-3, -1e-3, 0, 0, 0]
    assert order["a1"].tolist() == [0.01, 1e-6, 2e-6, 3e-10, 4e-10, 5e-10]
    assert field_terms(3.0, 5.0).tolist() == [1, 3, 5, 9, 15, 25]  # m n before n^2, unlike equation 3 of the paper


def test_trace_without_slope(tmp_path):
    text = ONE.replace("DYDX_ORDER_A 1", "DYDX_ORDER_A 0").replace("DYDX_A_1 0.01 1e-6 2e-6 3e-10 4e-10 5e-10\n", "")
    assert not read(tmp_path, text)[1]["a1"].any()


def test_round_trip(tmp_path):
    """To 1e-9 of each coefficient; what is below rounding at the corner of a chip is left out."""
    rng = np.random.default_rng(1)
    size = np.array([1, 1e-4, 1e-4, 1e-8, 1e-8, 1e-8])
    orders = {}
    for order in (1, 0, -2):  # the others need not be there
        one = {name: rng.normal(size=6) * size for name in COEFFICIENTS}
        one["a1"][1:], one["alpha0"][3:] = 0.0, 0.0
        orders[order] = one | {"extent": (-30.0, 500.0), "sensitivity": f"s{order}.fits"}
    found = read(tmp_path, axe_text(orders, ["a comment", "another"]))
    assert sorted(found) == [-2, 0, 1]
    for order, one in orders.items():
        assert found[order]["extent"] == one["extent"] and found[order]["sensitivity"] == one["sensitivity"]
        for name in COEFFICIENTS:
            np.testing.assert_allclose(found[order][name], one[name], rtol=1e-8, atol=1e-17)


def test_range_of_a_coefficient_over_a_rectangle():
    """Against a grid of 301 x 301 places, for saddles, bowls, planes and constants."""
    rng = np.random.default_rng(2)
    x, y = np.meshgrid(np.linspace(-500, 3000, 301), np.linspace(-100, 9000, 301))
    for degree in [1, 3, 4, 5, 6] * 20:
        coefficient = np.zeros(6)
        coefficient[:degree] = (rng.normal(size=6) * [1, 1e-3, 1e-3, 3e-7, 3e-7, 3e-7])[:degree]
        values = field_terms(x, y) @ coefficient
        low, high = field_range(coefficient, -500.0, 3000.0, -100.0, 9000.0)
        spread = 1e-4 * (values.max() - values.min()) + 1e-12
        assert low <= values.min() + 1e-12 and low >= values.min() - spread
        assert high >= values.max() - 1e-12 and high <= values.max() + spread


BAD = {
    "no first order": (lambda t: t.replace("BEAMA", "BEAMB"), "BEAMA: the first order is missing"),
    "grismconf": (lambda t: t.replace("BEAMA 10 200", "BEAM_+1"), "BEAM_+1: a beam of grismconf"),
    "key with underscore": (lambda t: t.replace("BEAMA", "BEAM_A"), "BEAM_A: a beam of grismconf"),
    "missing key": (lambda t: t.replace("XOFF_A 0\n", ""), "XOFF_A: required key is missing"),
    "no value": (lambda t: t.replace("XOFF_A 0\n", "XOFF_A\n"), "XOFF_A: required key is missing"),
    "word": (lambda t: t.replace("XOFF_A 0", "XOFF_A zero"), "XOFF_A: must be numbers (got 'zero')"),
    "four numbers": (lambda t: t.replace("DLDP_A_0 4000", "DLDP_A_0 1 2 3 4"), "1 or 3 or 6 finite numbers"),
    "not a number": (lambda t: t.replace("4000", "nan"), "DLDP_A_0: cannot be used"),
    "too large": (lambda t: t.replace("4000", "1e999"), "DLDP_A_0: cannot be used"),
    "twice": (lambda t: t + "XOFF_A 1\n", "XOFF_A: given twice"),
    "quadratic dispersion": (lambda t: t.replace("DISP_ORDER_A 1", "DISP_ORDER_A 2"), "DISP_ORDER_A: traces and"),
    "quadratic trace": (lambda t: t.replace("DYDX_ORDER_A 1", "DYDX_ORDER_A 2"), "got 2.0); allowed: 0 or 1"),
    "undispersed": (lambda t: t.replace("DLDP_A_1 8.5 1e-4 2e-4", "DLDP_A_1 0"), "DLDP_A_1: an order without"),
    "extent": (lambda t: t.replace("10 200", "200 10"), "BEAMA: must rise"),
    "sensitivity": (lambda t: t.replace("\nSENSITIVITY_A a.fits", ""), "SENSITIVITY_A: required key is missing"),
    "equal ends": (lambda t: t.replace("10 200", "10 10"), "BEAMA: must rise"),
    **{
        f"{key} is not 0": (lambda t, key=key: f"{t}{key} 507\n", f"{key}: pixels must count from the chip's corner")
        for key in ("XOFF", "YOFF", "REFX", "REFY")
    },
    "empty": (lambda t: "", "BEAMA: the first order is missing"),
}  # fmt: skip


@pytest.mark.parametrize("change, message", BAD.values(), ids=BAD)
def test_bad_files(tmp_path, change, message):
    with pytest.raises(InputError) as error:
        read(tmp_path, change(ONE))
    assert message in str(error.value) and "one.conf" in str(error.value)


def test_files_that_are_none(tmp_path):
    (tmp_path / "binary.conf").write_bytes(b"BEAMA \xff\xfe")
    for name, message in (("none.conf", "No such file"), ("binary.conf", "not UTF-8 text"), (".", "is a folder")):
        with pytest.raises(InputError, match=message):
            read_axe(tmp_path / name)


@pytest.mark.skipif(not HST.is_dir(), reason="HST's files are not shipped; set CSSTSIM_DATA")
@pytest.mark.parametrize("name, message", [
    ("aXe_ACS.WFC.CHIP1.Cycle13.5.conf", "DISP_ORDER_A: traces and dispersion are linear"),
    ("grizli-config_ACS.WFC.CHIP1.Stars.conf", "DISP_ORDER_C: traces and dispersion are linear"),
    ("aXe_G141.F140W.V4.32.conf", "SENSITIVITY_A: given twice"),
    ("G102.conf", "a beam of grismconf"),
    ("G141.conf", "a beam of grismconf"),
    ("UVIS_G280_CCD1_V2.conf", "a beam of grismconf"),
])  # fmt: skip
def test_hst_files_refused(name, message):
    with pytest.raises(InputError, match=message):
        read_axe(HST / name)


@pytest.mark.skipif(not HST.is_dir(), reason="HST's files are not shipped; set CSSTSIM_DATA")
def test_hst_file_read(tmp_path):
    """WFC3's G141, once it names one sensitivity a beam: five beams of 3 and 6 numbers, one without slope."""
    lines = (HST / "aXe_G141.F140W.V4.32.conf").read_text().splitlines()
    orders = read(tmp_path, "\n".join(line for line in lines if "GD153" not in line))
    assert sorted(orders) == sorted(BEAMS.values())
    first = orders[1]
    assert first["extent"] == (15.0, 196.0) and first["sensitivity"] == "WFC3.IR.G141.1st.sens.2.fits"
    alpha1 = field_terms(507.0, 507.0) @ first["alpha1"]  # angstrom / px in the middle; WFC3's handbook: 46.5
    assert alpha1 == pytest.approx(46.5, abs=0.5)
    assert orders[0]["a1"].tolist() == [0.0] * 6 and not orders[-1]["a0"][3:].any()


def test_each_order_has_a_sensitivity_file_of_its_own():
    names = {order: sensitivity_file("GV5", order) for order in (-2, -1, 0, 1, 2)}
    assert names == {-2: "GV5_m2.fits", -1: "GV5_m1.fits", 0: "GV5_p0.fits", 1: "GV5_p1.fits", 2: "GV5_p2.fits"}


def test_offsets_of_all_beams_may_be_given_as_none(tmp_path):
    assert read(tmp_path, "XOFF 0\nYOFF 0.0\nREFX 0\nREFY 0\n" + ONE).keys() == {1}
