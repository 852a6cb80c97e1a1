"""Stars that are not drawn: the list, the mean of the fainter ones, and what lies next to a frame."""

from dataclasses import replace

import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from support.sky_geometry import camera, numbers

from csstsim.base.errors import InputError
from csstsim.base.sphere import unit_vectors
from csstsim.catalog.astrometry.ephemeris import observer
from csstsim.catalog.astrometry.reduction import icrs
from csstsim.catalog.selection.reach import REACH_MAX
from csstsim.instrument.chip import Window
from csstsim.instrument.pointing import Pointing
from csstsim.optics.geometry.wcs import ChipWCS
from csstsim.optics.scatter.halo import make_wing
from csstsim.optics.sky.directions import telescope_axes
from csstsim.optics.sky.near_stars import NEAR_PX, pixels_off, stars_about
from csstsim.optics.sky.parameters import sky_numbers
from csstsim.optics.sky.starlight import faint_starlight
from csstsim.optics.sky.transmittance import transmittance
from csstsim.simulation.exposure import Exposure

N, CAMERA = numbers(), camera()
FIELD = 31.0, -48.0
ZENITH = 6778.137 * unit_vectors(*FIELD)


def exposure(chip=9, window=None, pa=-113.4333):
    pointing = Pointing("SCIE", *FIELD, pa, "2027-10-10T01:08:00", 150.0, tuple(ZENITH), (5.0, 3.0, -4.0))
    chip = CAMERA.chips[chip]
    return Exposure(pointing, chip, window or chip.full_window, ChipWCS(chip, pointing), CAMERA)


def test_the_list():
    """The catalogue's stars V < 5: how many there are, none twice, and those that everybody knows."""
    assert len(N.stars) == 1604 and N.stars[:, 2].max() < 5.0
    assert (np.diff(N.stars[:, 2]) >= 0).all() and (N.stars[:, 3] > 2000).all()
    there = SkyCoord(N.stars[:, 0], N.stars[:, 1], unit="deg")
    for ra, dec, v in (
        (101.287, -16.716, -1.46),
        (37.955, 89.264, 2.02),
        (186.650, -63.099, 1.33),
        (88.793, 7.407, 0.5),
    ):
        near = there.separation(SkyCoord(ra, dec, unit="deg")).deg < 0.01  # Sirius, Polaris, Acrux, Betelgeuse
        assert N.stars[near, 2].min() == pytest.approx(v, abs=0.1)


def test_stars_are_a_text_or_a_list():
    """The same numbers either way; a fault names the key."""
    given = CAMERA.sky
    text = sky_numbers(given | {"stars": "10.5 -20 4.0 6000, 11 -21 3.5 9000"})
    rows = sky_numbers(given | {"stars": [[10.5, -20, 4.0, 6000], [11, -21, 3.5, 9000]]})
    assert (text.stars == rows.stars).all() and text.stars.shape == (2, 4)
    for wrong in ("10.5 -20 4.0", "10.5 -20 4.0 6000, 11", "10.5 -20 bright 6000", ""):
        with pytest.raises(InputError, match="stars"):
            sky_numbers(given | {"stars": wrong})
    with pytest.raises(InputError, match="starlight"):
        sky_numbers({name: part for name, part in given.items() if name != "starlight"})


@pytest.mark.parametrize("name", ["NUV", "r", "y"])
def test_transmittance_continues_the_drawn_wings(name):
    """From the end of drawn wings (2048 px) to 0.1 deg it is the halo with its diffraction wing, within 15%."""
    wing = make_wing(CAMERA.scatter, CAMERA.filters[name].psf_wavelength, CAMERA.telescope)
    scale = CAMERA.telescope.pixel_scale / 3600
    assert N.transmittance.zenith[0] == pytest.approx(REACH_MAX * scale, rel=1e-3)
    for pixels in (REACH_MAX, 3000.0, 4800.0):
        expected = CAMERA.telescope.area_m2 / (CAMERA.detector.pixel_um * 1e-6) ** 2 * wing.profile(pixels).mean()
        mean = np.mean(transmittance(np.full(4, pixels * scale), np.array([0.0, 90.0, 180.0, 270.0]), N))
        assert mean == pytest.approx(expected, rel=0.15), pixels


def dark(numbers):
    """Numbers with a door that neither shades nor scatters, and a transmittance that is equal in all azimuths."""
    table = numbers.transmittance
    even = replace(table, matrix=np.repeat(table.matrix[:, :1], len(table.azimuth), axis=1))
    return replace(numbers, transmittance=even, door=replace(numbers.door, albedo=0.0, half_width_deg=1e-6))


def test_uniform_starlight_is_an_integral_over_the_sky():
    """Equal brightness everywhere, no Earth in the way: the transmittance integrated over 0.0421 to 90 deg; 1%."""
    even = dark(N)
    even = replace(even, starlight=replace(N.starlight, brightness=np.full_like(N.starlight.brightness, 50.0)))
    slant = np.geomspace(N.transmittance.zenith[0], 90.0, 20_001)
    value = transmittance(slant, np.zeros_like(slant), even) * 2 * np.pi * np.sin(np.radians(slant)) * np.degrees(1)
    expected = 50.0 * np.trapezoid(value, slant)
    far = ZENITH * 1e6  # the Earth is a point
    found = faint_starlight(telescope_axes(*FIELD, 20.0), far, 0.0, even)
    assert found == pytest.approx(expected, rel=0.01)
    assert faint_starlight(telescope_axes(*FIELD, 20.0), ZENITH, 0.0, even) == pytest.approx(expected, rel=0.01)
    half = faint_starlight(telescope_axes(*FIELD, 20.0), np.cross(unit_vectors(*FIELD), [0, 0, 1.0]) * 6379, 0.0, even)
    assert half == pytest.approx(0.5 * found, rel=0.06)  # on the ground, looking along the horizon


def test_starlight_follows_the_galactic_latitude():
    even = dark(N)
    for latitude, brightness in ((90.0, 18.0), (45.0, 33.0), (0.0, 340.0)):
        at = SkyCoord(l=130.0, b=latitude, unit="deg", frame="galactic").icrs
        axes = telescope_axes(at.ra.deg, at.dec.deg, 0.0)
        found = faint_starlight(axes, 6778e6 * axes[2], 0.0, even)
        level = replace(N.starlight, brightness=np.full_like(N.starlight.brightness, brightness))
        assert found == pytest.approx(
            faint_starlight(axes, 6778e6 * axes[2], 0.0, replace(even, starlight=level)), rel=0.1
        )


@pytest.mark.parametrize("chip", [9, 1])
def test_stars_beside_a_frame(chip):
    """Where a star lies decides whether it is drawn, next to the frame or far; a grating draws from further off."""
    one = exposure(chip)
    drawn = REACH_MAX + (one.gratings.reach if one.gratings is not None else 0.0)
    x = np.array([4000.0, -drawn + 600.0, -drawn - 600.0, 9216 + drawn + 600.0, -NEAR_PX + 600.0, -NEAR_PX - 600.0])
    ra, dec = one.wcs.pixel_to_world(x, np.full(x.shape, 4000.0))
    off = pixels_off(unit_vectors(ra, dec), one)
    # Apparent places differ from those of a catalogue by up to 21 arcsec, 290 px
    assert off == pytest.approx([0.0, drawn - 600, drawn + 600, drawn + 601, NEAR_PX - 600, NEAR_PX + 600], abs=300)
    stars = np.column_stack([ra, dec, np.full(len(x), 3.0), np.full(len(x), 6000.0)])
    away, beside = stars_about(one, replace(N, stars=stars))
    assert beside.tolist() == [False, False, True, True, True, False]
    assert away.tolist() == [False, False, False, False, False, True]
    behind = -unit_vectors(*FIELD)[None]
    assert pixels_off(behind, one) == [np.inf]


def test_the_distance_from_a_window_is_the_larger_of_both_axes():
    """A window of a chip, stars left, right, below, above and at corners; of apparent places, as nothing moves them."""
    one = exposure(window=Window(1000, 3000, 2000, 2500))
    x = np.array([400.0, 3500.0, 1500.0, 2900.0, 900.0, 4000.0])
    y = np.array([2200.0, 2300.0, 1200.0, 3100.0, 1300.0, 2700.0])
    seen_from = observer(one.pointing.mjd, one.pointing.sat_position, one.pointing.sat_velocity)
    directions = unit_vectors(*icrs(*one.wcs.pixel_to_world(x, y), seen_from))
    assert pixels_off(directions, one) == pytest.approx([600, 501, 800, 601, 700, 1001], abs=0.01)
