"""Electrons of each column of a cutout: box sums and optimal weights (Horne 1986, PASP 98, 609).

With d the electrons of a pixel less those of others and the sky (measure.spectra.local_sky), P the share of the
object's light there, V its variance and W a weight,

    e(X) = sum W d / sum W P,     W = overlap with the aperture (box),  W = P / V (optimal)

over the usable pixels. V is at least FLOOR, where a frame has less noise or none. The denominator is the aperture
correction: it scales e to all of the light, whatever is missing (edges, defects). Pixels that are more than REJECT
sigma off the fit are removed one by one (cosmic rays).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numba
import numpy as np

from csstsim.base.types import AnyArray, BoolArray, FloatArray, IntArray
from csstsim.measure.calibration.bad_pixels import FULL
from csstsim.measure.spectra.cutout import GOOD, INSIDE
from csstsim.measure.spectra.local_sky import Strips
from csstsim.measure.spectra.spectrum_columns import CONTAMINATED, COSMIC, EDGE, LOST, MASKED, SATURATED

if TYPE_CHECKING:
    from csstsim.measure.spectra.cutout import Cutout

# px: from the aperture to a strip of sky, and its width
GAP = 4.0
STRIP = 16.0
CONTAMINATED_FROM = 0.1  # of the electrons
# sigma; share by which the profile may be wrong
REJECT = 5.0
PROFILE_ERROR = 0.1
ROUNDS = 20
FLOOR = 1.0  # electron^2: least variance of a pixel, about that of one DN
WHOLE = 0.5  # of the aperture's light in usable pixels; with less there is no result
_LIGHT, _DATA, _OTHERS, _NOISE, _WEIGHT = range(5)


class Weights(NamedTuple):
    """How pixels (n, rows) make the electrons of columns: `each`, and `offset` [px] from the trace."""

    each: FloatArray
    offset: FloatArray


def measured(cutout: Cutout, shares: FloatArray, half: float, read_noise: float) -> tuple[dict[str, AnyArray], Weights]:
    """Return ({name: (n,)}, Weights): electrons, box, their errors, contamination (NaN: not known), sky, flags.

    cutout: cutout.Cutout; shares: of the object's light in each of its pixels; half: of the aperture [px]; read_noise:
    electron.
    """
    strips = Strips.of(cutout.data, (cutout.seen & GOOD) > 0, cutout.offset, shares, half + GAP, STRIP)
    known = cutout.others is not None
    cutout, shares = cutout.within(half, shares)
    overlap = _overlap(cutout.offset, half)
    used = (cutout.seen & GOOD) > 0
    others = np.zeros_like(cutout.data) if cutout.others is None else cutout.others
    enough = WHOLE * _light(overlap, shares, np.ones_like(used))
    sky = strips.sky_less_own(cutout.data, used, shares, overlap, _light(overlap, shares, used) >= enough)
    data = cutout.data - sky.level[:, None]
    level = sky.level
    used = used & (overlap > 0)
    variance = np.ones_like(data)
    _horne(data, shares, used, variance, level, others, cutout.response, float(read_noise))
    lost = ~(_light(overlap, shares, used) >= enough) | ~np.isfinite(level)
    out: dict[str, AnyArray] = {"sky": level, "flags": _flags(cutout.seen, overlap > 0, used) | np.where(lost, LOST, 0)}
    for name in ("electrons", "box"):
        sums = _sums(overlap, shares, used, variance, data, others, name == "electrons")
        total = np.where(lost | ~(sums[_LIGHT] > 0), np.nan, sums[_LIGHT])
        weight = sums[_WEIGHT]
        out[name] = sums[_DATA] / total
        out[f"{name}_err"] = np.sqrt(sums[_NOISE] + weight**2 * sky.variance) / (total - weight * sky.own)
        if name == "electrons":
            weights = Weights(_weights(shares, used, variance, total), cutout.offset)
            out["contamination"] = sums[_OTHERS] / total if known else np.full(len(total), np.nan)
    much = np.abs(out["contamination"]) > CONTAMINATED_FROM * np.abs(out["electrons"])
    out["flags"] |= np.where(much, CONTAMINATED, 0)
    return out, weights


@numba.njit(cache=True)
def _overlap(offset: FloatArray, half: float) -> FloatArray:
    """Return the share of each pixel within `half` of the trace."""
    out = np.empty(offset.shape)
    for i in range(offset.shape[0]):
        for j in range(offset.shape[1]):
            inside = min(offset[i, j] + 0.5, half) - max(offset[i, j] - 0.5, -half)
            out[i, j] = min(max(inside, 0.0), 1.0)
    return out


@numba.njit(cache=True)
def _light(overlap: FloatArray, shares: FloatArray, kept: BoolArray) -> FloatArray:
    """Return (n,): the share of the object's light in the aperture's pixels that are `kept`."""
    out = np.zeros(len(overlap))
    for i in range(overlap.shape[0]):
        for j in range(overlap.shape[1]):
            if kept[i, j]:
                out[i] += overlap[i, j] * shares[i, j]
    return out


@numba.njit(cache=True)
def _horne(
    data: FloatArray,
    shares: FloatArray,
    used: BoolArray,
    variance: FloatArray,
    level: FloatArray,
    others: FloatArray,
    response: FloatArray,
    read_noise: float,
) -> None:
    """Fit all columns; each round takes at most one outlier per column from `used`. Fills `variance` where used."""
    n, rows = data.shape
    base = np.ones_like(data)
    for i in range(n):
        for j in range(rows):
            if used[i, j]:
                flat = response[i, j]
                base[i, j] = max((max(level[i] + others[i, j], 0.0) + read_noise**2 / flat) / flat, FLOOR)
                variance[i, j] = base[i, j]
    for _ in range(ROUNDS):
        found = 0
        for i in range(n):
            fit = 0.0
            for _ in range(2):  # the variance follows the fit
                fit = _fitted(data[i], shares[i], used[i], variance[i])
                for j in range(rows):
                    if used[i, j]:
                        variance[i, j] = base[i, j] + max(fit, 0.0) * shares[i, j] / response[i, j]
            worst = -1
            most = 1.0
            for j in range(rows):
                if used[i, j]:
                    light = max(fit, 0.0) * shares[i, j]
                    allowed = REJECT**2 * (variance[i, j] + (PROFILE_ERROR * light) ** 2)
                    off = (data[i, j] - fit * shares[i, j]) ** 2 / allowed
                    if off > most:
                        worst = j
                        most = off
            if worst >= 0:
                used[i, worst] = False
                found += 1
        if not found:
            break


@numba.njit(cache=True)
def _fitted(data: FloatArray, shares: FloatArray, used: BoolArray, variance: FloatArray) -> float:
    """Return the electrons of a column that fit its used pixels best; 0 without any."""
    norm = 0.0
    total = 0.0
    for j in range(len(data)):
        if used[j]:
            weight = shares[j] / variance[j]
            norm += weight * shares[j]
            total += weight * data[j]
    return total / norm if norm > 0 else 0.0


@numba.njit(cache=True)
def _sums(
    overlap: FloatArray,
    shares: FloatArray,
    used: BoolArray,
    variance: FloatArray,
    data: FloatArray,
    others: FloatArray,
    optimal: bool,
) -> FloatArray:
    """Return (5, n): the sums of a column's weights with shares, data, others and variance, and of the weights."""
    out = np.zeros((5, len(data)))
    for i in range(data.shape[0]):
        for j in range(data.shape[1]):
            if used[i, j]:
                weight = shares[i, j] / variance[i, j] if optimal else overlap[i, j]
                out[_LIGHT, i] += weight * shares[i, j]
                out[_DATA, i] += weight * data[i, j]
                out[_OTHERS, i] += weight * others[i, j]
                out[_NOISE, i] += weight**2 * variance[i, j]
                out[_WEIGHT, i] += weight
    return out


@numba.njit(cache=True)
def _weights(shares: FloatArray, used: BoolArray, variance: FloatArray, total: FloatArray) -> FloatArray:
    """Return (n, rows): by how much a column's electrons rise with those of a pixel, optimal; 0 where not known."""
    out = np.zeros(shares.shape)
    for i in range(len(shares)):
        for j in range(shares.shape[1]):
            if used[i, j] and total[i] > 0:
                out[i, j] = shares[i, j] / variance[i, j] / total[i]
    return out


@numba.njit(cache=True)
def _flags(seen: IntArray, within: BoolArray, used: BoolArray) -> IntArray:
    """Return (n,) the bits that the pixels `within` the aperture give their column."""
    out = np.zeros(len(seen), np.int64)
    for i in range(seen.shape[0]):
        for j in range(seen.shape[1]):
            if not within[i, j]:
                continue
            bits = seen[i, j]
            if not bits & INSIDE:
                out[i] |= EDGE
            elif bits & FULL:
                out[i] |= SATURATED
            elif not bits & GOOD:
                out[i] |= MASKED
            elif not used[i, j]:
                out[i] |= COSMIC
    return out
