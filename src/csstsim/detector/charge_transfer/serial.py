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

from csstsim.base.counter import word
from csstsim.base.types import FloatArray
from csstsim.detector.charge_transfer.cti import checked_fill, follow_all, whole
from csstsim.detector.charge_transfer.packets import padded, search_arrays
from csstsim.detector.charge_transfer.parameters import Register, TrapKeys, TrapModel
from csstsim.detector.charge_transfer.traps import TrapLists, draw_traps, trap_lists

_WHOLE_CHANNEL = Register()


def transfer_rows(
    image: FloatArray, model: TrapModel, keys: TrapKeys, register: Register = _WHOLE_CHANNEL
) -> tuple[FloatArray, int]:
    """Transfer rows of one channel through its register, in place; return (trail, trapped).

    image: float32 (ny, nx), electrons, in readout order: column 0 is read first. model: per element of the register, in
    serial transfers. keys: that of the releases is mixed with the row's number, register.row0 + its index. Columns of
    the channel that are not in the image get its median charge.
    trail: float32 (ny, register.overscan), the packets read after each row; trapped: electrons left in traps after
    their row.

    Only whole electrons move; fractions and negative charge stay in their pixel. Raises ValueError, before any change,
    for values that are not finite or above CHARGE_MAX.
    """
    ny, nx = image.shape
    register = register._replace(n_columns=register.n_columns or register.lead + nx)
    trail = np.zeros((ny, register.overscan), np.float32)
    if image.size == 0:
        return trail, 0
    fill = checked_fill(image, nx, register.lead, register.n_columns)
    n_elements = register.prescan + register.n_columns
    traps = trap_lists(model.density, n_elements)
    draw_traps(keys.traps, model, np.ones(n_elements), traps)
    return trail, _transfer_rows(image, register, fill, trail, keys.releases, traps)


@numba.njit(cache=True)
def _transfer_rows(
    image: FloatArray, register: Register, fill: int, trail: FloatArray, key: np.uint64, traps: TrapLists
) -> int:
    """Transfer all rows one by one. Packets after the last one are -1."""
    ny, nx = image.shape
    prescan = register.prescan
    first = prescan + register.lead  # element of column 0
    n_elements = prescan + register.n_columns
    n_packets = n_elements + trail.shape[1]
    packets = np.empty(padded(n_packets), np.int32)
    packets[n_packets:] = -1
    search = search_arrays(len(packets))
    trapped = 0
    for y in range(ny):
        packets[:prescan] = 0
        packets[prescan:n_elements] = fill
        packets[n_elements:n_packets] = 0
        for x in range(nx):
            packets[first + x] = whole(image[y, x])
        trapped += follow_all(packets, n_packets, word(key, np.uint64(register.row0 + y)), traps, search)
        for x in range(nx):
            image[y, x] += np.float32(packets[first + x] - whole(image[y, x]))
        for x in range(trail.shape[1]):
            trail[y, x] = packets[n_elements + x]
    return trapped
