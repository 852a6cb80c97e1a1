"""Blooming (paper, Appendix B item 9): charge above the full well spills equally into both neighbours.

Along a line of pixels this is the divisible sandpile (Levine & Peres 2009, Potential Analysis 30, 1): a pixel above the
full well keeps a full well and gives half of the excess to each neighbour, until no pixel is above it. The result does
not depend on the order and has a closed form: runs of saturated pixels, each with a pixel at either end that receives

    at the upper end  sum e_m (m - i) / (j - i),   at the lower end  sum e_m (j - m) / (j - i)

for a run between i and j with excesses e_m = Q_m - full well (a random walk's probabilities to leave at either end).
Runs grow until their ends are not above the full well, and merge where they meet. The time is linear in the pixels
filled.

A fraction of each excess spills along its row first, then the remaining excess along the column. Columns run across the
middle of the chip, because its halves differ only in the clocks. Charge that reaches a border leaves the image (at the
upper and lower border into the registers) and is counted. Left out: differences between wells, the trail of charge in
the serial register, blooming during readout.
"""

from typing import NamedTuple

import numba
import numpy as np

from csstsim.base.types import AnyArray, FloatArray, IntArray
from csstsim.detector.mask import BLED, SATURATED

# A run of saturated pixels between `start` and `end`: sum of excesses e_m, and of e_m (m - start).
_RUN = np.dtype([("start", np.int64), ("end", np.int64), ("excess", np.float64), ("moment", np.float64)])


class SaturatedPixels(NamedTuple):
    """Numbers of saturated pixels in each row (ny,) and each column (nx,), and of pixels that are not finite."""

    in_row: IntArray
    in_column: IntArray
    not_finite: int


def bloom(
    image: FloatArray, full_well: float, row_fraction: float = 0.0, mask: IntArray | None = None
) -> tuple[int, float]:
    """Spill the charge of `image` (ny, nx; electrons, float32) above `full_well` [e-], in place.

    `row_fraction` 0..1: fraction of each excess that spills along its row. `mask` (uint8, same shape) or None:
    SATURATED is set where charge was above the full well, BLED where charge arrived from other pixels. Returns
    (saturated pixels, electrons that left through the borders). Charge is conserved to float32's rounding of each run's
    two ends. A negative pixel takes charge until it has a full well. Raises ValueError, and leaves the image unchanged,
    if a pixel is not finite, the full well is not positive or the fraction is out of range.
    """
    if not full_well > 0 or not 0 <= row_fraction <= 1:
        raise ValueError(f"full well {full_well}, row fraction {row_fraction}; need more than 0, and 0..1")
    in_row, in_column, not_finite = _find_saturated(image, full_well)
    if not_finite:
        raise ValueError(f"the charge of {not_finite} pixel(s) is not finite")
    count = int(in_row.sum())
    if not count:
        return 0, 0.0
    marks = np.zeros((image.shape[0], 0), np.uint8) if mask is None else mask
    return count, _spill_all(image, float(full_well), float(row_fraction), marks, in_row, in_column)


@numba.njit(cache=True)
def _find_saturated(image: FloatArray, full_well: float) -> SaturatedPixels:
    ny, nx = image.shape
    in_row = np.zeros(ny, np.int64)
    in_column = np.zeros(nx, np.int64)
    not_finite = 0
    for y in range(ny):
        for x in range(nx):
            in_row[y] += not image[y, x] <= full_well
            not_finite += image[y, x] == -np.inf
        if in_row[y]:
            for x in range(nx):
                in_column[x] += not image[y, x] <= full_well
                not_finite += not image[y, x] < np.inf
    return SaturatedPixels(in_row, in_column, not_finite)


@numba.njit(cache=True)
def _spill_all(
    image: FloatArray, full_well: float, row_fraction: float, mask: IntArray, in_row: IntArray, in_column: IntArray
) -> float:
    """Spill along rows, then along columns; return the electrons that left. A `mask` without columns is not filled."""
    ny, nx = image.shape
    lost = 0.0
    runs = np.empty(max(ny, nx) // 2 + 1, _RUN)
    start = np.zeros(nx + 1, np.int64)
    start[1:] = np.cumsum(in_column)
    # saturated rows, listed column by column
    rows = np.empty(start[-1], np.int32)
    next_index = start[:-1].copy()
    saturated = np.empty(nx, np.int32)
    for y in range(ny):
        if in_row[y]:
            count = 0
            for x in range(nx):
                if image[y, x] > full_well:
                    saturated[count] = x
                    count += 1
                    rows[next_index[x]] = y
                    next_index[x] += 1
                    if mask.size:
                        mask[y, x] |= SATURATED
            if row_fraction > 0:
                # ::1 gives the same array type as columns, so that one compiled function serves both
                lost += _spill(image[y, ::1], full_well, row_fraction, mask[y, ::1], saturated[:count], runs)
    for x in range(nx):
        if in_column[x]:
            marks = mask[:, x] if mask.size else mask[0, ::1]
            lost += _spill(image[:, x], full_well, 1.0, marks, rows[start[x] : start[x + 1]], runs)
    return lost


@numba.njit(cache=True)
def _spill(
    line: FloatArray, full_well: float, fraction: float, marks: IntArray, saturated: IntArray, runs: AnyArray
) -> float:
    """Spill a fraction of each excess of a line; return the electrons that left.

    saturated: the line's saturated pixels, ascending; runs: work space.
    """
    count = 0
    for pixel in saturated:
        if count == 0 or pixel >= runs[count - 1].end:
            count = _grow(line, full_well, fraction, runs, count, pixel)
    lost = 0.0
    for index in range(count):
        lost += _fill(line, full_well, fraction, marks, runs[index])
    return lost


@numba.njit(cache=True)
def _excess(charge: float, full_well: float, fraction: float) -> float:
    """Return the charge that a pixel gives away (> 0), or minus the charge that it takes until it is full."""
    excess = charge - full_well
    return excess * fraction if excess > 0 else excess


@numba.njit(cache=True)
def _grow(line: FloatArray, full_well: float, fraction: float, runs: AnyArray, count: int, pixel: int) -> int:
    """Grow a run from a saturated pixel until neither end is above the full well, merging runs; return their number."""
    start = pixel - 1
    end = pixel + 1
    excess = moment = _excess(line[pixel], full_well, fraction)
    while True:
        to_end = moment / (end - start)
        if end < len(line):
            added = _excess(line[end], full_well, fraction)
            if added + to_end > 0:
                moment += added * (end - start)
                excess += added
                end += 1
                continue
        if start >= 0:
            joins = count > 0 and runs[count - 1].end == start
            from_below = _charge_to_upper_end(runs[count - 1]) if joins else 0.0
            added = _excess(line[start], full_well, fraction)
            if added + from_below + (excess - to_end) > 0:
                grown = start - runs[count - 1].start if joins else 1
                excess += added
                moment += excess * grown
                start -= grown
                if joins:
                    count -= 1
                    excess += runs[count].excess
                    moment += runs[count].moment
                continue
        run = runs[count]
        run.start = start
        run.end = end
        run.excess = excess
        run.moment = moment
        return count + 1


@numba.njit(cache=True)
def _charge_to_upper_end(run: np.record) -> float:
    """Return the charge that a run gives to its upper end."""
    return run.moment / (run.end - run.start)


@numba.njit(cache=True)
def _fill(line: FloatArray, full_well: float, fraction: float, marks: IntArray, run: np.record) -> float:
    """Fill the pixels of a run and add charge to its ends; return the charge that leaves the line."""
    start = run.start
    end = run.end
    to_upper = _charge_to_upper_end(run)
    to_lower = run.excess - to_upper
    for pixel in range(start + 1, end):
        was_saturated = line[pixel] > full_well
        line[pixel] = full_well + (1.0 - fraction) * (line[pixel] - full_well) if was_saturated else full_well
        if marks.size and not marks[pixel] & SATURATED:
            marks[pixel] |= BLED
    lost = 0.0
    for pixel, charge in ((start, to_lower), (end, to_upper)):
        if 0 <= pixel < len(line):
            line[pixel] += charge
            if marks.size and charge > 0:
                marks[pixel] |= BLED
        else:
            lost += charge
    return lost
