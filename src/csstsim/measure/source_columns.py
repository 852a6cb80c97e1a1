"""Columns and flags of the table of measured sources (measure.catalogue)."""

import numpy as np

# Bits of `flags`.
BLENDED = 1
TRUNCATED = 2
SATURATED = 4
NEGATIVE_FLUX = 8
KRON_FAILED = 16
NOT_CENTRED = 32
SHARP = 64
BAD_PIXELS = 128
NO_SHAPE = 256
FLAGS = {
    BLENDED: "deblended from another source",
    TRUNCATED: "reaches the edge of the frame",
    SATURATED: "saturated pixels within 3 px; they are left out of the fit",
    NEGATIVE_FLUX: "PSF or Kron flux is not positive: its magnitude is NaN",
    KRON_FAILED: "no Kron radius: the smallest aperture was used",
    NOT_CENTRED: "windowed position failed: x, y are the isophotal barycentre",
    SHARP: "sharper than the PSF by 5 sigma, or a line narrower than it: cosmic ray or defect",
    BAD_PIXELS: "defects or cosmic rays within 3 px; they are left out of the fit",
    NO_SHAPE: "S/N below 5, or no adaptive moments: hsm_sigma, hsm_e1, hsm_e2, resolution, g1, g2, g_err are NaN",
}
# Type and meaning of each column; pixel centres are at whole numbers, the chip's first at 0
COLUMNS = {
    "obsid": (str, "exposure"),
    "chip": (np.int16, "chip"),
    "filter": (str, "filter"),
    "number": (np.int32, "row: 0 is the highest S/N"),
    "x": (np.float64, "px, column on the whole chip, from 0"),
    "y": (np.float64, "px, row on the whole chip, from 0"),
    "ra": (np.float64, "deg, ICRS at the epoch of the exposure: aberration and light deflection undone"),
    "dec": (np.float64, "deg, the same"),
    "ra_apparent": (np.float64, "deg, apparent direction, that of the image's WCS"),
    "dec_apparent": (np.float64, "deg, the same"),
    "pos_err": (np.float32, "arcsec on an axis"),
    "flux_psf": (np.float64, "electrons of the exposure, fit of the PSF"),
    "flux_psf_err": (np.float64, "its error"),
    "mag_psf": (np.float64, "AB; NaN where the flux is not positive"),
    "mag_psf_err": (np.float64, "its error"),
    "flux_aper": (np.float64, "electrons within 4 px over the fraction of a point's flux there: the total of a point"),
    "flux_aper_err": (np.float64, "its error"),
    "mag_aper": (np.float64, "AB; NaN where the flux is not positive"),
    "mag_aper_err": (np.float64, "its error"),
    "flux_kron": (np.float64, "electrons in the Kron ellipse, not corrected for the flux beyond it"),
    "flux_kron_err": (np.float64, "its error"),
    "mag_kron": (np.float64, "AB; NaN where the flux is not positive"),
    "mag_kron_err": (np.float64, "its error"),
    "flux_total": (
        np.float64,
        "electrons of the exposure: total flux of a fitted profile (measure.light.total_light)",
    ),
    "flux_total_err": (np.float64, "its error, size and profile free"),
    "mag_total": (np.float64, "AB; NaN where the flux is not positive"),
    "mag_total_err": (np.float64, "its error"),
    "flux_gaap": (
        np.float64,
        "electrons in a Gaussian aperture, FWHM 1 arcsec, before the PSF: for colours",
    ),
    "flux_gaap_err": (np.float64, "its error"),
    "mag_gaap": (np.float64, "AB; NaN where the flux is not positive"),
    "mag_gaap_err": (np.float64, "its error"),
    "half_light": (np.float32, "arcsec, half-light radius sqrt(a b) of the fitted profile before the PSF"),
    "point": (
        np.float32,
        "probability of a point, from the fit of profiles and the fraction of points at its magnitude; star: 0.5 on",
    ),
    "snr": (np.float32, "flux_psf / flux_psf_err; 0 where there is no error"),
    "fwhm": (np.float32, "px, twice the half-light radius"),
    "a": (np.float32, "px, major axis of the isophote's moments, rms"),
    "b": (np.float32, "px, minor axis"),
    "theta": (np.float32, "rad, of the major axis from +x to +y"),
    "hsm_sigma": (np.float32, "px, adaptive moments: det(M)^(1/4)"),
    "hsm_e1": (np.float32, "distortion (a2 - b2) / (a2 + b2) on pixel axes, along x"),
    "hsm_e2": (np.float32, "the same, at 45 deg towards +y"),
    "psf_sigma": (np.float32, "px, adaptive moments of the PSF model at the source"),
    "psf_e1": (np.float32, "distortion of the PSF model at the source"),
    "psf_e2": (np.float32, "the same"),
    "resolution": (np.float32, "0 for a star, 1 for a galaxy much larger than the PSF"),
    "g1": (np.float32, "ellipticity (a - b) / (a + b) without the PSF, axis 1 along +RA (east)"),
    "g2": (np.float32, "the same, axis 2 at 45 deg towards north"),
    "g_err": (np.float32, "error of g1, g2, on an axis"),
    "chi2": (np.float32, "reduced, of the PSF's fit"),
    "spread": (np.float32, "size beyond the PSF (measure.light.photometry): 0 for a star"),
    "spread_err": (np.float32, "its error"),
    "star": (
        bool,
        "`point` is at least 0.5; where it is not known, no wider than the PSF within 2.5 sigma of `spread`",
    ),
    "zeropoint": (np.float64, "AB magnitude of 1 electron"),
    "rms": (np.float32, "electrons, noise of the background at the source"),
    "flags": (np.int32, "bits, see below"),
}
