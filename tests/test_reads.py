"""What a stage reads while it runs, noted as it does: nothing that is not in its recipe, and no number kept for nothing.

tests/test_recipe.py holds recipes against a table of what is known. Here nobody has to know: each look at a number of
the camera or a key of the campaign is written down.
"""

import sys
from fnmatch import fnmatchcase

import pytest
from mini_campaign import POINTINGS, write_campaign

from csstsim.base.stages import behind, read_by
from csstsim.campaign import config as keys
from csstsim.campaign import recipes
from csstsim.campaign.opened import OpenCampaign
from csstsim.instrument import camera_parts
from csstsim.instrument.camera import Camera
from csstsim.instrument.chip import Chip, Detector
from csstsim.instrument.filter import Filter
from csstsim.instrument.telescope import Telescope
from csstsim.stages.level0 import level0
from csstsim.stages.measure import measure
from csstsim.stages.psf import psf
from csstsim.stages.readout import readout
from csstsim.stages.render import render
from csstsim.stages.select import select
from csstsim.stages.truth import truth

STARS = {"kind": "mini_campaign:Stars", "options": {"ra": [60.0], "dec": [-40.0], "mag": [18.0]}}
# Attributes of the camera's objects, and the parts of the camera that they come from
ATTRIBUTES = {
    Camera: {
        "keywords": "level0_keywords.yaml", "psf": "psf.yaml", "scatter": "scatter.yaml", "ghosts": "ghosts.yaml",
        "sky": "sky.yaml", "leds": "leds.yaml", "gratings": "gratings.yaml", "orbit": "telescope.orbit.epoch",
    },
    Chip: dict.fromkeys(("row", "column", "xc", "yc", "rotation", "filter"), "chips.yaml"),
    Detector: {
        "cosmic_rays": "cosmic_rays.yaml", "defects": "defects.yaml", "traps": "cti.yaml",
        "brighter_fatter": "brighter_fatter.yaml", "channels": "detector.channels_x",
    },
    Filter: {
        "throughput": "filters.r.nodes", "sky": "filters.r.sky", "limiting_mag": "filters.r.limiting_mag",
        "saturation_mag": "filters.r.saturation_mag",
    },
    Telescope: {"area_m2": "telescope.telescope.diameter_m"},
}  # fmt: skip
SECTIONS = {
    keys.Campaign: "", keys.CatalogConfig: "catalog.", keys.Lensing: "catalog.lensing.", keys.PsfConfig: "psf.",
    keys.AstrometryConfig: "astrometry.", keys.MeasurementConfig: "measurement.", keys.ValidateConfig: "validation.",
}  # fmt: skip
RUNS = {"psf": psf, "select": select, "render": render, "readout": readout, "level0": level0, "measure": measure}
COMPARED = {"__hash__", "__eq__", "<genexpr>", "__repr__", "_asdict_inner"}  # of a whole object: keys of caches


def part(kind, name):
    """Return the part of the camera, or the key of the campaign, that an attribute is, or None."""
    if kind in SECTIONS:
        return SECTIONS[kind] + name if name in kind.model_fields and (kind, name) not in HOLDERS else None
    if name in ATTRIBUTES[kind]:
        return ATTRIBUTES[kind][name]
    plain = kind.__dataclass_fields__.get(name)
    prefix = {Detector: "detector.", Telescope: "telescope.telescope."}.get(kind)
    return f"{prefix}{name}" if prefix and plain else None


HOLDERS = {(keys.Campaign, name) for name in ("catalog", "psf", "astrometry", "measurement", "validation", "select")}
HOLDERS.add((keys.CatalogConfig, "lensing"))


@pytest.fixture
def noted(monkeypatch):
    """The set of parts and keys that were looked at since it was last cleared."""
    found = set()

    def watch(kind):
        seen = kind.__getattribute__

        def look(self, name):
            if not name.startswith("_") and sys._getframe(1).f_code.co_name not in COMPARED:
                found.add(part(kind, name))
            return seen(self, name)

        monkeypatch.setattr(kind, "__getattribute__", look)

    for kind in (*ATTRIBUTES, *SECTIONS):
        watch(kind)
    return found


@pytest.fixture(scope="module", params=["imaging", "slitless", "calibration"])
def campaign(request, tmp_path_factory):
    chip, pointing = {"imaging": (9, 0), "slitless": (29, 0), "calibration": (9, 2)}[request.param]
    folder = tmp_path_factory.mktemp(request.param)
    return write_campaign(folder, [POINTINGS[pointing]], catalog=STARS, select={"chips": [chip]})


READ = {}  # {stage: what it read}, of all campaigns


def test_a_stage_reads_nothing_that_its_recipe_does_not_have(campaign, noted):
    run = OpenCampaign(campaign)
    job, science = run.jobs[0], run.jobs[0].pointing.type == "SCIE"
    for stage, do in RUNS.items():
        if (stage in ("psf", "select") and not science) or (stage == "measure" and job not in run.imaging_jobs):
            continue
        if not run.has_stage(job.pointing, stage) and stage in ("render", "readout"):
            continue
        noted.clear()
        do(run, job.chip.id if stage == "psf" else job)
        look = noted - {None}
        READ.setdefault(stage, set()).update(look)
        assert not sorted(look - allowed(run, stage)), stage


def allowed(run, stage):
    """Return the names that the recipe of a stage has, and keys whose content it has by other names."""
    stages = behind(stage)
    camera = read_by(stages, run.camera._parts, camera_parts.READERS)
    config = read_by(stages, run.recipes._keys, recipes.READERS)
    elsewhere = {"name", "output", "catalog.kind", "instrument", "survey_table", "window", "universe"}  # exposure, sky, camera
    measured = {f"measurement.{name}" for name in keys.MeasurementConfig.model_fields if name != "keep_calibrated"}
    return {*camera, *config, *elsewhere, *(measured if stage == "measure" else ())}


def test_truth_reads_nothing_that_its_recipe_does_not_have(tmp_path, noted):
    run = OpenCampaign(write_campaign(tmp_path, POINTINGS[:1]))
    run.universe.check()
    pix = run.truth_bricks(run.jobs[0])[0]
    noted.clear()
    truth(run, pix, lambda _: None)
    READ["truth"] = noted - {None}
    assert not sorted(READ["truth"] - allowed(run, "truth"))


def test_no_number_is_declared_for_an_earlier_stage_than_reads_it(campaign):
    """After the tests above: what a stage is said to read first is read by it."""
    run = OpenCampaign(campaign)
    for names, readers in ((run.camera._parts, camera_parts.READERS), (run.recipes._keys, recipes.READERS)):
        for pattern, stages in readers.items():
            fit = {name for name in names if fnmatchcase(name, pattern)}
            for stage in set(stages) & set(READ):
                assert fit & READ[stage] or pattern in UNSEEN, (pattern, stage)


# Read as files, as options of a catalogue, or only in other campaigns than these
UNSEEN = {}
