"""The contents of an output folder without its campaign file, from its products.

File names give the frames and bricks. Headers of Level-0 files give their recipes, which must agree within a campaign.
A missing frame or truth brick cannot be noticed this way: for that the manifest or the campaign file is needed.
"""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import replace
from typing import TYPE_CHECKING

from csstsim.base.errors import InputError
from csstsim.base.stage_records import STAGES
from csstsim.delivery.contents import CHECKED, MAYBE, NO, YES, Contents, ExpectedFrame
from csstsim.io.keywords import recorded_recipe
from csstsim.io.level0 import read_level0
from csstsim.io.level0_names import FORMS, read_name
from csstsim.io.paths import CAT, ORDERS, RENDER_PRODUCTS, TRUTH, Paths

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path
    from typing import Any

    from csstsim.base.types import PathLike


# of names of files: a brick's number, a brick, a chip's master frames
NUMBER = re.compile(r"\d{1,6}")
BRICK = re.compile(r"Npix=(\d{1,6})\.parquet")
MASTER = re.compile(r"chip_(\d\d)\.fits")


def of_folder(folder: PathLike) -> Contents:
    """Return the Contents of a folder. Raises InputError if it is not the output of a campaign."""
    paths = Paths(folder)
    if not (paths.output / "level0").is_dir():
        raise InputError(
            "not the output of a campaign: it has no folder level0",
            file=folder,
            allowed="a campaign file, or an output folder",
        )
    frames = _with_kinds([_frame(stated, path) for stated, path in _stems(paths.output / "level0")], paths)
    if not frames:
        raise InputError("holds no Level-0 file", file=paths.output / "level0")
    merged = {int(m[1]) for path in _files(paths.merge_catalogue / "dataset") if (m := BRICK.fullmatch(path.name))}
    validated = {int(path.stem) for path in _files(paths.output / "validate") if NUMBER.fullmatch(path.stem)}
    listed = _listed(paths.merge_catalogue / "partition_info.csv")
    truth = {int(m[1]) for path in _files(paths.truth_catalogue) if (m := BRICK.fullmatch(path.name))}
    truth |= _listed(paths.truth_catalogue / "partition_info.csv")
    masters = {int(m[1]) for path in _files(paths.output / "masters") if (m := MASTER.fullmatch(path.name))}
    inconsistent = _inconsistent(frames)
    return Contents(
        paths=paths,
        frames=frames,
        bricks=dict.fromkeys(sorted(merged | validated | listed)),
        truth=dict.fromkeys(sorted(truth)),
        masters=dict.fromkeys(sorted(masters)),
        light=dict.fromkeys(path for path in _files(paths.chips) if path.name in RENDER_PRODUCTS),
        measurement=_measurement(paths, frames),
        calibrated=MAYBE,
        joint=MAYBE,
        report=YES if any(frame.type == "SCIE" for frame in frames) else MAYBE,
        cat=MAYBE,
        others=_others(paths.output),
        faults=inconsistent,
    )


def _files(folder: Path) -> list[Path]:
    """Return the files below a folder, sorted; links to folders are not followed."""
    return sorted(path for path in folder.rglob("*") if path.is_file())


def _others(folder: Path) -> dict[Path, str]:
    """Return {file of a stage that is not in CHECKED: what it is}."""
    stages = [stage for stage in STAGES.values() if stage.kept == "yes" and not stage.instead_of]
    return {
        path: stage.title
        for stage in stages
        if stage.name not in CHECKED
        for product in stage.products
        for path in sorted(folder.glob(re.sub(r"\{\w+\}", "*", product.path)))
    }


def _stems(folder: Path) -> list[tuple[tuple[str, str, int], Path]]:
    """Return [((type, obsid, chip) of a name, Level-0 file)]: also where only its truth is left."""
    found = {}
    for path in _files(folder):
        name = path.name.removesuffix(TRUTH).removesuffix(".fits")
        stated = read_name(name)
        if stated is None:
            continue
        if path.parent.name == stated.obsid and path.parent.parent == folder:
            found[path.parent / f"{name}.fits"] = stated
    return [(stated, path) for path, stated in sorted(found.items())]


def _frame(stated: tuple[str, str, int], path: Path) -> ExpectedFrame:
    """Return the ExpectedFrame of a Level-0 file: by its header, or, if that cannot be read, by its name alone."""
    kind, obsid, chip = stated
    frame = ExpectedFrame(
        obsid=obsid,
        chip=chip,
        filter=None,
        type=kind,
        level0=path,
        recipe=None,
        rays_recipe=None,
        window=None,
        measured=MAYBE,
        extracted=MAYBE,
        cosmic=MAYBE,
    )
    if kind != "SCIE":
        frame = replace(frame, measured=NO, extracted=NO)
    try:
        if not path.is_file():
            return frame
        file = read_level0(path)
    except (InputError, OSError):
        return frame  # its own check says what is wrong
    filter_ = str(file.header0.get("FILTER"))
    names = (form.catalogue(path.stem, filter_) for form in FORMS.values())
    texts = (path.with_name(f"{name}{CAT}") for name in names if name)
    frame = replace(frame, catalogue=next((text for text in texts if text.is_file()), None))
    return replace(frame, filter=filter_, recipe=recorded_recipe(file.header0), window=file.readout.window)


def _with_kinds(frames: Sequence[ExpectedFrame], paths: Paths) -> tuple[ExpectedFrame, ...]:
    """Return the frames, spectra distinguished from images: a filter is a grating if one of its frames has orders."""
    spectra = {f.filter for f in frames if f.companion(ORDERS).is_file() or paths.spectra(*f.key).is_file()} - {None}
    return tuple(
        frame
        if frame.type != "SCIE" or frame.filter is None
        else replace(frame, measured=NO, extracted=MAYBE)
        if frame.filter in spectra
        else replace(frame, measured=YES, extracted=NO)
        for frame in frames
    )


def _inconsistent(frames: Sequence[ExpectedFrame]) -> list[tuple[Path, str]]:
    """Return [(path, fault)] of frames whose release, campaign, camera or layer list differs from that of most."""
    faults = []
    for name in ("csstsim", "campaign", "camera", "layers"):
        kinds: dict[str | None, list[tuple[Path, Any]]] = {}
        for frame in frames:
            if frame.recipe is not None:
                kind = frame.type if name == "layers" else None
                kinds.setdefault(kind, []).append((frame.level0, frame.recipe[name]))
        for group in kinds.values():
            [(usual, _)] = Counter(str(value) for _, value in group).most_common(1)
            faults += [
                (path, f"made for another campaign than most: {name} {value!r:.80}, not {usual!r}")
                for path, value in group
                if str(value) != usual
            ]
    return faults


def _measurement(paths: Paths, frames: Iterable[ExpectedFrame]) -> str | None:
    """Return the digest of the settings of `measure` that the first readable table records, or None."""
    from csstsim.catalog.table import ObjectTable, footer

    for frame in frames:
        for path in (paths.measure(*frame.key), paths.spectra(*frame.key)):
            try:
                if path.is_file() and footer(path).num_columns:
                    recipe = ObjectTable.read(path, []).meta.get("recipe")
                    return recipe.get("measurement") if isinstance(recipe, dict) else None
            except InputError:
                continue
    return None


def _listed(path: Path) -> set[int]:
    """Return the bricks that a HATS catalogue's partition_info.csv names."""
    try:
        lines = path.read_text(encoding="utf-8").split()[1:]
    except (OSError, ValueError):
        return set()
    return {int(line[2:]) for line in lines if line.startswith("8,") and NUMBER.fullmatch(line[2:])}
