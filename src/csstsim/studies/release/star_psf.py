"""The PSF of an image, measured from its stars and written in the format of PSFEx (its manual, section 6; Bertin 2011).

Pixels of the model are STEP image pixels wide. A star's pixels are Lanczos-3 interpolations of the model, times its
flux. The model's pixels, and their change over the image, follow from least squares over all stars, with a Gaussian as
the prior. Which sources are stars, their positions and their fluxes come from `csstsim measure`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from csstsim.base.files.atomic import atomic_path
from csstsim.base.process.one_thread import one_thread
from csstsim.measure.source_columns import BAD_PIXELS, BLENDED, SATURATED, SHARP, TRUNCATED

if TYPE_CHECKING:
    from pathlib import Path

    from csstsim.base.types import FloatArray, IntArray
    from csstsim.catalog.table import ObjectTable

# samples along a side; image pixels of one
SIDE = 45
STEP = 0.5
HALF_STAMP = 10  # image pixels of a star to each side
STARS_MAX = 150
STARS_MIN = 5
SNR = 30.0
LINEAR_FROM = 30  # stars, for a model that changes over the image
CHANGE_FRACTION = 0.3  # prior sigma of the model's change over half of the image, as a fraction of that of the model
NEIGHBOUR = 14.0  # px: a star is not used if a neighbour within this distance has a fraction NEIGHBOUR_FLUX of its flux
NEIGHBOUR_FLUX = 0.02
ITERATIONS = 150
ZOOM = 8
UNUSABLE = BLENDED | TRUNCATED | SATURATED | SHARP | BAD_PIXELS


class _StarPixels(NamedTuple):
    """Good pixels of a star: values over its flux (n,), indices and weights of model samples (n, 36), errors (n,)."""

    values: FloatArray
    samples: IntArray
    weights: FloatArray
    errors: FloatArray


@dataclass(frozen=True)
class StarPsf:
    """A PSF model, linear in x and y.

    planes (terms, SIDE, SIDE): the model and, if there are three, its change along x and y; zero, scale: x, y
    [FITS px] at which the change is 0, and over which it is 1; stars: number used; fwhm [px]; chi2: reduced.
    """

    planes: FloatArray
    zero: tuple[float, float]
    scale: tuple[float, float]
    stars: int
    fwhm: float
    chi2: float


def select_stars(table: ObjectTable) -> IntArray:
    """Return the rows of a measured table with stars for the model: unflagged, isolated; the highest S/N first."""
    from scipy.spatial import cKDTree

    good = table["star"] & (table["flags"] & UNUSABLE == 0) & (table["snr"] > SNR) & (table["flux_psf"] > 0)
    rows = np.flatnonzero(good)
    if not len(rows):
        return rows
    position = np.column_stack([table["x"], table["y"]])
    flux = np.nan_to_num(table["flux_psf"])
    near = cKDTree(position).query_ball_point(position[rows], NEIGHBOUR)
    isolated = [
        all(flux[k] < NEIGHBOUR_FLUX * flux[row] for k in neighbours if k != row)
        for row, neighbours in zip(rows, near, strict=True)
    ]
    rows = rows[isolated]
    return rows[np.argsort(-table["snr"][rows], kind="stable")][:STARS_MAX]


@one_thread
def star_psf(
    image: FloatArray, error: FloatArray, quality: IntArray, x: FloatArray, y: FloatArray, flux: FloatArray, fwhm: float
) -> StarPsf | None:
    """Return the StarPsf of stars at x, y (n,) [px from 0] of `flux` (n,); None for fewer than STARS_MIN.

    image, error (ny, nx): in the unit of flux; quality (ny, nx): 0 where a pixel is good; fwhm: px, of the Gaussian
    that is the prior's mean.
    """
    from scipy.sparse import csr_matrix, diags
    from scipy.sparse.linalg import lsqr

    ny, nx = image.shape
    inside = (x > HALF_STAMP + 1) & (x < nx - HALF_STAMP - 2) & (y > HALF_STAMP + 1) & (y < ny - HALF_STAMP - 2)
    x = x[inside]
    y = y[inside]
    flux = flux[inside]
    if len(x) < STARS_MIN:
        return None
    terms = 3 if len(x) >= LINEAR_FROM else 1
    zero_x = (nx + 1) / 2
    zero_y = (ny + 1) / 2
    scale_x = nx / 2
    scale_y = ny / 2
    start = _gaussian(fwhm)
    values: list[FloatArray] = []
    residuals: list[FloatArray] = []
    rows: list[IntArray] = []
    columns: list[IntArray] = []
    for k in range(len(x)):
        star = _star(image, error, quality, x[k], y[k], flux[k])
        change = np.array([1.0, (x[k] + 1 - zero_x) / scale_x, (y[k] + 1 - zero_y) / scale_y])[:terms]
        row_of_star = sum(map(len, residuals))
        residuals.append((star.values - (star.weights * start.ravel()[star.samples]).sum(axis=1)) / star.errors)
        weights = star.weights / star.errors[:, None]
        for term, factor in enumerate(change):
            rows.append(np.repeat(row_of_star + np.arange(len(star.values)), star.samples.shape[1]))
            columns.append((star.samples + term * SIDE**2).ravel())
            values.append((weights * factor).ravel())
    data = np.concatenate(residuals)
    matrix = csr_matrix(
        (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), (len(data), terms * SIDE**2)
    )
    factors = (1.0, CHANGE_FRACTION, CHANGE_FRACTION)[:terms]
    prior = np.concatenate([_prior_sigma(start).ravel() * factor for factor in factors])
    solution, *_ = lsqr(matrix @ diags(prior), data, damp=1.0, iter_lim=ITERATIONS)
    model = prior * solution
    chi2 = float(np.mean((matrix @ model - data) ** 2))
    planes = model.reshape(terms, SIDE, SIDE)
    mean, *_ = planes  # a view
    mean += start
    return StarPsf(planes, (zero_x, zero_y), (scale_x, scale_y), len(x), _fwhm(mean), chi2)


def _star(image: FloatArray, error: FloatArray, quality: IntArray, x: float, y: float, flux: float) -> _StarPixels:
    """Return the good pixels of a star at x, y [px from 0]."""
    span = np.arange(-HALF_STAMP, HALF_STAMP + 1)
    columns, rows = np.meshgrid(int(np.rint(x)) + span, int(np.rint(y)) + span)
    column = columns.ravel()
    row = rows.ravel()
    good = (quality[row, column] == 0) & (error[row, column] > 0)
    column = column[good]
    row = row[good]
    near_x, weight_x = _lanczos((column - x) / STEP)
    near_y, weight_y = _lanczos((row - y) / STEP)
    samples = (near_y[:, :, None] * SIDE + near_x[:, None, :]).reshape(len(row), -1)
    weights = (weight_y[:, :, None] * weight_x[:, None, :]).reshape(len(row), -1)
    # A hundredth of a pixel's value as model error, so that the brightest star does not dominate the fit
    sigma = np.hypot(error[row, column], 0.01 * np.abs(image[row, column])) / flux
    return _StarPixels(image[row, column] / flux, samples, weights, sigma)


def _lanczos(offset: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return (indices of samples (n, 6), weights (n, 6)) of Lanczos-3 interpolation at offsets from the middle."""
    position = offset + SIDE // 2
    nearest = np.floor(position).astype(int)[:, None] + np.arange(-2, 4)
    distance = position[:, None] - nearest
    weight = np.sinc(distance) * np.sinc(distance / 3)
    return np.clip(nearest, 0, SIDE - 1), weight / weight.sum(axis=1, keepdims=True)


def _gaussian(fwhm: float) -> FloatArray:
    """Return a model (SIDE, SIDE) whose image pixels add up to 1."""
    offset = (np.arange(SIDE) - SIDE // 2) * STEP
    profile = np.exp(-4 * np.log(2) * (offset / fwhm) ** 2)
    return np.outer(profile, profile) / profile.sum() ** 2 / STEP**2


def _prior_sigma(start: FloatArray) -> FloatArray:
    """Return the prior's sigma (SIDE, SIDE) of a PSF around the Gaussian `start`, of its core and its wings."""
    offset = (np.arange(SIDE) - SIDE // 2) * STEP
    r2 = offset**2 + offset[:, None] ** 2
    return 0.5 * start + 0.01 * start.max() * (1 + r2 / 4) ** -1.5


def _fwhm(plane: FloatArray) -> float:
    """Return the diameter [px] of a circle with the area above half of the peak, at ZOOM times the model's sampling."""
    from scipy.ndimage import zoom

    fine = zoom(plane, ZOOM, order=3, grid_mode=True, mode="grid-constant")
    return float(2 * STEP / ZOOM * np.sqrt((fine > fine.max() / 2).sum() / np.pi))


def write_psfex(path: Path, model: StarPsf) -> None:
    """Write a StarPsf in the format of PSFEx."""
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
