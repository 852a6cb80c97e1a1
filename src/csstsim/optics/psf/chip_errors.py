"""Wavefront errors of one chip: the position of its detector and the figure of its filter (section 5.1.1).

* Detector: a height and two tilts relative to the camera's focal surface. A height dz is a defocus of dz / (8 N^2) of
  optical path at the edge of the pupil (N the focal ratio), that is dz / (16 sqrt(3) N^2) in Noll's Z4. It varies
  linearly over the chip.
* Filter: each chip has its own filter. Near the focus a star's beam crosses a small part of it, so only low orders
  matter. The part differs with position, so each coefficient is linear over the chip.

All are drawn once for the camera, with the rms in psf.yaml, from random streams named after the chip. Left out: wedge
(an image shift), chromatic focus and ghosts of the filter, curvature of a chip.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from csstsim.base.rng import stream
from csstsim.base.types import FloatArray, Floats
from csstsim.base.units import NM_PER_UM
from csstsim.optics.psf.wavefront import Wavefront, filter_noll, number

if TYPE_CHECKING:
    from csstsim.instrument.chip import Chip


def chip_coefficients(
    wavefront: Wavefront, params: Mapping[str, Any], chip: Chip, x: ArrayLike, y: ArrayLike
) -> FloatArray:
    """Return Zernike coefficients, nm, shape (..., J), at pixels x, y of a chip: the telescope's and the chip's own.

    `wavefront` from `load_wavefront(params)`. Raises InputError for a missing or negative number.
    """
    x = np.asarray(x, float)
    y = np.asarray(y, float)
    detector = chip.detector
    terms = np.stack([np.ones_like(x), (2 * x + 1) / detector.nx - 1, (2 * y + 1) / detector.ny - 1], axis=-1)
    of_chip = np.zeros((len(wavefront.noll), 3))
    of_chip[wavefront.noll.index(4)] += detector_defocus(params, chip)
    for noll, row in filter_figure(params, chip).items():
        of_chip[wavefront.noll.index(noll)] += row
    return wavefront.coefficients(*mosaic_position(chip, x, y)) + np.einsum("...k,jk->...j", terms, of_chip)


def mosaic_position(chip: Chip, x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Return the position in the mosaic (px, origin on the boresight) of chip pixels x, y."""
    turn = math.radians(chip.rotation)
    dx = x - (chip.detector.nx - 1) / 2
    dy = y - (chip.detector.ny - 1) / 2
    return chip.xc + math.cos(turn) * dx - math.sin(turn) * dy, chip.yc + math.sin(turn) * dx + math.cos(turn) * dy


def chip_position(chip: Chip, x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Return the chip pixels x, y of a position in the mosaic: the inverse of `mosaic_position`."""
    turn = math.radians(chip.rotation)
    dx = x - chip.xc
    dy = y - chip.yc
    middle_x = (chip.detector.nx - 1) / 2
    middle_y = (chip.detector.ny - 1) / 2
    return middle_x + math.cos(turn) * dx + math.sin(turn) * dy, middle_y - math.sin(turn) * dx + math.cos(turn) * dy


def detector_defocus(params: Mapping[str, Any], chip: Chip) -> FloatArray:
    """Return Z4 (nm) of a chip's height and two tilts: (3,) factors of 1, X, Y, which are +-1 at the chip's edges."""
    rms = np.array([number(params, "detector", key) for key in ("height", "tilt", "tilt")])
    height = rms * stream(0, "optics", "detector", chip.id).standard_normal(3)
    ratio = chip.telescope.focal_length_m / chip.telescope.diameter_m
    return NM_PER_UM * height / (16 * math.sqrt(3) * ratio**2)


def filter_figure(params: Mapping[str, Any], chip: Chip) -> dict[int, FloatArray]:
    """Return {Noll index: (3,) nm, factors of 1, X, Y} of the filter in front of a chip.

    `params` has the rms over the pupil, averaged over chips and over the chip's area.
    """
    rms = number(params, "filter_figure", "rms", chip.filter)
    noll = filter_noll(params)
    draw = stream(0, "optics", "filter", chip.id).standard_normal((len(noll), 3))
    # 1 + 1/3 + 1/3: the mean over the chip of 1 + X^2 + Y^2
    return dict(zip(noll, draw * rms / math.sqrt(len(noll) * 5 / 3), strict=True))
