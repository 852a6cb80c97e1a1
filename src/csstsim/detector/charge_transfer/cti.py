"""Charge transfer inefficiency (paper, section 5.5.4): stochastic and exact, event by event; here along columns.

Packet k of a half's column meets the traps of rows k, k - 1, ... 0 on its way to the amplifier. An empty trap whose
level (detector.charge_transfer.traps) the packet reaches takes one electron at once; a filled trap whose level it does
not reach lets its electron go with probability 1 - exp(-1 / tau), independently at each transfer. Traps of one pixel
act one after another, so that no electron is taken twice. After the last row come empty packets, the parallel overscan.

A row of traps sees the packets in their order, and a packet sees the rows from far to near; hence "row by row from far
to near, packet by packet in each" is the same process as the clock's "transfer by transfer", and one trap may be
followed through all packets at once. Between its events a trap changes nothing, and the next event is found without
visiting each packet: for an empty trap the next packet that reaches its level; for a filled one the n-th packet below
its level, n = 1 + floor(tau x Exp(1)) being the geometric number of trials until it lets go
(detector.charge_transfer.packets).

Traps start empty: a trap meets its own pixel's packet first, so this is the equilibrium reached in an exposure much
longer than tau. Left out: capture that takes time, charge injection, the structure of clock phases.
Rows go on through their register: detector.charge_transfer.serial.
"""

import math

import numba
import numpy as np

from csstsim.base.counter import unit, word
from csstsim.detector.charge_transfer.packets import add, first_reaching, nth_below, padded, search_room, set_up
from csstsim.detector.charge_transfer.traps import buffers, draw_traps

COLUMNS = 64  # worked on at once: their packets fit the cache
LARGEST = 2.0**30  # electrons in a pixel
_TILE = 16  # rows: of as many cache lines


def transfer(image, density, timescale, well, keys, *, flip=False, lead=0, n_rows=None, overscan=0, x0=0):
    """Transfer the charge of one half to its amplifier, in place; return (trail, trapped).

    image: float32 (ny, nx), electrons; row 0 is read first, or the last row if `flip`. density, timescale: of each
    species [traps/pixel, transfers]; well: (beta, full_well, notch). keys: uint64 of the traps and of their releases,
    each mixed with the column's number, x0 + its index. The image may be part of a half of `n_rows` rows, `lead` of
    them between it and the amplifier; the other rows then hold its median charge.
    trail: float32 (overscan, nx), the packets read after the half; trapped: electrons left in traps.

    Whole electrons move; a fraction, or what is below 0, stays with its pixel. Raises ValueError, before any change,
    for values that are not finite or above LARGEST.
    """
    ny, nx = image.shape
    n_rows = lead + ny if n_rows is None else n_rows
    trail = np.zeros((overscan, nx), np.float32)
    if image.size == 0:
        return trail, 0
    fill = checked_fill(image, ny, lead, n_rows)
    density, timescale = np.array(density, np.float64), np.array(timescale, np.float64)
    room = buffers(density, n_rows)
    trapped = _transfer(image, flip, lead, n_rows, fill, trail, keys, x0, density, timescale, well, room)
    return trail, trapped


def checked_fill(image, n, lead, length):
    """Return the charge [e-] of the packets of a line of `length` px that an image of `n`, `lead` from its end, lacks.

    Raises ValueError if it does not fit, and for values that are not finite or above LARGEST.
    """
    if not 0 <= lead <= length - n:
        raise ValueError(f"{n} pixels, {lead} from the end, of a line of {length}")
    bad = image.size - _count_good(image)
    if bad:
        raise ValueError(f"the charge of {bad} pixel(s) is not finite or above {LARGEST:.0f} electrons")
    return max(int(np.median(image)), 0) if n < length else 0


@numba.njit(cache=True)
def _count_good(image):
    """Return how many pixels hold a charge to work with."""
    good = 0
    for y in range(image.shape[0]):
        for x in range(image.shape[1]):
            good += -np.inf < image[y, x] <= LARGEST
    return good


@numba.njit(cache=True)
def _transfer(image, flip, lead, n_rows, fill, trail, keys, x0, density, timescale, well, room):
    """All columns, COLUMNS at a time. -1 after the last packet: below any trap's level."""
    nx = image.shape[1]
    n_packets = n_rows + len(trail)
    packets = np.empty((COLUMNS, padded(n_packets)), np.int32)
    fullest, head = np.empty(n_rows), np.empty(n_rows, np.int32)
    search = search_room(packets.shape[1])
    trapped = 0
    for first in range(0, nx, COLUMNS):
        n = min(COLUMNS, nx - first)
        packets[:, :n_rows] = fill
        packets[:, n_rows:n_packets] = 0
        packets[:, n_packets:] = -1
        _exchange(image, flip, first, packets[:n, lead:], False)
        for c in range(n):
            column = np.uint64(x0 + first + c)
            own = word(keys[0], column), word(keys[1], column)
            trapped += _column(packets[c], n_packets, own, density, timescale, well, fullest, head, room, search)
        _exchange(image, flip, first, packets[:n, lead:], True)
        for y in range(len(trail)):
            for c in range(n):
                trail[y, first + c] = packets[c, n_rows + y]
    return trapped


@numba.njit(cache=True)
def _exchange(image, flip, first, packets, back):
    """Copy the whole electrons of columns first, first + 1, ... to `packets` (column, row), or put them `back`."""
    ny, n = image.shape[0], len(packets)
    for start in range(0, ny, _TILE):
        for c in range(n):
            for k in range(start, min(start + _TILE, ny)):
                y = ny - 1 - k if flip else k
                value = image[y, first + c]
                if back:
                    image[y, first + c] = value + np.float32(packets[c, k] - whole(value))
                else:
                    packets[c, k] = whole(value)


@numba.njit(inline="always")
def whole(charge):
    """Return the whole electrons in a pixel, none below 0."""
    return np.int32(max(charge, np.float32(0)))


@numba.njit(cache=True)
def _column(packets, n_packets, keys, density, timescale, well, fullest, head, room, search):
    """Draw a column's traps and follow them; return the electrons left in traps."""
    beta, full_well, notch = well
    most, share = 0, 0.0
    for k in range(len(head) - 1, -1, -1):
        if packets[k] > most:
            most = packets[k]
            share = (max(most - notch, 0.0) / full_well) ** beta
        fullest[k] = share
    draw_traps(keys[0], density, timescale, well, fullest, head, *room)
    return follow_all(packets, n_packets, keys[1], head, room, search)


@numba.njit(cache=True)
def follow_all(packets, n_packets, key, head, room, search):
    """Follow each trap of a line, far ones first; return the electrons left in traps.

    packets: int32, changed in place, `n_packets` and -1 to the padded length (detector.charge_transfer.packets). key:
    uint64 of the releases. head, room: traps as detector.charge_transfer.traps.draw_traps leaves them. search:
    detector.charge_transfer.packets.search_room.
    """
    level, tau, own, next_ = room
    table, words, small = search
    base = set_up(packets, table, small)
    trapped, reach = 0, 0
    for row in range(len(head) - 1, -1, -1):
        reach = max(reach, packets[row])  # no packet from here on is fuller: a release never passes its trap's level
        trap = head[row]
        while trap >= 0:
            if level[trap] <= reach:
                trapped += _follow(
                    packets, table, words, small, base, row, n_packets, level[trap], tau[trap], key, own[trap]
                )
            trap = next_[trap]
    return trapped


@numba.njit(inline="always")
def _follow(charge, table, words, small, base, k, n_packets, level, tau, key, own):
    """Lead one trap through packets k, k + 1, ...; return the electrons it ends with, 0 or 1."""
    captures = np.uint64(0)
    while True:
        k = first_reaching(charge, table, words, base, k, level)
        if k >= n_packets:
            return 0
        add(charge, table, small, base, k, -1)
        wait = int(-tau * math.log(unit(word(key, own + captures)))) + 1
        captures += np.uint64(1)
        k = nth_below(charge, table, words, base, k + 1, level, wait)
        if k >= n_packets:
            return 1
        add(charge, table, small, base, k, 1)
        k += 1
