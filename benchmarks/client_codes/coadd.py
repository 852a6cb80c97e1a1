"""SWarp's coadd of the middle of a chip, with SCAMP's solution: its depth and its PSF against theory.

Depth: the rms of the light in apertures on empty sky, against what the noise of the single frames gives, weighted as
SWarp weights them. Empty is where no object of the truth is near, so that faint galaxies do not count as noise.

PSF: SWarp resamples with a Lanczos function of order 3. Over many positions of a star between pixels, the mean image is
the PSF, with the pixel, convolved with that function; psfex measures it, on stars that the truth names.
"""

import numpy as np
from astromatic import fwhm
from astropy.io import fits
from scipy.ndimage import convolve1d, map_coordinates
from scipy.spatial import cKDTree

from client_codes.frames import EXPTIME, find, program
from client_codes.scamp import fitted, quiet_wcs
from csstsim.io.truth import read_truth
from csstsim.optics.psf.psf_file import half_pixels, pixel_response
from csstsim.stages.psf import open_psf

SIDE, SHIFT = 3000, 300  # px of the coadd, about the middle of the chip; by which the exposures are shifted at most
SCALE = 0.074  # arcsec
APERTURE, EMPTY = 4.0, 12.0  # px: radius of an aperture; distance to the nearest object of the truth
FEWEST = 200  # apertures
FINE = 0.25  # px: step of the PSF's theory


def coadd(frames):
    """Let SWarp co-add the frames of a chip about its middle; return the paths of the image and of its weights."""
    folder = frames[0].stem.parent
    for frame in frames:
        with fits.open(frame.planes[1]) as file:
            weight = np.where(file[0].data < 1e30, file[0].data, np.inf) ** -2.0
            fits.writeto(
                frame.stem.with_suffix(".weight.fits"), weight.astype(np.float32), file[0].header, overwrite=True
            )
    window = frames[0].job.window
    centre = fitted(frames[0]).all_pix2world(0.5 * (window.x1 - window.x0), 0.5 * (window.y1 - window.y0), 1)
    name = f"coadd_{frames[0].job.chip.id:02d}"
    settings = {
        "IMAGEOUT_NAME": f"{name}.fits", "WEIGHTOUT_NAME": f"{name}.weight.fits", "WEIGHT_TYPE": "MAP_WEIGHT",
        "WEIGHT_SUFFIX": ".weight.fits", "RESCALE_WEIGHTS": "N", "COMBINE_TYPE": "WEIGHTED", "PROJECTION_TYPE": "TAN",
        "CENTER_TYPE": "MANUAL", "CENTER": f"{centre[0]:.8f},{centre[1]:.8f}", "PIXELSCALE_TYPE": "MANUAL",
        "PIXEL_SCALE": SCALE, "IMAGE_SIZE": min(SIDE, window.nx - 2 * SHIFT), "RESAMPLING_TYPE": "LANCZOS3",
        "SUBTRACT_BACK": "N",
        "FSCALE_KEYWORD": "NONE", "GAIN_KEYWORD": "NONE", "DELETE_TMPFILES": "Y", "WRITE_XML": "N",
        "VERBOSE_TYPE": "QUIET", "NTHREADS": 1,
    }  # fmt: skip
    program(folder, ["SWarp", *(frame.image.name for frame in frames)], name, settings)
    return folder / f"{name}.fits", folder / f"{name}.weight.fits"


def depth(image, frames, run, rng):
    """Return (rms measured, rms expected, number) of apertures on empty sky of a coadd [e-/s], at most 4000."""
    with fits.open(image) as file:
        pixels, wcs = file[0].data, quiet_wcs(file[0].header)
    truth = read_truth(run.paths.level0_truth(frames[0].job))
    objects = np.transpose(wcs.all_world2pix(truth["ra_epoch"], truth["dec_epoch"], 0))
    objects, sizes = (values[np.isfinite(objects).all(1)] for values in (objects, truth["stamp"]))
    places = rng.uniform(2 * APERTURE, len(pixels) - 2 * APERTURE, (20_000, 2))
    near = cKDTree(objects).query(places)[0] > EMPTY
    wide = sizes > 4 * EMPTY  # a large galaxy or a bright star covers more
    if wide.any():
        apart, which = cKDTree(objects[wide]).query(places)
        near &= apart > 0.5 * sizes[wide][which]
    places = places[near][:4000]
    sums, pixels_in = _apertures(pixels, places)
    sky = wcs.all_pix2world(*places.T, 0)
    inverse = np.zeros(len(places))
    for frame in frames:
        x, y = fitted(frame).all_world2pix(*sky, 0)
        with fits.open(frame.planes[1]) as file:
            rms = file[0].data
            column, row = (np.clip(np.rint(v).astype(int), 8, n - 9) for v, n in ((x, rms.shape[1]), (y, rms.shape[0])))
            local = np.median([rms[row + j, column + i] for j in (-6, -3, 0, 3, 6) for i in (-6, -3, 0, 3, 6)], axis=0)
        inverse += local.astype(float) ** -2.0
    expected = np.sqrt(pixels_in / inverse)
    pulls = sums / expected
    measured = 1.4826 * np.median(abs(pulls - np.median(pulls)))
    return float(measured * np.median(expected)), float(np.median(expected)), len(places)


def _apertures(image, places):
    """Return (sums, number of pixels) of circles of APERTURE at places (n, 2) [px]."""
    reach = int(APERTURE) + 1
    axis = np.arange(-reach, reach + 1)
    x, y = (np.rint(places[:, k]).astype(int) for k in (0, 1))
    inside = axis[:, None] ** 2 + axis**2 <= APERTURE**2
    rows, columns = np.nonzero(inside)
    return image[y[:, None] + axis[rows], x[:, None] + axis[columns]].sum(1, dtype=float), int(inside.sum())


def psfs(image, weight, frames, run, stars):
    """Return {name: (FWHM [px], light within 2, 3 and 5 px over that within 6)} of theory and psfex, and the stars."""
    model, number = measured_psf(image, weight, stars)
    single = single_psf(run, frames[0].job)
    found = {
        "one exposure, theory": (single, 0.5), "the coadd, theory": (resampled(single, 0.5), FINE),
        "the coadd, psfex": (model, 0.5),
    }  # fmt: skip
    return {name: (fwhm(psf, step), *_encircled(psf, step)) for name, (psf, step) in found.items()}, number


def single_psf(run, job):
    """Return the PSF in the middle of a chip with the pixel response, in light per px^2 on steps of half a px."""
    psf, window = open_psf(run, job.chip), job.window
    cells = psf.at(0.5 * (window.x0 + window.x1 - 1), 0.5 * (window.y0 + window.y1 - 1))
    return pixel_response(half_pixels(cells, psf.oversampling).mean(axis=0, dtype=np.float64), 2)


def resampled(psf, step):
    """Return a PSF convolved with the Lanczos function of order 3 along both axes, on steps of FINE px."""
    reach = 12.0
    at = np.arange(-reach, reach + 0.5 * FINE, FINE) / step + len(psf) // 2
    fine = map_coordinates(psf, np.meshgrid(at, at, indexing="ij"), order=3)
    axis = np.arange(-3, 3 + 0.5 * FINE, FINE)
    lanczos = np.sinc(axis) * np.sinc(axis / 3)
    for k in (0, 1):
        fine = convolve1d(fine, lanczos / lanczos.sum(), axis=k, mode="constant")
    return fine


def measured_psf(image, weight, stars):
    """Return (psfex's PSF in the middle of a coadd per px^2 on steps of half a px, the number of its stars)."""
    folder, name = image.parent, f"{image.stem}_stars"
    settings = {
        "CATALOG_NAME": f"{name}.cat", "CATALOG_TYPE": "FITS_LDAC", "DETECT_THRESH": 5, "ANALYSIS_THRESH": 3,
        "DETECT_MINAREA": 3, "WEIGHT_TYPE": "MAP_WEIGHT", "WEIGHT_IMAGE": weight.name, "RESCALE_WEIGHTS": "N",
        "WEIGHT_GAIN": "N", "BACK_SIZE": 256, "SATUR_LEVEL": 1e9, "GAIN": 4 * EXPTIME, "PHOT_APERTURES": 12,
        "VERBOSE_TYPE": "QUIET", "STARNNW_NAME": "/usr/share/source-extractor/default.nnw",
    }  # fmt: skip
    columns = ("X_IMAGE", "Y_IMAGE", "FLUX_RADIUS", "FLUX_APER(1)", "FLUXERR_APER(1)", "ELONGATION", "SNR_WIN", "FLAGS",
               "VIGNET(45,45)")  # fmt: skip
    axis = np.arange(-3, 4) / 0.9
    find(folder, name, image.name, settings, columns, np.exp(-0.5 * (axis[:, None] ** 2 + axis**2)))
    wcs = quiet_wcs(fits.getheader(image))
    usable = (stars["snr"] > 50) & (stars["snr"] < 300)  # of one exposure; brighter ones saturate
    places = np.transpose(wcs.all_world2pix(stars["ra"][usable], stars["dec"][usable], 1))
    with fits.open(folder / f"{name}.cat") as file:
        table = file[2].data
        apart = cKDTree(places).query(np.transpose([table["X_IMAGE"], table["Y_IMAGE"]]))[0]
        file[2].data = table[(apart < 1.0) & (table["FLAGS"] == 0)]
        file.writeto(folder / f"{name}.cat", overwrite=True)
    settings = {
        "PSF_SIZE": "41,41", "PSF_SAMPLING": 0.5, "BASIS_TYPE": "PIXEL", "PSFVAR_DEGREES": 1,
        "SAMPLE_FWHMRANGE": "0.5,6.0", "SAMPLE_AUTOSELECT": "N", "SAMPLE_MINSN": 20, "SAMPLE_MAXELLIP": 0.5,
        "CHECKPLOT_DEV": "NULL", "CHECKPLOT_TYPE": "NONE", "CHECKIMAGE_TYPE": "NONE", "WRITE_XML": "N",
        "VERBOSE_TYPE": "QUIET", "NTHREADS": 1,
    }  # fmt: skip
    program(folder, ["psfex", f"{name}.cat"], f"{name}_psfex", settings)
    with fits.open(folder / f"{name}.psf") as file:
        return file[1].data["PSF_MASK"][0][0].astype(float), file[1].header["ACCEPTED"]


def _encircled(psf, step):
    """Return the light within 2, 3 and 5 px over that within 6 px, of a PSF on steps of `step` px."""
    axis = step * (np.arange(len(psf)) - len(psf) // 2)
    apart = np.hypot(axis[:, None], axis)
    light = [(psf * np.clip((radius - apart) / step + 0.5, 0.0, 1.0)).sum() for radius in (2.0, 3.0, 5.0, 6.0)]
    return [float(part / light[-1]) for part in light[:-1]]
