"""Bright stars are fitted and taken out: fluxes, places and what is left, also of saturated ones."""

from types import SimpleNamespace

import galsim
import numpy as np
import pytest
from slitless import below

from csstsim.base.rng import stream
from csstsim.instrument.chip import Window
from csstsim.measure.calibration.bad_pixels import FULL
from csstsim.measure.detection.bright_stars import MODEL_ERROR, WING_STEP, bright_stars
from csstsim.optics.scatter.ghosts import Ghosts
from csstsim.optics.scatter.halo import Wing
from csstsim.optics.scatter.scattered_light import Scattered

SIZE, FULL_WELL = 401, 90_000.0


PARTS = (0.95, 0.9), (3.0, 0.08), (8.0, 0.02)  # px, sigma, and share of the light: a core and wings


class WingedPsf:
    """Stands for optics.psf.psf_file.PsfSet: the same sum of Gaussians everywhere, 5 um cells."""

    oversampling, attributes = 2, {}

    def mixed(self, function):
        return lambda x, y: function(self.at(x, y))

    def at(self, x, y):
        lines = [below(0.5 * np.arange(-128, 129), sigma) for sigma, _ in PARTS]
        parts = (share * np.outer(*2 * [np.diff(line)]) for (_, share), line in zip(PARTS, lines, strict=True))
        return np.repeat(sum(parts)[None], 4, axis=0)


def frame(fabricate, places, flux, seed=50, extra=0.0):
    """Return (electrons, unusable) of stars that saturate at FULL_WELL and bleed ten pixels along their columns."""
    image, edges = np.zeros((SIZE, SIZE)) + extra, np.arange(SIZE + 1) - 0.5
    for (x, y), light in zip(places, flux, strict=True):
        for sigma, share in PARTS:
            image += light * share * np.outer(np.diff(below(edges - y, sigma)), np.diff(below(edges - x, sigma)))
    electrons = fabricate.add_noise(image, seed)
    full = electrons > FULL_WELL
    for row, column in zip(*np.nonzero(full), strict=True):
        full[max(row - 10, 0) : row + 11, column] = True
    electrons[full] = FULL_WELL
    return electrons, FULL * full.astype(np.uint8)


def fitted(fabricate, electrons, unusable, scattered=None):
    window = Window(100, 100 + electrons.shape[1], 50, 50 + electrons.shape[0])
    chip = SimpleNamespace(detector=None)
    return bright_stars(electrons, unusable, WingedPsf(), scattered or Scattered(), chip, window, fabricate.READ_NOISE)


def test_stars_have_their_flux_and_place(fabricate):
    """Two that saturate and two that do not: 1% of the flux, 0.05 px; a faint one is not a candidate."""
    places, flux = (
        [(80.3, 90.6), (300.0, 300.0), (90.2, 310.4), (310.7, 80.1), (200.0, 200.0)],
        [3e6, 8e5, 2e5, 3e4, 2e3],
    )
    electrons, unusable = frame(fabricate, places, flux)
    stars = fitted(fabricate, electrons, unusable)
    order = np.argsort(-stars.flux)
    assert len(stars) == 4 and stars.saturated[order].tolist() == [True, True, False, False]
    assert stars.flux[order] == pytest.approx(flux[:4], rel=0.012)
    for k, row in enumerate(order):
        assert np.hypot(stars.x[row] - places[k][0], stars.y[row] - places[k][1]) < 0.05


def test_little_is_left_where_stars_were(fabricate):
    """Beyond what saturates, at most MODEL_ERROR of the light and 5 sigma of noise; put back, it is as it was."""
    places, flux = [(120.4, 150.7), (280.2, 260.1)], [2e6, 1e5]
    electrons, unusable = frame(fabricate, places, flux)
    before = electrons.copy()
    stars = fitted(fabricate, electrons, unusable)
    stars.subtract_from(electrons)
    light = before - electrons
    usable = unusable == 0
    allowed = MODEL_ERROR * light + 5.0 * np.sqrt(np.maximum(before, fabricate.SKY) + fabricate.READ_NOISE**2)
    assert light[usable].max() > 50_000
    assert (np.abs(electrons - fabricate.SKY) <= allowed)[usable].all()
    rms = np.full(electrons.shape, 8.0, np.float32)
    stars.add_noise_to(rms)
    assert rms == pytest.approx(np.sqrt(64.0 + np.maximum(light, 0) + (MODEL_ERROR * light) ** 2), rel=1e-2, abs=0.05)
    stars.restore_to(electrons)
    assert electrons == pytest.approx(before, rel=1e-4, abs=1e-2)


def test_a_galaxy_is_left_alone(fabricate):
    image = galsim.Convolve(
        galsim.Sersic(n=2.5, half_light_radius=6.0, flux=2e6), galsim.Gaussian(sigma=fabricate.SIGMA)
    ).drawImage(nx=SIZE, ny=SIZE, scale=1.0).array  # fmt: skip
    electrons, unusable = frame(fabricate, [], [], extra=image)
    assert electrons.max() > 10_000
    assert len(fitted(fabricate, electrons, unusable)) == 0


def test_wing_and_ghosts_are_taken_out_where_they_fall(fabricate):
    """Both against their own formulas, 60 px from the star and on the disc's middle."""
    wing = Wing(np.full((4, 1), 0.02), np.array([20.0]), np.array([3.0]), np.full(4, 1e-9))
    ghosts = Ghosts(np.array([4000.0]), np.array([25.0]), np.array([1e-2]), 1e5, np.zeros(2), 0.05)
    electrons, unusable = frame(fabricate, [(200.2, 199.7)], [3e6])
    window = Window(0, SIZE, 0, SIZE)
    chip = SimpleNamespace()
    centres = []
    object.__setattr__(
        ghosts, "centres", lambda chip, x, y: centres.append((x, y)) or np.array([[x + 110.0, y + 20.0]])
    )
    stars = bright_stars(electrons, unusable, WingedPsf(), Scattered(wing, ghosts), chip, window, 5.0)
    image = np.zeros_like(electrons)
    stars.subtract_from(image)
    flux = stars.flux[0]
    place = round(stars.y[0]), round(stars.x[0] - 60)
    radius = np.hypot(place[1] - stars.x[0], place[0] - stars.y[0])
    assert image[place] == pytest.approx(-flux * wing.profile(radius).mean(), rel=1e-3)
    middle = round(stars.y[0] + 20), round(stars.x[0] + 110)
    apart = np.hypot(middle[1] - stars.x[0], middle[0] - stars.y[0])
    disc = flux * 1e-2 / (np.pi * 25.0**2)
    assert image[middle] == pytest.approx(-disc - flux * wing.profile(apart).mean(), abs=0.2)  # FAINTEST
    assert stars.wing[int(50 / WING_STEP)] == pytest.approx(wing.profile(50.0).mean())


@pytest.mark.parametrize("shape", [(1, 1), (5, 5), (64, 64)])
def test_frames_without_stars(fabricate, shape):
    """Empty sky, a frame that is saturated all over, and one of NaN, give none."""
    sky = np.full(shape, fabricate.SKY, np.float32)
    good, full = np.zeros(shape, np.uint8), np.full(shape, FULL)
    for electrons, unusable in ((sky, good), (sky + np.float32(FULL_WELL), full), (sky * np.float32(np.nan), good)):
        stars = fitted(fabricate, electrons, unusable)
        assert len(stars) == 0
        stars.subtract_from(sky)
    assert (sky == np.float32(fabricate.SKY)).all()


def test_a_star_on_the_edge_is_taken_out(fabricate):
    """Half of it is off the frame: 3% of the flux."""
    electrons = frame(fabricate, [(200.0, 40.0)], [2e5])[0][38:]
    stars = fitted(fabricate, electrons, np.zeros(electrons.shape, np.uint8))
    assert len(stars) == 1
    assert (stars.flux[0], stars.y[0]) == (pytest.approx(2e5, rel=0.03), pytest.approx(2.0, abs=0.05))


def test_two_runs_have_the_same_bits(fabricate):
    rng = stream(53, "stars")
    places, flux = rng.uniform(30, SIZE - 30, (40, 2)), 10 ** rng.uniform(4.3, 6.5, 40)
    one, two = (fitted(fabricate, *frame(fabricate, places, flux)) for _ in range(2))
    assert (one.flux == two.flux).all() and len(one) > 20
