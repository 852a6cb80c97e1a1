"""Field distortion: the pixel on which light actually falls (paper, section 5.2, equations 5 and 6).

    x = f_x(x0, y0) + f_dx(x0, y0),   y = f_y(x0, y0) + f_dy(x0, y0)

maps the ideal pixel (x0, y0) of the linear WCS to the pixel (x, y) of the light. One two-dimensional spline of order 4
over the whole focal plane describes the optics. One spline per CCD describes the residual, which jumps between CCDs
because they are not perfectly aligned. Splines give displacements (x - x0, y - y0), the global one in mosaic axes
about the boresight. builders/build_distortion.py fits both to samples (u, v, x, y), which PSF data sets contain.

The rows of equation 4 are exchanged in print; x0, y0 follow from u, v by the inverse of CD. Shapes of sources change by
the full matrix d(x, y)/d(x0, y0), composed with lensing (equation 7, in linear order and with the opposite sign).

The fit is valid to 2600 px beyond each chip; further out the displacement is that of the nearest point inside, so the
map stays continuous and one-to-one. Left out: colour, and change with time.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import fitsio
import numpy as np
from numpy.typing import ArrayLike

from csstsim.base.errors import InputError, first_line
from csstsim.base.types import AnyArray, FloatArray, PathLike
from csstsim.optics.geometry.few_points import Model
from csstsim.optics.geometry.wcs import chip_plane

if TYPE_CHECKING:
    from types import ModuleType

    from csstsim.instrument.chip import Chip

# cost in points: of a call without points; of starting numba (0.5 s)
_CALL = 200
_ENOUGH = 200_000
_asked = 0  # cost so far


@dataclass(frozen=True, eq=False)
class ChipDistortion:
    """The distortion of one chip; positions are its 0-based pixels, of any shape."""

    model: Model  # see optics.geometry.chip_distortion

    def forward(self, x0: ArrayLike, y0: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return the pixel x, y on which the light of ideal pixel x0, y0 falls."""
        distorted = self._distorted(x0, y0)
        return distorted[..., 0], distorted[..., 1]

    def inverse(self, x: ArrayLike, y: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return the ideal pixel x0, y0 whose light falls on x, y: Newton's method, to 1e-10 px."""
        x, y = np.broadcast_arrays(np.asarray(x, float), np.asarray(y, float))
        ideal = _splines(x.size).inverse(x.ravel(), y.ravel(), self.model).reshape(*x.shape, 2)
        return ideal[..., 0], ideal[..., 1]

    def jacobian(self, x0: ArrayLike, y0: ArrayLike) -> FloatArray:
        """Return d(x, y)/d(x0, y0), (..., 2, 2), at ideal pixels: the exact derivative of the splines."""
        distorted = self._distorted(x0, y0)
        return distorted[..., 2:].reshape(*distorted.shape[:-1], 2, 2)

    def _distorted(self, x0: ArrayLike, y0: ArrayLike) -> FloatArray:
        x0, y0 = np.broadcast_arrays(np.asarray(x0, float), np.asarray(y0, float))
        return _splines(x0.size).forward(x0.ravel(), y0.ravel(), self.model).reshape(*x0.shape, 6)


def _splines(points: int) -> ModuleType:
    """Return the module that evaluates the splines at `points` points: the compiled one after many evaluations."""
    global _asked
    _asked += _CALL + points
    if _asked > _ENOUGH:
        from csstsim.optics.geometry import chip_distortion

        return chip_distortion
    from csstsim.optics.geometry import few_points

    return few_points


@dataclass(frozen=True, eq=False)
class FieldDistortion:
    """The fitted model: (box, coefficients) of the global spline and of each chip's, as in optics.geometry.spline."""

    whole: tuple[FloatArray, FloatArray]
    chips: dict[int, tuple[FloatArray, FloatArray]]
    layout: dict[int, tuple[float, ...]]  # `chip_layout` of each chip at the time of the fit

    def on(self, chip: Chip) -> ChipDistortion:
        """Return the `ChipDistortion` of a chip. Raises InputError if the model was fitted to another chip layout."""
        if self.layout.get(chip.id) != chip_layout(chip):
            raise InputError(
                "the field distortion was fitted to another layout of the chips",
                key=f"chip {chip.id}",
                value=self.layout.get(chip.id, "missing"),
                allowed=chip_layout(chip),
            )
        rotation, origin = chip_plane(chip)
        return ChipDistortion(Model(rotation, origin, *self.whole, *self.chips[chip.id]))


def chip_layout(chip: Chip) -> tuple[float, ...]:
    """Return the nominal geometry of a chip that the model depends on: nx, ny, xc, yc, rotation."""
    return tuple(map(float, (chip.detector.nx, chip.detector.ny, chip.xc, chip.yc, chip.rotation)))


def load_distortion(path: PathLike) -> FieldDistortion:
    """Read a FieldDistortion. Raises InputError for a file that is missing or not a field distortion."""
    try:
        with fitsio.FITS(path) as file:
            tables = {name: file[name].read() for name in ("GLOBAL", "CHIPS")}
        whole, chips = (
            [(_native(row["box"]), _native(row["coefficients"])) for row in table] for table in tables.values()
        )
        numbers = tables["CHIPS"]["chip"].tolist()
        layout = [tuple(row.tolist()) for row in tables["CHIPS"]["layout"]]
    except (OSError, ValueError, KeyError) as exc:
        reason = first_line(exc)
        raise InputError(f"cannot read the field distortion: {reason}", file=path) from None
    for name, (box, coefficients) in zip(("global", *numbers), (*whole, *chips), strict=True):
        if box.shape != (4,) or coefficients.ndim != 3 or min(coefficients.shape[:2]) < 5 or coefficients.shape[2] != 2:
            raise InputError("wrong shape for a spline", file=path, key=name, value=(box.shape, coefficients.shape))
        if not (np.isfinite(box).all() and np.isfinite(coefficients).all()):
            raise InputError("holds a value that is not finite", file=path, key=name)
        if not (box[1] > box[0] and box[3] > box[2]):
            raise InputError("the box is empty", file=path, key=name, value=box.tolist())
    return FieldDistortion(whole[0], dict(zip(numbers, chips, strict=True)), dict(zip(numbers, layout, strict=True)))


def _native(values: AnyArray) -> FloatArray:
    return np.ascontiguousarray(values, np.float64)
