"""Counted electrons of a window (paper, Appendix B items 1 and 4) as the list of pixels that have some.

Photons of objects and cosmic rays reach one pixel in sixteen of a full-depth image. A plane of a whole chip would cost
0.3 CPU s, most of it for the pages of new memory.
"""

from dataclasses import dataclass

import numpy as np

from csstsim.base.types import IntArray


@dataclass(frozen=True, eq=False)
class SparsePlane:
    """A plane of `shape` (ny, nx) with electrons in the pixels of a list, and 0 electrons in all others."""

    shape: tuple[int, int]
    pixel: IntArray  # (n,) int32, flat indices, each larger than the one before
    electrons: IntArray  # (n,) int32

    def plus(self, pixel: IntArray, electrons: IntArray) -> "SparsePlane":
        """Return a SparsePlane with more electrons [e-]; arguments (m,) as those of the class."""
        position = np.searchsorted(self.pixel, pixel)
        present = np.append(self.pixel, -1)[position] == pixel
        sums = self.electrons.copy()
        sums[position[present]] += electrons[present]
        position = position[~present]
        absent = ~present
        merged = np.insert(self.pixel, position, pixel[absent]), np.insert(sums, position, electrons[absent])
        return SparsePlane(self.shape, *merged)

    def dense(self) -> IntArray:
        """Return the plane as an array of `shape`, int32."""
        plane = np.zeros(self.shape, np.int32)
        plane.reshape(-1)[self.pixel] = self.electrons
        return plane
