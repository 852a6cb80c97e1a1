"""Bits of the `flags` column: what happened to an object when it was selected and drawn."""

from __future__ import annotations

TRUNCATED_STAMP = 1
STRONG_LENSING = 2
SATURATED = 4
OFF_CHIP = 8
SKIPPED_FAINT = 16
BAD_VALUE = 32
OUTSIDE_PSF_HULL = 64
FFT_REDUCED = 128
NEGATIVE_CLIPPED = 256
TOO_LARGE = 512
NOT_RENDERED = BAD_VALUE | STRONG_LENSING  # never drawn, whichever method draws the others

ABOUT = {
    TRUNCATED_STAMP: "light is lost outside the largest stamp, more than the noise hides",
    STRONG_LENSING: "no thin shear (|g| >= 1, kappa >= 1 or mu <= 0), or an arc in the embedded sky: not drawn",
    SATURATED: "light above the full well in a pixel at its place (imaging)",
    OFF_CHIP: "the stamp misses the window after all",
    SKIPPED_FAINT: "below the rendering floor",
    BAD_VALUE: "a NaN, infinity or impossible number in a column that is used: not drawn",
    OUTSIDE_PSF_HULL: "outside the grid of PSF nodes",
    FFT_REDUCED: "drawn with loosened FFT accuracy",
    NEGATIVE_CLIPPED: "more than a trace of its light lay in negative pixels and was clipped",
    TOO_LARGE: "no FFT the renderer allows would hold it: not drawn",
}
