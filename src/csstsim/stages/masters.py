"""Masters: a chip's master calibration frames from the campaign's bias, dark and lamp exposures."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from csstsim import __version__
from csstsim.base.errors import InputError
from csstsim.base.process.one_thread import one_thread
from csstsim.base.process.progress import progress
from csstsim.campaign.job_lists import CALIBRATIONS, MIN_CALIBRATIONS
from csstsim.stages.level0 import own_level0

if TYPE_CHECKING:
    from csstsim.campaign.job import Job
    from csstsim.campaign.opened import OpenCampaign
    from csstsim.measure.calibration.calibrate import Calibrated


@one_thread
def masters(run: OpenCampaign, chip_id: int) -> None:
    """Make the master calibration frames of a chip from the campaign's bias, dark and lamp exposures."""
    from csstsim.io.frames import save_frame
    from csstsim.measure.calibration.masters import make_masters

    if chip_id not in run.calibration_jobs:
        raise InputError(
            f"chip {chip_id} has too few full-frame calibration exposures",
            file=run.file,
            key="chip",
            value=chip_id,
            allowed=f"{MIN_CALIBRATIONS} of each {', '.join(CALIBRATIONS)}",
        )
    jobs = run.calibration_jobs[chip_id]
    exposures = {
        kind: map(partial(_raw, run), progress([j for j in jobs if j.pointing.type == kind], f"{kind} frames"))
        for kind in CALIBRATIONS
    }
    seconds = {job.pointing.exptime for job in jobs if job.pointing.type == "DARK"}
    if len(seconds) > 1:
        raise InputError("dark exposures differ in time", file=run.file, key="exptime", value=sorted(seconds))
    made = make_masters(exposures, *seconds)
    meta = {
        "product": "master calibration frames",
        "csstsim": __version__,
        "dark [e-/s]": made.dark,
        "offset": made.offset,
        "exposures": [job.obsid for job in jobs],
        "recipes": [run.recipe(job) for job in jobs],
    }
    path = run.paths.masters(chip_id)
    save_frame(path, {"flat": made.flat, "bad": made.bad.astype(np.uint8)}, meta | masters_recipe(run, chip_id))
    print(f"{path}: {100 * made.bad.mean():.3f}% of the pixels are bad, dark {made.dark:.4f} e-/s")


def masters_recipe(run: OpenCampaign, chip_id: int) -> dict[str, str | int]:
    """Return the recipe of a chip's masters: what determines the detector."""
    camera = run.camera
    chip = run.camera.chips[chip_id]
    return {"camera": camera.digest_for("level0", chip=chip), "seed": run.config.seed, "chip": chip_id}


def _raw(run: OpenCampaign, job: Job) -> Calibrated:
    """Return the Calibrated of a calibration exposure, without corrections."""
    from csstsim.measure.calibration.calibrate import Electronics
    from csstsim.measure.calibration.calibrate import calibrate as to_electrons

    file = own_level0(run, job)
    detector = run.camera.detector
    return to_electrons(
        file.frame(),
        file.readout,
        Electronics.of(file, detector),
    )
