"""RO-Crate metadata (ro-crate-metadata.json) of a folder of products.

RO-Crate 1.1 (https://w3id.org/ro/crate/1.1) describes the files. Workflow Run Crate 0.5
(https://w3id.org/ro/wfrun/workflow/0.5), built on Workflow RO-Crate 1.0, describes how they were made. The terms are
those of schema.org. The workflow, the campaign and the recipes are files of the crate (release.made_with).

The library rocrate (0.16) would make this module a quarter shorter: links, context and language of the workflow. The
properties of the entities, most of the module, would stay. In return it needs 0.2 CPU-s to import and four times as
long to build the entities, puts each file into the root's hasPart as well as its folder's, writes `=` in paths as %3D,
and its wheel installs a top-level package `test`. rocrate-validator passes the metadata of both.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from datetime import UTC, datetime
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple
from urllib.parse import quote

from csstsim.base.errors import InputError
from csstsim.base.files.atomic import atomic_path
from csstsim.delivery.manifest import CRATE_FILE, CRATE_FOLDER
from csstsim.studies.release.made_with import INPUTS, RECIPES, TABLES, WORKFLOW

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from typing import Any, TypeAlias

    from csstsim.base.types import PathLike
    from csstsim.studies.release.run_record import RunRecord

    Entity: TypeAlias = dict[str, Any]  # a node of the graph, with "@id" and "@type"
    Link: TypeAlias = dict[str, str]  # {"@id": of an entity}

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
PARAMETER = "#campaign"
RESULT = "#products"
CSSTSIM_LICENCE = "#bsd"
SNAKEMAKE = "https://snakemake.readthedocs.io"
LICENCES = {
    "CC-BY-4.0": ("https://creativecommons.org/licenses/by/4.0/", "Creative Commons Attribution 4.0"),
    "CC0-1.0": ("https://creativecommons.org/publicdomain/zero/1.0/", "Creative Commons Zero 1.0"),
}


class CrateFile(NamedTuple):
    """A file of a crate: what it is, in words; its size [bytes]; its SHA-256."""

    kind: str
    size: int
    sha256: str


@dataclass(frozen=True)
class Crate:
    """The description of a folder.

    files: {path below the folder: CrateFile}; folders: {first folder of a path: description of its contents};
    run: release.run_record.RunRecord, or None; inputs: names in INPUTS, the campaign first; version: of the table of
    columns; authors: names of people.
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
    """Write the metadata of a Crate into its folder; return the path. One crate gives the same bytes, but for dates."""
    path = Path(folder) / CRATE_FILE
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(metadata(crate), indent=1) + "\n", encoding="utf-8")
    return path


def metadata(crate: Crate, now: datetime | None = None) -> Entity:
    """Return the JSON-LD of a Crate. now: datetime of the publication [default: the clock]."""
    address, title = licence_of(crate.licence)
    people = [{"@id": f"#{quote(name)}", "@type": "Person", "name": name} for name in dict.fromkeys(crate.authors)]
    people = people or [{"@id": ORGANISATION, "@type": "Organization", "name": "the csstsim contributors"}]
    publisher, *_ = people
    folders = _folders(crate)
    descriptor = {
        "@id": CRATE_FILE,
        "@type": "CreativeWork",
        "about": _link("./"),
        "conformsTo": _compact([_link(CRATE), *([_link(WORKFLOW_CRATE)] if crate.run else [])]),
    }
    top_files = [_link(_id(path)) for path in crate.files if "/" not in path]
    root = {
        "@id": "./",
        "@type": "Dataset",
        "name": crate.name,
        "description": crate.description,
        "datePublished": _timestamp(now or datetime.now(UTC)),
        "license": _link(address),
        "author": _compact(_links(people)),
        "publisher": _link(publisher["@id"]),
        "hasPart": _compact([*_links(folders), *top_files]),
    }
    licence = {
        "@id": address,
        "@type": "CreativeWork",
        "name": title,
        "description": f"the licence of these data: {title}",
    }
    files = [_file(path, file) for path, file in crate.files.items()]
    run = _run(crate, crate.run, root, files, folders) if crate.run else []
    return {"@context": CONTEXT, "@graph": [descriptor, root, licence, *people, *folders, *files, *run]}


def _folders(crate: Crate) -> list[Entity]:
    """Return the entities of the top folders: each has all files below it as parts."""
    paths = sorted(path for path in crate.files if "/" in path)
    return [
        {
            "@id": _id(f"{name}/"),
            "@type": "Dataset",
            "name": name,
            "description": crate.folders.get(name, name),
            "hasPart": _compact([_link(_id(path)) for path in paths_below]),
        }
        for name, paths_below in groupby(paths, lambda path: path.partition("/")[0])
    ]


def _file(path: str, file: CrateFile) -> Entity:
    about = {"about": _link("./")} if path == README else {}
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
    crate: Crate, run: RunRecord, root: Entity, files: Iterable[Entity], folders: Iterable[Entity]
) -> list[Entity]:
    """Return the entities of the workflow's run; complete the root, the workflow's files and the folders."""
    by_id = {file["@id"]: file for file in files}
    inputs = [_id(f"{INPUTS}/{name}") for name in crate.inputs]
    campaign, *_ = inputs
    product_folders = [folder for folder in folders if folder["@id"] != _id(f"{CRATE_FOLDER}/")]
    root |= {
        "conformsTo": [_link(address) for address in RUN_PROFILES],
        "mainEntity": _link(WORKFLOW),
        "mentions": _link(RUN),
    }
    by_id[WORKFLOW] |= {
        "@type": ["File", "SoftwareSourceCode", "ComputationalWorkflow"],
        "name": "csstsim's workflow",
        "programmingLanguage": _link(SNAKEMAKE),
        "input": _link(PARAMETER),
        "output": _link(RESULT),
        "conformsTo": _link(BIOSCHEMAS.format("ComputationalWorkflow")),
        "license": _link(CSSTSIM_LICENCE),
        "version": ", ".join(run.versions),
    }
    by_id[TABLES] |= {"version": crate.version}
    by_id[campaign]["exampleOfWork"] = _link(PARAMETER)
    for folder in product_folders:
        folder["exampleOfWork"] = _link(RESULT)
    jobs = ", ".join(f"{count} {rule}" for rule, count in run.jobs.items())
    action = {
        "@id": RUN,
        "@type": "CreateAction",
        "name": f"Snakemake's run of {crate.name}",
        "description": f"{sum(run.jobs.values())} jobs: {jobs}",
        "instrument": _link(WORKFLOW),
        "agent": root["publisher"],
        "actionStatus": "http://schema.org/CompletedActionStatus",
        "startTime": _timestamp(run.start),
        "endTime": _timestamp(run.end),
        "object": [_link(name) for name in [*inputs, RECIPES]],
        "result": _compact(_links(product_folders)),
    }
    return [action, *_fixed_entities()]


def _fixed_entities() -> list[Entity]:
    """Return the entities that do not depend on the run: language, parameter, result, licence of csstsim, profiles."""
    language = {
        "@id": SNAKEMAKE,
        "@type": "ComputerLanguage",
        "name": "Snakemake",
        "alternateName": "Snakemake",
        "identifier": _link(SNAKEMAKE),
        "url": _link(SNAKEMAKE),
    }
    parameter = {
        "@id": PARAMETER,
        "@type": "FormalParameter",
        "name": "campaign",
        "additionalType": "File",
        "description": "the campaign file: what is simulated, and how",
        "valueRequired": True,
        "conformsTo": _link(BIOSCHEMAS.format("FormalParameter")),
    }
    result = {
        "@id": RESULT,
        "@type": "FormalParameter",
        "name": "products",
        "additionalType": "Dataset",
        "description": "the products, a folder of each kind",
        "conformsTo": _link(BIOSCHEMAS.format("FormalParameter")),
    }
    licence = {
        "@id": CSSTSIM_LICENCE,
        "@type": "CreativeWork",
        "name": "BSD-3-Clause",
        "description": "the licence of csstsim",
    }
    profiles = [
        {"@id": address, "@type": "CreativeWork", "name": name, "version": version}
        for address, (name, version) in RUN_PROFILES.items()
    ]
    return [language, parameter, result, licence, *profiles]


def _id(path: str) -> str:
    return quote(path, safe="/=")


def _timestamp(time: datetime) -> str:
    return f"{time:%Y-%m-%dT%H:%M:%S+00:00}"


def _link(name: str) -> Link:
    return {"@id": name}


def _links(entities: Iterable[Mapping[str, Any]]) -> list[Link]:
    return [_link(entity["@id"]) for entity in entities]


def _compact(links: Sequence[Link]) -> Link | Sequence[Link]:
    """Return links as compact JSON-LD has them: a single one is not a list."""
    return links[0] if len(links) == 1 else links
