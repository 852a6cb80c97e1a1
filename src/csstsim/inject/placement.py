"""Positions for objects to be injected: on a grid, at random on free pixels, or next to given objects.

x, y are pixels of the image, the first at 0. Stars with `pmra`, `pmdec` and `parallax` are rendered at the epoch of
each frame of csstsim. `later` moves them for frames of other telescopes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.arrays.robust_sigma import robust_sigma
from csstsim.base.errors import InputError
from csstsim.base.plural import number_of
from csstsim.base.sphere import frames, ra_dec
from csstsim.catalog.astrometry.reduction import moved

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import ArrayLike

    from csstsim.base.types import BoolArray, FloatArray, IntArray, PathLike

SIGMA = 5.0  # robust sigmas above the median: a bright pixel
REACH = 8  # px that are not free around a bad or bright one
EDGE = 10  # px of the frame's border
_TRIES = 50
_PAIRS = 1_000_000  # of objects that are too close, among those placed at once
_SAMPLE = 1_000_000


@dataclass(frozen=True)
class Placement:
    """How positions are chosen: on a grid, next to given objects, or at random on free pixels.

    Parameters
    ----------
    spacing : float, optional
        Distance of the points of a grid [pixel]. Without it and `near`, positions are random on free pixels.
    min_separation : float
        Minimum distance between random positions [pixel].
    near : str or Path, optional
        Table's file of objects next to which objects are placed.
    distance : (float, float)
        Minimum and maximum distance from the objects of `near` [arcsec].
    seed : int
        Of the random positions.
    """

    spacing: float | None = None
    min_separation: float = 0.0
    near: PathLike | None = None
    distance: tuple[float, float] = (0.5, 2.0)
    seed: int = 1


def grid(shape: Sequence[int], spacing: float, edge: int = EDGE) -> tuple[FloatArray, FloatArray]:
    """Return x, y (n,) of a square grid in an image (ny, nx), row by row; spacing, edge [px]. Raises InputError."""
    if not 1 <= spacing < np.inf:
        raise InputError("no spacing of a grid", key="spacing", value=spacing, allowed="1 px or more")
    axes = []
    for length in shape[::-1]:
        extent = length - 1 - 2 * edge
        if extent < 0:
            raise InputError("the frame is all border", key="edge", value=edge)
        steps = int(extent // spacing)
        axes.append(edge + 0.5 * (extent - steps * spacing) + spacing * np.arange(steps + 1))
    x, y = np.meshgrid(*axes)
    return x.ravel(), y.ravel()


def free_pixels(
    image: ArrayLike, bad: BoolArray | None = None, sigma: float = SIGMA, reach: int = REACH, edge: int = EDGE
) -> BoolArray:
    """Return (ny, nx) bool: pixels without a bad or bright one within `reach` px along rows and columns.

    bad: (ny, nx) bool, or None; bright: `sigma` times the robust scatter above the median.
    """
    from scipy.ndimage import maximum_filter

    image = np.asarray(image)
    sample = image.reshape(-1)[:: max(image.size // _SAMPLE, 1) | 1]
    sample = sample[np.isfinite(sample)].astype(float)
    if not sample.size:
        return np.zeros(image.shape, bool)
    median = np.median(sample)
    scatter = robust_sigma(sample, median)
    occupied = ~(image <= median + sigma * scatter)  # NaN, too
    if bad is not None:
        occupied |= bad
    free = ~maximum_filter(occupied, size=2 * reach + 1)
    inside = np.zeros(image.shape, bool)
    inside[edge : image.shape[0] - edge, edge : image.shape[1] - edge] = True
    return free & inside


def random_positions(free: BoolArray, count: int, seed: int, min_separation: float = 0.0) -> FloatArray:
    """Return x, y (count,) at random in free pixels (ny, nx) bool, at least `min_separation` px from each other.

    Raises InputError if fewer objects fit.
    """
    from scipy.spatial import cKDTree

    rng = np.random.default_rng(seed)
    pixels = np.flatnonzero(free)
    positions = np.zeros((0, 2))
    block = max(count, 1)
    if min_separation > 0:
        area = (free.shape[0] + min_separation) * (free.shape[1] + min_separation)
        densest = int(area / (math.sqrt(0.75) * min_separation**2))  # a hexagonal lattice
        if count > densest:
            message = f"objects this far from each other cannot all fit: {number_of(densest, 'object')} at most"
            raise InputError(message, key="min_separation", value=min_separation, allowed="less, or fewer objects")
        block = max(int(math.sqrt(2 * _PAIRS * area / math.pi) / min_separation), 1)
    for _ in range(_TRIES * -(-count // block) if pixels.size else 0):
        missing = min(count - len(positions), block)
        if missing == 0:
            break
        row, column = np.divmod(rng.choice(pixels, missing), free.shape[1])
        new = np.column_stack([column, row]) + rng.uniform(-0.5, 0.5, (missing, 2))
        positions = np.concatenate([positions, new])
        if min_separation > 0 and len(positions) > 1:
            close = cKDTree(positions).query_pairs(min_separation, output_type="ndarray")
            positions = np.delete(positions, _later_members(close), axis=0)
    if len(positions) < count:
        fitting = number_of(len(positions), "object fits", "objects fit")
        message = f"only {fitting}, away from masked and bright pixels and from each other"
        raise InputError(message, key="count", value=count)
    return positions.T


def _later_members(pairs: IntArray) -> list[int]:
    """Return the members to remove so that no pair is left: each pair's later one, if the first stays."""
    removed = set()
    for first, second in pairs[np.lexsort((pairs[:, 0], pairs[:, 1]))].tolist():
        if first not in removed:
            removed.add(second)
    return sorted(removed)


def near_objects(
    ra: Sequence[float] | FloatArray, dec: Sequence[float] | FloatArray, count: int, low: float, high: float, seed: int
) -> tuple[FloatArray, FloatArray]:
    """Return ra, dec (count,) [deg] at `low` to `high` arcsec from each given object in turn, in a random direction.

    Raises InputError for distances that are not possible, or no objects.
    """
    if not 0 <= low <= high < 3600:
        raise InputError("no distances", key="distance", value=(low, high), allowed="0 <= LOW <= HIGH < 3600 arcsec")
    if not len(ra):
        raise InputError("no objects in the table", key="--near")
    rng = np.random.default_rng(seed)
    chosen = np.arange(count) % len(ra)
    distance = np.radians(rng.uniform(low, high, count) / 3600)
    angle = rng.uniform(0, 2 * np.pi, count)
    towards, east, north = frames(np.radians(np.asarray(ra, float)[chosen]), np.radians(np.asarray(dec, float)[chosen]))
    direction = np.sin(angle)[:, None] * east + np.cos(angle)[:, None] * north
    return ra_dec(np.cos(distance)[:, None] * towards + np.sin(distance)[:, None] * direction)


def later(columns: Mapping[str, ArrayLike], years: float) -> dict[str, ArrayLike]:
    """Return a table at a later epoch: ra and dec moved by pmra and pmdec.

    Parameters
    ----------
    columns : mapping
        {name: (n,) values}: ra, dec [deg], and pmra, pmdec [mas / yr], 0 where missing.
    years : float
        Time [Julian yr], negative for an earlier epoch.

    Returns
    -------
    dict
        {name: (n,) values} with the new ra and dec [deg].
    """
    moved_columns = dict(columns)
    pmra = np.nan_to_num(np.asarray(columns.get("pmra", 0.0), float))
    pmdec = np.nan_to_num(np.asarray(columns.get("pmdec", 0.0), float))
    ra = np.asarray(columns["ra"], float)
    dec = np.asarray(columns["dec"], float)
    moved_columns["ra"], moved_columns["dec"] = moved(ra, dec, pmra, pmdec, years)
    return moved_columns
