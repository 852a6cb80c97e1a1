"""The Sersic components of the objects of a table: the only definition of a galaxy's profiles."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from csstsim.catalog.profiles.sersic import BULGE, DISK
from csstsim.catalog.table import GALAXY, ObjectTable

if TYPE_CHECKING:
    from csstsim.base.types import BoolArray, FloatArray, Floats

KNOTS_WITHIN = 0.98  # of the disk's light: knots lie within the radius that holds so much


def components(table: ObjectTable) -> tuple[tuple[FloatArray, Floats, FloatArray], ...]:
    """Return ((light, index, size), ...) of disk and bulge of an ObjectTable's objects.

    light (n,): share of the object's light, that of knots in the disk's; index: Sersic's, a number, or (n,)
    if the table has a column of it; size (n,): half-light radius [arcsec]. A point is a disk of size 0, an image a
    disk. The table may hold any value for a point's shape and for the size and index of a component without light.
    """
    galaxy = table["obj_type"] == GALAXY
    bulge = np.where(galaxy, table["bulge_frac"].astype(float), 0.0)
    out = []
    for light, usual, part in ((1 - bulge, DISK, "disk"), (bulge, BULGE, "bulge")):
        there = galaxy & (light > 0)
        index = np.where(there, table[f"n_{part}"].astype(float), usual) if f"n_{part}" in table else usual
        out.append((light, index, np.where(there, table[f"size_{part}"].astype(float), 0.0)))
    return tuple(out)


def has_knots(table: ObjectTable) -> BoolArray:
    """Return (n,) bool: whether an object has light in knots."""
    if "knots" not in table or "knots_frac" not in table:
        return np.zeros(len(table), bool)
    return (table["obj_type"] == GALAXY) & (table["knots"] > 0) & (table["knots_frac"] > 0)


def has_image(table: ObjectTable) -> BoolArray:
    """Return (n,) bool: whether an object's light is that of an image."""
    if "image_file" not in table:
        return np.zeros(len(table), bool)
    return (table["obj_type"] == GALAXY) & (table["image_file"] != "")
