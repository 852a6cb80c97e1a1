"""Spectra of a spectroscopic exposure."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from csstsim.measure.bricks.validation.gates.record import SIGMAS_OF_MANY, AtMost, Measured

FAINT_LIGHT = 0.3  # electron / px, of objects too faint to be modelled; 0.1 to 0.4 in frames of 150 s


def _flux(checks: Mapping[str, Any]) -> list[Measured]:
    flux = checks["flux"]
    return [Measured(flux["off"], flux["n"], flux["error"])]


def _sky(checks: Mapping[str, Any]) -> list[Measured]:
    sky = checks["sky"]
    faint = FAINT_LIGHT / sky["expected"] if sky.get("expected") else 0.0  # a table of an earlier version has none
    return [Measured(sky["off"], sky["n"], faint / SIGMAS_OF_MANY)]


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
        tests="level next to the spectra divided by the dispersed sky, median, minus 1; faint objects add light: four "
        f"sigma are {FAINT_LIGHT} electrons a pixel",
        measure=_sky,
        sigmas=SIGMAS_OF_MANY,
    ),
)
