"""How each object was drawn: recorded by the renderers and returned as the truth columns described in io.truth."""

import numpy as np

from csstsim.catalog.flags import NOT_DRAWN, OFF_CHIP, OUTSIDE_PSF_HULL, TRUNCATED_STAMP

NONE = "none"  # method of objects that are not drawn


class DrawnTable:
    """One row per object of an ObjectTable from catalog.selection.select; `rows` are those that can be drawn.

    * electrons: nominal
    * drawn: electrons put on the window, whole ones for photons, expected ones otherwise; ghosts are added on top, so
      this may exceed `electrons`
    * method: see render.policy
    * snr: S/N, with the noise of the object's own light and of the pixels it covers
    * error: predicted, in units of the object's own noise
    * stamp: side [pixel], wing included
    * box: x0 x1 y0 y1 on the chip, half-open; zeros: none
    * ms: CPU time, measured for each stamp (the first includes the set-up); for photons the total, shared out by
      predicted cost
    * flags: catalog.flags
    """

    def __init__(self, objects, electrons):
        """electrons: (n,) nominal."""
        count = len(objects)
        self.objects, self.electrons, self.flags = objects, electrons, objects["flags"].copy()
        self.rows = np.flatnonzero((self.flags & NOT_DRAWN == 0) & (electrons > 0))
        self.drawn, self.method = np.zeros(count), np.full(count, NONE, dtype="U10")
        self.ms, self.error, self.snr = (np.zeros(count, np.float32) for _ in range(3))
        self.stamp, self.box = np.zeros(count, np.int32), np.zeros((count, 4), np.int32)

    def flag_optics(self, outside, wing):
        """Flag the drawable objects `outside` the PSF's nodes and, if `wing` is None, those that should have a wing."""
        self.flags[self.rows[outside]] |= OUTSIDE_PSF_HULL
        if wing is None:
            self.flags[self.rows[self.objects["wing"][self.rows] > 0]] |= TRUNCATED_STAMP

    def note_sides(self, rows, reach, wing):
        """Record the stamp sides of objects from the half sides of stamps and the radii of wings [px]."""
        self.stamp[rows] = (2 * np.maximum(reach, np.ceil(wing)) + 1).astype(np.int32)

    def miss(self, rows):
        """Flag objects whose light misses the window as OFF_CHIP and not drawn."""
        self.flags[rows] |= OFF_CHIP
        self.method[rows] = NONE

    def table(self):
        """Return the ObjectTable with the recorded values as columns."""
        electrons, drawn = self.electrons, self.drawn
        fraction = np.divide(drawn, electrons, out=np.zeros(len(drawn)), where=electrons > 0)
        return self.objects.with_columns(
            flags=self.flags, electrons=electrons, drawn=drawn, fraction=fraction, method=self.method, snr=self.snr,
            error=self.error, stamp=self.stamp, **dict(zip(("x0", "x1", "y0", "y1"), self.box.T, strict=True)),
            ms=self.ms,
        )  # fmt: skip
