"""Charge transfer inefficiency along rows: each row of a channel is transferred through the register to its amplifier.

Process and search are those of columns (detector.charge_transfer.cti), with elements of the register instead of rows of
pixels. There are `prescan` elements between the amplifier and the first active column, so the packet of active column i
meets the traps of elements prescan + i, ... 0. Before the first active column the amplifier reads `prescan` empty
packets; after the last column it reads empty packets, the serial overscan.

All rows of a channel pass through one register: its traps are drawn once, the releases anew for each row. The traps are
empty at the start of each row, because they release all electrons before: between the last charge of one row and the
first of the next, an overscan, a prescan and a parallel transfer pass, which take much longer than tau. So prescan
pixels have no charge. Left out: traps so slow that they stay filled from row to row; these trap nothing.
"""

import numba
import numpy as np
from numpy.typing import ArrayLike

from csstsim.base.counter import word
from csstsim.base.types import FloatArray, IntArray
from csstsim.detector.charge_transfer.cti import checked_fill, follow_all, whole
from csstsim.detector.charge_transfer.packets import padded, search_room
from csstsim.detector.charge_transfer.traps import Room, buffers, draw_traps


def transfer_rows(
    image: FloatArray,
    density: ArrayLike,
    timescale: ArrayLike,
    well: tuple[float, float, float],
    keys: tuple[np.uint64, np.uint64],
    *,
    prescan: int = 0,
    lead: int = 0,
    n_columns: int | None = None,
    overscan: int = 0,
    row0: int = 0,
) -> tuple[FloatArray, int]:
    """Transfer rows of one channel through its register, in place; return (trail, trapped).

    image: float32 (ny, nx), electrons, in readout order: column 0 is read first. density, timescale: of each species
    [traps/element, serial transfers]; well: (beta, full_well, notch). keys: uint64 of the register's traps and of their
    releases; the latter is mixed with the row's number, row0 + its index. The image may be part of a channel of
    `n_columns` columns, `lead` of them between it and the prescan; the other columns then get its median charge.
    trail: float32 (ny, overscan), the packets read after each row; trapped: electrons left in traps after their row.

    Only whole electrons move; fractions and negative charge stay in their pixel. Raises ValueError, before any change,
    for values that are not finite or above LARGEST.
    """
    ny, nx = image.shape
    n_columns = lead + nx if n_columns is None else n_columns
    trail = np.zeros((ny, overscan), np.float32)
    if image.size == 0:
        return trail, 0
    fill = checked_fill(image, nx, lead, n_columns)
    density = np.array(density, np.float64)
    timescale = np.array(timescale, np.float64)
    head = np.empty(prescan + n_columns, np.int32)
    room = buffers(density, prescan + n_columns)
    draw_traps(keys[0], density, timescale, well, np.ones(len(head)), head, *room)
    return trail, _transfer_rows(image, prescan, prescan + lead, fill, trail, keys[1], row0, head, room)


@numba.njit(cache=True)
def _transfer_rows(
    image: FloatArray,
    prescan: int,
    first: int,
    fill: int,
    trail: FloatArray,
    key: np.uint64,
    row0: int,
    head: IntArray,
    room: Room,
) -> int:
    """Transfer all rows one by one; `first`: element of column 0. Packets after the last one are -1."""
    ny, nx = image.shape
    n_elements = len(head)
    n_packets = n_elements + trail.shape[1]
    packets = np.empty(padded(n_packets), np.int32)
    packets[n_packets:] = -1
    search = search_room(len(packets))
    trapped = 0
    for y in range(ny):
        packets[:prescan] = 0
        packets[prescan:n_elements] = fill
        packets[n_elements:n_packets] = 0
        for x in range(nx):
            packets[first + x] = whole(image[y, x])
        trapped += follow_all(packets, n_packets, word(key, np.uint64(row0 + y)), head, room, search)
        for x in range(nx):
            image[y, x] += np.float32(packets[first + x] - whole(image[y, x]))
        for x in range(trail.shape[1]):
            trail[y, x] = packets[n_elements + x]
    return trapped
