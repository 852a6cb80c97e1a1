"""The frame that a stage writes for the next one, and the run time of a stage."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, cast

from csstsim.base.errors import InputError
from csstsim.base.release import check_recipe
from csstsim.simulation.state import State

if TYPE_CHECKING:
    from typing import Any

    from csstsim.base.types import AnyArray, IntArray
    from csstsim.campaign.job import Job
    from csstsim.campaign.opened import OpenCampaign


class Timer:
    """Wall and CPU seconds of a stage, for the provenance of its product."""

    def __init__(self, stage: str) -> None:
        self.stage = stage
        self.wall = time.perf_counter()
        self.cpu = time.process_time()

    def entry(self) -> list[str | float]:
        """Return [stage, wall s, CPU s] since it began."""
        return [self.stage, time.perf_counter() - self.wall, time.process_time() - self.cpu]


def state_before(run: OpenCampaign, job: Job, stage: str) -> State:
    """Return the State that a stage wrote to disk, or a blank one if the exposure has no such stage."""
    from csstsim.io.frames import load_frame

    state = State.blank(job.exposure)
    if run.has_stage(job.pointing, stage):
        path = run.paths.stage(*job.key, f"{stage}.fits")
        planes, meta = load_frame(path, {"stage": stage}, sparse=True)
        check_recipe(path, meta, run.recipe(job, stage))
        if "image" not in planes or not {"unit", "header"} <= meta.keys():
            raise InputError("damaged: it lacks the plane image, or unit or header in its metadata", file=path)
        state.image = cast("AnyArray", planes["image"])
        state.counted = cast("IntArray | None", planes.get("counted"))  # or a SparsePlane
        if state.mask is not None:
            state.mask = planes.get("mask", state.mask)
        state.unit = meta["unit"]
        state.header = meta["header"]
    return state


def frame_meta(run: OpenCampaign, job: Job, state: State) -> dict[str, Any]:
    """Return the metadata of a frame that one stage writes for the next."""
    stage = state.header["stages"][-1][0]
    frame = {"recipe": run.recipe(job, stage), "stage": stage, "unit": state.unit, "header": state.header}
    return frame | {"exposure": _exposure(run, job)}


def _exposure(run: OpenCampaign, job: Job) -> dict[str, Any]:
    """Return the exposure and chip of a frame under the keywords of the Level-0 header, for `csstsim show`."""
    pointing = job.pointing
    window = job.window
    return job.wcs.header() | {
        "OBSID": job.obsid, "FILETYPE": pointing.type, "DETECTOR": f"{job.chip.id:02d}", "FILTER": job.chip.filter,
        "EXPTIME": pointing.exptime, "RA_OBJ": pointing.ra, "DEC_OBJ": pointing.dec, "POS_ANG0": pointing.pa,
        "POSKIND": "APPARENT", "FLDDIST": job.wcs.distortion is not None, "CAMHASH": run.recipe(job)["camera"],
        "READX0": window.x0 + 1, "READX1": window.x1, "READY0": window.y0 + 1, "READY1": window.y1,
    }  # fmt: skip
