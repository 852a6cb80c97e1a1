"""Light through the detector into a Level-0 frame: the readout with the injected electrons minus the readout without.

The layers of the readout run twice, with their own fixed patterns: on the charge that the frame shows (DN minus bias,
times gain, corrected for nonlinearity), and on this charge with the injected electrons. The difference of the two, in
DN, is added to the frame, whose noise does not change. Charge transfer depends on noise in the charge: with many traps,
layers run on charges that the frame may have had (inject.likely_charge), and the mean difference is added. The
brighter-fatter effect has already moved the shown charge, which matters only in second order (docs/injection.md).
The charge of a DN is known to half a step; the sum is rounded with a random fraction, as the converter rounds.
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

# Layers that add charge or noise independent of the light: it cancels in the difference
WITHOUT_LIGHT = {"poisson_and_dark", "cosmic_rays", "bias", "readout_noise"}


@dataclass(frozen=True, eq=False)
class Injected:
    """A Level-0 frame with injected light: `frame` uint16 (readout.shape), `mask` new bits (same shape) or None.

    truth: ObjectTable; changed, saturated: pixels whose DN changed, and that reached the converter's maximum.
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
    changed, saturated = convert(frame, added, light.streams.exposure_key("converter"), run.camera.detector.adc_max)
    return Injected(frame, mask, truth, changed, saturated)


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
    new_bits = None
    differences: list[FloatArray] = []
    for charge in likely_charges(run, job, charge_in(run, file), light.streams):
        before = _read_out(run, job, [charge.copy()])
        charge.reshape(-1)[light.pixel] += light.electrons
        if job.chip.kind == "imaging" and not differences:
            truth = flag_saturated(truth, charge, None, job.window, run.camera.detector.full_well)
        after = _read_out(run, job, [charge])
        del charge
        if after.mask is not None and before.mask is not None:
            new_bits = after.mask & ~before.mask | (0 if new_bits is None else new_bits)
        after.image -= before.image
        differences.append(after.image)
    added = differences.pop(0)
    for term in differences:
        added += term
    added /= 1 + len(differences)
    if file.layout == "chip":  # its channels have one gain
        readout = ReadoutFrame.of(run.camera.detector, job.window)
        for block in readout.blocks:
            added[block.whole] *= after.header["gain"][block.channel - 1] / file.gain[block.channel]
        added = readout.active(added)
        new_bits = None if new_bits is None else readout.active(new_bits)
    return AddedLight(added, new_bits, truth)


def charge_in(run: OpenCampaign, file: Level0) -> FloatArray:
    """Return the electrons (ny, nx) float32 that the pixels of a Level-0 file show, negative ones as 0.

    Raises InputError.
    """
    detector = run.camera.detector
    calibrated = calibrate(
        file.frame(),
        file.readout,
        Electronics.of(file, detector),
    )
    return np.maximum(calibrated.electrons, np.float32(0.0), out=calibrated.electrons)


def _read_out(run: OpenCampaign, job: Job, charge: list[FloatArray]) -> State:
    """Return the State after the readout (DN) of electrons (ny, nx), which are removed from the list `charge`."""
    steps = run.steps[job.pointing.type]
    streams = run.streams(job)
    state = State.blank(job.exposure)
    state.image = charge.pop()
    for step in steps.stage("readout"):
        if step.name not in WITHOUT_LIGHT:
            state = step.module.apply(state, step.param, streams.layer(step.name))
            _, state.unit = step.module.UNITS
    return state


@numba.njit(cache=True)
def convert(frame: IntArray, added: FloatArray, key: np.uint64, top: int) -> tuple[int, int]:
    """Add DN (float32) to a frame (uint16, same shape), in place; return (pixels changed, pixels that reached `top`).

    Each sum is rounded with a random fraction within half a DN. A pixel at the converter's maximum, `top`, stays there,
    because its charge is unknown. key: uint64.
    """
    dn = frame.reshape(-1)
    added_dn = added.reshape(-1)
    changed = 0
    saturated = 0
    for i in range(dn.size):
        if added_dn[i] == 0 or dn[i] >= top:
            continue
        before = dn[i]
        value = np.rint(np.float64(before) + np.float64(added_dn[i]) + unit(word(key, np.uint64(i))) - 0.5)
        dn[i] = min(max(value, 0.0), top)
        changed += dn[i] != before
        saturated += dn[i] >= top
    return changed, saturated
