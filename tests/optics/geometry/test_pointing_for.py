"""Pointing at a position: hits the pixel to 1e-6 px wherever a boresight exists, also at poles and RA 0."""

import math

import pytest

from csstsim.base.errors import InputError
from csstsim.catalog.astrometry.ephemeris import observer
from csstsim.catalog.astrometry.reduction import apparent
from csstsim.optics.geometry.distortion import load_distortion
from csstsim.optics.geometry.pointing_for import aim_point, centred_exposure, pointing_for
from csstsim.optics.geometry.wcs import ChipWCS, gnomonic

PIXEL = 4500.0, 4700.0
CLOSE = 1e-6  # px


@pytest.mark.parametrize("target", [(60.0, -40.0), (0.0, 0.0), (359.99999, 5.0), (10.0, 89.0), (200.0, -89.0)])
@pytest.mark.parametrize("chip", [1, 6, 9, 30])
@pytest.mark.parametrize("pa", [-113.4333, 0.0, 90.0])
def test_the_place_is_on_the_pixel(camera, make_pointing, target, chip, pa):
    chip = camera.chips[chip]
    for distortion in (None, load_distortion(camera.folder / "distortion.fits")):
        found = pointing_for(make_pointing(pa=pa), chip, target, PIXEL, distortion)
        x, y = ChipWCS(chip, found, distortion).world_to_pixel(*target)
        assert math.hypot(x - PIXEL[0], y - PIXEL[1]) < CLOSE
        assert 0 <= found.ra < 360 and found.pa == pa


def test_beside_a_pole_a_position_angle_may_have_no_boresight(camera, make_pointing):
    """Seen from the target at the pole every direction is south: only a chip right above or below has a boresight."""
    for pole in (90.0, -90.0):
        with pytest.raises(ValueError, match="no boresight at position angle") as refused:
            pointing_for(make_pointing(), camera.chips[9], (0.0, pole), PIXEL)
        angle = float(str(refused.value).partition(": take ")[2])
        found = pointing_for(make_pointing(pa=angle), camera.chips[9], (0.0, pole), PIXEL)
        x, y = ChipWCS(camera.chips[9], found).world_to_pixel(0.0, pole)
        assert math.hypot(x - PIXEL[0], y - PIXEL[1]) < 0.1  # px: the angle has four digits
    at = camera.chips[9]
    mosaic = math.degrees(math.atan2(*_offset(at, make_pointing)))  # from boresight to pixel, at position angle 0
    found = pointing_for(make_pointing(pa=-mosaic), at, (0.0, 90.0), PIXEL)
    x, y = ChipWCS(at, found).world_to_pixel(0.0, 90.0)
    assert math.hypot(x - PIXEL[0], y - PIXEL[1]) < 1e-4  # px; at this one angle the triangle is degenerate


def _offset(chip, make_pointing):
    ra, dec = ChipWCS(chip, make_pointing(ra=0.0, dec=0.0, pa=0.0)).pixel_to_world(*PIXEL)
    ra = (float(ra) + 180.0) % 360.0 - 180.0
    return math.tan(math.radians(ra)), math.tan(math.radians(float(dec))) / math.cos(math.radians(ra))


def test_an_exposure_reckons_with_aberration_and_distortion(camera):
    found = centred_exposure(camera, camera.chips[9], 150.0, 2.2, pa=10.0, time="2027-11-20T01:20:00", exptime=150.0)
    distortion = load_distortion(camera.folder / "distortion.fits")
    seen = apparent(150.0, 2.2, observer(found.mjd, found.sat_position, found.sat_velocity))
    x, y = ChipWCS(camera.chips[9], found, distortion).world_to_pixel(*seen)
    assert math.hypot(x - 4607.5, y - 4615.5) < CLOSE


def test_an_exposure_reckons_with_the_planets_that_bend_light(camera):
    """A degree off Jupiter, which bends light by 0.1 mas: the target is in the middle with planets alone."""
    how = {"pa": 10.0, "time": "2027-11-20T01:20:00", "exptime": 150.0, "distorted": False}
    found = centred_exposure(camera, camera.chips[9], 174.0, 4.8, planets=True, **how)
    for planets, near in ((True, 0.0), (False, 1e-4)):
        craft = observer(found.mjd, found.sat_position, found.sat_velocity, planets=planets)
        x, y = ChipWCS(camera.chips[9], found).world_to_pixel(*apparent(174.0, 4.8, craft))
        off = math.hypot(x - 4607.5, y - 4615.5)
        assert near <= off < CLOSE + 100 * near


@pytest.mark.parametrize(
    "wrong",
    [{"ra": 361.0}, {"dec": -91.0}, {"dec": math.nan}, {"exptime": 0.0}, {"time": "2027-13-01"}, {"pa": math.inf}],
)
def test_bad_values_are_refused(camera, wrong):
    values = {"ra": 1.0, "dec": 1.0, "pa": 0.0, "time": "2027-11-20T01:20:00", "exptime": 1.0}
    with pytest.raises(InputError):
        centred_exposure(camera, camera.chips[9], **(values | wrong))


@pytest.mark.parametrize("dec", [89.5, 89.6, 89.7])
def test_of_two_boresights_near_a_pole_the_nearer_one_is_taken(camera, make_pointing, dec):
    """Both put the position on the pixel; their declinations lie alike about a middle one."""
    chip, both = camera.chips[6], 0
    for pa in range(0, 360, 20):
        try:
            found = pointing_for(make_pointing(pa=float(pa)), chip, (10.0, dec), PIXEL)
        except ValueError:
            continue  # none at this angle
        level = ChipWCS(chip, make_pointing(ra=0.0, dec=0.0, pa=float(pa)))
        xi, eta = gnomonic((0.0, 0.0), *level.pixel_to_world(*PIXEL))
        distance, phi = math.atan(math.hypot(xi, eta)), math.atan2(xi, eta)
        middle = math.degrees(math.atan2(math.cos(distance), math.sin(distance) * math.cos(phi)))
        other = 2 * middle - found.dec
        if abs(other) <= 90:
            both += 1
            assert abs(found.dec - dec) <= abs(other - dec) + 1e-9
    assert both >= 1


def test_light_falls_in_the_middle_of_a_chip_or_of_its_wider_grating(camera):
    """Imaging: the middle. Chip 1 splits at 3685, chip 29 at 5531: light of orders 0 and 1 about the wider part."""
    assert aim_point(camera, camera.chips[9]) == ((4607.5, 4615.5), (4607.5, 4615.5))
    for number, wanted in ((1, (3684.5 + 9215.5) / 2), (29, (5530.5 - 0.5) / 2)):
        target, middle = aim_point(camera, camera.chips[number])
        assert middle == (pytest.approx(wanted), 4615.5)
        grating = camera.gratings[number].right if number == 1 else camera.gratings[number].left
        ends = []
        for order in (grating.orders[0], grating.orders[1]):
            p, q, r, s = order.lines(*middle)
            ends += [(p + q * wave, r + s * wave) for wave in order.range]
        for axis in (0, 1):
            moved = [end[axis] for end in ends] + [0.0]
            assert target[axis] + (min(moved) + max(moved)) / 2 == pytest.approx(middle[axis], abs=1e-9)
        assert abs(target[0] - middle[0]) > 100


def test_a_target_may_lie_off_the_middle_and_without_distortion(camera):
    """Shifted by 300 px along x and -200 px along y; the linear projection has it there exactly."""
    chip, how = camera.chips[6], {"pa": 10.0, "time": "2027-11-20T01:20:00", "exptime": 150.0}
    found = centred_exposure(camera, chip, 150.0, 2.2, shift=(300.0, -200.0), distorted=False, **how)
    seen = apparent(150.0, 2.2, observer(found.mjd, found.sat_position, found.sat_velocity))
    x, y = ChipWCS(chip, found).world_to_pixel(*seen)
    assert (float(x), float(y)) == pytest.approx((4907.5, 4415.5), abs=CLOSE)
    assert (found.type, found.pa, found.time, found.exptime) == ("SCIE", 10.0, "2027-11-20T01:20:00", 150.0)
    assert found.sat_position == camera.orbit.state(found.time)[0] and 0 <= found.ra < 360


@pytest.mark.parametrize(
    "edge", [{"ra": 0.0, "pa": -360.0}, {"ra": 360.0, "pa": 360.0}, {"exptime": 1e5}, {"time": "2099-12-31T00:00:00"}]
)
def test_values_at_the_edge_of_their_range_are_taken(camera, edge):
    values = {"ra": 1.0, "dec": 1.0, "pa": 0.0, "time": "2027-11-20T01:20:00", "exptime": 1.0}
    centred_exposure(camera, camera.chips[9], distorted=False, **(values | edge))
    for wrong in ({"ra": -0.1}, {"pa": 361.0}, {"pa": -361.0}, {"exptime": 1.1e5}, {"time": "2101-01-01T00:00:00"}):
        with pytest.raises(InputError):
            centred_exposure(camera, camera.chips[9], distorted=False, **(values | wrong))
