"""The sampling of stored PSFs."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from csstsim.base.errors import InputError

if TYPE_CHECKING:
    pass

CELLS = 256  # along the side of a stored PSF
OVERSAMPLING = (2, 4)  # cells along the side of a pixel
WINDOW_PX = 1.5  # sigma of the window by which a PSF is centred
LIBRARY_PX = 128  # side of the box of an external library's PSF


def oversampling_of(filter: str, psf_params: Mapping[str, Any], asked: int | str = "auto") -> int:
    """Return the cells along the side of a pixel for a filter (name): `asked` (2 or 4), or for "auto" as in psf.yaml.

    Raises InputError for any other number.
    """
    table = psf_params.get("oversampling")
    value = asked if asked != "auto" else table.get(filter) if isinstance(table, dict) else None
    if isinstance(value, bool) or value not in OVERSAMPLING:
        raise InputError("bad sampling", file="psf.yaml", key=f"oversampling.{filter}", value=value, allowed="2, 4")
    return value


def psf_cube(folder: Path, chip_id: int) -> Path:
    """Return the path of a chip's file in an external library."""
    return folder / f"psfCube_{chip_id}.h5"
