"""Completeness and purity of a merged catalogue by the local density of objects: in clusters and in voids.

The density at a position is that of the detectable true objects within RADIUS: those of S/N above SNR_DETECTABLE in one
exposure of any band. An object closer than SAME is the source itself and does not count. Near the border of the brick
or of the frames the density is too low, because nothing beyond is known.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from csstsim.base.sphere import unit_vectors
from csstsim.base.types import BoolArray, FloatArray, IntArray
from csstsim.measure.bricks.validation.compare import SNR_COUNT, true_snr

if TYPE_CHECKING:
    from csstsim.catalog.table import ObjectTable

# arcsec
SAME = 0.5
RADIUS = 15.0
SNR_DETECTABLE = 5.0
EDGES = (0.0, 20.0, 40.0, 60.0, 90.0, 130.0, 200.0, 400.0, np.inf)  # arcmin-2


def by_density(
    truth: ObjectTable,
    sources: ObjectTable,
    match: IntArray,
    real: BoolArray,
    infos: Mapping[str, Sequence[Mapping[str, Any]]],
) -> dict[str, list[float] | list[int]]:
    """Return the numbers of a brick by bin of local density [arcmin-2], JSON-like lists of one entry a bin.

    truth, match: as in compare; real: (sources,) bool; infos: {band: its frames' info}. edges: the bins' lower
    edges; objects, found: true objects of S/N above SNR_COUNT in one exposure of some band, and how many have a source;
    sources, real: merged sources, and how many match a true object.
    """
    snr_of_bands = [np.nan_to_num(true_snr(band, truth, of_band)) for band, of_band in infos.items()]
    snr = np.max([np.zeros(len(truth)), *snr_of_bands], axis=0)
    positions = unit_vectors(truth["ra_epoch"], truth["dec_epoch"])[snr > SNR_DETECTABLE]
    bright = snr > SNR_COUNT
    objects = _bins(positions, truth["ra_epoch"][bright], truth["dec_epoch"][bright])
    detected = _bins(positions, sources["ra"], sources["dec"])
    found = np.asarray(match)[bright] >= 0
    real = np.asarray(real, bool)
    return {
        "edges": list(EDGES[:-1]),
        "objects": _counts(objects),
        "found": _counts(objects[found]),
        "sources": _counts(detected),
        "real": _counts(detected[real]),
    }


def _bins(positions: FloatArray, ra: FloatArray, dec: FloatArray) -> IntArray:
    """Return the bin (n,) of the density of `positions` (m, 3) around ra, dec (n,)."""
    from scipy.spatial import cKDTree

    if len(positions) == 0 or len(ra) == 0:
        return np.zeros(len(ra), int)
    tree = cKDTree(positions)
    centres = unit_vectors(ra, dec)
    same, near = (tree.query_ball_point(centres, np.radians(r / 3600.0), return_length=True) for r in (SAME, RADIUS))
    return np.digitize((near - same) / (np.pi * (RADIUS / 60.0) ** 2), EDGES[1:-1])


def _counts(bins: IntArray) -> list[int]:
    return np.bincount(bins, minlength=len(EDGES) - 1).tolist()
