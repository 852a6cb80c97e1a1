"""Errors of a spectrum's image: the result of a fit of the true image, moved and widened.

The truth T, moved by a small step or widened, is fitted to an image T + d. For a template t,

    value = sum w t d / sum w t^2,    w = 1 / (light + variance),

with t = -dT/dx for `along_px`, -dT/dy for `across_px` and d2T/dy2 / 2 for `size2`, the square of the width across the
trace, relative to the truth's. For `line_px` and `line_width2` [px^2], t = -dT/dx and d2T/dx2 / 2 about the brightest
line of a spectrum with lines; NaN for others. `flux` is the sum's relative error. `pixel` and `visible` are those of
bench.imaging.measures; rows at the edge of the PSF's box are excluded as pixels are there. The other measures are
linear, so their statistical errors are known.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from csstsim.base.types import BoolArray, FloatArray
from csstsim.studies.bench.imaging.measures import EDGE_PX, visible
from csstsim.studies.bench.setting import disperser_of

if TYPE_CHECKING:
    from csstsim.studies.bench.setting import Setting
    from csstsim.studies.bench.slitless.cases import SpectrumCase

NAMES = ("flux", "along_px", "across_px", "size2", "line_px", "line_width2", "pixel", "visible")
GOALS = {"flux": 1e-3, "along_px": 0.1, "across_px": 0.01, "size2": 1e-3, "line_px": 0.01, "line_width2": 0.01}
LINE_HALF = 12  # px on each side of a line


class _Template(NamedTuple):
    """A template t (ny, nx), the factor of its fitted value, and the pixels of the fit; None: an unweighted sum."""

    image: FloatArray
    scale: float
    pixels: BoolArray | None


def errors(
    setting: Setting, case: SpectrumCase, image: FloatArray, truth: FloatArray, drawn: float
) -> tuple[FloatArray, FloatArray]:
    """Return (errors, their statistical errors), each (8,), in the order of NAMES, of an image per unit of flux."""
    box = setting.psf.image.shape[-1] / 2 / setting.psf.oversampling
    rows = np.abs(np.arange(len(truth)) - (len(truth) - 1) / 2)
    counted = np.broadcast_to((np.abs(rows - box) > EDGE_PX)[:, None], truth.shape)
    weight = counted / (case.electrons * np.maximum(truth, 0) + setting.variance)
    difference = image - truth
    near_line = _near_line(setting, case, truth)
    templates = [
        _Template(np.ones_like(truth), 1 / truth.sum(), None),
        _Template(-derivative(truth, 1), 1.0, counted),
        _Template(-derivative(truth, 0), 1.0, counted),
        _Template(derivative(derivative(truth, 0), 0) / 2, 1 / _width2(truth), counted),
        _Template(-derivative(truth, 1), 1.0, near_line),
        _Template(derivative(derivative(truth, 1), 1) / 2, 1.0, near_line),
    ]
    pairs = []
    for template in templates:
        filter = template.image
        norm = template.scale
        if template.pixels is not None:
            filter = template.image * weight * template.pixels
            norm = template.scale / max((filter * template.image).sum(), 1e-300)
            if not template.pixels.any():
                norm = np.nan
        chance = np.sqrt((filter**2 * np.maximum(truth, 0)).sum() / drawn)
        pairs.append(((filter * difference).sum() * norm, chance * abs(norm)))
    peak = np.unravel_index(np.abs(difference * counted).argmax(), truth.shape)
    peak_chance = np.sqrt(max(float(truth[peak]), 0.0) / drawn)
    pairs.append((abs(difference[peak]) / truth.max(), peak_chance / truth.max()))
    pairs.append(visible(image, truth, setting.variance, case.electrons, drawn, counted))
    return tuple(np.transpose(pairs))


def derivative(image: FloatArray, axis: int) -> FloatArray:
    """Return d(image) / d(pixel) along an axis, by Fourier transform."""
    k = 2j * np.pi * np.fft.rfftfreq(image.shape[axis])
    spectrum = np.fft.rfft(image, axis=axis) * (k if axis == 1 else k[:, None])
    return np.fft.irfft(spectrum, image.shape[axis], axis=axis)


def _width2(truth: FloatArray) -> float:
    """Return the mean square width [px^2] of the truth across the trace, in a Gaussian window of 3 px."""
    rows = np.arange(len(truth)) - (len(truth) - 1) / 2
    profile = truth.sum(axis=1) * np.exp(-0.5 * (rows / 3.0) ** 2)
    mean = (profile * rows).sum() / profile.sum()
    return (profile * (rows - mean) ** 2).sum() / profile.sum()


def _near_line(setting: Setting, case: SpectrumCase, truth: FloatArray) -> BoolArray:
    """Return a mask of the pixels about the brightest line; none without lines."""
    out = np.zeros(truth.shape, bool)
    if len(case.lines):
        brightest, *_ = case.lines
        disperser = disperser_of(setting)
        p, q, _, _ = disperser.lines(case.visits, case.scene.x, case.scene.y)[0, disperser.orders.index(1)]
        at = round(case.scene.x[0] + p + q * brightest) - case.window.x0
        out[:, max(at - LINE_HALF, 0) : at + LINE_HALF + 1] = True
    return out
