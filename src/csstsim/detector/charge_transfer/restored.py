"""Charge transfer undone: the charge that the transfer (detector.charge_transfer) makes into what was read.

    guess <- guess + (read - forward(guess)),   guess = read at first

(Bristow 2003; Massey et al. 2010, MNRAS 401, 371; Anderson & Bedin 2010). Lines are independent of each other, so all
passes of one are made while it is in the cache, and nothing of the size of the frame is copied. What the registers did
is undone first, because rows were transferred last.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numba
import numpy as np
from numpy.typing import ArrayLike

from csstsim.base.counter import word
from csstsim.base.types import FloatArray, IntArray
from csstsim.detector.channels import ReadoutFrame
from csstsim.detector.charge_transfer.cti import COLUMNS, checked_fill, fill_fullest, follow_trap, whole
from csstsim.detector.charge_transfer.packets import Search, padded, search_room, set_up
from csstsim.detector.charge_transfer.serial import transfer_rows
from csstsim.detector.charge_transfer.traps import Room, buffers, draw_traps

if TYPE_CHECKING:
    from csstsim.base.rng import Streams
    from csstsim.instrument.chip import Detector, Window

_BLOCK = 64  # rows


def restore(
    image: FloatArray, detector: Detector, window: Window, rng: Streams, *, density: float, serial: bool, passes: int
) -> None:
    """Undo charge_transfer.transfer.transfer on a window's image [e-], float32 (ny, nx), in place.

    rng: rng.Streams of the traps; density: factor on the trap densities of cti.yaml; serial: transfer along the
    registers, too; passes: each leaves a tenth of the error before it, or less.
    """
    traps = detector.traps
    n_rows = detector.channel_ny
    assert traps is not None  # layers.cte_effect.check
    if serial:
        _restore_rows(image, detector, window, rng, density, passes)
    for half in range(2):
        low, high = (min(max(y, half * n_rows), (half + 1) * n_rows) for y in (window.y0, window.y1))
        if low < high:
            restore_columns(
                image[low - window.y0 : high - window.y0],
                density * np.array(traps.density),
                traps.timescale,
                (traps.beta, traps.full_well, traps.notch),
                (rng.chip_key(f"traps {half}"), rng.exposure_key(f"release {half}")),
                passes,
                flip=bool(half),
                lead=detector.ny - high if half else low,
                n_rows=n_rows,
                overscan=detector.parallel_overscan,
                x0=window.x0,
            )


def restore_columns(
    image: FloatArray,
    density: ArrayLike,
    timescale: ArrayLike,
    well: tuple[float, float, float],
    keys: tuple[np.uint64, np.uint64],
    passes: int,
    *,
    flip: bool = False,
    lead: int = 0,
    n_rows: int | None = None,
    overscan: int = 0,
    x0: int = 0,
) -> None:
    """Undo charge_transfer.cti.transfer on an image [e-], float32 (ny, nx), in place, in `passes`.

    The other arguments, and what raises ValueError, are those of `transfer`; the charge of rows that are not in the
    image is the median of what was read.
    """
    ny = len(image)
    n_rows = lead + ny if n_rows is None else n_rows
    if image.size and passes:
        fill = checked_fill(image, ny, lead, n_rows)
        density = np.array(density, np.float64)
        timescale = np.array(timescale, np.float64)
        line = lead, n_rows, n_rows + overscan, fill
        _restore(image, flip, line, keys, x0, density, timescale, well, buffers(density, n_rows), passes)


@numba.njit(cache=True)
def _restore(
    image: FloatArray,
    flip: bool,
    line: tuple[int, int, int, int],
    keys: tuple[np.uint64, np.uint64],
    x0: int,
    density: FloatArray,
    timescale: FloatArray,
    well: tuple[float, float, float],
    room: Room,
    passes: int,
) -> None:
    """Restore all columns, COLUMNS at a time. line: lead, n_rows, packets of a column and charge outside the image."""
    ny, nx = image.shape
    lead, n_rows, n_packets, fill = line
    packets = np.empty(padded(n_packets), np.int32)
    read = np.empty((COLUMNS, ny), np.float32)
    guess = np.empty(ny, np.float32)
    fullest = np.empty(n_rows)
    head = np.empty(n_rows, np.int32)
    search = search_room(len(packets))
    more = passes * len(room[0])  # a pass adds an electron for each trap at most, so all traps that act are drawn
    for first in range(0, nx, COLUMNS):
        n = min(COLUMNS, nx - first)
        _exchange(image, flip, first, read[:n], False)
        for c in range(n):
            column = np.uint64(x0 + first + c)
            guess[:] = read[c]
            _pack(guess, packets, lead, n_rows, n_packets, fill)
            fill_fullest(packets, more, well, fullest)
            draw_traps(word(keys[0], column), density, timescale, well, fullest, head, *room)
            rows = np.flatnonzero(head >= 0)[::-1]
            for _ in range(passes):
                _follow_rows(packets, n_packets, word(keys[1], column), rows, head, room, search)
                if not _correct(read[c], guess, packets[lead:]):
                    break  # the next pass would find the same
                _pack(guess, packets, lead, n_rows, n_packets, fill)
            read[c] = guess
        _exchange(image, flip, first, read[:n], True)


@numba.njit(cache=True)
def _follow_rows(
    packets: IntArray, n_packets: int, key: np.uint64, rows: IntArray, head: IntArray, room: Room, search: Search
) -> None:
    """Follow the traps of `rows`, the farthest first, as cti.follow_all."""
    level, tau, own, next_ = room
    table, words, small = search
    base = set_up(packets, table, small)
    reach = 0
    seen = len(packets)
    for row in rows:
        if row < seen:  # upper limit of the packets from here on, as in follow_all, block by block
            reach = max(reach, packets[max(row - _BLOCK, 0) : seen].max())
            seen = max(row - _BLOCK, 0)
        trap = head[row]
        while trap >= 0:
            if level[trap] <= reach:
                follow_trap(packets, table, words, small, base, row, n_packets, level[trap], tau[trap], key, own[trap])
            trap = next_[trap]


@numba.njit(cache=True)
def _pack(guess: FloatArray, packets: IntArray, lead: int, n_rows: int, n_packets: int, fill: int) -> None:
    """Fill the packets of a column: whole electrons of guess, `fill` beside the image, then empty ones, then -1."""
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
    assert detector.traps is not None
    traps = detector.traps.serial
    x0 = window.x0
    y0 = window.y0
    assert traps is not None
    density = scale * np.array(traps.density, float)
    for block in ReadoutFrame.of(detector, window).blocks:
        rows, cols = block.image
        read = image[block.image][block.as_read]
        guess = read.copy()
        keys = rng.chip_key(f"serial traps {block.channel}"), rng.exposure_key(f"serial release {block.channel}")
        for _ in range(passes):
            moved = guess.copy()
            transfer_rows(
                moved,
                density,
                traps.timescale,
                (traps.beta, traps.full_well, traps.notch),
                keys,
                prescan=detector.prescan,
                lead=(-(x0 + cols.stop) if block.flip_x else x0 + cols.start) % detector.channel_nx,
                n_columns=detector.channel_nx,
                overscan=detector.overscan,
                row0=(-(y0 + rows.stop) if block.flip_y else y0 + rows.start) % detector.channel_ny,
            )
            guess += read - moved
        read[:] = guess
