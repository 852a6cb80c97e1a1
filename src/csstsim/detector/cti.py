"""Charge transfer inefficiency of the parallel transfer (paper, section 5.5.4): stochastic and exact, event by event.

Packet k of a half's column meets the traps of rows k, k - 1, ... 0 on its way to the amplifier. An empty trap whose
level (detector.traps) the packet reaches takes one electron at once; a filled trap above the packet lets its electron
go with probability 1 - exp(-1 / tau), independently at each transfer. Traps of one pixel act one after another, so that
no electron is taken twice. After the last row come empty packets, the parallel overscan.

A trap row sees the packets in their order, and a packet sees the rows from far to near; therefore "row by row from far
to near, packet by packet in each" is the same process as the clock's "transfer by transfer", and one trap may be
followed through all packets at once. Between two events of a trap nothing happens to it, and its next event is found
without visiting each packet: the next packet that reaches its level when it is empty; when it is filled, the G-th packet
below its level, G = 1 + floor(tau x Exp(1)) being a geometric number. Bounds on the charge in blocks of packets skip
most of either search.

Traps start empty: a trap meets its own pixel's packet first, so this is the equilibrium reached in an exposure much
longer than tau. Left out: serial transfer, capture that takes time, charge injection, the structure of clock phases.
"""

import math

import numba
import numpy as np

from csstsim.counter import unit, word
from csstsim.detector.traps import buffers, draw_traps

COLUMNS = 64  # worked on at once: their packets fit the cache
LARGEST = 2.0**30  # electrons in a pixel
_BLOCK, _SUPER = 5, 9  # log2 of the packets in a block and in a super-block
_SPAN = 1 << _BLOCK
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
    if not 0 <= lead <= n_rows - ny:
        raise ValueError(f"{ny} rows, {lead} from the amplifier, of a half of {n_rows}")
    bad = image.size - _count_good(image)
    if bad:
        raise ValueError(f"the charge of {bad} pixel(s) is not finite or above {LARGEST:.0f} electrons")
    fill = max(int(np.median(image)), 0) if ny < n_rows else 0
    density, timescale = np.array(density, np.float64), np.array(timescale, np.float64)
    room = buffers(density, n_rows)
    trapped = _transfer(image, flip, lead, n_rows, fill, trail, keys, x0, density, timescale, well, room)
    return trail, trapped


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
    padded = (((n_packets - 1) >> _SUPER) + 1) << _SUPER
    packets = np.empty((COLUMNS, padded + _SPAN), np.int32)
    head = np.empty(n_rows, np.int32)
    bounds = _bounds(padded)
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
            trapped += _column(packets[c], n_packets, own, density, timescale, well, head, room, bounds)
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
                whole = np.int32(max(value, np.float32(0)))
                if back:
                    image[y, first + c] = value + np.float32(packets[c, k] - whole)
                else:
                    packets[c, k] = whole


@numba.njit(cache=True)
def _column(packets, n_packets, keys, density, timescale, well, head, room, bounds):
    """Follow each trap of a column, far rows first; return the electrons left in traps."""
    level, tau, words, next_ = room
    n_rows = len(head)
    fullest = 0
    for k in range(n_rows):
        fullest = max(fullest, packets[k])
    draw_traps(keys[0], density, timescale, well, fullest, head, level, tau, words, next_)
    _set_bounds(packets, bounds)
    trapped, reach = 0, 0
    for row in range(n_rows - 1, -1, -1):
        reach = max(reach, packets[row])  # no packet from here on is fuller: a release never passes its trap's level
        trap = head[row]
        while trap >= 0:
            if level[trap] <= reach:
                trapped += _follow(packets, bounds, row, n_packets, level[trap], tau[trap], keys[1], words[trap])
            trap = next_[trap]
    return trapped


@numba.njit(inline="always")
def _follow(packets, bounds, k, n_packets, level, tau, key, own):
    """Lead one trap through packets k, k + 1, ...; return the electrons it ends with, 0 or 1."""
    captures = np.uint64(0)
    while True:
        k = _reaching(packets, bounds, k, level)
        if k >= n_packets:
            return 0
        _add(packets, bounds, k, -1)
        wait = int(-tau * math.log(unit(word(key, own + captures)))) + 1
        captures += np.uint64(1)
        k = _below(packets, bounds, k + 1, level, wait)
        if k >= n_packets:
            return 1
        _add(packets, bounds, k, 1)
        k += 1


@numba.njit(inline="always")
def _reaching(packets, bounds, k, level):
    """Return the first packet at or after k that reaches `level`, or the end."""
    most, _, most_super, _ = bounds
    end = len(most) << _BLOCK
    while k < end:
        if most_super[k >> _SUPER] < level:
            k = ((k >> _SUPER) + 1) << _SUPER
        elif most[k >> _BLOCK] < level:
            k = ((k >> _BLOCK) + 1) << _BLOCK
        else:
            stop = ((k >> _BLOCK) + 1) << _BLOCK
            while k < stop:
                if packets[k] >= level:
                    return k
                k += 1
    return end


@numba.njit(inline="always")
def _below(packets, bounds, k, level, count):
    """Return the count-th packet at or after k that is below `level`, or the end or later."""
    most, least, most_super, least_super = bounds
    end = len(most) << _BLOCK
    while k < end:
        block, super_block = k >> _BLOCK, k >> _SUPER
        if least_super[super_block] >= level:
            k = (super_block + 1) << _SUPER
        elif most_super[super_block] < level:
            here = ((super_block + 1) << _SUPER) - k
            if count <= here:
                return k + count - 1
            count -= here
            k += here
        elif least[block] >= level:
            k = (block + 1) << _BLOCK
        elif most[block] < level:
            here = ((block + 1) << _BLOCK) - k
            if count <= here:
                return k + count - 1
            count -= here
            k += here
        else:
            here = 0
            for i in range(_SPAN):
                here += packets[k + i] < level
            if here < count:
                count -= here
                k += _SPAN
            else:
                while True:
                    if packets[k] < level:
                        count -= 1
                        if count == 0:
                            return k
                    k += 1
    return end


@numba.njit(cache=True)
def _bounds(n):
    """Return room for the most and the least charge in blocks and super-blocks of n packets."""
    blocks, supers = n >> _BLOCK, n >> _SUPER
    return (
        np.empty(blocks, np.int32),
        np.empty(blocks, np.int32),
        np.empty(supers, np.int32),
        np.empty(supers, np.int32),
    )


@numba.njit(cache=True)
def _set_bounds(packets, bounds):
    most, least, most_super, least_super = bounds
    most_super[:], least_super[:] = -1, np.iinfo(np.int32).max
    for block in range(len(most)):
        top = bottom = packets[block << _BLOCK]
        for i in range(1, _SPAN):
            value = packets[(block << _BLOCK) + i]
            top, bottom = max(top, value), min(bottom, value)
        most[block], least[block] = top, bottom
        super_block = block >> (_SUPER - _BLOCK)
        most_super[super_block] = max(most_super[super_block], top)
        least_super[super_block] = min(least_super[super_block], bottom)


@numba.njit(inline="always")
def _add(packets, bounds, k, electrons):
    """Change a packet; the bounds stay bounds, though not the closest ones."""
    most, least, most_super, least_super = bounds
    packets[k] += electrons
    value, block, super_block = packets[k], k >> _BLOCK, k >> _SUPER
    most[block], least[block] = max(most[block], value), min(least[block], value)
    most_super[super_block] = max(most_super[super_block], value)
    least_super[super_block] = min(least_super[super_block], value)
