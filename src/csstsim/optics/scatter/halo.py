"""The light of a point source far from its core: the scattered halo and the mean diffraction wing.

The halo (paper, section 5.5.1: a linear combination of BRDFs) is a sum of terms of the modified Harvey-Shack shape,
each normalised to its fraction S of the flux, with knee a and slope s > 2:

    I(r) = S (s - 2) / (2 pi a^2) (1 + (r/a)^2)^(-s/2)          light beyond r: S (1 + (r/a)^2)^(1 - s/2)

The light of the halo is removed from the diffraction image, so the sum stays 1. Beyond the scattering angles of the
mirrors' figure errors (40 cycles per pupil, 53 px at 950 nm) the diffraction image is on average that of a clear
circular pupil (Born & Wolf, section 8.5.2):

    I(r) = L / (pi^3 r^3), L = lambda / D          light beyond r: 2 L / (pi^2 r)

The stored PSFs follow this to 1% from 45 px to their edge (benchmarks/wings.py). Numbers: scatter.yaml.

Left out: change of the halo over the field, its dependence on the mirrors' ageing, diffraction at other edges than the
aperture stop, reflections (optics.scatter.ghosts).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import ArrayLike

from csstsim.base.errors import InputError
from csstsim.base.types import FloatArray
from csstsim.base.units import ARCSEC_PER_RAD

if TYPE_CHECKING:
    from csstsim.instrument.telescope import Telescope

_GAUSS = 0.5 / np.sqrt(3.0)  # two-point quadrature: nodes at +- this many cells
_RADII = np.geomspace(1.0, 1e5, 2001)  # px; for the inverse of the profile


@dataclass(frozen=True, eq=False)
class Wing:
    """The circular part of a point source's image in each of the four sub-bands; lengths in pixels."""

    share: FloatArray  # (4, K) fraction of all the light, by sub-band and term of the halo
    knee: FloatArray  # (K,)
    slope: FloatArray  # (K,)
    airy: FloatArray  # (4,) lambda / D

    @property
    def scattered(self) -> FloatArray:
        """(4,) fraction of the flux in the halo."""
        return self.share.sum(axis=1)

    def halo(self, r: ArrayLike) -> FloatArray:
        """Return the halo's light per pixel at radii r [px], (4, *r.shape)."""
        q = 1 + (np.asarray(r, float)[..., None] / self.knee) ** 2
        shape = (self.slope - 2) / (2 * np.pi * self.knee**2) * q ** (-self.slope / 2)
        return np.einsum("bk,...k->b...", self.share, shape)

    def profile(self, r: ArrayLike) -> FloatArray:
        """Return halo plus mean diffraction wing, light per pixel at radii r [px] > 0, (4, *r.shape)."""
        halo = self.halo(r)
        direct = ((1 - self.scattered) * self.airy).reshape(-1, *(1,) * np.ndim(r))
        return halo + direct / (np.pi * np.asarray(r, float)) ** 3

    def light_beyond(self, r: ArrayLike) -> FloatArray:
        """Return the fraction of all the light beyond radii r [px] of the profile, (4, *r.shape)."""
        q = 1 + (np.asarray(r, float)[..., None] / self.knee) ** 2
        halo = np.einsum("bk,...k->b...", self.share, q ** (1 - self.slope / 2))
        direct = ((1 - self.scattered) * self.airy).reshape(-1, *(1,) * np.ndim(r))
        return halo + 2 * direct / (np.pi**2 * np.asarray(r, float))

    def radius(self, level: ArrayLike) -> FloatArray:
        """Return the radii [px] at which the mean profile of the sub-bands falls to `level` (per pixel, array).

        Log-log interpolation; the result is limited to 1 to 1e5 px.
        """
        profile = np.log(self.profile(_RADII).mean(axis=0))
        with np.errstate(divide="ignore"):
            return np.exp(np.interp(-np.log(level), -profile, np.log(_RADII)))

    def cells(self, count: int, per_pixel: int) -> FloatArray:
        """Return the halo's integrals over cells, `per_pixel` to a pixel, (4, count, count), about its centre."""
        axis = (np.arange(count) - (count - 1) / 2)[:, None] + np.array([-_GAUSS, _GAUSS])
        square = (axis.ravel() / per_pixel) ** 2
        value = self.halo(np.sqrt(square + square[:, None]))
        return value.reshape(4, count, 2, count, 2).mean(axis=(2, 4)) / per_pixel**2

    def add_to(self, images: FloatArray, per_pixel: int) -> FloatArray:
        """Return diffraction images (4, cells, cells), cell integrals, with the light of the halo moved there."""
        return (1 - self.scattered)[:, None, None] * images + self.cells(images.shape[-1], per_pixel)

    def as_dict(self) -> dict[str, Any]:
        """Return the content as lists, for a file; `Wing.read` is the inverse."""
        return {name: value.tolist() for name, value in asdict(self).items()}

    @classmethod
    def read(cls, data: Mapping[str, Any]) -> Self:
        """Return the Wing of a mapping made by `as_dict`."""
        return cls(**{name: np.asarray(value, float) for name, value in data.items()})


def make_wing(scatter: Mapping[str, Any], wavelength: ArrayLike, telescope: Telescope) -> Wing:
    """Return the `Wing` at wavelengths (4,) angstrom. `scatter` is Camera.scatter; empty: no halo, diffraction only.

    Raises InputError for a row that is not share, knee, slope, power, or a halo with all the light or more.
    """
    rows = scatter.get("terms") or []
    reference = scatter.get("reference", 1.0)
    if not isinstance(reference, int | float) or not 1 <= reference <= 1e6:
        raise InputError("not a wavelength", file="scatter.yaml", key="reference", value=reference, allowed="angstrom")
    for row in rows if isinstance(rows, list) else [rows]:
        good = isinstance(row, list) and len(row) == 4 and all(isinstance(v, int | float) and abs(v) < 1e6 for v in row)
        if not (good and row[0] >= 0 and row[1] > 0 and row[2] > 2):
            allowed = "share >= 0, knee > 0 arcsec, slope > 2, power"
            raise InputError("bad row", file="scatter.yaml", key="terms", value=row, allowed=allowed)
    share, knee, slope, power = np.reshape(rows, (-1, 4)).astype(float).T
    wavelength = np.asarray(wavelength, float)
    share = share * (wavelength[:, None] / reference) ** -power
    if (share.sum(axis=1) >= 1).any():
        raise InputError(
            "the halo has all the light or more",
            file="scatter.yaml",
            key="terms",
            value=float(share.sum(axis=1).max()),
            allowed="< 1",
        )
    airy = wavelength * 1e-10 / telescope.diameter_m * ARCSEC_PER_RAD / telescope.pixel_scale
    return Wing(share, knee / telescope.pixel_scale, slope, airy)
