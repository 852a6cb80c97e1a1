"""`csstsim init DIR` writes a folder with a campaign that runs as it is, for the user to change."""

from __future__ import annotations

import json
import os
import re
import shlex
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.files.atomic import atomic_path
from csstsim.base.shipped import ROOT

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from csstsim.base.types import AnyArray, PathLike
    from csstsim.catalog.table import ObjectTable

# Files of a new folder: what they are copies of, and what they are for.
FILES = {
    "campaign.yaml": ("config/starter/campaign.yaml", "what to run: exposures, chips, sky, seed"),
    "science.yaml": ("config/observations/science.yaml", "how an exposure is made: the layers, in order"),
    "survey_table.csv": ("survey_tables/demo.csv", "where the telescope points, and when"),
    "Snakefile": ("config/starter/Snakefile", "the workflow"),
    "profiles/default/config.yaml": ("profiles/default/config.yaml", "how it is run here: cores, what to do on errors"),
    "profiles/slurm/config.yaml": ("profiles/slurm/config.yaml", "... on a cluster: --workflow-profile profiles/slurm"),
    "profiles/slurm/workflow.yaml": ("profiles/slurm/workflow.yaml", "... and on its nodes"),
}
EXAMPLES = {  # name: folder of examples/
    "layer": "my_layer",
    "catalogue": "my_catalogue",
    "camera": "my_camera",
    "shear": "shear",
    "slitless": "slitless",
    "lens": "lens",
}
KINDS = {  # suffix of an example's file: what it is, where nothing better is known
    ".csv": "a table",
    ".fits": "an image",
    ".md": "text",
    ".py": "a program, in Python",
    ".yaml": "settings",
}
SKIPPED = {"__pycache__", "results", "data"}  # what running an example leaves
AIMED = 8, 9, 7  # chips, g, r and i, that point at a catalogue's objects
# deg; of the first exposure
PA = -113.4333
TIME = "2027-11-20T01:16:00"
# arcmin: beyond the outermost object; a chip's half side is 5.7
MARGIN = 0.2
LARGEST = 5.0


def init(
    folder: PathLike, say: Callable[[str], object], catalogue: PathLike | None = None, example: str | None = None
) -> None:
    """Write the files of FILES into a folder, new or without any of them.

    catalogue: a table of objects (csstsim.catalog.own_table) to copy there, too, and to point at; example: one of
    EXAMPLES, whose files to write instead. Raises InputError for a folder that has one of the files, or a table that
    cannot be used.
    """
    folder = Path(folder)
    if folder.exists() and not folder.is_dir():
        raise InputError("is a file; name the folder to make", file=folder)
    content = {name: (ROOT / source).read_bytes() for name, (source, _) in FILES.items()}
    meanings = {name: meaning for name, (_, meaning) in FILES.items()}
    if example:
        content, meanings = _example(example, content, meanings)
    if catalogue:
        content |= _aimed(Path(catalogue), content)
        meanings |= {name: "named by your table" for name in content if name not in meanings}
        meanings[Path(catalogue).name] = "your objects"
    there = [name for name in content if os.path.lexists(folder / name)]
    if there:
        raise InputError("exists already, and nothing was written; name another folder", file=folder / there[0])
    written = []
    try:
        for name in meanings:
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            with atomic_path(folder / name) as temporary:
                Path(temporary).write_bytes(content[name])
            written.append(folder / name)
    except BaseException:  # a full disk, Ctrl-C: half a folder would be refused the next time
        for path in written:
            path.unlink()
        raise
    for name, meaning in meanings.items():
        say(f"{folder / name}  {meaning}")
    then = "README.md says how it is run" if example else "csstsim plan campaign.yaml\n       snakemake --cores 2"
    say(f"\nNext:  cd {shlex.quote(str(folder))}\n       {then}")


def _example(name: str, content: dict[str, bytes], meanings: dict[str, str]) -> tuple[dict[str, bytes], dict[str, str]]:
    """Return ({file: bytes}, {file: meaning}) of an example's folder, with the workflow and the files it shares."""
    workflow = [file for file in FILES if file not in ("campaign.yaml", "science.yaml", "survey_table.csv")]
    folder = ROOT / "examples" / EXAMPLES[name]
    found: dict[str, bytes] = {}
    for path in sorted(p for p in folder.rglob("*") if p.is_file() and not SKIPPED.intersection(p.parts)):
        data = path.read_bytes()
        if path.parent == folder and path.suffix == ".yaml":
            text, shared = _alone(data.decode())
            data = text.encode()
            found = found | shared
        found[path.relative_to(folder).as_posix()] = data
    found |= {file: content[file] for file in workflow}
    campaigns = {file: "a campaign" for file, data in found.items() if b"schema_version" in data}
    told = meanings | campaigns | {"README.md": "what it is, and how it is run"}
    return found, {file: told.get(file) or KINDS.get(Path(file).suffix, "data") for file in found}


def _alone(campaign: str) -> tuple[str, dict[str, bytes]]:
    """Return (text, {file: bytes}): an example's campaign, and what it shares with others, to lie beside it."""
    files = {}
    for name in set(re.findall(r"\.\./\.\./([\w./-]+)", campaign)):
        source = ROOT / name
        parts = Path(name).parts
        made = parts[0] == "results"
        here = Path("results", *parts[2:]) if made else Path(parts[-1])
        campaign = campaign.replace(f"../../{name}", here.as_posix())
        for path in [] if made else [source, *source.rglob("*")]:
            if path.is_file():
                files[(here / path.relative_to(source)).as_posix()] = path.read_bytes()
    return campaign, files


def _aimed(file: Path, content: dict[str, bytes]) -> dict[str, bytes]:
    """Return {name: bytes} of the files that differ for a user's catalogue: the table, the campaign, the pointings."""
    from csstsim.base.shipped import SHIPPED
    from csstsim.campaign.aiming import aimed, table_of
    from csstsim.catalog.object_table import object_table, read_table
    from csstsim.instrument.camera import load_camera

    if file.name in content:
        raise InputError("another file of the folder has this name; rename the table", file=file)
    camera = load_camera(SHIPPED / "instrument")
    columns = read_table(file)
    ra, dec, radius = _circle(file, object_table(columns, camera.bands, file))
    found = aimed(camera, ra, dec, [camera.chips[number] for number in AIMED], pa=PA, times=[TIME])
    text = content["campaign.yaml"].decode()
    changed = 0
    name = json.dumps(file.name, ensure_ascii=False)  # a scalar of YAML, whatever is in it
    region = f"region: {{ra: {ra:.6f}, dec: {dec:.6f}, radius: {radius:.2f}}}"
    own = f'catalog:\n  kind: "csstsim.catalog.own_table:TableCatalog"\n  options: {{file: {name}}}\npsf:'
    about = "your objects, seen once in each of g, r and i."
    for pattern, new in (
        (r"one small field, [^.]*\.", about),
        (r"region: \{[^}]*\}", region),
        (r"(?s)catalog:.*?psf:", own),
    ):

        def literal(_: re.Match[str], new: str = new) -> str:
            return new

        text, count = re.subn(pattern, literal, text, count=1)
        changed += count
    if changed != 3:
        raise ValueError("config/starter/campaign.yaml: heading, region and catalog are not where they are looked for")
    table = table_of(found).encode()
    named = _named_by(columns, file) | {file.name: file.read_bytes()}
    if taken := sorted(set(content).intersection(named)):
        raise InputError("another file of the folder has this name; rename yours", file=file, value=taken[0])
    return {"campaign.yaml": text.encode(), "survey_table.csv": table} | named


def _named_by(columns: Mapping[str, AnyArray], file: Path) -> dict[str, bytes]:
    """Return {name: bytes} of images and spectra that a table names relative to itself; others stay where they are."""
    from csstsim.catalog.table import FILE_COLUMNS

    found = {}
    for column in FILE_COLUMNS:
        for text in sorted({str(text).strip().split("[")[0] for text in columns.get(column, ())} - {"", "nan", "--"}):
            if Path(text).is_absolute():
                continue
            if ".." in Path(text).parts:
                raise InputError(
                    "would not be found from the new folder",
                    file=file,
                    key=column,
                    value=text,
                    allowed="files in the table's folder or below it, or whole paths",
                )
            try:
                found[Path(text).as_posix()] = (file.parent / text).read_bytes()
            except OSError as exc:
                raise InputError(f"cannot be read: {exc.strerror}", file=file, key=column, value=text) from None
    return found


def _circle(file: Path, table: ObjectTable) -> tuple[float, float, float]:
    """Return ra, dec [deg] of the middle of a table's objects, and the radius of a circle about it [arcmin]."""
    from csstsim.base.sphere import ra_dec, unit_vectors

    vectors = unit_vectors(table["ra"], table["dec"])
    if not len(vectors) or not np.isfinite(vectors).all():
        raise InputError("the table has no objects, or one without a position", file=file, key="ra, dec")
    middle = vectors.mean(axis=0)
    chord = np.linalg.norm(vectors - middle / np.linalg.norm(middle), axis=1).max()
    reach = 60.0 * float(np.degrees(2 * np.arcsin(chord / 2)))
    ra, dec = ra_dec(middle)
    if reach + MARGIN > LARGEST:
        raise InputError(
            "objects lie too far apart for one chip; for more, csstsim init without a catalogue, and a survey table",
            file=file,
            value=f"{reach:.1f} arcmin from their middle",
            allowed=f"{LARGEST - MARGIN:g} arcmin",
        )
    return round(float(ra), 6) % 360.0, float(dec), reach + MARGIN
