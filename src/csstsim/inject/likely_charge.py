"""Charges that a raw frame allows, before charge transfer moved them: what the traps met, without the read noise.

Traps fill up to the highest charge that passes. The charge that a frame shows has read noise in it, which never was in
the silicon, and fills too many: objects would lose too little. So the charge is drawn anew, as a pixel s that shows
q = s + read noise may have had it. About the background b, s is Poisson, hence about normal of mean b and variance b:

    s = b + b / (b + r^2) (q - b) + z sqrt(b r^2 / (b + r^2)),   r the read noise, z normal.

Pixels far from the background keep what they show. What the transfer moved comes off q first: it follows from a first
draw, by the layer itself. Two charges are drawn, with opposite z. The mean of what the detector does with them has no
bias, and less noise than one alone (docs/injection.md).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numba
import numpy as np

from csstsim.detector.charge_transfer.transfer import transfer
from csstsim.detector.random.normal import normal_row, normal_table
from csstsim.measure.detection.background import crude_background
from csstsim.measure.detection.maps import BIN, binned

if TYPE_CHECKING:
    from collections.abc import Iterator

    from csstsim.base.rng import Streams
    from csstsim.base.types import FloatArray
    from csstsim.campaign.job import Job
    from csstsim.campaign.opened import OpenCampaign

FEW = 0.1  # of the paper's traps: with fewer, what is shown does, to 0.05 sigma of a pixel, at less than half the cost
NEAR = 4.0  # sigma: pixels within it of the background are drawn anew


def likely_charges(run: OpenCampaign, job: Job, shown: FloatArray, streams: Streams) -> Iterator[FloatArray]:
    """Yield arrays of electrons (ny, nx) float32, each as likely as another, that a job's raw frame may have had.

    shown: what its pixels show (level0.charge_in), not below 0; streams: rng.Streams of the injection. Without charge
    transfer, or with FEW traps, `shown` is the only one.
    """
    steps = run.steps[job.pointing.type]
    traps = steps.step("cte_effect")
    if traps is None or traps.param.density_scale < FEW:
        yield shown
        return
    detector = run.camera.detector
    rng = run.streams(job).layer(traps.name)
    noise = detector.read_noise if steps.step("readout_noise") else 0.0
    level = crude_background(binned(shown))[0]
    key = streams.exposure_key("charge")
    corner = (job.window.y0, job.window.x0)
    for sign in (1.0, -1.0):
        moved = np.zeros((0, 0), np.float32)
        for last in (False, True):
            charge = _drawn(shown, moved, level, noise, sign, key, *corner, *normal_table())
            if last:
                break
            moved = charge.copy()
            transfer(moved, detector, job.window, rng, density=traps.param.density_scale, serial=traps.param.serial)
            moved -= charge
        del moved
        yield charge


@numba.njit(cache=True)
def _drawn(
    shown: FloatArray,
    moved: FloatArray,
    level: FloatArray,
    noise: float,
    sign: float,
    key: np.uint64,
    y0: int,
    x0: int,
    start: FloatArray,
    step: FloatArray,
) -> FloatArray:
    """Return a charge; moved: what was moved into each pixel, or of size 0; level: background of BIN x BIN pixels."""
    ny, nx = shown.shape
    out = np.empty_like(shown)
    z = np.empty(nx, np.float32)
    halves = np.empty(nx + 2, np.uint32)
    for y in range(ny):
        normal_row(key, y0 + y, x0, halves, z, start, step)
        line = level[min(y // BIN, level.shape[0] - 1)]
        for x in range(nx):
            value = shown[y, x] - (moved[y, x] if moved.size else np.float32(0.0))
            mean = max(line[min(x // BIN, line.size - 1)] / np.float32(BIN**2), np.float32(0.0))
            variance = mean + noise**2
            if variance > 0 and (value - mean) ** 2 < NEAR**2 * variance:
                spread = math.sqrt(mean * noise**2 / variance)
                value = round(mean + mean / variance * (value - mean) + sign * z[x] * spread)
            out[y, x] = max(value, 0.0)
    return out
