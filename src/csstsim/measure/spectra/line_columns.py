"""Emission lines that are looked for at a known redshift; columns and flags of the table of their fluxes."""

import numpy as np

# Vacuum wavelengths [angstrom] and fractions of the flux: atomic ratios, and 1.3 for [SII]. NIST Atomic Spectra
# Database; Storey & Zeippen 2000, MNRAS 312, 813.
LINES = {
    "Lya": ((1215.67, 1.0),),
    "CIV": ((1549.48, 1.0),),
    "CIII]": ((1908.73, 1.0),),
    "MgII": ((2799.12, 1.0),),
    "[OII]": ((3728.48, 1.0),),
    "[NeIII]": ((3869.86, 1.0),),
    "Hd": ((4102.89, 1.0),),
    "Hg": ((4341.68, 1.0),),
    "Hb": ((4862.68, 1.0),),
    "[OIII]": ((4960.30, 0.25), (5008.24, 0.75)),
    "Ha": ((6564.61, 1.0),),
    "[NII]": ((6549.85, 0.25), (6585.27, 0.75)),
    "[SII]": ((6718.29, 0.565), (6732.67, 0.435)),
    "[SIII]9071": ((9071.1, 1.0),),
    "[SIII]9533": ((9533.2, 1.0),),
}
# Bits in addition to those of spectrum_columns.FLAGS, which a line has if one of its columns has them
BLENDED = 1 << 10
PART = 1 << 11
BLIND = 1 << 12
FLAGS = {
    BLENDED: "another line of the spectrum is within 1.5 full widths at half maximum",
    PART: "a fifth or more of its flux is in columns that cannot be used",
    BLIND: "found without a redshift: the highest points above the continuum",
}
COLUMNS = {
    "id": (np.int64, "the object"),
    "row": (np.int32, "its row in the truth table"),
    "order": (np.int8, "order of the spectrum"),
    "line": (str, 'name; "" for a line found without a redshift'),
    "wavelength": (np.float64, "angstrom, observed; of a multiplet the mean"),
    "column": (np.float64, "px, x of the chip, from 0"),
    "flux": (np.float32, "erg / s / cm2"),
    "flux_err": (np.float32, "its error"),
    "snr": (np.float32, "flux / flux_err"),
    "limit": (np.float32, "erg / s / cm2, at S/N below 3: flux, at least 0, plus 3 flux_err; NaN: detected"),
    "shift": (np.float32, "px, along x: position of the line minus that of its wavelength (`column`)"),
    "shift_err": (np.float32, "its error"),
    "continuum": (np.float32, "erg / s / cm2 / angstrom, at the line"),
    "flux_true": (np.float32, "erg / s / cm2: fit of the spectrum's column `model`, total flux; NaN: not known"),
    "flags": (np.int16, "bits, see below"),
}
