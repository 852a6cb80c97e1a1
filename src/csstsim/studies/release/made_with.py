"""Files in a release that record how it was made: workflow, campaign and its input files, recipes, columns.

workflow/Snakefile  workflow/workflow/rules/*.smk       the workflow of csstsim
workflow/inputs/    the campaign file, its survey table and its lists of layers
workflow/recipes.json  digests of everything that determines the products, by kind of exposure, stage and chip
workflow/tables.json   the columns of every table
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

from csstsim import __version__
from csstsim.base.files.atomic import atomic_path
from csstsim.base.files.text_file import read_json
from csstsim.base.shipped import ROOT, SHIPPED
from csstsim.delivery.manifest import CRATE_FOLDER

if TYPE_CHECKING:
    from typing import Any

    from csstsim.campaign.opened import OpenCampaign

WORKFLOW = f"{CRATE_FOLDER}/Snakefile"
INPUTS = f"{CRATE_FOLDER}/inputs"
RECIPES = f"{CRATE_FOLDER}/recipes.json"
TABLES = f"{CRATE_FOLDER}/tables.json"
KINDS = {
    WORKFLOW: "the workflow",
    RECIPES: "digests of what decides the products",
    TABLES: "the columns of every table",
}


def write_made_with(run: OpenCampaign, folder: Path) -> dict[str, str]:
    """Write the files of a campaign.opened.OpenCampaign below `folder`; return {path below it: description}."""
    kinds = dict(KINDS)
    sources = {WORKFLOW: ROOT / "Snakefile", TABLES: SHIPPED / "schema" / "tables.json"}
    for path in sorted((ROOT / "workflow" / "rules").glob("*.smk")):
        name = f"{CRATE_FOLDER}/workflow/rules/{path.name}"
        sources[name] = path
        kinds[name] = "rules of the workflow"
    for name, path in inputs(run).items():
        sources[f"{INPUTS}/{name}"] = path
        kinds[f"{INPUTS}/{name}"] = "the campaign file" if path == run.file else "a file that the campaign names"
    for name, path in sources.items():
        _write(folder / name, path.read_bytes())
    _write(folder / RECIPES, (json.dumps(recipes(run), indent=1) + "\n").encode())
    return kinds


def inputs(run: OpenCampaign) -> dict[str, Path]:
    """Return {name: file} of the campaign and the files that it names, the campaign first."""
    files = [run.file, Path(run.config.survey_table)]
    files += [Path(run.config.observation_file(kind)) for kind in run.steps]
    named: dict[str, Path] = {}
    for path in dict.fromkeys(files):
        is_taken = path.name in named  # two files of one name, in different folders
        named[f"{path.parent.name}_{path.name}" if is_taken else path.name] = path
    return named


def recipes(run: OpenCampaign) -> dict[str, Any]:
    """Return what determines the products: version, seed, and each stage's recipe, by kind of exposure and chip."""
    stages = ("level0", "measure")
    return {
        "csstsim": __version__,
        "campaign": run.config.name,
        "seed": run.config.seed,
        "digest": run.config.digest(),
        "truth": run.recipes.truth,
        "psf": run.recipes.psf,
        "validation": run.recipes.validation,
        "jobs": {
            f"{job.obsid}_{job.chip.id:02d}": {
                stage: run.recipe(job, stage) for stage in stages if stage == "level0" or job.pointing.type == "SCIE"
            }
            for job in run.jobs
        },
    }


def tables_version() -> str:
    """Return the version of the table of columns."""
    return read_json(SHIPPED / "schema" / "tables.json")["version"]


def _write(path: Path, content: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_path(path) as temporary:
        temporary.write_bytes(content)
