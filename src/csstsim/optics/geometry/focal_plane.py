"""Optical model of the focal plane: where light from a direction falls on a chip at its actual position.

It replaces the ray tracing of the paper (section 5.2) and gives the samples to which the distortion model is fitted
(optics.geometry.distortion); simulations use the fitted model. With q = (X, Y) / radius on the mosaic, the light of
ideal position (X, Y) arrives at

    (X, Y) + cubic q^2 q + quintic q^4 q + decentring + astigmatic,
    decentring = (p1 (q^2 + 2 qx^2) + 2 p2 qx qy,  p2 (q^2 + 2 qy^2) + 2 p1 qx qy),
    astigmatic = q^2 [[a, b], [b, -a]] q,

on the focal plane. Call this point Q. A CCD surface at height z above the plane meets that light at Q (1 - z / L), L
the distance of the exit pupil; the CCD's shift and rotation are then removed. Numbers:
config/instrument/distortion.yaml.

The position of light is the windowed centroid on which the PSF is centred (optics.psf.psf_set). Left out: colour (the
shift by filters and their wedges would be absorbed by the fit of each chip), the CCDs' bow, foreshortening (1e-8).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from csstsim.base.errors import InputError
from csstsim.base.sphere import rotation
from csstsim.base.types import FloatArray, Floats, PathLike
from csstsim.instrument.load import read_data
from csstsim.optics.geometry.wcs import chip_plane, mosaic_cd

if TYPE_CHECKING:
    from csstsim.instrument.chip import Chip

_STEPS = 12  # of the inverse; each reduces the error by a factor of 50


@dataclass(frozen=True)
class Placement:
    """Position of a CCD: shift [px, mosaic axes], turn [rad], height [um], slopes of the height along chip x, y."""

    shift_x: float = 0.0
    shift_y: float = 0.0
    turn: float = 0.0
    height: float = 0.0
    slope_x: float = 0.0
    slope_y: float = 0.0


@dataclass(frozen=True, eq=False)
class FocalPlane:
    """The numbers of distortion.yaml."""

    radius: float  # px
    optics: dict[str, Any]
    exit_pupil: float  # mm
    placement: dict[int, Placement]

    def forward(self, chip: Chip, x0: ArrayLike, y0: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return the pixel x, y on which the light of ideal pixel x0, y0 (0-based, arrays) of the chip falls."""
        chip_turn, origin = chip_plane(chip)
        seat = self.placement[chip.id]
        px = np.asarray(x0, float) - origin[0]
        py = np.asarray(y0, float) - origin[1]
        landed = np.stack(self._optics(*np.tensordot(chip_turn, np.stack([px, py]), axes=1)))
        centre = np.array([(chip.detector.nx - 1) / 2, (chip.detector.ny - 1) / 2])
        seat_centre = chip_turn @ (centre - origin) + [seat.shift_x, seat.shift_y]
        to_chip = rotation(-seat.turn) @ chip_turn.T
        shape = (2,) + (1,) * (landed.ndim - 1)
        on_chip = np.tensordot(to_chip, landed - seat_centre.reshape(shape), axes=1)
        um = chip.detector.pixel_um
        z = seat.height + um * (seat.slope_x * on_chip[0] + seat.slope_y * on_chip[1])
        on_chip -= z / (1000.0 * self.exit_pupil) * np.tensordot(to_chip, landed, axes=1)
        return on_chip[0] + centre[0], on_chip[1] + centre[1]

    def ideal(self, chip: Chip, x: Floats, y: Floats) -> tuple[FloatArray, FloatArray]:
        """Return the ideal pixel x0, y0 whose light falls on pixel x, y of the chip (to 1e-9 px)."""
        x0 = np.asarray(x, float)
        y0 = np.asarray(y, float)
        for _ in range(_STEPS):
            there = self.forward(chip, x0, y0)
            x0 = x0 - (there[0] - x)
            y0 = y0 - (there[1] - y)
        return x0, y0

    def _optics(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        o = self.optics
        qx = x / self.radius
        qy = y / self.radius
        r2 = qx**2 + qy**2
        radial = o["cubic"] * r2 + o["quintic"] * r2**2
        (p1, p2), (a, b) = o["decentring"], o["astigmatic"]
        dx = radial * qx + p1 * (r2 + 2 * qx**2) + 2 * p2 * qx * qy + r2 * (a * qx + b * qy)
        dy = radial * qy + p2 * (r2 + 2 * qy**2) + 2 * p1 * qx * qy + r2 * (b * qx - a * qy)
        return x + dx, y + dy


def load_focal_plane(path: PathLike) -> FocalPlane:
    """Read distortion.yaml. Raises InputError."""
    data = read_data(path)
    try:
        optics: dict[str, Any] = {name: np.asarray(data["optics"][name], float) for name in ("cubic", "quintic")}
        optics |= {name: tuple(map(float, data["optics"][name])) for name in ("decentring", "astigmatic")}
        rows = {int(row[0]): Placement(*map(float, row[1:])) for row in data["placement"]}
        return FocalPlane(float(data["radius"]), optics, float(data["exit_pupil"]), rows)
    except (KeyError, TypeError, ValueError) as exc:
        raise InputError(f"not a description of the focal plane: {exc!r}", file=path) from None


def samples(plane: FocalPlane, chip: Chip, nodes: int = 30) -> FloatArray:
    """Return (nodes^2, 4) of u, v [deg], x, y [px] on a regular lattice of the chip's pixels, edge to edge.

    u, v are intermediate world coordinates (east, north of the boresight) at position angle 0 of the light that falls
    on x, y. A PSF data set has these numbers for each node (paper, section 5.2).
    """
    edge_x, edge_y = (np.linspace(-0.5, n - 0.5, nodes) for n in (chip.detector.nx, chip.detector.ny))
    x, y = (a.ravel() for a in np.meshgrid(edge_x, edge_y))
    turn, origin = chip_plane(chip)
    cd = mosaic_cd(0.0, chip.telescope) @ turn
    x0, y0 = plane.ideal(chip, x, y)
    u, v = (row[0] * (x0 - origin[0]) + row[1] * (y0 - origin[1]) for row in cd)
    return np.stack([u, v, x, y], axis=1)
