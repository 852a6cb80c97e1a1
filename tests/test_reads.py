"""Record what a stage reads while it runs: its recipe must have all of that, and little else.

tests/test_recipe.py compares recipes with a table of known dependences. Here no table is needed: each read of a number
of the camera or a key of the campaign is recorded.
"""

import sys
from fnmatch import fnmatchcase
from functools import partial

import pytest
from support.mini_campaign import POINTINGS, write_campaign

from csstsim.base.stages import read_by, with_dependencies
from csstsim.campaign import recipes
from csstsim.campaign import sections as keys
from csstsim.campaign.config import Campaign
from csstsim.campaign.opened import OpenCampaign
from csstsim.campaign.thresholds import ValidateConfig
from csstsim.instrument import camera_parts
from csstsim.instrument.camera import Camera
from csstsim.instrument.chip import Chip, Detector
from csstsim.instrument.filter import Filter
from csstsim.instrument.maps.chip_maps import STAGES, ChipMaps
from csstsim.instrument.telescope import Telescope
from csstsim.stages.calibrate import calibrate
from csstsim.stages.extract import extract
from csstsim.stages.level0 import level0
from csstsim.stages.measure import measure
from csstsim.stages.merge import merge
from csstsim.stages.psf import psf
from csstsim.stages.readout import readout
from csstsim.stages.render import render
from csstsim.stages.select import select
from csstsim.stages.truth import truth
from csstsim.stages.validate import validate

STARS = {"kind": "support.mini_campaign:Stars", "options": {"ra": [60.0], "dec": [-40.0], "mag": [18.0]}}
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
    ChipMaps: {kind: f"maps.{kind}" for kind in STAGES},
}  # fmt: skip
SECTIONS = {
    Campaign: "", keys.CatalogConfig: "catalog.", keys.Lensing: "catalog.lensing.", keys.PsfConfig: "psf.",
    keys.AstrometryConfig: "astrometry.", keys.MeasurementConfig: "measurement.",
    keys.ContaminationConfig: "measurement.contamination.", ValidateConfig: "validation.",
}  # fmt: skip
MEASURED = keys.MeasurementConfig, keys.ContaminationConfig  # apart, in `measurement` of a recipe
TYPES = ["SCIE", "BIAS"]
# Where products lie; files and folders whose content is in the recipe, under other names: exposure, sky, camera
FOLDERS = {"output", "share", "instrument", "universe"}
ELSEWHERE = FOLDERS | {"name", "survey_table", "window", "catalog.kind", "catalog.options"}
ELSEWHERE |= {"truth"}  # which files there are, not what is in them
# Read when the campaign is opened, or as files by the embedded universe's catalogue; saturation_mag by nobody
UNSEEN = {
    ("astrometry.*", "select"), ("distortion.fits", "select"), ("distortion.yaml", "psf"), ("rendering.*", "render"),
    ("filters.*.saturation_mag", "validate"), ("seed", "select"), ("sky", "select"), ("sky", "truth"),
    ("telescope.orbit.*", "select"), ("fidelity", "render"), ("changing.*", "select"), ("components.*", "select"),
    ("components.*", "render"), ("library*", "psf"), ("library*", "select"),
}  # fmt: skip
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


HOLDERS = {(Campaign, name) for name in ("catalog", "psf", "astrometry", "measurement", "validation", "select")}
HOLDERS |= {(keys.CatalogConfig, "lensing"), (keys.MeasurementConfig, "contamination")}


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


@pytest.fixture(params=["imaging", "slitless", "calibration"])
def campaign(request, tmp_path):
    chip, pointing = {"imaging": (9, 0), "slitless": (29, 0), "calibration": (9, 2)}[request.param]
    return write_campaign(tmp_path, [POINTINGS[pointing]], catalog=STARS, select={"types": TYPES, "chips": [chip]})


READ = {}  # {stage: what it read}, of all tests


def stages_of(run):
    """Yield (stage, what runs it) of the only job of a campaign, in order."""
    job = run.jobs[0]
    if job.pointing.type == "SCIE":
        yield "psf", partial(psf, run, job.chip.id)
        yield "select", partial(select, run, job)
    for stage, do in {"render": render, "readout": readout, "level0": level0}.items():
        if run.has_stage(job.pointing, stage):
            yield stage, partial(do, run, job)
    if job in run.slitless_jobs:
        yield "measure", partial(extract, run, job)
    if job in run.imaging_jobs:
        yield "measure", partial(measure, run, job)
        yield "measure", partial(calibrate, run, job)
        pix = next(iter(run.merge_bricks))
        yield "measure", partial(merge, run, pix)
        yield "validate", partial(validate, run, pix)


def unknown(run, stage, do, noted):
    """Run a stage; return what it read beside its recipe, sorted."""
    noted.clear()
    do()
    found = noted - {None}
    READ.setdefault(stage, set()).update(found)
    stages = with_dependencies(stage)
    camera = read_by(stages, run.camera.files.parts, camera_parts.READERS)
    config = read_by(stages, run.recipes._keys, recipes.READERS)
    maps = {f"maps.{kind}" for kind, first in STAGES.items() if first in stages}
    apart = {SECTIONS[kind] + name for kind in MEASURED for name in kind.model_fields} if "measure" in stages else set()
    return sorted(found - {*camera, *config, *maps, *apart, *ELSEWHERE})


def test_a_stage_reads_nothing_that_its_recipe_does_not_have(campaign, noted):
    run = OpenCampaign(campaign)
    for stage, do in stages_of(run):
        assert not unknown(run, stage, do, noted), stage


def test_truth_reads_nothing_that_its_recipe_does_not_have(tmp_path, noted):
    run = OpenCampaign(write_campaign(tmp_path, POINTINGS[:1]))
    run.universe.check()
    pix = run.truth_bricks(run.jobs[0])[0]
    # sky.yaml: the list of bright stars, of which the recipe has a digest
    assert unknown(run, "truth", partial(truth, run, pix, lambda _: None), noted) == ["sky.yaml"]


def test_nothing_is_declared_for_an_earlier_stage_than_reads_it(tmp_path):
    """After the tests above: what a stage is said to read first is read by it."""
    run = OpenCampaign(write_campaign(tmp_path, POINTINGS[:1]))
    early = [(kind, stage) for kind, stage in STAGES.items() if f"maps.{kind}" not in READ.get(stage, {f"maps.{kind}"})]
    for names, readers in ((run.camera.files.parts, camera_parts.READERS), (run.recipes._keys, recipes.READERS)):
        for pattern, stages in readers.items():
            fit = {name for name in names if fnmatchcase(name, pattern)}
            early += [(pattern, stage) for stage in set(stages) & set(READ) if not fit & READ[stage]]
    assert sorted(set(early) - UNSEEN) == []
