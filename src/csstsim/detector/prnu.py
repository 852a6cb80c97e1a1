"""Pixel response non-uniformity (paper, Appendix B item 3): a pixel's response is 1 + rms x z, z normal.

z is fixed for each pixel of a chip and clipped to +-CLIP, so that no response is above `highest` (7 in a million are
clipped, which lowers the rms by 2e-5). Left out: correlation between pixels, colour.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np

    from csstsim.base.types import FloatArray, IntArray


CLIP = 4.5


def highest(rms: float) -> float:
    """Return the upper limit of a pixel's response (relative, dimensionless)."""
    return 1 + CLIP * rms


def multiply(image: FloatArray, x0: int, y0: int, rms: float, key: np.uint64) -> None:
    """Multiply `image` (ny, nx) float32, whose first pixel is column x0, row y0 of the chip, by the response, in place.

    key: uint64 of the chip (rng.Streams.chip_key). Raises ValueError for an rms that makes a response negative.
    """
    if _is_positive(rms):
        from csstsim.detector.prnu_rows import multiply_rows

        multiply_rows(image, x0, y0, rms, key, CLIP)


def multiply_at(values: FloatArray, x: IntArray, y: IntArray, rms: float, key: np.uint64) -> None:
    """Multiply `values` (n,) float32 by the response of the pixels in columns x and rows y of the chip, in place.

    rms, key: as for `multiply`; x, y: int (n,). Raises ValueError as `multiply`.
    """
    if _is_positive(rms):
        from csstsim.detector.prnu_rows import multiply_pixels

        multiply_pixels(values, x, y, rms, key, CLIP)


def _is_positive(rms: float) -> bool:
    if not 0 <= rms < 1 / CLIP:
        raise ValueError(f"relative rms {rms} is not from 0 to 1 / {CLIP}")
    return rms > 0
