"""Why an object cannot be rendered: the reasons for the flag BAD_VALUE, in words."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

import numpy as np

from csstsim.catalog.changing import columns as changing
from csstsim.catalog.flags import STRONG_LENSING
from csstsim.catalog.galaxy_shapes.components import has_image
from csstsim.catalog.profiles.sersic import INDEX_MAX, INDEX_MIN
from csstsim.catalog.table import GALAXY, STAR, TYPES, ObjectTable
from csstsim.universe.lensing.lensing import magnification

if TYPE_CHECKING:
    from csstsim.base.types import BoolArray, FloatArray

MAX_KNOTS = 10_000
LARGEST = 3600.0  # arcsec, half-light radius
STRONGLY_LENSED = "strongly lensed"
NO_LIGHT = "its flux in the band is negative or not a number"


def reasons(table: ObjectTable) -> dict[str, BoolArray]:
    """Return {reason: (n,) bool} from the columns of an ObjectTable; its flux is not checked."""
    galaxy = table["obj_type"] == GALAXY
    bulge_frac = table["bulge_frac"]
    kappa, gamma1, gamma2 = (table[name] for name in ("kappa", "gamma1", "gamma2"))
    lensed = np.isfinite(kappa + gamma1 + gamma2)
    _, thin = magnification(*(np.where(lensed, v, 0.0) for v in (kappa, gamma1, gamma2)))
    found = {
        "ra, dec is not a position on the sky": ~np.isfinite(table["ra"] + table["dec"]) | (np.abs(table["dec"]) > 90),
        "obj_type is not one of " + ", ".join(TYPES): ~np.isin(table["obj_type"], range(len(TYPES))),
        "a galaxy whose bulge_frac is not within 0..1": galaxy & ~((bulge_frac >= 0) & (bulge_frac <= 1)),
        "a galaxy whose |e1, e2| is not below 1": galaxy & ~(np.hypot(table["e1"], table["e2"]) < 1),
        "kappa, gamma1 or gamma2 is not finite": (table["obj_type"] != STAR) & ~lensed,
        STRONGLY_LENSED: (table["obj_type"] != STAR) & lensed & ~thin,
    }
    for part, used in (("disk", bulge_frac < 1), ("bulge", bulge_frac > 0)):
        name = f"size_{part}"
        index = f"n_{part}"
        size = table[name]
        found[f"a galaxy without {name} (or size)"] = galaxy & used & ~((size > 0) & np.isfinite(size))
        found[f"a galaxy whose {name} is above {LARGEST:g} arcsec"] = galaxy & used & (size > LARGEST)
        if index in table:
            n = table[index]
            outside = ~((n >= np.float32(INDEX_MIN)) & (n <= np.float32(INDEX_MAX)))
            found[f"a galaxy whose {index} is not within {INDEX_MIN:g}..{INDEX_MAX:g}"] = galaxy & used & outside
    if "knots" in table or "knots_frac" in table:
        knots, knots_frac = (table.get(name, np.zeros(len(bulge_frac))) for name in ("knots", "knots_frac"))
        found["a galaxy whose knots_frac and bulge_frac are not within 0..1 together"] = galaxy & ~(
            (knots_frac >= 0) & (knots_frac + bulge_frac <= 1 + 1e-6)
        )
        found["a negative number of knots"] = knots < 0
        found["a star or quasar with knots"] = ~galaxy & ((knots != 0) | (knots_frac != 0))
        found["a galaxy with knots_frac but no knots"] = galaxy & (knots_frac > 0) & ~(knots > 0)
        found[f"a galaxy of more than {MAX_KNOTS} knots"] = galaxy & (knots > MAX_KNOTS)
        found["a galaxy with knots and an image"] = (knots_frac > 0) & has_image(table)
    if "image_file" in table:
        found["a star or quasar with an image"] = ~galaxy & (table["image_file"] != "")
        found["a galaxy with an image and a bulge"] = has_image(table) & (bulge_frac > 0)
        found["a galaxy whose image_pa or image_scale is not a number"] = has_image(table) & ~np.isfinite(
            table.get("image_pa", bulge_frac) + table.get("image_scale", bulge_frac)
        )
    return found | changing.reasons(table)


def unusable(table: ObjectTable, flux: FloatArray) -> BoolArray:
    """Return (n,) bool: a value for rendering is missing, not finite or impossible; flux: (n, 4) electron / s."""
    bad = cast("BoolArray", ~np.isfinite(flux).all(axis=1) | (flux < 0).any(axis=1))
    for reason, mask in reasons(table).items():
        bad |= mask & (reason != STRONGLY_LENSED)  # has a flag of its own
    return bad


def why_not_rendered(table: ObjectTable, omitted: BoolArray) -> dict[str, int]:
    """Return {reason: number of objects}, each object under its first reason; omitted (n,) bool: those not rendered."""
    remaining = np.array(omitted, dtype=bool)
    counts = {}
    masks = reasons(table)
    masks[STRONGLY_LENSED] |= (table["flags"] & STRONG_LENSING) != 0  # bricks flag arcs of thin lenses, too
    for reason, mask in masks.items():
        counts[reason] = int((remaining & mask).sum())
        remaining &= ~mask
    counts[NO_LIGHT] = int(remaining.sum())
    return {reason: count for reason, count in counts.items() if count}
