"""The chip's WCS with field distortion: its Jacobian, its effect on shapes, its SIP header in other readers."""

import re

import numpy as np
import pytest
from astropy.io import fits
from astropy.wcs import WCS
from build_distortion import fit
from support.canvases import blank
from support.csst import BANDS

from csstsim.base.shipped import SHIPPED
from csstsim.catalog.table import GALAXY, ObjectTable
from csstsim.instrument.chip import Window
from csstsim.optics.geometry.distortion import load_distortion
from csstsim.optics.geometry.focal_plane import FocalPlane, Placement, samples
from csstsim.optics.geometry.sip import sip_header
from csstsim.optics.geometry.wcs import ChipWCS, chip_plane
from csstsim.render.drawing import Drawing
from csstsim.render.imaging.reference import draw_objects

BORESIGHTS = [(60.0, -40.0, -113.4333), (0.001, 30.0, 77.0), (10.0, 90.0, 20.0)]


@pytest.fixture(scope="module")
def field():
    return load_distortion(SHIPPED / "instrument" / "distortion.fits")


def pixels(n=400, seed=7):
    rng = np.random.default_rng(seed)
    return rng.uniform(-0.5, 9215.5, n), rng.uniform(-0.5, 9231.5, n)


@pytest.mark.parametrize("boresight", BORESIGHTS)
@pytest.mark.parametrize("number", [1, 6])
def test_jacobian_against_finite_differences_of_the_whole_map(camera, make_pointing, field, number, boresight):
    """1 arcsec along true east and north, through world_to_pixel: 1e-6 of the scale."""
    ra0, dec0, pa = boresight
    wcs = ChipWCS(camera.chips[number], make_pointing(ra=ra0, dec=dec0, pa=pa), field)
    ra, dec = wcs.pixel_to_world(*pixels(30))
    a, d = np.radians(ra), np.radians(dec)
    r = np.stack([np.cos(d) * np.cos(a), np.cos(d) * np.sin(a), np.sin(d)])
    east = np.stack([-np.sin(a), np.cos(a), np.zeros_like(a)])
    north = np.stack([-np.sin(d) * np.cos(a), -np.sin(d) * np.sin(a), np.cos(d)])
    got, h = wcs.jacobian(ra, dec), np.radians(1 / 3600)
    for column, tangent in enumerate((east, north)):
        ends = []
        for v in (r + h * tangent, r - h * tangent):
            sky = np.degrees([np.arctan2(v[1], v[0]), np.arctan2(v[2], np.hypot(v[0], v[1]))])
            ends.append(np.array(wcs.world_to_pixel(*sky)))
        assert got[:, :, column] == pytest.approx((ends[0] - ends[1]).T / 2, abs=1e-6 / 0.074)


def test_jacobian_takes_the_distortion_where_the_light_is_seen(camera, make_pointing, field):
    """Axes at the catalogue's place, distortion at the apparent one, 26 arcsec off: 1e-4 and more in shape."""
    pointing, chip = make_pointing(), camera.chips[30]
    plain, wcs = ChipWCS(chip, pointing), ChipWCS(chip, pointing, field)
    ra, dec = wcs.pixel_to_world(*pixels(20))
    there = ra, dec + 26 / 3600
    got = wcs.jacobian(ra, dec, seen=there)
    by_hand = field.on(chip).jacobian(*plain.world_to_pixel(*there)) @ plain.jacobian(ra, dec)
    assert got == pytest.approx(by_hand, rel=1e-12)
    assert np.abs(got - wcs.jacobian(ra, dec)).max() * 0.074 > 1e-4


@pytest.mark.parametrize("number", [1, 6, 30])
def test_a_round_source_lengthens_along_the_stretched_axis(camera, make_pointing, field, number):
    """Points spread evenly about a place on the sky, mapped one by one: pincushion draws them out along the radius.

    Equation 7's ellipticity with its signs turned, e1 = (xx - yy)/(xx + yy), to first order; J J^T exactly.
    """
    chip = camera.chips[number]
    wcs = ChipWCS(chip, make_pointing(), field)
    x, y = (4608.0, 4616.0)
    angle, radius = np.arange(720) * np.pi / 360, 1.0  # arcsec
    ideal = np.array(field.on(chip).inverse(x, y))
    ring = ideal[:, None] + radius / 0.074 * np.stack([np.cos(angle), np.sin(angle)])
    seen = np.array(field.on(chip).forward(*ring))
    moments = np.cov(seen)
    e = np.array([moments[0, 0] - moments[1, 1], 2 * moments[0, 1]]) / np.trace(moments)
    (xx, xy), (yx, yy) = field.on(chip).jacobian(*ideal)
    first_order = 2 * np.array([xx - yy, xy + yx]) / (xx + yy)
    assert e == pytest.approx(first_order / (1 + (first_order**2).sum() / 4), abs=2e-5)
    _, origin = chip_plane(chip)
    outward = ideal - origin
    direction = np.arctan2(outward[1], outward[0])
    along = e @ [np.cos(2 * direction), np.sin(2 * direction)]
    assert along > 0.9 * np.hypot(*e) > 0.004  # 0.01 at the corners: a shear of 0.005
    # On the sky the tangent plane itself stretches: the whole Jacobian is the product.
    whole = wcs.jacobian(*wcs.pixel_to_world(x, y))
    linear = ChipWCS(chip, make_pointing()).jacobian(*wcs.pixel_to_world(x, y))
    assert whole == pytest.approx(np.array([[xx, xy], [yx, yy]]) @ linear, rel=1e-9)


def test_a_drawn_galaxy_is_drawn_out(camera, make_pointing, psf_r):
    """A round galaxy under twenty-fold distortion has the moments of J J^T, not of its inverse; its light stays."""
    optics = {"cubic": 4000.0, "quintic": 0.0, "decentring": (0.0, 0.0), "astigmatic": (0.0, 0.0)}
    strong = FocalPlane(38786.3, optics, 5000.0, {9: Placement()})
    chip = camera.chips[9]
    field = fit({9: samples(strong, chip, 12)}, camera.chips)
    window = Window(4000, 4500, 5000, 5500)
    shapes, light = [], []
    for wcs in (ChipWCS(chip, make_pointing()), ChipWCS(chip, make_pointing(), field)):
        ra, dec = (np.atleast_1d(v) for v in wcs.pixel_to_world(4250.0, 5250.0))
        columns = {
            "obj_type": [GALAXY], "ra": ra, "dec": dec, "ra_orig": ra, "dec_orig": dec, "x": [4250.0], "y": [5250.0],
            "size_disk": [1.5], "reach": [240], "lost": [1e-4], "wing": [0.0],
            **{f"flux{i}": [1000.0] for i in range(4)},
        }  # fmt: skip
        columns = {k: np.asarray(v) for k, v in columns.items()}
        table = ObjectTable.complete({"id": np.zeros(1, int)} | columns, BANDS)
        canvas = blank(window)
        light.append(draw_objects(canvas, table, Drawing(wcs, psf_r, 100.0))["drawn"][0])
        image = canvas.expected
        axis = np.arange(500) - 250.0
        x2, y2, xy = (float((image * w).sum(dtype=float)) for w in (axis**2, axis[:, None] ** 2, axis * axis[:, None]))
        shapes.append(np.array([x2 - y2, 2 * xy]) / (x2 + y2))
        jacobian = wcs.jacobian(ra, dec)[0]
    q = jacobian @ jacobian.T
    expected = np.array([q[0, 0] - q[1, 1], 2 * q[0, 1]]) / np.trace(q)
    assert np.hypot(*expected) > 0.03 and np.abs(shapes[0]).max() < 2e-3
    assert shapes[1] == pytest.approx(expected, abs=0.05 * np.hypot(*expected))  # the PSF and the cut-off round it
    assert light[1] == pytest.approx(light[0], rel=1e-3)


@pytest.mark.parametrize("boresight", BORESIGHTS)
@pytest.mark.parametrize("number", [1, 9, 30])
def test_sip_header_in_astropy(camera, make_pointing, field, number, boresight):
    """Both ways within 1e-3 px over the chip (the goal is 0.01), edges included; corner chips, pole and RA wrap."""
    ra, dec, pa = boresight
    wcs = ChipWCS(camera.chips[number], make_pointing(ra=ra, dec=dec, pa=pa), field)
    theirs = WCS(fits.Header(sip_header(wcs)))
    x, y = (np.append(v, edge) for v, edge in zip(pixels(), ([-0.5, 9215.5], [-0.5, 9231.5]), strict=True))
    sky = wcs.pixel_to_world(x, y)
    assert np.hypot(*np.subtract(theirs.all_world2pix(*sky, 0, tolerance=1e-6), (x, y))).max() < 1e-3
    assert np.hypot(*np.subtract(wcs.world_to_pixel(*theirs.all_pix2world(x, y, 0)), (x, y))).max() < 1e-3
    # AP, BP: the way back without iteration
    focal = theirs.wcs_world2pix(*sky, 1) - theirs.wcs.crpix[:, None]
    back = np.array(theirs.sip_foc2pix(*focal, 1))  # astropy adds CRPIX
    assert np.hypot(*(back - (x + 1, y + 1))).max() < 1e-3


@pytest.mark.parametrize("number", [1, 9, 30])
def test_sip_header_in_galsim(camera, make_pointing, field, number):
    import galsim

    wcs = ChipWCS(camera.chips[number], make_pointing(), field)
    header = {k: v for k, v in sip_header(wcs).items() if not k.startswith(("CUNIT", "WCSAXES"))}
    theirs = galsim.GSFitsWCS(header=galsim.FitsHeader(header))
    x, y = pixels()
    px, py = theirs.radecToxy(*wcs.pixel_to_world(x, y), units="degrees")
    assert np.hypot(px - 1 - x, py - 1 - y).max() < 1e-3
    back = theirs.xyToradec(x + 1, y + 1, units="degrees")
    assert np.hypot(*np.subtract(wcs.world_to_pixel(*back), (x, y))).max() < 1e-3


def test_sip_of_low_order_is_worse(camera, make_pointing, field):
    """What the polynomials are for: the linear header is 200 px off in a corner, order 2 over 0.1 px."""
    wcs = ChipWCS(camera.chips[30], make_pointing(), field)
    x, y = pixels()
    sky = wcs.pixel_to_world(x, y)
    off = [
        np.hypot(*np.subtract(WCS(fits.Header(h)).all_world2pix(*sky, 0, tolerance=1e-6), (x, y))).max()
        for h in (wcs.header(), sip_header(wcs, 2), sip_header(wcs, 3), sip_header(wcs, 4))
    ]
    assert off[0] > 150 and off[1] > 0.1 and off[2] < 0.01 and off[3] < 1e-3


@pytest.mark.parametrize("order", [2, 5])
def test_a_sip_header_says_how_many_terms_it_has(camera, make_pointing, field, order):
    """Readers take no terms above A_ORDER: there are none, and some of that degree."""
    header = sip_header(ChipWCS(camera.chips[9], make_pointing(), field), order)
    for name in ("A", "B", "AP", "BP"):
        degrees = [sum(map(int, key.split("_")[1:])) for key in header if re.fullmatch(rf"{name}_\d_\d", key)]
        assert header[f"{name}_ORDER"] == max(degrees) == order and min(degrees) == 2
