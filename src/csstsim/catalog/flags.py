"""What can befall an object on its way to the image: bits of the `flags` column."""

TRUNCATED_STAMP = 1  # light is lost outside the largest stamp, more than the noise hides
STRONG_LENSING = 2  # kappa and gamma are no thin shear (|g| >= 1, kappa >= 1 or mu <= 0): not drawn
SATURATED = 4  # pixels above full well
OFF_CHIP = 8  # the stamp misses the window after all
SKIPPED_FAINT = 16  # below the rendering floor
BAD_VALUE = 32  # a NaN, infinity or impossible number in a column that is used: not drawn
OUTSIDE_PSF_HULL = 64  # outside the grid of PSF nodes
FFT_REDUCED = 128  # drawn with loosened FFT accuracy
NEGATIVE_CLIPPED = 256  # more than a trace of its light lay in negative pixels and was clipped
TOO_LARGE = 512  # no FFT the renderer allows would hold it: not drawn

NAMES = {
    TRUNCATED_STAMP: "TRUNCATED_STAMP",
    STRONG_LENSING: "STRONG_LENSING",
    SATURATED: "SATURATED",
    OFF_CHIP: "OFF_CHIP",
    SKIPPED_FAINT: "SKIPPED_FAINT",
    BAD_VALUE: "BAD_VALUE",
    OUTSIDE_PSF_HULL: "OUTSIDE_PSF_HULL",
    FFT_REDUCED: "FFT_REDUCED",
    NEGATIVE_CLIPPED: "NEGATIVE_CLIPPED",
    TOO_LARGE: "TOO_LARGE",
}
