"""Charges that a raw frame may have had before charge transfer, without the read noise.

Traps fill up to the largest charge that passes. The charge that a frame shows includes read noise, which the silicon
did not have, so it fills too many traps, and objects would lose too little charge. Therefore the charge s of a pixel
that shows q = s + read noise is sampled. Near the background b, s is Poisson, approximately normal of mean and
variance b:

    s = b + b / (b + r^2) (q - b) + z sqrt(b r^2 / (b + r^2)),   r the read noise, z normal.

Pixels far from the background keep the charge that they show. The charge that the transfer moved is subtracted from q
first; the layer itself computes it for a first sample. Two charges are sampled, with opposite z. The mean effect of the
detector on them has no bias, and less noise than the effect on one (docs/injection.md).
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

# Of the paper's traps: with fewer, the shown charge gives the same to 0.05 sigma of a pixel, at less than half the cost
DENSITY_MIN = 0.1
NEAR_BACKGROUND = 4.0  # sigma: pixels nearer to the background than this are sampled


def likely_charges(run: OpenCampaign, job: Job, shown: FloatArray, streams: Streams) -> Iterator[FloatArray]:
    """Yield equally likely arrays of electrons (ny, nx) float32 that a job's raw frame may have had.

    shown: electrons that its pixels show (level0.charge_in), not below 0; streams: rng.Streams of the injection.
    Without charge transfer, or with fewer traps than DENSITY_MIN, only `shown` is yielded.
    """
    steps = run.steps[job.pointing.type]
    traps = steps.step("cte_effect")
    if traps is None or traps.param.density_scale < DENSITY_MIN:
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
        for final in (False, True):
            charge = _sampled_charge(shown, moved, level, noise, sign, key, *corner, *normal_table())
            if final:
                break
            moved = charge.copy()
            transfer(moved, detector, job.window, rng, density=traps.param.density_scale, serial=traps.param.serial)
            moved -= charge
        del moved
        yield charge


@numba.njit(cache=True)
def _sampled_charge(
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
    """Return a sampled charge; moved: electrons moved into each pixel, or of size 0; level: of BIN x BIN pixels."""
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
            if variance > 0 and (value - mean) ** 2 < NEAR_BACKGROUND**2 * variance:
                spread = math.sqrt(mean * noise**2 / variance)
                value = round(mean + mean / variance * (value - mean) + sign * z[x] * spread)
            out[y, x] = max(value, 0.0)
    return out
