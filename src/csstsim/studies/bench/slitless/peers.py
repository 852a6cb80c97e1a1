"""Spectra by the paper's method, as `prepare(setting, case) -> draw(copies)` (see methods.py).

* `paper` (sections 4.2 and 5.3): the object is rendered in each sub-band as by bench.imaging.peers. Then the flux of
  each pixel is spread along the trace as by aXe, divided by area among the pixels that the shifted pixel overlaps.
  Only the first order is rendered; csstsim's methods render all five, but the window has only the first.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import galsim
import numpy as np
from scipy.signal import fftconvolve

from csstsim.base.types import BoolArray, FloatArray
from csstsim.studies.bench.imaging.peers import BANDS, galaxy_of, interpolated
from csstsim.studies.bench.setting import disperser_of

if TYPE_CHECKING:
    from csstsim.render.scene import Scene
    from csstsim.studies.bench.setting import Setting
    from csstsim.studies.bench.slitless.cases import SpectrumCase
    from csstsim.studies.bench.sweep import Draw


class Trace(NamedTuple):
    """Bins of a dispersed spectrum, each field (n,): offsets from the object [px], and electrons."""

    dx: FloatArray
    dy: FloatArray
    electrons: FloatArray

    def take(self, bins: BoolArray) -> Trace:
        """Return the Trace of some bins."""
        return Trace(self.dx[bins], self.dy[bins], self.electrons[bins])


def trace(setting: Setting, case: SpectrumCase) -> Trace:
    """Return the Trace of the first order."""
    disperser = disperser_of(setting)
    first = disperser.orders.index(1)
    p, q, r, s = disperser.lines(case.visits, case.scene.x, case.scene.y)[0, first]
    centres = 0.5 * (disperser.edges[1:] + disperser.edges[:-1])
    return Trace(p + q * centres, r + s * centres, case.binned_density * disperser.rates[case.visits[0, 1], first])


def cells(setting: Setting, scene: Scene, band: int) -> FloatArray:
    """Return the cells of the PSF at the object's position in one sub-band."""
    return sum(w * setting.psf.node(n)[band] for n, w in zip(scene.node[0], scene.weight[0], strict=True))


def paper(setting: Setting, case: SpectrumCase) -> Draw:
    """Return draw(copies) by the paper's method: one stamp per sub-band, laid along the trace pixel by pixel."""
    scene = case.scene
    window = case.window
    per_pixel = setting.psf.oversampling
    reach = int(case.row["reach"][0])
    spectrum = trace(setting, case)
    centres = 0.5 * (disperser_of(setting).edges[1:] + disperser_of(setting).edges[:-1])
    band_of = np.searchsorted(setting.filter.edges[1:-1], centres)
    column = round(scene.x[0])
    row = round(scene.y[0])

    def draw(copies: int) -> FloatArray:
        image = np.zeros(window.shape)
        for _ in range(copies):
            for band in range(BANDS):
                point = interpolated(cells(setting, scene, band), per_pixel)
                profile = point if case.star else galsim.Convolve(galaxy_of(scene), point)
                stamp = galsim.ImageD(2 * reach + 1, 2 * reach + 1)
                profile.drawImage(stamp, scale=1.0, offset=(scene.x[0] - column, scene.y[0] - row))
                bins = spectrum.take(band_of == band)
                _disperse(image, stamp.array, column - reach - window.x0, row - reach - window.y0, bins)
        return image

    return draw


def _disperse(image: FloatArray, stamp: FloatArray, x0: int, y0: int, bins: Trace) -> None:
    """Add the stamp at each of the bins; a shifted pixel is divided by area among four. Its corner lies at x0, y0."""
    x = np.floor(bins.dx).astype(int)
    y = np.floor(bins.dy).astype(int)
    a = bins.dx - x
    b = bins.dy - y
    first = x.min()
    bottom = y.min()
    shifts = np.zeros((np.ptp(y) + 2, np.ptp(x) + 2))
    for i, j, fraction in ((0, 0, (1 - a) * (1 - b)), (1, 0, a * (1 - b)), (0, 1, (1 - a) * b), (1, 1, a * b)):
        np.add.at(shifts, (y - bottom + j, x - first + i), bins.electrons * fraction)
    spread = fftconvolve(stamp, shifts)
    add(image, spread, x0 + first, y0 + bottom)


def add(image: FloatArray, stamp: FloatArray, x0: int, y0: int) -> None:
    """Add the part of a stamp that falls on the image; the stamp's corner lies at x0, y0."""
    left = max(x0, 0)
    right = min(x0 + stamp.shape[1], image.shape[1])
    low = max(y0, 0)
    high = min(y0 + stamp.shape[0], image.shape[0])
    if left < right and low < high:
        image[low:high, left:right] += stamp[low - y0 : high - y0, left - x0 : right - x0]
