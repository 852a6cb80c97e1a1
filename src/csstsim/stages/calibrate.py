"""Calibrate: Level-0 files to calibrated images, as `measurement` in a campaign says.

calibration: truth     the maps the simulator used: flat field, shutter, pixel response, defects, each trap
calibration: frames    masters of `csstsim masters` for pixel response and defects; flat field and shutter as above,
                       because a survey finds these from its own stars; other traps, of the same density
"""

import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.one_thread import one_thread
from csstsim.base.release import check_release
from csstsim.base.rng import Streams
from csstsim.stages.level0 import own_level0
from csstsim.stages.masters import masters_recipe
from csstsim.stages.psf import open_psf

PUSHES = 2  # passes of the brighter-fatter correction: charge moves by per cents, the second by per cents of those


@one_thread
def calibrate(run, job):
    """Write the calibrated image of an imaging chip's science exposure."""
    from csstsim.io.calibrated import write_calibrated
    from csstsim.measure.bad_pixels import mend
    from csstsim.measure.detect import subtract_background
    from csstsim.measure.photometry import psf_model

    if job.chip.kind != "imaging" or job.pointing.type != "SCIE":
        raise InputError(
            "only science exposures of imaging chips have calibrated images", file=run.file, key="chip",
            value=f"{job.chip.id} ({job.chip.filter}) in {job.pointing.type}",
        )  # fmt: skip
    file, frame = calibrated_frame(run, job)
    quality = mend(frame, psf_model(open_psf(run, job.chip), (job.window.x0, job.window.y0), job.window.shape))
    image, error, rate = frame.electrons, frame.sigma(), 1.0 / job.pointing.exptime
    background = float(np.median(image))
    subtract_background(image, quality > 0)
    background -= float(np.median(image))
    image *= rate
    error *= rate
    path, filter_ = run.paths.calibrated(*job.key), run.camera.filters[job.chip.filter]
    write_calibrated(
        path, file, job.wcs, (image, error, quality), background=background * rate,
        zeropoint=filter_.zeropoint(run.camera.telescope), read_noise=float(np.mean(list(frame.read_noise.values()))),
        settings=run.measurement,
    )  # fmt: skip
    print(f"{path}: {100 * (quality > 0).mean():.3f}% of the pixels are flagged")


def calibrated_frame(run, job):
    """Return (io.level0.Level0, measure.calibrate.Calibrated) of a job's file. Raises InputError."""
    from csstsim.measure.calibrate import calibrate as to_electrons

    file, streams = own_level0(run, job), run.streams(job, "measure")
    steps, detector = run.steps[job.pointing.type], run.camera.detector
    from_frames = run.config.measurement.calibration == "frames"
    response, bad, offset = (_by_masters if from_frames else _by_truth)(run, job, streams)
    traps = Streams(run.config.seed, job.obsid, -job.chip.id, "measure") if from_frames else streams
    return file, to_electrons(
        file.frame(), file.readout, file.gain, nonlinearity=file.nonlinearity, adc_max=detector.adc_max,
        full_well=detector.full_well, response=response, bad=bad, offset=offset,
        correct=_charge_correction(run, job, steps, traps),
    )  # fmt: skip


def _response(run, job, streams, prnu):
    from csstsim.optics.throughput.response import response_map

    exposure, losses = job.exposure, job.exposure.losses
    return response_map(
        exposure.chip, exposure.window, exposure.filter, exposure.exptime, run.camera.leds, streams.camera,
        flat=losses.flat, shutter=losses.shutter, prnu=streams.chip_key("prnu") if prnu and losses.prnu else None,
    )  # fmt: skip


def _by_truth(run, job, streams):
    from csstsim.measure.bad_pixels import known_defects

    layer = run.steps[job.pointing.type].step("detector_defects")
    bad = known_defects(run.camera.detector, job.window, layer.param, streams) if layer else None
    return _response(run, job, streams, prnu=True), bad, None


def _by_masters(run, job, streams):
    from csstsim.io.frames import load_frame

    planes, meta = load_frame(run.masters(job.chip.id), masters_recipe(run, job.chip.id))
    check_release(run.masters(job.chip.id), meta.get("csstsim"))
    part, response = job.window.slices, _response(run, job, streams, prnu=False)
    flat = np.ascontiguousarray(planes["flat"][part])
    offset = {int(channel): value for channel, value in meta["offset"].items()}
    return flat if response is None else flat * response, planes["bad"][part] > 0, offset


def _charge_correction(run, job, steps, streams):
    """Return a function that moves charge back to where light made it. streams: rng.Streams of the traps."""
    from csstsim.detector.bfe_kernel import detector_kernel
    from csstsim.detector.brighter_fatter import move_charge
    from csstsim.detector.charge_transfer.transfer import transfer
    from csstsim.measure.charge_correction import corrected

    detector, passes = run.camera.detector, run.config.measurement.cti_passes
    traps, spread = steps.step("cte_effect"), steps.step("brighter_fatter")

    def trap(image):
        transfer(image, detector, job.window, streams, density=traps.param.density_scale, serial=traps.param.serial)

    def push(image):
        below = np.minimum(image, np.float32(0.0))  # negative read noise is no charge
        image -= below
        move_charge(image, *detector_kernel(detector), detector.full_well)
        image += below

    def correct(electrons):
        if traps and traps.param.density_scale > 0:
            electrons = corrected(electrons, trap, passes)
        return corrected(electrons, push, PUSHES) if spread else electrons

    return correct
