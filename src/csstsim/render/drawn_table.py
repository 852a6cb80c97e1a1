"""What came of each object: noted by whatever draws it, and written as the columns of truth that io.truth describes."""

import numpy as np

from csstsim.catalog.flags import NOT_DRAWN, OFF_CHIP, OUTSIDE_PSF_HULL, TRUNCATED_STAMP

NONE = "none"  # the method of what is not drawn


class DrawnTable:
    """A row an object of an ObjectTable from catalog.selection.select; `rows` are those that can be drawn.

    electrons (nominal), drawn (put on the window: whole electrons for photons, the sum of expected ones otherwise; with
    ghosts, which come on top, they may exceed the nominal ones), method (render.policy), snr (against its own light
    and the pixels it covers), error (predicted, in units of its own noise), stamp (side, pixel, its wing's included),
    box (x0 x1 y0 y1 on the chip, half-open; zeros: none), ms (CPU: measured for stamps, of which the first sets up the
    rest; for photons the time of all, shared by predicted cost), flags.
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
        """Flag the drawable objects `outside` the PSF's nodes, and those whose wing, not being there, is left out."""
        self.flags[self.rows[outside]] |= OUTSIDE_PSF_HULL
        if wing is None:
            self.flags[self.rows[self.objects["wing"][self.rows] > 0]] |= TRUNCATED_STAMP

    def note_sides(self, rows, reach, wing):
        """Note the stamps of objects from half their sides and the radii of their wings [px]."""
        self.stamp[rows] = (2 * np.maximum(reach, np.ceil(wing)) + 1).astype(np.int32)

    def miss(self, rows):
        """Objects whose light misses the window."""
        self.flags[rows] |= OFF_CHIP
        self.method[rows] = NONE

    def table(self):
        """Return the ObjectTable with the columns of what was drawn."""
        electrons, drawn = self.electrons, self.drawn
        fraction = np.divide(drawn, electrons, out=np.zeros(len(drawn)), where=electrons > 0)
        return self.objects.with_columns(
            flags=self.flags, electrons=electrons, drawn=drawn, fraction=fraction, method=self.method, snr=self.snr,
            error=self.error, stamp=self.stamp, **dict(zip(("x0", "x1", "y0", "y1"), self.box.T, strict=True)),
            ms=self.ms,
        )  # fmt: skip
