"""The flat field of the focal plane (paper, section 5.5.5): external vignetting and the internal flats of the LEDs.

    external   1 - q(x, y), q a quadratic polynomial >= 0 that is zero near the boresight
    internal   for each LED: level of the detector x (1 + smooth pattern), 1 on average over the mosaic. The pattern is
               a sum of low-order cosines, which stay bounded in the corners, unlike polynomials. Flats are linear
               between LED wavelengths, so a band's flat is their mean with weights from its throughput.

The paper's internal flats are laboratory images that are not public. A chip whose camera folder has such maps
(instrument.maps, led_flats) has those. For others the patterns are random, one draw per campaign seed, with the rms,
order and correlation between wavelengths of config/instrument/leds.yaml. Drawn flats are exact on a grid of NODES^2
points per chip and bilinear in between, with an error of 5e-6; they leave out structure smaller than a few cm, and the
coatings of the filters.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from csstsim.base.errors import InputError
from csstsim.base.types import FloatArray, IntArray, PathLike
from csstsim.optics.geometry.wcs import chip_plane

if TYPE_CHECKING:
    from csstsim.instrument.chip import Chip, Window
    from csstsim.instrument.filter import Filter
    from csstsim.instrument.maps.lab_map import LabMap

NODES = 65


@dataclass(frozen=True, eq=False)
class FlatField:
    """The flats of one camera seed.

    numbers: Camera.leds (leds.yaml and the mosaic's columns and rows); camera: function of a name that returns a
    Generator, the same in all exposures (rng.Streams.camera).
    """

    numbers: Mapping[str, Any]
    camera: Callable[[str], np.random.Generator]

    def _unit(self, x: ArrayLike, y: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return mosaic positions [px from the boresight] in units of half the mosaic."""
        half_x, half_y = self.numbers["half_mosaic"]
        return np.asarray(x) / half_x, np.asarray(y) / half_y

    @cached_property
    def wavelengths(self) -> FloatArray:
        """(n,) nm: wavelengths of the LEDs that have a flat."""
        return np.asarray(self.numbers["flat"]["wavelengths"], dtype=float)

    @cached_property
    def _modes(self) -> tuple[FloatArray, FloatArray]:
        """Coefficients (n, J) of the shapes and detector levels (n, columns, rows of the mosaic), by wavelength."""
        flat = self.numbers["flat"]
        gap = np.subtract.outer(np.log(self.wavelengths), np.log(self.wavelengths)) / flat["correlation"]
        alike = np.linalg.cholesky(np.exp(-0.5 * gap**2) + 1e-9 * np.eye(len(gap)))
        orders = _orders(flat["order"])
        draw = self.camera("internal flat")
        pattern = np.einsum("ij,jk->ik", alike, draw.standard_normal((len(gap), len(orders))))
        # A cosine has mean square 1/2; the variance is divided equally among the orders.
        size = np.sqrt([(4 if i and j else 2) / len(orders) for i, j in orders])
        levels = np.einsum("ij,jcr->icr", alike, draw.standard_normal((len(gap), *self.numbers["mosaic"])))
        levels = 1 + flat["detector_rms"] * levels
        return flat["pattern_rms"] * pattern * size, levels / levels.mean(axis=(1, 2), keepdims=True)

    @cached_property
    def _vignette(self) -> tuple[float, float, float, float, float]:
        """(centre x, centre y, A, B, C): q = A u^2 + B u v + C v^2; u, v from the centre, in units of half a mosaic."""
        numbers = self.numbers["vignetting"]
        draw = self.camera("vignette")
        low, high = numbers["corner"]
        corner = draw.uniform(low, high)
        skew = draw.uniform(-numbers["skew"], numbers["skew"], 2)
        centre = draw.uniform(-numbers["offset"], numbers["offset"], 2)
        return *centre, 0.5 * corner * (1 + skew[0]), corner * skew[1], 0.5 * corner * (1 - skew[0])

    def vignetting(self, x: ArrayLike, y: ArrayLike) -> FloatArray:
        """Return the external flat at mosaic positions [px from the boresight]; at most 1."""
        cx, cy, a, b, c = self._vignette
        u, v = self._unit(x, y)
        u = u - cx
        v = v - cy
        return 1 - (a * u * u + b * u * v + c * v * v)

    def internal(self, chip: Chip, x: ArrayLike, y: ArrayLike, weights: FloatArray) -> FloatArray:
        """Return the internal flat of a chip at mosaic positions, for weights (n,) of the wavelengths that sum to 1."""
        pattern, levels = self._modes
        u, v = (0.5 * np.pi * (1 + w) for w in self._unit(x, y))  # 0 to pi over the mosaic
        shapes = np.array([np.cos(i * u) * np.cos(j * v) for i, j in _orders(self.numbers["flat"]["order"])])
        flats = 1 + np.einsum("nj,j...->n...", pattern, shapes)
        return np.einsum("n,n...->...", weights * levels[:, chip.column - 1, chip.row - 1], flats)

    def weights(self, wave: FloatArray, response: FloatArray) -> FloatArray:
        """Return (n,) weights of the LED wavelengths for a response at `wave` [A]; flats are constant outside them."""
        total = np.trapezoid(response, wave)
        hats = [np.interp(np.asarray(wave) / 10, self.wavelengths, row) for row in np.eye(len(self.wavelengths))]
        return np.array([np.trapezoid(response * hat, wave) for hat in hats]) / total

    def external_grid(self, chip: Chip, filter: Filter) -> FloatArray:
        """Return (NODES, NODES): the smooth flat for light from the sky, external x drawn internal flat of the filter.

        Of a chip with laboratory flats it is the external flat alone: `laboratory` has the internal one.
        """
        x, y = _mosaic(chip)
        if chip.maps.led_flats:
            return self.vignetting(x, y)
        return self.vignetting(x, y) * self.internal(chip, x, y, self.weights(filter.wavelength, filter.throughput))

    def laboratory(self, chip: Chip, wave: FloatArray, response: FloatArray) -> LabFlat | None:
        """Return the LabFlat of a chip for a response, or None for a chip without laboratory flats."""
        flats = chip.maps.led_flats
        if not flats:
            return None
        weights = zip(self.wavelengths, self.weights(wave, response), strict=True)
        return LabFlat(tuple((float(weight), flats[led]) for led, weight in weights if weight > 0))

    def led_map(self, chip: Chip, window: Window, wave: FloatArray, response: FloatArray) -> FloatArray:
        """Return (ny, nx) float32: the internal flat for a given response, such as one LED through a filter."""
        from csstsim.optics.throughput.coarse_grid import expand

        flat = self.laboratory(chip, wave, response)
        if flat is not None:
            return flat.part(*window.slices)
        return expand(self.internal(chip, *_mosaic(chip), self.weights(wave, response)), chip, window)


@dataclass(frozen=True)
class LabFlat:
    """A mean of laboratory flats: pairs of a weight and an instrument.maps.lab_map.LabMap; the weights' sum is 1."""

    flats: tuple[tuple[float, LabMap], ...]

    @property
    def maximum(self) -> float:
        """An upper bound of the values, from what the maps declare."""
        return sum(weight * flat.maximum for weight, flat in self.flats)

    def part(self, rows: slice, columns: slice) -> FloatArray:
        """Return float32 (ny, nx) of slices of the chip's rows and columns. Raises InputError as the maps do."""
        return np.asarray(sum(np.float32(weight) * flat.part(rows, columns) for weight, flat in self.flats))

    def at(self, row: IntArray, column: IntArray) -> FloatArray:
        """Return float32 (n,) of single pixels of the chip: the numbers of `part`."""
        return np.asarray(sum(np.float32(weight) * flat.at(row, column) for weight, flat in self.flats))


# Keys of leds.yaml, what they may be, and the test of it
_RULES = (
    ("half_mosaic", "two numbers above 0", lambda v: len(v) == 2 and min(v) > 0),
    ("flat.wavelengths", "two numbers or more, rising", lambda v: len(v) > 1 and (np.diff(v) > 0).all()),
    ("flat.order", "1 to 8", lambda v: 1 <= v <= 8),
    ("flat.correlation", "above 0", lambda v: v > 0),
    ("flat.pattern_rms", "0 to 0.1", lambda v: 0 <= v <= 0.1),
    ("flat.detector_rms", "0 to 0.1", lambda v: 0 <= v <= 0.1),
    ("vignetting.corner", "two numbers, rising, from 0 to 0.5", lambda v: len(v) == 2 and 0 <= v[0] <= v[1] <= 0.5),
    ("vignetting.skew", "0 to 0.5", lambda v: 0 <= v <= 0.5),
    ("vignetting.offset", "0 to 0.5", lambda v: 0 <= v <= 0.5),
)


def check_flat(numbers: Mapping[str, Any], file: PathLike = "leds.yaml") -> None:
    """Raise InputError if a number for the flat field in leds.yaml is missing or out of range."""
    for name, allowed, good in _RULES:
        value: Any = numbers
        try:
            for key in name.split("."):
                value = value[key]
            fine = good(value)
        except KeyError:
            value = None
            fine = False
        except (TypeError, IndexError, ValueError):
            fine = False
        if not fine:
            raise InputError("missing or out of range", file=file, key=name, value=value, allowed=allowed)


def _mosaic(chip: Chip) -> tuple[FloatArray, FloatArray]:
    """Return mosaic positions [px from the boresight] of a chip's grid."""
    rotation, origin = chip_plane(chip)
    from csstsim.optics.throughput.coarse_grid import grid_pixels

    x, y = grid_pixels(chip, NODES)
    along, across = (row[0] * (x - origin[0]) + row[1] * (y - origin[1]) for row in rotation)
    return along, across


def _orders(order: int) -> list[tuple[int, int]]:
    return [(i, j) for i in range(order + 1) for j in range(order + 1 - i) if i + j > 0]
