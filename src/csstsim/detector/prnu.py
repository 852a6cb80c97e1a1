"""Pixel response non-uniformity (paper, Appendix B item 3): each pixel counts 1 + rms x z of the light, z normal.

z is the pixel's own for the life of the chip, and held within +-CLIP, so that no pixel is above `highest` (7 in a
million are held, which takes 2e-5 off the rms). Left out: correlation between pixels, colour.
"""

CLIP = 4.5


def highest(rms):
    """Return what no pixel's response is above."""
    return 1 + CLIP * rms


def multiply(image, x0, y0, rms, key):
    """Multiply `image` (ny, nx) float32, whose first pixel is column x0, row y0 of the chip, by the response, in place.

    key: uint64 of the chip (rng.Streams.chip_key). Raises ValueError for an rms that makes a response negative.
    """
    if not 0 <= rms < 1 / CLIP:
        raise ValueError(f"a relative rms of {rms}: not within 0 and 1 / {CLIP}")
    if rms > 0:
        from csstsim.detector.prnu_rows import multiply_rows

        multiply_rows(image, x0, y0, rms, key, CLIP)
