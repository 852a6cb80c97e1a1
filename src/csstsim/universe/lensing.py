"""Weak lensing of the galaxies (paper, sections 3.2.3 and 5.3.1): one constant field (first version).

    g = gamma / (1 - kappa),   mu = 1 / ((1 - kappa)^2 - |gamma|^2)

A field with |g| >= 1, kappa >= 1 or mu <= 0 is strong lensing, which thin-shear rendering cannot draw: such
galaxies are flagged, never turned into NaN. Positions are those in the image plane: no deflection.
"""

import numpy as np


def magnification(kappa, gamma1, gamma2):
    """Return (mu, valid); where `valid` is False the field is strong or not a number, and mu is 1."""
    kappa, gamma1, gamma2 = (np.asarray(v, dtype=float) for v in (kappa, gamma1, gamma2))
    gamma2_total = gamma1**2 + gamma2**2
    inverse = (1 - kappa) ** 2 - gamma2_total
    valid = (kappa < 1) & (inverse > 0)  # with kappa < 1, mu > 0 is |g| < 1
    return np.divide(1.0, inverse, out=np.ones(np.shape(inverse)), where=valid), valid


def lens(count, field):
    """Return the columns kappa, gamma1, gamma2 of `count` galaxies in a config.ConstantShear field."""
    return {name: np.full(count, getattr(field, name), np.float32) for name in ("kappa", "gamma1", "gamma2")}
