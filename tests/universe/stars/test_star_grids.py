"""Readers of real atmosphere grids, and a grid used instead of the compact model."""

import gzip
import lzma
import os
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits
from star_grids import Grid, GridSeds, read_btsettl, read_ck04, read_packed, resample

from csstsim.base.errors import InputError
from csstsim.base.units import C_A_S, H_J_S
from csstsim.instrument.filter import GRID
from csstsim.universe.stars.star_sed import KNOTS

SHIPPED = Path(__file__).resolve().parents[3] / "config"
DATA = Path(os.environ.get("CSSTSIM_DATA", SHIPPED.parents[1] / "shared" / "data"))
NO_DUST = np.zeros_like(GRID)
WAVE = np.arange(1500.0, 12000.0, 7.0)


def real(path):
    if not (DATA / path).exists():
        pytest.skip(f"{path} is not on this machine (CSSTSIM_DATA)")
    return DATA / path


def write_ck04(folder, teff=5000, log_z=0.0, columns=(("g40", 1.0), ("g45", 2.0), ("g50", 0.0))):
    """Write a file in STScI's form; each column is a constant flux."""
    folder.mkdir(parents=True, exist_ok=True)
    table = [fits.Column(name="WAVELENGTH", format="E", array=WAVE)]
    table += [fits.Column(name=name, format="E", array=np.full(len(WAVE), level)) for name, level in columns]
    hdus = fits.HDUList([fits.PrimaryHDU(), fits.BinTableHDU.from_columns(table)])
    hdus[0].header["TEFF"], hdus[0].header["LOG_Z"] = teff, log_z
    path = folder / f"{folder.name}_{teff}.fits"
    hdus.writeto(path)
    return path


def test_ck04_written_here(tmp_path):
    write_ck04(tmp_path / "ckp00")
    write_ck04(tmp_path / "ckm10", log_z=-1.0)
    grid = read_ck04(tmp_path)  # the column of zeros is a model that does not exist
    assert sorted(zip(grid.teff, grid.logg, grid.feh, strict=True)) == [
        (5000, 4.0, -1.0), (5000, 4.0, 0.0), (5000, 4.5, -1.0), (5000, 4.5, 0.0),
    ]  # fmt: skip
    np.testing.assert_allclose(grid.flux[grid.logg == 4.5], 2.0)


def test_real_ck04_files():
    grid = read_ck04(real("ck04"))
    packed = read_packed(real("ck04/ck04_packed_1500_12000A.fits"))
    assert set(np.unique(grid.feh)) == {-1.0, 0.0} and len(packed.teff) == 3808
    row = np.flatnonzero((grid.teff == 5750) & (grid.logg == 4.5) & (grid.feh == 0))
    same = np.flatnonzero((packed.teff == 5750) & (packed.logg == 4.5) & (packed.feh == 0))
    assert len(row) == len(same) == 1
    np.testing.assert_allclose(grid.flux[row], packed.flux[same], rtol=1e-5)


def test_real_btsettl_files_against_their_packed_form():
    grid = read_btsettl(real("btsettl/orig"))
    assert list(zip(grid.teff, grid.logg, grid.feh, strict=True)) == [(3000, 5, 0), (5800, 4.5, 0), (7000, 4, 0)]
    packed = read_packed(real("btsettl/btsettl_cifist_solar_lephare.fits"))
    for teff, logg, flux in zip(grid.teff, grid.logg, grid.flux, strict=True):
        other = packed.flux[(packed.teff == teff) & (packed.logg == logg)][0]
        assert flux.sum() == pytest.approx(other.sum(), rel=4e-3)  # packed by samples, not means


def fortran(wave, flux):
    """Return lines as on the authors' site: unsorted, log10 per cm and black body, columns that touch."""
    lines = [f" {w:.6E}{np.log10(f) + 8:+.5f}-1.2345D+01\n" for w, f in zip(wave, flux, strict=True)]
    return "".join(reversed(lines)).replace("E+", "D+")


@pytest.mark.parametrize("suffix, opener", [("", open), (".gz", gzip.open), (".xz", lzma.open)])
def test_btsettl_logarithmic_form_is_the_linear_form(tmp_path, suffix, opener):
    flux = 1e-12 * (1 + 0.5 * np.sin(WAVE / 300))  # log10 + 8 is negative: the columns touch
    for kind in ("two", "many"):
        (tmp_path / kind).mkdir()
    np.savetxt(tmp_path / "two/lte058.0-4.5-0.0a+0.0.BT-Settl.spec.txt", np.column_stack([WAVE, flux]))
    with opener(tmp_path / f"many/lte058-4.5+0.3a+0.0.BT-Settl.spec.7{suffix}", "wt") as file:
        file.write(fortran(WAVE, flux))
    two, many = read_btsettl(tmp_path / "two"), read_btsettl(tmp_path / "many")
    assert (two.teff[0], two.logg[0], two.feh[0]) == (5800, 4.5, 0.0)
    assert (many.teff[0], many.logg[0], many.feh[0]) == (5800, 4.5, 0.3)
    np.testing.assert_allclose(many.flux, two.flux, rtol=3e-5)


@pytest.mark.parametrize(
    "name, content, message",
    [
        ("lte058-4.5-0.0a+0.0.txt", "", "cannot be read"),
        ("lte058-4.5-0.0a+0.0.txt", "2000 words\n", "cannot be read"),
        ("lte058-4.5-0.0a+0.0.txt", "2000 1\n9000 1\n", "rising wavelengths"),
        ("lte058-4.5-0.0a+0.0.txt", "1000 1\n12000 nan\n", "finite"),
        ("lte058-4.5-0.0a+0.0.txt", "1000 1\n12000 -1\n", "finite"),
        ("lte058-4.5-0.0a+0.0.txt.xz", "not xz", "cannot be read"),
        ("lte_of_the_sun.txt", "1000 1\n12000 1\n", "the name"),
        ("readme.txt", "", "no spectra"),
    ],
)
def test_damaged_btsettl_is_named(tmp_path, name, content, message):
    (tmp_path / name).write_text(content)
    with pytest.raises(InputError, match=message):
        read_btsettl(tmp_path)


def test_damaged_ck04_is_named(tmp_path):
    path = write_ck04(tmp_path / "ckp00")
    whole = path.read_bytes()
    for damage in (b"", b"SIMPLE  =", whole[:2880], whole[:5760].replace(b"TEFF", b"TAFF")):
        path.write_bytes(damage)
        with pytest.raises(InputError, match=r"ATLAS9|cut short"):
            read_ck04(tmp_path)
    with pytest.raises(InputError, match="no spectra"):
        read_ck04(tmp_path / "nowhere")
    with pytest.raises(InputError, match=r"packed|cut short"):
        read_packed(path)


def test_resampling_keeps_the_integral_of_lines_narrower_than_a_knot():
    rng = np.random.default_rng(3)
    wave = np.arange(1990.0, 11010.0, 0.05)
    flux = 1 - 0.9 * (rng.random(len(wave)) < 0.2)
    cells = resample("here", wave, flux)
    inside = (wave >= 1997.5) & (wave <= 11002.5)
    assert cells.sum() * 5.0 == pytest.approx(np.trapezoid(flux[inside], wave[inside]), rel=2e-5)
    ramp = resample("here", np.array([1000.0, 20000.0]), np.array([1000.0, 20000.0]))
    np.testing.assert_allclose(ramp, KNOTS, rtol=1e-12)  # a straight line is kept


def planck_grid(teff, logg=(4.0, 5.0), feh=(-1.0, 0.0)):
    nodes = [(t, g, z) for t in teff for g in logg for z in feh]
    flux = [KNOTS**-5.0 * 10 ** (0.1 * g + 0.2 * z) / np.expm1(1.438777e8 / (KNOTS * t)) for t, g, z in nodes]
    return Grid(KNOTS, *np.array(nodes, dtype=float).T, np.array(flux) * 1e20)


def test_grid_seds_at_nodes_and_between():
    grid = planck_grid([4000, 4200, 4400, 4600, 4800, 5000])
    seds = GridSeds(grid, NO_DUST)
    photons = grid.flux * 1e-3 * KNOTS / (H_J_S * C_A_S)  # erg/cm2 to J/m2, over the energy of a photon
    np.testing.assert_allclose(seds.surface(grid.teff, grid.logg, grid.feh, KNOTS), photons, rtol=1e-10)
    # A black body between nodes 200 K apart, and the mean of ln S in log g and [Fe/H]
    between = planck_grid([4330.0], logg=(4.3,), feh=(-0.4,)).flux * 1e-3 * KNOTS / (H_J_S * C_A_S)
    np.testing.assert_allclose(seds.surface([4330], [4.3], [-0.4], KNOTS), between, rtol=2e-4)
    assert seds.limits == {"teff": (pytest.approx(4000), pytest.approx(5000)), "logg": (4, 5), "feh": (-1, 0)}


def test_missing_node_takes_the_nearest_in_gravity_first():
    grid = planck_grid([4000, 5000], logg=(3.0, 4.0, 5.0))
    keep = ~((grid.teff == 5000) & (grid.logg == 3.0))
    cut = Grid(KNOTS, *(part[keep] for part in (grid.teff, grid.logg, grid.feh, grid.flux)))
    seds = GridSeds(cut, NO_DUST)
    np.testing.assert_array_equal(seds.surface([5000], [3.0], [0.0]), seds.surface([5000], [4.0], [0.0]))


def test_a_grid_of_one_spectrum_serves_every_star():
    seds = GridSeds(planck_grid([5000], logg=(4.5,), feh=(0.0,)), NO_DUST)
    s = seds.surface([3000, 5000, 9000], [0, 4.5, 8], [-2, 0, 1], KNOTS)
    np.testing.assert_allclose(s, s[[1, 1, 1]])
    weights = np.zeros((2, len(GRID)))
    weights[0, 5000:9000] = 0.5
    rates = seds.rates([5000], [4.5], [0.0], [0.0], weights)
    assert rates[0, 0] == pytest.approx(0.5 * np.interp(GRID[5000:9000], KNOTS, s[1]).sum(), rel=1e-12)
    assert rates[0, 1] == 0.0
