"""The size of an object's stamp: half the side of the square that contains the flux visible above the noise.

Flux outside the stamp is not lost, but is rendered around it on coarser pixels (render.wings).

The paper asks GalSim for folding_threshold = 5e-8 on bright and large objects, which is a stamp of 27,756 pixels; its
default loses 0.5% of the flux. Here a stamp may end only where this chip's noise hides the rest:

* point sources: out to where the wing falls below a tenth of a pixel's noise and the flux beyond is less than a tenth
  of the object's own noise. The wing is that of an unobscured circular pupil (Born & Wolf, section 8.5.2),
  surface brightness lambda / (pi^3 D r^3), four times over for aberrations;
* flux beyond the box of the stored PSF (32 or 64 px): the wing is rendered out to where it falls below a thousandth of
  a pixel's noise, for every kind of object; an ideal filter detects the flux beyond with at most 1.3e-3 r [px] sigma;
* galaxies: out to where the fraction of flux beyond is max(1e-4, min(5e-3, 0.02 sigma_F / F)), from the closed form of
  the enclosed flux of Sersic profiles, stretched to circles of the longest axis (so never too small), plus
  the reach of a point source of that flux.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.units import ARCSEC_PER_RAD
from csstsim.catalog.galaxy_shapes.components import KNOTS_WITHIN, components, has_image, has_knots
from csstsim.catalog.profiles.sersic import BULGE, DISK, light_beyond, radius_of
from csstsim.universe.lensing.lensing import magnification

if TYPE_CHECKING:
    from csstsim.base.types import FloatArray
    from csstsim.catalog.table import ObjectTable
    from csstsim.instrument.filter import Filter
    from csstsim.instrument.telescope import Telescope
    from csstsim.optics.scatter.halo import Wing

# pixel; no stored PSF extends beyond 64
POINT_MIN = 16
POINT_MAX = 64
# pixel; a smaller stamp loses 1% of a faint star's flux: noise hides that for one star, but not on average
STAR_MIN = 32
REACH_MAX = 2048  # pixel
_WING_SAFETY = 4.0
_HIDDEN = 0.1  # largest lost flux, as a fraction of the noise
_HIDDEN_WING = 1e-3  # of a pixel's noise
_LOST = (1e-4, 5e-3, 0.02)
_PSF_HALF_LIGHT = 1.2  # pixel, for the number of pixels that bring noise
_GAUSSIAN = 4 * np.pi / (2 * np.log(2))  # effective number of pixels / half-light radius^2 of a Gaussian


def point_reach(
    electrons: FloatArray, variance: float, filter: Filter, telescope: Telescope, box: float = POINT_MAX
) -> FloatArray:
    """Return the reach [pixel], at most `box`.

    electrons: (n,) in the exposure; variance: of one pixel without the object [e-^2].
    """
    blur = filter.pivot * 1e-10 / telescope.diameter_m * ARCSEC_PER_RAD / telescope.pixel_scale  # lambda / D, pixel
    wing = _WING_SAFETY * blur / np.pi**3
    by_pixel = np.cbrt(electrons * wing / (_HIDDEN * np.sqrt(variance)))
    noise = np.sqrt(electrons + _GAUSSIAN * _PSF_HALF_LIGHT**2 * variance)
    by_flux = electrons * 2 * np.pi * wing / _WING_SAFETY / (_HIDDEN * noise)
    return np.clip(np.maximum(by_pixel, by_flux), POINT_MIN, box)


def wing_reach(electrons: FloatArray, variance: float, wing: Wing | None) -> FloatArray:
    """Return the radius [pixel] at which noise hides an object's wing, not clipped; 0 without flux or wing.

    electrons: (n,); variance: of one pixel without the object [e-^2]; wing: optics.scatter.halo.Wing or None.
    """
    lit = electrons > 0
    if wing is None:
        return np.zeros(len(lit))
    return np.where(lit, wing.radius(_HIDDEN_WING * np.sqrt(variance) / np.where(lit, electrons, 1.0)), 0.0)


def galaxy_radius(
    table: ObjectTable, electrons: FloatArray, variance: float, pixel_scale: float
) -> tuple[FloatArray, FloatArray]:
    """Return (radius, lost): visible radius of the profile before the PSF [pixel; may exceed REACH_MAX], and fraction
    of the flux that may lie beyond it."""
    stretch = _stretch(table) / pixel_scale
    parts = [part._replace(size=part.size * stretch) for part in components(table)]
    size2 = sum(part.fraction * part.size**2 for part in parts) + _PSF_HALF_LIGHT**2
    noise = np.sqrt(electrons + _GAUSSIAN * size2 * variance)
    low, high, of_noise = _LOST
    lost = np.clip(of_noise * noise / np.maximum(electrons, 1e-30), low, high)
    # 100 r_e contain all but 4e-5 of n = 4, 2000 r_e all but that of n = 6.2
    widest = [part.size * np.where(np.asarray(part.sersic_index) > BULGE, 2000.0, 100.0) for part in parts]
    inner = np.zeros(len(table))
    outer = np.max(widest, axis=0)
    for _ in range(22):  # halving: to 1e-4 of a half-light radius
        middle = 0.5 * (inner + outer)
        outside = sum(part.fraction * light_beyond(middle, part.size, part.sersic_index) for part in parts)
        too_small = outside > lost
        inner = np.where(too_small, middle, inner)
        outer = np.where(too_small, outer, middle)
    return parts_radius(table, outer, pixel_scale), lost


def parts_radius(table: ObjectTable, radius: FloatArray, pixel_scale: float) -> FloatArray:
    """Return the visible radius (n,) [pixel] of galaxies: `radius` of disk and bulge, or more for knots and images.

    Knots lie within a fraction of the disk's flux (catalog.galaxy_shapes.knots); an image extends to its corners.
    """
    stretch = _stretch(table) / pixel_scale
    knotted = np.flatnonzero(has_knots(table))
    if len(knotted):
        galaxies = table.take(knotted)
        index = galaxies["n_disk"].astype(float) if "n_disk" in galaxies else np.full(len(galaxies), DISK)
        outermost = radius_of(KNOTS_WITHIN, index) * galaxies["size_disk"] * stretch[knotted]
        radius[knotted] = np.maximum(radius[knotted], outermost)
    imaged = has_image(table)
    if imaged.any():
        unsheared = table.with_columns(e1=np.zeros(len(table)), e2=np.zeros(len(table)))
        radius = np.where(imaged, table["image_radius"] * _stretch(unsheared) / pixel_scale, radius)
    return radius


def _stretch(table: ObjectTable) -> FloatArray:
    """Longest axis over the circular radius: ellipticity at constant area, then lensing."""
    e = np.hypot(table["e1"].astype(float), table["e2"].astype(float))
    kappa, gamma1, gamma2 = (table[name].astype(float) for name in ("kappa", "gamma1", "gamma2"))
    _, thin = magnification(kappa, gamma1, gamma2)
    shrink = np.where(thin, 1 - kappa - np.hypot(gamma1, gamma2), 1.0)
    return np.sqrt((1 + e) / (1 - e)) / shrink
