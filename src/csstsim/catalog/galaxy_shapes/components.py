"""The Sersic components of the objects of a table: the only definition of a galaxy's profiles."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from csstsim.catalog.profiles.sersic import BULGE, DISK
from csstsim.catalog.table import GALAXY, ObjectTable

if TYPE_CHECKING:
    from csstsim.base.types import BoolArray, FloatArray, Floats

KNOTS_WITHIN = 0.98  # fraction of the disk's flux within the radius of the outermost knots


class Component(NamedTuple):
    """Disks or bulges of n objects.

    fraction (n,): of the object's flux, knots included in the disk's; sersic_index: a number, or (n,) if the table
    has a column of it; size (n,): half-light radius [arcsec].
    """

    fraction: FloatArray
    sersic_index: Floats
    size: FloatArray


def components(table: ObjectTable) -> tuple[Component, Component]:
    """Return the disks and the bulges of an ObjectTable's objects.

    A point is a disk of size 0, an image a disk. The table may contain any value for a point's shape and for the size
    and index of a component without flux.
    """
    galaxy = table["obj_type"] == GALAXY
    bulge = np.where(galaxy, table["bulge_frac"].astype(float), 0.0)

    def component(fraction: FloatArray, default: float, name: str) -> Component:
        extended = galaxy & (fraction > 0)
        index = np.where(extended, table[f"n_{name}"].astype(float), default) if f"n_{name}" in table else default
        return Component(fraction, index, np.where(extended, table[f"size_{name}"].astype(float), 0.0))

    return component(1 - bulge, DISK, "disk"), component(bulge, BULGE, "bulge")


def has_knots(table: ObjectTable) -> BoolArray:
    """Return (n,) bool: whether an object has flux in knots."""
    if "knots" not in table or "knots_frac" not in table:
        return np.zeros(len(table), bool)
    return (table["obj_type"] == GALAXY) & (table["knots"] > 0) & (table["knots_frac"] > 0)


def has_image(table: ObjectTable) -> BoolArray:
    """Return (n,) bool: whether an object is rendered from an image."""
    if "image_file" not in table:
        return np.zeros(len(table), bool)
    return (table["obj_type"] == GALAXY) & (table["image_file"] != "")
