"""The contract test of your own catalogue: checks csstsim's requirements on a region of the sky.

`csstsim check CAMPAIGN` runs it on the campaign's first exposure. In your test:

    from csstsim.catalog.contract import check, sky_region
    report = check(Mine, {"file": "mine.csv"}, sky_region(ra=10.0, dec=-2.0, radius=0.1))
    assert not report.faults, report

A fault means that an object or all objects would be rendered wrongly or not at all. The reason for a warning may be
intended. An exception raised by the catalogue's own code becomes an InputError with class, method and object.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from csstsim.base.healpix import NSIDE, disc
from csstsim.base.plural import number_of
from csstsim.base.shipped import SHIPPED
from csstsim.base.sphere import unit_vectors
from csstsim.catalog.base import CatalogBase, Region, name_of, users_code
from csstsim.catalog.changing.motion import Interval
from csstsim.catalog.galaxy_shapes.part_rows import SHORTHANDS
from csstsim.catalog.hooks import dimming_of, fractions_of
from csstsim.catalog.light.photometry import load_fluxes, rate_to_mag
from csstsim.catalog.light.spectrum_tables import read_columns
from csstsim.catalog.misspelt import closest_name, unused_magnitude
from csstsim.catalog.open import make_catalog
from csstsim.catalog.selection.renderable import reasons
from csstsim.catalog.table import STAR, TYPES, ObjectTable, columns_with
from csstsim.instrument.camera import Camera, load_camera
from csstsim.instrument.filter import GRID, SUBBANDS

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping

    from csstsim.base.types import IntArray
    from csstsim.catalog.mock_object import MockObject

PLAUSIBLE_MAG = (0.0, 40.0)  # AB, in an object's brightest band: outside, FLUX is probably in a wrong unit
MAG_TOLERANCE = 0.05
FLUX_TOLERANCE = 0.01  # between load_fluxes and the integral of load_seds, relative
SHOWN = 5  # ids named in one message
EXPOSURE = Interval(start=61000.0, exptime=150.0)  # for which `dimming` is tested: MJD, s
Found: TypeAlias = defaultdict[str, list[int]]  # {message: ids of objects}


@dataclass(frozen=True)
class Report:
    """The result of the test.

    Attributes
    ----------
    table : ObjectTable
        The objects.
    counts : dict
        {type: number of objects}.
    faults : tuple of str
        One line per fault.
    warnings : tuple of str
        One line per warning.
    """

    table: ObjectTable
    counts: dict[str, int]
    faults: tuple[str, ...]
    warnings: tuple[str, ...]

    def __str__(self) -> str:
        counts = ", ".join(f"{count} of type {kind}" for kind, count in self.counts.items())
        total = len(self.table)
        lines = [f"{number_of(total, 'object')}: {counts}" if total else "no objects in the region"]
        lines += [f"fault: {text}" for text in self.faults] + [f"warning: {text}" for text in self.warnings]
        return "\n".join(lines)


def sky_region(ra: float, dec: float, radius: float, bands: Iterable[str] = ()) -> Region:
    """Return the Region of a circle's bounding square. The circle must not contain a pole.

    Parameters
    ----------
    ra, dec : float
        Centre [deg, ICRS].
    radius : float
        Radius of the circle [deg].
    bands : iterable of str, optional
        Bands of the camera; `check` replaces them by those of its own camera.

    Returns
    -------
    Region
        Corners [deg, ICRS] and bricks of the square.
    """
    half = radius / np.cos(np.radians(abs(dec) + radius))
    bricks = disc(NSIDE, unit_vectors(ra, dec), np.radians(radius), inclusive=True)
    east = ra + np.array([-half, half, half, -half])
    north = dec + np.array([-radius, -radius, radius, radius])
    corners = tuple((east % 360.0).tolist()), tuple(north.tolist())
    return Region(*corners, tuple(bricks.tolist()), tuple(bands))


def check(
    cls: type[CatalogBase], options: Mapping[str, Any], region: Region, camera: Camera | None = None, most: int = 100
) -> Report:
    """Return the faults and warnings of a catalogue class on a region of the sky.

    Parameters
    ----------
    cls : type
        A CatalogBase class.
    options : mapping
        Its options, as catalog.options of a campaign file.
    region : Region
        The region of the sky, for example that of `sky_region`.
    camera : Camera, optional
        The camera (csstsim.instrument.camera); None: the shipped one.
    most : int
        Maximum number of objects of each type whose spectra are checked.

    Returns
    -------
    Report
        Its `faults` are empty if the catalogue fulfils the contract.

    Raises
    ------
    InputError
        For exceptions of the class, and for a return value in the wrong form.
    """
    camera = camera or load_camera(SHIPPED / "instrument")
    catalog = make_catalog(cls, options, replace(region, bands=tuple(camera.bands)))
    with users_code(f"{name_of(catalog)}.table"):
        table = catalog.table
        if not isinstance(table, ObjectTable):
            raise TypeError(f"{type(table).__name__} is not an ObjectTable")
    if len(catalog.objs) != len(table):
        return Report(table, {}, (f"objs has {len(catalog.objs)} objects, table {len(table)} rows",), ())
    faults: Found = defaultdict(list)
    warnings: Found = defaultdict(list)
    ids, times = np.unique(table["id"], return_counts=True)
    faults["an id given more than once"] = list(ids[times > 1])
    _check_columns(table, camera.bands, faults, warnings)
    rows = _sample(table["obj_type"], most)
    for row in rows:
        _check_spectrum(catalog, catalog.objs[row], faults, warnings)
    _check_fluxes(catalog, rows, camera, faults, warnings)
    _check_hooks(catalog, rows, camera)
    counts = {kind: int((table["obj_type"] == number).sum()) for number, kind in enumerate(TYPES)}
    return Report(table, {k: n for k, n in counts.items() if n}, _lines(faults), _lines(warnings))


def _sample(kinds: IntArray, most: int) -> IntArray:
    """Return rows, at most `most` of each type, spread evenly over the table."""
    picked = []
    for kind in range(len(TYPES)):
        rows = np.flatnonzero(kinds == kind)
        picked.append(rows[np.linspace(0, len(rows) - 1, min(most, len(rows))).astype(int)])
    return np.sort(np.concatenate(picked))


def _check_columns(table: ObjectTable, bands: Collection[str], faults: Found, warnings: Found) -> None:
    """Check the objects' parameters."""
    rendered = 0
    for _, part in table.parts():
        omitted = np.zeros(len(part), dtype=bool)
        for reason, mask in reasons(part).items():
            warnings[f"would not be rendered: {reason}"] += list(part["id"][mask])
            omitted |= mask
        rendered += int(np.count_nonzero(~omitted))
        flagged = part["flags"] != 0
        warnings["flags are set by csstsim; an object with a flag may not be rendered"] += list(part["id"][flagged])
        shape = np.hypot(part["e1"], part["e2"]) + part["size_disk"] + part["size_bulge"]
        shaped = (part["obj_type"] == STAR) & (shape > 0)
        warnings["a star, rendered as a point, has a size or an ellipticity"] += list(part["id"][shaped])
    if len(table) and not rendered:
        faults["every object would be omitted"] = list(table["id"])
    for name in (name.removeprefix("user_") for name in table if name.startswith("user_")):
        if name in SHORTHANDS:
            warnings[f"{name} is a column of tables only: give the position and flux of the part"] = list(table["id"])
        elif column := closest_name(name, columns_with(bands)):
            warnings[f"{name} is unknown to csstsim; did you mean {column}?"] = list(table["id"])
        elif text := unused_magnitude(name, bands):
            warnings[text] = list(table["id"])


def _check_spectrum(catalog: CatalogBase, obj: MockObject, faults: Found, warnings: Found) -> None:
    """Check the samples of one object's spectrum as `load_sed` gives them."""
    where = f"{name_of(catalog)}.load_sed, object {obj.id}"
    with users_code(where):
        sed = catalog.load_sed(obj)
    wave, flux = read_columns(sed, "FLUX", where)
    if wave[-1] <= GRID[0] or wave[0] >= GRID[-1]:
        unit = "; is it in micron?" if wave[-1] < 50 else "; is it in nanometre?" if wave[-1] <= GRID[0] else ""
        faults[f"WAVELENGTH has nothing within 2000-11000 angstrom{unit}"].append(obj.id)
    elif wave[0] > GRID[0] or wave[-1] < GRID[-1]:
        warnings["spectrum does not cover 2000-11000 angstrom; it counts as zero beyond its ends"].append(obj.id)
    if not np.isfinite(flux).all():
        faults["FLUX holds values that are not finite"].append(obj.id)
    elif (flux < 0).any():
        faults["FLUX holds negative values"].append(obj.id)
    with users_code(where.replace("load_sed", "load_norm_filt")):
        norm = catalog.load_norm_filt(obj)
    if norm is None:
        if np.isfinite(getattr(obj, "mag_norm", np.nan)):
            warnings["mag_norm has no effect: load_norm_filt gives no filter, so that FLUX is absolute"].append(obj.id)
        return
    wave, response = read_columns(norm, "SENSITIVITY", where.replace("load_sed", "load_norm_filt"))
    if not (response >= 0).all():
        faults["SENSITIVITY holds values that are negative or not finite"].append(obj.id)
    elif (response[(wave < GRID[0]) | (wave > GRID[-1])] > 0).any():
        warnings["load_norm_filt's filter reaches beyond 2000-11000 angstrom and is cut there"].append(obj.id)


def _check_fluxes(catalog: CatalogBase, rows: IntArray, camera: Camera, faults: Found, warnings: Found) -> None:
    """Check the electrons and magnitudes of `rows` in every imaging band."""
    ids = catalog.table["id"][rows]
    mags = np.empty((len(camera.bands), len(rows)))
    for mag, (name, band) in zip(mags, camera.bands.items(), strict=True):
        with users_code(f"{name_of(catalog)}.load_fluxes"):
            rates = np.asarray(catalog.load_fluxes(rows, band, camera.telescope))
            if rates.shape != (len(rows), SUBBANDS):
                raise ValueError(f"its shape is {rates.shape}, not {(len(rows), SUBBANDS)}")
        with users_code(f"{name_of(catalog)}.load_seds"):
            direct = load_fluxes(catalog.load_seds, rows, band, camera.telescope)
        differ = ~np.isclose(rates, direct, rtol=FLUX_TOLERANCE, atol=1e-9, equal_nan=True).all(axis=1)
        faults[f"load_fluxes is not the integral of load_seds in {band.name}"] = list(ids[differ])
        mag[:] = rate_to_mag(direct.sum(axis=1), band, camera.telescope)
        stated = catalog.table.get(f"mag_{name}", np.full(len(catalog.table), np.nan))[rows]
        with np.errstate(invalid="ignore"):  # both infinite: equal
            wrong = np.abs(mag - stated) > MAG_TOLERANCE  # false for NaN: not stated
        warnings[f"mag_{name} is not the spectrum's magnitude"] = list(ids[wrong])
    has_flux = np.isfinite(mags)
    faults["has no flux in any band (or none in its mag_norm's filter)"] = list(ids[~has_flux.any(axis=0)])
    brightest = np.where(has_flux, mags, np.inf).min(axis=0, initial=np.inf)
    odd = np.isfinite(brightest) & ((brightest < PLAUSIBLE_MAG[0]) | (brightest > PLAUSIBLE_MAG[1]))
    warnings["is brighter than 0 or fainter than 40 mag: is FLUX in photon / s / m2 / angstrom?"] = list(ids[odd])


def _check_hooks(catalog: CatalogBase, rows: IntArray, camera: Camera) -> None:
    """Call the class's own dimming and component_shares in every imaging band. Raises InputError for a wrong form.

    They get half of `rows`, so that values for the complete table have the wrong length.
    """
    half = rows[: (len(rows) + 1) // 2]
    for band in camera.bands.values() if len(half) else ():
        if _own(catalog.dimming):
            dimming_of(catalog, half, EXPOSURE, band)
        if _own(catalog.component_shares):
            fractions_of(catalog, half, band)


def _own(method: object) -> bool:
    """Return whether a method is not one of csstsim's."""
    return not str(getattr(method, "__module__", "")).startswith("csstsim.")


def _lines(found: Found) -> tuple[str, ...]:
    lines = []
    for message, ids in found.items():
        if ids:
            more = f" and {len(ids) - SHOWN} more" if len(ids) > SHOWN else ""
            lines.append(f"{message}: object {', '.join(map(str, ids[:SHOWN]))}{more}")
    return tuple(lines)
