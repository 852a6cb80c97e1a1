"""Charge transfer against the clock's own order, closed forms and another code; charge is conserved."""

import numpy as np
import pytest
from scipy.stats import chi2_contingency, chisquare, poisson
from support.cti_clock import DENSITY, KEYS, TAU, TRAPS, WELL, clocked, scene, traps_of, wait_of
from support.cti_peer import COLUMN_ROWS, SKY, TAILS, arctic_spot, spot_column

from csstsim.base.counter import word
from csstsim.detector.charge_transfer.cti import transfer
from csstsim.detector.charge_transfer.parameters import Columns, Register, trap_model
from csstsim.detector.charge_transfer.serial import transfer_rows
from csstsim.detector.charge_transfer.traps import volume

SIGMA5 = 5.7e-7  # probability beyond 5 sigma


@pytest.mark.parametrize("sky", [0.5, 40])
@pytest.mark.parametrize(("n_rows", "times"), [(500, 1), (100, 20)])
def test_event_by_event_is_transfer_by_transfer(sky, n_rows, times):
    """The same traps and waiting times give the same electrons, every one: blocks, bounds and jumps hide nothing."""
    overscan, density = 30, times * np.array(DENSITY)
    image = scene(np.random.default_rng(3), (n_rows, 3), sky)
    out = image.copy()
    trail, trapped = transfer(out, trap_model(density, TAU, WELL), KEYS, Columns(overscan=overscan, x0=5))
    total = 0
    for column in range(3):
        own = [np.uint64(word(key, np.uint64(5 + column))) for key in KEYS]
        packets = [int(n) for n in image[:, column]] + [0] * overscan
        moved, left = clocked(packets, traps_of(own[0], n_rows, density, fullest=max(packets)), wait_of(own[1]))
        assert np.array_equal(np.concatenate([out[:, column], trail[:, column]]), moved)
        total += left
    assert total == trapped
    assert not np.array_equal(out, image)


def independent(rng, image, density, overscan):
    """The paper's process once more, by numpy: traps pixel by pixel, a chance of release at each transfer."""
    n_rows, n = image.shape
    numbers = rng.poisson(density, (n_rows, n, len(density)))
    slots = numbers.sum(2).max()
    order = np.full((n_rows, n, slots), -1)
    place = np.arange(slots)
    ends = numbers.cumsum(2)
    for s in range(3):
        inside = (place >= (ends - numbers)[..., s, None]) & (place < ends[..., s, None])
        order[inside] = s
    mark = np.where(order < 0, 2.0, rng.random(order.shape))
    chance = 1 - np.exp(-1 / np.array(TAU))[order]
    filled = np.zeros(order.shape, bool)
    packets = np.concatenate([image.astype(int), np.zeros((overscan, n), int)])
    for time in range(len(packets)):
        rows = min(n_rows, len(packets) - time)
        here = packets[time : time + rows]
        for slot in range(slots):
            below, was = mark[:rows, :, slot] < volume(here, *WELL), filled[:rows, :, slot]
            taken = below & ~was
            freed = was & ~below & (rng.random(was.shape) < chance[:rows, :, slot])
            here += freed.astype(int) - taken
            filled[:rows, :, slot] = (was | taken) & ~freed
    return packets, filled.sum((0, 2))


def test_distribution_of_an_independent_simulation():
    """A spot of 3000 e- on 6 e- of sky, 1500 columns: numbers left, released and trapped have one distribution."""
    n_rows, n, overscan, density = 30, 1500, 12, 6 * np.array(DENSITY)
    image = np.random.default_rng(1).poisson(6.0, (n_rows, n)).astype(np.float32)
    image[22] = 3000
    packets, trapped = independent(np.random.default_rng(2), image, density, overscan)
    out = image.copy()
    trail, _ = transfer(out, trap_model(density, TAU, WELL), KEYS, Columns(overscan=overscan))
    ours = np.concatenate([out, trail])
    for name, one, other in (
        ("spot", packets[22], ours[22]), ("first behind", packets[23], ours[23]),
        ("sixth behind", packets[28], ours[28]), ("front", packets[:8].sum(0), ours[:8].sum(0)),
        ("overscan", packets[30:].sum(0), ours[30:].sum(0)), ("trapped", trapped, image.sum(0) - ours.sum(0)),
    ):  # fmt: skip
        edges = np.unique(np.quantile(np.concatenate([one, other]), np.linspace(0, 1, 12)))
        edges[-1] += 1
        table = [np.histogram(values, edges)[0] for values in (one, other)]
        assert len(edges) > 3
        assert chi2_contingency(table).pvalue > SIGMA5, name


def test_traps_are_poisson_in_pixels_and_uniform_in_watermark():
    rows = [pixel for column in range(20) for pixel in traps_of(np.uint64(column), 4616)]
    number = np.bincount([len(pixel) for pixel in rows])
    expected = len(rows) * poisson(sum(DENSITY)).pmf(np.arange(len(number)))
    expected[5] = len(rows) * poisson(sum(DENSITY)).sf(4)
    assert chisquare([*number[:5], number[5:].sum()], expected[:6]).pvalue > SIGMA5
    level, tau = np.array([(trap[1], trap[2]) for pixel in rows for trap in pixel]).T
    edges = np.array([0, 1, 3, 10, 40, 100, 1000, 1e4, 4e4, 85200, 1e9])  # reached by N: V(N) of the traps
    for density, timescale in zip(DENSITY, TAU, strict=True):
        own = level[tau == timescale]
        mean = len(rows) * density
        assert abs(len(own) - mean) < 5 * np.sqrt(mean)
        share = np.diff(np.minimum(volume(edges, *WELL), 1))[:-1]
        found = np.histogram(own, edges[:-1] + 0.5)[0]
        assert chisquare(found, share / share.sum() * found.sum()).pvalue > SIGMA5
    assert level.min() >= 1 and level.max() <= 85201


def test_traps_do_not_depend_on_the_image():
    """Those that a lesser packet can feel are the same whatever else is on the chip."""
    key = np.uint64(8)
    every = {trap for pixel in traps_of(key, 500) for trap in pixel}
    some = {trap for pixel in traps_of(key, 500, fullest=700) for trap in pixel}
    assert {trap for trap in every if trap[1] <= 700} == some


def test_extended_pixel_edge_response():
    """One row of 2e4 e-, 40000 columns; a notch above anything released rules out recapture, so that all is Poisson.

    Overscan packet m holds rho V q^(m - 1) (1 - q) of each species, q = exp(-1 / tau); within 5 sigma.
    """
    n, overscan, charge, well = 40000, 60, 20000, (0.492, 85200.0, 50.0)
    image = np.full((1, n), charge, np.float32)
    trail, trapped = transfer(image, trap_model(DENSITY, TAU, well), KEYS, Columns(overscan=overscan))
    caught = np.array(DENSITY) * volume(charge, *well)
    q = np.exp(-1 / np.array(TAU))
    m = np.arange(1, overscan + 1)[:, None]
    expected = (caught * q ** (m - 1) * (1 - q)).sum(1)
    assert (abs(trail.mean(1, dtype=float) - expected) < 5 * np.sqrt(expected / n)).all()
    assert abs(trapped / n - (caught * q**overscan).sum()) < 5 * np.sqrt(caught.sum() / n)
    lost = charge - image[0]
    assert abs(lost.mean() - caught.sum()) < 5 * np.sqrt(caught.sum() / n)
    assert abs(lost.var() / caught.sum() - 1) < 5 * np.sqrt((2 + 1 / caught.sum()) / n)


@pytest.mark.parametrize("row", sorted(TAILS))
def test_against_arctic(row):
    """A spot over 3 rows of 5000 e-, 1500 columns or more: what it loses and the trail in three parts, within 3%.

    Both as differences from the same column without the spot; TAILS is what arcticpy gives (cti_peer.py).
    """
    n, change = max(1500, 3000000 // row), {}
    for spot in (True, False):
        image = np.repeat(spot_column(row, spot)[:, None], n, 1)
        transfer(image, TRAPS, KEYS)
        change[spot] = image.mean(1, dtype=float) - spot_column(row, spot)
    difference = change[True] - change[False]
    parts = [difference[row + a : row + b].sum() for a, b in COLUMN_ROWS]
    assert parts == pytest.approx(list(TAILS[row]), rel=0.03)


def test_arctic_numbers():
    """The numbers above are arcticpy's."""
    pytest.importorskip(
        "arcticpy",
        reason="arcticpy is not installed: it needs GSL and a compiler (csstsim.studies.bench.readout.arctic)",
    )
    for row, parts in TAILS.items():
        assert arctic_spot(row, DENSITY, TAU, WELL) == pytest.approx(list(parts), abs=0.02)


@pytest.mark.parametrize(("move", "line"), [(transfer, Columns(overscan=84)), (transfer_rows, Register(overscan=84))])
@pytest.mark.parametrize("tau", [0.1, 1.0, 1e4])
@pytest.mark.parametrize("times", [1, 100])
def test_charge_is_conserved(times, tau, move, line):
    image = scene(np.random.default_rng(5), (600, 40), SKY)
    out = image.copy()
    density = times * np.array(DENSITY)
    trail, trapped = move(out, trap_model(density, np.array(TAU) * tau, WELL), KEYS, line)
    assert out.min() >= 0 and trail.min() >= 0
    assert trapped > 0 or tau < 1
    assert image.sum(dtype=float) == out.sum(dtype=float) + trail.sum(dtype=float) + trapped


def test_no_traps_no_change():
    image = np.random.default_rng(0).normal(3, 20, (50, 70)).astype(np.float32)
    out = image.copy()
    trail, trapped = transfer(out, trap_model(np.zeros(3), TAU, WELL), KEYS, Columns(overscan=4))
    assert np.array_equal(out, image) and not trail.any() and trapped == 0


@pytest.mark.parametrize("move", [transfer, transfer_rows])
def test_fractions_and_negative_charge_stay_with_their_pixel(move):
    whole = scene(np.random.default_rng(7), (300, 50), 8)
    extra = np.where(whole == 0, -3.25, 0.75).astype(np.float32)
    odd = whole + extra
    for image in (whole, odd):
        move(image, trap_model(10 * np.array(DENSITY), TAU, WELL), KEYS)
    assert np.array_equal(odd, whole + extra)


def test_extreme_images():
    """One pixel, no charge, all full: conserved; nothing moves; every trap is filled."""
    density = 10 * np.array(DENSITY)
    for shape, charge in (((1, 1), 50.0), ((40, 3), 0.0), ((40, 3), 90000.0)):
        image = np.full(shape, charge, np.float32)
        _, trapped = transfer(image, trap_model(density, TAU, WELL), KEYS)
        assert image.sum() == charge * image.size - trapped
        keys = [np.uint64(word(KEYS.traps, np.uint64(x))) for x in range(shape[1])]
        traps = sum(len(pixel) for key in keys for pixel in traps_of(key, shape[0], density))
        assert trapped == {50.0: trapped, 0.0: 0, 90000.0: traps}[charge]


@pytest.mark.parametrize("move", [transfer, transfer_rows])
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e10])
def test_values_that_are_no_charge_are_refused(bad, move):
    image = np.full((20, 30), 7, np.float32)
    image[3, 4:6] = bad
    before = image.copy()
    with pytest.raises(ValueError, match=r"2 pixel\(s\) is not finite or above"):
        move(image, TRAPS, KEYS)
    assert np.array_equal(image, before, equal_nan=True)


def test_the_upper_half_is_the_lower_one_turned():
    image = scene(np.random.default_rng(9), (200, 80), 20)
    turned = image[::-1].copy()
    one = transfer(image, TRAPS, KEYS, Columns(overscan=10))
    other = transfer(turned, TRAPS, KEYS, Columns(overscan=10, flip=True))
    assert np.array_equal(image, turned[::-1]) and np.array_equal(one[0], other[0]) and one[1] == other[1]


def test_columns_may_be_done_in_any_pieces():
    """Neither the number of columns at once nor, therefore, threads that share them can matter."""
    image = scene(np.random.default_rng(9), (200, 150), 20)
    whole = image.copy()
    transfer(whole, TRAPS, KEYS)
    for x0, x1 in ((0, 1), (60, 75), (100, 150)):
        part = image[:, x0:x1].copy()
        transfer(part, TRAPS, KEYS, Columns(x0=x0))
        assert np.array_equal(part, whole[:, x0:x1])


@pytest.mark.parametrize("flip", [False, True])
def test_a_window_is_a_part_of_the_half(flip):
    """With the median charge around it the half gives, bit for bit, what the window alone does."""
    lead, ny, n_rows = 120, 101, 400
    part = scene(np.random.default_rng(4), (ny, 30), 20)
    half = np.full((n_rows, 30), np.median(part), np.float32)
    rows = slice(n_rows - lead - ny, n_rows - lead) if flip else slice(lead, lead + ny)
    half[rows] = part
    wanted = transfer(half, TRAPS, KEYS, Columns(overscan=9, flip=flip, x0=3))
    given = transfer(part, TRAPS, KEYS, Columns(overscan=9, flip=flip, x0=3, lead=lead, n_rows=n_rows))
    assert np.array_equal(part, half[rows]) and np.array_equal(given[0], wanted[0]) and given[1] == wanted[1]
    with pytest.raises(ValueError, match="do not fit in a line of 200"):
        transfer(part, TRAPS, KEYS, Columns(lead=120, n_rows=200))
