"""`csstsim budget redshift`: the spectra of a campaign stacked, and a fitter's redshifts scored, with a figure."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.files.atomic import atomic_path
from csstsim.base.files.output_folder import output_folder
from csstsim.base.types import PathLike
from csstsim.catalog.table import GALAXY, ObjectTable
from csstsim.studies.budget.answer import answer_number, answer_rows
from csstsim.studies.budget.redshift.extracted import extracted
from csstsim.studies.budget.redshift.line_biases import by_contamination, line_biases
from csstsim.studies.budget.redshift.scores import RIGHT, scores
from csstsim.studies.budget.redshift.stack import stacked, usable

if TYPE_CHECKING:
    from csstsim.campaign.opened import OpenCampaign
    from csstsim.studies.budget.redshift.extracted import FrameTables


def budget(
    runs: Sequence[OpenCampaign],
    output: PathLike,
    spectra: PathLike | None = None,
    answer: PathLike | None = None,
    band: str = "i",
    log: Callable[[str], object] = print,
) -> dict[str, Any] | None:
    """Write stack.parquet and objects.parquet, for a fitter, into `output`; with its answer, scores and a figure, too.

    runs: campaign.opened.OpenCampaign of different positions; spectra: folder, relative to each campaign's file, of
    tables as `extract` writes them, or None: the campaign's; answer: CSV file of columns id, z and good (0 or 1); band:
    of the magnitudes. Returns the scores, or None. Raises InputError.
    """
    output = output_folder(output)
    run, *_ = runs
    given = None if answer is None else read_answer(answer)
    name = f"mag_{band}"
    if band not in run.camera.bands:
        raise InputError("no such band", key="--band", value=band, allowed=", ".join(run.camera.bands))
    frames = extracted(runs, spectra, log)
    tables = [frame.spectra for frame in frames]
    objects = objects_of(frames, name)
    _check_band(frames, objects, run.camera.bands, band)
    if given is not None and answer is not None:
        _check_ids(given, tables, answer)
    stack = stacked(tables)
    found = None
    if given is not None:
        found = scores(given, objects)
        lines = by_contamination(line_biases(tables, [frame.lines for frame in frames]))
    output.mkdir(parents=True, exist_ok=True)  # nothing is written before all is checked
    stack.write(output / "stack.parquet", {"frames": len(tables)})
    objects.write(output / "objects.parquet", {"band": band})
    log(f"{len(objects)} galaxies in {len(tables)} frames: {output / 'stack.parquet'}")
    if found is None:
        return None
    result = {"right": RIGHT, "band": band, "frames": len(tables), **found, "lines": lines}
    with atomic_path(output / "redshift.json") as temporary:
        temporary.write_text(json.dumps(_plain(result), indent=1))
    from csstsim.studies.budget.redshift.figure import figure

    assert given is not None  # of which the scores are

    with atomic_path(output / "redshift.png") as temporary:
        temporary.write_bytes(figure(result, given, objects))
    for line in text(result):
        log(line)
    return result


def _check_band(
    frames: Sequence[FrameTables],
    objects: ObjectTable,
    bands: Iterable[str],
    band: str,
) -> None:
    """Refuse a band that no galaxy has a magnitude in, if there is another one."""
    if len(objects) == 0 or np.isfinite(objects["magnitude"]).any():
        return
    truths = [frame.truth for frame in frames]
    known = [
        one
        for one in bands
        if any(np.isfinite(truth[f"mag_{one}"][truth["obj_type"] == GALAXY]).any() for truth in truths)
    ]
    if known:
        raise InputError("no galaxy has a magnitude in it", key="--band", value=band, allowed=", ".join(known))


def _check_ids(given: Iterable[int], tables: Sequence[ObjectTable], path: PathLike) -> None:
    """Refuse an answer with an id that no spectrum has: it is of another field, or shifted."""
    seen = set(np.concatenate([table["id"] for table in tables]).tolist())
    for k in given:
        if k not in seen:
            raise InputError(
                "no spectrum has this id", file=Path(path), key="id", value=k, allowed="ids of stack.parquet"
            )


class _True(NamedTuple):
    """The redshift, magnitude and half-light radius [arcsec] of a galaxy in the truth."""

    z: float
    magnitude: float
    size: float


def objects_of(frames: Sequence[FrameTables], name: str) -> ObjectTable:
    """Return the ObjectTable of galaxies with usable columns: id, z, magnitude, size, contamination, frames.

    name: column of the magnitude; contamination: the light of others over the object's own, of all columns.
    """
    galaxies: dict[int, _True] = {}
    light: dict[int, float] = {}
    others: dict[int, float] = {}
    count: dict[int, int] = {}
    for frame in frames:
        table = frame.spectra
        truth = frame.truth
        row = {int(k): i for i, k in enumerate(truth["id"].tolist())}
        good = table.take(usable(table) & (table["order"] == 1) & np.isfinite(table["model"]))
        order = np.argsort(good["id"], kind="stable")
        ids, start = np.unique(good["id"][order], return_index=True)
        sums = [
            np.add.reduceat(np.nan_to_num(good[key][order].astype(float)), start) if len(start) else np.zeros(0)
            for key in ("model", "contamination")
        ]
        for k, own, more in zip(ids.tolist(), *sums, strict=True):
            i = row.get(k)
            if i is None or truth["obj_type"][i] != GALAXY:
                continue
            galaxies[k] = _True(float(truth["z"][i]), float(truth[name][i]), float(truth["size"][i]))
            light[k] = light.get(k, 0.0) + own
            others[k] = others.get(k, 0.0) + more
            count[k] = count.get(k, 0) + 1
    known = sorted(galaxies)
    contamination = np.array([others[k] / light[k] if light[k] > 0 else np.inf for k in known])
    return ObjectTable(
        {
            "id": np.array(known, np.int64),
            "z": np.array([galaxies[k].z for k in known], float),
            "magnitude": np.array([galaxies[k].magnitude for k in known], float),
            "size": np.array([galaxies[k].size for k in known], float),
            "contamination": contamination,
            "frames": np.array([count[k] for k in known], np.int16),
        }
    )


def read_answer(path: PathLike) -> dict[int, tuple[float, bool]]:
    """Return {id: (z, good)} of a CSV file. Raises InputError."""
    path = Path(path)
    out = {}
    for line, row in answer_rows(path, ("id", "z", "good"), "--answer"):
        try:
            k = int(row["id"])  # not by way of a float: an id has more digits
        except (TypeError, ValueError):
            key = f"line {line}, id"
            allowed = "a whole number"
            raise InputError("not an answer", file=path, key=key, value=row["id"], allowed=allowed) from None
        if k in out:
            raise InputError("id given twice", file=path, key=f"line {line}, id", value=k)
        z = answer_number(path, line, row, "z", lambda z: z > -1, "a redshift, above -1")
        out[k] = z, answer_number(path, line, row, "good", (0, 1).__contains__, "0 or 1") == 1
    return out


def text(result: Mapping[str, Any]) -> list[str]:
    """Return the lines of the result that are printed."""
    out = [f"right: |dz| / (1 + z) < {result['right']:g}", _line("all", result["all"])]
    for name in ("magnitude", "redshift", "size", "contamination"):
        out += [_line(f"{name} {one['low']:g} to {one['high']:g}", one) for one in result[name]]
    out.append("lines by contamination: number; flux over true; shift [px]")
    for one in result["lines"]:
        values = " ".join(f"{one[name]:+.4f} +- {one[f'{name}_err']:.4f}" for name in ("ratio", "shift"))
        out.append(f"  {one['low']:g} to {one['high']:g}: {one['lines']:5d}  {values}")
    return out


def _line(name: str, one: Mapping[str, Any]) -> str:
    return (
        f"  {name:28s} {one['objects']:5d} galaxies, {one['good']:5d} good: complete {one['completeness']:.3f} +- "
        f"{one['completeness_err']:.3f}, pure {one['purity']:.3f} +- {one['purity_err']:.3f}, "
        f"sigma {one['sigma']:.5f}, bias {one['bias']:+.5f}"
    )


def _plain(value: Any) -> Any:
    """Return a value as JSON has it: numbers that are not finite as null."""
    if isinstance(value, dict):
        return {key: _plain(one) for key, one in value.items()}
    if isinstance(value, list):
        return [_plain(one) for one in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value
