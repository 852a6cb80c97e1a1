"""States for tests of the readout: a flat image on a small or a real chip."""

from dataclasses import replace
from functools import cache

import yaml

from csstsim.base.shipped import SHIPPED
from csstsim.instrument.camera import load_camera
from csstsim.instrument.chip import Window
from csstsim.instrument.pointing import Pointing
from csstsim.optics.geometry.wcs import ChipWCS
from csstsim.simulation.exposure import NO_LOSSES, Exposure
from csstsim.simulation.sim_steps import SimSteps
from csstsim.simulation.state import State
from support.mini import mini_camera

OBSID = "10160000004"
POINTING = {
    "type": "SCIE", "ra": 60.0, "dec": -40.0, "pa": -113.4333,
    "time": "2027-06-26T20:35:58", "exptime": 150.0,
    "sat_position": (6778.137, 0.0, 0.0), "sat_velocity": (0.0, 5.743, 5.09),
}  # fmt: skip


EFFECTS = (
    "prnu_effect", "cosmic_rays", "brighter_fatter", "detector_defects", "blooming", "cte_effect", "nonlinearity",
)  # fmt: skip


@cache
def small_camera(folder):
    return load_camera(mini_camera(folder))


def flat_state(camera, level=0.0, *, window=None, chip=9, losses=NO_LOSSES, fidelity="standard", **pointing):
    """Return a blank state with `level` expected electrons in every pixel; window (x0, x1, y0, y1)."""
    chip = camera.chips[chip]
    pointing = Pointing(**(POINTING | pointing))
    window = chip.full_window if window is None else Window(*window)
    wcs = ChipWCS(chip, pointing)
    state = State.blank(Exposure(pointing, chip, window, wcs, camera, losses=losses, fidelity=fidelity))
    state.image[:] = level
    return state


def change_exposure(state, **fields):
    """Give a state an exposure of which some fields are others."""
    state.exposure = replace(state.exposure, **fields)


def dark_layers(off=()):
    """Return the steps of the shipped dark exposure, some switched off."""
    return [step for step in SimSteps(SHIPPED / "observations" / "dark.yaml") if step.name not in off]


def plain_layers(off=()):
    """Return those of them that leave a flat image flat but for noise and the levels of channels."""
    return dark_layers(off=(*EFFECTS, *off))


def plain_list(kind):
    """Return a shipped layer list ("science", "bias", ...) without EFFECTS, as its YAML says it."""
    layers = yaml.safe_load((SHIPPED / "observations" / f"{kind}.yaml").read_text())["layers"]
    return [layer for layer in layers if next(iter(layer)).lower() not in EFFECTS]


def run(state, steps, seed=11, obsid=OBSID):
    """Run steps one by one, each with its own streams, as SimSteps does."""
    from csstsim.base.rng import Streams

    for step in steps:
        state = step.module.apply(state, step.param, Streams(seed, obsid, state.chip.id, step.name))
    return state
