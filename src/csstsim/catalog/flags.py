"""Bits of the `flags` column: what happened to an object when it was selected and rendered."""

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
NOT_RENDERED = BAD_VALUE | STRONG_LENSING  # not rendered by any method

ABOUT = {
    TRUNCATED_STAMP: "flux is lost outside the largest stamp, more than the noise hides",
    STRONG_LENSING: "no thin shear (|g| >= 1, kappa >= 1 or mu <= 0), or an arc in the embedded sky: not rendered",
    SATURATED: "charge above the full well in a pixel at its position (imaging)",
    OFF_CHIP: "the stamp does not overlap the window",
    SKIPPED_FAINT: "below the rendering floor",
    BAD_VALUE: "a NaN, infinity or impossible number in a column that is used: not rendered",
    OUTSIDE_PSF_HULL: "outside the grid of PSF nodes",
    FFT_REDUCED: "rendered with reduced FFT accuracy",
    NEGATIVE_CLIPPED: "more than a trace of its flux was in negative pixels and was clipped",
    TOO_LARGE: "larger than the largest FFT of the renderer: not rendered",
}
