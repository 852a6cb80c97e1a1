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
from csstsim.studies.release.score import statistics
from csstsim.studies.release.score.catalogue import read_catalogue
from csstsim.studies.release.score.field import read_field
from csstsim.studies.release.score.match import RADIUS, brightness, chance_matches, match_sources
from csstsim.studies.release.score.summary import summary_lines

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping
    from typing import Any

    from csstsim.base.types import AnyArray, BoolArray, FloatArray, PathLike
    from csstsim.catalog.table import ObjectTable
    from csstsim.studies.release.score.catalogue import Catalogue
    from csstsim.studies.release.score.field import Field

PAGE = "score.html"
JSON = "score.json"
# objects with a source that show another unit [of a smaller catalogue: its size]; times as many as in degrees
OTHER_UNIT_MIN = 5
OTHER_UNIT_FACTOR = 10
RADIAN = 180 / np.pi
UNITS = {"ra_hour": (15.0, 1.0), "ra_rad, dec_rad": (RADIAN, RADIAN), "ra_rad": (RADIAN, 1.0)}  # of ra and dec [deg]


def score(
    catalogue: PathLike,
    truth: PathLike,
    output: PathLike,
    log: Callable[[str], object],
    maps: Iterable[str] = (),
    band: str | None = None,
    radius: float = RADIUS,
) -> dict[str, Any]:
    """Score a catalogue's file against a pack's truth folder; write PAGE and JSON into `output`; return the result.

    maps: texts KEY=COLUMN; band: of the magnitudes for matching and bins [default: the mapped band with the most
    sources]; radius: minimum reach of a match, arcsec. Raises InputError.
    """
    from csstsim.studies.release.score.page import write_page

    folder = output_folder(output)
    field = read_field(truth)
    sources = read_catalogue(catalogue, _column_map(maps), field.bands)
    result, arrays = evaluate(field, sources, band, radius, catalogue)
    for line in result["notes"]:
        log(line)
    for line in summary_lines(result):
        log(line)
    folder.mkdir(parents=True, exist_ok=True)
    with atomic_path(folder / JSON) as temporary:
        temporary.write_text(json.dumps(_json_value(result), indent=1, allow_nan=False) + "\n")
    write_page(folder / PAGE, result, arrays)
    log(f"{folder / PAGE}, and {JSON} beside it")
    return result


def evaluate(
    field: Field, sources: Catalogue, band: str | None = None, radius: float = RADIUS, file: PathLike | None = None
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return (result, JSON-like; arrays for the figures) of a Catalogue against a Field. Raises InputError."""
    band = _band(field, sources, band)
    objects = field.objects

    def covers(ra: FloatArray, dec: FloatArray) -> BoolArray:
        return field.covers(ra, dec, band)

    truth = objects.take(covers(objects["ra"], objects["dec"]))
    is_inside = covers(sources["ra"], sources["dec"])
    notes = list(sources.notes)
    if len(sources) and not is_inside.any():
        ra = float(np.median(sources["ra"]))
        dec = float(np.median(sources["dec"]))
        ra0 = float(np.median(objects["ra"]))
        dec0 = float(np.median(objects["dec"]))
        raise InputError(
            "no source lies in the field: are the units of ra and dec right?",
            file=file,
            value=f"their middle is {ra:.4f}, {dec:.4f}",
            allowed=f"about {ra0:.4f}, {dec0:.4f} deg",
        )
    if not is_inside.all():
        notes.append(f"{(~is_inside).sum()} of {len(sources)} sources lie outside the frames: left out")
    all_sources = sources
    sources = sources.take(is_inside)
    match_band = band if band and f"mag_{band}" in sources else None
    match = match_sources(truth, sources, match_band, radius)
    _check_unit(truth, all_sources, int(match.found.sum()), covers, radius, file)
    chance, n_chance = chance_matches(truth, sources, covers, match_band, radius)
    mag = brightness(truth, band)
    snr = _snr(truth, band)
    isolated = statistics.isolated(truth, band)
    n_sources = len(sources)
    pure = match.real(n_sources).mean() if n_sources else np.nan
    result: dict[str, Any] = {
        "pack": field.name, "csstsim": __version__, "catalogue": Path(file).name if file else "", "band": band,
        "columns": sources.columns_used, "notes": notes, "objects": len(truth), "sources": n_sources,
        "radius_arcsec": radius, "zero_point": match.zero_point if match_band else None,
        "completeness": statistics.completeness_of_bright(truth, match, snr),
        "completeness_by_magnitude": statistics.completeness(truth, match, mag),
        "purity": {
            "purity": pure, "second": match.second.mean() if n_sources else np.nan,
            "chance": chance, "chance_tried": n_chance,
            "corrected": (pure - chance) / (1 - chance) if n_sources and chance < 1 else np.nan,
        },
    }  # fmt: skip
    result["half_found"] = {
        kind: statistics.half_found_magnitude(bins) for kind, bins in result["completeness_by_magnitude"].items()
    }
    arrays: dict[str, Any] = {"photometry": {}}
    if match_band:
        result["purity_by_magnitude"] = statistics.purity(match, np.asarray(sources[f"mag_{band}"]), n_sources)
    result["photometry"] = {}
    for name in field.bands:
        if f"mag_{name}" in sources:
            photometry = statistics.photometry(truth, sources, match, isolated, name, _snr(truth, name))
            result["photometry"][name], arrays["photometry"][name] = photometry
    result["astrometry_mas"], arrays["positions"] = statistics.positions(truth, sources, match, isolated, snr)
    if "e1" in sources:
        result["shapes"], arrays["shapes"] = statistics.shapes(truth, sources, match, isolated, snr)
    if "z" in sources:
        result["redshifts"], arrays["redshifts"] = statistics.redshifts(truth, sources, match)
    return result, arrays


def _check_unit(
    truth: Mapping[str, AnyArray],
    sources: Catalogue,
    found: int,
    covers: Callable[[FloatArray, FloatArray], BoolArray],
    radius: float,
    file: PathLike | None = None,
) -> None:
    """Raise InputError if positions in degrees match no object, but would in another unit.

    Positions in hours may lie in the field near a right ascension of 0. truth, sources: with ra, dec [deg]; found:
    objects that have a source; covers: function of ra, dec [deg] that returns which are in the field; radius: arcsec.
    """
    minimum = min(OTHER_UNIT_MIN, len(sources))
    for unit, (ra_factor, dec_factor) in UNITS.items():
        ra = ra_factor * sources["ra"]
        dec = dec_factor * sources["dec"]
        inside = (np.abs(dec) <= 90.0) & (np.abs(ra) <= 720.0)
        inside[inside] = covers(ra[inside], dec[inside])
        if inside.sum() < max(minimum, 1):
            continue
        match = match_sources(truth, {"ra": ra[inside], "dec": dec[inside]}, radius=radius)
        other = int(match.found.sum())
        if other >= minimum and other > OTHER_UNIT_FACTOR * found:
            raise InputError(
                f"{found} true objects have a source; {other} would, if the positions were {unit}",
                file=file,
                key="ra, dec",
                allowed=f"degrees; for another unit --map {unit.split(',')[0]}=COLUMN",
            )


def _band(field: Field, sources: Catalogue, band: str | None) -> str | None:
    """Return the requested band, or the mapped one with the most sources; None if no magnitude is mapped."""
    if band and band not in field.bands:
        raise InputError("not a band of this pack", key="--band", value=band, allowed=", ".join(field.bands))
    counts = {name: np.isfinite(sources[f"mag_{name}"]).sum() for name in field.bands if f"mag_{name}" in sources}
    return band or max(counts, key=counts.__getitem__, default=None)


def _snr(truth: ObjectTable, band: str | None) -> FloatArray:
    """Return the S/N (n,) of objects in all frames of a band together; without a band, of the best one."""
    names = [f"snr_{band}"] if band else [name for name in truth if name.startswith("snr_")]
    return np.max([np.nan_to_num(truth[name].astype(float)) for name in names], axis=0, initial=0.0)


def _column_map(texts: Iterable[str]) -> dict[str, str]:
    """Return {key: column} of texts KEY=COLUMN. Raises InputError."""
    columns: dict[str, str] = {}
    for text in texts:
        key, equals, name = (part.strip() for part in text.partition("="))
        if not (key and equals and name):
            raise InputError("not KEY=COLUMN", key="--map", value=text)
        if key in columns:
            raise InputError("given twice", key="--map", value=key)
        columns[key] = name
    return columns


def _json_value(value: Any) -> Any:
    """Return a value as JSON has it: numbers of Python, null for those that are not finite."""
    if isinstance(value, dict):
        return {key: _json_value(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_json_value(inner) for inner in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value
