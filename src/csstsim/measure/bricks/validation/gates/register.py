"""All gates: the families in the order of their gates in the products, and how the gates of a scope are evaluated."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from csstsim.measure.bricks.validation.gates import (
    astrometry,
    completeness,
    counts,
    galaxy_photometry,
    headers,
    merging,
    pixels,
    shapes,
    spectra,
    star_photometry,
    twin_shear,
)

if TYPE_CHECKING:
    from csstsim.campaign.thresholds import ValidateConfig
    from csstsim.measure.bricks.validation.gates.record import Gate, GateResult, Scope

FAMILIES = [
    counts,
    galaxy_photometry,
    completeness,
    star_photometry,
    astrometry,
    shapes,
    spectra,
    pixels,
    headers,
    merging,
    twin_shear,
]


def all_gates() -> list[Gate]:
    """Return the records of all families."""
    return [gate for family in FAMILIES for gate in family.GATES]


def gate_named(name: str) -> Gate:
    """Return the record of a gate by its printed name. Raises KeyError if there is none."""
    for gate in all_gates():
        if gate.name == name:
            return gate
    raise KeyError(name)


def evaluate(scope: Scope, data: Any, thresholds: ValidateConfig, band: str, **where: Any) -> list[GateResult]:
    """Return the results of the gates of a scope.

    data: as the scope states; band: as the results name it; where: {exposure, chip} of a frame.
    """
    return [
        result
        for gate in all_gates()
        if gate.scope == scope
        for result in gate.evaluate(data, thresholds, band, **where)
    ]


def of_exposures(results: Iterable[GateResult]) -> list[GateResult]:
    """Return all failing results of single exposures; for a name and band without any, the one closest to failing.

    If no result of a name and band was evaluated, the one with the most sources is returned.
    """
    groups: dict[tuple[str, str], list[GateResult]] = {}
    for result in results:
        groups.setdefault((result["name"], result["band"]), []).append(result)
    out = []
    for group in groups.values():
        failing = [result for result in group if result["passed"] is False]
        passing = [result for result in group if result["passed"]]
        if failing or passing:
            out += failing or [max(passing, key=lambda result: result["margin"])]
        else:
            out.append(max(group, key=lambda result: result["n"] or 0))
    return out
