"""The bound of an object's light through a grating; for the objects of a brick see test_select."""

import dataclasses

import numpy as np
import pytest

from csstsim.catalog.light.grating_bound import SPILL, band_coefficients, grating_rate
from csstsim.instrument.filter import GRID


def imaging(camera):
    return tuple(band for band in camera.filters.values() if band.kind == "imaging")


@pytest.mark.parametrize("name", ["GU", "GV", "GI"])
def test_bands_cover_the_curve(camera, name):
    """At each wavelength but GU's blue end, with at most 3.5 times the electrons of a flat spectrum."""
    filter = camera.filters[name]
    cover = sum(c * band.throughput for band, c in band_coefficients(filter, imaging(camera)))
    short = np.maximum(filter.throughput - cover, 0.0)
    assert short.sum() <= SPILL * filter.throughput.sum()
    assert (GRID[short > 0] < 2484).all()
    assert cover.sum() < 3.5 * filter.throughput.sum()


def test_without_light_or_magnitude(camera):
    """No light in any band: none through the grating. A magnitude that is not known: no bound."""
    bands = imaging(camera)
    dark = grating_rate(camera.filters["GV"], bands, lambda band: np.zeros(2))
    assert (dark == 0).all()
    unknown = grating_rate(camera.filters["GV"], bands, lambda band: np.array([np.nan, 1.0]) if band.name == "g" else 1)
    assert np.isnan(unknown[0]) and np.isfinite(unknown[1])


def test_bands_that_do_not_cover(camera):
    only_r = tuple(band for band in imaging(camera) if band.name == "r")
    assert band_coefficients(camera.filters["GV"], only_r) is None
    assert grating_rate(camera.filters["GV"], only_r, lambda band: np.ones(1)) is None
    filter = camera.filters["r"]  # a "grating" of half the r band's curve
    half = dataclasses.replace(filter, kind="slitless", throughput=filter.throughput / 2)
    ((band, share),) = band_coefficients(half, only_r)
    assert band.name == "r" and 0.5 <= share < 0.62  # the foot of an edge counts for more within a constraint


def test_the_margin_is_on_top_of_the_bands_rates(camera):
    """Of a grating with half the throughput of r: 5% above the share that covers it, for each object."""
    only_r = tuple(band for band in imaging(camera) if band.name == "r")
    half = dataclasses.replace(only_r[0], kind="slitless", throughput=only_r[0].throughput / 2)
    ((_, share),) = band_coefficients(half, only_r)
    rates = np.array([3.0, 0.0, 70.0])
    assert grating_rate(half, only_r, lambda band: rates) == pytest.approx(1.05 * share * rates, rel=1e-9)


def test_a_block_of_samples_is_covered_where_the_bands_give_least(camera):
    """Of two bands that meet with a step, each sample of the grating's curve is below the sum of their shares."""
    r = camera.filters["r"]
    flat = np.where((GRID >= 5000) & (GRID <= 7000), 1.0, 0.0)
    low = dataclasses.replace(r, name="low", throughput=np.where(GRID < 6001.2, flat, 0.0))
    high = dataclasses.replace(r, name="high", throughput=np.where(GRID >= 5998.2, 0.25 * flat, 0.0))
    wanted = dataclasses.replace(r, kind="slitless", throughput=np.where(GRID < 6000, 0.5, 1.0) * flat)
    shares = {band.name: share for band, share in band_coefficients(wanted, (low, high))}
    assert shares == pytest.approx({"low": 0.5, "high": 4.0}, rel=1e-3)
    cover = shares["low"] * low.throughput + shares["high"] * high.throughput
    assert (cover - wanted.throughput).min() > -1e-3
