"""Canvas: the pixels of a window that objects are rendered on, as two planes of electrons."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np

from csstsim.base.types import FloatArray, IntArray
from csstsim.instrument.chip import Window

Box: TypeAlias = tuple[int, int, int, int]  # x0, x1, y0, y1 of pixels, half-open


@dataclass(eq=False)
class Canvas:
    """The pixels of a window, changed in place, and their response.

    * expected: (window.ny, window.nx) float32 or float64, expected electrons; `poisson_and_dark` adds their Poisson
      noise
    * counted: int32, same shape, electrons drawn one by one, Poisson noise included; None until the first is drawn
    * response: same shape, fraction of the light that is detected, at most `maximum`; None: all light is detected
    """

    expected: FloatArray | None
    window: Window
    response: FloatArray | None = None
    maximum: float = 1.0
    counted: IntArray | None = None

    @cached_property
    def response_array(self) -> FloatArray:
        """The response as an array."""
        return np.ones(self.window.shape, np.float32) if self.response is None else self.response

    def count(self) -> IntArray:
        """Return the plane of counted electrons; make it if there is none yet."""
        if self.counted is None:
            self.counted = np.zeros(self.window.shape, np.int32)
        return self.counted

    def cut(self, box: Box) -> tuple[slice, slice]:
        """Return the slices (rows, columns) of the planes for a box (x0, x1, y0, y1) of the chip within the window."""
        x0, x1, y0, y1 = box
        return slice(y0 - self.window.y0, y1 - self.window.y0), slice(x0 - self.window.x0, x1 - self.window.x0)

    @property
    def corner(self) -> IntArray:
        """(4,) the offset to add to a box in plane coordinates to get the box on the chip."""
        return np.array([self.window.x0, self.window.x0, self.window.y0, self.window.y0])


def around(boxes: Sequence[Box | IntArray]) -> Box:
    """Return the smallest box (x0, x1, y0, y1) that encloses all boxes; zeros if there are none."""
    x0, x1, y0, y1 = np.transpose(boxes) if boxes else np.zeros((4, 1), int)  # type: ignore[arg-type]  # of both
    return x0.min(), x1.max(), y0.min(), y1.max()
