"""Shear of twin campaigns (`csstsim shear`)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

from csstsim.measure.bricks.validation.gates.record import AtMost, Measured

SIGMAS_OF_SHEAR = 5.0


def _of_fit(fits: Sequence[Mapping[str, Any]], name: str, component: int) -> list[Measured]:
    return [Measured(fit[name], fit["n"], fit[f"{name}_err"] or 0.0) for fit in fits if fit["component"] == component]


GATES = tuple(
    AtMost(
        f"shear {name}{component}",
        scope="twins",
        threshold=f"shear_{name}_max",
        tests=f"{name} of component {component} in (1 + m) g + c, fitted to the mean shapes of twins' galaxies",
        measure=partial(_of_fit, name=name, component=component),
        sigmas=SIGMAS_OF_SHEAR,
    )
    for component in (1, 2)
    for name in ("m", "c")
)
