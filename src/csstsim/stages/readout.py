"""Readout: the detector's layers turn electrons into DN."""

import numpy as np

from csstsim.base.one_thread import one_thread
from csstsim.stages.stage_frames import Timer, frame_meta, state_before


@one_thread
def readout(run, job):
    """Run the layers of the readout stage: electrons to DN."""
    from csstsim.io.frames import save_frame

    timer = Timer("readout")
    state = read_out(run, job, state_before(run, job, "render"))
    save_cosmic_rays(run, job, state)
    state.header.setdefault("stages", []).append(timer.entry())
    save_frame(
        run.paths.stage(*job.key, "readout.fits"),
        {"image": state.image, "mask": state.mask},
        frame_meta(run, job, state),
    )


def read_out(run, job, state):
    """Return the State after the readout stage."""
    return run.steps[job.pointing.type].run(state, "readout", run.config.seed)


def save_cosmic_rays(run, job, state):
    """Write the electrons of cosmic rays alone (int32, the window's active pixels), if the layer asks for it.

    The file lies beside the Level-0 file. If the layer does not ask for it, an old one is removed.
    """
    from csstsim.io.frames import save_frame

    path = run.paths.level0_cosmic(job.pointing, job.chip.id)
    path.unlink(missing_ok=True)
    if state.cosmic_rays is None:
        return
    (pixel, electrons), plane = state.cosmic_rays, np.zeros(job.window.shape, np.int32)
    plane.reshape(-1)[pixel] = electrons
    save_frame(path, {"cosmic": plane}, {"recipe": run.recipe(job, "readout"), "unit": "electron"})
    state.cosmic_rays = None
