"""The validation.facts.Facts of a job: values expected from the campaign, and those of the Level-0 header."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from csstsim.detector.adc import channel_gains
from csstsim.io.level0 import read_level0
from csstsim.io.paths import existing_product
from csstsim.io.pointing_keywords import Boresight, pointing_offsets, wcs_offset
from csstsim.layers import sky_background
from csstsim.measure.bricks.validation.facts import Facts, HeaderWCS

if TYPE_CHECKING:
    from csstsim.campaign.job import Job
    from csstsim.campaign.opened import OpenCampaign
    from csstsim.io.level0 import Level0
    from csstsim.simulation.sim_steps import SimSteps
    from csstsim.stages.parts.catalogue_counts import BrickObjects

# Of the world coordinates of the assembled frame; those of channels end in a letter.
WCS_KEYS = (
    "WCSAXES", "CTYPE1", "CTYPE2", "CUNIT1", "CUNIT2", "CRVAL1", "CRVAL2", "CRPIX1", "CRPIX2", "CD1_1", "CD1_2",
    "CD2_1", "CD2_2", "LONPOLE", "RADESYS",
)  # fmt: skip
SIP = "A_", "B_", "AP_", "BP_"


def frame_facts(run: OpenCampaign, job: Job, objects: BrickObjects | None = None) -> Facts:
    """Return the Facts of an imaging science job; reads the header of its Level-0 file. Raises InputError.

    objects: catalogue_counts.BrickObjects of the brick that is validated, or None.
    """
    file = read_level0(existing_product(run.paths.level0(job), f"chip {run.file} {job.options}"))
    steps = run.steps[job.pointing.type]
    detector = run.camera.detector
    streams = run.streams(job, "validate")
    gains = steps.step("gain")
    pointing = job.pointing.ra, job.pointing.dec, job.pointing.pa
    values = channel_gains(detector, streams, per_channel=gains.param.gain_16channel) if gains else []
    if file.layout == "chip" and values:  # its channels are scaled to one gain
        values = [float(np.mean(values))] * len(values)
    header = {
        "exptime": file.header0.get("EXPTIME"),
        "gain": file.gain,
        "read_noise": file.per_channel("RON"),
        "bias": file.per_channel("DETBIA"),
        "pointing": pointing_offsets(file.header0, Boresight(*pointing)) | {"CRVAL1": wcs_offset(file.header, job.wcs)},
    }
    return Facts(
        exptime=job.pointing.exptime,
        sky=_sky(run, job, steps),
        dark=detector.dark * job.pointing.exptime if steps.step("poisson_and_dark") else 0.0,
        read_noise=detector.read_noise if steps.step("readout_noise") else 0.0,
        full_well=detector.full_well,
        gain=dict(enumerate(values, start=1)),
        header=header,
        wcs=_wcs(file, job),
        expected=objects.on_frame(job) if objects else {},
    )


def _sky(run: OpenCampaign, job: Job, steps: SimSteps) -> float | None:
    """Return the sky [e-/px, before all losses]; None if a user's layer may add light."""
    step = steps.step("sky_background")
    if not steps.shipped:
        return None
    return sky_background.mean_rate(job.exposure, step.param) * job.pointing.exptime if step else 0.0


def _wcs(file: Level0, job: Job) -> HeaderWCS | None:
    """Return the HeaderWCS of a Level-0 file, None where the header has no such cards."""
    cards = {key: value for key, value in file.header.items() if key in WCS_KEYS or key.startswith(SIP)}
    if not {"CTYPE1", "CRVAL1", "CRPIX1", "CD1_1"} <= set(cards):
        return None
    return HeaderWCS(cards, None if cards["CTYPE1"].endswith("-SIP") else job.wcs.distortion)
