"""Blooming (paper, Appendix B item 9): charge above the full well spills equally into both neighbours.

Along a line of pixels this is the divisible sandpile (Levine & Peres 2009, Potential Analysis 30, 1): a pixel above the
full well keeps a full well and gives half of the excess to each neighbour, until no pixel is above it. The result does
not depend on the order and has a closed form: runs of saturated pixels, each with a pixel at either end that receives

    at the upper end  sum e_m (m - i) / (j - i),   at the lower end  sum e_m (j - m) / (j - i)

for a run between i and j with excesses e_m = Q_m - full well (a random walk's probabilities to leave at each end). Runs
grow until their ends are not above the full well, and merge where they meet. The time is linear in the pixels filled.

A share of each excess spills along its row first, then the remaining excess along the column. Columns run across the
middle of the chip, because its halves differ only in the clocks. Charge that reaches a border leaves the image (at the
upper and lower border into the registers) and is counted. Left out: differences between wells, the trail of charge in
the serial register, blooming during readout.
"""

import numba
import numpy as np

from csstsim.base.types import AnyArray, FloatArray, IntArray
from csstsim.detector.mask import BLED, SATURATED

# A run of saturated pixels between `start` and `end`: sum of excesses e_m, and of e_m (m - start).
_RUN = np.dtype([("start", np.int64), ("end", np.int64), ("excess", np.float64), ("moment", np.float64)])


def bloom(
    image: FloatArray, full_well: float, row_share: float = 0.0, mask: IntArray | None = None
) -> tuple[int, float]:
    """Spill the charge of `image` (ny, nx; electrons, float32) above `full_well` [e-], in place.

    `row_share` 0..1: part of each excess that spills along its row. `mask` (uint8, same shape) or None: SATURATED is
    set where charge was above the full well, BLED where charge arrived from other pixels. Returns (saturated pixels,
    electrons that left through the borders). Charge is conserved to float32's rounding of each run's two ends; a
    negative pixel has more room. Raises ValueError, and leaves the image unchanged, if a pixel is not finite, the full
    well is not positive or the share is out of range.
    """
    if not full_well > 0 or not 0 <= row_share <= 1:
        raise ValueError(f"full well {full_well}, row share {row_share}; need more than 0, and 0..1")
    in_row, in_column, bad = _search(image, full_well)
    if bad:
        raise ValueError(f"the charge of {bad} pixel(s) is not finite")
    number = int(in_row.sum())
    if not number:
        return 0, 0.0
    marks = np.zeros((image.shape[0], 0), np.uint8) if mask is None else mask
    return number, _spill_all(image, float(full_well), float(row_share), marks, in_row, in_column)


@numba.njit(cache=True)
def _search(image: FloatArray, full_well: float) -> tuple[IntArray, IntArray, int]:
    """Return (saturated pixels of each row, of each column, pixels that are not finite)."""
    ny, nx = image.shape
    in_row = np.zeros(ny, np.int64)
    in_column = np.zeros(nx, np.int64)
    bad = 0
    for y in range(ny):
        for x in range(nx):
            in_row[y] += not image[y, x] <= full_well
            bad += image[y, x] == -np.inf
        if in_row[y]:
            for x in range(nx):
                in_column[x] += not image[y, x] <= full_well
                bad += not image[y, x] < np.inf
    return in_row, in_column, bad


@numba.njit(cache=True)
def _spill_all(
    image: FloatArray, full_well: float, row_share: float, mask: IntArray, in_row: IntArray, in_column: IntArray
) -> float:
    """Spill along rows, then along columns; return the electrons that left. `mask` may have no columns."""
    ny, nx = image.shape
    lost = 0.0
    runs = np.empty(max(ny, nx) // 2 + 1, _RUN)
    start = np.zeros(nx + 1, np.int64)
    start[1:] = np.cumsum(in_column)
    # saturated rows, listed column by column
    rows = np.empty(start[-1], np.int32)
    found = start[:-1].copy()
    here = np.empty(nx, np.int32)
    for y in range(ny):
        if in_row[y]:
            number = 0
            for x in range(nx):
                if image[y, x] > full_well:
                    here[number] = x
                    number += 1
                    rows[found[x]] = y
                    found[x] += 1
                    if mask.size:
                        mask[y, x] |= SATURATED
            if row_share > 0:
                # ::1 gives the same array type as columns, so that one compiled function serves both
                lost += _spill(image[y, ::1], full_well, row_share, mask[y, ::1], here[:number], runs)
    for x in range(nx):
        if in_column[x]:
            marks = mask[:, x] if mask.size else mask[0, ::1]
            lost += _spill(image[:, x], full_well, 1.0, marks, rows[start[x] : start[x + 1]], runs)
    return lost


@numba.njit(cache=True)
def _spill(
    line: FloatArray, full_well: float, share: float, marks: IntArray, saturated: IntArray, runs: AnyArray
) -> float:
    """Spill a share of each excess of a line; return the electrons that left. saturated: its pixels, ascending."""
    count = 0
    for p in saturated:
        if count == 0 or p >= runs[count - 1].end:
            count = _grow(line, full_well, share, runs, count, p)
    lost = 0.0
    for run in range(count):
        lost += _fill(line, full_well, share, marks, runs[run])
    return lost


@numba.njit(cache=True)
def _excess(charge: float, full_well: float, share: float) -> float:
    """Return the charge that a pixel gives away (> 0), or minus its room."""
    excess = charge - full_well
    return excess * share if excess > 0 else excess


@numba.njit(cache=True)
def _grow(line: FloatArray, full_well: float, share: float, runs: AnyArray, count: int, p: int) -> int:
    """Grow a run from the saturated pixel p until both ends have room, merging runs; return the number of runs."""
    start = p - 1
    end = p + 1
    excess = moment = _excess(line[p], full_well, share)
    while True:
        up = moment / (end - start)
        if end < len(line):
            more = _excess(line[end], full_well, share)
            if more + up > 0:
                moment += more * (end - start)
                excess += more
                end += 1
                continue
        if start >= 0:
            touches = count > 0 and runs[count - 1].end == start
            below = _up(runs[count - 1]) if touches else 0.0
            more = _excess(line[start], full_well, share)
            if more + below + (excess - up) > 0:
                reach = start - runs[count - 1].start if touches else 1
                excess += more
                moment += excess * reach
                start -= reach
                if touches:
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
def _up(run: np.record) -> float:
    """Return the charge that a run gives to its upper end."""
    return run.moment / (run.end - run.start)


@numba.njit(cache=True)
def _fill(line: FloatArray, full_well: float, share: float, marks: IntArray, run: np.record) -> float:
    """Fill the pixels of a run and add charge to its ends; return the charge that leaves the line."""
    start = run.start
    end = run.end
    up = _up(run)
    down = run.excess - up
    for p in range(start + 1, end):
        source = line[p] > full_well
        line[p] = full_well + (1.0 - share) * (line[p] - full_well) if source else full_well
        if marks.size and not marks[p] & SATURATED:
            marks[p] |= BLED
    lost = 0.0
    for p, part in ((start, down), (end, up)):
        if 0 <= p < len(line):
            line[p] += part
            if marks.size and part > 0:
                marks[p] |= BLED
        else:
            lost += part
    return lost
