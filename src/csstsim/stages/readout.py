"""Readout: the detector's layers turn electrons into DN."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.process.one_thread import one_thread
from csstsim.stages.parts.stage_frames import Timer, frame_meta, state_before

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from csstsim.base.rng import Streams
    from csstsim.campaign.job import Job
    from csstsim.campaign.opened import OpenCampaign
    from csstsim.simulation.state import State


@one_thread
def readout(run: OpenCampaign, job: Job) -> None:
    """Run the layers of the readout stage: electrons to DN."""
    from csstsim.io.frames import save_frame

    timer = Timer("readout")
    state = read_out(run, state_before(run, job, "render"), run.streams(job))
    save_cosmic_rays(run.paths.level0_cosmic(job), state, run.recipe(job, "readout"))
    state.header.setdefault("stages", []).append(timer.entry())
    save_frame(
        run.paths.stage(*job.key, "readout.fits"),
        {"image": state.image, "mask": state.mask},
        frame_meta(run, job, state),
    )


def read_out(run: OpenCampaign, state: State, rng: Streams) -> State:
    """Return the State after the readout stage; rng: the job's rng.Streams."""
    return run.steps[state.pointing.type].run(state, "readout", rng)


def save_cosmic_rays(path: Path, state: State, recipe: Mapping[str, str]) -> None:
    """Write the electrons of cosmic rays alone (int32, the window's active pixels), if the layer asks for it.

    The file is in the folder of the Level-0 file. If the layer does not ask for it, an old file is removed.
    """
    from csstsim.io.frames import save_frame

    path.unlink(missing_ok=True)
    if state.cosmic_rays is None:
        return
    (pixel, electrons), plane = state.cosmic_rays, np.zeros(state.window.shape, np.int32)
    plane.reshape(-1)[pixel] = electrons
    save_frame(path, {"cosmic": plane}, {"recipe": recipe, "unit": "electron"})
    state.cosmic_rays = None
