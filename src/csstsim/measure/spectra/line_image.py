"""The image of an object at one wavelength, and the electrons that are extracted from it.

    L(x, y) = PSF * sum_k f_k S_k(x, y) * pixel        f_k, S_k: fraction and image of component k of the galaxy

An emission line has the image L. Its profile across the trace differs from column to column: it is sharper in the
middle, and slanted if the galaxy is. The collapsed profile P of a continuum is their mean. With the weights w of the
extraction,

    extracted(X) = sum_y w(X, y) L(X - X_0, y - Y_0),        Y_0: the trace at the line

is the fraction of a line's flux that is extracted in column X. Its sum over all columns is that of P along the trace,
but in the middle of a resolved galaxy `extracted` is larger. The transform of a component is that of a circle at the
wave number sqrt(a^2 kx^2 + b^2 ky^2 + 2 rho a b kx ky), with its half-light radii a, b on x and y, and the slant rho.
The step of the lattice is half a pixel, its period one of SIDES. Left out: flux of the PSF beyond SIDES[0].
"""

from collections.abc import Callable
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import ArrayLike

from csstsim.base.types import ComplexArray, FloatArray
from csstsim.catalog.profiles.sersic import BULGE, DISK, radius_of
from csstsim.measure.spectra.line_profile import band_position
from csstsim.optics.psf.psf_file import half_pixels

SIDES = 64, 128  # px: of the lattice of small objects, and of those with a radius above LARGE
LARGE = 8.0  # px, half-light
_RINGS = 2000  # of equal light
_WAVES = np.concatenate([[0.0], np.geomspace(1e-2, 1e3, 500)])  # wave numbers times the half-light radius


class LineImage:
    """The image of one object at one position, at any wavelength."""

    def __init__(
        self,
        psf: Callable[[], ComplexArray],
        bands: FloatArray,
        fractions: FloatArray,
        radius: FloatArray,
        slant: float,
    ) -> None:
        """Store the PSF and the shape of the object.

        psf: function without arguments that returns point_transforms of the PSF at `bands` [angstrom]; fractions (2,),
        radius (2 axes, 2) px, slant: of line_profile.Shapes.
        """
        self._psf = psf
        self._bands = bands
        self._shape = (fractions, radius, slant)
        self._n = 2 * SIDES[int((fractions * radius.max(axis=0)).sum() > LARGE)]
        self._transforms: dict[int, ComplexArray] = {}  # by band, computed when first used

    def extracted(self, wavelength: float, x: FloatArray, y: FloatArray, weights: FloatArray) -> FloatArray:
        """Return (n,): sums over rows of weights (n, rows) times the fraction of the flux in pixels.

        x (n,): distance of consecutive columns from the line [px]; y (rows,): of rows from the trace at the line [px].
        """
        dx, dy = (float(coordinate[0] - np.rint(coordinate[0])) for coordinate in (x, y))
        image = self._pixels(wavelength, dx, dy)
        i, j = (np.rint(coordinate - d).astype(int) + len(image) // 2 for coordinate, d in ((x, dx), (y, dy)))
        inside = (i >= 0) & (i < len(image))
        rows = (j >= 0) & (j < len(image))
        out = np.zeros(len(x))
        pixels = np.ix_(inside, rows)
        out[inside] = (weights[pixels] * image.T[np.ix_(i[inside], j[rows])]).sum(axis=1)
        return out

    def _pixels(self, wavelength: float, dx: float, dy: float) -> FloatArray:
        """Return (side, side): fractions of the flux in pixels [y, x]; the middle pixel is dx, dy [px] off the line."""
        n = self._n
        band, fraction = band_position(wavelength, self._bands)
        # The middle of a cell is a quarter of a pixel from a whole position; a pixel is four cells
        along, across = (
            (2 * np.cos(k / 4) * np.exp(1j * k * (d - 0.25))).astype(np.complex64)
            for k, d in zip(_wave_numbers(n)[::-1], (dx, dy), strict=True)
        )
        waves = self._transform(band) * np.float32(1 - fraction)
        waves += self._transform(band + 1) * np.float32(fraction)
        waves *= across[:, None]
        waves *= along
        # Only every second cell is needed: wave numbers that are equal on whole pixels are added
        folded = waves[: n // 2]
        folded += waves[n // 2 :]
        half = folded[:, : n // 4 + 1].copy()
        mirrored = folded[:, n // 4 :][:, ::-1]
        half[0] += np.conj(mirrored[0])
        half[1:] += np.conj(mirrored[:0:-1])
        return np.fft.irfft2(half, (n // 2, n // 2)) / 4

    def _transform(self, band: int) -> ComplexArray:
        """Return complex64 (n, n // 2 + 1), the transform of the object in cells at a band."""
        if band not in self._transforms:
            point = self._point[band]
            if self._n > 2 * SIDES[0]:
                before = (self._n - 2 * SIDES[0]) // 2
                point = np.fft.rfft2(np.pad(np.fft.irfft2(point), before))
            self._transforms[band] = (point * self._galaxy).astype(np.complex64, copy=False)
        return self._transforms[band]

    @cached_property
    def _galaxy(self) -> FloatArray:
        return _galaxy(self._n, *self._shape)

    @cached_property
    def _point(self) -> ComplexArray:
        return self._psf()


@lru_cache
def _wave_numbers(n: int) -> tuple[FloatArray, FloatArray]:
    """Return (ky (n,), kx (n // 2 + 1,)) [1 / px] of a lattice of half pixels."""
    ky = np.fft.fftfreq(n, 0.5) * 2 * np.pi
    kx = np.fft.rfftfreq(n, 0.5) * 2 * np.pi
    return ky, kx


def _galaxy(n: int, fractions: FloatArray, radius: FloatArray, slant: float) -> FloatArray:
    """Return float32 (n, n // 2 + 1): the transform of an object's components."""
    ky, kx = _wave_numbers(n)
    out = np.zeros((n, len(kx)))
    for index, fraction, (a, b) in zip((DISK, BULGE), fractions, radius.T, strict=True):
        if fraction == 0:
            continue
        k2 = (a * kx) ** 2 + ((b * ky) ** 2)[:, None] + 2 * slant * a * b * np.outer(ky, kx)
        out += fraction * np.interp(np.sqrt(np.maximum(k2, 0.0)), _WAVES, _sersic(index))
    return out.astype(np.float32)


@lru_cache
def _sersic(index: float) -> FloatArray:
    """Return the transform of a circular Sersic profile at _WAVES."""
    from scipy.special import j0

    radius = radius_of((np.arange(_RINGS) + 0.5) / _RINGS, index)
    return np.array([j0(k * radius).mean() for k in _WAVES])


def point_transforms(cells: ArrayLike, per_pixel: int) -> ComplexArray:
    """Return (4, n, n // 2 + 1) complex64, transforms of a PSF in half pixels within SIDES[0], from its cells."""
    half = half_pixels(np.asarray(cells, float), per_pixel)
    n = 2 * SIDES[0]
    edge, before = (max(difference, 0) // 2 for difference in (half.shape[-1] - n, n - half.shape[-1]))
    part = slice(edge, half.shape[-1] - edge)
    inner = np.pad(half[:, part, part], ((0, 0), (before, before), (before, before)))
    return np.fft.rfft2(inner).astype(np.complex64)
