"""How each object was rendered: recorded by the renderers and returned as the truth columns described in io.truth."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from csstsim.catalog.flags import NOT_RENDERED, OFF_CHIP, OUTSIDE_PSF_HULL, TRUNCATED_STAMP

if TYPE_CHECKING:
    from csstsim.base.types import AnyArray, BoolArray, FloatArray, IntArray
    from csstsim.catalog.table import ObjectTable
    from csstsim.optics.scatter.halo import Wing
    from csstsim.render.policy import Choice

NONE = "none"  # method of objects that are not rendered
# Columns that drawing adds
ADDED = "electrons", "drawn", "fraction", "method", "snr", "error", "stamp", "x0", "x1", "y0", "y1", "ms"


class DrawnTable:
    """One row per object of an ObjectTable from catalog.selection.select; `rows` are those that can be rendered.

    * electrons: nominal
    * drawn: electrons put on the window, whole ones for photons, expected ones otherwise; ghosts are added on top, so
      this may exceed `electrons`
    * method: name of a drawing method (render.method)
    * snr: S/N, with the noise of the object's own light and of the pixels it covers
    * error: predicted, in units of the object's own noise
    * stamp: side [pixel], wing included
    * box: x0 x1 y0 y1 on the chip, half-open; zeros: none
    * ms: CPU time, measured for each stamp (the first includes the set-up); for photons the total, divided by
      predicted cost
    * flags: catalog.flags
    """

    def __init__(self, objects: ObjectTable, electrons: FloatArray) -> None:
        """electrons: (n,) nominal."""
        count = len(objects)
        self.objects = objects
        self.electrons = electrons
        self.flags = objects["flags"].copy()
        self.rows = np.flatnonzero((self.flags & NOT_RENDERED == 0) & (electrons > 0))
        self.drawn = np.zeros(count)
        self.method = np.full(count, NONE, dtype="U10")
        self.ms = np.zeros(count, np.float32)
        self.error = np.zeros(count, np.float32)
        self.snr = np.zeros(count, np.float32)
        self.stamp = np.zeros(count, np.int32)
        self.box = np.zeros((count, 4), np.int32)

    def flag_optics(self, outside: BoolArray, wing: Wing | None) -> None:
        """Flag the drawable objects `outside` the PSF's nodes and, if `wing` is None, those that should have a wing."""
        self.flags[self.rows[outside]] |= OUTSIDE_PSF_HULL
        if wing is None:
            self.flags[self.rows[self.objects["wing"][self.rows] > 0]] |= TRUNCATED_STAMP

    def note_choice(self, rows: IntArray, choice: Choice, electrons: FloatArray) -> None:
        """Record S/N and predicted error of a Scene's rows, which belong to the objects `rows`, of so many electrons.

        Of an object of several parts, errors add up and S/N adds in squares.
        """
        if len(np.unique(rows)) == len(rows):
            self.snr[rows] = choice.snr
            self.error[rows] = choice.error
            return
        lit = electrons > 0
        square = np.zeros(len(self.snr))
        np.add.at(square, rows, choice.snr**2)
        self.snr[rows] = np.sqrt(square[rows])
        self.error[rows] = 0.0
        np.add.at(self.error, rows[lit], choice.error[lit])

    def note(self, rows: IntArray, drawn: FloatArray | IntArray, box: IntArray) -> None:
        """Add electrons and boxes to what was rendered of the objects `rows`; one may be named several times."""
        np.add.at(self.drawn, rows, drawn)
        lit = box[:, 1] > 0
        low = self.box[:, ::2].copy()
        high = self.box[:, 1::2].copy()
        low[high[:, 0] == 0] = np.iinfo(np.int32).max
        np.minimum.at(low, rows[lit], box[lit][:, ::2].astype(np.int32))
        np.maximum.at(high, rows[lit], box[lit][:, 1::2].astype(np.int32))
        low[high[:, 0] == 0] = 0
        self.box[:, ::2] = low
        self.box[:, 1::2] = high

    def name_methods(self, rows: IntArray, names: AnyArray, electrons: FloatArray) -> None:
        """Record how objects were rendered: of one of several parts, how the brightest was."""
        order = np.argsort(electrons, kind="stable")
        self.method[rows[order]] = names[order]

    def note_sides(self, rows: IntArray | slice, reach: AnyArray, wing: FloatArray) -> None:
        """Record the stamp sides of objects from the half sides of stamps and the radii of wings [px]."""
        self.stamp[rows] = (2 * np.maximum(reach, np.ceil(wing)) + 1).astype(np.int32)

    def miss(self, rows: IntArray | BoolArray) -> None:
        """Flag objects whose light misses the window as OFF_CHIP and not rendered."""
        self.flags[rows] |= OFF_CHIP
        self.method[rows] = NONE

    def table(self) -> ObjectTable:
        """Return the ObjectTable with the recorded values as columns."""
        electrons = self.electrons
        drawn = self.drawn
        fraction = np.divide(drawn, electrons, out=np.zeros(len(drawn)), where=electrons > 0)
        return self.objects.with_columns(
            flags=self.flags,
            electrons=electrons,
            drawn=drawn,
            fraction=fraction,
            method=self.method,
            snr=self.snr,
            error=self.error,
            stamp=self.stamp,
            **dict(zip(("x0", "x1", "y0", "y1"), self.box.T, strict=True)),
            ms=self.ms,
        )
