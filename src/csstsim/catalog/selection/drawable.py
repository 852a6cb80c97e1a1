"""Why an object cannot be drawn: the reasons behind the flag BAD_VALUE, in words."""

import numpy as np

from csstsim.catalog.changing import columns as changing
from csstsim.catalog.table import GALAXY, STAR, TYPES
from csstsim.universe.lensing.lensing import magnification

LARGEST = 3600.0  # arcsec, half-light radius
STRONGLY_LENSED = "strongly lensed"
NO_LIGHT = "its light in the band is negative or not a number"


def reasons(table):
    """Return {reason: (n,) bool} from the columns of an ObjectTable; its light is not checked."""
    galaxy = table["obj_type"] == GALAXY
    share = table["bulge_frac"]
    kappa, gamma1, gamma2 = (table[name] for name in ("kappa", "gamma1", "gamma2"))
    lensed = np.isfinite(kappa + gamma1 + gamma2)
    _, thin = magnification(*(np.where(lensed, v, 0.0) for v in (kappa, gamma1, gamma2)))
    found = {
        "ra, dec is not a position on the sky": ~np.isfinite(table["ra"] + table["dec"]) | (np.abs(table["dec"]) > 90),
        "obj_type is not one of " + ", ".join(TYPES): ~np.isin(table["obj_type"], range(len(TYPES))),
        "a galaxy whose bulge_frac is not within 0..1": galaxy & ~((share >= 0) & (share <= 1)),
        "a galaxy whose |e1, e2| is not below 1": galaxy & ~(np.hypot(table["e1"], table["e2"]) < 1),
        "kappa, gamma1 or gamma2 is not finite": (table["obj_type"] != STAR) & ~lensed,
        STRONGLY_LENSED: (table["obj_type"] != STAR) & lensed & ~thin,
    }
    for name, used in (("size_disk", share < 1), ("size_bulge", share > 0)):
        size = table[name]
        found[f"a galaxy without {name}"] = galaxy & used & ~((size > 0) & np.isfinite(size))
        found[f"a galaxy whose {name} is above {LARGEST:g} arcsec"] = galaxy & used & (size > LARGEST)
    return found | changing.reasons(table)


def unusable(table, flux):
    """Return (n,) bool: a value that drawing needs is missing, not finite or impossible; flux: (n, 4) electron / s."""
    bad = ~np.isfinite(flux).all(axis=1) | (flux < 0).any(axis=1)
    for reason, mask in reasons(table).items():
        bad |= mask & (reason != STRONGLY_LENSED)  # has a flag of its own
    return bad


def why_not_drawn(table, dark):
    """Return {reason: number of objects}, each object under its first reason; `dark` (n,) bool: those not drawn."""
    left, counts = np.array(dark, dtype=bool), {}
    for reason, mask in reasons(table).items():
        counts[reason] = int((left & mask).sum())
        left &= ~mask
    counts[NO_LIGHT] = int(left.sum())
    return {reason: count for reason, count in counts.items() if count}
