"""True objects and a catalogue's sources matched one to one, by position and, where it is known, by magnitude.

A pair within reach costs (distance / reach)^2 + (difference of magnitudes / MAG_SPREAD)^2, after subtracting the
catalogue's zero point. Pairs are matched by increasing cost (bricks.match.greedy_match). A pair whose magnitudes differ
by more than MAG_REACH is not matched.

An object without a source is merged if it lies within BLEND_ARCSEC (of larger sources: their half-light radius) of a
source that is matched with a brighter object; otherwise it is lost. A source without an object is a second one if an
object within reach has another; otherwise it is false.
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
SHIFT = 10.0  # arcsec, of the catalogue: its matches are by chance
PAIRS_MIN = 5  # pairs for a zero point


@dataclass(frozen=True)
class Match:
    """The match of n objects with m sources.

    source_row (n,): row of each object's source, or -1; merged (n,): objects without one, in the source of a brighter
    object; second (m,): further sources of an object that has one; zero_point: of the catalogue [mag].
    """

    source_row: IntArray
    merged: BoolArray
    second: BoolArray
    zero_point: float

    @property
    def found(self) -> BoolArray:
        """(n,) objects that have a source."""
        return self.source_row >= 0

    def real(self, count: int) -> BoolArray:
        """Return (count,): sources that are matched with an object."""
        mask = np.zeros(count, bool)
        mask[self.source_row[self.found]] = True
        return mask


class _Pairs(NamedTuple):
    """Pairs (n,): rows of the object and of the source, and their distance [arcsec]."""

    object: IntArray
    source: IntArray
    distance: FloatArray

    def take(self, selected: BoolArray | IntArray) -> _Pairs:
        """Return some of the pairs, by mask or row."""
        return _Pairs(self.object[selected], self.source[selected], self.distance[selected])


def match_sources(
    truth: Mapping[str, AnyArray],
    sources: Catalogue | Mapping[str, AnyArray],
    band: str | None = None,
    radius: float = RADIUS,
) -> Match:
    """Return the Match of true objects and sources, mappings with ra, dec [deg]; truth also has size [arcsec].

    band: of the magnitudes mag_B that are compared; None: positions alone. radius: minimum reach [arcsec].
    """
    object_vectors = unit_vectors(truth["ra"], truth["dec"]).reshape(-1, 3)
    source_vectors = unit_vectors(sources["ra"], sources["dec"]).reshape(-1, 3)
    reach = np.maximum(radius, 0.5 * np.nan_to_num(np.asarray(truth["size"], float)))
    pairs = _pairs(object_vectors, source_vectors, reach)
    zero_point = 0.0
    cost = (pairs.distance / reach[pairs.object]) ** 2
    if band and len(cost):
        source_mag, true_mag = (np.asarray(table[f"mag_{band}"], float) for table in (sources, truth))
        difference = source_mag[pairs.source] - true_mag[pairs.object]
        zero_point = _zero_point(pairs, difference)
        difference = np.abs(difference - zero_point)
        known = np.isfinite(difference)
        cost = cost + np.where(known, difference / MAG_SPREAD, 0.0) ** 2
        near = ~known | (difference <= MAG_REACH)
        pairs = pairs.take(near)
        cost = cost[near]
    pairs = pairs.take(np.lexsort((pairs.source, pairs.object, cost)))
    source_row = np.full(len(object_vectors), -1)
    chosen = greedy_match(pairs.object, pairs.source)
    source_row[pairs.object[chosen]] = pairs.source[chosen]
    merged = _find_merged(object_vectors, source_vectors, truth, source_row, band)
    return Match(source_row, merged, _find_second(source_row, pairs, len(source_vectors)), zero_point)


def _zero_point(pairs: _Pairs, difference: FloatArray) -> float:
    """Return the median of the magnitude differences of pairs that are the closest of both members.

    difference (n,): of each pair. Returns 0 if fewer than PAIRS_MIN are known.
    """
    order = np.lexsort((pairs.source, pairs.object, pairs.distance))
    order = order[greedy_match(pairs.object[order], pairs.source[order])]
    closest = difference[order]
    closest = closest[np.isfinite(closest)]
    return float(np.median(closest)) if len(closest) >= PAIRS_MIN else 0.0


def _pairs(objects: FloatArray, sources: FloatArray, reach: FloatArray) -> _Pairs:
    """Return all pairs of unit vectors (n, 3) and (m, 3) within the objects' reach (n,) [arcsec]."""
    from scipy.spatial import cKDTree

    if not len(objects) or not len(sources):
        return _Pairs(np.zeros(0, int), np.zeros(0, int), np.zeros(0))
    neighbours = cKDTree(sources).query_ball_point(objects, _chord(reach))
    in_objects = np.repeat(np.arange(len(objects)), [len(rows) for rows in neighbours])
    in_sources = np.concatenate([np.zeros(0, int), *filter(None, neighbours)]).astype(int)
    chord = np.linalg.norm(objects[in_objects] - sources[in_sources], axis=1)
    return _Pairs(in_objects, in_sources, np.degrees(2 * np.arcsin(np.minimum(chord / 2, 1.0))) * 3600.0)


def _chord(arcsec: FloatArray) -> FloatArray:
    return 2 * np.sin(np.radians(np.asarray(arcsec) / 3600.0) / 2)


def _find_merged(
    objects: FloatArray, sources: FloatArray, truth: Mapping[str, AnyArray], source_row: IntArray, band: str | None
) -> BoolArray:
    """Return (n,): objects without a source that lie in the source of a brighter object."""
    from scipy.spatial import cKDTree

    merged = np.zeros(len(source_row), bool)
    unmatched = np.flatnonzero(source_row < 0)
    matched = np.flatnonzero(source_row >= 0)
    if not len(unmatched) or not len(matched):
        return merged
    radius = np.maximum(BLEND_ARCSEC, np.nan_to_num(np.asarray(truth["size"], float))[matched])
    mag = brightness(truth, band)
    neighbours = cKDTree(objects[unmatched]).query_ball_point(sources[source_row[matched]], _chord(radius))
    for bright, rows in zip(matched, neighbours, strict=True):
        hidden = unmatched[rows]
        merged[hidden[mag[hidden] >= mag[bright]]] = True
    return merged


def brightness(truth: Mapping[str, AnyArray], band: str | None = None) -> FloatArray:
    """Return (n,) magnitudes in a band, or where that is unknown, in the band in which the object is brightest."""
    mags = [np.nan_to_num(np.asarray(truth[n], float), nan=np.inf) for n in truth if n.startswith("mag_")]
    brightest = np.min(mags, axis=0) if mags else np.full(len(truth["ra"]), np.inf)
    if band:
        mag = np.asarray(truth[f"mag_{band}"], float)
        return np.where(np.isfinite(mag), mag, brightest)
    return brightest


def _find_second(source_row: IntArray, pairs: _Pairs, count: int) -> BoolArray:
    """Return (count,): sources without an object, within reach of an object that has another source."""
    mask = np.zeros(count, bool)
    mask[pairs.source[source_row[pairs.object] >= 0]] = True
    mask[source_row[source_row >= 0]] = False
    return mask


def chance_matches(
    truth: Mapping[str, AnyArray],
    sources: Catalogue | Mapping[str, AnyArray],
    covers: Callable[[FloatArray, FloatArray], BoolArray],
    band: str | None = None,
    radius: float = RADIUS,
) -> tuple[float, int]:
    """Return (fraction, n) of the n sources, moved by SHIFT in four directions and still in the field, with an object.

    covers: function of ra, dec [deg] that returns which positions are in the field.
    """
    matches = total = 0
    for east, north in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        ra, dec = moved(sources["ra"], sources["dec"], east * SHIFT, north * SHIFT)
        covered = covers(ra, dec)
        columns = {"ra": ra[covered], "dec": dec[covered]}
        if band:
            columns[f"mag_{band}"] = np.asarray(sources[f"mag_{band}"])[covered]
        matches += int(match_sources(truth, columns, band, radius).found.sum())
        total += int(covered.sum())
    return (matches / total if total else np.nan), total


def moved(ra: FloatArray, dec: FloatArray, east: float, north: float) -> tuple[FloatArray, FloatArray]:
    """Return ra, dec [deg] of positions moved by east, north [arcsec] on their tangent planes, also at the poles."""
    from csstsim.base.sphere import frames, normalised

    position, to_east, to_north = frames(np.radians(ra), np.radians(dec))
    east, north = np.radians(np.array([east, north]) / 3600.0)
    return ra_dec(normalised(position + east * to_east + north * to_north))
