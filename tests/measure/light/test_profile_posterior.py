"""The posterior's parts by hand and against numpy: fits of profiles, cubics, medians, the columns of a source."""

import math

import numpy as np
import pytest

from csstsim.measure.light import profile_posterior, total_light
from csstsim.measure.light.pixels import Pixels
from csstsim.measure.light.profile_posterior import (
    Moments,
    Narrowed,
    NormalEquations,
    Point,
    ProfileFits,
    ProfileMaps,
    Region,
    Samples,
    Scratch,
    _coarse,
    _cubic,
    _median,
    _moments,
    _narrowed,
    _refine,
    posterior,
)


def samples_of(count):
    """Return room for so many samples."""
    return Samples(*np.empty((7, count)))


@pytest.mark.parametrize("position", [0.0, 0.4, 1.0, 3.7, 5.2, 7.0])
def test_a_cubic_through_four_neighbours_is_itself(position):
    weight = np.empty(4)
    first = _cubic.py_func(position, 8, weight)
    at = first + np.arange(4)
    assert 0 <= first <= 4 and abs(np.clip(position, 1, 6) - (first + 1.5)) <= 0.5 + 1e-9
    assert weight @ (2 - at + 0.5 * at**2 - 0.3 * at**3) == pytest.approx(
        2 - position + 0.5 * position**2 - 0.3 * position**3
    )


def test_fluxes_of_profiles_are_a_weighted_least_squares_fit(monkeypatch):
    """Pixel by pixel with numpy: flux and sky, its own prior, rings that weigh by their own mean light; errors."""
    rng = np.random.default_rng(6)
    nodes, (x, y), counted, noise = np.array([0.0, 4.0, 16.0, 49.0, 81.0]), (11.3, 9.6), 0.8, 3.0
    image = rng.normal(5.0, 3.0, (22, 24)).astype(np.float32)
    image[2, 8] = np.nan
    unusable, segments = np.zeros(image.shape, np.uint8), np.zeros(image.shape, np.int32)
    unusable[12, 13], segments[14:18, 4:8], segments[8:12, 8:12] = 1, 7, 3
    image[14:18, 4:8] += 1e4
    profiles = np.array([[0.08, 0.05], [0.05, 0.04], [0.02, 0.03], [0.004, 0.02], [0.001, 0.01]])
    b = total_light.BIN
    which = (np.searchsorted(nodes, 0.25 + 0.5 * np.arange(162), side="right") - 1).astype(np.uint8)
    rings, room, fits = np.empty((4, 5)), np.empty((4, 5)), ProfileFits(*np.empty((3, 2)))
    monkeypatch.setattr(total_light, "_add", total_light._add.py_func)
    pixels = Pixels(image, np.ones_like(image), unusable, segments[::b, ::b])
    total_light._rings.py_func(pixels, 3, x, y, nodes, which, rings)
    normal = total_light._normal.py_func(rings, noise**2, counted, room, 0.03)
    assert normal.pixels == rings[:, 0].sum()
    profile_posterior.project.py_func(profiles, normal, fits)

    row, column = np.indices(image.shape)
    square = (row - y) ** 2 + (column - x) ** 2
    bins = segments[::b, ::b].repeat(b, 0).repeat(b, 1)[:22, :24]
    used = (square < 81) & np.isfinite(image) & (unusable == 0) & ((bins == 0) | (bins == 3))
    ring, data = np.digitize(square[used], nodes) - 1, image[used].astype(float)
    mean = np.bincount(ring, data) / np.bincount(ring)
    weight = 1 / (noise**2 + np.maximum(mean, 0) / counted)[ring]
    assert used.sum() == rings[:, 0].sum() and (mean != 0).all()
    for k in range(2):
        design = np.column_stack([np.interp(square[used], nodes, profiles[:, k]), np.ones(used.sum())])
        matrix = design.T @ (weight[:, None] * design) + np.diag([0, 0.03**-2])
        wanted, covariance = np.linalg.solve(matrix, design.T @ (weight * data)), np.linalg.inv(matrix)
        assert fits.product[k] / fits.weight[k] == pytest.approx(wanted[0], rel=1e-9)
        assert 1 / fits.weight[k] == pytest.approx(covariance[0, 0], rel=1e-9)


def test_rings_darker_than_the_sky_have_its_noise():
    rings = np.array([[4.0, 1.0, 0.5, -80.0, -20.0], [0.0] * 5])
    normal = total_light._normal.py_func(rings, 2.0, 0.5, np.empty((4, 3)), 0.03)
    assert normal.ones.tolist() == pytest.approx([0.5 * 3, 0.5 * 1, 0])
    assert normal.diagonal.tolist() == pytest.approx([0.5 * (4 - 2 + 0.5), 0.5 * 0.5, 0])
    assert normal.upper[0] == 0.25 and normal.data.tolist() == [-30.0, -10.0, 0.0]
    assert [normal.sky_weight, normal.sky_data] == pytest.approx([1 / 0.0009 + 2, -40])


def test_points_of_the_tables_are_their_own_fits():
    """(inverse variance, F times it, fraction, ln population) of two sizes and kinds; a flux below 0 is unlikely."""
    maps = ProfileMaps(
        weight=np.array([[4.0, 2.0], [1.0, 0.5]]),
        product=np.array([[8.0, 6.0], [-3.0, 0.0]]),
        gaap=np.array([[0.1, 0.2], [0.3, 0.4]]),
        log_population=np.array([[-1.0, -2.0], [-3.0, -4.0]]),
    )
    samples = samples_of(4)
    _coarse.py_func(maps, samples)
    assert samples.log_probability.tolist() == [8.0, 9.0, -4.5, 0.0]
    assert samples.log_population.tolist() == [-1.0, -2.0, -3.0, -4.0]
    assert samples.flux.tolist() == [2.0, 3.0, -3.0, 0.0]
    assert samples.variance.tolist() == [0.25, 0.5, 1.0, 2.0]
    assert samples.gaap.tolist() == [0.1, 0.2, 0.3, 0.4]
    assert samples.size.tolist() == [0.0, 0.0, 1.0, 1.0]
    assert samples.kind.tolist() == [0.0, 1.0, 0.0, 1.0]


def test_between_the_tables_sizes_are_cubic_and_kinds_linear(monkeypatch):
    for name in ("project", "_cubic"):
        monkeypatch.setattr(profile_posterior, name, getattr(profile_posterior, name).py_func)
    sizes, kinds = 6, 3

    def profile(size, kind):
        return np.array([3.0 + 0.1 * size + 0.02 * size**3 + kind, 2.0 + 0.3 * size**2 - 0.4 * kind, 1.0 + size])

    grid = [(size, kind) for size in range(sizes) for kind in range(kinds)]
    profiles = np.transpose([profile(*at) for at in grid])
    diagonal, upper = np.array([2.0, 3.0, 1.5]), np.array([0.5, 0.2, 0])
    data, ones = np.array([9.0, 5.0, 2.0]), np.array([1.0, 1.2, 0.7])
    normal = NormalEquations(diagonal, upper, data, ones, sky_weight=40.0, sky_data=11.0, pixels=9.0)
    gaap, log_population = (np.array(grid) @ np.array([[0.1, 1.0], [0.02, -0.5]])).T.reshape(2, sizes, kinds)
    unknown = np.full((sizes, kinds), np.nan)
    maps, samples = ProfileMaps(unknown, unknown, gaap, log_population), samples_of(9)
    _refine.py_func(profiles, normal, maps, Region(0.5, 4.5, 0.25, 1.75), samples)
    wanted = [(size, kind) for size in (0.5, 2.5, 4.5) for kind in (0.25, 1.0, 1.75)]
    assert list(zip(samples.size, samples.kind, strict=True)) == wanted
    for k, (size, kind) in enumerate(wanted):
        p = profile(size, kind)
        matrix = np.diag(diagonal) + np.diag(upper[:2], 1) + np.diag(upper[:2], -1)
        inverse = p @ matrix @ p - (p @ ones) ** 2 / 40
        product = p @ data - (p @ ones) * 11 / 40
        found = [column[k] for column in samples[:5]]
        fit = 0.5 * product**2 / inverse, size - 0.5 * kind, product / inverse, 1 / inverse, 0.1 * size + 0.02 * kind
        assert found == pytest.approx(fit)


def test_moments_are_those_of_probabilities():
    rng = np.random.default_rng(8)
    points = rng.normal(0.0, 2.0, (7, 300))
    points[[0, 5, 6]] += np.array([[900.0], [12.0], [5.0]])
    points[0, 4] -= 1e4
    best, population, *rest = _moments.py_func(Samples(*points))
    w = np.exp(points[0] - points[0].max())
    mean = [np.average(v, weights=w) for v in points[5:]]
    scatter = [np.sqrt(np.average((v - m) ** 2, weights=w)) for v, m in zip(points[5:], mean, strict=True)]
    assert best == points[0].max() and population == pytest.approx((w * np.exp(points[1])).sum())
    assert rest == pytest.approx([mean[0], scatter[0], mean[1], scatter[1]])


def test_medians_are_those_of_weighted_values():
    """Skew values of unequal weights, one far away: as by the sorted sum of weights."""
    rng = np.random.default_rng(9)
    value, weight = rng.gamma(2.0, 50.0, 4000), rng.random(4000)
    weight[value > 150] *= 4
    value[0] = 1e4
    order = np.argsort(value)
    fraction = np.cumsum(weight[order]) / weight.sum()
    low, middle, high = np.interp([0.1587, 0.5, 0.8413], fraction, value[order])
    found, half = _median.py_func(value, weight)
    assert found == pytest.approx(middle, abs=1) and half == pytest.approx((high - low) / 2, abs=3)
    assert _median.py_func(np.full(5, 3.0), weight[:5]) == (pytest.approx(3.0), 0.0)


def test_columns_of_a_source_are_those_of_four_profiles_and_a_point(monkeypatch):
    """Weights 0.1, 0.4, 0.3, 0.2 of profiles of area 1/2, all and those of the population, and 0.25 of the point.

    Medians, intervals and errors by hand.
    """
    fluxes, variance, fraction = (
        np.array([100.0, 200, 300, 400]),
        np.array([9.0, 16, 25, 36]),
        np.array([0.5, 0.8, 0.4, 0.6]),
    )
    weight = np.array([0.1, 0.4, 0.3, 0.2])
    population = np.array([0.1, 0.3, 0.2, 0.4])
    log_probability = np.log(weight) + 700
    log_population = np.log(2 * population / weight)
    samples = Samples(log_probability, log_population, fluxes, variance, fraction, np.arange(4.0), np.zeros(4))
    moments = Moments(log_probability.max(), np.nan, np.nan, 3.0, 4.0, 1.0)
    monkeypatch.setattr(profile_posterior, "_narrowed", lambda *given: Narrowed(samples, 0.5, moments))
    monkeypatch.setattr(profile_posterior, "_median", _median.py_func)
    star = Point(700 + math.log(0.25), 250.0, 49.0)
    out = posterior.py_func(None, None, None, star, Scratch(None, None, np.empty(9), np.empty(9)))
    noise = 0.8 * population @ variance + 0.2 * 49
    assert out.point == pytest.approx(0.2) and out.size == pytest.approx(population @ np.arange(4.0))
    assert out.evidence == pytest.approx(700)  # area 1/2, and twice the population's fractions
    assert out.total == pytest.approx(250)  # the point; of all: 0.08 and 0.32 below, 0.24 and 0.16 above
    # of the population: 0.08, 0.24, 0.2 (the point), 0.16, 0.32
    assert out.total_error == pytest.approx(math.sqrt(100**2 + noise + (0.8 * 0.025 * 250) ** 2))  # 200 to 400
    assert out.gaap == pytest.approx(240)  # 50, 120, 160, 240 and 250
    assert out.gaap_error == pytest.approx(
        math.sqrt(65**2 + 0.8 * population @ (variance * fraction**2) + 0.2 * 49)
    )  # 120 to 250


@pytest.mark.parametrize(("advantage", "flux"), [(0.0, 200), (2.0, 200), (20.0, 300), (-20.0, 100)])
def test_the_flux_heeds_the_population_little(monkeypatch, advantage, flux):
    """Of 100, 200, 300, as likely by the pixels; one is exp(2) or exp(20) times as frequent, which counts 1.3 or 20."""
    population = np.array([0.0, 0.0, advantage])
    if advantage < 0:
        population = np.array([-advantage, 0.0, 0.0])
    fluxes = np.array([100.0, 200.0, 300.0])
    samples = Samples(np.zeros(3), population, fluxes, np.ones(3), np.ones(3), np.arange(3.0), np.zeros(3))
    moments = Moments(0.0, 1.0, 1.0, 0.0, 0.0, 0.0)
    monkeypatch.setattr(profile_posterior, "_narrowed", lambda *given: Narrowed(samples, 1.0, moments))
    monkeypatch.setattr(profile_posterior, "_median", _median.py_func)
    star = Point(-1e6, 0.0, 1.0)
    out = posterior.py_func(None, None, None, star, Scratch(None, None, np.empty(9), np.empty(9)))
    assert out.total == pytest.approx(flux)


@pytest.mark.parametrize("log_odds", [-1e6, -300.0, 300.0, 1e6])
def test_a_certain_point_or_galaxy_has_its_flux(monkeypatch, log_odds):
    samples = Samples(*(np.array([v, v]) for v in (50.0, 0.0, 80.0, 4.0, 0.5, 2.0, 0.0)))
    moments = Moments(50.0, 2.0, 2.0, 0.0, 0.0, 0.0)
    monkeypatch.setattr(profile_posterior, "_narrowed", lambda *given: Narrowed(samples, 0.5, moments))
    monkeypatch.setattr(profile_posterior, "_median", _median.py_func)
    scratch = Scratch(None, None, np.empty(9), np.empty(9))
    out = posterior.py_func(None, None, None, Point(50.0 + log_odds, 120.0, 9.0), scratch)
    is_point = log_odds > 0
    assert out.point == pytest.approx(float(is_point)) and out.total == pytest.approx(120 if is_point else 80)
    assert out.total_error == pytest.approx(3.0 if is_point else math.hypot(2.0, 2.0))
    assert out.gaap == pytest.approx(120 if is_point else 40)


@pytest.mark.parametrize(("star", "called"), [(-1e9, 2), (107.0, 2), (108.0, 0)])
def test_a_narrow_posterior_is_refined_about_its_mean_unless_it_is_a_point(monkeypatch, star, called):
    """Twice here: first 1.5 steps of the tables either way, cut at their ends, then three of its scatter."""
    windows = []

    def refine(profiles, normal, maps, region, samples):
        windows.append(list(region))

    found = iter(
        [
            Moments(100.0, 1.5, 20.0, 0.4, 8.5, 0.2),
            Moments(100.0, 1.5, 20.5, 0.5, 8.0, 0.15),
            Moments(100.0, 1.5, 21.0, 0.5, 8.0, 0.4),
        ]
    )
    monkeypatch.setattr(profile_posterior, "_coarse", lambda maps, samples: None)
    monkeypatch.setattr(profile_posterior, "_moments", lambda samples: next(found))
    monkeypatch.setattr(profile_posterior, "_refine", refine)
    maps, coarse, fine = ProfileMaps(None, None, np.empty((33, 10)), None), "coarse", "fine"
    samples, area, moments = _narrowed.py_func(None, None, maps, Point(star, 0.0, 1.0), coarse, fine)
    assert len(windows) == called and samples == (fine if called else coarse)
    if called:
        assert windows[0] == pytest.approx([18.5, 21.5, 7.0, 9.0])
        assert windows[1] == pytest.approx([19.0, 22.0, 7.55, 8.45])
        assert area == pytest.approx(3 / 12 * 0.9 / 12) and moments.size == 21.0
    else:
        assert area == 1.0 and moments.size == 20.0
