"""Shear from twin campaigns (paper, section 5.3.1): the same galaxies under a known constant shear, as they are and
with their intrinsic shapes turned by 90 degrees. The mean of a galaxy's two shapes is the shear; shape noise cancels.

    mean shape = (1 + m) g + c

is fitted over campaigns of different g, for each component. m and c are those of the whole chain, from the universe to
the measured shapes, including the shape estimator's. A galaxy counts if it is found in both twins, isolated and
resolved: galaxies found in one orientation only would be selected by shape.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from csstsim.base.types import FloatArray
from csstsim.catalog.table import GALAXY
from csstsim.measure.bricks.validation.gates.register import evaluate
from csstsim.measure.bricks.validation.trials import RESOLVED, SHAPELESS, matched

if TYPE_CHECKING:
    from csstsim.campaign.thresholds import ValidateConfig
    from csstsim.catalog.table import ObjectTable
    from csstsim.measure.bricks.validation.gates.record import GateResult
    from csstsim.measure.bricks.validation.measured_frame import MeasuredFrame

SNR_MIN = 10.0
SHAPE_MAX = 1.5  # of a measured shape; longer ones are noise


def shapes(frame: MeasuredFrame, truth: ObjectTable) -> dict[int, FloatArray]:
    """Return {object id: (g1, g2)} of the unflagged, resolved, isolated galaxies of a measured_frame.MeasuredFrame.

    truth: its measured_frame.truth_inside.
    """
    truth = truth.take((truth["obj_type"] == GALAXY) & ~truth["blended"])
    measured = frame.measured
    row = matched(truth, frame.measured, frame.pixel)
    truth = truth.take(row >= 0)
    row = row[row >= 0]
    g = np.stack([measured["g1"][row], measured["g2"][row]], axis=1)
    good = (measured["snr"][row] > SNR_MIN) & (measured["resolution"][row] > RESOLVED)
    good &= ((measured["flags"][row] & SHAPELESS) == 0) & np.isfinite(g).all(axis=1) & (np.hypot(*g.T) < SHAPE_MAX)
    return dict(zip(truth["id"][good].tolist(), g[good], strict=True))


def pair_means(first: Iterable[Mapping[int, FloatArray]], second: Iterable[Mapping[int, FloatArray]]) -> FloatArray:
    """Return (n, 2): the mean shapes of the galaxies that two lists of `shapes`, one entry per frame, have in common.

    A galaxy in several frames counts once, with its mean, because its shape noise is the same in all.
    """
    means: dict[int, list[FloatArray]] = {}
    for a, b in zip(first, second, strict=True):
        for number in a.keys() & b.keys():
            means.setdefault(number, []).append(0.5 * (a[number] + b[number]))
    return np.array([np.mean(means[number], axis=0) for number in sorted(means)]).reshape(-1, 2)


def calibration(shears: Sequence[Sequence[float]], means: Sequence[FloatArray]) -> list[dict[str, Any]]:
    """Return [{component, m, m_err, c, c_err, n}] from (k, 2) input shears and k arrays (n, 2) of `pair_means`.

    m is None if all shears of a component are equal. Raises ValueError if a campaign has fewer than two galaxies.
    """
    if min(map(len, means)) < 2:
        raise ValueError("a pair of twins has fewer than two galaxies measured in both")
    out = []
    for axis in range(2):
        g = np.array([shear[axis] for shear in shears])
        y = np.array([values[:, axis].mean() for values in means])
        weight = np.array([len(values) / values[:, axis].var(ddof=1) for values in means])
        fit: dict[str, Any] = {"component": axis + 1, "m": None, "m_err": None, "n": sum(map(len, means))}
        if np.ptp(g) > 0:
            design = np.stack([g, np.ones(len(g))])
            covariance = np.linalg.inv(np.einsum("ik,jk,k->ij", design, design, weight))
            slope, offset = np.einsum("ij,jk,k,k->i", covariance, design, weight, y)
            m_err, c_err = np.sqrt(np.diag(covariance))
            fit |= {"m": float(slope - 1), "m_err": float(m_err), "c": float(offset), "c_err": float(c_err)}
        else:
            fit |= {"c": float(np.average(y - g, weights=weight)), "c_err": float(weight.sum() ** -0.5)}
        out.append(fit)
    return out


def shear_gates(fits: Sequence[Mapping[str, Any]], thresholds: ValidateConfig) -> list[GateResult]:
    """Return the results of the gates of m and c; they have neither error nor margin."""
    results = evaluate("twins", fits, thresholds, "all")
    return [{name: result[name] for name in result if name not in ("error", "margin")} for result in results]
