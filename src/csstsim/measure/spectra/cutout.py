"""Pixels around a trace, transposed: a row is one column of the chip, so that its pixels are contiguous in memory."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Self, cast

import numba
import numpy as np

from csstsim.base.types import AnyArray, FloatArray, IntArray
from csstsim.measure.calibration.bad_pixels import FULL

if TYPE_CHECKING:
    from csstsim.measure.spectra.extract import DispersedImage

# bits of `status`, in addition to FULL
INSIDE = np.uint8(8)
GOOD = np.uint8(16)
_NOTHING = np.zeros((0, 0), np.float32)


@dataclass(frozen=True, eq=False)
class Cutout:
    """Pixels (columns, rows) about a trace.

    `data` electrons, without those of other objects if these are subtracted, 0 where not GOOD; `others` electrons of
    other objects, or None if they are not known; `offset` px across from the trace; `status` uint8 bits INSIDE (of the
    window), GOOD (usable), FULL (saturated); `response`.
    """

    data: FloatArray
    others: FloatArray | None
    offset: FloatArray
    status: IntArray
    response: FloatArray

    @classmethod
    def of(
        cls, frame: DispersedImage, columns: IntArray, rows: IntArray, centre: FloatArray, own: FloatArray | None
    ) -> Self:
        """Return the Cutout of columns and rows (consecutive px of the chip) around a trace.

        frame: extract.DispersedImage; centre: rows of the trace, by column; own: electrons of the object itself in
        frame.others, float32 (rows, columns), or None without frame.others.
        """
        window = frame.window
        shape = (len(columns), len(rows))
        first_row = int(rows[0])
        low = min(max(first_row, window.y0), window.y1) - window.y0
        high = min(max(int(rows[-1]) + 1, window.y0), window.y1) - window.y0
        part = slice(low, high), slice(int(columns[0]) - window.x0, int(columns[-1]) + 1 - window.x0)
        inside = slice(low + window.y0 - first_row, high + window.y0 - first_row)
        data = np.zeros(shape)
        others = np.zeros(shape)
        response = np.ones(shape)
        status = np.zeros(shape, np.uint8)
        if frame.response is not None:
            response[:, inside] = frame.response.part(*part).T
        expected = _NOTHING
        expected_own = _NOTHING
        if own is not None:
            expected = cast("FloatArray", frame.others)[part]
            expected_own = own[inside]
        planes = data[:, inside], others[:, inside], status[:, inside]
        _fill(frame.electrons[part], frame.marks[part], expected, expected_own, float(frame.subtract), *planes)
        return cls(data, None if own is None else others, rows - centre[:, None], status, response)

    def within(self, half: float, fractions: FloatArray) -> tuple[Cutout, FloatArray]:
        """Return (Cutout, fractions) of the rows with pixels of an aperture, up to `half` [px] from the trace.

        fractions (columns, rows): any plane of the cutout.
        """
        near = np.flatnonzero((self.offset.min(axis=0) < half + 0.5) & (self.offset.max(axis=0) > -half - 0.5))
        part = slice(near[0], near[-1] + 1)

        def cut(plane: AnyArray) -> AnyArray:
            return np.ascontiguousarray(plane[:, part])

        others = None if self.others is None else cut(self.others)
        return Cutout(cut(self.data), others, cut(self.offset), cut(self.status), cut(self.response)), cut(fractions)


@numba.njit(cache=True)
def _fill(
    electrons: FloatArray,
    marks: IntArray,
    expected: FloatArray,
    expected_own: FloatArray,
    subtract: float,
    data: FloatArray,
    others: FloatArray,
    status: IntArray,
) -> None:
    """Fill data, others and status (columns, rows) of a Cutout from planes (rows, columns).

    expected: electrons of all objects, and expected_own: of the object itself, both empty if not known; subtract: 1 if
    those of others are subtracted, else 0.
    """
    for y in range(electrons.shape[0]):
        for x in range(electrons.shape[1]):
            value = np.float64(electrons[y, x])
            mark = marks[y, x]
            if expected.size:
                others[x, y] = np.float64(expected[y, x]) - np.float64(expected_own[y, x])
            status[x, y] = INSIDE
            if mark & FULL:
                status[x, y] |= FULL
            elif not mark and np.isfinite(value):
                status[x, y] |= GOOD
                data[x, y] = value - subtract * others[x, y]
