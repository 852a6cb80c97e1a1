"""Counted electrons of a window (paper, Appendix B items 1 and 4) as the list of pixels that have some.

Photons of objects and cosmic rays reach one pixel in sixteen of a full-depth image. A plane of a whole chip would cost
0.3 CPU s, most of it for the pages of new memory.
"""

from dataclasses import dataclass

import numpy as np

from csstsim.base.types import IntArray


@dataclass(frozen=True, eq=False)
class SparsePlane:
    """A plane of a `shape` (ny, nx) whose other pixels are 0 electrons."""

    shape: tuple[int, int]
    pixel: IntArray  # (n,) int32, flat indices, each larger than the one before
    electrons: IntArray  # (n,) int32

    def plus(self, pixel: IntArray, electrons: IntArray) -> "SparsePlane":
        """Return a SparsePlane with more electrons [e-]; arguments (m,) as those of the class."""
        at = np.searchsorted(self.pixel, pixel)
        there = np.append(self.pixel, -1)[at] == pixel
        sums = self.electrons.copy()
        sums[at[there]] += electrons[there]
        at = at[~there]
        new = ~there
        both = np.insert(self.pixel, at, pixel[new]), np.insert(sums, at, electrons[new])
        return SparsePlane(self.shape, *both)

    def dense(self) -> IntArray:
        """Return the plane as an array of `shape`, int32."""
        plane = np.zeros(self.shape, np.int32)
        plane.reshape(-1)[self.pixel] = self.electrons
        return plane
