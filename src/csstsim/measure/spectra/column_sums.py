"""Electrons of each column of a cutout: box sums and optimal weights (Horne 1986, PASP 98, 609).

With d the electrons of a pixel minus those of other objects and the sky (measure.spectra.local_sky), P the fraction of
the object's flux in the pixel, V its variance and W a weight,

    e(X) = sum W d / sum W P,     W = overlap with the aperture (box),  W = P / V (optimal)

over the usable pixels. V has the electrons of the columns around (`_signal`), and is at least FLOOR, for frames with
less noise or none. The denominator is the aperture correction: it scales e to the total flux, whatever is missing
(edges, defects). Pixels that deviate more than REJECT sigma from the fit are removed one by one (cosmic rays).
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
REJECT = 5.0  # sigma
PROFILE_ERROR = 0.1  # relative error of the profile
ROUNDS = 20
AROUND = 8  # columns on either side, whose electrons give a column's variance
LINE = 3.0  # sigma
FLOOR = 1.0  # electron^2: minimum variance of a pixel, about that of one DN
USABLE_FRACTION_MIN = 0.5  # of the aperture's flux in usable pixels; with less there is no result


class Weights(NamedTuple):
    """The weight (n, rows) of each pixel in the electrons of its column, and its `offset` [px] from the trace."""

    weight: FloatArray
    offset: FloatArray


class _Sums(NamedTuple):
    """Sums over the pixels of each column (n,): of the weights W times P, d, others, and W V, and of the weights."""

    fraction: FloatArray
    data: FloatArray
    others: FloatArray
    noise: FloatArray
    weight: FloatArray


def summed_columns(
    cutout: Cutout, fractions: FloatArray, half: float, read_noise: float
) -> tuple[dict[str, AnyArray], Weights]:
    """Return ({name: (n,)}, Weights): electrons, box, their errors, contamination (NaN: not known), sky, flags.

    cutout: cutout.Cutout; fractions: of the object's flux in each of its pixels; half: half the aperture [px];
    read_noise: electron.
    """
    strips = Strips.of(cutout.data, (cutout.status & GOOD) > 0, cutout.offset, fractions, half + GAP, STRIP)
    known = cutout.others is not None
    cutout, fractions = cutout.within(half, fractions)
    overlap = _overlap(cutout.offset, half)
    used = (cutout.status & GOOD) > 0
    others = np.zeros_like(cutout.data) if cutout.others is None else cutout.others
    enough = USABLE_FRACTION_MIN * _flux_fraction(overlap, fractions, np.ones_like(used))
    known_columns = _flux_fraction(overlap, fractions, used) >= enough
    sky = strips.sky_without_object(cutout.data, used, fractions, overlap, known_columns)
    data = cutout.data - sky.level[:, None]
    level = sky.level
    used = used & (overlap > 0)
    variance = np.ones_like(data)
    _reject_outliers(data, fractions, used, variance, level, others, cutout.response, float(read_noise))
    lost = ~(_flux_fraction(overlap, fractions, used) >= enough) | ~np.isfinite(level)
    out: dict[str, AnyArray] = {
        "sky": level,
        "flags": _flags(cutout.status, overlap > 0, used) | np.where(lost, LOST, 0),
    }
    for name in ("electrons", "box"):
        sums = _sums(overlap, fractions, used, variance, data, others, name == "electrons")
        total = np.where(lost | ~(sums.fraction > 0), np.nan, sums.fraction)
        out[name] = sums.data / total
        noise = np.sqrt(sums.noise + sums.weight**2 * sky.variance)
        out[f"{name}_err"] = noise / (total - sums.weight * sky.fraction)
        if name == "electrons":
            weights = Weights(_weights(fractions, used, variance, total), cutout.offset)
            out["contamination"] = sums.others / total if known else np.full(len(total), np.nan)
    contaminated = np.abs(out["contamination"]) > CONTAMINATED_FROM * np.abs(out["electrons"])
    out["flags"] |= np.where(contaminated, CONTAMINATED, 0)
    return out, weights


@numba.njit(cache=True)
def _overlap(offset: FloatArray, half: float) -> FloatArray:
    """Return (n, rows): the fraction of each pixel within `half` of the trace."""
    out = np.empty(offset.shape)
    for i in range(offset.shape[0]):
        for j in range(offset.shape[1]):
            inside = min(offset[i, j] + 0.5, half) - max(offset[i, j] - 0.5, -half)
            out[i, j] = min(max(inside, 0.0), 1.0)
    return out


@numba.njit(cache=True)
def _flux_fraction(overlap: FloatArray, fractions: FloatArray, usable: BoolArray) -> FloatArray:
    """Return (n,): the fraction of the object's flux in the `usable` pixels of the aperture."""
    out = np.zeros(len(overlap))
    for i in range(overlap.shape[0]):
        for j in range(overlap.shape[1]):
            if usable[i, j]:
                out[i] += overlap[i, j] * fractions[i, j]
    return out


@numba.njit(cache=True)
def _reject_outliers(
    data: FloatArray,
    fractions: FloatArray,
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
    fits = np.zeros(n)
    errors = np.zeros(n)
    for _ in range(ROUNDS):
        rejected = 0
        for _ in range(2):  # the variance follows the fits
            for i in range(n):
                fits[i], errors[i] = _fit(data[i], fractions[i], used[i], variance[i])
            for i in range(n):
                signal = max(_signal(fits, errors, i), 0.0)
                for j in range(rows):
                    if used[i, j]:
                        variance[i, j] = base[i, j] + signal * fractions[i, j] / response[i, j]
        for i in range(n):
            fit = fits[i]
            worst = -1
            excess_max = 1.0
            for j in range(rows):
                if used[i, j]:
                    flux = max(fit, 0.0) * fractions[i, j]
                    allowed = REJECT**2 * (variance[i, j] + (PROFILE_ERROR * flux) ** 2)
                    excess = (data[i, j] - fit * fractions[i, j]) ** 2 / allowed
                    if excess > excess_max:
                        worst = j
                        excess_max = excess
            if worst >= 0:
                used[i, worst] = False
                rejected += 1
        if not rejected:
            break


@numba.njit(cache=True)
def _fit(data: FloatArray, fractions: FloatArray, used: BoolArray, variance: FloatArray) -> tuple[float, float]:
    """Return the electrons of a column that fit its used pixels best, and their error; 0, 0 without used pixels."""
    norm = 0.0
    total = 0.0
    for j in range(len(data)):
        if used[j]:
            weight = fractions[j] / variance[j]
            norm += weight * fractions[j]
            total += weight * data[j]
    if norm <= 0:
        return 0.0, 0.0
    return total / norm, 1 / np.sqrt(norm)


@numba.njit(cache=True)
def _signal(fits: FloatArray, errors: FloatArray, i: int) -> float:
    """Return the electrons of column i in its variance: the median fit of the columns around, without its own.

    With its own noise in its variance, a column that is too bright would weigh less: means of columns weighted by their
    errors would be low, by an electron a column on a sky of 35. In a line, the mean of the two columns beside it counts
    if it is LINE sigma from the median, and its own fit if that is LINE sigma from this.
    """
    around = np.empty(2 * AROUND)  # in rising order
    count = 0
    for k in range(max(i - AROUND, 0), min(i + AROUND + 1, len(fits))):
        if k != i and errors[k] > 0:
            rank = count
            while rank > 0 and around[rank - 1] > fits[k]:
                around[rank] = around[rank - 1]
                rank -= 1
            around[rank] = fits[k]
            count += 1
    if not count:
        return fits[i]
    signal = 0.5 * (around[(count - 1) // 2] + around[count // 2])
    noise = 0.0
    if 0 < i < len(fits) - 1 and errors[i - 1] > 0 and errors[i + 1] > 0:
        beside = 0.5 * (fits[i - 1] + fits[i + 1])
        error = 0.5 * np.hypot(errors[i - 1], errors[i + 1])
        if abs(beside - signal) > LINE * error:
            signal = beside
            noise = error
    return fits[i] if abs(fits[i] - signal) > LINE * np.hypot(errors[i], noise) else signal


@numba.njit(cache=True)
def _sums(
    overlap: FloatArray,
    fractions: FloatArray,
    used: BoolArray,
    variance: FloatArray,
    data: FloatArray,
    others: FloatArray,
    optimal: bool,
) -> _Sums:
    """Return the _Sums with optimal weights, or with the overlap as weight."""
    n = len(data)
    sums = _Sums(np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n))
    for i in range(data.shape[0]):
        for j in range(data.shape[1]):
            if used[i, j]:
                weight = fractions[i, j] / variance[i, j] if optimal else overlap[i, j]
                sums.fraction[i] += weight * fractions[i, j]
                sums.data[i] += weight * data[i, j]
                sums.others[i] += weight * others[i, j]
                sums.noise[i] += weight**2 * variance[i, j]
                sums.weight[i] += weight
    return sums


@numba.njit(cache=True)
def _weights(fractions: FloatArray, used: BoolArray, variance: FloatArray, total: FloatArray) -> FloatArray:
    """Return (n, rows): the optimal weight of each pixel in the electrons of its column; 0 where they are not known."""
    out = np.zeros(fractions.shape)
    for i in range(len(fractions)):
        for j in range(fractions.shape[1]):
            if used[i, j] and total[i] > 0:
                out[i, j] = fractions[i, j] / variance[i, j] / total[i]
    return out


@numba.njit(cache=True)
def _flags(status: IntArray, within: BoolArray, used: BoolArray) -> IntArray:
    """Return (n,): the flags of columns from the status of their pixels `within` the aperture."""
    out = np.zeros(len(status), np.int64)
    for i in range(status.shape[0]):
        for j in range(status.shape[1]):
            if not within[i, j]:
                continue
            bits = status[i, j]
            if not bits & INSIDE:
                out[i] |= EDGE
            elif bits & FULL:
                out[i] |= SATURATED
            elif not bits & GOOD:
                out[i] |= MASKED
            elif not used[i, j]:
                out[i] |= COSMIC
    return out
