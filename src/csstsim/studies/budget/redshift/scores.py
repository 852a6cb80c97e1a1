"""Fitted redshifts scored against the truth: completeness, purity, scatter and bias by properties of the object.

With dz = (z - z_true) / (1 + z_true), a redshift is right if |dz| < RIGHT. Completeness is the fraction of all objects
with a right redshift that the fitter flags as good, purity the fraction of right ones among the good.
sigma_NMAD is 1.48 times the median of |dz - median(dz)| of the good redshifts with |dz| < OUTLIER.
"""

from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np

from csstsim.base.arrays.robust_sigma import robust_sigma
from csstsim.base.types import AnyArray, BoolArray, FloatArray

RIGHT = 0.005
OUTLIER = 0.05  # |dz| from which on a redshift is an outlier, excluded from the scatter
CLASSES = {
    "magnitude": (18.0, 20.0, 21.0, 21.5, 22.0, 22.5, 23.0, 24.0),
    "redshift": (0.0, 0.2, 0.4, 0.6, 0.8, 1.0, 1.5, 3.0),
    "size": (0.0, 0.15, 0.25, 0.35, 0.5, 0.8, 3.0),
    "contamination": (0.0, 0.01, 0.1, 0.3, 1.0, np.inf),
}


def score(z: FloatArray, good: BoolArray, true: FloatArray) -> dict[str, Any]:
    """Return {objects, good, completeness, completeness_err, purity, purity_err, sigma, bias} of (n,) arrays."""
    dz = (z - true) / (1 + true)
    right = good & (np.abs(dz) < RIGHT)
    close = dz[good & (np.abs(dz) < OUTLIER)]
    sigma = float(robust_sigma(close)) if len(close) else np.nan
    result = {"objects": len(z), "good": int(good.sum()), "sigma": sigma}
    result["bias"] = float(np.median(close)) if len(close) else np.nan
    for name, total in (("completeness", len(z)), ("purity", int(good.sum()))):
        result[name], result[f"{name}_err"] = _fraction(int(right.sum()), total)
    return result


def _fraction(k: int, n: int) -> tuple[float, float]:
    """Return (k / n, its error by the rule of succession); NaN for n = 0."""
    if n == 0:
        return np.nan, np.nan
    p = (k + 1) / (n + 2)
    return k / n, float(np.sqrt(p * (1 - p) / (n + 3)))


def scores(answer: Mapping[int, tuple[float, bool]], objects: Mapping[str, AnyArray]) -> dict[str, Any]:
    """Return {"all": score, quantity of CLASSES: [{low, high, score}]}; objects without an answer count as not good.

    answer: {id: (z, good)}; objects: {"id", "z", "magnitude", "size", "contamination": (n,)}.
    """
    answers = [answer.get(int(k), (np.nan, False)) for k in objects["id"]]
    z = np.array([z for z, _ in answers], float)
    good = np.array([bool(is_good) for _, is_good in answers], bool)
    good &= np.isfinite(z)
    z = np.where(good, z, 0.0)
    true = np.asarray(objects["z"], float)
    result: dict[str, Any] = {"all": score(z, good, true)}
    for name, edges in CLASSES.items():
        values = np.asarray(objects["z" if name == "redshift" else name], float)
        result[name] = []
        for low, high in pairwise(edges):
            mask = (values >= low) & (values < high)
            if mask.any():
                result[name].append({"low": low, "high": high} | score(z[mask], good[mask], true[mask]))
    return result
