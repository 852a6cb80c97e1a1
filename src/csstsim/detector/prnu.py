"""Pixel response non-uniformity (paper, Appendix B item 3): a pixel's response is 1 + rms x z, z normal.

z is fixed for each pixel of a chip and clipped to +-CLIP, so that no response is above `highest` (7 in a million are
clipped, which lowers the rms by 2e-5). Left out: correlation between pixels, colour.
"""

CLIP = 4.5


def highest(rms):
    """Return the upper limit of a pixel's response (relative, dimensionless)."""
    return 1 + CLIP * rms


def multiply(image, x0, y0, rms, key):
    """Multiply `image` (ny, nx) float32, whose first pixel is column x0, row y0 of the chip, by the response, in place.

    key: uint64 of the chip (rng.Streams.chip_key). Raises ValueError for an rms that makes a response negative.
    """
    if _varies(rms):
        from csstsim.detector.prnu_rows import multiply_rows

        multiply_rows(image, x0, y0, rms, key, CLIP)


def multiply_at(values, x, y, rms, key):
    """Multiply `values` (n,) float32 by the response of the pixels in columns x and rows y of the chip, in place.

    rms, key as of `multiply`; x, y: int (n,). Raises ValueError as `multiply`.
    """
    if _varies(rms):
        from csstsim.detector.prnu_rows import multiply_pixels

        multiply_pixels(values, x, y, rms, key, CLIP)


def _varies(rms):
    if not 0 <= rms < 1 / CLIP:
        raise ValueError(f"relative rms {rms} is not from 0 to 1 / {CLIP}")
    return rms > 0
