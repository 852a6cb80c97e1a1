"""Rectangles: minimum and maximum of x and y."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from csstsim.base.types import FloatArray


class Bounds(NamedTuple):
    """Minimum and maximum of x and y, in the unit of the positions."""

    x0: float
    x1: float
    y0: float
    y1: float


def bounds_of(positions: FloatArray) -> Bounds:
    """Return the Bounds of positions (n, 2), the smallest rectangle that contains them."""
    low = positions.min(axis=0)
    high = positions.max(axis=0)
    return Bounds(low[0], high[0], low[1], high[1])
