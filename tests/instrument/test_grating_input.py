"""A user's own grating files: unusable ones are refused in one line with key, value and allowed values."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
from astropy.io import fits

from csstsim.base.errors import InputError
from csstsim.base.shipped import SHIPPED
from csstsim.base.units import C_A_S, H_J_S
from csstsim.instrument.axe import COEFFICIENTS
from csstsim.instrument.grating import load_grating, load_gratings, sensitivity

ROW = {"left": "GI2", "right": "GI1", "split": 3685, "reach": [654, 1600, 1600, 449]}


@pytest.fixture
def load(camera, tmp_path):
    """Return a function that loads chip 1's two gratings from a folder of their files, after `change(folder, data)`."""
    folder = tmp_path / "gratings"
    folder.mkdir()
    for name in ("GI1.conf", "GI2.conf", *(f"GI_{order}.fits" for order in ("m2", "m1", "p0", "p1", "p2"))):
        shutil.copy(SHIPPED / "instrument" / "gratings" / name, folder)

    def loaded(change):
        data = {"chips": {1: dict(ROW)}}
        change(folder, data)
        return load_gratings(folder, data, {1: camera.chips[1]}, camera.filters, camera.telescope)[1]

    return loaded


def test_the_reach_is_beyond_left_right_lower_and_upper_edge(load, camera):
    detector = camera.chips[1].detector
    edges = (-654.5, detector.nx - 0.5 + 1600, -1600.5, detector.ny - 0.5 + 449)
    assert load(lambda folder, data: None).bounds == edges


def edit(name, old, new):
    """Return a change that replaces the beginning of a line of a .conf file by another line."""

    def change(folder, data):
        path = folder / name
        lines = path.read_text().splitlines()
        assert any(line.startswith(old) for line in lines)
        path.write_text("\n".join(new if line.startswith(old) else line for line in lines))

    return change


def table(name="GI_p1.fits", **columns):
    """Return a change that writes a sensitivity with other columns."""

    def change(folder, data):
        old = fits.getdata(folder / name)
        new = {key: np.asarray(old[key], float) for key in ("WAVELENGTH", "SENSITIVITY")} | columns
        arrays = {key: v(old) if callable(v) else v for key, v in new.items()}
        listed = [fits.Column(key, "D", array=v) for key, v in arrays.items() if v is not None]
        fits.BinTableHDU.from_columns(listed).writeto(folder / name, overwrite=True)

    return change


def file(name, content):
    return lambda folder, data: (folder / name).write_bytes(content(folder / name))


def row(**keys):
    return lambda folder, data: data["chips"][1].update(keys)


def image(folder, data):
    fits.HDUList([fits.PrimaryHDU(), fits.ImageHDU(np.ones((4, 4)))]).writeto(folder / "GI_p1.fits", overwrite=True)


BAD = {
    "outside": (edit("GI1.conf", "SENSITIVITY_A ", "SENSITIVITY_A ../GI_p1.fits"), "not a data file of the camera"),
    "no .fits": (edit("GI1.conf", "SENSITIVITY_A ", "SENSITIVITY_A GI_p1.dat"), "(got 'GI_p1.dat')"),
    "no chips": (lambda f, d: d.update(chips=None), "gratings.yaml: chips: must be a mapping"),
    "chip missing": (lambda f, d: d.update(chips={}), "chips.1: must be a mapping"),
    "imaging chip": (lambda f, d: d["chips"].update({9: dict(ROW)}), "not a chip with gratings (got 9)"),
    "one grating": (lambda f, d: d["chips"][1].pop("right"), "chips.1.right: required key is missing"),
    "row is a list": (lambda f, d: d["chips"].update({1: ["GI2", "GI1"]}), "chips.1: must be a mapping"),
    "name is a list": (row(left=["GI2"]), "chips.1.left: input should be a valid string"),
    "name is a number": (row(right=2), "chips.1.right: input should be a valid string"),
    "no such grating": (row(right="GI9"), "GI9.conf: cannot read the file: No such file"),
    "split outside": (row(split=9216), "chips.1.split: must be a column (got 9216); allowed: 1..9215"),
    "split between": (row(split=3685.5), "chips.1.split: input should be a valid integer"),
    "split is true": (row(split=True), "chips.1.split: input should be a valid integer"),
    "reach too short": (row(reach=[1, 2, 3]), "chips.1.reach: too few numbers"),
    "reach nan": (row(reach=[1, 2, 3, float("nan")]), "chips.1.reach.3: input should be a finite number"),
    "reach infinite": (row(reach=[1, 2, 3, float("inf")]), "chips.1.reach.3: input should be a finite number"),
    "turns round in the piece": (edit("GI1.conf", "DLDP_A_1", "DLDP_A_1 -8.4 0 0 0 0 1e-7"),
                                 "GI1.conf: DLDP_A_1: must have one sign"),
    "vanishes in a corner": (edit("GI1.conf", "DLDP_A_1", "DLDP_A_1 -10815.5 1 0"), "DLDP_A_1: must have one sign"),
    "wrong side": (edit("GI1.conf", "DLDP_D_1", "DLDP_D_1 -8.5"), "DLDP_D_1: wrong sign of order -1"),
    "far away": (edit("GI1.conf", "DLDP_E_1", "DLDP_E_1 0.1"), "BEAME: the trace is too far from its direct image"),
    "astronomically far": (edit("GI1.conf", "XOFF_A", "XOFF_A 1e300 1e306 0"), "BEAMA: the trace is too far"),
    "other filter": (edit("GI1.conf", "SENSITIVITY_A", "SENSITIVITY_A GI_m1.fits"), "is not the throughput of GI"),
    "nanometres a pixel": (edit("GI1.conf", "DLDP_A_1", "DLDP_A_1 -0.84449406"), "BEAMA: the middle of the order"),
    "a point": (edit("GI1.conf", "DLDP_A_1", "DLDP_A_1 -1e9"), "BEAMA: the middle of the order is outside"),
    "another extent": (edit("GI1.conf", "BEAMA", "BEAMA 5 6"), "BEAMA: the middle of the order is outside"),
    "too sensitive": (table(SENSITIVITY=lambda t: 1.02 * t["SENSITIVITY"]), "off by 0.020 of the peak"),
    "too insensitive": (table(SENSITIVITY=lambda t: 0.98 * t["SENSITIVITY"]), "off by 0.020 of the peak"),
    "elsewhere": (edit("GI1.conf", "SENSITIVITY_A", "SENSITIVITY_A /tmp/GI_p1.fits"), "not a data file of the camera"),
    "hidden": (edit("GI1.conf", "SENSITIVITY_A", "SENSITIVITY_A .GI_p1.fits"), "not a data file of the camera"),
    "no sensitivity": (edit("GI1.conf", "SENSITIVITY_A", "SENSITIVITY_A a/b/none.fits"), "none.fits: no such file"),
    "folder": (edit("GI1.conf", "SENSITIVITY_A", "SENSITIVITY_A ."), "not a data file of the camera"),
    "text": (file("GI_p1.fits", lambda p: b"1 2 3\n"), "GI_p1.fits: cannot be read as a sensitivity"),
    "empty": (file("GI_p1.fits", lambda p: b""), "GI_p1.fits: cannot be read as a sensitivity"),
    "cut short": (file("GI_p1.fits", lambda p: p.read_bytes()[:9000]), "GI_p1.fits"),
    "cut in the header": (file("GI_p1.fits", lambda p: p.read_bytes()[:4000]), "GI_p1.fits: cannot be read"),
    "image": (image, "GI_p1.fits: cannot be read as a sensitivity"),
    "no column": (table(SENSITIVITY=None), "GI_p1.fits: cannot be read as a sensitivity"),
    "not a number": (table(SENSITIVITY=lambda t: np.where(t["WAVELENGTH"] > 8e3, np.nan, t["SENSITIVITY"])), "finite"),
    "negative": (table(SENSITIVITY=lambda t: -1.0 * t["SENSITIVITY"]), "sensitivities be 0 or more"),
    "falling": (table(WAVELENGTH=lambda t: t["WAVELENGTH"][::-1]), "wavelengths must rise"),
    "nanometres": (table(WAVELENGTH=lambda t: t["WAVELENGTH"] / 10), "impossible electrons per photon at 2000-11000"),
    "zero": (table(SENSITIVITY=lambda t: 0.0 * t["SENSITIVITY"]), "a peak above 0, up to 1"),
    "zeroth order zero": (table("GI_p0.fits", SENSITIVITY=lambda t: 0.0 * t["SENSITIVITY"]), "GI_p0.fits"),
    "too much": (table("GI_p2.fits", SENSITIVITY=lambda t: 1e3 * t["SENSITIVITY"]), "a peak above 0, up to 1"),
}  # fmt: skip


@pytest.mark.parametrize("change, message", BAD.values(), ids=BAD)
def test_bad_input(load, change, message):
    with pytest.raises(InputError) as error:
        load(change)
    assert message in str(error.value)


def test_an_order_may_be_missing_from_one(load):
    """GI1 without its order -2: GI2 keeps it."""

    def without(folder, data):
        path = folder / "GI1.conf"
        path.write_text(path.read_text().partition("# Order -2")[0])

    two = load(without)
    assert sorted(two.right.orders) == [-1, 0, 1, 2]
    assert two.numbers == [-2, -1, 0, 1, 2]
    assert 2500 < two.reach < 2600  # px, of the second order


def test_small_letters_in_a_table(load):
    assert load(table(WAVELENGTH=None, wavelength=lambda t: t["WAVELENGTH"])).numbers == [-2, -1, 0, 1, 2]


def test_pieces_bounds_and_span_of_a_chips_gratings(load):
    """Light from 654 px left to 1600 px right and 1600 px below to 449 px above the chip; columns below 3685 left."""
    two = load(row(reach=[654, 1600, 1500, 449]))
    assert two.bounds == (-654.5, 9215.5 + 1600, -1500.5, 9231.5 + 449) and two.split == 3685.0
    (left, to_left), (right, to_right) = two.pieces
    assert (left.name, right.name) == ("GI2", "GI1")
    assert to_left == (-654.5, 3684.5, -1500.5, 9680.5) and to_right == (3684.5, 10815.5, -1500.5, 9680.5)
    assert left.orders[1].extent != right.orders[1].extent
    for x, grating in ((3684.4, left), (3684.5, right)):
        ends = [(0.0, 0.0)]
        for number in (0, 1):
            p, q, r, s = grating.orders[number].lines(x, 5000.0)
            ends += [(p + q * wave, r + s * wave) for wave in grating.orders[number].range]
        (x0, y0), (x1, y1) = np.min(ends, axis=0), np.max(ends, axis=0)
        assert two.span(x, 5000.0) == pytest.approx((x0, x1, y0, y1))
        assert x1 - x0 > 300


@pytest.mark.parametrize(("said", "reason"), [
    ("first\nthe last line  \n", "the last line"), ("one", "one"), ("", "OSError"), ("  \n", "OSError"),
])  # fmt: skip
def test_why_a_sensitivity_cannot_be_read_is_the_last_line_or_the_kind_of_error(load, monkeypatch, said, reason):
    def read(*given, **named):
        raise OSError(said)

    monkeypatch.setattr("fitsio.read", read)
    with pytest.raises(InputError) as refused:
        load(lambda folder, data: None)
    assert refused.value.message == f"cannot be read as a sensitivity: {reason}"


def test_a_sensitivity_may_differ_from_the_filter_by_less_than_a_percent(load):
    assert load(table(SENSITIVITY=lambda t: 1.008 * t["SENSITIVITY"])).numbers == [-2, -1, 0, 1, 2]


def test_lines_between_the_points_of_the_grid_keep_their_light(load, camera):
    """A comb of teeth of 0.1 A, 1 A apart, in a second order: the electrons of trapezoids on its own points."""
    wave = 7000.13 + 0.05 * np.arange(2801)
    comb = np.where(np.arange(2801) % 20 < 2, 1e13, 0.0)
    two = load(table("GI_m2.fits", WAVELENGTH=wave, SENSITIVITY=comb))
    throughput = comb / (1e-3 * camera.telescope.area_m2 * wave / (H_J_S * C_A_S))
    assert 0.5 * two.left.orders[-2].throughput.sum() == pytest.approx(np.trapezoid(throughput, wave), rel=5e-3)


@pytest.mark.parametrize("side", ["left", "right"])
def test_the_reach_is_that_of_the_grating_that_throws_light_further(load, side):
    """By the ends of all orders in the corners of their pieces; of one grating, orders go half as far again."""
    two = load(lambda folder, data: None)
    grating = getattr(two, side)
    further = np.where(np.array(list(COEFFICIENTS)) == "alpha1", 2 / 3, 1.0)[:, None]
    orders = {k: replace(order, coefficients=order.coefficients * further) for k, order in grating.orders.items()}
    two = replace(two, **{side: replace(grating, orders=orders)})
    ends = []
    for piece, (x0, x1, y0, y1) in two.pieces:
        x, y = np.array([x0, x1, x0, x1]), np.array([y0, y0, y1, y1])
        for order in piece.orders.values():
            p, q, r, s = order.lines(x, y).T
            ends += [np.abs([p + q * wave, r + s * wave]).max() for wave in order.range]
    assert two.reach == pytest.approx(max(ends), rel=1e-3) and two.reach > 3800


def test_a_sensitivity_is_of_a_telescope(load, camera, tmp_path):
    """Electrons go with the area: of a quarter of it, a quarter of the sensitivity is the same throughput."""
    two = load(lambda folder, data: None)
    small = replace(camera.telescope, diameter_m=camera.telescope.diameter_m / 2)
    wave, flat = np.array([7000.0, 9000.0]), np.array([0.3, 0.3])
    assert sensitivity(wave, flat, small) == pytest.approx(sensitivity(wave, flat, camera.telescope) / 4)
    folder = tmp_path / "gratings"
    for order in ("m2", "m1", "p0", "p1", "p2"):
        table(f"GI_{order}.fits", SENSITIVITY=lambda t: t["SENSITIVITY"] / 4)(folder, {})
    again = load_grating(folder / "GI1.conf", camera.filters["GI"], small)
    for number, order in two.right.orders.items():
        assert again.orders[number].throughput == pytest.approx(order.throughput, abs=1e-9)
