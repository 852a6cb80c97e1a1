"""RO-Crate metadata (ro-crate-metadata.json) of a folder of products.

RO-Crate 1.1 (https://w3id.org/ro/crate/1.1) says what the files are; Workflow Run Crate 0.5
(https://w3id.org/ro/wfrun/workflow/0.5), built on Workflow RO-Crate 1.0, how they were made. Its terms are those of
schema.org. The workflow, the campaign and the recipes are files of the crate (release.made_with).
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from datetime import UTC, datetime
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, cast
from urllib.parse import quote

from csstsim.base.errors import InputError
from csstsim.base.files.atomic import atomic_path
from csstsim.delivery.manifest import CRATE_FILE
from csstsim.studies.release.made_with import INPUTS, RECIPES, TABLES, WORKFLOW

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from typing import Any

    from csstsim.base.types import PathLike
    from csstsim.studies.release.run_record import RunRecord

README = "README.md"
CONTEXT = ["https://w3id.org/ro/crate/1.1/context", "https://w3id.org/ro/terms/workflow-run/context"]
CRATE = "https://w3id.org/ro/crate/1.1"
WORKFLOW_CRATE = "https://w3id.org/workflowhub/workflow-ro-crate/1.0"
RUN_PROFILES = {
    "https://w3id.org/ro/wfrun/process/0.5": ("Process Run Crate", "0.5"),
    "https://w3id.org/ro/wfrun/workflow/0.5": ("Workflow Run Crate", "0.5"),
    WORKFLOW_CRATE: ("Workflow RO-Crate", "1.0"),
}
BIOSCHEMAS = "https://bioschemas.org/profiles/{}/1.0-RELEASE"
MEDIA = {
    ".fits": "application/fits",
    ".parquet": "application/vnd.apache.parquet",
    ".h5": "application/x-hdf5",
    ".json": "application/json",
    ".html": "text/html",
    ".png": "image/png",
    ".md": "text/markdown",
    ".yaml": "application/yaml",
    ".csv": "text/csv",
    ".cat": "text/plain",
    ".psf": "application/fits",
    ".conf": "text/plain",
    ".tsv": "text/tab-separated-values",
}
PLAIN = "text/plain"
ORGANISATION = "#contributors"
RUN = "#run"
SNAKEMAKE = "https://snakemake.readthedocs.io"
LICENCES = {
    "CC-BY-4.0": ("https://creativecommons.org/licenses/by/4.0/", "Creative Commons Attribution 4.0"),
    "CC0-1.0": ("https://creativecommons.org/publicdomain/zero/1.0/", "Creative Commons Zero 1.0"),
}


class CrateFile(NamedTuple):
    """A file of a crate: its kind in words, its size [bytes] and its SHA-256."""

    kind: str
    size: int
    sha256: str


@dataclass(frozen=True)
class Crate:
    """The description of a folder.

    files: {path below the folder: CrateFile}; folders: {first folder of a path: what it holds};
    run: release.run_record.RunRecord, or None; inputs: names in INPUTS; version: of the table of columns; authors:
    names of people.
    """

    name: str
    description: str
    files: dict[str, CrateFile]
    folders: dict[str, str] = field(default_factory=dict)
    run: RunRecord | None = None
    inputs: tuple[str, ...] = ()
    version: str = ""
    authors: tuple[str, ...] = ()
    licence: str = "CC-BY-4.0"


def licence_of(name: str) -> tuple[str, str]:
    """Return (address, title) of a licence, one of LICENCES or an address. Raises InputError for another word."""
    if name in LICENCES:
        return LICENCES[name]
    if not name.startswith(("https://", "http://")):
        raise InputError("unknown licence", key="--licence", value=name, allowed=f"{', '.join(LICENCES)}, an address")
    return name, name


def write_crate(folder: PathLike, crate: Crate) -> Path:
    """Write the metadata of a Crate into its folder; return the path. The same crate gives the same bytes but dates."""
    path = Path(folder) / CRATE_FILE
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(metadata(crate), indent=1) + "\n", encoding="utf-8")
    return path


def metadata(crate: Crate, now: datetime | None = None) -> dict[str, Any]:
    """Return the JSON-LD of a Crate. now: datetime of the publication [default: the clock]."""
    now = now or datetime.now(UTC)
    address, title = licence_of(crate.licence)
    people = [{"@id": f"#{quote(name)}", "@type": "Person", "name": name} for name in dict.fromkeys(crate.authors)]
    people = people or [{"@id": ORGANISATION, "@type": "Organization", "name": "the csstsim contributors"}]
    first, *_ = people
    folders = _folders(crate)
    about = {
        "@id": CRATE_FILE,
        "@type": "CreativeWork",
        "about": _to("./"),
        "conformsTo": _compact([_to(CRATE), *([_to(WORKFLOW_CRATE)] if crate.run else [])]),
    }
    root = {
        "@id": "./",
        "@type": "Dataset",
        "name": crate.name,
        "description": crate.description,
        "datePublished": f"{now:%Y-%m-%dT%H:%M:%S+00:00}",
        "license": _to(address),
        "author": _all(people),
        "publisher": _to(first["@id"]),
        "hasPart": _compact([*map(_to, _names(folders)), *(_to(_id(path)) for path in crate.files if "/" not in path)]),
    }
    licence = {
        "@id": address,
        "@type": "CreativeWork",
        "name": title,
        "description": f"the licence of these data: {title}",
    }
    files = [_file(path, file) for path, file in crate.files.items()]
    run = _run(crate, root, files, folders) if crate.run else []
    return {"@context": CONTEXT, "@graph": [about, root, licence, *people, *folders, *files, *run]}


def _folders(crate: Crate) -> list[dict[str, Any]]:
    """Return the entities of the folders: each holds its files, those of the folders in it included."""
    paths = sorted(path for path in crate.files if "/" in path)
    return [
        {
            "@id": _id(f"{name}/"),
            "@type": "Dataset",
            "name": name,
            "description": crate.folders.get(name, name),
            "hasPart": _compact([_to(_id(path)) for path in inside]),
        }
        for name, inside in groupby(paths, lambda path: path.partition("/")[0])
    ]


def _file(path: str, file: CrateFile) -> dict[str, Any]:
    about = {"about": _to("./")} if path == README else {}
    return about | {
        "@id": _id(path),
        "@type": "File",
        "name": Path(path).name,
        "description": file.kind,
        "encodingFormat": MEDIA.get(Path(path).suffix, PLAIN),
        "contentSize": str(file.size),
        "sha256": file.sha256,
    }


def _run(
    crate: Crate, root: dict[str, Any], files: Iterable[dict[str, Any]], folders: Iterable[dict[str, Any]]
) -> list[dict[str, Any]]:
    """Return the entities of the workflow's run, and complete the root and the workflow's files."""
    run = cast("RunRecord", crate.run)
    entities = {file["@id"]: file for file in files}
    root |= {
        "conformsTo": [_to(address) for address in RUN_PROFILES],
        "mainEntity": _to(WORKFLOW),
        "mentions": _to(RUN),
    }
    parameter = {
        "@id": "#campaign",
        "@type": "FormalParameter",
        "name": "campaign",
        "additionalType": "File",
        "description": "the campaign file: what is simulated, and how",
        "valueRequired": True,
        "conformsTo": _to(BIOSCHEMAS.format("FormalParameter")),
    }
    result = {
        "@id": "#products",
        "@type": "FormalParameter",
        "name": "products",
        "additionalType": "Dataset",
        "description": "the products, a folder of each kind",
        "conformsTo": _to(BIOSCHEMAS.format("FormalParameter")),
    }
    entities[WORKFLOW] |= {
        "@type": ["File", "SoftwareSourceCode", "ComputationalWorkflow"],
        "name": "csstsim's workflow",
        "programmingLanguage": _to(SNAKEMAKE),
        "input": _to("#campaign"),
        "output": _to("#products"),
        "conformsTo": _to(BIOSCHEMAS.format("ComputationalWorkflow")),
        "license": _to("#bsd"),
        "version": ", ".join(run.versions),
    }
    entities[TABLES] |= {"version": crate.version}
    inputs = [_id(f"{INPUTS}/{name}") for name in crate.inputs]
    campaign, *_ = inputs
    entities[campaign]["exampleOfWork"] = _to("#campaign")
    made = [one for one in folders if one["@id"] != _id(f"{WORKFLOW.partition('/')[0]}/")]
    for one in made:
        one["exampleOfWork"] = _to("#products")
    jobs = ", ".join(f"{count} {rule}" for rule, count in run.jobs.items())
    action = {
        "@id": RUN,
        "@type": "CreateAction",
        "name": f"Snakemake's run of {crate.name}",
        "description": f"{sum(run.jobs.values())} jobs: {jobs}",
        "instrument": _to(WORKFLOW),
        "agent": root["publisher"],
        "actionStatus": "http://schema.org/CompletedActionStatus",
        "startTime": f"{run.start:%Y-%m-%dT%H:%M:%S+00:00}",
        "endTime": f"{run.end:%Y-%m-%dT%H:%M:%S+00:00}",
        "object": [_to(name) for name in [*inputs, RECIPES]],
        "result": _all(made),
    }
    language = {
        "@id": SNAKEMAKE,
        "@type": "ComputerLanguage",
        "name": "Snakemake",
        "alternateName": "Snakemake",
        "identifier": {"@id": SNAKEMAKE},
        "url": {"@id": SNAKEMAKE},
    }
    own = {"@id": "#bsd", "@type": "CreativeWork", "name": "BSD-3-Clause", "description": "the licence of csstsim"}
    profiles = [
        {"@id": address, "@type": "CreativeWork", "name": name, "version": version}
        for address, (name, version) in RUN_PROFILES.items()
    ]
    return [action, language, parameter, result, own, *profiles]


def _id(path: str) -> str:
    return quote(path, safe="/=")


def _names(entities: Iterable[Mapping[str, Any]]) -> list[str]:
    return [entity["@id"] for entity in entities]


def _to(name: str) -> dict[str, str]:
    return {"@id": name}


def _all(entities: Iterable[Mapping[str, Any]]) -> dict[str, str] | list[dict[str, str]]:
    """Return links to entities; of one alone the link itself, as compact JSON-LD has it."""
    return _compact([_to(entity["@id"]) for entity in entities])


def _compact(values: list[dict[str, str]]) -> dict[str, str] | list[dict[str, str]]:
    if len(values) == 1:
        [only] = values
        return only
    return values
