"""True objects and a catalogue's sources matched one to one, by position and, where it is known, by magnitude.

A pair within reach costs (distance / reach)^2 + (difference of magnitudes / MAG_SPREAD)^2, the catalogue's own zero
point removed; cheap pairs are made first (bricks.match.greedy_match). Magnitudes more than MAG_REACH apart are no pair.

An object without a source is merged if it lies within BLEND_ARCSEC (of larger sources: their half-light radius) of a
source that belongs to a brighter object; otherwise it is lost. A source without an object is a second one if an object
within reach has another; otherwise it is false.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from csstsim.base.sphere import ra_dec, unit_vectors
from csstsim.measure.bricks.match import greedy_match

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from csstsim.base.types import AnyArray, BoolArray, FloatArray, IntArray
    from csstsim.studies.release.score.catalogue import Catalogue

RADIUS = 0.3  # arcsec: minimum reach; of galaxies half the half-light radius if that is more
BLEND_ARCSEC = 0.5  # two objects closer than three PSF widths are one source to most codes
# mag
MAG_REACH = 3.0
MAG_SPREAD = 1.0
SHIFT = 10.0  # arcsec: of the catalogue, for matches by chance
FEWEST = 5  # pairs for a zero point


@dataclass(frozen=True)
class Matched:
    """row (n,): the source of each object, or -1; merged (n,): without one, in the source of a brighter object.

    second (m,): sources beside another one of their object; zero: mag, the catalogue's own zero point.
    """

    row: IntArray
    merged: BoolArray
    second: BoolArray
    zero: float

    @property
    def found(self) -> BoolArray:
        """(n,) objects that have a source."""
        return self.row >= 0

    def real(self, count: int) -> BoolArray:
        """Return (count,): sources that belong to an object."""
        mask = np.zeros(count, bool)
        mask[self.row[self.found]] = True
        return mask


class _Pairs(NamedTuple):
    """Pairs (n,): rows of the object and of the source, and their distance [arcsec]."""

    object: IntArray
    source: IntArray
    distance: FloatArray


def matched(
    truth: Mapping[str, AnyArray],
    sources: Catalogue | Mapping[str, AnyArray],
    band: str | None = None,
    radius: float = RADIUS,
) -> Matched:
    """Return the Matched of true objects and sources, mappings with ra, dec [deg]; truth has size [arcsec], too.

    band: whose magnitudes mag_B count; None: positions alone. radius: arcsec.
    """
    objects = unit_vectors(truth["ra"], truth["dec"]).reshape(-1, 3)
    found = unit_vectors(sources["ra"], sources["dec"]).reshape(-1, 3)
    reach = np.maximum(radius, 0.5 * np.nan_to_num(np.asarray(truth["size"], float)))
    first, second, distance = _pairs(objects, found, reach)
    zero = 0.0
    cost = (distance / reach[first]) ** 2
    if band and len(first):
        apart = np.asarray(sources[f"mag_{band}"], float)[second] - np.asarray(truth[f"mag_{band}"], float)[first]
        zero = _zero(first, second, distance, apart)
        apart = np.abs(apart - zero)
        known = np.isfinite(apart)
        cost = cost + np.where(known, apart / MAG_SPREAD, 0.0) ** 2
        near = ~known | (apart <= MAG_REACH)
        first = first[near]
        second = second[near]
        cost = cost[near]
    row = np.full(len(objects), -1)
    order = np.lexsort((second, first, cost))
    first = first[order]
    second = second[order]
    taken = greedy_match(first, second)
    row[first[taken]] = second[taken]
    merged = _merged(objects, found, truth, row, band)
    return Matched(row, merged, _second(row, first, second, len(found)), zero)


def _zero(first: IntArray, second: IntArray, distance: FloatArray, apart: FloatArray) -> float:
    """Return the median difference of magnitudes of the pairs that are the closest of both members; 0 of few."""
    order = np.lexsort((second, first, distance))
    order = order[greedy_match(first[order], second[order])]
    apart = apart[order]
    apart = apart[np.isfinite(apart)]
    return float(np.median(apart)) if len(apart) >= FEWEST else 0.0


def _pairs(objects: FloatArray, sources: FloatArray, reach: FloatArray) -> _Pairs:
    """Return all pairs of unit vectors (n, 3) within the objects' reach [arcsec]."""
    from scipy.spatial import cKDTree

    if not len(objects) or not len(sources):
        return _Pairs(np.zeros(0, int), np.zeros(0, int), np.zeros(0))
    near = cKDTree(sources).query_ball_point(objects, _chord(reach))
    first = np.repeat(np.arange(len(objects)), [len(rows) for rows in near])
    second = np.concatenate([np.zeros(0, int), *filter(None, near)]).astype(int)
    apart = np.linalg.norm(objects[first] - sources[second], axis=1)
    return _Pairs(first, second, np.degrees(2 * np.arcsin(np.minimum(apart / 2, 1.0))) * 3600.0)


def _chord(arcsec: FloatArray) -> FloatArray:
    return 2 * np.sin(np.radians(np.asarray(arcsec) / 3600.0) / 2)


def _merged(
    objects: FloatArray, sources: FloatArray, truth: Mapping[str, AnyArray], row: IntArray, band: str | None
) -> BoolArray:
    """Return (n,): objects without a source that lie on the source of a brighter object."""
    from scipy.spatial import cKDTree

    merged = np.zeros(len(row), bool)
    left = np.flatnonzero(row < 0)
    owners = np.flatnonzero(row >= 0)
    if not len(left) or not len(owners):
        return merged
    size = np.maximum(BLEND_ARCSEC, np.nan_to_num(np.asarray(truth["size"], float))[owners])
    mag = brightness(truth, band)
    hidden_by = cKDTree(objects[left]).query_ball_point(sources[row[owners]], _chord(size))
    for owner, near in zip(owners, hidden_by, strict=True):
        hidden = left[near]
        merged[hidden[mag[hidden] >= mag[owner]]] = True
    return merged


def brightness(truth: Mapping[str, AnyArray], band: str | None = None) -> FloatArray:
    """Return (n,) magnitudes in a band, or where that is not known, in the one where an object is brightest."""
    known = [np.nan_to_num(np.asarray(truth[n], float), nan=np.inf) for n in truth if n.startswith("mag_")]
    best = np.min(known, axis=0) if known else np.full(len(truth["ra"]), np.inf)
    if band:
        own = np.asarray(truth[f"mag_{band}"], float)
        return np.where(np.isfinite(own), own, best)
    return best


def _second(row: IntArray, first: IntArray, second: IntArray, count: int) -> BoolArray:
    """Return (count,): sources without an object, within reach of one that has another source."""
    mask = np.zeros(count, bool)
    mask[second[row[first] >= 0]] = True
    mask[row[row >= 0]] = False
    return mask


def chance(
    truth: Mapping[str, AnyArray],
    sources: Catalogue | Mapping[str, AnyArray],
    inside: Callable[[FloatArray, FloatArray], BoolArray],
    band: str | None = None,
    radius: float = RADIUS,
) -> tuple[float, int]:
    """Return (fraction, n): of n sources moved by SHIFT to four sides, and still `inside`, those that have an object.

    inside: function of ra, dec [deg] that tells which positions the field has.
    """
    hits = total = 0
    for east, north in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        ra, dec = moved(sources["ra"], sources["dec"], east * SHIFT, north * SHIFT)
        kept = inside(ra, dec)
        columns = {"ra": ra[kept], "dec": dec[kept]}
        if band:
            columns[f"mag_{band}"] = np.asarray(sources[f"mag_{band}"])[kept]
        hits += int(matched(truth, columns, band, radius).found.sum())
        total += int(kept.sum())
    return (hits / total if total else np.nan), total


def moved(ra: FloatArray, dec: FloatArray, east: float, north: float) -> tuple[FloatArray, FloatArray]:
    """Return ra, dec [deg] of positions moved by east, north [arcsec], on their tangent planes: also at the poles."""
    from csstsim.base.sphere import frames, normalised

    at, to_east, to_north = frames(np.radians(ra), np.radians(dec))
    east, north = np.radians(np.array([east, north]) / 3600.0)
    return ra_dec(normalised(at + east * to_east + north * to_north))
