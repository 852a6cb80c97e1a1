"""Calibrate: Level-0 files to calibrated images, as set by `measurement` in a campaign.

calibration: truth     the maps of the simulation: flat field, shutter, pixel response, defects, bias, each trap
calibration: frames    masters of `csstsim masters` for pixel response and defects; flat field and shutter as above,
                       because a survey determines these from its stars; other traps, of the same density; the bias of
                       a channel without its structure
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.process.one_thread import one_thread
from csstsim.base.release import check_release
from csstsim.base.rng import Streams
from csstsim.instrument.maps.lab_map import frame_of
from csstsim.stages.level0 import own_level0
from csstsim.stages.masters import masters_recipe
from csstsim.stages.psf import open_psf

if TYPE_CHECKING:
    from csstsim.base.types import FloatArray
    from csstsim.campaign.job import Job
    from csstsim.campaign.opened import OpenCampaign
    from csstsim.io.level0 import Level0
    from csstsim.measure.calibration.calibrate import Calibrated, Corrections
    from csstsim.optics.throughput.response import Response


@one_thread
def calibrate(run: OpenCampaign, job: Job) -> None:
    """Write the calibrated image of an imaging chip's science exposure."""
    from csstsim.io.calibrated import CalibratedPlanes, write_calibrated
    from csstsim.measure.calibration.bad_pixels import fill_bad_pixels
    from csstsim.measure.detection.detect import subtract_background
    from csstsim.measure.light.photometry import psf_model

    if job.chip.kind != "imaging" or job.pointing.type != "SCIE":
        raise InputError(
            "only science exposures of imaging chips have calibrated images",
            file=run.file,
            key="chip",
            value=f"{job.chip.id} ({job.chip.filter}) in {job.pointing.type}",
        )
    file, frame = calibrated_frame(run, job)
    quality = fill_bad_pixels(
        frame, psf_model(open_psf(run, job.chip), (job.window.x0, job.window.y0), job.window.shape)
    )
    image = frame.electrons
    error = frame.sigma()
    rate = 1.0 / job.pointing.exptime
    background = float(np.median(image))
    subtract_background(image, quality)
    background -= float(np.median(image))
    image *= rate
    error *= rate
    path = run.paths.calibrated(*job.key)
    filter_ = run.camera.filters[job.chip.filter]
    write_calibrated(
        path,
        file,
        job.wcs,
        CalibratedPlanes(image, error, quality),
        background=background * rate,
        zeropoint=filter_.zeropoint(run.camera.telescope),
        read_noise=float(np.mean(list(frame.read_noise.values()))),
        settings=run.measurement,
    )
    print(f"{path}: {100 * (quality > 0).mean():.3f}% of the pixels are flagged")


def calibrated_frame(run: OpenCampaign, job: Job) -> tuple[Level0, Calibrated]:
    """Return (io.level0.Level0, measure.calibration.calibrate.Calibrated) of a job's file. Raises InputError."""
    file = own_level0(run, job)
    return file, calibrated_of(run, job, file)


def known_corrections(run: OpenCampaign, job: Job) -> Corrections:
    """Return the response, defects and bias offset that the campaign's `measurement` knows. Raises InputError."""
    from_frames = run.config.measurement.calibration == "frames"
    return (_by_masters if from_frames else _by_truth)(run, job, run.streams(job, "measure"))


def calibrated_of(run: OpenCampaign, job: Job, file: Level0) -> Calibrated:
    """Return the measure.calibration.calibrate.Calibrated of an io.level0.Level0 of a job. Raises InputError.

    It is corrected by `known_corrections`, the structure of the bias, and the charge put back.
    """
    from csstsim.measure.calibration.calibrate import Electronics
    from csstsim.measure.calibration.calibrate import calibrate as to_electrons
    from csstsim.measure.calibration.charge_correction import put_back

    streams = run.streams(job, "measure")
    steps = run.steps[job.pointing.type]
    detector = run.camera.detector
    from_frames = run.config.measurement.calibration == "frames"
    bias = None if from_frames or not steps.step("bias") else job.chip.maps.bias
    traps = steps.step("cte_effect")
    correct = partial(
        put_back,
        detector=detector,
        window=job.window,
        traps=traps.param if traps else None,
        passes=run.config.measurement.cti_passes,
        spread=steps.step("brighter_fatter") is not None,
        rng=Streams(run.config.seed, job.obsid, -job.chip.id, "measure") if from_frames else streams,
    )
    structure = frame_of(bias, file.readout) if bias else None
    corrections = known_corrections(run, job)._replace(structure=structure, correct=correct)
    return to_electrons(file.frame(), file.readout, Electronics.of(file, detector), corrections)


def _response(
    run: OpenCampaign, job: Job, streams: Streams, *, prnu: bool, master: FloatArray | None = None
) -> Response | None:
    """Return the optics.throughput.response.Response of a job's frame; None if it is 1 everywhere."""
    from csstsim.optics.throughput.flat import FlatField
    from csstsim.optics.throughput.response import Response

    exposure = job.exposure
    losses = job.exposure.losses
    key = streams.chip_key("prnu") if prnu and losses.prnu else None
    if not (losses.flat or losses.shutter) and key is None and master is None:
        return None
    return Response(
        exposure.chip,
        exposure.window,
        exposure.filter,
        exposure.exptime,
        flat=FlatField(run.camera.leds, streams.camera) if losses.flat else None,
        shutter=losses.shutter,
        prnu=key,
        master=master,
    )


def _by_truth(run: OpenCampaign, job: Job, streams: Streams) -> Corrections:
    from csstsim.measure.calibration.bad_pixels import known_defects
    from csstsim.measure.calibration.calibrate import Corrections

    layer = run.steps[job.pointing.type].step("detector_defects")
    bad = known_defects(job.chip, job.window, layer.param, streams) if layer else None
    return Corrections(_response(run, job, streams, prnu=True), bad)


def _by_masters(run: OpenCampaign, job: Job, streams: Streams) -> Corrections:
    from csstsim.io.frames import load_frame
    from csstsim.measure.calibration.calibrate import Corrections

    planes, meta = load_frame(run.masters(job.chip.id), masters_recipe(run, job.chip.id))
    check_release(run.masters(job.chip.id), meta.get("csstsim"))
    part = job.window.slices
    response = _response(run, job, streams, prnu=False, master=np.ascontiguousarray(planes["flat"][part]))
    offset = {int(channel): value for channel, value in meta["offset"].items()}
    return Corrections(response, planes["bad"][part] > 0, offset)
