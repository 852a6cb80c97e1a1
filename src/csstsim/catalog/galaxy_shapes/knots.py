"""Knots of galaxies: points of equal flux, at random positions in the profile of the disk.

Positions are in the circle that ellipticity and lensing turn into the galaxy. They depend on the galaxy's id, its
Sersic index and the number of its knots alone, so that the knots are the same in all exposures of all campaigns. They
are within the radius that contains KNOTS_WITHIN of the disk's flux.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numba
import numpy as np

from csstsim.base.counter import high, object_keys, word
from csstsim.base.errors import InputError
from csstsim.catalog.galaxy_shapes.components import KNOTS_WITHIN, has_knots
from csstsim.catalog.profiles.sersic import DISK
from csstsim.catalog.profiles.sersic_photons import ring, rings_for
from csstsim.catalog.table import ObjectTable

if TYPE_CHECKING:
    from astropy.table import Table

    from csstsim.base.types import FloatArray, IntArray

_STREAM = np.uint64(0x6B6E6F74735F3031)  # the word "knots_01": of no other random number
_BEYOND = np.uint64(int((1 - KNOTS_WITHIN) * 2**32))
_LOW31 = np.uint64(0x7FFFFFFF)
_OUTER = np.uint64(0x80000000)
_ONE = np.uint64(1)


class Knots(NamedTuple):
    """The knots of the objects `rows` (m,) of a table.

    fraction (m,): of the object's flux in knots; counts (m,): numbers of knots; u, v (sum of counts,): positions in the
    galaxy's circle [arcsec]; size (m,): the disk's half-light radius [arcsec].
    """

    rows: IntArray
    fraction: FloatArray
    counts: IntArray
    u: FloatArray
    v: FloatArray
    size: FloatArray


def knots_of(table: ObjectTable | Table) -> Knots:
    """Return the Knots of an ObjectTable, or of the truth of a frame as an astropy Table or ObjectTable.

    Raises InputError for a table without a column that knots need.
    """
    names = table.names if isinstance(table, ObjectTable) else table.colnames
    table = ObjectTable({"id" if name == "obj_ID" else name: np.asarray(table[name]) for name in names})
    if missing := [name for name in ("id", "obj_type", "size_disk") if name not in table]:
        raise InputError("the table lacks a column", key=missing[0])
    rows = np.flatnonzero(has_knots(table))
    if not len(rows):
        return Knots(rows, *(np.zeros(0) for _ in range(5)))  # type: ignore[arg-type]  # no counts
    galaxies = table.take(rows)
    counts = galaxies["knots"].astype(np.int64)
    size = galaxies["size_disk"].astype(float)
    index = galaxies["n_disk"].astype(float) if "n_disk" in galaxies else np.full(len(rows), DISK)
    u = np.empty(counts.sum())
    v = np.empty(counts.sum())
    _set_positions(u, v, counts, size, object_keys(_STREAM, galaxies["id"].astype(np.int64)), *rings_for(index))
    if "knots_turned" in galaxies:
        turned = np.repeat(galaxies["knots_turned"] != 0, counts)
        u, v = np.where(turned, -v, u), np.where(turned, u, v)
    return Knots(rows, galaxies["knots_frac"].astype(float), counts, u, v, size)


@numba.njit(cache=True)
def _set_positions(
    u: FloatArray,
    v: FloatArray,
    counts: IntArray,
    size: FloatArray,
    keys: IntArray,
    rings: FloatArray,
    which: IntArray,
    fraction: FloatArray,
) -> None:
    """Fill u, v; rings, which, fraction: of profiles.sersic_photons.Rings."""
    k = 0
    for i in range(len(counts)):
        counter = np.uint64(0)
        for _ in range(counts[i]):
            bits = word(keys[i], counter)
            while bits & _OUTER and (bits & _LOW31) < _BEYOND:  # the lower bits count the flux from outside
                counter += _ONE
                bits = word(keys[i], counter)
            counter += _ONE
            r = size[i] * ring(rings, which[i], fraction[i], bits)
            angle = 2 * np.pi * high(bits)
            u[k], v[k] = r * np.cos(angle), r * np.sin(angle)
            k += 1
