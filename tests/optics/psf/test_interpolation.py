"""Interpolation between PSF nodes: polynomials, hulls, dead and doubled nodes; against scipy."""

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator
from scipy.spatial import ConvexHull, cKDTree

from csstsim.base.errors import InputError
from csstsim.optics.psf.interpolation import METHODS, Interpolator

SIDE_X, SIDE_Y = 9215.5, 9231.5


def grid(nx, ny=None):
    """Nodes over a chip, x fastest."""
    x, y = np.linspace(-0.5, SIDE_X, nx), np.linspace(-0.5, SIDE_Y, ny or nx)
    return np.stack([np.tile(x, y.size), np.repeat(y, x.size)], axis=1)


def positions(count, seed=1):
    rng = np.random.default_rng(seed)
    return rng.uniform(-0.5, SIDE_X, count), rng.uniform(-0.5, SIDE_Y, count)


def value(mixture, field, x, y):
    """The interpolated value of `field` (m,), given at the nodes."""
    index, weight, _ = mixture(x, y)
    return np.einsum("...k,...k->...", weight, field[index])


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("size", [1, 2, 3, 4, 7])
def test_weights_sum_to_one_and_are_convex_if_said(method, size):
    mixture = Interpolator(grid(size), method)
    index, weight, outside = mixture(*positions(500))
    assert weight.sum(axis=1) == pytest.approx(1.0, abs=1e-14)
    assert (index >= 0).all() and (index < size**2).all()
    assert outside.all() if size == 1 else not outside.any()
    assert mixture.convex == (method != "bicubic")
    # bicubic really goes below zero where it has four nodes to a side; else it says less than it could
    assert (weight >= 0).all() == (mixture.convex or size < 3)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("size", [1, 2, 5])
def test_at_a_node_it_is_the_node(method, size):
    nodes = grid(size)
    index, weight, outside = Interpolator(nodes, method)(*nodes.T)
    assert np.array_equal(index[np.arange(size**2), weight.argmax(axis=1)], np.arange(size**2))
    assert np.array_equal(np.sort(weight, axis=1)[:, -1], np.ones(size**2))
    assert np.count_nonzero(weight) == size**2
    assert not outside.any()


def polynomials(degree):
    return [(i, j) for i in range(degree + 1) for j in range(degree + 1)]


@pytest.mark.parametrize(
    ("method", "size", "degree"),
    [("bilinear", 2, 1), ("bilinear", 6, 1), ("bicubic", 3, 2), ("bicubic", 4, 3), ("bicubic", 9, 3)],
)
def test_polynomials_are_reproduced_up_to_the_edges(method, size, degree):
    nodes, (x, y) = grid(size), positions(300)
    mixture = Interpolator(nodes, method)
    for i, j in polynomials(degree):
        exact = (x / SIDE_X) ** i * (y / SIDE_Y) ** j
        at_nodes = (nodes[:, 0] / SIDE_X) ** i * (nodes[:, 1] / SIDE_Y) ** j
        assert value(mixture, at_nodes, x, y) == pytest.approx(exact, abs=1e-12)
    beyond = (nodes[:, 0] / SIDE_X) ** (degree + 1)
    assert np.abs(value(mixture, beyond, x, y) - (x / SIDE_X) ** (degree + 1)).max() > 1e-5


def test_bilinear_is_scipys_on_uneven_rows_and_columns():
    rng = np.random.default_rng(2)
    x, y = np.cumsum(rng.uniform(500, 1500, 5)), np.cumsum(rng.uniform(300, 1100, 7))
    nodes = np.stack([np.tile(x, 7), np.repeat(y, 5)], axis=1)
    field = rng.normal(size=35)
    at = rng.uniform(x[0], x[-1], 200), rng.uniform(y[0], y[-1], 200)
    peer = RegularGridInterpolator((y, x), field.reshape(7, 5))(at[::-1])
    assert value(Interpolator(nodes), field, *at) == pytest.approx(peer, abs=1e-12)
    shuffled = rng.permutation(35)  # nodes in any order
    assert value(Interpolator(nodes[shuffled]), field[shuffled], *at) == pytest.approx(peer, abs=1e-12)


def test_a_bent_grid_is_a_grid_within_a_twentieth_of_a_cell():
    nodes = grid(10)
    bend = 40 * np.sin(nodes[::, ::-1] / 3000)  # px, of cells of 1024
    field = nodes[:, 0] / SIDE_X
    x, y = positions(200)
    mixture = Interpolator(nodes + bend)
    assert np.abs(value(mixture, (nodes + bend)[:, 0] / SIDE_X, x, y) - x / SIDE_X).max() < 2 * 40 / SIDE_X
    assert value(mixture, field, x, y) == pytest.approx(value(Interpolator(nodes), field, x, y), abs=2 * 40 / SIDE_X)
    with pytest.raises(InputError, match="no grid"):
        Interpolator(nodes + 2 * bend)


def test_error_falls_with_the_power_that_is_said():
    """Twice the cells, a smooth wave of a fifth of a turn over the chip; largest error of 20,000 positions."""

    def wave(x, y):
        return np.cos(1.3 * x / SIDE_X + 0.4) * np.sin(1.1 * y / SIDE_Y)

    def error(method, size):
        x, y = positions(20000)
        return np.abs(value(Interpolator(grid(size), method), wave(*grid(size).T), x, y) - wave(x, y)).max()

    gain = {method: error(method, 9) / error(method, 17) for method in METHODS}
    assert gain["idw"] == pytest.approx(2, rel=0.2)
    assert gain["bilinear"] == pytest.approx(4, rel=0.1)
    assert gain["bicubic"] == pytest.approx(16, rel=0.2)


@pytest.mark.parametrize(("beta", "neighbours"), [(2.0, 4), (1.0, 3), (6.5, 1), (300.0, 5)])
def test_idw_is_equation_3_of_the_nearest_of_scattered_nodes(beta, neighbours):
    nodes = np.stack(positions(50, seed=7), axis=1)
    x, y = positions(300)
    index, weight, outside = Interpolator(nodes, "idw", beta=beta, neighbours=neighbours)(x, y)
    distance, nearest = cKDTree(nodes).query(np.stack([x, y], axis=1), np.arange(1, neighbours + 1))
    power = (distance / distance[:, :1]) ** -beta
    assert np.array_equal(index, nearest)
    assert weight == pytest.approx(power / power.sum(axis=1, keepdims=True), rel=1e-9, abs=1e-300)
    planes = ConvexHull(nodes).equations
    beyond = (np.stack([x, y], axis=1) @ planes[:, :2].T + planes[:, 2]).max(axis=1) > 1e-6
    assert 0 < beyond.sum() < 300
    assert np.array_equal(outside, beyond)


def test_nodes_equally_far_go_by_their_number():
    mixture = Interpolator(grid(3), "idw")
    middle = (9215.5 - 0.5) / 2, (9231.5 - 0.5) / 2  # node 4, then 1 and 7 (a little farther than 3, 5)
    index, weight, _ = mixture(*middle)
    assert (index[0], weight.tolist()) == (4, [1, 0, 0, 0])
    assert set(index[1:3]) == {3, 5} and index[3] == 1
    x, y = positions(100, seed=4)
    index, weight, _ = mixture(x, y)
    mirrored, same, _ = mixture(9215 - x, y)
    assert np.array_equal(mirrored, index // 3 * 3 + 2 - index % 3)
    assert same == pytest.approx(weight, abs=1e-9)


def test_between_and_on_doubled_nodes():
    nodes = np.array([[0.0, 0.0], [100.0, 0.0], [100.0, 0.0], [0.0, 100.0]])
    mixture = Interpolator(nodes, "idw")
    index, weight, _ = mixture(100.0, 0.0)
    assert (index[weight == 1].tolist(), weight.sum()) == ([1], 1.0)
    index, weight, outside = mixture(50.0, 0.0)
    assert dict(zip(index.tolist(), weight.round(12), strict=True)) == pytest.approx(
        {0: 0.3125, 1: 0.3125, 2: 0.3125, 3: 0.0625}
    )
    assert not outside
    # nodes 1e-7 px apart are one position; 1e-3 px apart they share by distance
    close = Interpolator(np.array([[0.0, 0.0], [1e-7, 0.0], [9.0, 9.0]]), "idw")(5e-8, 0.0)[1]
    assert sorted(close) == [0, 0, 1]
    shared = Interpolator(np.array([[0.0, 0.0], [1e-3, 0.0], [9.0, 9.0]]), "idw")(5e-4, 0.0)[1]
    assert sorted(shared) == pytest.approx([0, 0.5, 0.5], abs=1e-8)


@pytest.mark.parametrize("method", ["bilinear", "bicubic"])
def test_scattered_and_doubled_nodes_are_no_grid(method):
    doubled = np.vstack([grid(3), grid(3)[4]])
    for nodes in (np.stack(positions(9), axis=1), doubled, np.diag([100.0, 200.0]), grid(3)[:8]):
        with pytest.raises(InputError, match=rf"set\.h5: nodes_xy: the nodes form no grid.*{method}"):
            Interpolator(nodes, method, file="set.h5")


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("broken", [0, 2, 12, 24])
def test_a_dead_node_is_never_used_and_matters_only_nearby(method, broken):
    nodes, dead = grid(5), np.arange(25) == broken
    mixture, whole = Interpolator(nodes, method, dead=dead), Interpolator(nodes, method)
    x, y = (np.concatenate(pair) for pair in zip(positions(500), nodes.T, strict=True))
    index, weight, outside = mixture(x, y)
    assert broken not in index
    assert weight.sum(axis=1) == pytest.approx(1.0, abs=1e-14)
    assert outside.any() == (broken in (0, 24)), "a dead corner takes its triangle off the hull"
    field = np.hypot(*(nodes / SIDE_X - 0.3).T)
    got, reference = value(mixture, field, x, y), value(whole, field, x, y)
    away = np.abs(np.stack([x, y]) - nodes[broken][:, None]).max(axis=0) > 2.01 * 9232 / 4
    assert np.array_equal(got[away], reference[away])
    assert np.abs(got - reference).max() < 0.25, "within a node spacing"
    at = np.flatnonzero(~dead)
    assert np.array_equal(value(mixture, field, *nodes[at].T), field[at])


def test_beside_a_dead_node_the_next_simpler_method():
    nodes, dead = grid(5), np.arange(25) == 12
    x, y = positions(400)
    column, row = (np.minimum((at + 0.5) // (side / 4), 3) for at, side in ((x, 9216), (y, 9232)))
    cell_dead = ((column == 1) | (column == 2)) & ((row == 1) | (row == 2))
    index, weight, _ = Interpolator(nodes, "bicubic", dead=dead)(x, y)
    for method, where in (("bilinear", ~cell_dead), ("idw", cell_dead)):  # every 4 x 4 stencil of 5 holds the middle
        expected, fraction, _ = Interpolator(nodes, method, dead=dead)(x[where], y[where])
        assert np.array_equal(index[where, :4], expected)
        assert np.array_equal(weight[where, :4], fraction)
        assert not weight[where, 4:].any()
    many = Interpolator(nodes, "bilinear", dead=dead, neighbours=9)(x, y)
    assert many[1].shape == (400, 9)
    assert many[1].sum(axis=1) == pytest.approx(1.0, abs=1e-14)


@pytest.mark.parametrize("method", METHODS)
def test_few_live_nodes(method):
    nodes = grid(2)
    for live in ([3], [0, 3], [0, 1, 3]):
        dead = ~np.isin(np.arange(4), live)
        index, weight, _ = Interpolator(nodes, method, dead=dead)(*positions(50))
        assert np.isin(index, live).all()
        assert weight.sum(axis=1) == pytest.approx(1.0, abs=1e-14)
    with pytest.raises(InputError, match="no node is alive"):
        Interpolator(nodes, method, dead=np.ones(4, bool))


@pytest.mark.parametrize("method", METHODS)
def test_outside_is_flagged_and_never_extrapolated(method):
    nodes = grid(4)
    mixture = Interpolator(nodes, method)
    x = np.array([-0.4, -0.6, 9215.4, 9216.0, 5000.0, -3e9])
    y = np.array([0.0, 0.0, 9231.0, 9231.0, 9300.0, -3e9])
    index, weight, outside = mixture(x, y)
    assert outside.tolist() == [False, True, False, True, True, True]
    assert weight.sum(axis=1) == pytest.approx(1.0, abs=1e-12)
    if method != "idw":  # the nearest place of the edge
        edge = mixture(np.clip(x, -0.5, SIDE_X), np.clip(y, -0.5, SIDE_Y))
        assert np.array_equal(index, edge[0])
        assert np.array_equal(weight, edge[1])


def test_hull_of_one_two_and_collinear_nodes():
    for nodes, inside, beyond in [
        ([[5.0, 6.0]], [(5, 6)], [(5.1, 6), (5, 5.9)]),
        ([[0.0, 0.0], [4.0, 2.0]], [(0, 0), (2, 1), (4, 2)], [(2, 1.1), (6, 3), (-2, -1)]),
        ([[0.0, 0.0], [4.0, 2.0], [2.0, 1.0], [2.0, 1.0]], [(1, 0.5), (3, 1.5)], [(3, 1.6), (6, 3)]),
    ]:
        mixture = Interpolator(np.array(nodes), "idw")
        assert not mixture(*np.array(inside, float).T)[2].any()
        assert mixture(*np.array(beyond, float).T)[2].all()


@pytest.mark.parametrize("method", METHODS)
def test_shapes_and_bits(method):
    mixture = Interpolator(grid(6), method)
    x, y = positions(200)
    index, weight, outside = mixture(x, y)
    k = index.shape[1]
    for shape in ((), (0,), (1,), (2, 3)):
        got = mixture(np.full(shape, x[0]), np.full(shape, y[0]))
        assert [part.shape for part in got] == [(*shape, k), (*shape, k), shape]
    order = np.random.default_rng(6).permutation(200)
    for part, whole in zip(mixture(x[order], y[order]), (index, weight, outside), strict=True):
        assert np.array_equal(part, whole[order]), "no position hangs on the others"


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_positions_must_be_finite(method, bad):
    with pytest.raises(ValueError, match="not finite"):
        Interpolator(grid(3), method)([1.0, bad], 2.0)


def test_unknown_method():
    with pytest.raises(InputError, match=r"psf\.interpolation: unknown .*'cubic'.*idw, bilinear, bicubic"):
        Interpolator(grid(3), "cubic")
