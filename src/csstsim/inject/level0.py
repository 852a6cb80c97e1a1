"""Light through the detector into a Level-0 frame: what the readout makes of the charge with it, less without it.

The layers of the readout run twice, with their own fixed patterns: on the charge that the frame shows (DN less bias,
times gain, nonlinearity undone), and on this charge with the injected electrons. The difference of the two, in DN, is
added to the frame, whose noise stays as it is. The charge that the frame shows has been moved by charge transfer and
the brighter-fatter effect already, and has read noise in it. This enters the difference in second order only: undoing
the movement first changes it by less than can be measured (docs/injection.md). A DN hides up to half a step of charge;
the sum is rounded with a random fraction, as the converter would have rounded it.
"""

from dataclasses import dataclass

import numpy as np

from csstsim.detector.channels import ReadoutFrame
from csstsim.inject.shot import fractions
from csstsim.measure.calibration.calibrate import calibrate
from csstsim.render.imaging.saturated import flag_saturated
from csstsim.simulation.state import State

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


def into_level0(run, job, file, light):
    """Return the Injected of a job's io.level0.Level0 and a light.Light; the file stays as it is. Raises InputError."""
    added, mask, truth = difference(run, job, file, light)
    raw, top = file.frame(), run.camera.detector.adc_max
    frame = converted(raw, added, light.streams.exposure_key("converter"), top)
    full = int(np.count_nonzero(frame >= top)) - int(np.count_nonzero(raw >= top))
    return Injected(frame, mask, truth, int(np.count_nonzero(frame != raw)), full)


def difference(run, job, file, light):
    """Return (DN that a Light adds to a Level-0 file, float32; new bits of its mask or None; ObjectTable of the light).

    Arrays have the shape of file.frame(). Raises InputError.
    """
    charge, truth = charge_in(run, file), light.truth
    before = _read_out(run, job, charge.copy())
    charge.reshape(-1)[light.pixel] += light.electrons
    if job.chip.kind == "imaging":
        truth = flag_saturated(truth, charge, None, job.window, run.camera.detector.full_well)
    after = _read_out(run, job, charge)
    added, new = after.image, None if after.mask is None else after.mask & ~before.mask
    added -= before.image
    if file.layout == "chip":  # its channels have one gain
        readout = ReadoutFrame.of(run.camera.detector, job.window)
        for block in readout.blocks:
            added[block.whole] *= after.header["gain"][block.channel - 1] / file.gain[block.channel]
        added, new = readout.active(added), None if new is None else readout.active(new)
    return added, new, truth


def charge_in(run, file):
    """Return the electrons (ny, nx) float32 that the pixels of a Level-0 file show, negative ones as 0.

    Raises InputError.
    """
    detector = run.camera.detector
    seen = calibrate(
        file.frame(), file.readout, file.gain, nonlinearity=file.nonlinearity, adc_max=detector.adc_max,
        full_well=detector.full_well, levels=file.levels,
    )  # fmt: skip
    return np.maximum(seen.electrons, np.float32(0.0), out=seen.electrons)


def _read_out(run, job, charge):
    """Return the State after the readout (DN) of electrons (ny, nx), which are changed in place."""
    steps, streams = run.steps[job.pointing.type], run.streams(job)
    state = State.blank(job.exposure)
    state.image = charge
    for step in steps.stage("readout"):
        if step.name not in ALIKE:
            state = step.module.apply(state, step.param, streams.layer(step.name))
            state.unit = step.module.UNITS[1]
    return state


def converted(raw, added, key, adc_max):
    """Return uint16 DN of a frame (uint16) with `added` DN (float32, same shape), each rounded with a random fraction.

    A pixel at the converter's end stays there: how much charge it had is not known. key: uint64.
    """
    frame = raw.copy()
    at = np.flatnonzero((added.reshape(-1) != 0) & (raw.reshape(-1) < adc_max))
    value = raw.reshape(-1)[at] + fractions(at.astype(np.uint64), key) + added.reshape(-1)[at]
    frame.reshape(-1)[at] = np.clip(np.rint(value), 0, adc_max).astype(np.uint16)
    return frame
