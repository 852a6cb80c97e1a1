"""What the RO-Crate metadata of a folder must hold, and the validator of others, if it is installed."""

import json
import os
import shutil
import subprocess
from urllib.parse import unquote

import pytest


def checked(folder):
    """Return {@id: entity} of a folder's crate: each link resolves, each file is there, all hang on the root."""
    graph = json.loads((folder / "ro-crate-metadata.json").read_text())["@graph"]
    entities = {one["@id"]: one for one in graph}
    assert len(entities) == len(graph)
    for one in graph:
        for link in _links(one):
            assert link in entities or link.startswith(("http://", "https://")), (one["@id"], link)
    reached, waiting = set(), ["./"]
    while waiting:
        here = waiting.pop()
        reached.add(here)
        parts = entities[here].get("hasPart", [])
        waiting += [part["@id"] for part in (parts if isinstance(parts, list) else [parts])]
    files = {name for name, one in entities.items() if "File" in one["@type"]}
    assert files <= reached
    for name in files:
        path = folder / unquote(name)
        assert path.stat().st_size == int(entities[name]["contentSize"])
    there = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
    return entities, there - {unquote(name) for name in files}


def _links(value):
    if isinstance(value, dict):
        if set(value) == {"@id"}:
            yield value["@id"]
        else:
            yield from (link for key, inner in value.items() if key != "@id" for link in _links(inner))
    elif isinstance(value, list):
        yield from (link for inner in value for link in _links(inner))


def validated(folder, profile):
    """Let rocrate-validator judge a folder's crate: all that is required of `profile`. Skips if it is not there.

    It reads the JSON-LD contexts from the network: set CSSTSIM_ROCRATE_VALIDATOR to a command that can.
    """
    command = os.environ.get("CSSTSIM_ROCRATE_VALIDATOR")
    if not command or not shutil.which(command.split()[0]):
        pytest.skip("CSSTSIM_ROCRATE_VALIDATOR names no rocrate-validator (pip install roc-validator)")
    said = subprocess.run(
        [*command.split(), "-y", "validate", "--no-paging", "-v", "-l", "required", "-p", profile, str(folder)],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert said.returncode == 0, said.stdout[-4000:]
