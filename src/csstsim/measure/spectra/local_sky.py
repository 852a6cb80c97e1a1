"""Sky beside a spectrum: clipped means of a strip on either side of the trace, per block of columns.

The mean of the two sides is the level at the trace also if the sky slopes across it; between blocks it is linear. A
side with a usable share below USABLE (the window's edge, a saturated neighbour) is left out. The strips also contain
the object's own far light, so bright columns raise the sky of dim ones; `sky_less_own` corrects this.
"""

from dataclasses import dataclass

import numba
import numpy as np

BLOCK = 48  # columns
CLIP, ROUNDS = 4.0, 3  # robust sigma about the median
USABLE = 0.25
OWN_ROUNDS = 4  # the object's light in the strips is a few per cent; each round leaves a few per cent of it


@dataclass(frozen=True, eq=False)
class Sky:
    """By column, (n,): `level` electron / px, `variance` of it, `own` share of the object's light in a strip's px."""

    level: np.ndarray
    variance: np.ndarray
    own: np.ndarray


def local_sky(data, good, offset, share, inner, width):
    """Return the Sky of a cutout; NaN where no strip is usable.

    data (n columns, rows) electrons; good: bool; offset: rows from the trace [px]; share: of the object's light in each
    pixel; the strips are at |offset| from `inner` to `inner` + `width`.
    """
    n = len(data)
    edges = np.linspace(0, n, max(1, round(n / BLOCK)) + 1).astype(int)
    found = _by_block(data, good, offset, share, edges, float(inner), float(width))
    there = np.isfinite(found[0])
    if not there.any():
        return Sky(*np.full((3, n), np.nan))
    middle = 0.5 * (edges[1:] + edges[:-1] - 1)[there]
    return Sky(*(np.interp(np.arange(n), middle, values[there]) for values in found))


@numba.njit(cache=True)
def _by_block(data, good, offset, share, edges, inner, width):
    """Return (3, blocks): level, its variance and the object's share, means of the usable sides; NaN: none is."""
    out = np.full((3, len(edges) - 1), np.nan)
    size = (edges[1:] - edges[:-1]).max() * data.shape[1]
    values, own = np.empty(size), np.empty(size)
    for k in range(len(edges) - 1):
        total, sides = np.zeros(3), 0
        for side in (-1.0, 1.0):
            n = 0
            for i in range(edges[k], edges[k + 1]):
                for j in range(data.shape[1]):
                    if good[i, j] and inner <= side * offset[i, j] < inner + width:
                        values[n], own[n] = data[i, j], share[i, j]
                        n += 1
            if n >= max(USABLE * (edges[k + 1] - edges[k]) * width, 2):
                total += _clipped(values[:n], own[:n])
                sides += 1
        if sides:
            out[:, k] = total / sides
            out[1, k] /= sides  # of two strips' mean
    return out


@numba.njit(cache=True)
def _clipped(values, own):
    """Return (3,): mean of the values within CLIP robust sigma about their median, its variance, mean of their own."""
    kept = np.ones(len(values), np.bool_)
    for _ in range(ROUNDS):
        some = values[kept]
        centre = np.median(some)
        sigma = 1.4826 * np.median(np.abs(some - centre)) + 0.5  # at least about a DN of rounding
        before, kept = kept, np.abs(values - centre) <= CLIP * sigma
        if (kept == before).all():
            break
    some = values[kept]
    mean, n = some.sum() / len(some), len(some)
    return np.array([mean, ((some - mean) ** 2).sum() / n**2, own[kept].sum() / n])


def sky_less_own(data, good, offset, share, aperture, known, inner, width):
    """Return the Sky, as `local_sky`, without the light of the object itself in the strips.

    Each round measures the object's light with the weights `aperture` (shaped as data) and the sky so far, removes it
    from the strips and measures the sky again. known (n,): columns with such light; others are interpolated.
    """
    light, column = np.zeros(len(data)), np.arange(len(data))
    total = (aperture * share).sum(axis=1)[known]
    for _ in range(OWN_ROUNDS):
        sky = local_sky(data - light[:, None] * share, good, offset, share, inner, width)
        if known.any() and np.isfinite(sky.level).all():
            found = (aperture * (data - sky.level[:, None])).sum(axis=1)[known] / total
            light = np.interp(column, column[known], found)
    return sky
