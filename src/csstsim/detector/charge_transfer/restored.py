"""Charge transfer undone: the charge that the transfer (detector.charge_transfer) makes into what was read.

    guess <- guess + (read - forward(guess)),   guess = read at first

(Bristow 2003; Massey et al. 2010, MNRAS 401, 371; Anderson & Bedin 2010). Lines are independent of each other, so all
passes of a line are made while it is in the cache, and no array of the frame's size is copied. The transfer along the
registers is undone first, because it came last.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numba
import numpy as np

from csstsim.base.counter import word
from csstsim.base.types import FloatArray, IntArray
from csstsim.detector.channels import ReadoutFrame
from csstsim.detector.charge_transfer.cti import COLUMNS, Trap, checked_fill, filled_fractions, follow_trap, whole
from csstsim.detector.charge_transfer.packets import Search, padded, search_arrays, set_up
from csstsim.detector.charge_transfer.parameters import (
    Columns,
    TrapKeys,
    TrapModel,
    channel_register,
    half_windows,
    register_keys,
    scaled_model,
)
from csstsim.detector.charge_transfer.serial import transfer_rows
from csstsim.detector.charge_transfer.traps import TrapLists, draw_traps, trap_lists

if TYPE_CHECKING:
    from csstsim.base.rng import Streams
    from csstsim.instrument.chip import Detector, Window

_BLOCK = 64  # rows
_WHOLE_HALF = Columns()


def restore(
    image: FloatArray, detector: Detector, window: Window, rng: Streams, *, density: float, serial: bool, passes: int
) -> None:
    """Undo charge_transfer.transfer.transfer on a window's image [e-], float32 (ny, nx), in place.

    rng: rng.Streams of the traps; density: factor on the trap densities of cti.yaml; serial: transfer along the
    registers, too; passes: each reduces the error to a tenth or less.
    """
    assert detector.traps is not None  # layers.cte_effect.check
    if serial:
        _restore_rows(image, detector, window, rng, density, passes)
    model = scaled_model(detector.traps, density)
    for half in half_windows(detector, window, rng):
        restore_columns(image[half.rows], model, half.keys, passes, half.columns)


def restore_columns(
    image: FloatArray, model: TrapModel, keys: TrapKeys, passes: int, columns: Columns = _WHOLE_HALF
) -> None:
    """Undo charge_transfer.cti.transfer on an image [e-], float32 (ny, nx), in place, in `passes`.

    The other arguments, and what raises ValueError, are those of `transfer`; the charge of rows that are not in the
    image is the median of what was read.
    """
    ny = len(image)
    columns = columns._replace(n_rows=columns.n_rows or columns.lead + ny)
    if image.size and passes:
        fill = checked_fill(image, ny, columns.lead, columns.n_rows)
        traps = trap_lists(model.density, columns.n_rows)
        _restore(image, columns, fill, model, keys, traps, passes)


@numba.njit(cache=True)
def _restore(
    image: FloatArray, columns: Columns, fill: int, model: TrapModel, keys: TrapKeys, traps: TrapLists, passes: int
) -> None:
    """Restore all columns, COLUMNS at a time. fill: charge outside the image [e-]."""
    ny, nx = image.shape
    flip, lead, n_rows, overscan, x0 = columns
    n_packets = n_rows + overscan
    packets = np.empty(padded(n_packets), np.int32)
    read = np.empty((COLUMNS, ny), np.float32)
    guess = np.empty(ny, np.float32)
    filled = np.empty(n_rows)
    search = search_arrays(len(packets))
    added = passes * len(traps.level)  # a pass adds an electron for each trap at most, so all traps that act are drawn
    for first in range(0, nx, COLUMNS):
        n = min(COLUMNS, nx - first)
        _exchange(image, flip, first, read[:n], False)
        for c in range(n):
            column = np.uint64(x0 + first + c)
            guess[:] = read[c]
            _pack(guess, packets, lead, n_rows, n_packets, fill)
            filled_fractions(packets, added, model.well, filled)
            draw_traps(word(keys.traps, column), model, filled, traps)
            rows = np.flatnonzero(traps.head >= 0)[::-1]
            for _ in range(passes):
                _follow_rows(packets, n_packets, word(keys.releases, column), rows, traps, search)
                if not _correct(read[c], guess, packets[lead:]):
                    break  # the next pass would find the same
                _pack(guess, packets, lead, n_rows, n_packets, fill)
            read[c] = guess
        _exchange(image, flip, first, read[:n], True)


@numba.njit(cache=True)
def _follow_rows(
    packets: IntArray, n_packets: int, key: np.uint64, rows: IntArray, traps: TrapLists, search: Search
) -> None:
    """Follow the traps of `rows`, the farthest first, as cti.follow_all."""
    head, next_, level, tau, bits = traps
    table, words, small = search
    base = set_up(packets, table, small)
    charge_max = 0
    checked_from = len(packets)
    for row in rows:
        if row < checked_from:  # upper limit of the packets from here on, as in follow_all, block by block
            charge_max = max(charge_max, packets[max(row - _BLOCK, 0) : checked_from].max())
            checked_from = max(row - _BLOCK, 0)
        trap = head[row]
        while trap >= 0:
            if level[trap] <= charge_max:
                one = Trap(row, level[trap], tau[trap], bits[trap])
                follow_trap(packets, n_packets, table, words, small, base, one, key)
            trap = next_[trap]


@numba.njit(cache=True)
def _pack(guess: FloatArray, packets: IntArray, lead: int, n_rows: int, n_packets: int, fill: int) -> None:
    """Fill the packets of a column: whole electrons of guess, `fill` outside the image, then empty ones, then -1."""
    packets[:lead] = fill
    for k in range(len(guess)):
        packets[lead + k] = whole(guess[k])
    packets[lead + len(guess) : n_rows] = fill
    packets[n_rows:n_packets] = 0
    packets[n_packets:] = -1


@numba.njit(cache=True)
def _correct(read: FloatArray, guess: FloatArray, packets: IntArray) -> int:
    """Add to guess what is missing in its transferred packets; return the number of pixels that change."""
    changed = 0
    for k in range(len(guess)):
        before = guess[k]
        guess[k] += read[k] - (before + np.float32(packets[k] - whole(before)))
        changed += guess[k] != before
    return changed


@numba.njit(cache=True)
def _exchange(image: FloatArray, flip: bool, first: int, lines: FloatArray, back: bool) -> None:
    """Copy columns first, first + 1, ... of the image to `lines` (column, row in readout order), or back."""
    ny = image.shape[0]
    for k in range(ny):
        row = image[ny - 1 - k if flip else k]
        for c in range(len(lines)):
            if back:
                row[first + c] = lines[c, k]
            else:
                lines[c, k] = row[first + c]


def _restore_rows(
    image: FloatArray, detector: Detector, window: Window, rng: Streams, scale: float, passes: int
) -> None:
    """Undo the transfer along the registers, channel by channel, in place."""
    assert detector.traps is not None and detector.traps.serial is not None  # layers.cte_effect.check
    model = scaled_model(detector.traps.serial, scale)
    for block in ReadoutFrame.of(detector, window).blocks:
        register = channel_register(block, detector, window)
        keys = register_keys(block.channel, rng)
        read = image[block.image][block.as_read]
        guess = read.copy()
        for _ in range(passes):
            moved = guess.copy()
            transfer_rows(moved, model, keys, register)
            guess += read - moved
        read[:] = guess
