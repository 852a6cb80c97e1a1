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
from csstsim.studies.budget.redshift.frame_tables import read_frame_tables
from csstsim.studies.budget.redshift.line_biases import by_contamination, line_biases
from csstsim.studies.budget.redshift.scores import RIGHT, scores
from csstsim.studies.budget.redshift.stack import stack_spectra, usable

if TYPE_CHECKING:
    from csstsim.campaign.opened import OpenCampaign
    from csstsim.studies.budget.redshift.frame_tables import FrameTables


def budget(
    runs: Sequence[OpenCampaign],
    output: PathLike,
    spectra: PathLike | None = None,
    answer: PathLike | None = None,
    band: str = "i",
    log: Callable[[str], object] = print,
) -> dict[str, Any] | None:
    """Write stack.parquet and objects.parquet, for a fitter, into `output`; with its answer, also scores and a figure.

    runs: campaign.opened.OpenCampaign of different fields; spectra: folder of tables as `csstsim extract` writes them,
    relative to each campaign's file, or None: the campaign's; answer: CSV file with columns id, z and good (0 or 1);
    band: of the magnitudes. Returns the scores, or None. Raises InputError.
    """
    output = output_folder(output)
    run, *_ = runs
    fits = None if answer is None else read_answer(answer)
    name = f"mag_{band}"
    if band not in run.camera.bands:
        raise InputError("no such band", key="--band", value=band, allowed=", ".join(run.camera.bands))
    frames = read_frame_tables(runs, spectra, log)
    tables = [frame.spectra for frame in frames]
    objects = objects_of(frames, name)
    _check_band(frames, objects, run.camera.bands, band)
    if fits is not None and answer is not None:
        _check_ids(fits, tables, answer)
    stack = stack_spectra(tables)
    scored = None
    if fits is not None:
        scored = scores(fits, objects)
        lines = by_contamination(line_biases(tables, [frame.lines for frame in frames]))
    output.mkdir(parents=True, exist_ok=True)  # nothing is written before all is checked
    stack.write(output / "stack.parquet", {"frames": len(tables)})
    objects.write(output / "objects.parquet", {"band": band})
    log(f"{len(objects)} galaxies in {len(tables)} frames: {output / 'stack.parquet'}")
    if scored is None:
        return None
    result = {"right": RIGHT, "band": band, "frames": len(tables), **scored, "lines": lines}
    with atomic_path(output / "redshift.json") as temporary:
        temporary.write_text(json.dumps(_json_value(result), indent=1))
    from csstsim.studies.budget.redshift.figure import figure

    assert fits is not None  # of which the scores are

    with atomic_path(output / "redshift.png") as temporary:
        temporary.write_bytes(figure(result, fits, objects))
    for line in text(result):
        log(line)
    return result


def _check_band(
    frames: Sequence[FrameTables],
    objects: ObjectTable,
    bands: Iterable[str],
    band: str,
) -> None:
    """Raise InputError for a band in which no galaxy has a magnitude, if there is another band."""
    if len(objects) == 0 or np.isfinite(objects["magnitude"]).any():
        return
    truths = [frame.truth for frame in frames]
    known = [
        name
        for name in bands
        if any(np.isfinite(truth[f"mag_{name}"][truth["obj_type"] == GALAXY]).any() for truth in truths)
    ]
    if known:
        raise InputError("no galaxy has a magnitude in it", key="--band", value=band, allowed=", ".join(known))


def _check_ids(fits: Iterable[int], tables: Sequence[ObjectTable], path: PathLike) -> None:
    """Raise InputError for an answer with an id that no spectrum has: it is of another field, or shifted."""
    ids = set(np.concatenate([table["id"] for table in tables]).tolist())
    for id_ in fits:
        if id_ not in ids:
            raise InputError(
                "no spectrum has this id", file=Path(path), key="id", value=id_, allowed="ids of stack.parquet"
            )


class _TrueGalaxy(NamedTuple):
    """The redshift, magnitude and half-light radius [arcsec] of a galaxy in the truth."""

    z: float
    magnitude: float
    size: float


def objects_of(frames: Sequence[FrameTables], name: str) -> ObjectTable:
    """Return the ObjectTable of galaxies with usable columns: id, z, magnitude, size, contamination, frames.

    name: column of the magnitude; contamination: electrons of other objects over the object's, summed over columns.
    """
    galaxies: dict[int, _TrueGalaxy] = {}
    electrons: dict[int, float] = {}
    contaminating: dict[int, float] = {}
    count: dict[int, int] = {}
    for frame in frames:
        table = frame.spectra
        truth = frame.truth
        row_of_id = {int(id_): i for i, id_ in enumerate(truth["id"].tolist())}
        good = table.take(usable(table) & (table["order"] == 1) & np.isfinite(table["model"]))
        order = np.argsort(good["id"], kind="stable")
        ids_of_frame, starts = np.unique(good["id"][order], return_index=True)
        sums = [
            np.add.reduceat(np.nan_to_num(good[key][order].astype(float)), starts) if len(starts) else np.zeros(0)
            for key in ("model", "contamination")
        ]
        for id_, electrons_of_frame, contaminating_of_frame in zip(ids_of_frame.tolist(), *sums, strict=True):
            i = row_of_id.get(id_)
            if i is None or truth["obj_type"][i] != GALAXY:
                continue
            galaxies[id_] = _TrueGalaxy(float(truth["z"][i]), float(truth[name][i]), float(truth["size"][i]))
            electrons[id_] = electrons.get(id_, 0.0) + electrons_of_frame
            contaminating[id_] = contaminating.get(id_, 0.0) + contaminating_of_frame
            count[id_] = count.get(id_, 0) + 1
    ids = sorted(galaxies)
    contamination = np.array([contaminating[id_] / electrons[id_] if electrons[id_] > 0 else np.inf for id_ in ids])
    return ObjectTable(
        {
            "id": np.array(ids, np.int64),
            "z": np.array([galaxies[id_].z for id_ in ids], float),
            "magnitude": np.array([galaxies[id_].magnitude for id_ in ids], float),
            "size": np.array([galaxies[id_].size for id_ in ids], float),
            "contamination": contamination,
            "frames": np.array([count[id_] for id_ in ids], np.int16),
        }
    )


def read_answer(path: PathLike) -> dict[int, tuple[float, bool]]:
    """Return {id: (z, good)} of a CSV file. Raises InputError."""
    path = Path(path)
    fits = {}
    for line, row in answer_rows(path, ("id", "z", "good"), "--answer"):
        try:
            id_ = int(row["id"])  # not by way of a float: an id has more digits
        except (TypeError, ValueError):
            key = f"line {line}, id"
            allowed = "a whole number"
            raise InputError("not an answer", file=path, key=key, value=row["id"], allowed=allowed) from None
        if id_ in fits:
            raise InputError("id given twice", file=path, key=f"line {line}, id", value=id_)
        z = answer_number(path, line, row, "z", lambda z: z > -1, "a redshift, above -1")
        fits[id_] = z, answer_number(path, line, row, "good", (0, 1).__contains__, "0 or 1") == 1
    return fits


def text(result: Mapping[str, Any]) -> list[str]:
    """Return the lines to print about a result."""
    lines = [f"right: |dz| / (1 + z) < {result['right']:g}", _line("all", result["all"])]
    for name in ("magnitude", "redshift", "size", "contamination"):
        lines += [_line(f"{name} {class_['low']:g} to {class_['high']:g}", class_) for class_ in result[name]]
    lines.append("lines by contamination: number; flux over true; shift [px]")
    for class_ in result["lines"]:
        values = " ".join(f"{class_[name]:+.4f} +- {class_[f'{name}_err']:.4f}" for name in ("ratio", "shift"))
        lines.append(f"  {class_['low']:g} to {class_['high']:g}: {class_['lines']:5d}  {values}")
    return lines


def _line(name: str, class_: Mapping[str, Any]) -> str:
    return (
        f"  {name:28s} {class_['objects']:5d} galaxies, {class_['good']:5d} good: "
        f"complete {class_['completeness']:.3f} +- {class_['completeness_err']:.3f}, "
        f"pure {class_['purity']:.3f} +- {class_['purity_err']:.3f}, "
        f"sigma {class_['sigma']:.5f}, bias {class_['bias']:+.5f}"
    )


def _json_value(value: Any) -> Any:
    """Return a value as JSON has it: null for numbers that are not finite."""
    if isinstance(value, dict):
        return {key: _json_value(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [_json_value(inner) for inner in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value
