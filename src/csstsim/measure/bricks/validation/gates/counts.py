"""Numbers of objects in the truth."""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING

from csstsim.catalog.table import GALAXY, STAR
from csstsim.catalog.truth_bricks import ID_BITS
from csstsim.measure.bricks.validation.gates.record import SIGMAS_OF_MANY, AtMost, Measured

if TYPE_CHECKING:
    from csstsim.measure.bricks.validation.gates.data import BrickData, FrameData

KINDS = {"galaxies": GALAXY, "stars": STAR}
BORDER = 4  # stars that proper motion takes across the border of a window
CLUSTERING = 0.03  # relative scatter of the number of galaxies from brick to brick


def _of_frame(data: FrameData, kind: str) -> list[Measured]:
    """Compare a frame's objects on the brick with those in the catalogue; a frame without an expectation has none."""
    expected = data.frame.facts.expected if data.frame.facts else {}
    if kind not in expected:
        return []
    n = expected[kind]
    truth, (x0, x1, y0, y1) = data.frame.truth, data.frame.info["window"]
    x = truth["x"]
    y = truth["y"]
    on = (x > x0 - 0.5) & (x < x1 - 0.5) & (y > y0 - 0.5) & (y < y1 - 0.5) & (truth["id"] >> ID_BITS == data.brick)
    number = int((truth["obj_type"][on] == KINDS[kind]).sum())
    return [Measured(number / n - 1, n, BORDER / n / SIGMAS_OF_MANY) if n else Measured(None, n)]


def _of_brick(data: BrickData, kind: str) -> list[Measured]:
    number, expected = data.laws.get(kind, (0, 0.0))
    if not expected > 0:
        return []
    clustering = CLUSTERING if kind == "galaxies" else 0.0
    return [Measured(number / expected - 1, None, math.hypot(clustering, expected**-0.5))]


GATES = (
    *(
        AtMost(
            f"{kind} of a frame over the catalogue's, less 1",
            scope="frame",
            threshold="frame_counts_max",
            tests=f"{kind} in the frame's truth on a brick, divided by those of the truth brick with positions in the "
            "window and magnitudes within the campaign's limit, minus 1; embedded sky only; four sigma are four "
            "objects at the border",
            measure=partial(_of_frame, kind=kind),
            sigmas=SIGMAS_OF_MANY,
        )
        for kind in KINDS
    ),
    *(
        AtMost(
            f"{kind} of the brick over the universe's laws, less 1",
            scope="brick",
            threshold="laws_max",
            tests=f"{kind} of a truth brick, divided by the prediction of the number counts and star densities of "
            "`config/universe`, minus 1; galaxies also scatter by large-scale structure",
            measure=partial(_of_brick, kind=kind),
            sigmas=SIGMAS_OF_MANY,
        )
        for kind in KINDS
    ),
)
