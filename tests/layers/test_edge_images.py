"""Each readout layer, alone and all in sequence, on one pixel, empty, saturated, NaN and negative images."""

import numpy as np
import pytest
from support.readout_state import flat_state, run

from csstsim.base.shipped import SHIPPED
from csstsim.simulation.sim_steps import SimSteps

STEPS = [step for step in SimSteps(SHIPPED / "observations" / "science.yaml", "SCIE") if step.module.STAGE != "render"]
LEVEL = {"one pixel": 50.0, "zero": 0.0, "saturated": 1e6, "nan": 50.0, "negative": -50.0}  # electrons or DN
# The others change a pixel whatever its neighbours hold, and hand the NaN on to quantization_and_output.
REFUSES = {
    "nan": {
        "poisson_and_dark", "brighter_fatter", "detector_defects", "blooming", "cte_effect", "nonlinearity",
        "quantization_and_output",
    },
    "negative": {"poisson_and_dark", "brighter_fatter"},  # neither light nor charge can be
}  # fmt: skip


def found_by(step, small, kind):
    """The state with such an image, as a layer of its frame finds it."""
    state = flat_state(small, LEVEL[kind], window=(5, 6, 5, 6) if kind == "one pixel" else None)
    if getattr(step.module, "FRAME", ("readout",))[0] == "readout" or step.name == "nonlinearity":
        state = run(state, [step for step in STEPS if step.name == "prescan_overscan"])
    if kind == "nan":
        state.image[-1, -1] = np.nan
    return state


@pytest.mark.parametrize("kind", LEVEL)
@pytest.mark.parametrize("step", STEPS, ids=lambda step: step.name)
def test_outcome(small, step, kind):
    state = found_by(step, small, kind)
    before, bad = state.image.copy(), state.image.size if kind == "negative" else 1
    if step.name in REFUSES.get(kind, ()):
        with pytest.raises(ValueError, match=rf"\b{bad} pixel\(s\)"):
            run(state, [step])
        return
    after = run(state, [step]).image
    assert np.isfinite(after).sum() == after.size - (kind == "nan")
    if step.name == "blooming" and kind == "saturated":
        assert (after == state.chip.detector.full_well).all()
        assert after.sum(dtype=float) + state.header["bloom_lost"] == pytest.approx(before.sum(dtype=float))
    if step.name == "quantization_and_output":
        clipped = state.header["clipped_low"] + state.header["clipped_high"]
        assert clipped == ((before < 0) | (before > 65535)).sum()
    if step.name == "cte_effect":
        kept = state.header["cti_trapped"] + sum(trail.sum(dtype=float) for trail in state.trailed.parallel)
        assert after.sum(dtype=float) + kept == pytest.approx(np.nansum(before, dtype=float), abs=1e-3)


@pytest.mark.parametrize("kind", ["one pixel", "zero", "saturated"])
def test_the_whole_readout(small, kind):
    """Bright cores may saturate every layer; a frame of them still becomes a file's 16 bits, and is counted."""
    state = run(found_by(STEPS[0], small, kind), STEPS)
    assert state.image.dtype == np.uint16
    counted = state.header["clipped_high"]
    assert (counted > 0.5 * 128**2) == (kind == "saturated")
