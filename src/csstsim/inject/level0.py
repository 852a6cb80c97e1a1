"""Light through the detector into a Level-0 frame: what the readout makes of the charge with it, less without it.

The charge of the frame is undone as `calibrate` does, up to the flat field: DN, bias, gain, nonlinearity, charge
transfer, brighter-fatter. The layers of the readout then run twice, with their own fixed patterns: on this charge, and
on this charge with the injected electrons. The difference of the two, in DN, is added to the frame. The noise in the
frame stays as it is, and an error of the undone charge enters the difference only in second order. A DN hides up to half
a step of charge; the sum is rounded with a random fraction, as the converter would have rounded it.
"""

from dataclasses import dataclass

import numpy as np

from csstsim.inject.shot import fractions
from csstsim.render.imaging.saturated import flag_saturated
from csstsim.simulation.state import State
from csstsim.stages.calibrate import calibrated_of

# Layers that add charge or noise which does not depend on the light: both runs would have the same
ALIKE = {"poisson_and_dark", "cosmic_rays", "bias", "readout_noise"}


@dataclass(frozen=True, eq=False)
class Injected:
    """A Level-0 frame with injected light: `frame` uint16 (readout.shape), `mask` new bits (same shape) or None.

    truth: ObjectTable; changed, saturated: numbers of pixels whose DN changed, and that reached the converter's end.
    """

    frame: np.ndarray
    mask: np.ndarray | None
    truth: object
    changed: int
    saturated: int


def into_level0(run, job, file, light, passes=None):
    """Return the Injected of an io.level0.Level0 of a job and a light.Light; the file stays as it is.

    passes: of the correction of charge transfer [default: the campaign's]. Raises InputError.
    """
    raw = file.frame()
    charge = charge_in(run, job, file, passes)
    without, marks = read_out(run, job, charge.copy())
    charge.reshape(-1)[light.pixel] += light.electrons
    truth = light.truth
    if job.chip.kind == "imaging":
        truth = flag_saturated(truth, charge, None, job.window, run.camera.detector.full_well)
    added, new_marks = read_out(run, job, charge)
    added -= without
    del without
    before = int(np.count_nonzero(raw >= run.camera.detector.adc_max))
    frame = converted(raw, added, light.streams.exposure_key("converter"), run.camera.detector.adc_max)
    after = int(np.count_nonzero(frame >= run.camera.detector.adc_max))
    mask = None if marks is None else new_marks & ~marks
    return Injected(frame, mask, truth, int(np.count_nonzero(frame != raw)), after - before)


def charge_in(run, job, file, passes=None):
    """Return the electrons (ny, nx) float32 that the pixels of a Level-0 file held before they were moved.

    Read noise is in them as if it were charge; negative ones are 0. Raises InputError.
    """
    return np.maximum(calibrated_of(run, job, file, passes=passes).electrons, np.float32(0.0))


def read_out(run, job, charge):
    """Return (DN, float32 of the readout frame; mask or None) of electrons (ny, nx), which are changed in place."""
    steps, streams = run.steps[job.pointing.type], run.streams(job)
    state = State.blank(job.exposure)
    state.image = charge
    for step in steps.stage("readout"):
        if step.name not in ALIKE:
            state = step.module.apply(state, step.param, streams.layer(step.name))
            state.unit = step.module.UNITS[1]
    return state.image, state.mask


def converted(raw, added, key, adc_max):
    """Return uint16 DN of a frame (uint16) with `added` DN (float32, same shape), each rounded with a random fraction.

    A pixel at the converter's end stays there: how much charge it had is not known. key: uint64.
    """
    frame = raw.copy()
    at = np.flatnonzero((added.reshape(-1) != 0) & (raw.reshape(-1) < adc_max))
    value = raw.reshape(-1)[at] + fractions(at.astype(np.uint64), key) + added.reshape(-1)[at]
    frame.reshape(-1)[at] = np.clip(np.rint(value), 0, adc_max).astype(np.uint16)
    return frame
