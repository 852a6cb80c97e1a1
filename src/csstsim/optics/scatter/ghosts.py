"""Ghosts: out-of-focus images of the pupil from two reflections between filter and detector (paper, section 5.5.1).

Three pairs of surfaces reflect light back and forth once; the added path P (paraxial, in air) determines the ghost:

| pair                     | added path P       | light                      |
|--------------------------|--------------------|----------------------------|
| detector - filter back   | 2 gap              | R_det R_back               |
| detector - filter front  | 2 (gap + t / n)    | R_det R_front (1 - R_back)^2 |
| filter back - front      | 2 t / n            | R_back R_front             |

A ghost is a uniform disc of the pupil's shape, a circle of diameter P / (f/D). The chief ray of a star at mosaic
position m is inclined by (m - axis) / L to the focal plane's normal, L the distance of the exit pupil. So the ghost is
displaced outwards by P (m - axis) / L: concentric on the axis, in opposite directions at opposite field points.

The ghost is added to the star's light, because throughput curves contain only direct light. Numbers, most of them
estimates: config/instrument/ghosts.yaml.

Left out: vignetting and aberration of the discs, reflectance that changes over a band (fringes) or with angle, a
dewar window, reflections from a neighbour's filter, more than two reflections.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.sphere import rotation
from csstsim.base.types import BoolArray, FloatArray, Floats
from csstsim.optics.psf.chip_errors import mosaic_position

if TYPE_CHECKING:
    from csstsim.instrument.chip import Chip
    from csstsim.instrument.telescope import Telescope


@dataclass(frozen=True, eq=False)
class Ghosts:
    """The ghosts of one band; lengths in pixels."""

    way: FloatArray  # (G,) added path P
    radius: FloatArray  # (G,)
    light: FloatArray  # (G,) fraction of the star's direct light
    pupil: float  # distance of the exit pupil
    axis: FloatArray  # (2,) mosaic position where chief rays are normal to the detector
    faintest: float  # electron per pixel below which a ghost is not drawn

    def centres(self, chip: Chip, x: float, y: float) -> FloatArray:
        """Return the discs' centres (G, 2) [chip pixel] for a star at chip pixel x, y, which may be off the chip."""
        lean = (np.array(mosaic_position(chip, x, y)) - self.axis) / self.pupil
        turn = math.radians(chip.rotation)
        in_chip = rotation(-turn) @ lean
        return np.array([x, y]) + self.way[:, None] * in_chip

    @property
    def level(self) -> FloatArray:
        """Light per pixel of each ghost, as a fraction of the star's direct light, (G,)."""
        return self.light / (np.pi * self.radius**2)

    def visible(self, electrons: Floats) -> bool | BoolArray:
        """Whether a star's ghosts are drawn: the brightest one reaches `faintest`. electrons: float or array."""
        return electrons * self.level.max() >= self.faintest

    def reach(self, chip: Chip) -> float:
        """Return the largest distance from a star on the chip that any of its ghosts extends to [pixel]."""
        nx = chip.detector.nx
        ny = chip.detector.ny
        lean = max(
            np.hypot(*(np.array(mosaic_position(chip, *c)) - self.axis)) for c in ((0, 0), (nx, 0), (0, ny), (nx, ny))
        )
        return float((self.way * lean / self.pupil + self.radius).max())

    def as_dict(self) -> dict[str, Any]:
        """Return the content as lists, for a file; `Ghosts.read` is the inverse."""
        return {name: np.asarray(value).tolist() for name, value in asdict(self).items()}

    @classmethod
    def read(cls, data: Mapping[str, Any]) -> Self:
        """Return the Ghosts of a mapping made by `as_dict`."""
        arrays = {name: np.asarray(data[name], float) for name in ("way", "radius", "light", "axis")}
        return cls(pupil=float(data["pupil"]), faintest=float(data["faintest"]), **arrays)


def make_ghosts(params: Mapping[str, Any], band: str, telescope: Telescope, pixel_um: float) -> Ghosts | None:
    """Return the `Ghosts` of a filter (`band`, its name), or None if `params` (Camera.ghosts) is empty.

    Raises InputError for a band without three reflectances from 0 to 1, and for lengths that are not above 0.
    """
    if not params:
        return None
    lengths, reflectances = (params.get(key) for key in ("geometry", "reflectance"))
    if not (isinstance(lengths, dict) and isinstance(reflectances, dict)):
        raise InputError("must be mappings", file="ghosts.yaml", key="geometry, reflectance")
    names = ("gap", "thickness", "index", "pupil_distance", "axis_x", "axis_y", "faintest")
    for name in names:
        if not isinstance(lengths.get(name), int | float) or not (lengths[name] > 0 or name.startswith("axis")):
            raise InputError(
                "bad length", file="ghosts.yaml", key=f"geometry.{name}", value=lengths.get(name), allowed="> 0"
            )
    gap, thickness, index, pupil, axis_x, axis_y, faintest = (float(lengths[name]) for name in names)
    reflectance: Any = reflectances.get(band)
    known = isinstance(reflectance, list) and len(reflectance) == 3
    if not (known and all(isinstance(r, int | float) and 0 <= r <= 1 for r in reflectance)):
        allowed = "three numbers from 0 to 1: detector, filter front, filter back"
        raise InputError(
            "bad reflectance", file="ghosts.yaml", key=f"reflectance.{band}", value=reflectance, allowed=allowed
        )
    detector, front, back = reflectance
    way = 2 * np.array([gap, gap + thickness / index, thickness / index]) * 1000 / pixel_um
    light = np.array([detector * back, detector * front * (1 - back) ** 2, back * front])
    radius = way / (2 * telescope.focal_length_m / telescope.diameter_m)
    return Ghosts(way, radius, light, pupil * 1000 / pixel_um, np.array([axis_x, axis_y]), faintest)
