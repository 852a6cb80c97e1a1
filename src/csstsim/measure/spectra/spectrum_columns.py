"""Columns and flags of the table of extracted spectra: a row is one column of pixels of one spectrum."""

import numpy as np

MASKED, SATURATED, COSMIC, EDGE, DIM, CONTAMINATED, LOST, CUT, BESIDE, UNEVEN = (1 << k for k in range(10))
IMAGED = 1 << 13  # the bits between are of lines alone (line_columns.FLAGS)
FLAGS = {
    MASKED: "a defect in the aperture, left out of the sums",
    SATURATED: "a saturated pixel in the aperture, left out",
    COSMIC: "a pixel in the aperture was rejected as a cosmic ray",
    EDGE: "the aperture reaches beyond the window",
    DIM: "too little throughput: no flux",
    CONTAMINATED: "the electrons of other orders are more than a tenth",
    LOST: "less than half of the aperture's flux is in usable pixels: no result",
    CUT: "the object is at the edge of its grating's piece: part of its light does not pass it",
    BESIDE: "within 3 columns of a saturated one (charge leaks along rows), or 63 of a saturated lost one (its wings)",
    UNEVEN: "the error of wings from brighter columns, at the spectrum's ends and lines, may exceed the stated error",
    IMAGED: "rendered from an image, which is treated as a disk, or near such an object with a tenth of its electrons",
}
COLUMNS = {
    "id": (np.int64, "the object"),
    "row": (np.int32, "its row in the truth table"),
    "order": (np.int8, "order of the spectrum"),
    "column": (np.int32, "px, x of the chip, from 0"),
    "y": (np.float32, "px, row of the trace"),
    "wavelength": (np.float64, "angstrom, of the column's middle"),
    "electrons": (np.float32, "electrons, by optimal extraction: total flux, without that of other orders"),
    "electrons_err": (np.float32, "its error"),
    "box": (np.float32, "electrons, the same by a box"),
    "box_err": (np.float32, "its error"),
    "flux": (np.float32, "photon / s / m2 / angstrom, of the optimal extraction"),
    "flux_err": (np.float32, "its error"),
    "flux_erg": (np.float32, "erg / s / cm2 / angstrom"),
    "contamination": (np.float32, "electrons of other orders that were subtracted; NaN: not known"),
    "model": (np.float32, "electrons expected from the truth; NaN: not known"),
    "sensitivity": (np.float32, "electrons of 1 photon / s / m2 / angstrom"),
    "sky": (np.float32, "electron / px"),
    "flags": (np.int16, "bits, see below"),
}
