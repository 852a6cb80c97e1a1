"""Spectra of a spectroscopic exposure."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from csstsim.measure.bricks.validation.gates.record import SIGMAS_OF_MANY, AtMost, Measured


def _flux(checks: Mapping[str, Any]) -> list[Measured]:
    flux = checks["flux"]
    return [Measured(flux["off"], flux["n"], flux["error"])]


def _sky(checks: Mapping[str, Any]) -> list[Measured]:
    return [Measured(checks["sky"]["off"], checks["sky"]["n"])]


GATES = (
    AtMost(
        "flux of spectra over true, less 1",
        scope="spectra",
        threshold="spectra_flux_max",
        tests="electrons of stars' spectra of S/N > 50 divided by the true ones, mean, minus 1",
        measure=_flux,
        sigmas=SIGMAS_OF_MANY,
    ),
    AtMost(
        "sky near spectra over the campaign's, less 1",
        scope="spectra",
        threshold="spectra_sky_max",
        tests="level next to the spectra divided by the dispersed sky, median, minus 1; faint objects add 0.01",
        measure=_sky,
    ),
)
