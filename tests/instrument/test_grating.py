"""The shipped gratings match their description, their electrons the filters'; bad data are refused."""

import shutil

import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.io import fits
from build_gratings import build

from csstsim.base.shipped import SHIPPED
from csstsim.instrument.grating import load_gratings
from csstsim.instrument.load import read_data
from csstsim.optics.geometry.wcs import ChipWCS

SHIPPED_GRATINGS = SHIPPED / "instrument" / "gratings"
ZEROPOINT = {"GU": 25.41, "GV": 26.23, "GI": 26.11}  # AB mag of 1 e-/s in the first order: statistics of CESS's curves
DISPERSION = {"GU": 5.2, "GV": 7.1, "GI": 8.5}  # angstrom / px, first order: gratings.yaml


def places(piece, count=4):
    x0, x1, y0, y1 = piece
    return (v.ravel() for v in np.meshgrid(np.linspace(x0, x1, count), np.linspace(y0, y1, count)))


def test_two_gratings_a_chip(camera):
    """24 in all, of the chip's filter, meeting at the split, with opposite first orders of the published dispersion."""
    names = [g.name for two in camera.gratings.values() for g in (two.left, two.right)]
    assert sorted(names) == sorted(f"{band}{k}" for band in DISPERSION for k in range(1, 9))
    for number, two in camera.gratings.items():
        chip = camera.chips[number]
        (left, to_left), (right, to_right) = two.pieces
        assert left.name[:2] == right.name[:2] == chip.filter
        assert to_left[1] == to_right[0] == (3684.5 if chip.xc > 0 else 5530.5)  # 2/5 and 3/5 of 9216 columns
        for grating, piece, sign in ((left, to_left, 1), (right, to_right, -1)):
            x, y = places(piece)
            for order in grating.orders.values():
                p, q, r, s = order.lines(x, y).T
                ends = np.array(order.range)
                if order.number:
                    dispersion = sign * order.number / q  # of all orders the first one's, to 3% over the piece
                    assert dispersion == pytest.approx(DISPERSION[chip.filter], rel=0.03)
                else:
                    assert (sign * q > 0).all() and np.abs(q).max() * np.ptp(ends) < 1.1  # px, the whole band
                light = p[:, None] + q[:, None] * ends
                assert order.extent[0] <= light.min() and light.max() <= order.extent[1]  # what extraction relies on
                # Along the chip's rows, to 10 px: the turn by one degree is the chip's
                assert np.abs(r[:, None] + s[:, None] * ends).max() < 10


def test_first_order_is_the_filter(camera):
    """Electrons of every grating's first order, by sensitivity, are the filter's; the others' are the shares stated."""
    shares = read_data(SHIPPED / "instrument" / "gratings.yaml")["efficiency"]
    for number, two in camera.gratings.items():
        curve = camera.filters[camera.chips[number].filter].throughput
        for grating in (two.left, two.right):
            assert sorted(grating.orders) == [-2, -1, 0, 1, 2]
            for order in grating.orders.values():
                share = shares[order.number]
                assert np.abs(order.throughput - share * curve).max() < 2e-3 * share * curve.max()
                assert order.throughput.sum() == pytest.approx(share * curve.sum(), rel=1e-4)


@pytest.mark.parametrize("band", ZEROPOINT)
def test_zero_point_of_the_first_order(camera, band):
    """From the file alone, in the units it states: 3631 Jy give the published electrons per second."""
    table = fits.getdata(SHIPPED_GRATINGS / f"{band}_p1.fits")
    wave = table["WAVELENGTH"].astype(float)
    flux = 3631e-23 * 2.99792458e18 / wave**2  # erg / s / cm2 / angstrom
    zeropoint = 2.5 * np.log10(np.trapezoid(flux * table["SENSITIVITY"], wave))
    assert zeropoint == pytest.approx(camera.filters[band].zeropoint(camera.telescope), abs=1e-3)
    assert zeropoint == pytest.approx(ZEROPOINT[band], abs=0.05)


def test_committed_files_are_what_the_builder_makes(camera, tmp_path):
    """To 1e-3 px over each piece and 1e-6 electron per photon."""
    folder = shutil.copytree(SHIPPED / "instrument", tmp_path / "instrument")
    shutil.rmtree(folder / "gratings")
    worst = build(folder)
    chips = {chip.id: chip for chip in camera.slitless_chips}
    data = read_data(folder / "gratings.yaml")
    made = load_gratings(folder / "gratings", data, chips, camera.filters, camera.telescope)
    for number, two in camera.gratings.items():
        for (grating, piece), (other, _) in zip(two.pieces, made[number].pieces, strict=True):
            x, y = places(piece)
            for order, one in grating.orders.items():
                for wave in one.range:
                    moved = (one.lines(x, y) - other.orders[order].lines(x, y)).reshape(-1, 2, 2) @ [1, wave]
                    assert np.abs(moved).max() < 1e-3
                assert np.abs(one.throughput - other.orders[order].throughput).max() < 1e-6
    assert max(px for orders in worst.values() for order, px in orders.items() if order in (0, 1)) < 0.2
    assert sorted(p.name for p in (folder / "gratings").iterdir()) == sorted(p.name for p in SHIPPED_GRATINGS.iterdir())


def test_lines_by_hand(camera):
    """At one place of GV4, equations 1 to 4 as the paper prints them, with the .conf's numbers read by hand."""
    text = dict(line.split(maxsplit=1) for line in (SHIPPED_GRATINGS / "GV4.conf").read_text().splitlines() if line)
    m, n, wave = 1234.0, 5678.0, 5000.0

    def value(key):
        return sum(float(c) * t for c, t in zip(text[key].split(), (1, m, n, m * m, m * n, n * n), strict=False))

    a0, a1, alpha0, alpha1 = (value(key) for key in ("DYDX_A_0", "DYDX_A_1", "DLDP_A_0", "DLDP_A_1"))
    x = (wave - alpha0) / alpha1 / np.hypot(1.0, a1)
    y = a0 + a1 * x
    p, q, r, s = camera.gratings[2].left.orders[1].lines(m, n)
    assert (p + q * wave, r + s * wave) == pytest.approx((x, y), abs=1e-9)  # px
    # The paper's L = sqrt(x^2 + y^2) differs by a0^2 / 2L
    assert alpha0 + alpha1 * np.hypot(x, y) == pytest.approx(wave, abs=0.05)  # angstrom


def test_light_goes_where_the_turned_chip_says(camera, make_pointing):
    """Position angle of the first order on the sky: 90 deg from mosaic +y, less the chip's turn; 0.01 deg."""
    pointing = make_pointing(ra=150.0, dec=0.0, pa=30.0)
    for number, two in camera.gratings.items():
        chip, order = camera.chips[number], two.left.orders[1]
        x, y = 3000.0, (chip.detector.ny - 1) / 2
        p, q, r, s = order.lines(x, y)
        light = np.array(order.range)
        sky = SkyCoord(*ChipWCS(chip, pointing).pixel_to_world(x + p + q * light, y + r + s * light), unit="deg")
        angle = sky[0].position_angle(sky[1]).deg
        slope = np.degrees(np.arctan(s / q))  # of the trace, in the chip's pixels
        assert chip.rotation == (1.0 if chip.xc > 0 else -1.0)
        assert angle == pytest.approx(pointing.pa + 90.0 - chip.rotation - slope, abs=0.01)
