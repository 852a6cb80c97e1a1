"""The response to light from the sky: flat field x shutter x pixel response (PRNU), the same for all sources."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.types import FloatArray, IntArray
from csstsim.detector import prnu as pixels
from csstsim.optics.throughput.flat import check_flat
from csstsim.optics.throughput.shutter import exposed

if TYPE_CHECKING:
    from csstsim.instrument.chip import Chip, Window
    from csstsim.instrument.filter import Filter
    from csstsim.optics.throughput.flat import FlatField

_ROUNDING = 1e-6


def response_maximum(chip: Chip, filter: Filter, flat: FlatField | None) -> float:
    """Return an upper limit of `response_map` for a chip, for all pixels in any window.

    flat: as in `Response`. Photons are drawn for this times the flux and then thinned (render.photon_positions). The
    maximum of the shutter is 1. The maximum of the pixel response is always included, so that the random numbers of
    photons do not depend on PRNU. Laboratory maps declare theirs.
    """
    own = chip.maps.prnu
    highest = (own.maximum if own else pixels.highest(chip.detector.prnu)) * (1 + _ROUNDING)  # rounding of float32
    if flat is None:
        return highest
    check_flat(flat.numbers)
    lab = flat.laboratory(chip, filter.wavelength, filter.throughput)
    highest *= float(flat.external_grid(chip, filter).max())  # bilinear: its nodes are highest
    return highest if lab is None else highest * lab.maximum


def response_map(
    chip: Chip,
    window: Window,
    filter: Filter,
    exptime: float,
    *,
    flat: FlatField | None,
    shutter: bool,
    prnu: np.uint64 | None = None,
) -> FloatArray | None:
    """Return (ny, nx) float32, the fraction of nominal flux that is detected; None if all losses are off.

    Arguments are those of `Response`. Raises InputError.
    """
    if flat is None and not shutter and prnu is None:
        return None
    return Response(chip, window, filter, exptime, flat=flat, shutter=shutter, prnu=prnu).rows(0, window.ny)


def pixel_response(image: FloatArray, chip: Chip, window: Window, key: np.uint64) -> None:
    """Multiply `image` (ny, nx) float32 of a Window by the response of its pixels, in place: the map, or drawn numbers.

    key: uint64, the chip's (rng.Streams.chip_key). Raises InputError as the map does.
    """
    own = chip.maps.prnu
    if own:
        image *= own.part(*window.slices)
    else:
        pixels.multiply(image, window.x0, window.y0, chip.detector.prnu, key)


class Response:
    """The fraction of nominal flux that each pixel of a window detects, computed for the pixels that are asked for."""

    def __init__(
        self,
        chip: Chip,
        window: Window,
        filter: Filter,
        exptime: float,
        *,
        flat: FlatField | None,
        shutter: bool,
        prnu: np.uint64 | None = None,
        master: FloatArray | None = None,
    ) -> None:
        """Prepare the response of a chip's Window.

        exptime: [s]; flat: the camera's, or None: no vignetting and no flats of lamps; shutter: its losses are wanted;
        prnu: uint64, the chip's key (rng.Streams.chip_key) of the pixel response, or None: no PRNU; master: float32
        (ny, nx) of the window, a measured response of the pixels, or None. Raises InputError.
        """
        if flat is not None:
            check_flat(flat.numbers)
        self._chip = chip
        self._window = window
        self._prnu = prnu
        self._master = master
        self._grid = None if flat is None else flat.external_grid(chip, filter)
        self._lab = None if flat is None else flat.laboratory(chip, filter.wavelength, filter.throughput)
        self._exposed = exposed(chip, window, exptime).astype(np.float32) if shutter else None

    def rows(self, first: int, last: int) -> FloatArray:
        """Return float32 (last - first, nx), of the window's rows first to last - 1."""
        return self.part(slice(first, last), slice(0, self._window.nx))

    def part(self, rows: slice, columns: slice) -> FloatArray:
        """Return float32, of slices of the window's rows and columns that have a start and a stop."""
        from csstsim.optics.throughput.coarse_grid import expand

        x0 = self._window.x0
        y0 = self._window.y0
        window = replace(
            self._window, x0=x0 + columns.start, x1=x0 + columns.stop, y0=y0 + rows.start, y1=y0 + rows.stop
        )
        out = np.ones(window.shape, np.float32) if self._grid is None else expand(self._grid, self._chip, window)
        if self._exposed is not None:
            out *= self._exposed[columns]
        if self._lab is not None:
            out *= self._lab.part(*window.slices)
        if self._prnu is not None:
            pixel_response(out, self._chip, window, self._prnu)
        if self._master is not None:
            out *= self._master[rows, columns]
        return out

    def at(self, row: IntArray, column: IntArray) -> FloatArray:
        """Return float32 (n,), of single pixels of the window: the numbers of `rows`. row, column: int (n,)."""
        from csstsim.optics.throughput.coarse_grid import pick

        window = self._window
        x = column + window.x0
        y = row + window.y0
        out = np.ones(len(row), np.float32) if self._grid is None else pick(self._grid, self._chip, x, y)
        if self._exposed is not None:
            out *= self._exposed[column]
        if self._lab is not None:
            out *= self._lab.at(y, x)
        own = self._chip.maps.prnu
        if self._prnu is not None and own:
            out *= own.at(y, x)
        elif self._prnu is not None:
            pixels.multiply_at(out, x, y, self._chip.detector.prnu, self._prnu)
        if self._master is not None:
            out *= self._master[row, column]
        return out
