"""Positions for objects to be injected: on a grid, at random where the frame is free, or next to given objects.

x, y are pixels of the image, the first at 0. A table whose stars have `pmra`, `pmdec` and `parallax` needs no help: in
each frame of csstsim they stand where its epoch puts them. `later` moves them for frames of others.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.arrays.robust_sigma import robust_sigma
from csstsim.base.errors import InputError
from csstsim.base.sphere import frames, ra_dec
from csstsim.catalog.astrometry.reduction import moved

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import ArrayLike

    from csstsim.base.types import BoolArray, FloatArray, IntArray

# of a bright pixel; px kept free around it; px of the frame's border
SIGMA = 5.0
REACH = 8
EDGE = 10
_TRIES = 50
_SAMPLE = 1_000_000


def grid(shape: Sequence[int], spacing: float, edge: int = EDGE) -> tuple[FloatArray, FloatArray]:
    """Return x, y (n,) of a square grid in an image (ny, nx), row by row; spacing, edge [px]. Raises InputError."""
    if not 1 <= spacing < np.inf:
        raise InputError("no spacing of a grid", key="spacing", value=spacing, allowed="1 px or more")
    axes = []
    for length in shape[::-1]:
        room = length - 1 - 2 * edge
        if room < 0:
            raise InputError("the frame is all border", key="edge", value=edge)
        number = int(room // spacing)
        axes.append(edge + 0.5 * (room - number * spacing) + spacing * np.arange(number + 1))
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
    some = image.reshape(-1)[:: max(image.size // _SAMPLE, 1) | 1]
    some = some[np.isfinite(some)].astype(float)
    if not some.size:
        return np.zeros(image.shape, bool)
    middle = np.median(some)
    scatter = robust_sigma(some, middle)
    taken = ~(image <= middle + sigma * scatter)  # NaN, too
    if bad is not None:
        taken |= bad
    free = ~maximum_filter(taken, size=2 * reach + 1)
    inside = np.zeros(image.shape, bool)
    inside[edge : image.shape[0] - edge, edge : image.shape[1] - edge] = True
    return free & inside


def random(free: BoolArray, count: int, seed: int, apart: float = 0.0) -> FloatArray:
    """Return x, y (count,) at random in free pixels (ny, nx) bool, at least `apart` px from each other.

    Raises InputError if there is not enough room.
    """
    from scipy.spatial import cKDTree

    rng = np.random.default_rng(seed)
    pixels = np.flatnonzero(free)
    places = np.zeros((0, 2))
    for _ in range(_TRIES if pixels.size else 0):
        want = count - len(places)
        if want == 0:
            break
        row, column = np.divmod(rng.choice(pixels, want), free.shape[1])
        more = np.column_stack([column, row]) + rng.uniform(-0.5, 0.5, (want, 2))
        places = np.concatenate([places, more])
        if apart > 0 and len(places) > 1:
            close = cKDTree(places).query_pairs(apart, output_type="ndarray")
            places = np.delete(places, _later_of(close), axis=0)
    if len(places) < count:
        message = f"room for {len(places)} objects only, away from masked and bright places and from each other"
        raise InputError(message, key="count", value=count)
    return places.T


def _later_of(pairs: IntArray) -> list[int]:
    """Return the members to remove so that no pair is left: each pair's later one, if the first stays."""
    gone = set()
    for first, second in pairs[np.lexsort((pairs[:, 0], pairs[:, 1]))].tolist():
        if first not in gone:
            gone.add(second)
    return sorted(gone)


def beside(
    ra: Sequence[float] | FloatArray, dec: Sequence[float] | FloatArray, count: int, low: float, high: float, seed: int
) -> tuple[FloatArray, FloatArray]:
    """Return ra, dec (count,) [deg] at `low` to `high` arcsec from given objects, in turn, in any direction.

    Raises InputError for distances that are not possible, or no objects.
    """
    if not 0 <= low <= high < 3600:
        raise InputError("no distances", key="distance", value=(low, high), allowed="0 <= LOW <= HIGH < 3600 arcsec")
    if not len(ra):
        raise InputError("no objects to stand next to", key="beside")
    rng = np.random.default_rng(seed)
    to = np.arange(count) % len(ra)
    distance = np.radians(rng.uniform(low, high, count) / 3600)
    angle = rng.uniform(0, 2 * np.pi, count)
    star, east, north = frames(np.radians(np.asarray(ra, float)[to]), np.radians(np.asarray(dec, float)[to]))
    away = np.sin(angle)[:, None] * east + np.cos(angle)[:, None] * north
    return ra_dec(np.cos(distance)[:, None] * star + np.sin(distance)[:, None] * away)


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
    made = dict(columns)
    pmra = np.nan_to_num(np.asarray(columns.get("pmra", 0.0), float))
    pmdec = np.nan_to_num(np.asarray(columns.get("pmdec", 0.0), float))
    ra = np.asarray(columns["ra"], float)
    dec = np.asarray(columns["dec"], float)
    made["ra"], made["dec"] = moved(ra, dec, pmra, pmdec, years)
    return made
