"""Pixels about a trace, turned so that a row holds one column of the chip: what is measured together lies together."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Self, cast

import numba
import numpy as np

from csstsim.base.types import AnyArray, FloatArray, IntArray
from csstsim.measure.calibration.bad_pixels import FULL

if TYPE_CHECKING:
    from csstsim.measure.spectra.extract import DispersedImage

# bits of `seen`, beside FULL
INSIDE = np.uint8(8)
GOOD = np.uint8(16)
_NOTHING = np.zeros((0, 0), np.float32)


@dataclass(frozen=True, eq=False)
class Cutout:
    """Pixels (columns, rows) about a trace.

    `data` electrons, less those of others if these are subtracted, 0 where not GOOD; `others` electrons, or None if
    they are not known; `offset` px across from the trace; `seen` uint8 bits INSIDE (of the window), GOOD (usable), FULL
    (saturated); `response`.
    """

    data: FloatArray
    others: FloatArray | None
    offset: FloatArray
    seen: IntArray
    response: FloatArray

    @classmethod
    def of(
        cls, frame: DispersedImage, columns: IntArray, rows: IntArray, centre: FloatArray, own: FloatArray | None
    ) -> Self:
        """Return the Cutout of columns and rows (consecutive px of the chip) about a trace.

        frame: extract.DispersedImage; centre: rows of the trace, by column; own: what the object itself has in
        frame.others, float32 (rows, columns), or None without these.
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
        seen = np.zeros(shape, np.uint8)
        if frame.response is not None:
            response[:, inside] = frame.response.part(*part).T
        light = _NOTHING
        mine = _NOTHING
        if own is not None:
            light = cast("FloatArray", frame.others)[part]
            mine = own[inside]
        planes = data[:, inside], others[:, inside], seen[:, inside]
        _fill(frame.electrons[part], frame.marks[part], light, mine, float(frame.subtract), *planes)
        return cls(data, None if own is None else others, rows - centre[:, None], seen, response)

    def within(self, half: float, shares: FloatArray) -> tuple[Cutout, FloatArray]:
        """Return (Cutout, shares) of the rows with pixels of an aperture, up to `half` [px] from the trace.

        shares (columns, rows): any plane of the cutout.
        """
        near = np.flatnonzero((self.offset.min(axis=0) < half + 0.5) & (self.offset.max(axis=0) > -half - 0.5))
        part = slice(near[0], near[-1] + 1)

        def cut(plane: AnyArray) -> AnyArray:
            return np.ascontiguousarray(plane[:, part])

        others = None if self.others is None else cut(self.others)
        return Cutout(cut(self.data), others, cut(self.offset), cut(self.seen), cut(self.response)), cut(shares)


@numba.njit(cache=True)
def _fill(
    electrons: FloatArray,
    marks: IntArray,
    light: FloatArray,
    own: FloatArray,
    taken: float,
    data: FloatArray,
    others: FloatArray,
    seen: IntArray,
) -> None:
    """Fill the (columns, rows) of a Cutout from (rows, columns); light, own: of others, or nothing; taken: 1 if they
    are subtracted, else 0."""
    for y in range(electrons.shape[0]):
        for x in range(electrons.shape[1]):
            value = np.float64(electrons[y, x])
            mark = marks[y, x]
            if light.size:
                others[x, y] = np.float64(light[y, x]) - np.float64(own[y, x])
            seen[x, y] = INSIDE
            if mark & FULL:
                seen[x, y] |= FULL
            elif not mark and np.isfinite(value):
                seen[x, y] |= GOOD
                data[x, y] = value - taken * others[x, y]
