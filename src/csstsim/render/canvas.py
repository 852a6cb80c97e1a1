"""Canvas: what light is drawn on, the pixels of a window in two planes."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from csstsim.instrument.chip import Window


@dataclass(eq=False)
class Canvas:
    """The pixels of a window, changed in place, and the share of the light there that is counted.

    * expected: (window.ny, window.nx) float32 or float64, electrons that become Poisson once, in `poisson_and_dark`
    * counted: int32 of that shape, electrons drawn one by one, which are Poisson already; None as long as there are
      none
    * response: of that shape, share of the light that is counted, nowhere above `maximum`; None: all of it
    """

    expected: np.ndarray | None
    window: Window
    response: np.ndarray | None = None
    maximum: float = 1.0
    counted: np.ndarray | None = None

    @cached_property
    def seen(self):
        """The response as an array."""
        return np.ones(self.window.shape, np.float32) if self.response is None else self.response

    def count(self):
        """Make the plane of counted electrons, if there is none, and return it."""
        if self.counted is None:
            self.counted = np.zeros(self.window.shape, np.int32)
        return self.counted

    def cut(self, box):
        """Return the slices of the planes that a box (x0, x1, y0, y1) of the chip, within the window, stands for."""
        x0, x1, y0, y1 = box
        return slice(y0 - self.window.y0, y1 - self.window.y0), slice(x0 - self.window.x0, x1 - self.window.x0)

    @property
    def corner(self):
        """(4,) what turns a box of the planes into one of the chip."""
        return np.array([self.window.x0, self.window.x0, self.window.y0, self.window.y0])


def around(boxes):
    """Return the box (x0, x1, y0, y1) around some; zeros: there is none."""
    x0, x1, y0, y1 = np.transpose(boxes) if boxes else np.zeros((4, 1), int)
    return x0.min(), x1.max(), y0.min(), y1.max()
