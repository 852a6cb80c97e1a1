"""Write tests/reference/golden_scene.json: statistics of a small scene after each layer.

    PYTHONPATH=tests:builders python tests/reference/builders/golden_scene.py

It stores statistics, not hashes: another processor or library changes them by far less than the tolerances of
tests/end_to_end/test_golden_scene.py; a change of physics changes them by more. Run it only when pixels are meant to
change, and say in CHANGES.md by how much.
"""

import json
import tempfile
from importlib import import_module
from pathlib import Path

import numpy as np
from support.mini_campaign import write_scene

from csstsim.campaign.opened import OpenCampaign
from csstsim.stages import psf as psf_stage
from csstsim.stages import select as select_stage

GOLDEN = Path(__file__).parents[1] / "golden_scene.json"
OBSID, CHIP = "10100000001", 9


def statistics(folder):
    """Draw a star and two galaxies layer by layer; return {layer: {statistic: value}}."""
    run = OpenCampaign(write_scene(folder, "Pair", [40.3, 90.1, 20.0], [50.2, 70.6, 110.0], mag=20.0))
    job = run.job(OBSID, CHIP)
    psf_stage.psf(run, CHIP)
    select_stage.select(run, job)
    steps, found = run.steps["SCIE"], {}
    for step in steps:
        apply = step.module.apply

        def watched(state, param, rng, apply=apply, name=step.name):
            state = apply(state, param, rng)
            found[name] = summary(state.image if state.counted is None else state.image + state.counted)
            return state

        step.module.apply = watched
    try:
        for stage in ("render", "readout", "level0"):
            getattr(import_module(f"csstsim.stages.{stage}"), stage)(run, job)
    finally:
        for step in steps:
            step.module.apply = step.module.apply.__defaults__[0]
    return found


def summary(image):
    """Return the statistics kept of an image."""
    values = image.astype(float)
    return {
        "rows": image.shape[0], "columns": image.shape[1], "sum": values.sum(), "mean": values.mean(),
        "std": values.std(), "min": values.min(), "median": float(np.median(values)), "max": values.max(),
        "row_moment": float((values.sum(axis=1) * np.arange(image.shape[0])).sum() / values.sum()),
        "column_moment": float((values.sum(axis=0) * np.arange(image.shape[1])).sum() / values.sum()),
    }  # fmt: skip


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as scratch:
        GOLDEN.write_text(json.dumps(statistics(Path(scratch)), indent=1) + "\n")
    print(GOLDEN)
