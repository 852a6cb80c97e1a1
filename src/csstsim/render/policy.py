"""Which method renders an object: the cheapest one whose predicted error is below `eps` of the object's own noise.

The methods and what each is for: render.imaging.register and render.slitless.register. The choice is deterministic: it
depends only on nominal electrons, the stored PSF and config/render.yaml. If no method is below `eps`, as for the
brightest objects, the cheapest method within three times the smallest error is taken. The column `error` of the truth
table has the predicted error.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from csstsim.render.method import NOT_RENDERED

if TYPE_CHECKING:
    from collections.abc import Sequence

    from csstsim.base.types import BoolArray, FloatArray, IntArray
    from csstsim.render.method import Method, SpectraMethod, Targets

_AS_GOOD = 3.0


@dataclass(frozen=True)
class Choice:
    """Method and predicted error of n objects."""

    method: IntArray  # (n,) int8, code of the method (render.method)
    error: FloatArray  # (n,) predicted, in units of the object's own noise
    snr: FloatArray  # (n,)
    allowed: FloatArray | None = None  # (n,) allowed error of a spectrum as a fraction of S/N, for dispersed light
    coarse: BoolArray | None = None  # (n,) whether the bins of Disperser.coarse are fine enough


def choose(targets: Targets, methods: Sequence[Method]) -> Choice:
    """Return the Choice among the methods of a register for n Targets.

    An object that a preferred method may render gets this method. Of methods with equal cost, the last is taken.
    """
    compared = [method for method in reversed(methods) if not method.preferred]
    errors = np.stack([method.error(targets) for method in compared], axis=1)
    costs = np.stack([method.cost(targets) for method in compared], axis=1)
    allowed = np.stack([method.allowed(targets) for method in compared], axis=1)
    smallest = np.where(allowed, errors, np.inf).min(axis=1)
    good = allowed & (errors <= np.maximum(targets.preset.eps, _AS_GOOD * smallest)[:, None])
    best = np.where(good, costs, np.inf).argmin(axis=1)
    code = np.array([method.code for method in compared], np.int8)[best]
    error: FloatArray = np.take_along_axis(errors, best[:, None], 1)[:, 0]
    for method in methods:
        if method.preferred:
            rows = method.allowed(targets)
            code[rows] = method.code
            error[rows] = method.error(targets)[rows]
    code[targets.electrons <= 0] = NOT_RENDERED
    return Choice(code, error, targets.snr)


def choose_dispersed(targets: Targets, methods: Sequence[SpectraMethod]) -> Choice:
    """Return the Choice for n Targets whose light is dispersed: as `choose`, with allowed errors and coarse bins."""
    choice = choose(targets, methods)
    coarse = np.zeros(len(targets), bool)
    for method in methods:
        coarse |= (choice.method == method.code) & method.coarse(targets)
    return replace(choice, allowed=targets.allowed_error, coarse=coarse)
