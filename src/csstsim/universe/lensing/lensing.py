"""Weak lensing of the galaxies (paper, sections 3.2.3 and 5.3.1): the columns kappa, gamma1, gamma2, and magnification.

    g = gamma / (1 - kappa),   mu = 1 / ((1 - kappa)^2 - |gamma|^2)

A field with |g| >= 1, kappa >= 1 or mu <= 0 is strong lensing, which thin shear cannot describe. Such galaxies are
flagged and never become NaN. Positions are in the image plane: there is no deflection.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.types import BoolArray, FloatArray, Floats

if TYPE_CHECKING:
    from csstsim.campaign.sections import Lensing
    from csstsim.universe.lensing.potential_field import PotentialField


def magnification(kappa: Floats, gamma1: Floats, gamma2: Floats) -> tuple[FloatArray, BoolArray]:
    """Return the magnification of an image by a lensing field.

    Parameters
    ----------
    kappa, gamma1, gamma2 : float or ndarray
        Convergence and shear (dimensionless), which broadcast.

    Returns
    -------
    mu : ndarray, shape of the arguments
        Magnification, 1 where `valid` is False.
    valid : ndarray of bool
        False where the field is strong or not a number.

    Examples
    --------
    >>> mu, valid = magnification(0.02, 0.01, -0.03)
    >>> print(mu.round(4), valid)
    1.0423 True
    """
    kappa = np.asarray(kappa, dtype=float)
    inverse = (1 - kappa) ** 2 - (np.asarray(gamma1, dtype=float) ** 2 + np.asarray(gamma2, dtype=float) ** 2)
    valid = (kappa < 1) & (inverse > 0) & np.isfinite(inverse)  # with kappa < 1, mu > 0 is |g| < 1
    return np.divide(1.0, inverse, out=np.ones(np.shape(inverse)), where=valid), valid


def stretch(kappa: Floats, gamma1: Floats, gamma2: Floats) -> FloatArray:
    """Return the factor by which an image is stretched along its longer axis, 1 / (1 - kappa - |gamma|), or inf."""
    smallest = 1 - kappa - np.hypot(gamma1, gamma2)
    return np.divide(1.0, smallest, out=np.full(np.shape(smallest), np.inf), where=smallest > 0)


def lens(
    pix: int, ra: FloatArray, dec: FloatArray, z: FloatArray, lensing: Lensing, field: PotentialField | None = None
) -> dict[str, FloatArray]:
    """Return {kappa, gamma1, gamma2} (float32, each (n,)) of galaxies in brick `pix`, axes east and north.

    ra, dec: deg, inside the brick; z: redshifts; lensing: sections.Lensing; field: lensing_field.LensingField or
    structure.matter_field.MatterField, needed only for `field: cosmic`. It does not lens z <= 0 or NaN; z beyond the
    last shell counts as its edge.
    """
    if lensing.field == "cosmic":
        return field.lens(pix, ra, dec, z)._asdict()  # type: ignore[union-attr]  # it is given
    values = {"kappa": lensing.kappa, "gamma1": lensing.gamma1, "gamma2": lensing.gamma2}  # zeros for `none`
    return {name: np.full(len(z), value, np.float32) for name, value in values.items()}
