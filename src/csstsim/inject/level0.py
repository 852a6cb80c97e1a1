"""Light through the detector into a Level-0 frame: what the readout makes of the charge with it, less without it.

The layers of the readout run twice, with their own fixed patterns: on the charge that the frame shows (DN less bias,
times gain, nonlinearity undone), and on this charge with the injected electrons. The difference of the two, in DN, is
added to the frame, whose noise stays as it is. Charge transfer depends on noise in the charge: with many traps, layers
run on charges that the frame may have had (inject.likely_charge), and the mean difference is added. That the
brighter-fatter effect has moved the shown charge already enters in second order only (docs/injection.md). A DN hides up
to half a step of charge; the sum is rounded with a random fraction, as the converter would have rounded it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numba
import numpy as np

from csstsim.base.counter import unit, word
from csstsim.base.types import FloatArray, IntArray
from csstsim.detector.channels import ReadoutFrame
from csstsim.inject.likely_charge import likely_charges
from csstsim.measure.calibration.calibrate import Electronics, calibrate
from csstsim.render.imaging.saturated import flag_saturated
from csstsim.simulation.state import State

if TYPE_CHECKING:
    from csstsim.campaign.job import Job
    from csstsim.campaign.opened import OpenCampaign
    from csstsim.catalog.table import ObjectTable
    from csstsim.inject.light import Light
    from csstsim.io.level0 import Level0

# Layers that add charge or noise which does not depend on the light: both runs would have the same
ALIKE = {"poisson_and_dark", "cosmic_rays", "bias", "readout_noise"}


@dataclass(frozen=True, eq=False)
class Injected:
    """A Level-0 frame with injected light: `frame` uint16 (readout.shape), `mask` new bits (same shape) or None.

    truth: ObjectTable; changed, saturated: numbers of pixels whose DN changed, and that reached the converter's end.
    """

    frame: IntArray
    mask: IntArray | None
    truth: ObjectTable
    changed: int
    saturated: int


def into_level0(run: OpenCampaign, job: Job, file: Level0, light: Light) -> Injected:
    """Return the Injected of a job's io.level0.Level0 and a light.Light; the file stays as it is. Raises InputError."""
    added, mask, truth = difference(run, job, file, light)
    frame = file.frame()
    changed, full = convert(frame, added, light.streams.exposure_key("converter"), run.camera.detector.adc_max)
    return Injected(frame, mask, truth, changed, full)


class AddedLight(NamedTuple):
    """What a Light changes in a Level-0 file, arrays of the shape of file.frame().

    `added`: DN, float32; `mask`: new bits or None; `truth`: ObjectTable of the light.
    """

    added: FloatArray
    mask: IntArray | None
    truth: ObjectTable


def difference(run: OpenCampaign, job: Job, file: Level0, light: Light) -> AddedLight:
    """Return what a Light changes in a Level-0 file. Raises InputError."""
    truth = light.truth
    new = None
    parts: list[FloatArray] = []
    for charge in likely_charges(run, job, charge_in(run, file), light.streams):
        before = _read_out(run, job, [charge.copy()])
        charge.reshape(-1)[light.pixel] += light.electrons
        if job.chip.kind == "imaging" and not parts:
            truth = flag_saturated(truth, charge, None, job.window, run.camera.detector.full_well)
        after = _read_out(run, job, [charge])
        del charge
        if after.mask is not None and before.mask is not None:
            new = after.mask & ~before.mask | (0 if new is None else new)
        after.image -= before.image
        parts.append(after.image)
    added = parts.pop(0)
    for part in parts:
        added += part
    added /= 1 + len(parts)
    if file.layout == "chip":  # its channels have one gain
        readout = ReadoutFrame.of(run.camera.detector, job.window)
        for block in readout.blocks:
            added[block.whole] *= after.header["gain"][block.channel - 1] / file.gain[block.channel]
        added = readout.active(added)
        new = None if new is None else readout.active(new)
    return AddedLight(added, new, truth)


def charge_in(run: OpenCampaign, file: Level0) -> FloatArray:
    """Return the electrons (ny, nx) float32 that the pixels of a Level-0 file show, negative ones as 0.

    Raises InputError.
    """
    detector = run.camera.detector
    seen = calibrate(
        file.frame(),
        file.readout,
        Electronics.of(file, detector),
    )
    return np.maximum(seen.electrons, np.float32(0.0), out=seen.electrons)


def _read_out(run: OpenCampaign, job: Job, charge: list[FloatArray]) -> State:
    """Return the State after the readout (DN) of electrons (ny, nx), taken from a list so that nobody else has them."""
    steps = run.steps[job.pointing.type]
    streams = run.streams(job)
    state = State.blank(job.exposure)
    state.image = charge.pop()
    for step in steps.stage("readout"):
        if step.name not in ALIKE:
            state = step.module.apply(state, step.param, streams.layer(step.name))
            _, state.unit = step.module.UNITS
    return state


@numba.njit(cache=True)
def convert(frame: IntArray, added: FloatArray, key: np.uint64, top: int) -> tuple[int, int]:
    """Add DN (float32) to a frame (uint16, same shape), in place; return (pixels changed, pixels that came to `top`).

    Each sum is rounded with a random fraction within half a DN. A pixel at the converter's end, `top`, stays there: how
    much charge it had is not known. key: uint64.
    """
    raw = frame.reshape(-1)
    more = added.reshape(-1)
    changed = 0
    full = 0
    for i in range(raw.size):
        if more[i] == 0 or raw[i] >= top:
            continue
        before = raw[i]
        value = np.rint(np.float64(before) + np.float64(more[i]) + unit(word(key, np.uint64(i))) - 0.5)
        raw[i] = min(max(value, 0.0), top)
        changed += raw[i] != before
        full += raw[i] >= top
    return changed, full
