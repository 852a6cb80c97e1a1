"""The compact model of stellar atmospheres against real stars, the grids it represents, and closed forms."""

import os
from pathlib import Path

import numpy as np
import pytest
import speclite.filters
from astropy.io import fits
from astropy.table import Table
from star_grids import GridSeds, read_packed

from csstsim.base.errors import InputError
from csstsim.base.units import C_A_S, H_J_S, ab_photon_density
from csstsim.catalog.light.photometry import subband_weights
from csstsim.instrument.camera import load_camera
from csstsim.instrument.filter import GRID
from csstsim.universe.stars.star_sed import KNOTS, StarSeds, cubic, linear

SHIPPED = Path(__file__).resolve().parents[3] / "config"
MODEL = SHIPPED / "universe" / "star_spectra.fits"
DATA = Path(os.environ.get("CSSTSIM_DATA", SHIPPED.parents[1] / "shared" / "data"))
CURVE = (5500.0 / GRID) ** 1.3  # any smooth A(lambda) / A(V)
BESSELL = {"U": 0.79, "B": -0.09, "V": 0.02, "R": 0.21, "I": 0.45}  # AB - Vega, Blanton & Roweis 2007, AJ 133, 734
GAIA = {"G": 0.105, "BP": 0.029, "RP": 0.354}  # AB - Vega in DR2, Evans et al. 2018, A&A 616, A4
MAIN_SEQUENCE = ([2800, 3200, 3500, 3900, 4500, 5200, 6500, 9700], [5.15, 5.05, 4.9, 4.7, 4.62, 4.55, 4.25, 4.1])


@pytest.fixture(scope="module")
def seds():
    return StarSeds(MODEL, CURVE)


def magnitudes(surface, names):
    """Return the AB magnitudes, {name: (n,)}, of photon densities on the paper's grid in speclite's filters."""
    out = {}
    for name in names:
        response = speclite.filters.load_filter(name).interpolator(GRID)
        out[name.split("-")[1]] = -2.5 * np.log10(surface @ response / (ab_photon_density(GRID) @ response))
    return out


def dwarfs(seds, teff, feh=0.0):
    teff = np.asarray(teff, dtype=float)
    return seds.surface(teff, np.interp(teff, *MAIN_SEQUENCE), feh)


def test_colours_of_real_dwarfs_from_3500_to_10000_kelvin(seds):
    real = Table.read(Path(__file__).parents[3] / "builders" / "dwarf_colours.csv", format="ascii.csv", comment="#")
    real = real[real["teff"] > 3500]
    moved = Table.read(Path(__file__).parents[3] / "builders" / "real_dwarfs.csv", format="ascii.csv", comment="#")
    for name, column in (("U-B", "u-g"), ("g-r", "g-r")):  # moved on purpose, as spectra of real dwarfs say
        real[name] += np.interp(real["teff"], moved["teff"], moved[column])
    surface = dwarfs(seds, real["teff"])
    m = {k: v - BESSELL[k] for k, v in magnitudes(surface, [f"bessell-{b}" for b in BESSELL]).items()}
    m |= {k: v - GAIA[k] for k, v in magnitudes(surface, [f"gaiadr2-{b}" for b in GAIA]).items()}
    m |= magnitudes(surface, ["sdss2010-g", "sdss2010-r"])
    error = {name: m[name.split("-")[0]] - m[name.split("-")[1]] - real[name] for name in real.colnames[2:]}
    for name in ("B-V", "V-R", "V-I", "BP-RP", "g-r"):
        assert np.abs(error[name]).mean() < 0.02, name
        # Two rows of BP-RP (A9, K7) reach 0.06, where the table itself jumps from type to type
        assert np.sum(np.abs(error[name]) > 0.05) <= (2 if name == "BP-RP" else 0), name
        assert np.abs(error[name]).max() < 0.065, name
    assert np.abs(error["U-B"]).max() < 0.08  # mag; Johnson's U has no agreed passband (Bessell & Murphy 2012)


def test_stellar_locus_of_sdss(seds):
    m = magnitudes(dwarfs(seds, np.geomspace(9000, 2800, 200)), [f"sdss2010-{b}" for b in "griz"])
    g_i = m["g"] - m["i"]
    assert (np.diff(g_i) > 0).all()  # one colour, one star: nothing folds back at the seam of the grids
    for colour, *expected in np.loadtxt(SHIPPED / "curves" / "sdss_locus.csv", delimiter=",", skiprows=2):
        computed = [np.interp(colour, g_i, m[blue] - m[red]) for blue, red in ("gr", "ri", "iz")]
        # Spectra of real dwarfs are 0.03 to 0.045 redder in g-r than the locus, and as much bluer in r-i
        np.testing.assert_allclose(np.subtract(computed, expected), [0.035, -0.035, 0.0], atol=0.06)


def test_colours_of_spectra_of_real_dwarfs_in_the_camera_s_bands(seds):
    """At given g-i, so that no temperature is needed: STIS spectra to 0.1 mag in NUV and u, 0.04 from g to y."""
    camera = load_camera(SHIPPED / "instrument")
    weights = np.stack([subband_weights(camera.filters[b], camera.telescope).sum(axis=0) for b in ("NUV", *"ugrizy")])
    teff = np.geomspace(9900, 2700, 160)
    light = seds.rates(teff, np.interp(teff, *MAIN_SEQUENCE), 0.0, 0.0, weights)
    computed = np.diff(2.5 * np.log10(light / (weights @ ab_photon_density(GRID))), axis=1)
    real = Table.read(Path(__file__).parents[3] / "builders" / "real_colours.csv", format="ascii.csv")
    names = real.colnames[2:]
    g_i, ours_g_i = real["g-r"] + real["r-i"], computed[:, 2] + computed[:, 3]
    error = np.stack([np.interp(g_i, ours_g_i, computed[:, k]) - real[name] for k, name in enumerate(names)], axis=1)
    stis = real["source"] != "Pickles"
    assert stis.sum() == 10 and np.nanmax(np.abs(error[stis, :2])) < 0.1
    assert np.nanmax(np.abs(error[stis, 2:])) < 0.04
    # Pickles' spectra are put together from several: to these in the mean of classes, F and G, K, M
    for letters in ("fg", "k", "m"):
        some = [not own and str(star)[0] in letters for own, star in zip(stis, real["star"], strict=True)]
        assert np.abs(np.nanmean(error[some, 2:], axis=0)).max() < 0.04, letters
        assert np.abs(np.nanmean(error[some, :2], axis=0)).max() < 0.16, letters


def test_the_sun_at_ten_parsec(seds):
    dilution = (6.957e8 / 3.0857e17) ** 2  # nominal solar radius (IAU 2015) over 10 pc
    surface = seds.surface([5772], [4.44], [0.0]) * dilution
    m = {k: v[0] - BESSELL[k] for k, v in magnitudes(surface, ["bessell-V"]).items()}
    assert m["V"] == pytest.approx(4.81, abs=0.03)  # Willmer 2018, ApJS 236, 47
    energy = np.trapezoid(surface[0] * H_J_S * C_A_S / GRID, GRID)
    assert energy * (3.0857e17 / 1.495979e11) ** 2 == pytest.approx(1361 * 0.752, rel=0.02)  # W / m2; ASTM E490


# Pecaut & Mamajek 2013: Teff and bolometric correction in V
BOLOMETRIC = [[3560, -1.62], [3850, -1.15], [4440, -0.63], [5100, -0.26], [5770, -0.085], [6550, -0.02], [7910, 0.005],
              [9700, -0.21], [12300, -0.73], [20600, -2.03]]  # fmt: skip


def test_scale_against_bolometric_corrections(seds):
    teff, published = np.array(BOLOMETRIC).T
    surface = dwarfs(seds, teff) * (6.957e8 / 3.0857e17) ** 2
    m_v = magnitudes(surface, ["bessell-V"])["V"] - BESSELL["V"]
    bolometric = 4.74 - 10 * np.log10(teff / 5772)  # of one solar radius; zero point of IAU 2015
    np.testing.assert_allclose(bolometric - m_v, published, atol=0.08)


# Holberg & Bergeron 2006 (Montreal, 2021): pure hydrogen, log g 8: Teff, M/Msun, SDSS u, g, r, Gaia DR3 G, BP, RP
WHITE_DWARFS = [
    [4500, 0.577, 18.265, 16.286, 15.344, 15.353, 15.930, 14.632],
    [6500, 0.590, 14.610, 14.006, 13.719, 13.694, 13.922, 13.306],
    [9500, 0.599, 12.750, 12.386, 12.419, 12.344, 12.402, 12.218],
    [12500, 0.607, 11.898, 11.550, 11.740, 11.629, 11.613, 11.663],
    [15500, 0.614, 11.342, 11.115, 11.400, 11.255, 11.199, 11.370],
    [30000, 0.646, 9.421, 9.718, 10.193, 9.951, 9.803, 10.240],
]


def test_white_dwarfs_against_published_absolute_magnitudes(seds):
    teff, mass, *published = np.array(WHITE_DWARFS).T
    dilution = 6.6743e-8 * 1.98841e33 * mass / 1e8 / 3.0857e19**2  # R^2 = G M / g, over 10 pc [cgs]
    surface = seds.surface(teff, 8.0, 0.0) * dilution[:, None]
    m = magnitudes(surface, [*(f"sdss2010-{b}" for b in "ugr"), *(f"gaiadr3-{b}" for b in ("G", "BP", "RP"))])
    vega = {"G": 0.114, "BP": 0.016, "RP": 0.356}  # AB - Vega in DR3, Riello et al. 2021, A&A 649, A3
    computed = np.array([m["u"], m["g"], m["r"], *(m[b] - vega[b] for b in vega)])
    np.testing.assert_allclose(computed[:3], published[:3], atol=0.02)
    np.testing.assert_allclose(computed[3:], published[3:], atol=0.05)  # Gaia's bands were not fitted


def depth(surface, line, blue, red):
    """Return the equivalent width [angstrom] of `line` (low, high) under the straight line between two side bands."""
    mean = [surface[:, (low <= GRID) & (high >= GRID)].mean(axis=1) for low, high in (blue, red)]
    inside = (line[0] <= GRID) & (line[1] >= GRID)
    fraction = (GRID[inside] - np.mean(blue)) / (np.mean(red) - np.mean(blue))
    level = mean[0][:, None] * (1 - fraction) + mean[1][:, None] * fraction
    return (1 - surface[:, inside] / level).sum(axis=1) * (GRID[1] - GRID[0])


H_BETA = (4800, 4922), (4740, 4800), (4922, 4980)
MG_B = (5150, 5200), (5110, 5145), (5300, 5360)
NA_D = (5870, 5915), (5825, 5865), (5920, 5960)
FEATURES = {"Hbeta": H_BETA, "Mg b": MG_B, "Na D": NA_D, "Halpha": ((6510, 6615), (6450, 6510), (6615, 6675))}


def breaks(surface):
    """Return the ratios over the 4000 A break and the Balmer jump, and TiO at 7100 A (shallow is 1)."""
    band = {e: surface[:, (e[0] <= GRID) & (e[1] >= GRID)].mean(axis=1) for e in
            [(4000, 4100), (3850, 3950), (3500, 3620), (4200, 4300), (7130, 7160), (7020, 7050)]}  # fmt: skip
    b4000, balmer = band[4000, 4100] / band[3850, 3950], band[4200, 4300] / band[3500, 3620]
    return b4000, balmer, band[7130, 7160] / band[7020, 7050]


def test_features_stand_at_the_temperatures_they_should(seds):
    teff = np.array([2800, 3200, 3600, 4000, 4500, 5000, 6000, 7000, 8000, 9000, 10000, 12000, 20000, 40000])
    surface = dwarfs(seds, teff)
    width = {name: dict(zip(teff, depth(surface, *bands), strict=True)) for name, bands in FEATURES.items()}
    # Balmer lines peak at A0 (13 A of Hbeta there: Gray & Corbally 2009), weak in G and in O stars
    warm = teff[teff >= 5000]  # below, "Hbeta" is bands of TiO and MgH
    assert max(warm, key=width["Hbeta"].get) in (8000, 9000, 10000)
    assert 10 < width["Hbeta"][9000] < 20 and 1 < width["Hbeta"][6000] < 6 and width["Hbeta"][40000] < 5
    assert 5 < width["Halpha"][9000] < 15
    # Mg b and Na D belong to K dwarfs, and fade to nothing at A0
    assert max(width["Mg b"][4000], width["Mg b"][4500]) > 2 * width["Mg b"][6000] > 0.5
    assert width["Na D"][4000] > 5 > width["Na D"][6000] > 0.3 > abs(width["Na D"][9000])
    b4000, balmer, tio = (dict(zip(teff, ratio, strict=True)) for ratio in breaks(surface))
    assert b4000[4500] > 2 > b4000[6000] > 1.3 > b4000[9000]
    assert max(balmer, key=balmer.get) < 4000 or balmer[9000] > 2.0  # the jump at A0, besides the red slope of M dwarfs
    assert balmer[9000] > 1.5 * balmer[20000]
    assert tio[2800] < tio[3200] < tio[3600] < tio[4000] < 1.02 and tio[3200] < 0.75 and abs(tio[6000] - 1) < 0.05


def test_giants_and_poor_stars_differ_as_they_should(seds):
    giant, dwarf = depth(seds.surface(4500, [2.0, 4.6], 0.0), *MG_B)
    assert dwarf > giant + 1  # A: the dwarf's pressure-broadened Mg b
    rich, poor = (breaks(seds.surface([5500], [4.5], [feh]))[0][0] for feh in (0.0, -2.0))
    assert rich > poor + 0.1
    jump = breaks(seds.surface(9000, [2.0, 4.0], 0.0))[1]
    assert jump[0] > jump[1]  # the Balmer jump is a luminosity indicator


def grid_seds(name):
    path = DATA / name
    if not path.exists():
        pytest.skip(f"{name} is not on this machine (CSSTSIM_DATA)")
    return GridSeds(read_packed(path), CURVE)


def colours(seds, camera, teff, logg, feh, av=0.0):
    """Return (n, 6): NUV-u ... z-y with the camera's own filters."""
    weights = np.stack(
        [
            subband_weights(camera.filters[b], camera.telescope).sum(axis=0)
            for b in ["NUV", "u", "g", "r", "i", "z", "y"]
        ]
    )
    zero = weights @ ab_photon_density(GRID)
    return np.diff(2.5 * np.log10(seds.rates(teff, logg, feh, av, weights) / zero), axis=1)


def test_camera_colours_against_atlas9(seds, camera):
    """Redward of u they are those of the grid; in NUV stars below 9000 K are tied to real dwarfs, which are redder."""
    grid = grid_seds("ck04/ck04_packed_1500_12000A.fits")
    nodes = np.array(
        np.meshgrid([5250, 5750, 6500, 7500, 9000, 10000, 15000], [2.0, 3.5, 4.0, 4.5], [-2.0, -0.5, 0, 0.5])
    )
    # Between the nodes of the model (grid and model interpolate apart): 200 stars
    rng = np.random.default_rng(5)
    some = np.stack([rng.uniform(5300, 12000, 200), rng.uniform(3.0, 5.0, 200), rng.uniform(-2.5, 0.5, 200)])
    for stars, tolerance in ((nodes.reshape(3, -1), 0.005), (some, 0.01)):
        off = colours(seds, camera, *stars) - colours(grid, camera, *stars)
        hot = stars[0] >= 9000
        assert np.abs(off[:, 1:]).max() < tolerance and np.abs(off[hot, 0]).max() < tolerance
        assert -tolerance < off[~hot, 0].min() and off[~hot, 0].max() < 0.15


def test_spectra_against_the_grids(seds):
    """At R = 250 (a box of 25 A) the rms residual is under 1% of the grid's spectrum, 3% below the Balmer jump."""
    box, wave = np.ones(5) / 5, KNOTS[2:-2]
    hot = grid_seds("ck04/ck04_packed_1500_12000A.fits")
    for teff in (5250, 6000, 8000, 10000, 20000):
        computed, reference = (
            np.convolve(s.surface([teff], [4.0], [0.0], KNOTS)[0], box, "valid") for s in (seds, hot)
        )
        assert np.std((computed / reference)[wave > 3200]) < 0.01, teff
        assert np.std((computed / reference)[(wave > 2550) & (wave < 3200)]) < 0.03, teff
    for name in FEATURES:
        computed, reference = (
            depth(s.surface([5500.0, 9000.0], [4.5, 4.0], 0.0), *FEATURES[name]) for s in (seds, hot)
        )
        np.testing.assert_allclose(computed, reference, atol=0.4, err_msg=name)  # angstrom
    cool = grid_seds("btsettl/btsettl_cifist_solar_lephare.fits")
    computed, reference = (breaks(s.surface([2500.0, 3000.0, 3500.0], 5.0, 0.0))[2] for s in (seds, cool))
    np.testing.assert_allclose(computed, reference, atol=0.02)


def test_no_jump_where_the_grids_meet(seds, camera):
    teff = np.arange(3300, 5400, 20.0)
    for logg, feh in ((4.7, 0.0), (4.7, -1.5), (1.0, 0.0)):
        c = colours(seds, camera, teff, logg, feh)
        step = np.abs(np.diff(c, n=2, axis=0))[:, 1:].max()
        assert step < 0.015, (logg, feh, step)  # mag; a jump would stand out as its own size


def test_rates_are_the_integral_of_the_spectrum(seds, camera):
    rng = np.random.default_rng(7)
    teff, logg, feh = rng.uniform(2000, 30000, 40), rng.uniform(0, 8, 40), rng.uniform(-2, 0.5, 40)
    for name in ("NUV", "r", "GI"):
        weights = subband_weights(camera.filters[name], camera.telescope)
        surface = seds.surface(teff, logg, feh)
        np.testing.assert_allclose(seds.rates(teff, logg, feh, 0.0, weights), surface @ weights.T, rtol=1e-12)
        dimmed = surface * 10 ** (-0.4 * CURVE)
        np.testing.assert_allclose(seds.rates(teff, logg, feh, np.ones(40), weights), dimmed @ weights.T, rtol=1e-4)


def test_bins_are_the_integrals_of_the_extincted_spectrum(seds):
    """Bins that end anywhere between the knots, against a trapezium rule over knots and edges, which is exact."""
    edges = np.sort(np.random.default_rng(6).uniform(3000.0, 9900.0, 300))
    at = np.unique(np.concatenate([edges, KNOTS[(edges[0] < KNOTS) & (edges[-1] > KNOTS)]]))
    star = np.array([4500.0]), np.array([4.5]), np.array([0.0])
    light = seds.surface(*star, KNOTS)[0] * 10 ** (-0.4 * 0.8 * np.interp(KNOTS, GRID, CURVE))
    values = np.interp(at, KNOTS, light)
    running = np.concatenate([[0.0], np.cumsum(0.5 * np.diff(at) * (values[1:] + values[:-1]))])
    exact = np.diff(running[np.searchsorted(at, edges)]) / np.diff(edges)
    assert seds.binned(*star, [0.8], edges)[0] == pytest.approx(exact, rel=1e-6)


def test_a_star_does_not_depend_on_its_company(seds, camera):
    weights = subband_weights(camera.filters["g"], camera.telescope)
    teff, logg, feh, av = np.array([2500.0, 5777, 9000, 40000]), np.array([5, 4.4, 4, 8.0]), np.zeros(4), np.arange(4.0)
    whole = seds.rates(teff, logg, feh, av, weights)
    for k in range(4):
        np.testing.assert_array_equal(seds.rates(teff[k], logg[k], feh[k], av[k], weights)[0], whole[k])
    assert seds.rates([], [], [], [], weights).shape == (0, 4)
    assert seds.surface([], [], []).shape == (0, len(GRID))


def test_outside_the_grid_the_edge_holds(seds):
    low, high = seds.limits["teff"]
    np.testing.assert_allclose(seds.surface([1.0, 1e9], 5.0, 0.0), seds.surface([low, high], 5.0, 0.0))
    np.testing.assert_allclose(
        seds.surface(5000, [-3.0, 30.0], [-9, 9]), seds.surface(5000, seds.limits["logg"], [-2.5, 0.5])
    )
    assert low <= 1950 and high >= 50000
    every = np.array(np.meshgrid(np.geomspace(1900, 50000, 40), np.linspace(0, 9, 10), [-2.5, 0, 0.5])).reshape(3, -1)
    surface = seds.surface(*every, KNOTS)
    assert np.isfinite(surface).all() and (surface > 0).all()


@pytest.mark.parametrize("bad", [(np.nan, 4, 0), (5000, np.inf, 0), (5000, 4, np.nan), (0, 4, 0), (-5000, 4, 0)])
def test_what_is_no_number_is_refused(seds, bad):
    with pytest.raises(InputError, match="finite"):
        seds.surface(*bad)


def test_damaged_model_is_named(tmp_path):
    path = tmp_path / "stars.fits"
    whole = MODEL.read_bytes()
    for damage in (None, b"", b"text", whole[:2880], whole[: len(whole) // 2]):
        if damage is not None:
            path.write_bytes(damage)
        with pytest.raises(InputError, match=r"stars\.fits"):
            StarSeds(path, CURVE)
    with fits.open(MODEL) as file:
        file["LOGG"].data = file["LOGG"].data[:-1]
        file.writeto(path, overwrite=True)
    with pytest.raises(InputError, match="fit together"):
        StarSeds(path, CURVE)


def test_interpolation_weights():
    nodes = np.array([0.0, 1.0, 3.0, 4.0, 4.5])
    x = np.linspace(1.0, 4.0, 50)
    for curve in (np.ones_like, lambda v: v, lambda v: v**2):  # exact for a parabola where both slopes are
        index, weight = cubic(nodes, x)
        np.testing.assert_allclose((weight * curve(nodes[index])).sum(axis=1), curve(x), atol=1e-12)
    for rule in (cubic, linear):
        index, weight = rule(nodes, np.concatenate([nodes, [-5.0, 9.0]]))
        np.testing.assert_allclose((weight * nodes[index]).sum(axis=1), [*nodes, 0.0, 4.5], atol=1e-12)
    index, weight = cubic(nodes[:2], np.array([0.25]))  # two nodes: a straight line
    assert (weight * nodes[:2][index]).sum() == pytest.approx(0.25)


def test_scaled_integers_are_read_to_the_bits_that_astropy_makes_of_them(seds):
    """The sky of a seed hangs on the last bit: cfitsio scales in float64 and rounds once, astropy in float32."""
    with fits.open(MODEL) as file:
        assert file["COEFF"].header["BITPIX"] == 16
        np.testing.assert_array_equal(seds._table[..., 1:], np.float64(file["COEFF"].data))
        np.testing.assert_array_equal(seds._rows, np.float64(file["BASIS"].data))
