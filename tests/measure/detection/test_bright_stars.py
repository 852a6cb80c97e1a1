"""Bright stars are fitted and subtracted: fluxes, positions and what is left, also of saturated ones."""

import math
from functools import partial
from types import SimpleNamespace

import galsim
import numpy as np
import pytest
from measure.slitless import below

from csstsim.base.rng import stream
from csstsim.instrument.chip import Window
from csstsim.measure.calibration.bad_pixels import BAD, FULL
from csstsim.measure.detection import bright_stars as module
from csstsim.measure.detection.bright_stars import MODEL_ERROR, WING_STEP, BrightStars, bright_stars
from csstsim.measure.detection.maps import BIN, binned
from csstsim.measure.light import photometry
from csstsim.optics.scatter.ghosts import Ghosts
from csstsim.optics.scatter.halo import Wing
from csstsim.optics.scatter.scattered_light import Scattered

SIZE, FULL_WELL = 401, 90_000.0


PARTS = (0.95, 0.9), (3.0, 0.08), (8.0, 0.02)  # px, sigma, and fraction of the light: a core and wings


class WingedPsf:
    """Stands for optics.psf.psf_file.PsfSet: the same sum of Gaussians everywhere, 5 um cells."""

    oversampling, attributes = 2, {}

    def mixed(self, function):
        return lambda x, y: function(self.at(x, y))

    def at(self, x, y):
        lines = [below(0.5 * np.arange(-128, 129), sigma) for sigma, _ in PARTS]
        parts = (fraction * np.outer(*2 * [np.diff(line)]) for (_, fraction), line in zip(PARTS, lines, strict=True))
        return np.repeat(sum(parts)[None], 4, axis=0)


def frame(fabricate, positions, flux, seed=50, extra=0.0):
    """Return (electrons, unusable) of stars that saturate at FULL_WELL and bleed ten pixels along their columns."""
    image, edges = np.zeros((SIZE, SIZE)) + extra, np.arange(SIZE + 1) - 0.5
    for (x, y), light in zip(positions, flux, strict=True):
        for sigma, fraction in PARTS:
            image += light * fraction * np.outer(np.diff(below(edges - y, sigma)), np.diff(below(edges - x, sigma)))
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


def test_stars_have_their_flux_and_position(fabricate):
    """Two that saturate and two that do not: 1% of the flux, 0.05 px; a faint one is not a candidate."""
    positions, flux = (
        [(80.3, 90.6), (300.0, 300.0), (90.2, 310.4), (310.7, 80.1), (200.0, 200.0)],
        [3e6, 8e5, 2e5, 3e4, 2e3],
    )
    electrons, unusable = frame(fabricate, positions, flux)
    stars = fitted(fabricate, electrons, unusable)
    order = np.argsort(-stars.flux)
    assert len(stars) == 4 and stars.saturated[order].tolist() == [True, True, False, False]
    assert stars.flux[order] == pytest.approx(flux[:4], rel=0.012)
    for k, row in enumerate(order):
        assert np.hypot(stars.x[row] - positions[k][0], stars.y[row] - positions[k][1]) < 0.05


@pytest.mark.thorough
def test_little_is_left_where_stars_were(fabricate):
    """Beyond what saturates, at most MODEL_ERROR of the light and 5 sigma of noise; put back, it is as it was."""
    positions, flux = [(120.4, 150.7), (280.2, 260.1)], [2e6, 1e5]
    electrons, unusable = frame(fabricate, positions, flux)
    before = electrons.copy()
    stars = fitted(fabricate, electrons, unusable)
    stars.subtract_from(electrons)
    light = before - electrons
    usable = unusable == 0
    allowed = MODEL_ERROR * light + 5.0 * np.sqrt(np.maximum(before, fabricate.SKY) + fabricate.READ_NOISE**2)
    assert light[usable].max() > 50_000
    assert (np.abs(electrons - fabricate.SKY) <= allowed)[usable].all()
    rms = np.full([-(-n // BIN) for n in electrons.shape], 8.0, np.float32)
    stars.add_noise_to(rms)
    variance = 64.0 + binned(np.maximum(light, 0) + (MODEL_ERROR * light) ** 2) / BIN**2
    whole = rms[: variance.shape[0], : variance.shape[1]]
    assert whole == pytest.approx(np.sqrt(variance), rel=1e-2, abs=0.05)
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
    position = round(stars.y[0]), round(stars.x[0] - 60)
    radius = np.hypot(position[1] - stars.x[0], position[0] - stars.y[0])
    assert image[position] == pytest.approx(-flux * wing.profile(radius).mean(), rel=1e-3)
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
    positions, flux = rng.uniform(30, SIZE - 30, (40, 2)), 10 ** rng.uniform(4.3, 6.5, 40)
    one, two = (fitted(fabricate, *frame(fabricate, positions, flux)) for _ in range(2))
    assert (one.flux == two.flux).all() and len(one) > 20


def test_saturated_pixels_are_stars_where_they_are_widest():
    """A bleeding star of rows 4, 5 and 3 px wide (3 is below 0.7 of 5), a pair 3 px apart, one 3.2 px from it."""
    star = {(y, 10) for y in range(21)} | {(9, x) for x in range(9, 13)} | {(10, x) for x in range(8, 13)}
    pixels = sorted(star | {(11, x) for x in range(8, 11)} | {(30, 30), (33, 30), (34, 33)})
    x, y = module._groups(*np.transpose(pixels))
    assert sorted(zip(x, y, strict=True)) == [
        (pytest.approx((4 * 10.5 + 5 * 10) / 9), pytest.approx((4 * 9 + 5 * 10) / 9)),
        (30.0, 31.5),
        (33.0, 34.0),
    ]


@pytest.mark.parametrize(
    ("lit", "marked", "found"),  # {position: electron}, {position: bits}, peaks
    [
        ({(5, 7): 4000.0}, {}, [(5, 7)]),
        ({(5, 7): 3999.0}, {}, []),
        ({(5, 7): 5000.0, (7, 5): 5001.0}, {}, [(7, 5)]),
        ({(5, 7): 5000.0, (5, 8): 5000.0}, {}, [(5, 7)]),  # of two alike the first
        ({(5, 7): 5000.0, (8, 7): 6000.0}, {}, [(5, 7), (8, 7)]),
        ({(2, 11): 5000.0, (1, 5): 5000.0, (7, 12): 5000.0}, {}, [(2, 11)]),  # not at the edge
        ({(9, 2): 5000.0, (10, 7): 5000.0, (5, 1): 5000.0}, {}, [(9, 2)]),
        ({(5, 7): 5000.0}, {(3, 9): BAD}, []),
        ({(5, 7): 5000.0}, {(5, 10): BAD}, [(5, 7)]),
        ({(5, 7): 5000.0}, {(5, 7): BAD}, []),
    ],
)
def test_peaks_exceed_the_24_pixels_around_them(lit, marked, found):
    electrons, unusable = np.zeros((12, 14), np.float32), np.zeros((12, 14), np.uint8)
    for position, value in lit.items():
        electrons[position] = value
    for position, bits in marked.items():
        unusable[position] = bits
    unusable[0, 0] = FULL
    full, peaks = module._pixels(electrons, unusable, np.float32(4000.0))
    assert full.T.tolist() == [[0, 0]] and peaks.T.tolist() == [list(position) for position in found]


def test_charge_is_spilled_two_steps_along_the_axes():
    unusable = np.zeros((9, 12), np.uint8)
    unusable[8, 11] = BAD
    spilled = module._spilled(unusable, np.array([4, 0]), np.array([5, 11]))
    row, column = np.indices(unusable.shape)
    near = np.minimum(abs(row - 4) + abs(column - 5), abs(row) + abs(column - 11)) <= 2
    assert (spilled == np.where(near, FULL, unusable)).all() and unusable.sum() == BAD


def test_of_fits_that_ended_on_one_star_the_brightest_is_left():
    rows = [[10, 0, 0, 1], [20, 2, 2, 1], [30, 4.9, 2.1, 1], [99, 0, 0, 1], [7, 50, 0, 1], [8, 50, 3.1, 1]]
    fit = module.StarFits(*np.transpose(rows))
    assert module._repeated(fit, fit.flux != 99).tolist() == [True, True, False, False, False, False]
    alike = module.StarFits(*np.transpose([[10.0, 0, 0, 1], [10, 0, 1, 1]]))
    assert module._repeated(alike, np.ones(2, bool)).sum() == 1


def test_psfs_are_those_of_the_middles_of_cells():
    psf = SimpleNamespace(oversampling=2, mixed=lambda function: lambda x, y: np.array([[x, y]]))
    number, tables = module._tables(psf, np.array([1151.9, 1152.0, 10.0]), np.array([5.0, 2304.1, 3.0]))
    assert tables[number, 0].tolist() == [[575.5, 575.5], [1727.5, 2879.5], [575.5, 575.5]] and len(tables) == 2


def test_positions_on_the_chip_are_those_of_the_frame_and_its_origin(fabricate):
    """The PSF's cell; where its light ends: the mean wing of four unlike bands at FAINTEST of the noise of a pixel."""
    asked = []

    class Psf(WingedPsf):
        def mixed(self, function):
            return lambda x, y: asked.append((x, y)) or function(self.at(x, y))

    wing = Wing(np.array([[0.01], [0.02], [0.03], [0.06]]), np.array([20.0]), np.array([3.0]), np.full(4, 1e-9))
    electrons, unusable = frame(fabricate, [(200.2, 199.7)], [3e6])
    window = Window(2000, 2000 + SIZE, 50, 50 + SIZE)
    stars = bright_stars(electrons, unusable, Psf(), Scattered(wing), None, window, fabricate.READ_NOISE)
    assert asked == [(1.5 * 1152 - 0.5, 575.5)]
    assert stars.x[0] == pytest.approx(200.2, abs=0.05) and not len(stars.ghosts)
    corner = math.hypot(SIZE + 1 + module.SHIFT_MAX, SIZE + 1 + module.SHIFT_MAX)  # from a star beyond the other corner
    assert len(stars.wing) * WING_STEP > corner + WING_STEP
    level = 0.03 / (2 * np.pi * 20**2) * (1 + (stars.reach[0] / 20) ** 2) ** -1.5 * stars.flux[0]
    assert level == pytest.approx(0.04 * np.sqrt(fabricate.VARIANCE), rel=0.02)


def test_ghosts_are_in_pixels_of_the_frame():
    ghosts = SimpleNamespace(
        visible=lambda flux: flux > 100,
        centres=lambda chip, x, y: np.array([[x + 10, y - 20], [2 * x, y]]),
        radius=np.array([5.0, 7.0]),
        level=np.array([0.01, 0.02]),
    )
    at = (np.array(v) for v in ([1.0, 2.0], [3.0, 4.0], [50.0, 200.0]))
    found = module._ghosts(ghosts, None, SimpleNamespace(x0=100, y0=50), *at)
    assert found.tolist() == [[12.0, -16.0, 5.0, 2.0], [104.0, 4.0, 7.0, 4.0]]


def test_a_star_is_its_psf_then_its_wing_as_far_as_it_reaches(fabricate):
    """The PSF to 0.7 of the box's half side, 62 px, the wing from 0.95, a smooth step between; nothing beyond."""
    psf, flux, (x, y), reach = WingedPsf(), 1e6, (200.3, 150.8), 120.0
    tables = psf.mixed(partial(photometry._whole_table, oversampling=2))(0, 0)[None]
    wing = 1e-4 / (1 + WING_STEP * np.arange(4000))
    one = [np.array([v]) for v in (x, y, flux)]
    for far, edge in ((reach, reach), (0.0, 62.0)):
        stars = BrightStars(
            *one, np.ones(1, bool), np.zeros(1, np.int64), tables, 2, wing, np.array([far]), np.zeros((0, 4))
        )
        image = np.zeros((301, 351), np.float32)
        stars.restore_to(image)
        for u, v in ((201, 150), (205, 153), (160, 150), (200, 100), (246, 165), (150, 150), (200, 210), (200, 30)):
            r = np.hypot(u - x, v - y)
            line = [np.diff(below(np.array([n - 0.5, n + 0.5]) - at, sigma))[0] for sigma, _ in PARTS
                    for n, at in ((u, x), (v, y))]  # fmt: skip
            core = sum(fraction * line[2 * k] * line[2 * k + 1] for k, (_, fraction) in enumerate(PARTS))
            t = np.clip((r / 62 - 0.7) / 0.25, 0, 1)
            t = t * t * (3 - 2 * t)
            wanted = flux * ((1 - t) * core + t * 1e-4 / (1 + r)) if r <= edge else 0.0
            assert image[v, u] == pytest.approx(wanted, rel=1e-3, abs=0.3), (u, v, far)


def test_a_neighbour_and_charge_beside_the_saturated_pixels_do_not_move_a_star(fabricate):
    """Light of a star 5 px away, and 8,000 electrons in the pixels two steps from the full ones, are left out."""
    positions, flux = [(100.3, 100.6), (300.2, 290.7)], [6e4, 3e6]
    electrons, unusable = frame(fabricate, [*positions, (105.1, 100.2)], [*flux, 6e3])
    row, column = np.nonzero(unusable)
    spilled = module._spilled(unusable, row, column) > unusable
    electrons[spilled] += 8_000.0
    stars = fitted(fabricate, electrons, unusable)
    assert len(stars) == 2
    for (x, y), light in zip(positions, flux, strict=True):
        k = int(np.argmin(np.hypot(stars.x - x, stars.y - y)))
        assert stars.flux[k] == pytest.approx(light, rel=0.025)
        assert np.hypot(stars.x[k] - x, stars.y[k] - y) < 0.05


def test_a_star_of_a_slightly_other_psf_is_still_a_star(fabricate):
    """Its core is 5% narrower than the model: far beyond its noise, not beyond the error of the model."""
    edges = np.arange(SIZE + 1) - 0.5
    core, share = PARTS[0]
    lines = [[np.diff(below(edges - at, sigma)) for at in (150.6, 100.3)] for sigma in (0.95 * core, core)]
    change = 2e5 * share * (np.outer(*lines[0]) - np.outer(*lines[1]))
    electrons, unusable = frame(fabricate, [(100.3, 150.6)], [2e5], extra=change)
    stars = fitted(fabricate, electrons, unusable)
    assert len(stars) == 1 and stars.flux[0] == pytest.approx(2e5, rel=0.1)


def test_stars_keep_their_own_psf_and_mark_when_a_candidate_before_them_is_none(fabricate):
    """A saturated galaxy and a star, in two cells of the PSF: the star is not saturated and has the second table."""
    galaxy = galsim.Convolve(
        galsim.Sersic(n=2.5, half_light_radius=6.0, flux=5e7), galsim.Gaussian(sigma=fabricate.SIGMA)
    ).drawImage(nx=SIZE, ny=SIZE, scale=1.0, offset=(-100, -100)).array  # fmt: skip
    electrons, unusable = frame(fabricate, [(330.3, 330.6)], [5e4], extra=galaxy)
    assert unusable.any()
    window = Window(1000, 1000 + SIZE, 50, 50 + SIZE)  # the PSF's second cell begins at 1152
    stars = bright_stars(electrons, unusable, WingedPsf(), Scattered(), None, window, fabricate.READ_NOISE)
    near = np.hypot(stars.x - 330.3, stars.y - 330.6) < 0.1
    assert len(stars.tables) == 2 and near.sum() == 1
    assert not stars.saturated[near][0] and stars.table[near][0] == 1
