"""The chip's WCS against published headers, astropy and GalSim; tolerance 1e-6 arcsec unless stated."""

from dataclasses import replace

import numpy as np
import pytest

from csstsim.instrument.chip import Window
from csstsim.instrument.pointing import Pointing
from csstsim.optics.geometry.wcs import ChipWCS, mosaic_cd, nominal_crpix

TOLERANCE = 1e-6  # arcsec
BORESIGHTS = [
    (30.0, -48.0, -113.4333),
    (0.05, 12.0, 0.0),  # RA wrap
    (359.9, 60.0, 45.0),
    (200.0, 90.0, 133.0),  # poles
    (0.0, 90.0, -113.4333),
    (123.0, -90.0, -20.0),
    (77.0, 89.7, 300.0),
    (180.0, 0.0, 180.0),
]


def _pointing(ra, dec, pa):
    return Pointing("SCIE", ra, dec, pa, "2027-01-01T00:00:00", 150.0, (7e3, 0, 0), (0, 7.6, 0))


def _astropy(wcs):
    from astropy.wcs import WCS

    reference = WCS(naxis=2)
    h = wcs.header()
    reference.wcs.ctype = [h["CTYPE1"], h["CTYPE2"]]
    reference.wcs.cunit = [h["CUNIT1"], h["CUNIT2"]]
    reference.wcs.crval = [h["CRVAL1"], h["CRVAL2"]]
    reference.wcs.crpix = [h["CRPIX1"], h["CRPIX2"]]
    reference.wcs.cd = [[h["CD1_1"], h["CD1_2"]], [h["CD2_1"], h["CD2_2"]]]
    reference.wcs.lonpole = h["LONPOLE"]
    reference.wcs.set()
    return reference


def _separation(ra1, dec1, ra2, dec2):
    """arcsec between two directions, by the chord: no loss at small angles or at the poles."""

    def unit(ra, dec):
        a, d = np.radians(ra), np.radians(dec)
        return np.stack([np.cos(d) * np.cos(a), np.cos(d) * np.sin(a), np.sin(d)])

    return np.degrees(np.linalg.norm(unit(ra1, dec1) - unit(ra2, dec2), axis=0)) * 3600


def _pixels(seed, n=300):
    rng = np.random.default_rng(seed)
    return rng.uniform(-2000, 11000, n), rng.uniform(-2000, 11000, n)


def test_published_headers(camera):
    """CD of pa -113.4333 and CRPIX of chips 30 and 12 as in published Level-1 headers, to their last digit."""
    cd = mosaic_cd(-113.4333, camera.telescope)
    published = [[-8.1745583617600e-06, -1.8860208370739e-05], [1.8860208370739e-05, -8.1745583617600e-06]]
    assert cd == pytest.approx(np.array(published), rel=1e-13)
    assert np.linalg.det(cd) > 0
    assert nominal_crpix(camera.chips[30]).tolist() == [29758, -15644]
    assert nominal_crpix(camera.chips[12]).tolist() == [-267, 14746]
    h = ChipWCS(camera.chips[12], _pointing(90.0, 24.5, -113.4333)).header()
    assert (h["CRVAL1"], h["CRVAL2"], h["CRPIX1"], h["CRPIX2"]) == (90.0, 24.5, -267.0, 14746.0)


@pytest.mark.parametrize("boresight", BORESIGHTS)
@pytest.mark.parametrize("chip", [8, 12, 30])
def test_against_astropy(camera, chip, boresight):
    """Both directions, imaging and turned chips, poles and RA wrap."""
    wcs = ChipWCS(camera.chips[chip], _pointing(*boresight))
    reference = _astropy(wcs)
    x, y = _pixels(chip)
    ra, dec = wcs.pixel_to_world(x, y)
    assert (ra >= 0).all() and (ra < 360).all() and (abs(dec) <= 90).all()
    theirs = reference.wcs_pix2world(np.stack([x, y], 1), 0).T
    assert _separation(ra, dec, *theirs).max() < TOLERANCE
    back = np.hypot(*(np.array(wcs.world_to_pixel(ra, dec)) - [x, y]))
    assert back.max() * 0.074 < TOLERANCE
    pixels = reference.wcs_world2pix(np.stack([ra, dec], 1), 0).T
    assert np.hypot(*(np.array(wcs.world_to_pixel(ra, dec)) - pixels)).max() * 0.074 < TOLERANCE


@pytest.mark.parametrize("boresight", [BORESIGHTS[0], BORESIGHTS[1], BORESIGHTS[6]])
def test_against_galsim(camera, boresight):
    """GalSim's own reading of the header (1-based pixels)."""
    import galsim

    wcs = ChipWCS(camera.chips[30], _pointing(*boresight))
    header = galsim.FitsHeader({k: v for k, v in wcs.header().items() if not k.startswith(("CUNIT", "WCSAXES"))})
    reference = galsim.GSFitsWCS(header=header)
    x, y = _pixels(5, 40)
    ra, dec = wcs.pixel_to_world(x, y)
    for i in range(len(x)):
        sky = reference.toWorld(galsim.PositionD(x[i] + 1, y[i] + 1))
        theirs = sky.ra / galsim.degrees, sky.dec / galsim.degrees
        assert _separation(ra[i], dec[i], *theirs) < TOLERANCE


@pytest.mark.parametrize("boresight", BORESIGHTS)
def test_jacobian_against_finite_differences(camera, boresight):
    """Central differences of 1 arcsec along true east and north through astropy; 1e-6 of the scale."""
    wcs = ChipWCS(camera.chips[3], _pointing(*boresight))
    reference = _astropy(wcs)
    x, y = _pixels(7, 20)
    ra, dec = wcs.pixel_to_world(x, y)
    got = wcs.jacobian(ra, dec)
    a, d = np.radians(ra), np.radians(dec)
    r = np.stack([np.cos(d) * np.cos(a), np.cos(d) * np.sin(a), np.sin(d)])
    east = np.stack([-np.sin(a), np.cos(a), np.zeros_like(a)])
    north = np.stack([-np.sin(d) * np.cos(a), -np.sin(d) * np.sin(a), np.cos(d)])
    h = np.radians(1 / 3600)
    for column, tangent in enumerate((east, north)):
        ends = []
        for sign in (1, -1):
            v = r + sign * h * tangent
            sky = np.degrees([np.arctan2(v[1], v[0]), np.arctan2(v[2], np.hypot(v[0], v[1]))])
            ends.append(reference.wcs_world2pix(sky.T, 0))
        slope = (ends[0] - ends[1]) / 2
        assert got[:, :, column] == pytest.approx(slope, abs=1e-6 / 0.074)


def test_jacobian_shapes_and_scale(camera):
    """A scalar gives (2, 2), none gives (0, 2, 2); at the boresight it is the inverse of CD."""
    wcs = ChipWCS(camera.chips[8], _pointing(30.0, -48.0, -113.4333))
    one = wcs.jacobian(30.0, -48.0)
    assert one.shape == (2, 2) and wcs.jacobian(np.array([]), np.array([])).shape == (0, 2, 2)
    assert one @ wcs.cd * 3600 == pytest.approx(np.eye(2), abs=1e-12)
    assert np.linalg.det(one) == pytest.approx(1 / 0.074**2, rel=1e-12)  # positive parity


def test_position_angle_and_parity(camera):
    """+y points at position angle pa, north through east; +x a quarter turn further towards east (determinant > 0)."""
    from astropy.coordinates import SkyCoord

    for pa in (0.0, 45.0, 133.0, -113.4333):
        wcs = ChipWCS(camera.chips[13], _pointing(150.0, 40.0, pa))
        x0, y0 = wcs.crpix - 1
        here = SkyCoord(*wcs.pixel_to_world(x0, y0), unit="deg")
        up = SkyCoord(*wcs.pixel_to_world(x0, y0 + 100), unit="deg")
        right = SkyCoord(*wcs.pixel_to_world(x0 + 100, y0), unit="deg")
        assert here.position_angle(up).deg == pytest.approx(pa % 360, abs=1e-3)
        assert here.position_angle(right).deg == pytest.approx((pa + 90) % 360, abs=1e-3)
        assert here.separation(up).arcsec == pytest.approx(7.4, abs=1e-6)


def test_parity_switch_mirrors_mosaic_y(camera):
    """With parity -1 the sky at mosaic (x, y) is the sky that was at (x, -y), chip by chip."""
    chip = camera.chips[8]  # yc = 0: its own mirror image
    flipped = replace(chip, telescope=replace(chip.telescope, parity=-1))
    plain, mirror = (ChipWCS(c, _pointing(10.0, 20.0, 30.0)) for c in (chip, flipped))
    assert np.linalg.det(mirror.cd) < 0 < np.linalg.det(plain.cd)
    y0 = plain.crpix[1] - 1
    x, dy = np.array([0.0, 5000.0]), np.array([300.0, -4000.0])
    assert _separation(*mirror.pixel_to_world(x, y0 + dy), *plain.pixel_to_world(x, y0 - dy)).max() < TOLERANCE


def test_two_position_angles_against_an_independent_projection(camera):
    """A star field in two exposures a roll of 71 deg apart, on a turned and a straight chip.

    Written from the published rule in astropy's terms: offsets from SkyOffsetFrame, gnomonic by hand, chip pixel =
    R(-rotation)(mosaic - centre) + centre. A wrong sign of pa, parity or rotation is off by hundreds of pixels.
    """
    from astropy.coordinates import SkyCoord

    for pa in (-113.4333, -42.0):
        for number in (26, 9):
            chip = camera.chips[number]
            wcs = ChipWCS(chip, _pointing(180.0, 60.0, pa))
            ra, dec = wcs.pixel_to_world(*_pixels(number, 100))
            centre = SkyCoord(180.0, 60.0, unit="deg")
            v = SkyCoord(ra, dec, unit="deg").transform_to(centre.skyoffset_frame()).cartesian
            xi, eta = (np.degrees((part / v.x).value) * 3600 / 0.074 for part in (v.y, v.z))  # px
            c, s = np.cos(np.radians(pa)), np.sin(np.radians(pa))
            mosaic = np.stack([c * xi - s * eta, s * xi + c * eta])  # along +x (pa + 90) and +y (pa)
            # Mosaic position of the chip's geometric centre: half a pixel beyond (xc, yc).
            from_centre = mosaic - np.array([[chip.xc + 0.5], [chip.yc + 0.5]])
            t = np.radians(chip.rotation)
            own = np.array([[np.cos(t), np.sin(t)], [-np.sin(t), np.cos(t)]]) @ from_centre
            expected = own + np.array([[4607.5], [4615.5]])
            got = np.array(wcs.world_to_pixel(ra, dec))
            assert np.hypot(*(got - expected)).max() * 0.074 < TOLERANCE


@pytest.mark.parametrize("number", [1, 5, 10, 21, 30])
def test_turn_leaves_the_chip_centre_where_it_was(camera, number):
    chip = camera.chips[number]
    turned, straight = (ChipWCS(c, _pointing(30.0, -48.0, 10.0)) for c in (chip, replace(chip, rotation=0.0)))
    assert turned.nominal_crpix.tolist() == straight.crpix.tolist()
    centre = (4607.5, 4615.5)
    assert _separation(*turned.pixel_to_world(*centre), *straight.pixel_to_world(*centre)) < TOLERANCE
    # A pixel 4000 to the right moves by 4000 px x 1 deg.
    aside = (8607.5, 4615.5)
    moved = _separation(*turned.pixel_to_world(*aside), *straight.pixel_to_world(*aside))
    assert moved == pytest.approx(4000 * 0.074 * 2 * np.sin(np.radians(0.5)), rel=1e-3)


def test_behind_the_tangent_plane_is_nan(camera):
    wcs = ChipWCS(camera.chips[8], _pointing(30.0, -48.0, 0.0))
    x, y = wcs.world_to_pixel(np.array([30.0, 210.0, 30.0, np.nan]), np.array([-48.0, 48.0, 43.0, 0.0]))
    assert np.isnan(x).tolist() == np.isnan(y).tolist() == [False, True, True, True]
    assert len(wcs.world_to_pixel(np.array([]), np.array([]))[0]) == 0


def test_footprint(camera):
    """Corners are the outer pixel edges; one chip is 681.98 x 683.17 arcsec; a margin widens every side."""
    wcs = ChipWCS(camera.chips[8], _pointing(30.0, 80.0, 45.0))
    ra, dec = wcs.footprint()
    assert (
        pytest.approx(np.array([[-0.5, -0.5], [9215.5, -0.5], [9215.5, 9231.5], [-0.5, 9231.5]]), abs=1e-5)
        == np.array(wcs.world_to_pixel(ra, dec)).T
    )
    assert _separation(ra[0], dec[0], ra[1], dec[1]) == pytest.approx(681.98, abs=0.1)
    assert _separation(ra[0], dec[0], ra[3], dec[3]) == pytest.approx(683.17, abs=0.1)
    ra, dec = wcs.footprint(Window(100, 200, 300, 400), margin_px=10)
    corners = np.array([[89.5, 289.5], [209.5, 289.5], [209.5, 409.5], [89.5, 409.5]])
    assert pytest.approx(corners, abs=1e-5) == np.array(wcs.world_to_pixel(ra, dec)).T
