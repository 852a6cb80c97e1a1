"""Twin study: what one campaign measures of the same objects less what another does, object by object.

Objects are matched by their number in the truth, so intrinsic scatter cancels, and noise that both share cancels, too.
Errors of means are those of the differences' own scatter.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from csstsim.base.arrays.robust_sigma import SIGMA_PER_MAD
from csstsim.base.types import FloatArray
from csstsim.catalog.table import GALAXY
from csstsim.measure.bricks.validation.trials import RESOLVED, SHAPELESS, matched
from csstsim.measure.source_columns import SATURATED

if TYPE_CHECKING:
    from csstsim.catalog.table import ObjectTable
    from csstsim.measure.bricks.validation.measured_frame import MeasuredFrame

MIN_OBJECTS = 5  # for a mean
CLIP = 5.0  # robust sigmas: differences beyond are outliers
MAG_STEP = 1.0
SNR_COUNTED = 5.0  # S/N of the sources that are counted: below, most are noise
# {quantity: (its meaning, the kinds of objects that have it)}
QUANTITIES = {
    "mag": ("magnitude", ("star", "galaxy")),
    "x": ("position x [px]", ("star", "galaxy")),
    "y": ("position y [px]", ("star", "galaxy")),
    "size": ("ln size", ("star", "galaxy")),
    "e1": ("ellipticity e1", ("star", "galaxy")),
    "e2": ("ellipticity e2", ("star", "galaxy")),
    "g1": ("shape g1, corrected for the PSF", ("galaxy",)),
    "g2": ("shape g2, corrected for the PSF", ("galaxy",)),
    "spectrum": ("electrons of a spectrum, relative", ("spectrum",)),
}


@dataclass(frozen=True)
class Mean:
    """Mean of all n differences, its error, and their scatter.

    changed: how many differ at all; outliers: how many lie beyond CLIP robust sigmas of the median; clipped_mean,
    clipped_error: mean of the others and its error. Where an effect is local, most objects hardly differ, and the
    outliers are the effect itself: so `mean` includes them.
    """

    n: int
    mean: float
    error: float
    scatter: float
    changed: int
    outliers: int
    clipped_mean: float
    clipped_error: float


def mean(values: ArrayLike) -> Mean:
    """Return the Mean of differences, NaN left out; NaN of fewer than MIN_OBJECTS."""
    known = np.asarray(values, float)
    known = known[np.isfinite(known)]
    n = len(known)
    changed = int(np.count_nonzero(known))
    if n < MIN_OBJECTS:
        return Mean(n, np.nan, np.nan, np.nan, changed, 0, np.nan, np.nan)
    away = np.abs(known - np.median(known))
    # Not sigma_of_deviations: the order of the products decides which values are clipped
    clipped = known[away <= CLIP * SIGMA_PER_MAD * np.median(away)]  # at least half of all
    every, without_outliers = _moments(known), _moments(clipped)
    return Mean(
        n,
        every.mean,
        every.error,
        every.scatter,
        changed,
        n - len(clipped),
        without_outliers.mean,
        without_outliers.error,
    )


class _Moments(NamedTuple):
    mean: float
    error: float  # of the mean
    scatter: float


def _moments(values: FloatArray) -> _Moments:
    """Return the moments of two values or more."""
    scatter = float(values.std(ddof=1))
    return _Moments(float(values.mean()), scatter / len(values) ** 0.5, scatter)


def measured_objects(frame: MeasuredFrame, truth: ObjectTable) -> tuple[dict[int, dict[str, Any]], dict[str, int]]:
    """Return ({id: values}, counts) of the objects of a measured_frame.MeasuredFrame that are measured.

    truth: its measured_frame.truth_inside. values: {kind, true, mag, x, y, size, e1, e2, g1, g2}, NaN where flags
    exclude a value. counts: {"sources", "matched", "other"}, numbers of all sources of S/N above SNR_COUNTED, of those
    that belong to an object, and of the others.
    """
    measured = frame.measured
    row = matched(truth, frame.measured, frame.pixel) if len(truth) else np.zeros(0, int)
    rows = row[row >= 0]
    n, n_matched = (int((snr > SNR_COUNTED).sum()) for snr in (measured["snr"], measured["snr"][rows]))
    counts = {"sources": n, "matched": n_matched, "other": n - n_matched}
    truth = truth.take(row >= 0) if len(truth) else truth
    source = measured.take(rows)
    if not len(rows):
        return {}, counts
    galaxy = truth["obj_type"] == GALAXY
    flags = source["flags"]
    shaped = ((flags & SHAPELESS) == 0) & ~truth["blended"].astype(bool)
    resolved = shaped & galaxy & (source["resolution"] > RESOLVED)
    unsaturated = (flags & SATURATED) == 0
    with np.errstate(divide="ignore", invalid="ignore"):
        size = np.log(source["hsm_sigma"])
    values = {
        "mag": np.where(unsaturated, np.where(galaxy, source["mag_total"], source["mag_psf"]), np.nan),
        "x": np.where(unsaturated, source["x"], np.nan),
        "y": np.where(unsaturated, source["y"], np.nan),
        "size": np.where(shaped, size, np.nan),
        "e1": np.where(shaped, source["hsm_e1"], np.nan),
        "e2": np.where(shaped, source["hsm_e2"], np.nan),
        "g1": np.where(resolved, source["g1"], np.nan),
        "g2": np.where(resolved, source["g2"], np.nan),
    }
    true = truth[f"mag_{frame.band}"].astype(float)
    kind = np.where(galaxy, "galaxy", "star")
    found = {
        int(number): {"kind": str(kind[k]), "true": float(true[k])} | {name: float(v[k]) for name, v in values.items()}
        for k, number in enumerate(truth["id"])
    }
    return found, counts


def summed_spectra(table: ObjectTable) -> dict[int, dict[tuple[int, int], tuple[float, float]]]:
    """Return {id: values} of a table of first-order spectra (measure.spectra): electrons summed over good columns."""
    found: dict[int, dict[tuple[int, int], tuple[float, float]]] = {}
    good = np.isfinite(table["electrons"]) & np.isfinite(table["electrons_err"]) & (table["flags"] == 0)
    key = list(zip(table["id"].tolist(), table["order"].tolist(), table["column"].tolist(), strict=True))
    for k in np.flatnonzero(good):
        number, order, column = key[k]
        found.setdefault(number, {})[order, column] = float(table["electrons"][k]), float(table["electrons_err"][k])
    return found


def differences(
    first: Mapping[int, Mapping[str, Any]], other: Mapping[int, Mapping[str, Any]]
) -> dict[int, dict[str, Any]]:
    """Return {id: {kind, true, quantity: other - first}} of the objects that both frames have (`measured_objects`)."""
    return {
        number: {"kind": first[number]["kind"], "true": first[number]["true"]}
        | {name: other[number][name] - first[number][name] for name in QUANTITIES if name in first[number]}
        for number in sorted(first.keys() & other.keys())
    }


def spectral_differences(
    first: Mapping[int, Mapping[tuple[int, int], tuple[float, float]]],
    other: Mapping[int, Mapping[tuple[int, int], tuple[float, float]]],
) -> dict[int, dict[str, Any]]:
    """Return {id: {kind, true, spectrum}}: relative difference of electrons over the columns good in both.

    first, other: of `summed_spectra`; true: -2.5 lg of the electrons of the first, a magnitude without a zero point.
    """
    found = {}
    for number in sorted(first.keys() & other.keys()):
        columns = first[number].keys() & other[number].keys()
        total = sum(first[number][one][0] for one in columns)
        if columns and total > 0:
            change = sum(other[number][one][0] - first[number][one][0] for one in columns)
            found[number] = {"kind": "spectrum", "true": -2.5 * np.log10(total), "spectrum": change / total}
    return found


def summary(objects: Sequence[Mapping[str, Any]]) -> list[tuple[str, str, Mean]]:
    """Return [(kind, quantity, Mean)] of a list of differences."""
    rows = []
    for name, (_, kinds) in QUANTITIES.items():
        for kind in kinds:
            values = [one[name] for one in objects if one["kind"] == kind and name in one]
            if values:
                rows.append((kind, name, mean(values)))
    return rows


def values(objects: Iterable[Mapping[str, Any]], kind: str, name: str) -> FloatArray:
    """Return (true magnitudes, differences) of a quantity, of the objects of a kind that have it."""
    pairs = [(one["true"], one[name]) for one in objects if one["kind"] == kind and np.isfinite(one.get(name, np.nan))]
    return np.array(pairs, float).reshape(-1, 2).T


def binned(objects: Iterable[Mapping[str, Any]], kind: str, name: str) -> tuple[FloatArray, list[Mean]]:
    """Return (magnitudes, [Mean]) of a quantity's differences in bins of MAG_STEP; bins without a mean left out."""
    true, difference = values(objects, kind, name)
    bin_ = np.floor(np.nan_to_num(true, nan=np.inf) / MAG_STEP)
    bins = [(float(true[bin_ == k].mean()), mean(difference[bin_ == k])) for k in np.unique(bin_[np.isfinite(bin_)])]
    bins = [one for one in bins if np.isfinite(one[1].mean)]
    return np.array([one[0] for one in bins]), [one[1] for one in bins]
