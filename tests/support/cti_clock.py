"""Charge transfer in the clock's order in plain Python, for the tests of columns and of rows."""

import numpy as np

from csstsim.base.counter import unit, word
from csstsim.detector.charge_transfer.parameters import TrapKeys, trap_model
from csstsim.detector.charge_transfer.traps import draw_traps, trap_lists, volume

DENSITY, TAU = (0.025, 0.105, 0.655), (1.22, 14.02, 84.74)  # paper, section 5.5.4
WELL = (0.492, 85200.0, 0.0)
TRAPS = trap_model(DENSITY, TAU, WELL)
KEYS = TrapKeys(np.uint64(20), np.uint64(21))


def traps_of(key, n_rows, density=DENSITY, timescale=TAU, well=WELL, fullest=1e9):
    """The traps of a line as (row, level, tau, word), in the order in which they act: far rows first."""
    model, lists = trap_model(density, timescale, well), trap_lists(density, n_rows)
    draw_traps(key, model, np.full(n_rows, volume(fullest, *well)), lists)
    found = []
    for row in range(n_rows):
        here, trap = [], lists.head[row]
        while trap >= 0:
            here.append((row, int(lists.level[trap]), lists.tau[trap], lists.bits[trap]))
            trap = lists.next_[trap]
        found.append(here)
    return found


def clocked(packets, rows, wait):
    """Transfer by transfer: at time t row j holds packet j + t, and its traps act one after another.

    packets: list of electrons, overscan included; wait(trap, n): transfers, among those at which the packet is below
    the trap's level, until it lets its n-th electron go. Returns (packets, electrons left in traps).
    """
    packets, filled, taken = list(packets), {}, {}
    for time in range(len(packets)):
        for row in range(min(len(rows), len(packets) - time)):
            for number, trap in enumerate(rows[row]):
                name, k = (row, number), row + time
                if name not in filled:
                    if packets[k] >= trap[1]:
                        packets[k] -= 1
                        filled[name] = wait(trap, taken.get(name, 0))
                        taken[name] = taken.get(name, 0) + 1
                elif packets[k] < trap[1]:
                    filled[name] -= 1
                    if filled[name] == 0:
                        packets[k] += 1
                        del filled[name]
    return packets, len(filled)


def wait_of(key):
    """The kernel's waiting times, for `clocked`: of the releases' key of a line."""
    return lambda trap, n: int(-trap[2] * np.log(unit(np.uint64(word(key, trap[3] + np.uint64(n)))))) + 1


def scene(rng, shape, sky):
    """Poisson sky with some bright pixels and one saturated."""
    image = rng.poisson(sky, shape).astype(np.float32)
    bright = rng.random(shape) < 0.01
    image[bright] += np.rint(10 ** rng.uniform(1, 4.5, bright.sum()))
    image[shape[0] // 2, 0] = 90000
    return image
