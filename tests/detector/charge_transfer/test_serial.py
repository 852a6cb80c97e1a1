"""Transfer of rows through a register against the clock's own order and closed forms; charge is conserved."""

import numpy as np
import pytest
from support.cti_clock import KEYS, clocked, scene, traps_of, wait_of

from csstsim.base.counter import word
from csstsim.detector.charge_transfer.parameters import Register, TrapKeys, trap_model
from csstsim.detector.charge_transfer.serial import transfer_rows
from csstsim.detector.charge_transfer.traps import volume

DENSITY, TAU = (0.2, 0.3, 0.4), (0.8, 4.0, 20.0)  # more traps than cti.yaml says: the rows here are short
WELL = (0.492, 85200.0, 0.0)
TRAPS = trap_model(DENSITY, TAU, WELL)


@pytest.mark.parametrize("sky", [0.5, 40])
@pytest.mark.parametrize(("nx", "times"), [(300, 1), (60, 10)])
def test_event_by_event_is_transfer_by_transfer(sky, nx, times):
    """The same traps, of one register for all rows, and the same waiting times: the same electrons, every one."""
    prescan, overscan, density = 9, 20, times * np.array(DENSITY)
    image = scene(np.random.default_rng(3), (5, nx), sky)
    out = image.copy()
    trail, trapped = transfer_rows(
        out, trap_model(density, TAU, WELL), KEYS, Register(prescan=prescan, n_columns=nx, overscan=overscan, row0=40)
    )
    register, total = traps_of(KEYS.traps, prescan + nx, density, TAU), 0
    for y in range(len(image)):
        packets = [0] * prescan + [int(n) for n in image[y]] + [0] * overscan
        moved, left = clocked(packets, register, wait_of(np.uint64(word(KEYS.releases, np.uint64(40 + y)))))
        assert not any(moved[:prescan])
        assert np.array_equal(np.concatenate([out[y], trail[y]]), moved[prescan:])
        total += left
    assert total == trapped
    assert not np.array_equal(out, image)


def test_extended_pixel_edge_response():
    """A bright last column, 2e4 e-; a notch above anything released rules out recapture.

    Of the register's own traps below V, n of each species, overscan packet m gets n q^(m - 1) (1 - q) on average over
    4000 rows, q = exp(-1 / tau), within 5 sigma; n itself is Poisson of mean rho V (prescan + nx) over 200 registers.
    """
    nx, prescan, overscan, charge, well, rows = 40, 10, 30, 20000, (0.492, 85200.0, 50.0), 4000
    image = np.zeros((rows, nx), np.float32)
    image[:, -1] = charge
    trail, trapped = transfer_rows(
        image, trap_model(DENSITY, TAU, well), KEYS, Register(prescan=prescan, overscan=overscan)
    )
    found = [trap for element in traps_of(KEYS.traps, prescan + nx, DENSITY, TAU, well) for trap in element]
    n = np.array([sum(trap[1] <= charge and trap[2] == tau for trap in found) for tau in TAU])
    assert (n > 0).all()
    q = np.exp(-1 / np.array(TAU))
    m = np.arange(1, overscan + 1)[:, None]
    share = q ** (m - 1) * (1 - q)
    sigma = np.sqrt((n * share * (1 - share)).sum(1) / rows)
    assert (abs(trail.mean(0, dtype=float) - (n * share).sum(1)) < 5 * sigma).all()
    assert (charge - image[:, -1] == n.sum()).all() and not image[:, :-1].any()
    left = q**overscan
    assert abs(trapped / rows - (n * left).sum()) < 5 * np.sqrt((n * left * (1 - left)).sum() / rows)

    registers = 200
    for number in range(registers):
        one = np.zeros((1, nx), np.float32)
        one[0, -1] = charge
        transfer_rows(
            one, trap_model(DENSITY, TAU, well), TrapKeys(np.uint64(number), KEYS.releases), Register(prescan=prescan)
        )
        image[number] = one
    mean = sum(DENSITY) * volume(charge, *well) * (prescan + nx)
    caught = charge - image[:registers, -1].astype(float)
    assert abs(caught.mean() - mean) < 5 * np.sqrt(mean / registers)
    assert abs(caught.var() / mean - 1) < 5 * np.sqrt((2 + 1 / mean) / registers)


def test_traps_are_the_registers_and_releases_the_rows():
    """Equal rows lose the same electrons from a first bright pixel; what comes out where differs from row to row."""
    image = np.zeros((30, 50), np.float32)
    image[:, 20] = 5000
    whole = image.copy()
    transfer_rows(whole, TRAPS, KEYS)
    assert len(np.unique(whole[:, 20])) == 1 and whole[0, 20] < 5000
    assert len(np.unique(whole[:, 21:], axis=0)) == len(whole)
    part = image[7:9].copy()
    transfer_rows(part, TRAPS, KEYS, Register(row0=7))
    assert np.array_equal(part, whole[7:9])


def test_the_prescan_holds_traps():
    """The first column passes all elements of the prescan: it loses to their traps and to its own."""
    image = np.full((1, 1), 90000.0, np.float32)
    _, trapped = transfer_rows(image, TRAPS, KEYS, Register(prescan=200))
    every = sum(len(element) for element in traps_of(KEYS.traps, 201, DENSITY, TAU))
    assert every > 100 and trapped == every == 90000 - image[0, 0]


@pytest.mark.parametrize("turned", [False, True])
def test_a_window_is_a_part_of_the_channel(turned):
    """With the median charge around it the channel gives, bit for bit, what the window alone does; a view will do."""
    lead, nx, n_columns = 30, 61, 200
    part = scene(np.random.default_rng(4), (40, nx), 20)
    channel = np.full((40, n_columns), np.median(part), np.float32)
    channel[:, lead : lead + nx] = part
    if turned:  # held as the chip lies, given as the amplifier sees it
        part, channel = part[:, ::-1].copy()[:, ::-1], channel[:, ::-1].copy()[:, ::-1]
    how = {"prescan": 7, "overscan": 9, "row0": 3}
    wanted = transfer_rows(channel, TRAPS, KEYS, Register(**how))
    given = transfer_rows(part, TRAPS, KEYS, Register(**how, lead=lead, n_columns=n_columns))
    assert np.array_equal(part, channel[:, lead : lead + nx])
    assert np.array_equal(given[0], wanted[0]) and given[1] == wanted[1]
    with pytest.raises(ValueError, match="do not fit in a line of 80"):
        transfer_rows(part, TRAPS, KEYS, Register(lead=30, n_columns=80))
