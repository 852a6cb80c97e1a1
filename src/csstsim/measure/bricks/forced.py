"""Forced photometry: the fluxes of known positions in frames that did not detect the source.

They are measured on what is left of a frame without the models of its sources (measure.detection.residual): the fit of
the PSF, and a Gaussian aperture for colours. The latter has the width GAAP_FWHM before the PSF (Kuijken 2008): on the
image it is narrower, by the PSF's width in quadrature, and divided by its mean over the PSF.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numba
import numpy as np

from csstsim.base.types import AnyArray, FloatArray, IntArray
from csstsim.catalog.table import ObjectTable
from csstsim.measure.detection.detect import FWHM_TO_SIGMA
from csstsim.measure.detection.maps import BIN
from csstsim.measure.detection.residual import BLANK, MESH, values
from csstsim.measure.light.photometry import HALF, SourcePsfs, fit_sources, render_psf
from csstsim.measure.light.profile_tables import GAAP_FWHM

if TYPE_CHECKING:
    from csstsim.measure.bricks.joint_frame import JointFrame

STRIP = 512  # px, height of the parts of a frame that are read
REACH = 18  # px, of the aperture
KNOWN_MIN = 0.8  # fraction of the weights of the aperture on known pixels


class ForcedFluxes(NamedTuple):
    """Fluxes (n,) [electron] of the PSF's fit and in the aperture, and their errors; NaN where they are not known.

    `noise`: error of the PSF's flux without the Poisson noise of the source, which must not be in weights of a mean: a
    flux that is low by chance would count more.
    """

    flux_psf: FloatArray
    flux_psf_err: FloatArray
    flux_gaap: FloatArray
    flux_gaap_err: FloatArray
    noise: FloatArray


def forced_photometry(frames: Sequence[JointFrame], sources: ObjectTable, detections: ObjectTable) -> ObjectTable:
    """Return an ObjectTable of the fluxes of sources in the frames that contain them but did not detect them.

    sources: has ra, dec, motion; those that move are left out. detections: has source, obsid, chip. The columns are
    source (row in `sources`), filter, and those of ForcedFluxes, in microjansky.
    """
    parts: list[dict[str, AnyArray]] = []
    empty = {"source": np.zeros(0, int), "filter": np.zeros(0, str)} | dict.fromkeys(ForcedFluxes._fields, np.zeros(0))
    for frame in frames:
        x, y = frame.to_pixel(sources["ra"], sources["dec"])
        ny, nx = frame.residual.steps.shape
        inside = (sources["motion"] == 0) & (x > -0.5) & (x < nx - 0.5) & (y > -0.5) & (y < ny - 0.5)
        inside[detections["source"][(detections["obsid"] == frame.obsid) & (detections["chip"] == frame.chip)]] = False
        rows = np.flatnonzero(inside)
        fluxes = forced_fluxes(frame, x[rows], y[rows])._asdict()
        in_microjansky = {name: frame.to_microjansky * flux for name, flux in fluxes.items()}
        parts.append({"source": rows, "filter": np.full(len(rows), frame.band)} | in_microjansky)
    return ObjectTable({name: np.concatenate([empty[name], *(part[name] for part in parts)]) for name in empty})


def forced_fluxes(frame: JointFrame, x: FloatArray, y: FloatArray) -> ForcedFluxes:
    """Return the ForcedFluxes at positions (n,) on a frame [px]."""
    aperture = GAAP_FWHM / FWHM_TO_SIGMA / frame.pixel
    steps, noise = frame.residual
    ny = len(steps)
    out = ForcedFluxes(*np.full((5, len(x)), np.nan))
    for low in range(0, ny, STRIP):
        rows = np.flatnonzero((y >= low - 0.5) & (y < low + STRIP - 0.5))
        if not rows.size:
            continue
        first = max(low - REACH, 0)
        part = np.ascontiguousarray(steps[first : low + STRIP + REACH])
        image = values(part)
        unknown = (part == BLANK).astype(np.uint8)
        one = np.ones([-(-n // BIN) for n in part.shape], np.float32)
        there = x[rows], y[rows] - first
        rms = noise[np.rint(y[rows]).astype(int) // MESH, np.rint(x[rows]).astype(int) // MESH].astype(float)
        psf = frame.psf.at(x[rows] + frame.psf.origin[0], y[rows] + frame.psf.origin[1])
        fit = fit_sources(image, one, unknown, *there, rms, psf)  # in units of the noise
        known = fit.unusable == 0
        out.flux_psf[rows] = np.where(known, fit.flux * rms, np.nan)
        out.flux_psf_err[rows] = np.where(known, fit.flux_error * rms, np.nan)
        alone = fit_sources(image, one, unknown, *there, np.full(len(rows), np.inf), psf)
        out.noise[rows] = np.where(known, alone.flux_error * rms, np.nan)
        flux, error = _aperture_fluxes(image, unknown, *there, psf, math.sqrt(aperture**2 - frame.width**2))
        out.flux_gaap[rows] = np.where(known, flux * rms, np.nan)
        out.flux_gaap_err[rows] = np.where(known, error * rms, np.nan)
    return out


@numba.njit(cache=True)
def _aperture_fluxes(
    image: FloatArray, unknown: IntArray, x: FloatArray, y: FloatArray, psf: SourcePsfs, sigma: float
) -> tuple[FloatArray, FloatArray]:
    """Return (fluxes, errors) (n,) in a Gaussian aperture, over its mean in the PSF, for noise of 1 a pixel."""
    ny, nx = image.shape
    flux = np.full(x.size, np.nan)
    error = np.full(x.size, np.nan)
    stamp = np.empty((2 * HALF + 1, 2 * HALF + 1))
    for k in range(x.size):
        column = round(x[k])
        row = round(y[k])
        render_psf(psf.coefficients[psf.cell[k]], psf.per_pixel, x[k] - column, y[k] - row, stamp)
        total = 0.0
        known = 0.0
        squares = 0.0
        product = 0.0
        of_psf = 0.0
        for j in range(row - REACH, row + REACH + 1):
            for i in range(column - REACH, column + REACH + 1):
                weight = math.exp(-0.5 * ((i - x[k]) ** 2 + (j - y[k]) ** 2) / sigma**2)
                total += weight
                if not (0 <= j < ny and 0 <= i < nx) or unknown[j, i]:
                    continue
                known += weight
                squares += weight * weight
                product += weight * image[j, i]
                if abs(i - column) <= HALF and abs(j - row) <= HALF:
                    of_psf += weight * stamp[j - row + HALF, i - column + HALF]
        if known >= KNOWN_MIN * total:
            flux[k] = product / of_psf
            error[k] = math.sqrt(squares) / of_psf
    return flux, error
