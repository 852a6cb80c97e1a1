"""Estimators of shapes: each measures Stamps, on pixel axes.

Each returns Shapes: e (n,) complex and its response (n, 2), so that the mean of e over that of the response is the
shear; NaN where a galaxy has no shape. The response of hsm and own is 1: they give ellipticities (a - b) / (a + b).

hsm      GalSim's re-Gaussianisation (Hirata & Seljak 2003; Mandelbaum et al. 2005)
own      adaptive moments of `csstsim measure` (measure.light.moments), with the PSF's stamp
fpfs     AnaCal's Fourier power function shapelets with analytic responses (Li & Mandelbaum 2023, MNRAS 521, 4904)
metacal  ngmix's metacalibration with weighted moments (Huff & Mandelbaum 2017; Sheldon & Huff 2017)

fpfs and metacal need the packages anacal and ngmix. Both add noise from `rng`, the same in both arms.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.types import ComplexArray, FloatArray, PathLike
from csstsim.measure.light.moments import (
    SIZE_MIN,
    SMOOTH,
    AdaptiveShapes,
    MeasuredShapes,
    adaptive_moments,
    reduced,
    without_psf,
)

if TYPE_CHECKING:
    from ngmix import Observation
    from ngmix.gaussmom import GaussMom

PACKAGES = {"fpfs": "anacal", "metacal": "ngmix"}
# px, sigma at which the search for the moments of PSF and galaxy starts
PSF_GUESS = 1.5
GALAXY_GUESS = 3.5
SHAPELET_ARCSEC = 0.3  # sigma of the shapelets
FLUX_SIGMAS = 5.0  # weighting parameter of fpfs, in units of the flux's noise: faint galaxies get less weight
# shear of metacalibration; arcsec, FWHM of its weight
SHEAR_STEP = 0.01
WEIGHT_FWHM = 1.2


@dataclass(frozen=True, eq=False)
class Shapes:
    """e (n,) complex, response (n, 2)."""

    e: ComplexArray
    response: FloatArray


class Stamps(NamedTuple):
    """Stamps (n, s, s) of galaxies, background subtracted [e-], and of the PSF, of any scale, at each galaxy."""

    galaxies: FloatArray
    psf: FloatArray
    sigma: float  # e-, noise of a pixel
    scale: float  # arcsec, side of a pixel

    def take(self, rows: Sequence[int]) -> Stamps:
        """Return the Stamps of some galaxies."""
        return self._replace(galaxies=self.galaxies[rows], psf=self.psf[rows])


# arguments: Stamps, generator of the added noise
Estimator: TypeAlias = Callable[[Stamps, np.random.Generator], Shapes]


def check_installed(names: Iterable[str], file: PathLike | None) -> None:
    """Raise InputError if an estimator's package is missing."""
    for name in names:
        if name in PACKAGES and find_spec(PACKAGES[name]) is None:
            raise InputError(
                f"the package {PACKAGES[name]} is not installed",
                file=file,
                key="estimators",
                value=name,
                allowed="hsm, own, and those whose packages are installed",
            )


def estimator(name: str) -> Estimator:
    """Return the function (Stamps, rng) -> Shapes of a plan's name."""
    return {"hsm": hsm, "own": linear_moments, "fpfs": fpfs, "metacal": metacal}[name]


def smoothed(stamps: FloatArray) -> FloatArray:
    """Return stamps smoothed by a Gaussian of SMOOTH px: pixels sample a star too coarsely for adaptive moments."""
    from scipy.ndimage import gaussian_filter

    return gaussian_filter(np.asarray(stamps, float), (0, SMOOTH, SMOOTH), mode="constant")


def hsm(stamps: Stamps, rng: np.random.Generator) -> Shapes:
    """Measure by GalSim's re-Gaussianisation of the smoothed stamps."""
    import galsim

    params = galsim.hsm.HSMParams(convergence_threshold=1e-7)
    e = np.full(len(stamps.galaxies), np.nan, complex)
    for k, (image, star) in enumerate(zip(smoothed(stamps.galaxies), smoothed(stamps.psf), strict=True)):
        result = galsim.hsm.EstimateShear(
            galsim.ImageD(image), galsim.ImageD(star), guess_sig_PSF=PSF_GUESS, hsmparams=params, strict=False
        )
        distortion = result.corrected_e1 + 1j * result.corrected_e2
        if not result.error_message and abs(distortion) < 1:
            e[k] = reduced(distortion)
    return Shapes(e, np.ones((len(e), 2)))


def psf_shapes(psf: FloatArray) -> ComplexArray:
    """Return (n,) complex ellipticities (a - b) / (a + b) of the smoothed stamps of a PSF; NaN where there is none."""
    shapes = _adaptive_shapes(psf, SIZE_MIN)
    return reduced(shapes.e1 + 1j * shapes.e2)


def linear_moments(stamps: Stamps, rng: np.random.Generator) -> Shapes:
    """Measure by adaptive moments corrected with the kurtosis terms."""
    galaxies = _adaptive_shapes(stamps.galaxies, GALAXY_GUESS)
    stars = _adaptive_shapes(stamps.psf, SIZE_MIN)
    unused = np.zeros(len(galaxies.e1))  # positions and errors
    e = reduced(without_psf(MeasuredShapes(unused, unused, galaxies, unused, stars)).e)
    return Shapes(e, np.ones((len(e), 2)))


def _adaptive_shapes(stamps: FloatArray, size: float) -> AdaptiveShapes:
    """Return the adaptive shapes of stamps (n, s, s), searched from a sigma of `size` px; NaN where there is none."""
    rows = np.full((len(stamps), 4), np.nan)
    start = np.hypot(size, SMOOTH)
    for row, image in zip(rows, np.asarray(stamps, float), strict=True):
        flags = np.zeros(image.shape, np.uint8)
        segments = np.zeros(image.shape, np.int32)
        middle = image.shape[0] // 2
        fit = adaptive_moments(image, flags, segments, 0, middle, middle, start, SMOOTH)
        if fit.flux > 0:
            _, _, xx, xy, yy = fit.gaussian
            row[:] = (xx * yy - xy * xy) ** 0.25, (xx - yy) / (xx + yy), 2 * xy / (xx + yy), fit.kurtosis
    return AdaptiveShapes(*rows.T)


def fpfs(stamps: Stamps, rng: np.random.Generator) -> Shapes:
    """Measure by AnaCal: shapelets with analytic response, noise bias removed by added noise."""
    from anacal.fpfs import FpfsTask, _catalog_dtype, _ForceTask

    n = len(stamps.galaxies)
    side = stamps.galaxies.shape[-1]
    sigma = stamps.sigma
    scale = stamps.scale
    mean = np.ascontiguousarray(np.mean(stamps.psf, axis=0))
    task = FpfsTask(npix=side, pixel_scale=scale, sigma_shapelets=SHAPELET_ARCSEC, psf_array=mean, kmax_thres=1e-12)
    task.prepare_covariance(variance=max(sigma, 1e-3) ** 2)
    force = _ForceTask(side, scale, SHAPELET_ARCSEC, task.kmax / scale, FLUX_SIGMAS * task.std_m00)
    noise = (sigma * rng.standard_normal(stamps.galaxies.shape)).astype(np.float32) if sigma > 0 else [None] * n
    options = {
        "filter_image": task.bfunc_use,
        "std_m00": float(task.std_m00),
        "out_dtype": _catalog_dtype("fpfs1", None),
        "det": np.array([(side // 2, side // 2)], [("y", "i4"), ("x", "i4")]),
    }
    results = [
        force.process_image(
            gal_array=image.astype(np.float32),
            psf_array=np.ascontiguousarray(star, float),
            noise_array=added,
            **options,
        )
        for image, star, added in zip(stamps.galaxies, stamps.psf, noise, strict=True)
    ]

    def joined(name: str) -> FloatArray:  # whole records are slow to join
        return np.concatenate([result[f"fpfs1_{name}"] for result in results])

    response = np.stack([joined("de1_dg1"), joined("de2_dg2")], axis=1)
    return Shapes(joined("e1") + 1j * joined("e2"), response)


def metacal(stamps: Stamps, rng: np.random.Generator) -> Shapes:
    """Measure by ngmix: moments with a Gaussian weight of images sheared by SHEAR_STEP, the PSF made round."""
    import ngmix
    from ngmix.gaussmom import GaussMom
    from ngmix.metacal import get_all_metacal

    # odd: ngmix moves the galaxy by the PSF's offset from the middle
    galaxies = stamps.galaxies[:, 1:, 1:]
    psf = stamps.psf[:, 1:, 1:]
    side = galaxies.shape[-1]
    jacobian = ngmix.DiagonalJacobian(row=side // 2, col=side // 2, scale=stamps.scale)
    weight = np.full((side, side), 1 / max(stamps.sigma, 1e-3) ** 2)
    moments = partial(_weighted, GaussMom(fwhm=WEIGHT_FWHM))
    e = np.full(len(galaxies), np.nan, complex)
    response = np.full((len(galaxies), 2), np.nan)
    for k, (image, star) in enumerate(zip(galaxies, psf, strict=True)):
        observation = ngmix.Observation(
            np.array(image, float),
            weight=weight,
            jacobian=jacobian,
            psf=ngmix.Observation(np.array(star / star.sum(), float), jacobian=jacobian),
        )
        types = ["noshear", "1p", "1m", "2p", "2m"]
        options = {"rng": np.random.RandomState(int(rng.integers(2**32))), "fixnoise": stamps.sigma > 0}
        try:
            sheared = get_all_metacal(observation, psf="gauss", step=SHEAR_STEP, types=types, **options)
        except ngmix.GMixRangeError:
            continue
        shapes = {name: moments(sheared[name]) for name in types}
        e[k] = shapes["noshear"]
        response[k] = (
            (shapes["1p"] - shapes["1m"]).real / (2 * SHEAR_STEP),
            (shapes["2p"] - shapes["2m"]).imag / (2 * SHEAR_STEP),
        )
    return Shapes(np.where(np.isfinite(response).all(axis=1), e, np.nan), response)


def _weighted(measure: GaussMom, observation: Observation) -> complex:
    result = measure.go(observation)
    return complex(*result["e"]) if result["flags"] == 0 else complex(np.nan, np.nan)
