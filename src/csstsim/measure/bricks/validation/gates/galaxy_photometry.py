"""Magnitudes and colours of galaxies in the merged catalogue."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from itertools import pairwise
from typing import Any

from csstsim.measure.bricks.validation.compare import SNR_GALAXY, SNR_GALAXY_COLOUR
from csstsim.measure.bricks.validation.gates.record import SIGMAS, AtMost, Measured


def _magnitudes(band: Mapping[str, Any], index: int) -> list[Measured]:
    part = band["galaxy_bins"][index]
    return [Measured(part["median"], part["n"], part["error"] or 0.0)]


def _colours(part: Mapping[str, Any], low: float, high: float) -> list[Measured]:
    return [Measured(part["median"], part["n"], part["error"] or 0.0)] if part["snr"] == [low, high] else []


GATES = (
    *(
        AtMost(
            f"magnitude bias of galaxies, S/N {low:g} to {high:g} [mag]",
            scope="band",
            threshold="galaxy_mag_max",
            unit="mag",
            tests="merged total magnitude minus true magnitude, median of isolated galaxies",
            measure=partial(_magnitudes, index=k),
            sigmas=SIGMAS,
            bin=k,
        )
        for k, (low, high) in enumerate(pairwise(SNR_GALAXY))
    ),
    *(
        AtMost(
            f"colour bias of galaxies, S/N {low:g} to {high:g} [mag]",
            scope="colour",
            threshold="galaxy_colour_max",
            unit="mag",
            tests="merged colour in neighbouring bands minus true colour, median of isolated galaxies",
            measure=partial(_colours, low=low, high=high),
            sigmas=SIGMAS,
        )
        for low, high in pairwise(SNR_GALAXY_COLOUR)
    ),
)
