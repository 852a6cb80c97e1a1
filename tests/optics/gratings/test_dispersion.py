"""The two gratings of a chip as arrays: bins that lose no electron, the PSF's mixture, which grating light passes."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import trapezoid
from support.grating_scene import GV, SPLIT, disperser_of

from csstsim.instrument.axe import COEFFICIENTS
from csstsim.instrument.filter import GRID
from csstsim.optics.gratings.dispersion import Disperser

SLITLESS = 1, GV, 3  # GI, GV, GU


@pytest.mark.parametrize("chip", SLITLESS)
def test_bins_hold_all_electrons_and_are_a_quarter_pixel(camera, chip):
    disperser = disperser_of(camera, chip)
    assert np.isin(disperser.edges, GRID).all() and np.ptp(np.diff(disperser.edges)) == 0
    for i, (grating, (x0, x1, y0, y1)) in enumerate(disperser.gratings.pieces):
        for o, number in enumerate(disperser.orders):
            order = grating.orders[number]
            whole = np.trapezoid(order.throughput, GRID) * camera.telescope.area_m2
            assert disperser.rates[i, o].sum() == pytest.approx(whole, rel=1e-6)
        q = grating.orders[1].lines(0.5 * (x0 + x1), 0.5 * (y0 + y1))[1]
        assert abs(q) * np.diff(disperser.edges[:2]) <= 0.25
    flat = np.array([camera.filters[camera.chips[chip].filter].throughput])
    first = np.trapezoid(flat, GRID)[0] * camera.telescope.area_m2
    assert disperser.rates[:, disperser.orders.index(1)].sum(axis=1) == pytest.approx(first, rel=2e-3)


@pytest.mark.parametrize("chip", SLITLESS)
def test_coarse_bins_are_a_pixel_and_hold_the_same_electrons(camera, chip):
    fine = disperser_of(camera, chip)
    coarse = fine.coarse
    assert coarse.rates.sum(axis=2) == pytest.approx(fine.rates.sum(axis=2), rel=1e-9)
    q = max(abs(piece.orders[1].lines(4608.0, 4616.0)[1]) for piece, _ in fine.gratings.pieces)
    assert 0.9 < q * np.diff(coarse.edges[:2])[0] <= 1.02
    assert coarse.lines(np.array([[0, 0, 0]]), np.array([4000.0]), np.array([4000.0])) == pytest.approx(
        fine.lines(np.array([[0, 0, 0]]), np.array([4000.0]), np.array([4000.0]))
    )


@pytest.mark.parametrize("chip", SLITLESS)
def test_the_psf_is_linear_between_its_wavelengths_and_held_beyond(camera, chip):
    disperser = disperser_of(camera, chip)
    lower, upper = disperser.psf_mixture
    assert lower.min() >= 0 and lower.max() <= 2 and upper.min() == 0 and upper.max() == 1
    waves = 0.5 * (disperser.edges[1:] + disperser.edges[:-1])
    w = disperser.wavelengths
    assert (1 - upper) * w[lower] + upper * w[lower + 1] == pytest.approx(waves.clip(w[0], w[3]))


def test_a_visit_is_a_piece_that_light_meets(camera):
    disperser = disperser_of(camera, GV)
    (x0, _, y0, _), (_, x1, _, y1) = disperser.rectangles
    x = np.array([SPLIT - 30, SPLIT - 10, SPLIT + 10, x0 - 30, x0 - 10, x1 + 10, 4000, 4000, np.nan])
    y = np.array([4000.0, 4000, 4000, 4000, 4000, 4000, y0 + 10, y1 + 25, 4000])
    found = {tuple(v) for v in disperser.visits(x, y, np.full(9, 20.0)).tolist()}
    assert found == {(0, 0, 0), (1, 0, 1), (1, 1, 1), (2, 0, 1), (2, 1, 1), (4, 0, 1), (5, 1, 1), (6, 0, 1)}


def test_boxes_and_lines_are_the_orders(camera):
    """Corners of the box are the ends of the trace; an order that one grating lacks is not a number, and dark."""
    gratings = camera.gratings[GV]
    fewer = replace(gratings.right, orders={k: v for k, v in gratings.right.orders.items() if k > -2})
    disperser = Disperser(replace(gratings, right=fewer), camera.filters["GV"], camera.telescope)
    assert disperser.orders == [-2, -1, 0, 1, 2]
    x, y = np.array([5000.0, 6000.0]), np.array([3000.0, 7000.0])
    visits = disperser.visits(x, y, np.full(2, 20.0))
    box, lines = disperser.boxes(visits, x, y), disperser.lines(visits, x, y)
    assert np.isnan(box[1, 0]).all() and not lines[1, 0].any() and not disperser.rates[1, 0].any()
    for v, grating in enumerate((gratings.left, fewer)):
        for number, order in grating.orders.items():
            p, q, r, s = order.lines(x[v], y[v])
            ends = np.array(order.range)
            u, w = x[v] + p + q * ends, y[v] + r + s * ends
            o = disperser.orders.index(number)
            assert box[v, o] == pytest.approx([u.min(), u.max(), w.min(), w.max()], abs=1e-9)
            assert lines[v, o] == pytest.approx([p, q, r, s], abs=1e-12)


def test_rates_are_the_throughputs_integral_bin_by_bin(camera):
    """By scipy's trapezoids on the samples of each bin."""
    disperser = disperser_of(camera, GV)
    at = np.searchsorted(GRID, disperser.edges)
    for piece, (grating, _) in enumerate(disperser.gratings.pieces):
        for number, order in grating.orders.items():
            wanted = [trapezoid(order.throughput[a : b + 1], GRID[a : b + 1]) for a, b in pairwise(at)]
            rates = disperser.rates[piece, disperser.orders.index(number)] / camera.telescope.area_m2
            assert rates == pytest.approx(np.array(wanted), rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("piece", [0, 1])
@pytest.mark.parametrize("side", range(4))
def test_light_that_reaches_over_any_side_of_a_piece_visits_it(camera, piece, side):
    disperser = disperser_of(camera, GV)
    x0, x1, y0, y1 = disperser.rectangles[piece]
    out, reach = np.array([19.0, 21.0]), np.full(2, 20.0)  # px beyond the side: within reach, and not
    x, y = np.full(2, 0.5 * (x0 + x1)), np.full(2, 0.5 * (y0 + y1))
    position = [x0 - out, x1 + out, y0 - out, y1 + out][side]
    x, y = (position, y) if side < 2 else (x, position)
    visits = disperser.visits(x, y, reach)
    assert visits[visits[:, 1] == piece][:, 0].tolist() == [0]
    assert visits[visits[:, 1] == piece][:, 2].tolist() == [1]  # part of its square is beyond


@pytest.mark.parametrize("side", ["left", "right"])
def test_bins_are_fine_enough_for_the_grating_that_disperses_more(camera, side):
    """One of the two gratings spreads its light twice as far: its pixel has four bins, and its spectrum is `length`."""
    gratings = camera.gratings[GV]
    grating = getattr(gratings, side)
    first = grating.orders[1]
    wide = first.coefficients * np.where(np.array(list(COEFFICIENTS)) == "alpha1", 0.5, 1.0)[:, None]
    changed = replace(grating, orders=grating.orders | {1: replace(first, coefficients=wide)})
    filter_ = camera.filters[camera.chips[GV].filter]
    disperser = Disperser(replace(gratings, **{side: changed}), filter_, camera.telescope)
    plain = disperser_of(camera, GV)
    assert np.diff(disperser.edges)[0] <= 0.55 * np.diff(plain.edges)[0]
    assert disperser.length == pytest.approx(2 * plain.length, rel=0.05)


def test_electrons_go_with_the_area_of_the_telescope(camera):
    gratings, filter_ = camera.gratings[GV], camera.filters[camera.chips[GV].filter]
    small = Disperser(gratings, filter_, replace(camera.telescope, diameter_m=camera.telescope.diameter_m / 2))
    assert small.rates == pytest.approx(disperser_of(camera, GV).rates / 4, rel=1e-12)
