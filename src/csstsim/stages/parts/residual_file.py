"""What is left of measured frames without the models of their sources, as FITS files of two planes.

`steps` (uint8) and `noise` (float32) are those of measure.detection.residual.Residual, META has the recipe.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from csstsim.base.types import PathLike
from csstsim.io.fits import open_fits
from csstsim.io.frames import load_frame, save_frame
from csstsim.measure.detection.residual import Residual


def save_residual(path: PathLike, residual: Residual, meta: dict[str, Any]) -> None:
    """Write what is left of a frame to a file; meta: JSON-like."""
    save_frame(path, residual._asdict(), meta)


def open_residual(path: PathLike, expect: Mapping[str, Any]) -> Residual:
    """Return the Residual of a file, whose steps stay in the file until they are used.

    expect: required entries {key: value} of its metadata. Raises InputError as `load_frame`.
    """
    planes, _ = load_frame(path, expect)
    with open_fits(path) as file:
        start = file["STEPS"].get_offsets()["data_start"]
    steps = np.memmap(path, np.uint8, mode="r", offset=start, shape=planes["steps"].shape)
    return Residual(steps, planes["noise"])
