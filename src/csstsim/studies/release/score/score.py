"""`csstsim release score`: a catalogue against the truth of a pack; a page of figures and a JSON file."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from csstsim import __version__
from csstsim.base.errors import InputError
from csstsim.base.files.atomic import atomic_path
from csstsim.base.files.output_folder import output_folder
from csstsim.studies.release.score import numbers
from csstsim.studies.release.score.catalogue import read_catalogue
from csstsim.studies.release.score.field import read_field
from csstsim.studies.release.score.lines import lines
from csstsim.studies.release.score.match import RADIUS, brightness, chance, matched
from csstsim.studies.release.score.unit_of_places import check_unit

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from typing import Any

    from csstsim.base.types import FloatArray, PathLike
    from csstsim.catalog.table import ObjectTable
    from csstsim.studies.release.score.catalogue import Catalogue
    from csstsim.studies.release.score.field import Field

PAGE = "score.html"
JSON = "score.json"


def score(
    catalogue: PathLike,
    truth: PathLike,
    output: PathLike,
    log: Callable[[str], object],
    maps: Iterable[str] = (),
    band: str | None = None,
    radius: float = RADIUS,
) -> dict[str, Any]:
    """Score a catalogue's file against a pack's truth folder, write PAGE and JSON into `output`; return the numbers.

    maps: texts KEY=COLUMN; band: whose magnitudes matching and bins use [default: the mapped one of most sources];
    radius: minimum reach of a match, arcsec. Raises InputError.
    """
    from csstsim.studies.release.score.page import write_page

    folder = output_folder(output)
    field = read_field(truth)
    read = read_catalogue(catalogue, _pairs(maps), field.bands)
    result, arrays = evaluate(field, read, band, radius, catalogue)
    for line in result["notes"]:
        log(line)
    for line in lines(result):
        log(line)
    folder.mkdir(parents=True, exist_ok=True)
    with atomic_path(folder / JSON) as temporary:
        temporary.write_text(json.dumps(_finite(result), indent=1, allow_nan=False) + "\n")
    write_page(folder / PAGE, result, arrays)
    log(f"{folder / PAGE}, and {JSON} beside it")
    return result


def evaluate(
    field: Field, sources: Catalogue, band: str | None = None, radius: float = RADIUS, file: PathLike | None = None
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return (numbers, JSON-like; arrays for the figures) of a Catalogue against a Field. Raises InputError."""
    band = _band(field, sources, band)
    objects = field.objects
    held = field.has(objects["ra"], objects["dec"], band)
    truth = objects.take(held)
    inside = field.has(sources["ra"], sources["dec"], band)
    notes = list(sources.notes)
    if len(sources) and not inside.any():
        ra = float(np.median(sources["ra"]))
        dec = float(np.median(sources["dec"]))
        ra0 = float(np.median(objects["ra"]))
        dec0 = float(np.median(objects["dec"]))
        raise InputError(
            "no source lies in the field: is the unit of ra or dec another one?",
            file=file,
            value=f"their middle is {ra:.4f}, {dec:.4f}",
            allowed=f"about {ra0:.4f}, {dec0:.4f} deg",
        )
    if not inside.all():
        notes.append(f"{(~inside).sum()} of {len(sources)} sources lie outside the frames: left out")
    everything = sources
    sources = sources.take(inside)
    match_band = band if band and f"mag_{band}" in sources else None
    match = matched(truth, sources, match_band, radius)
    check_unit(truth, everything, int(match.found.sum()), lambda ra, dec: field.has(ra, dec, band), radius, file)
    by_chance, tried = chance(truth, sources, lambda ra, dec: field.has(ra, dec, band), match_band, radius)
    mag = brightness(truth, band)
    snr = _snr(truth, band)
    clean = numbers.alone(truth, band)
    count = len(sources)
    pure = match.real(count).mean() if count else np.nan
    result: dict[str, Any] = {
        "pack": field.name, "csstsim": __version__, "catalogue": Path(file).name if file else "", "band": band,
        "columns": sources.told, "notes": notes, "objects": len(truth), "sources": count, "radius_arcsec": radius,
        "zero_point": match.zero if match_band else None,
        "completeness": numbers.shares(truth, match, snr),
        "completeness_by_magnitude": numbers.completeness(truth, match, mag),
        "purity": {
            "purity": pure, "second": match.second.mean() if count else np.nan,
            "chance": by_chance, "chance_tried": tried,
            "corrected": (pure - by_chance) / (1 - by_chance) if count and by_chance < 1 else np.nan,
        },
    }  # fmt: skip
    result["half_found"] = {
        kind: numbers.half_found(bins) for kind, bins in result["completeness_by_magnitude"].items()
    }
    arrays: dict[str, Any] = {"photometry": {}}
    if match_band:
        result["purity_by_magnitude"] = numbers.purity(match, np.asarray(sources[f"mag_{band}"]), count)
    result["photometry"] = {}
    for one in field.bands:
        if f"mag_{one}" in sources:
            found = numbers.photometry(truth, sources, match, clean, one, _snr(truth, one))
            result["photometry"][one], arrays["photometry"][one] = found
    result["astrometry_mas"], arrays["positions"] = numbers.positions(truth, sources, match, clean, snr)
    if "e1" in sources:
        result["shapes"], arrays["shapes"] = numbers.shapes(truth, sources, match, clean, snr)
    if "z" in sources:
        result["redshifts"], arrays["redshifts"] = numbers.redshifts(truth, sources, match)
    return result, arrays


def _band(field: Field, sources: Catalogue, band: str | None) -> str | None:
    """Return the band that is asked for, or the mapped one of most sources; None if no magnitude is mapped."""
    if band and band not in field.bands:
        raise InputError("no band of this pack", key="--band", value=band, allowed=", ".join(field.bands))
    known = {one: np.isfinite(sources[f"mag_{one}"]).sum() for one in field.bands if f"mag_{one}" in sources}
    return band or max(known, key=known.__getitem__, default=None)


def _snr(truth: ObjectTable, band: str | None) -> FloatArray:
    """Return the S/N (n,) of objects in all frames of a band together; without a band in their best one."""
    names = [f"snr_{band}"] if band else [name for name in truth if name.startswith("snr_")]
    return np.max([np.nan_to_num(truth[name].astype(float)) for name in names], axis=0, initial=0.0)


def _pairs(texts: Iterable[str]) -> dict[str, str]:
    """Return {key: column} of texts KEY=COLUMN. Raises InputError."""
    found: dict[str, str] = {}
    for text in texts:
        key, equals, name = (part.strip() for part in text.partition("="))
        if not (key and equals and name):
            raise InputError("not KEY=COLUMN", key="--map", value=text)
        if key in found:
            raise InputError("given twice", key="--map", value=key)
        found[key] = name
    return found


def _finite(value: Any) -> Any:
    """Return a JSON-like value with null for numbers that are not finite, and Python's own numbers."""
    if isinstance(value, dict):
        return {key: _finite(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(inner) for inner in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value
