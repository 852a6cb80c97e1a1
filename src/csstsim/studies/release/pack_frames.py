"""The public frames of a pack: as read (compressed) and calibrated, in ICRS; the PSF measured from an image's stars.

raw/{obsid}_{chip}_{filter}.fits         Level-0, RICE tiles, without the seed
calibrated/{obsid}_{chip}_{filter}.fits  SCI, ERR [electron/s], DQ
psf/{obsid}_{chip}_{filter}.psf          images only: PSFEx's form (release.star_psf)
"""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from csstsim.base.files.atomic import atomic_path
from csstsim.base.process.one_thread import one_thread
from csstsim.io.calibrated import COPIED, DQ
from csstsim.io.fits_writing import card, compress, write_hdus
from csstsim.optics.geometry.icrs_header import corners, icrs_header
from csstsim.studies.release.star_psf import select_stars, star_psf, write_psfex

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path
    from typing import Any

    from csstsim.base.types import FloatArray, IntArray
    from csstsim.campaign.job import Job
    from csstsim.campaign.opened import OpenCampaign
    from csstsim.catalog.table import ObjectTable
    from csstsim.io.level0 import Level0
    from csstsim.measure.calibration.calibrate import Calibrated
    from csstsim.studies.release.star_psf import StarPsf

RAW = "raw"
CALIBRATED = "calibrated"
PSF = "psf"
# With the seed, the truth can be simulated again; with a digest of it, seeds can be tried without a simulation
SECRET = "SIMSEED", "CAMPHASH", "TRUTHASH"


@dataclass(frozen=True)
class PackFrame:
    """A frame of a pack: its row in frames.csv, None for unknown values, and its corners [deg, ICRS]."""

    row: dict[str, Any]
    corners: list[list[float]]


class Planes(NamedTuple):
    """The planes SCI, ERR [electron/s] and DQ of a frame (ny, nx), and the subtracted background [electron/s]."""

    image: FloatArray
    error: FloatArray
    quality: IntArray
    background: float


def stem(job: Job) -> str:
    """Return the name of a job's files: {obsid}_{chip}_{filter}."""
    return f"{job.obsid}_{job.chip.id:02d}_{job.chip.filter}"


@one_thread
def write_frame(run: OpenCampaign, job: Job, folder: Path) -> PackFrame:
    """Write the public files of a job into `folder` and return its PackFrame. Raises InputError."""
    from csstsim.stages.calibrate import calibrated_frame
    from csstsim.stages.measure import measured_table

    names = {kind: f"{kind}/{stem(job)}.{'psf' if kind == PSF else 'fits'}" for kind in (RAW, CALIBRATED, PSF)}
    for kind in names:
        (folder / kind).mkdir(exist_ok=True)
    level0, frame = calibrated_frame(run, job)  # first: it reports what is wrong with a damaged file
    with atomic_path(folder / names[RAW]) as temporary:
        shutil.copyfile(run.paths.level0(job), temporary)
        compress(temporary, without=SECRET)
    imaging = job.chip.kind == "imaging"
    planes = _image(run, job, frame) if imaging else _spectra(job, frame)
    filter_ = run.camera.filters[job.chip.filter]
    zeropoint = filter_.zeropoint(run.camera.telescope) if imaging else None
    read_noise = float(np.mean(list(frame.read_noise.values())))
    header = icrs_header(job.wcs, level0.observer, job.window)
    _write(
        folder / names[CALIBRATED],
        level0,
        planes,
        header,
        {
            "BACKMED": (planes.background, "[electron/s] median background taken off"),
            "RDNOISE": (read_noise, "[electron] rms"),
            "MAGZERO": (zeropoint, "AB magnitude of 1 electron/s"),
            "PIXSCALE": (run.camera.telescope.pixel_scale, "[arcsec]"),
            "READX0": (job.window.x0 + 1, "first column, on the chip, counted from 1"),
            "READY0": (job.window.y0 + 1, "first row"),
        },
    )
    height, width = planes.image.shape
    row = {
        "name": stem(job),
        "filter": job.chip.filter,
        "kind": job.chip.kind,
        "chip": job.chip.id,
        "obsid": job.obsid,
        "start_utc": job.pointing.time,
        "exptime_s": job.pointing.exptime,
        "pa_deg": job.pointing.pa,
        "ra_deg": round(header["CRVAL1"], 6),
        "dec_deg": round(header["CRVAL2"], 6),
        "width_px": width,
        "height_px": height,
        "zero_point_mag": zeropoint and round(zeropoint, 5),
        "psf_fwhm_px": None,
        "psf_stars": None,
        "raw": names[RAW],
        "calibrated": names[CALIBRATED],
        "psf": None,
    }
    if imaging and (model := _psf(measured_table(run, job), planes, job)):
        write_psfex(folder / names[PSF], model)
        row |= {"psf_fwhm_px": round(model.fwhm, 3), "psf_stars": model.stars, "psf": names[PSF]}
    return PackFrame(row, corners(job.wcs, level0.observer, job.window))


def _image(run: OpenCampaign, job: Job, frame: Calibrated) -> Planes:
    """Return the planes of an image, background subtracted."""
    from csstsim.measure.calibration.bad_pixels import fill_bad_pixels
    from csstsim.measure.detection.detect import subtract_background
    from csstsim.measure.light.photometry import psf_model
    from csstsim.stages.psf import open_psf

    quality = fill_bad_pixels(
        frame, psf_model(open_psf(run, job.chip), (job.window.x0, job.window.y0), job.window.shape)
    )
    image = frame.electrons
    error = frame.sigma()
    rate = np.float32(1.0 / job.pointing.exptime)
    level = float(np.median(image))
    subtract_background(image, quality)
    level -= float(np.median(image))
    return Planes(image * rate, error * rate, quality, level * float(rate))


def _spectra(job: Job, frame: Calibrated) -> Planes:
    """Return the planes of a frame of spectra: the dispersed sky stays, cosmic rays are not searched for."""
    rate = np.float32(1.0 / job.pointing.exptime)
    return Planes(frame.electrons * rate, frame.sigma() * rate, frame.marks, 0.0)


def _psf(table: ObjectTable, planes: Planes, job: Job) -> StarPsf | None:
    rows = select_stars(table)
    if not len(rows):
        return None
    of_stars = partial(np.take, indices=rows)
    flux = of_stars(table["flux_psf"]) / job.pointing.exptime
    return star_psf(
        planes.image,
        planes.error,
        planes.quality,
        of_stars(table["x"]) - job.window.x0,
        of_stars(table["y"]) - job.window.y0,
        flux,
        float(np.median(of_stars(table["fwhm"]))),
    )


def _write(
    path: Path,
    file: Level0,
    planes: Planes,
    header: Mapping[str, Any],
    facts: Mapping[str, tuple[float | str | None, str]],
) -> None:
    copied = {name: file.header0[name] for name in COPIED if name in file.header0 and name not in SECRET}
    primary = [card(name, value) for name, value in (copied | {"POSKIND": "ICRS"}).items()]
    position = [card(name, value) for name, value in header.items()]
    cards_of_facts = [card(name, value, about) for name, (value, about) in facts.items() if value is not None]
    bits = [card(f"BIT{bit.bit_length() - 1}", name, f"value {bit}") for bit, name in DQ.items()]
    unit = card("BUNIT", "electron/s")
    with atomic_path(path) as temporary:
        hdus = [
            ("SCI", [unit, *position, *cards_of_facts], planes.image),
            ("ERR", [unit, *position], planes.error),
            ("DQ", [*position, *bits], planes.quality),
        ]
        write_hdus(temporary, [("", primary, None), *hdus])
