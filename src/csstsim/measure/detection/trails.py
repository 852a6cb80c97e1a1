"""Trails of moving objects: isophotes that are as narrow as the PSF and evenly bright along a line.

Along the line, the light of a trail is a box: the fourth moment over the squared second is 9/5, more with the PSF.
Two equal points have 1 to 1.7, unequal ones are skew, and discs and bars have more than 2.3.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numba
import numpy as np

from csstsim.base.types import AnyArray, BoolArray, FloatArray, IntArray
from csstsim.measure.detection.maps import BIN
from csstsim.measure.light.centroid import windowed_positions

if TYPE_CHECKING:
    from csstsim.measure.detection.detect import Frame

LENGTH_MIN = 3.9  # px, rms along the line: a trail of 13 px. Pairs that may look alike are closer
WIDTH = 0.7, 1.8  # rms across, over that of the PSF on binned pixels: a cosmic ray's track is narrower
EVEN = 1.7, 2.1  # fourth moment over the squared second
SKEWNESS_MAX = 0.25  # third moment over the second to the power 3/2
FAINTEST = 0.15  # of the brightest bin
SNR_MIN = 15.0  # of the isophote's flux: the moments of fainter ones are noise


def with_trails(frame: Frame, kernel: FloatArray) -> tuple[Frame, BoolArray]:
    """Return (frame, bool (m,)): a detect.Frame with the positions of trails, and which isophotes are trails.

    The window of a trail's position is as long as the trail: along the line, a shorter one finds no centre. Where it
    drifts farther, to a neighbour or away, the position is that of the isophote. kernel: the PSF (n, n), n odd.
    """
    isophotes = frame.extended
    length = _lengths(frame, kernel)
    is_trail = length > 0.0
    window = np.where(is_trail, length, isophotes.window)
    before_x, before_y, size = isophotes.x[is_trail], isophotes.y[is_trail], window[is_trail]
    x, y, failed = windowed_positions(frame.image, before_x, before_y, size)
    failed |= ~(np.hypot(x - before_x, y - before_y) < size)
    new = {"x": np.where(failed, before_x, x), "y": np.where(failed, before_y, y), "window_failed": failed}
    columns = {name: _replaced(getattr(isophotes, name), is_trail, values) for name, values in new.items()}
    return replace(frame, extended=replace(isophotes, window=window, **columns)), is_trail


def _replaced(values: AnyArray, rows: BoolArray, new: AnyArray) -> AnyArray:
    out = values.copy()
    out[rows] = new
    return out


def _lengths(frame: Frame, kernel: FloatArray) -> FloatArray:
    """Return (m,): the rms along the line [px] of the isophotes that are trails, 0 of others."""
    isophotes = frame.extended
    moments = _moments(frame.image, frame.segments, isophotes.x, isophotes.y, isophotes.theta)
    axis = np.arange(len(kernel)) - len(kernel) // 2
    psf = float((kernel.sum(axis=0) * axis**2).sum() / kernel.sum()) + (BIN**2 - 1) / 12.0
    with np.errstate(invalid="ignore", divide="ignore"):
        flux = moments[:, 0]
        first, second, third, fourth, across = (one / flux for one in moments.T[1:])
        variance = second - first**2
        cube = third - 3.0 * first * second + 2.0 * first**3
        square = fourth - 4.0 * first * third + 6.0 * first**2 * second - 3.0 * first**4
        even = square / variance**2
        noise = np.sqrt(isophotes.area) * float(np.median(frame.rms[::4, ::4]))
        is_trail = (
            (flux > SNR_MIN * noise)
            & (variance > LENGTH_MIN**2)
            & (across > WIDTH[0] ** 2 * psf)
            & (across < WIDTH[1] ** 2 * psf)
            & (even > EVEN[0])
            & (even < EVEN[1])
            & (np.abs(cube) < SKEWNESS_MAX * variance**1.5)
        )
        return np.where(is_trail, np.sqrt(variance), 0.0)


@numba.njit(cache=True)
def _moments(image: FloatArray, segments: IntArray, x: FloatArray, y: FloatArray, theta: FloatArray) -> FloatArray:
    """Return (m, 6): the flux of isophotes times 1, u, u^2, u^3, u^4, v^2; u, v: px along and across `theta`.

    Bins fainter than FAINTEST of the brightest one are left out: the wings of the PSF.
    """
    out = np.zeros((x.size, 6))
    peak = np.zeros(x.size)
    for j in range(segments.shape[0]):
        for i in range(segments.shape[1]):
            k = segments[j, i] - 1
            if k >= 0:
                peak[k] = max(peak[k], _bin(image, j, i))
    cosine = np.cos(theta)
    sine = np.sin(theta)
    for j in range(segments.shape[0]):
        for i in range(segments.shape[1]):
            k = segments[j, i] - 1
            if k < 0:
                continue
            flux = _bin(image, j, i)
            if flux < FAINTEST * peak[k]:
                continue
            dx = BIN * i + 0.5 * (BIN - 1) - x[k]
            dy = BIN * j + 0.5 * (BIN - 1) - y[k]
            u = cosine[k] * dx + sine[k] * dy
            v = cosine[k] * dy - sine[k] * dx
            for power in range(5):
                out[k, power] += flux * u**power
            out[k, 5] += flux * v * v
    return out


@numba.njit(cache=True)
def _bin(image: FloatArray, j: int, i: int) -> float:
    """Return the sum of a bin of the image; a last odd row or column is a part of one."""
    total = 0.0
    for row in range(BIN * j, min(BIN * (j + 1), image.shape[0])):
        for column in range(BIN * i, min(BIN * (i + 1), image.shape[1])):
            total += image[row, column]
    return total
