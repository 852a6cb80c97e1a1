"""The truth of a pack, as `csstsim release score` reads it: objects, frames, and the area of the frames."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.files.text_file import read_json
from csstsim.base.sphere import inside_polygon, unit_vectors
from csstsim.catalog.table import ObjectTable

if TYPE_CHECKING:
    from collections.abc import Mapping
    from typing import Any

    from csstsim.base.types import BoolArray, FloatArray, PathLike

OBJECTS = "objects.parquet"
FRAMES = "frames.json"


@dataclass(frozen=True)
class Field:
    """objects: ObjectTable (pack_truth.COLUMNS); frames: [{file, filter, kind, corners}]; name of the pack."""

    name: str
    objects: ObjectTable
    frames: list[dict[str, Any]]

    @property
    def bands(self) -> tuple[str, ...]:
        """Names of the bands of imaging frames, lower case, in the order of the frames."""
        return tuple(dict.fromkeys(frame["filter"].lower() for frame in self.frames if frame["kind"] == "imaging"))

    def covers(self, ra: FloatArray, dec: FloatArray, band: str | None = None) -> BoolArray:
        """Return a mask (n,) of the positions ra, dec [deg] on an imaging frame, of a band if that is given."""
        points = unit_vectors(ra, dec).reshape(-1, 3)
        mask = np.zeros(np.size(ra), bool)
        for frame in self.frames:
            if frame["kind"] == "imaging" and band in (None, frame["filter"].lower()):
                mask |= inside_polygon(points, unit_vectors(*np.transpose(frame["corners"])))
        return mask


def read_field(folder: PathLike) -> Field:
    """Return the Field of a pack's truth folder. Raises InputError."""
    folder = Path(folder)
    if not (folder / FRAMES).is_file():
        allowed = f"the folder truth of a pack, with {OBJECTS} and {FRAMES}"
        raise InputError("not the truth of a pack", file=folder, key="--truth", allowed=allowed)
    name, frames = read_frames(folder / FRAMES)
    return Field(name, ObjectTable.read(folder / OBJECTS), frames)


def read_frames(path: PathLike) -> tuple[str, list[dict[str, Any]]]:
    """Return (name of the pack, list of frames) of a pack's FRAMES. Raises InputError."""
    content = read_json(path)
    frames = content.get("frames") if isinstance(content, dict) else None
    if not isinstance(frames, list) or not all(isinstance(frame, dict) and _is_frame(frame) for frame in frames):
        raise InputError("not a list of frames with file, filter, kind and corners", file=path)
    return str(content.get("name", "")), frames


def _is_frame(frame: Mapping[str, Any]) -> bool:
    try:
        corners = np.asarray(frame["corners"], float)
        return (
            corners.ndim == 2 and corners.shape[1] == 2 and len(corners) > 2 and bool(frame["filter"] and frame["kind"])
        )
    except (KeyError, TypeError, ValueError):
        return False
