"""The PSF of an image as its own stars show it, written as PSFEx does (PSFEx manual, section 6; Bertin 2011).

Pixels of the model are STEP image pixels wide. A star's pixels are Lanczos-3 interpolations of the model, times its
flux; the model's pixels, and their change over the image, follow from least squares over all stars, held to a
Gaussian where the stars say little. Which sources are stars, their positions and fluxes are what `measure` found.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from csstsim.base.files.atomic import atomic_path
from csstsim.base.process.one_thread import one_thread

if TYPE_CHECKING:
    from pathlib import Path

    from csstsim.base.types import FloatArray, IntArray
    from csstsim.catalog.table import ObjectTable

# samples along a side; image pixels of one
SIDE = 45
STEP = 0.5
REACH = 10  # image pixels of a star to each side
STARS_MAX = 150
FEWEST = 5
SNR = 30.0
LINEAR_FROM = 30  # stars, for a model that changes over the image
CHANGE = 0.3  # of the model over half of the image, in units of how unlike a Gaussian it may be
NEIGHBOUR = 14.0  # px: a star with a neighbour of 2% of its light is not used
FAINT = 0.02
ITERATIONS = 150
FINE = 8
SPOILT = 1 | 2 | 4 | 64 | 128  # flags of measure.catalogue: blended, truncated, saturated, sharp, bad pixels


class _StarPixels(NamedTuple):
    """Good pixels of a star: values over its flux (n,), samples of the model (n, 36), their weights, errors (n,)."""

    values: FloatArray
    samples: IntArray
    weights: FloatArray
    errors: FloatArray


@dataclass(frozen=True)
class StarPsf:
    """planes (terms, SIDE, SIDE): the model and, if there are three, its change along x and y; stars used; FWHM px.

    zero, scale: x, y [FITS px] at which the change is 0, and over which it is 1; chi2: reduced.
    """

    planes: FloatArray
    zero: tuple[float, float]
    scale: tuple[float, float]
    stars: int
    fwhm: float
    chi2: float


def chosen(table: ObjectTable) -> IntArray:
    """Return rows of a measured table that are stars good for a model, the brightest first."""
    from scipy.spatial import cKDTree

    good = table["star"] & (table["flags"] & SPOILT == 0) & (table["snr"] > SNR) & (table["flux_psf"] > 0)
    rows = np.flatnonzero(good)
    if not len(rows):
        return rows
    position = np.column_stack([table["x"], table["y"]])
    flux = np.nan_to_num(table["flux_psf"])
    near = cKDTree(position).query_ball_point(position[rows], NEIGHBOUR)
    alone = [all(flux[k] < FAINT * flux[row] for k in some if k != row) for row, some in zip(rows, near, strict=True)]
    rows = rows[alone]
    return rows[np.argsort(-table["snr"][rows], kind="stable")][:STARS_MAX]


@one_thread
def star_psf(
    image: FloatArray, error: FloatArray, quality: IntArray, x: FloatArray, y: FloatArray, flux: FloatArray, fwhm: float
) -> StarPsf | None:
    """Return the StarPsf of stars at x, y (n,) [px from 0] of `flux` (n,) in the image's unit; None of few.

    image, error (ny, nx): in one unit; quality (ny, nx): 0 where a pixel is good; fwhm: px, of the starting Gaussian.
    """
    from scipy.sparse import csr_matrix, diags
    from scipy.sparse.linalg import lsqr

    ny, nx = image.shape
    inside = (x > REACH + 1) & (x < nx - REACH - 2) & (y > REACH + 1) & (y < ny - REACH - 2)
    x = x[inside]
    y = y[inside]
    flux = flux[inside]
    if len(x) < FEWEST:
        return None
    terms = 3 if len(x) >= LINEAR_FROM else 1
    zero_x = (nx + 1) / 2
    zero_y = (ny + 1) / 2
    scale_x = nx / 2
    scale_y = ny / 2
    start = _gaussian(fwhm)
    values: list[FloatArray] = []
    data: list[FloatArray] = []
    rows: list[IntArray] = []
    columns: list[IntArray] = []
    for k in range(len(x)):
        star = _star(image, error, quality, x[k], y[k], flux[k])
        change = np.array([1.0, (x[k] + 1 - zero_x) / scale_x, (y[k] + 1 - zero_y) / scale_y])[:terms]
        first = sum(map(len, data))
        data.append((star.values - (star.weights * start.ravel()[star.samples]).sum(axis=1)) / star.errors)
        weights = star.weights / star.errors[:, None]
        for term, factor in enumerate(change):
            rows.append(np.repeat(first + np.arange(len(star.values)), star.samples.shape[1]))
            columns.append((star.samples + term * SIDE**2).ravel())
            values.append((weights * factor).ravel())
    seen = np.concatenate(data)
    matrix = csr_matrix(
        (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), (len(seen), terms * SIDE**2)
    )
    likely = np.concatenate([_likely(start).ravel() * factor for factor in (1.0, CHANGE, CHANGE)[:terms]])
    solution, *_ = lsqr(matrix @ diags(likely), seen, damp=1.0, iter_lim=ITERATIONS)
    found = likely * solution
    chi2 = float(np.mean((matrix @ found - seen) ** 2))
    planes = found.reshape(terms, SIDE, SIDE)
    mean, *_ = planes  # a view
    mean += start
    return StarPsf(planes, (zero_x, zero_y), (scale_x, scale_y), len(x), _fwhm(mean), chi2)


def _star(image: FloatArray, error: FloatArray, quality: IntArray, x: float, y: float, flux: float) -> _StarPixels:
    """Return the good pixels of a star at x, y [px from 0]."""
    span = np.arange(-REACH, REACH + 1)
    columns, rows = np.meshgrid(int(np.rint(x)) + span, int(np.rint(y)) + span)
    column = columns.ravel()
    row = rows.ravel()
    good = (quality[row, column] == 0) & (error[row, column] > 0)
    column = column[good]
    row = row[good]
    near_x, weight_x = _lanczos((column - x) / STEP)
    near_y, weight_y = _lanczos((row - y) / STEP)
    near = (near_y[:, :, None] * SIDE + near_x[:, None, :]).reshape(len(row), -1)
    weights = (weight_y[:, :, None] * weight_x[:, None, :]).reshape(len(row), -1)
    # A hundredth of the peak as model error, so that the brightest star does not decide alone
    sigma = np.hypot(error[row, column], 0.01 * np.abs(image[row, column])) / flux
    return _StarPixels(image[row, column] / flux, near, weights, sigma)


def _lanczos(offset: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return (samples (n, 6), weights (n, 6)) of Lanczos-3 interpolation at offsets from the model's middle."""
    at = offset + SIDE // 2
    near = np.floor(at).astype(int)[:, None] + np.arange(-2, 4)
    away = at[:, None] - near
    weight = np.sinc(away) * np.sinc(away / 3)
    return np.clip(near, 0, SIDE - 1), weight / weight.sum(axis=1, keepdims=True)


def _gaussian(fwhm: float) -> FloatArray:
    """Return a model (SIDE, SIDE) whose image pixels add up to 1."""
    offset = (np.arange(SIDE) - SIDE // 2) * STEP
    one = np.exp(-4 * np.log(2) * (offset / fwhm) ** 2)
    return np.outer(one, one) / one.sum() ** 2 / STEP**2


def _likely(start: FloatArray) -> FloatArray:
    """Return by how much a PSF may differ from the starting Gaussian (SIDE, SIDE), a core and wings, one sigma."""
    offset = (np.arange(SIDE) - SIDE // 2) * STEP
    r2 = offset**2 + offset[:, None] ** 2
    return 0.5 * start + 0.01 * start.max() * (1 + r2 / 4) ** -1.5


def _fwhm(plane: FloatArray) -> float:
    """Return the width of a circle of the area above half of the peak, px; the model is drawn FINE times finer."""
    from scipy.ndimage import zoom

    fine = zoom(plane, FINE, order=3, grid_mode=True, mode="grid-constant")
    return float(2 * STEP / FINE * np.sqrt((fine > fine.max() / 2).sum() / np.pi))


def write_psfex(path: Path, model: StarPsf) -> None:
    """Write a StarPsf in PSFEx's form."""
    from astropy.io import fits

    terms = len(model.planes)
    mask = fits.Column("PSF_MASK", f"{model.planes.size}E", dim=f"({SIDE},{SIDE},{terms})", array=model.planes[None])
    hdu = fits.BinTableHDU.from_columns([mask], name="PSF_DATA")
    zero_x, zero_y = model.zero
    scale_x, scale_y = model.scale
    cards = {
        "LOADED": model.stars,
        "ACCEPTED": model.stars,
        "CHI2": model.chi2,
        "POLNAXIS": 2,
        "POLGRP1": 1,
        "POLNAME1": "X_IMAGE",
        "POLZERO1": zero_x,
        "POLSCAL1": scale_x,
        "POLGRP2": 1,
        "POLNAME2": "Y_IMAGE",
        "POLZERO2": zero_y,
        "POLSCAL2": scale_y,
        "POLNGRP": 1,
        "POLDEG1": 1 if terms == 3 else 0,
        "PSF_FWHM": model.fwhm,
        "PSF_SAMP": STEP,
        "PSFNAXIS": 3,
        "PSFAXIS1": SIDE,
        "PSFAXIS2": SIDE,
        "PSFAXIS3": terms,
    }
    hdu.header.update(cards)
    with atomic_path(path) as temporary:
        fits.HDUList([fits.PrimaryHDU(), hdu]).writeto(temporary, overwrite=True)
