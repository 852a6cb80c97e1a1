"""Run source-extractor and psfex on a calibrated image, for source_extractor.py and catalogue_codes.py.

`extract` has settings chosen here:

1. source-extractor finds the brighter sources with a Gaussian kernel and cuts a vignette of each.
2. psfex makes a PSF model, linear in x and y, of those that look like stars.
3. source-extractor finds all sources with that model as the kernel, THRESHOLD, and its own deblending. It fits the
   model (FLUX_PSF) in a window as large as the isophote, at least 3 px.

source-extractor subtracts its own background, on a mesh as wide as csstsim's. Pixels with a defect or a cosmic ray have
no weight. The noise map is that of the background, ERR without the light of the sources: source-extractor adds their
shot noise by itself, and weights that include the noise of a pixel's own light make fluxes too faint.

`plain` is source-extractor alone as it is shipped: 1.5 sigma on 5 px, its 3 x 3 kernel, deblending and cleaning. `deep`
is the same with a Gaussian kernel as wide as the PSF, and THRESHOLD on single pixels.
"""

import os
import shutil
import subprocess
from dataclasses import dataclass

import numpy as np
from astropy.io import fits
from private_memory import PrivateMemory
from scipy.ndimage import map_coordinates, zoom

from csstsim.base.errors import InputError
from csstsim.catalog.table import ObjectTable
from csstsim.measure.calibration.bad_pixels import FULL
from csstsim.measure.source_columns import SATURATED

PROGRAMS = "source-extractor", "psfex"
APERTURE = 12.0  # px, diameter within which psfex normalises its model
FEWEST_STARS = 5  # for a PSF model
THRESHOLD = 3.75  # S/N of a peak behind a kernel as wide as the PSF, of the deep catalogues
_STEP, _STEPS = 0.5, 41  # px and number of samples of psfex's model: light within 10 px
_VIGNETTE = 45  # px, side: holds psfex's model with room to shift it
UNUSABLE = np.float32(1e31)  # an rms above 1e30: no weight
_FIRST = ("X_IMAGE", "Y_IMAGE", "FLUX_RADIUS", "FLUX_APER(1)", "FLUXERR_APER(1)", "ELONGATION", "SNR_WIN", "FLAGS",
          "IMAFLAGS_ISO", f"VIGNET({_VIGNETTE},{_VIGNETTE})")  # fmt: skip
_SECOND = "XWIN_IMAGE", "YWIN_IMAGE", "FLUX_PSF", "FLUXERR_PSF", "FLUX_AUTO", "IMAFLAGS_ISO"
_KERNEL = "/usr/share/source-extractor/default.conv"
_PLAIN = "XWIN_IMAGE", "YWIN_IMAGE", "FLUX_AUTO", "FLUXERR_AUTO"
_SETTINGS = {
    "CATALOG_TYPE": "FITS_LDAC", "THRESH_TYPE": "RELATIVE", "CLEAN": "N", "BACK_SIZE": 256,
    "WEIGHT_TYPE": "MAP_RMS", "WEIGHT_IMAGE": "rms.fits", "RESCALE_WEIGHTS": "N",
    "FLAG_IMAGE": "flag.fits", "PHOT_APERTURES": APERTURE, "SATUR_LEVEL": 1e9,
    "MEMORY_OBJSTACK": 65_000, "MEMORY_PIXSTACK": 5_000_000, "PIXEL_SCALE": 0.074, "VERBOSE_TYPE": "QUIET",
    "STARNNW_NAME": "/usr/share/source-extractor/default.nnw",
}  # fmt: skip
_GIVEN = (
    "CATALOG_TYPE", "WEIGHT_TYPE", "WEIGHT_IMAGE", "RESCALE_WEIGHTS", "SATUR_LEVEL", "MEMORY_OBJSTACK",
    "MEMORY_PIXSTACK", "VERBOSE_TYPE", "STARNNW_NAME",
)  # fmt: skip
_PSFEX = {
    "PSF_SIZE": f"{_STEPS},{_STEPS}", "PSF_SAMPLING": _STEP, "BASIS_TYPE": "PIXEL", "PSFVAR_DEGREES": 1,
    "SAMPLE_FWHMRANGE": "1.0,4.0", "SAMPLE_MINSN": 50, "SAMPLE_IMAFLAGMASK": "0xff", "CHECKPLOT_DEV": "NULL",
    "CHECKPLOT_TYPE": "NONE", "CHECKIMAGE_TYPE": "NONE", "WRITE_XML": "N", "VERBOSE_TYPE": "QUIET",
    "NTHREADS": 1,
}  # fmt: skip


@dataclass(frozen=True)
class Extracted:
    """The programs' results for a frame.

    table: ObjectTable with columns x, y (whole chip, 0-based px), flux_psf (the factor of the model; 0 where its fit
    failed), flux_kron [electron], snr (of flux_psf), flags (SATURATED of measure.catalogue or 0); psf: their model in
    the middle of the frame, with the pixel response, per px^2 on steps of half a px, about 1 in total within APERTURE;
    stars: the number it is made of; cpu: seconds by program; memory: the largest of a program [GB].
    """

    table: ObjectTable
    psf: np.ndarray
    stars: int
    cpu: dict
    memory: float


def missing():
    """Return the programs that are not installed."""
    return [name for name in PROGRAMS if shutil.which(name) is None]


def extract(calibrated, folder, exptime):
    """Return the `Extracted` of a calibrated image (io.calibrated), working in `folder`.

    exptime: seconds. Raises InputError for a frame with too few stars.
    """
    header = _write_planes(calibrated, folder, exptime)
    settings = _SETTINGS | {"GAIN": exptime}
    cost = {"source-extractor, vignettes": _find(folder, "first", gauss(), 5.0, 3, _FIRST, settings)}
    cost["psfex"] = _run(folder, "psfex", "first.cat", _PSFEX)
    psf, about = _middle(folder / "first.psf")
    if about["ACCEPTED"] < FEWEST_STARS:
        raise InputError(
            "too few bright stars for psfex", file=calibrated, key="stars", value=about["ACCEPTED"],
            allowed=f"{FEWEST_STARS} or more; take a larger window",
        )  # fmt: skip
    kernel = map_coordinates(psf, np.indices((7, 7)) / _STEP + _STEPS // 2 - 3 / _STEP, order=3)
    fitted = settings | {"PSF_NAME": "first.psf"}
    cost["source-extractor, all sources"] = _find(folder, "second", kernel, THRESHOLD, 1, _SECOND, fitted)
    found = fits.getdata(folder / "second.cat", 2)
    columns = _places(found, header) | {
        "flux_psf": found["FLUX_PSF"] * exptime, "flux_kron": found["FLUX_AUTO"] * exptime,
        "snr": found["FLUX_PSF"] / np.maximum(found["FLUXERR_PSF"], np.float32(1e-30)),
        "flags": np.where(found["IMAFLAGS_ISO"] & FULL, SATURATED, 0),
    }  # fmt: skip
    table = ObjectTable({name: np.array(values, np.float64) for name, values in columns.items()})
    cpu, memory = ({name: each[k] for name, each in cost.items()} for k in (0, 1))
    table = table.with_columns(flags=columns["flags"].astype(np.int32))
    return Extracted(table, psf, about["ACCEPTED"], cpu, max(memory.values()))


def plain(calibrated, folder, exptime, deep=False):
    """Return (ObjectTable, CPU seconds, GB) of source-extractor as shipped; columns x, y, flux (AUTO) [electron], snr.

    Arguments as of `extract`. Only the weights, the saturation and the size of its buffers are given. deep: with a
    kernel as wide as the PSF, and THRESHOLD on its pixels.
    """
    header = _write_planes(calibrated, folder, exptime)
    settings = {name: _SETTINGS[name] for name in _GIVEN} | {"GAIN": exptime}
    if deep:
        cpu, memory = _find(folder, "plain", gauss(), THRESHOLD, 1, _PLAIN, settings)
    else:
        (folder / "plain.param").write_text("\n".join(_PLAIN) + "\n")
        settings |= {"CATALOG_NAME": "plain.cat", "PARAMETERS_NAME": "plain.param", "FILTER_NAME": _KERNEL}
        cpu, memory = _run(folder, "source-extractor", "image.fits", settings)
    found = fits.getdata(folder / "plain.cat", 2)
    columns = _places(found, header) | {
        "flux": found["FLUX_AUTO"] * exptime,
        "snr": found["FLUX_AUTO"] / np.maximum(found["FLUXERR_AUTO"], np.float32(1e-30)),
    }
    return ObjectTable({name: np.array(values, np.float64) for name, values in columns.items()}), cpu, memory


def gauss():
    """Return a Gaussian kernel about as wide as the PSF."""
    axis = np.arange(-3, 4) / 0.9
    return np.exp(-0.5 * (axis[:, None] ** 2 + axis**2))


def fwhm(psf, step):
    """Return the full width at half maximum [px] of a PSF on steps of `step` px: diameter of the area above half."""
    fine = 16
    middle = len(psf) // 2
    part = slice(middle - round(4 / step), middle + round(4 / step) + 1)
    zoomed = zoom(np.asarray(psf[part, part], float), fine, order=3, grid_mode=True, mode="nearest")
    return 2.0 * np.sqrt((zoomed > 0.5 * zoomed.max()).sum() / np.pi) * step / fine


def _places(found, header):
    """Return the columns x, y [px of the whole chip, from 0] of a program's table, whose pixels count from 1."""
    return {name: found[f"{name.upper()}WIN_IMAGE"] - 2.0 + header[f"READ{name.upper()}0"] for name in "xy"}


def planes(calibrated, exptime):
    """Return (SCI, noise of its background, DQ, header of SCI) of a calibrated image; noise is UNUSABLE where DQ is."""
    with fits.open(calibrated) as file:
        science, error, quality = (file[name].data for name in ("SCI", "ERR", "DQ"))
        header = file["SCI"].header
    variance = error**2 - science / exptime
    usual = np.median(variance)  # bounds the residuals of bright stars from the pixel response
    rms = np.sqrt(np.clip(variance, 0.5 * usual, 2.0 * usual))
    rms[(quality & ~FULL) > 0] = UNUSABLE
    return science, rms.astype(np.float32), quality, header


def _write_planes(calibrated, folder, exptime):
    """Write the image, the noise of its background and its flags; return the header of SCI."""
    *images, header = planes(calibrated, exptime)
    for name, plane in zip(("image", "rms", "flag"), images, strict=True):
        fits.writeto(folder / f"{name}.fits", plane)
    return header


def _find(folder, name, kernel, threshold, area, columns, settings):
    """Run source-extractor with a kernel and a threshold on the S/N in it; return as `_run`."""
    kernel = kernel / kernel.sum()
    rows = "\n".join(" ".join(f"{value:.7f}" for value in row) for row in kernel)
    (folder / f"{name}.conv").write_text(f"CONV NORM\n{rows}\n")
    (folder / f"{name}.param").write_text("\n".join(columns) + "\n")
    # Its threshold is in units of the noise before the smoothing
    level = threshold * np.sqrt((kernel**2).sum())
    settings = settings | {
        "CATALOG_NAME": f"{name}.cat", "PARAMETERS_NAME": f"{name}.param", "FILTER_NAME": f"{name}.conv",
        "DETECT_THRESH": level, "ANALYSIS_THRESH": level, "DETECT_MINAREA": area,
    }  # fmt: skip
    return _run(folder, "source-extractor", "image.fits", settings)


def _run(folder, program, file, settings):
    """Run a program with settings {key: value} in `folder`; return (CPU seconds, GB). RuntimeError has its output."""
    (folder / "settings").write_text("".join(f"{key} {value}\n" for key, value in settings.items()))
    with (folder / "said").open("w") as said:
        cpu, memory, failed = cost([program, file, "-c", "settings"], cwd=folder, stdout=said, stderr=said)
    if failed:
        raise RuntimeError(f"{program}: {(folder / 'said').read_text()[-1000:]}")
    return cpu, memory


def cost(command, **options):
    """Run a command (options as of Popen); return (CPU seconds, largest private memory [GB], exit code)."""
    process = subprocess.Popen(command, **options)
    with PrivateMemory(process.pid) as memory:
        _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    return used.ru_utime + used.ru_stime, memory.largest, process.returncode


def _middle(path):
    """Return (PSF per px^2 in the middle of the frame, header) of a psfex file; there only the constant terms count."""
    with fits.open(path) as file:
        return file[1].data["PSF_MASK"][0][0].astype(float), file[1].header
