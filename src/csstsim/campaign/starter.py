"""`csstsim init DIR` writes a folder with a campaign that runs as it is and that the user may change."""

from __future__ import annotations

import json
import os
import re
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.files.atomic import atomic_path
from csstsim.base.shipped import ROOT, SHIPPED

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from csstsim.base.types import AnyArray, PathLike
    from csstsim.catalog.table import ObjectTable

# {file of a new folder: (the file it is a copy of, its purpose)}
FILES = {
    "campaign.yaml": ("config/starter/campaign.yaml", "the campaign: exposures, chips, sky, seed"),
    "science.yaml": ("config/observations/science.yaml", "the layers of a science exposure, in order"),
    "survey_table.csv": ("survey_tables/demo.csv", "the pointings: direction, time and exposure time"),
    "Snakefile": ("config/starter/Snakefile", "the workflow"),
    "profiles/default/config.yaml": ("profiles/default/config.yaml", "workflow on this machine: cores, restarts"),
    "profiles/slurm/config.yaml": ("profiles/slurm/config.yaml", "on Slurm: --workflow-profile profiles/slurm"),
    "profiles/slurm/workflow.yaml": ("profiles/slurm/workflow.yaml", "on Slurm: options of jobs on nodes"),
}
EXAMPLES = {  # name: folder of examples/
    "layer": "my_layer",
    "catalogue": "my_catalogue",
    "camera": "my_camera",
    "shear": "shear",
    "slitless": "slitless",
    "lens": "lens",
}
PURPOSES = {  # {suffix of an example's file: its purpose, if FILES does not have it}
    ".csv": "a table",
    ".fits": "an image",
    ".md": "a description",
    ".py": "Python code of the example",
    ".yaml": "settings",
}
_SCHEMA = re.compile(rb"\$schema=[\w./]*/schema/")
SKIPPED = {"__pycache__", "results", "data"}  # folders written by an example that was run
CHIPS = 8, 9, 7  # in g, r and i, for exposures of a user's objects
PA = -113.4333  # deg
TIME = "2027-11-20T01:16:00"  # start of the first exposure
MARGIN = 0.2  # arcmin, from the outermost object to the edge of the region
MAX_RADIUS = 5.0  # arcmin, of the region; half the side of a chip is 5.7


def init(
    folder: PathLike, log: Callable[[str], object], catalogue: PathLike | None = None, example: str | None = None
) -> None:
    """Write the files of FILES into a folder that has none of them.

    catalogue: a table of objects (csstsim.catalog.own_table), which is copied and observed; example: one of EXAMPLES,
    whose files are written instead. Raises InputError for a folder that has one of the files, or a table that cannot
    be used.
    """
    folder = Path(folder)
    if folder.exists() and not folder.is_dir():
        raise InputError("is a file; name the folder to make", file=folder)
    content = {name: _content(ROOT / source) for name, (source, _) in FILES.items()}
    purposes = {name: purpose for name, (_, purpose) in FILES.items()}
    if example:
        content, purposes = _example(example, content, purposes)
    if catalogue:
        content |= _files_of_catalogue(Path(catalogue), content)
        purposes |= {name: "named in your table" for name in content if name not in purposes}
        purposes[Path(catalogue).name] = "your objects"
    existing = [name for name in content if os.path.lexists(folder / name)]
    if existing:
        raise InputError("exists already, and nothing was written; name another folder", file=folder / existing[0])
    written = []
    try:
        for name in purposes:
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            with atomic_path(folder / name) as temporary:
                Path(temporary).write_bytes(content[name])
            written.append(folder / name)
    except BaseException:  # a full disk, Ctrl-C: an incomplete folder would be refused the next time
        for path in written:
            path.unlink()
        raise
    for name, purpose in purposes.items():
        log(f"{folder / name}  {purpose}")
    next_step = "see README.md" if example else "csstsim plan campaign.yaml\n       snakemake --cores 2"
    log(f"\nNext:  cd {shlex.quote(str(folder))}\n       {next_step}")


def _content(path: Path) -> bytes:
    """Return the bytes of a file; the first line of YAML then names the schema of the installed package."""
    data = path.read_bytes()
    if path.suffix != ".yaml":
        return data
    schemas = SHIPPED / "schema"
    return _SCHEMA.sub(lambda match: f"$schema={schemas}/".encode(), data, count=1)


def _example(name: str, content: dict[str, bytes], purposes: dict[str, str]) -> tuple[dict[str, bytes], dict[str, str]]:
    """Return ({file: bytes}, {file: purpose}) of an example, with the workflow and the files it shares with others."""
    workflow = [file for file in FILES if file not in ("campaign.yaml", "science.yaml", "survey_table.csv")]
    folder = ROOT / "examples" / EXAMPLES[name]
    files: dict[str, bytes] = {}
    for path in sorted(p for p in folder.rglob("*") if p.is_file() and not SKIPPED.intersection(p.parts)):
        data = _content(path)
        if path.parent == folder and path.suffix == ".yaml":
            text, shared = _standalone(data.decode())
            data = text.encode()
            files |= shared
        files[path.relative_to(folder).as_posix()] = data
    files |= {file: content[file] for file in workflow}
    campaigns = {file: "a campaign" for file, data in files.items() if b"schema_version" in data}
    known = purposes | campaigns | {"README.md": "description of the example, and how to run it"}
    return files, {file: known.get(file) or PURPOSES.get(Path(file).suffix, "data") for file in files}


def _standalone(campaign: str) -> tuple[str, dict[str, bytes]]:
    """Return (text, {file: bytes}) of an example's campaign, with its shared files next to it."""
    files = {}
    for name in set(re.findall(r"\.\./\.\./([\w./-]+)", campaign)):
        source = ROOT / name
        parts = Path(name).parts
        is_product = parts[0] == "results"
        target = Path("results", *parts[2:]) if is_product else Path(parts[-1])
        campaign = campaign.replace(f"../../{name}", target.as_posix())
        for path in [] if is_product else [source, *source.rglob("*")]:
            if path.is_file():
                files[(target / path.relative_to(source)).as_posix()] = path.read_bytes()
    return campaign, files


def _files_of_catalogue(file: Path, content: dict[str, bytes]) -> dict[str, bytes]:
    """Return {name: bytes} of the files that differ for a user's catalogue: the table, the campaign, the pointings."""
    from csstsim.campaign.aiming import aimed_exposures, survey_table_text
    from csstsim.catalog.object_table import object_table, read_table
    from csstsim.instrument.camera import load_camera

    if file.name in content:
        raise InputError("another file of the folder has this name; rename the table", file=file)
    camera = load_camera(SHIPPED / "instrument")
    columns = read_table(file)
    circle = _circle(file, object_table(columns, camera.bands, file))
    chips = [camera.chips[number] for number in CHIPS]
    exposures = aimed_exposures(camera, circle.ra, circle.dec, chips, pa=PA, times=[TIME])
    text = content["campaign.yaml"].decode()
    changed = 0
    name = json.dumps(file.name, ensure_ascii=False)  # a valid YAML scalar for any name
    region = f"region: {{ra: {circle.ra:.6f}, dec: {circle.dec:.6f}, radius: {circle.radius:.2f}}}"
    catalog = f'catalog:\n  kind: "csstsim.catalog.own_table:TableCatalog"\n  options: {{file: {name}}}\npsf:'
    heading = "your objects, observed once in each of g, r and i."
    for pattern, new in (
        (r"one small field, [^.]*\.", heading),
        (r"region: \{[^}]*\}", region),
        (r"(?s)catalog:.*?psf:", catalog),
    ):

        def literal(_: re.Match[str], new: str = new) -> str:
            return new

        text, count = re.subn(pattern, literal, text, count=1)
        changed += count
    if changed != 3:
        raise ValueError("config/starter/campaign.yaml: heading, region or catalog not found")
    table = survey_table_text(exposures).encode()
    users_files = _named_files(columns, file) | {file.name: file.read_bytes()}
    if taken := sorted(set(content).intersection(users_files)):
        raise InputError("another file of the folder has this name; rename yours", file=file, value=taken[0])
    return {"campaign.yaml": text.encode(), "survey_table.csv": table} | users_files


def _named_files(columns: Mapping[str, AnyArray], file: Path) -> dict[str, bytes]:
    """Return {name: bytes} of the images and spectra that a table names by relative paths; others are not copied."""
    from csstsim.catalog.table import FILE_COLUMNS

    files = {}
    for column in FILE_COLUMNS:
        for text in sorted({str(text).strip().split("[")[0] for text in columns.get(column, ())} - {"", "nan", "--"}):
            if Path(text).is_absolute():
                continue
            if ".." in Path(text).parts:
                raise InputError(
                    "is outside the table's folder and would not be found from the new folder",
                    file=file,
                    key=column,
                    value=text,
                    allowed="files in the table's folder or below it, or absolute paths",
                )
            try:
                files[Path(text).as_posix()] = (file.parent / text).read_bytes()
            except OSError as exc:
                raise InputError(f"cannot be read: {exc.strerror}", file=file, key=column, value=text) from None
    return files


class _Circle(NamedTuple):
    ra: float  # deg, of the centre
    dec: float  # deg
    radius: float  # arcmin


def _circle(file: Path, table: ObjectTable) -> _Circle:
    """Return the _Circle around a table's objects, MARGIN larger than needed."""
    from csstsim.base.sphere import ra_dec, unit_vectors

    vectors = unit_vectors(table["ra"], table["dec"])
    if not len(vectors) or not np.isfinite(vectors).all():
        raise InputError("the table has no objects, or one without a position", file=file, key="ra, dec")
    centre = vectors.mean(axis=0)
    chord = np.linalg.norm(vectors - centre / np.linalg.norm(centre), axis=1).max()
    radius = 60.0 * float(np.degrees(2 * np.arcsin(chord / 2)))
    ra, dec = ra_dec(centre)
    if radius + MARGIN > MAX_RADIUS:
        raise InputError(
            "objects are too far from each other for one chip; for more chips use csstsim init without a catalogue, "
            "and a survey table",
            file=file,
            value=f"{radius:.1f} arcmin from their centre",
            allowed=f"{MAX_RADIUS - MARGIN:g} arcmin",
        )
    return _Circle(round(float(ra), 6) % 360.0, float(dec), radius + MARGIN)
