"""The merged catalogue: false, lost and duplicate sources."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

from csstsim.measure.bricks.validation.gates.record import SIGMAS, AtLeast, FractionAtMost, Measured

if TYPE_CHECKING:
    from csstsim.measure.bricks.validation.gates.data import BrickData


def _number_counts(band: Mapping[str, Any]) -> list[Measured]:
    return [Measured(band["counts"]["excess"], band["counts"]["n"])]


def _purity(data: BrickData) -> list[Measured]:
    return [Measured(data.purity, data.sources)]


def _lost(data: BrickData, kind: str) -> list[Measured]:
    return [Measured(*data.lost[kind])]


def _duplicates(data: BrickData) -> list[Measured]:
    return [Measured(*data.duplicates)]


GATES = (
    FractionAtMost(
        "number counts, out / in - 1",
        scope="band",
        threshold="counts_max",
        tests="isolated true objects of S/N above 20 in an exposure that have a source in the band, plus false sources "
        "of that S/N, divided by the number of objects, minus 1",
        measure=_number_counts,
        sigmas=SIGMAS,
    ),
    AtLeast(
        "purity",
        scope="brick",
        threshold="purity_min",
        tests='merged sources with a true object within 0.2" (a galaxy: half its half-light radius)',
        measure=_purity,
        sigmas=SIGMAS,
    ),
    *(
        FractionAtMost(
            f"{kind} found in an exposure, lost in the merge",
            scope="brick",
            threshold="lost_max",
            tests=f"isolated {kind} of S/N 20 to 500 that are found in an exposure without a flag of doubt, but are "
            "missing from the merged catalogue",
            measure=partial(_lost, kind=kind),
            sigmas=SIGMAS,
        )
        for kind in ("stars", "galaxies")
    ),
    FractionAtMost(
        "sources counted twice",
        scope="brick",
        threshold="twice_max",
        tests="surplus sources within the match radius of isolated objects, divided by the number of these objects",
        measure=_duplicates,
        sigmas=SIGMAS,
    ),
)
