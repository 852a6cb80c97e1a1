"""Charge transfer inefficiency along columns (paper, section 5.5.4): an exact stochastic simulation of each event.

Packet k of a half's column meets the traps of rows k, k - 1, ... 0 on its way to the amplifier. An empty trap captures
one electron at once if the packet reaches its level (detector.charge_transfer.traps). A filled trap releases its
electron into a packet below its level with probability 1 - exp(-1 / tau), independently at each transfer. Traps of one
pixel act one after another, so that no electron is captured twice. After the last row follow empty packets, the
parallel overscan.

A row of traps meets the packets in order, and a packet meets the farthest rows first. So going through the rows, the
farthest first, and in each row through the packets, gives the same process as the clock's sequence of transfers, and
one trap can be followed through all packets at once. Between its events a trap changes nothing. The next event is found
without visiting each packet: for an empty trap it is at the next packet that reaches its level; for a filled trap at
the n-th packet below its level, n = 1 + floor(tau x Exp(1)), the geometric number of trials until release
(detector.charge_transfer.packets).

Traps start empty: a trap meets its own pixel's packet first, which is the equilibrium after an exposure much longer
than tau. Left out: finite capture times, charge injection, the structure of clock phases.
The transfer of rows along their register: detector.charge_transfer.serial.
"""

import math
from typing import NamedTuple

import numba
import numpy as np

from csstsim.base.counter import unit, word
from csstsim.base.types import FloatArray, IntArray
from csstsim.detector.charge_transfer.packets import (
    Search,
    add,
    first_reaching,
    nth_below,
    padded,
    search_arrays,
    set_up,
)
from csstsim.detector.charge_transfer.parameters import Columns, TrapKeys, TrapModel, Well
from csstsim.detector.charge_transfer.traps import TrapLists, draw_traps, trap_lists

COLUMNS = 64  # processed at once: their packets fit in the cache
CHARGE_MAX = 2.0**30  # electrons in a pixel
_TILE = 16  # rows copied at a time, for use of the cache
_WHOLE_HALF = Columns()


def transfer(
    image: FloatArray, model: TrapModel, keys: TrapKeys, columns: Columns = _WHOLE_HALF
) -> tuple[FloatArray, int]:
    """Transfer the charge of one half of the chip to its amplifier, in place; return (trail, trapped).

    image: float32 (ny, nx), electrons. keys: each is mixed with the column's number, columns.x0 + its index. Rows of
    the half that are not in the image get its median charge.
    trail: float32 (columns.overscan, nx), the packets read after the half; trapped: electrons left in traps.

    Only whole electrons move; fractions and negative charge stay in their pixel. Raises ValueError, before any change,
    for values that are not finite or above CHARGE_MAX.
    """
    ny, nx = image.shape
    columns = columns._replace(n_rows=columns.n_rows or columns.lead + ny)
    trail = np.zeros((columns.overscan, nx), np.float32)
    if image.size == 0:
        return trail, 0
    fill = checked_fill(image, ny, columns.lead, columns.n_rows)
    traps = trap_lists(model.density, columns.n_rows)
    return trail, _transfer(image, columns, fill, trail, model, keys, traps)


def checked_fill(image: FloatArray, n: int, lead: int, length: int) -> int:
    """Return the charge [e-] for the packets of a line of `length` px that lie outside an image of `n` px.

    lead: distance of the image from the line's end [px]. The charge is the image's median, or 0 if none lie outside.
    Raises ValueError if the image does not fit, and for values that are not finite or above CHARGE_MAX.
    """
    if not 0 <= lead <= length - n:
        raise ValueError(f"{n} pixels, {lead} from the end, do not fit in a line of {length}")
    invalid = image.size - _count_good(image)
    if invalid:
        raise ValueError(f"the charge of {invalid} pixel(s) is not finite or above {CHARGE_MAX:.0f} electrons")
    return max(int(np.median(image)), 0) if n < length else 0


@numba.njit(cache=True)
def _count_good(image: FloatArray) -> int:
    """Return the number of pixels with a charge that is finite and at most CHARGE_MAX."""
    good = 0
    for y in range(image.shape[0]):
        for x in range(image.shape[1]):
            good += -np.inf < image[y, x] <= CHARGE_MAX
    return good


@numba.njit(cache=True)
def _transfer(
    image: FloatArray,
    columns: Columns,
    fill: int,
    trail: FloatArray,
    model: TrapModel,
    keys: TrapKeys,
    traps: TrapLists,
) -> int:
    """Transfer all columns, COLUMNS at a time. Packets after the last one are -1, below any trap's level."""
    flip, lead, n_rows, _, x0 = columns
    nx = image.shape[1]
    n_packets = n_rows + len(trail)
    packets = np.empty((COLUMNS, padded(n_packets)), np.int32)
    filled = np.empty(n_rows)
    search = search_arrays(packets.shape[1])
    trapped = 0
    for first in range(0, nx, COLUMNS):
        n = min(COLUMNS, nx - first)
        packets[:, :n_rows] = fill
        packets[:, n_rows:n_packets] = 0
        packets[:, n_packets:] = -1
        _exchange(image, flip, first, packets[:n, lead:], False)
        for c in range(n):
            column = np.uint64(x0 + first + c)
            column_keys = TrapKeys(word(keys.traps, column), word(keys.releases, column))
            trapped += _column(packets[c], n_packets, model, column_keys, filled, traps, search)
        _exchange(image, flip, first, packets[:n, lead:], True)
        for y in range(len(trail)):
            for c in range(n):
                trail[y, first + c] = packets[c, n_rows + y]
    return trapped


@numba.njit(cache=True)
def _exchange(image: FloatArray, flip: bool, first: int, packets: IntArray, back: bool) -> None:
    """Copy the whole electrons of columns first, first + 1, ... to `packets` (column, row), or from them if `back`.

    A tile of rows is turned in a small buffer: neighbours in a column of the image, or in a row of the packets, lie a
    multiple of 4096 bytes apart, so that few of them fit in the cache at once.
    """
    ny = image.shape[0]
    n = len(packets)
    tile = np.empty((_TILE, n), np.int32)
    for start in range(0, ny, _TILE):
        count = min(_TILE, ny - start)
        if back:
            for c in range(n):
                for k in range(count):
                    tile[k, c] = packets[c, start + k]
        for k in range(count):
            row = image[ny - 1 - start - k if flip else start + k, first : first + n]
            line = tile[k]
            for c in range(n):
                if back:
                    row[c] += np.float32(line[c] - whole(row[c]))
                else:
                    line[c] = whole(row[c])
        if not back:
            for c in range(n):
                for k in range(count):
                    packets[c, start + k] = tile[k, c]


@numba.njit(inline="always")
def whole(charge: np.float32) -> np.int32:
    """Return the whole electrons in a pixel, at least 0."""
    return np.int32(max(charge, np.float32(0)))


@numba.njit(cache=True)
def _column(
    packets: IntArray,
    n_packets: int,
    model: TrapModel,
    keys: TrapKeys,
    filled: FloatArray,
    traps: TrapLists,
    search: Search,
) -> int:
    """Draw a column's traps and follow them; return the electrons left in traps."""
    filled_fractions(packets, 0, model.well, filled)
    draw_traps(keys.traps, model, filled, traps)
    return follow_all(packets, n_packets, keys.releases, traps, search)


@numba.njit(cache=True)
def filled_fractions(packets: IntArray, added: int, well: Well, filled: FloatArray) -> None:
    """Fill `filled` (n_rows,): the fraction of a pixel that the largest packet of a row, or behind it, fills.

    added: electrons added to each packet.
    """
    beta, full_well, notch = well
    maximum = -1
    fraction = 0.0
    for k in range(len(filled) - 1, -1, -1):
        if packets[k] > maximum:
            maximum = packets[k]
            fraction = (max(maximum + added - notch, 0.0) / full_well) ** beta
        filled[k] = fraction


@numba.njit(cache=True)
def follow_all(packets: IntArray, n_packets: int, key: np.uint64, traps: TrapLists, search: Search) -> int:
    """Follow each trap of a line, the farthest from the amplifier first; return the electrons left in traps.

    packets: int32, changed in place, `n_packets` and -1 up to the padded length (detector.charge_transfer.packets).
    key: uint64 of the releases; traps: of detector.charge_transfer.traps.draw_traps; search: of
    detector.charge_transfer.packets.search_room.
    """
    head, next_, level, tau, bits = traps
    table, words, small = search
    base = set_up(packets, table, small)
    trapped = 0
    charge_max = 0
    for row in range(len(head) - 1, -1, -1):
        # The maximum from this row on: a release does not raise a packet above its trap's level
        charge_max = max(charge_max, packets[row])
        trap = head[row]
        while trap >= 0:
            if level[trap] <= charge_max:
                one = Trap(row, level[trap], tau[trap], bits[trap])
                trapped += follow_trap(packets, n_packets, table, words, small, base, one, key)
            trap = next_[trap]
    return trapped


class Trap(NamedTuple):
    """One trap: its row, level [e-], timescale [transfers] and random bits."""

    row: int
    level: int
    tau: float
    bits: np.uint64


@numba.njit(inline="always")
def follow_trap(
    charge: IntArray,
    n_packets: int,
    table: IntArray,
    words: IntArray,
    small: IntArray,
    base: int,
    trap: Trap,
    key: np.uint64,
) -> int:
    """Follow one trap through the packets of its row and behind it; return the electrons left in it, 0 or 1.

    table, words, small, base: of the search among the packets `charge` (packets.Search, packets.set_up). key: uint64 of
    the releases.
    """
    k, level, tau, bits = trap
    captures = np.uint64(0)
    while True:
        k = first_reaching(charge, table, words, base, k, level)
        if k >= n_packets:
            return 0
        add(charge, table, small, base, k, -1)
        packets_until_release = int(-tau * math.log(unit(word(key, bits + captures)))) + 1
        captures += np.uint64(1)
        k = nth_below(charge, table, words, base, k + 1, level, packets_until_release)
        if k >= n_packets:
            return 1
        add(charge, table, small, base, k, 1)
        k += 1
