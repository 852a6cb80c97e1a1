"""Light of a table's objects without sampled spectra: equal to that with them, for any colours, and cheap."""

import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.csst import BANDS

from csstsim.base.shipped import SHIPPED
from csstsim.catalog.base import CatalogBase, Region
from csstsim.catalog.light import colours
from csstsim.catalog.light.colour_sums import STEEPEST, PivotMoments
from csstsim.catalog.light.colours import colour_bins, colour_rates, colour_spectra
from csstsim.catalog.light.photometry import bin_means, load_fluxes, subband_fluxes, subband_weights
from csstsim.catalog.own_table import TableCatalog
from csstsim.instrument.camera import load_camera
from csstsim.instrument.filter import GRID

CAMERA = load_camera(SHIPPED / "instrument")
FILTERS = [{name.lower(): f for name, f in CAMERA.filters.items()}[band] for band in BANDS]
SUM = 1e-9  # relative: the series' end
KINK = 1e-3  # relative, of a sample: linear between samples cuts the corner of a spectrum that turns at a pivot
CPU = 1e-4  # s an object; sums over samples take eight times as much
REGION = Region((10.0, 11.0, 11.0, 10.0), (0.0, 0.0, 1.0, 1.0), (0,), BANDS)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    st.lists(st.floats(-9.0, 9.0), min_size=7, max_size=7), st.lists(st.booleans(), min_size=7, max_size=7),
    st.sampled_from(sorted(CAMERA.filters)),
)  # fmt: skip
def test_rates_are_the_sums_over_samples(steps, known, name):
    """Property: any colours, bands missing, any imaging filter or grating; steps of 9 mag a band are of no real sky."""
    mags = np.where(known, 20.0 + np.cumsum(steps), np.nan)[None]
    mags[0, 3] = 20.0 if not any(known) else mags[0, 3]
    filter_ = CAMERA.filters[name]
    rates = colour_rates(mags, FILTERS, subband_weights(filter_, CAMERA.telescope))
    summed = subband_fluxes(colour_spectra(mags, FILTERS), filter_, CAMERA.telescope)
    np.testing.assert_allclose(rates, summed, rtol=SUM)


def test_steps_beyond_the_series_are_summed_as_well():
    weights = np.stack([f.at(GRID) for f in FILTERS])
    pivots = np.log([f.pivot for f in FILTERS])
    knots = PivotMoments(pivots, GRID, weights)
    for step in (0.0, 1e-9, 0.999 * STEEPEST, 1.001 * STEEPEST, -3 * STEEPEST):
        nodes = 20.0 + step * (np.arange(7) % 2)
        light = 10 ** (-0.4 * np.interp(np.log(GRID), pivots, nodes))
        np.testing.assert_allclose(knots.sums(nodes[None])[0], (weights * light).sum(axis=1), rtol=SUM)


def test_bins_are_the_means_of_samples():
    """Two hundred random colours over bins of 0.5, 12.5 and 250 A."""
    rng = np.random.default_rng(8)
    mags = 20.0 + rng.normal(0.0, 0.4, (200, 7)).cumsum(axis=1)
    mags[rng.random(mags.shape) < 0.4] = np.nan
    mags = mags[np.isfinite(mags).any(axis=1)]
    spectra = colour_spectra(mags, FILTERS)
    for step in (1, 25, 500):
        edges = GRID[400:17001:step]
        summed = bin_means(spectra, np.searchsorted(GRID, edges))
        np.testing.assert_allclose(colour_bins(mags, FILTERS, edges), summed, rtol=KINK / step)


def catalog(count):
    rng = np.random.default_rng(3)
    columns = {"ra": rng.uniform(10.0, 11.0, count), "dec": rng.uniform(0.0, 1.0, count)}
    columns |= {f"mag_{band}": rng.uniform(19.0, 20.0, count) for band in BANDS}
    return TableCatalog({"columns": columns}, REGION)


def test_a_table_gives_the_light_of_its_spectra():
    """Both ways into the renderers, against those of CatalogBase that sample each spectrum."""
    table, rows, edges = catalog(40), np.array([30, 2, 7]), GRID[::50]
    for name in ("r", "GV"):
        filter_ = CAMERA.filters[name]
        sampled = load_fluxes(table.load_seds, rows, filter_, CAMERA.telescope)
        np.testing.assert_allclose(table.load_fluxes(rows, filter_, CAMERA.telescope), sampled, rtol=SUM)
    np.testing.assert_allclose(
        table.load_binned(rows, edges), CatalogBase.load_binned(table, rows, edges), rtol=KINK / 50
    )


@pytest.mark.parametrize("way", ["load_fluxes", "load_binned"])
def test_it_is_cheap_and_samples_nothing(way, monkeypatch):
    """CPU seconds an object, seven bands; the clock starts after compilation, and the best of three counts."""
    monkeypatch.setattr(colours, "colour_spectra", None)
    table, edges = catalog(4000), GRID[2000:12001:40]
    asked = {"load_fluxes": (CAMERA.filters["r"], CAMERA.telescope), "load_binned": (edges,)}[way]
    getattr(table, way)(np.arange(10), *asked)
    spent = []
    for _ in range(3):
        start = time.process_time()
        getattr(table, way)(np.arange(4000), *asked)
        spent.append((time.process_time() - start) / 4000)
    assert min(spent) < CPU
