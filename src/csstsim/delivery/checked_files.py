"""Facts of products that were checked, needed by the checks of products that refer to them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from pathlib import Path
    from typing import Any

    from csstsim.io.level0 import Level0


class MergedBrick(NamedTuple):
    """The number of rows of a merged brick, and the recipe that it records."""

    rows: int
    recipe: Any


@dataclass
class CheckedFiles:
    """Facts of the products that were checked so far."""

    measured: dict[tuple[str, int], int] = field(default_factory=dict)  # {(obsid, chip): rows}
    merged: dict[int, MergedBrick] = field(default_factory=dict)  # by brick
    gates: dict[int, int] = field(default_factory=dict)  # {brick: how many}
    opened: dict[Path, Level0] = field(default_factory=dict)  # of the frame that is being checked
    truths: set[Path] = field(default_factory=set)  # truth tables without a fault
    psf_hash: dict[Path, str | None] = field(default_factory=dict)  # {path: PSFHASH} of sound Level-0 files
