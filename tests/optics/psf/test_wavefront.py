"""The wavefront: Zernike convention against GalSim, the mirror screen's statistics, the shipped error budget."""

from dataclasses import replace

import galsim
import numpy as np
import pytest

from csstsim.base.errors import InputError
from csstsim.base.shipped import SHIPPED
from csstsim.instrument.load import read_data
from csstsim.optics.psf.wavefront import load_wavefront, mirror_screen, noll_to_nm, zernike

GRID = np.linspace(-1, 1, 401)
U, V = np.meshgrid(GRID, GRID)
DISC = U**2 + V**2 <= 1


@pytest.fixture(scope="module")
def params():
    return read_data(SHIPPED / "instrument" / "psf.yaml")


def disc_rms(wavefront, coefficients):
    """Rms over the disc, nm, for each row of coefficients."""
    grid = GRID[::4]
    disc = DISC[::4, ::4]
    return np.std(coefficients @ wavefront.basis(grid, grid)[:, disc] + wavefront.screen(grid, grid)[disc], axis=1)


@pytest.mark.parametrize("noll", range(1, 29))
def test_zernike_is_noll_as_in_galsim(noll):
    u, v = U[DISC][::500], V[DISC][::500]
    expected = galsim.zernike.Zernike([0] * noll + [1]).evalCartesian(u, v)
    assert zernike(noll, u, v) == pytest.approx(expected, abs=1e-11)
    assert noll_to_nm(noll) == galsim.zernike.noll_to_zern(noll)


def test_zernikes_are_orthonormal_over_the_disc():
    terms = np.array([zernike(j, U, V)[DISC] for j in range(1, 16)])
    # 2e-2: the highest terms peak at the edge, which 401 samples resolve to 1/200
    assert terms @ terms.T / DISC.sum() == pytest.approx(np.eye(15), abs=0.02)


def test_screen_has_the_rms_asked_no_tilt_and_normal_heights():
    # Flat spectrum: hundreds of modes, so the heights of one screen show the distribution
    height = mirror_screen(30.0, 0.0, (1, 20))(GRID, GRID)[DISC]
    assert np.std(height) == pytest.approx(30.0, rel=0.01)
    assert abs(height.mean()) < 0.1  # nm
    for tilt in (U[DISC], V[DISC]):
        assert abs(np.mean(height * tilt) * 2) < 0.2  # nm of tilt
    standard = height / height.std()
    # 1,256 modes fall on the disc's area/period share (pi/16 of them independent): 5 sigma on the moments
    modes = np.pi * 40**2 * np.pi / 16
    assert abs(np.mean(standard**3)) < 5 * np.sqrt(15 / modes)
    assert abs(np.mean(standard**4) - 3) < 5 * np.sqrt(96 / modes)


def test_shipped_mirror_is_0603_waves_with_normal_heights(params):
    """Paper 5.1.1; heights of what lies above 6 cycles a pupil: the few lowest modes hold most of the rms."""
    screen = load_wavefront(params, parts=("mirror",)).screen
    assert np.std(screen(GRID, GRID)[DISC]) / 632.8 == pytest.approx(0.0603, abs=3e-4)  # waves
    high = np.hypot(screen.mode, screen.mode[:, None]) / 2 > 6
    height = replace(screen, amplitude=np.where(high, screen.amplitude, 0), plane=np.zeros(3))(GRID, GRID)[DISC]
    standard = (height - height.mean()) / height.std()
    power = np.abs(screen.amplitude[high]) ** 2
    modes = power.sum() ** 2 / (power**2).sum() * np.pi / 16  # independent ones on the disc
    assert modes > 50
    assert abs(np.mean(standard**3)) < 5 * np.sqrt(15 / modes)
    assert abs(np.mean(standard**4) - 3) < 5 * np.sqrt(96 / modes)
    # The middle of the distribution: share within 1 sigma, 0.683 +- 5 sigma
    assert np.mean(np.abs(standard) < 1) == pytest.approx(0.683, abs=5 * np.sqrt(0.22 / modes))


@pytest.mark.parametrize("slope", [2.0, 4.0])
def test_screen_spectrum_falls_with_the_slope(slope):
    screen = mirror_screen(30.0, slope, (1, 20))
    frequency = np.hypot(screen.mode, screen.mode[:, None]) / 2
    power = np.abs(screen.amplitude) ** 2
    low, high = (power[(frequency >= a) & (frequency < b)].mean() for a, b in ((4, 5), (16, 18)))
    # 113 and 845 complex modes: 5 sigma = 0.5 + 0.2 in ln of the ratio; bin centres 4.5 and 17
    assert np.log(low / high) == pytest.approx(slope * np.log(17 / 4.5), abs=0.75)
    assert not power[(frequency > 20) | (frequency < 1)].any()


def test_screen_is_one_surface_however_it_is_sampled():
    one, other = mirror_screen(38.2, 4.0, (1, 40)), mirror_screen(38.2, 4.0, (1, 40))
    coarse, fine = one(GRID[::4], GRID), other(GRID, GRID)
    assert np.array_equal(coarse.shape, (401, 101))
    assert coarse == pytest.approx(fine[:, ::4], abs=1e-9)
    assert not np.allclose(fine, fine[::-1])  # and has no accidental symmetry
    assert not np.allclose(fine, fine.T)


def test_coefficients_are_a_quadratic_of_the_place(params):
    own = {**params, "field_scale": 100.0, "static": [], "design": [[5, 1, 2, 3, 4, 5, 6], [7, 0, 0, 0, 0, 0, 1]]}
    wavefront = load_wavefront(own | {"filter_figure": {"noll": [7, 6]}})
    assert wavefront.noll == (4, 5, 6, 7)  # the telescope's, and what chips add to: defocus and the filters' figure
    assert wavefront.coefficients(200.0, -100.0) == pytest.approx([0, 1 + 4 - 3 + 16 - 10 + 6, 0, 1.0])
    assert wavefront.coefficients(np.zeros((2, 3)), np.zeros((2, 3))).shape == (2, 3, 4)


def test_shipped_budget_is_19_nm_design_and_45_nm_static(params):
    x, y = (a.ravel() for a in np.meshgrid(np.linspace(-29758, 29758, 5), np.linspace(-24876, 24876, 5)))
    for parts, goal in ((("design",), 19.3), (("design", "static", "mirror"), 45.4)):  # from Strehl 0.964 and 0.816
        wavefront = load_wavefront(params, parts=parts)
        rms = disc_rms(wavefront, wavefront.coefficients(x, y))
        assert rms.mean() == pytest.approx(goal, abs=1.5)  # nm: the published Strehls are to 0.01
        corners = rms[[0, 4, 20, 24]].mean()
        assert corners > rms[12] + 1.0
    mirror = load_wavefront(params, parts=("mirror",))
    assert disc_rms(mirror, np.zeros((1, 12))) == pytest.approx(38.2, abs=0.3)


@pytest.mark.parametrize("row", [[4, 1, 2], [2, 0, 0, 0, 0, 0, 0], [4.5, 0, 0, 0, 0, 0, 0], [4, 0, 0, 0, 0, 0, np.nan]])
def test_bad_row_is_refused(params, row):
    with pytest.raises(InputError, match=r"psf\.yaml: static: bad row .*allowed: a Noll index >= 4"):
        load_wavefront({**params, "static": [row]})


@pytest.mark.parametrize(
    "mirror", [{"rms": -1.0}, {"rms": None}, {"slope": np.nan}, {"cycles_min": 50}, {"cycles_min": 0.1}]
)
def test_impossible_mirror_is_refused(params, mirror):
    with pytest.raises(InputError, match=r"psf\.yaml: mirror"):
        load_wavefront({**params, "mirror": params["mirror"] | mirror})
    with pytest.raises(InputError, match=r"psf\.yaml: mirror\.rms: must be a number; allowed: >= 0"):
        load_wavefront({"design": [], "static": []})
