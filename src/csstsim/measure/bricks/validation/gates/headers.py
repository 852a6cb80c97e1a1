"""Values in the headers of Level-0 files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

from csstsim.measure.bricks.validation.gates.record import AtMost, Measured

if TYPE_CHECKING:
    from csstsim.measure.bricks.validation.gates.data import FrameData


def _off(data: FrameData, name: str) -> list[Measured]:
    """Measure the deviation of every channel's value, or of the frame's."""
    return [Measured(one.value, None, one.sigma, one.channel) for one in data.header.get(name, ())]


def _pointing_of_spectra(checks: Mapping[str, Any]) -> list[Measured]:
    return [Measured(max(checks["pointing"].values(), default=None))]


POINTING = AtMost(
    "header: pointing less the campaign's [arcsec]",
    scope="frame",
    threshold="pointing_max",
    unit="arcsec",
    tests="RA, DEC, POS_ANG and EULER keywords of both ends, and the world coordinates at the middle and a corner of "
    "the chip; the largest difference",
    measure=partial(_off, name="pointing"),
)
GATES = (
    *(
        AtMost(
            name,
            scope="frame",
            threshold="header_max",
            tests=f"{keyword} divided by the campaign's value, minus 1",
            measure=partial(_off, name=entry),
        )
        for name, keyword, entry in (
            ("header: gain over the camera's, less 1", "GAINnn", "gain"),
            ("header: exposure time over the campaign's, less 1", "EXPTIME", "exptime"),
            ("header: read noise over the camera's, less 1", "RONnn", "read_noise"),
        )
    ),
    POINTING,
    replace(POINTING, scope="spectra", measure=_pointing_of_spectra),
)
