"""The objects of a truth catalogue as a table that csstsim draws (catalog.own_table).

Places are those of the image, xImage and yImage, taken back to the sky through the camera's own geometry: the objects
stand on the same pixels, whatever aberration and distortion made them stand there. Light is `mag`, taken back through
the lens, in the frame's filter (of a grating in all bands: flat in f_nu). Shapes are size, e1, e2, kappa, g1, g2; the
bulge's share is its share of the mass. A parquet truth table has the sizes of both components, and all magnitudes.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from astropy.coordinates import angular_separation

from csstsim.base.errors import InputError
from csstsim.catalog.astrometry.reduction import icrs
from csstsim.catalog.object_table import BRIGHTEST, FAINTEST
from csstsim.catalog.selection.renderable import STRONGLY_LENSED, reasons
from csstsim.catalog.table import GALAXY, OPTIONAL, ObjectTable
from csstsim.io.cat import read_cat
from csstsim.io.truth import read_truth

if TYPE_CHECKING:
    from collections.abc import Collection

    from numpy.typing import ArrayLike

    from csstsim.base.types import AnyArray, BoolArray, FloatArray, IntArray, PathLike
    from csstsim.campaign.job import Job

_BESIDE = 0.05  # deg beyond a frame where objects may still throw light into it: wings, orders of gratings
_BLANK = ("", "-", "-1", "-99", "nan", "none", "None")  # of a chip or filter that is not stated
_UNKNOWN = -90.0  # below: a placeholder, as -99 and -999
_KEPT = ("z", "teff", "logg", "feh", "av", "stellarmass", "bulgemass", "diskmass", "veldisp")  # not drawn, but kept
_SHAPE = {"e1": "round", "e2": "round", "kappa": "no lens", "g1": "no lens", "g2": "no lens"}


def read_objects(path: PathLike) -> ObjectTable:
    """Return the ObjectTable of a `.cat` or a truth parquet file, our names and 0-based x, y. Raises InputError."""
    path = Path(path)
    table = read_truth(path) if path.suffix == ".parquet" else read_cat(path)
    for name in ("mag", "obj_type"):
        if name not in table:
            raise InputError("the catalogue lacks a column", file=path, key=name)
    if not ({"x", "y"} <= set(table) or {"ra", "dec"} <= set(table)):
        raise InputError("the catalogue lacks a place", file=path, key="xImage, yImage or ra, dec")
    return table


def check_frame(objects: ObjectTable, truth: PathLike, job: Job, turned: bool = True) -> None:
    """Raise InputError if a catalogue is of another chip or filter than the frame's Job, or lies elsewhere on the sky.

    Its places are compared with the frame as they are given: those on the image, and ra, dec. turned: whether the
    position angle is known; if not, ra, dec cannot tell.
    """
    for name, key, allowed in (("chip", "ID_chip", str(job.chip.id)), ("filter", "filter", job.chip.filter)):
        for value in np.unique(np.asarray(objects[name]).astype(str)) if name in objects else ():
            plain = value.removesuffix(".0").lstrip("0") if name == "chip" else value
            if plain.lower() != allowed.lower() and value not in _BLANK:
                raise InputError("not of this frame", file=truth, key=key, value=str(value), allowed=allowed)
    w = job.window
    (ra0, dec0), corner = (
        job.wcs.pixel_to_world(*(np.array([v]) for v in at))
        for at in (((w.x0 + w.x1) / 2, (w.y0 + w.y1) / 2), (float(w.x0), float(w.y0)))
    )
    reach = _apart(ra0, dec0, *corner)[0] + _BESIDE
    for a, b in (("x", "y"), ("ra", "dec")) if turned else (("x", "y"),):
        if not {a, b} <= set(objects):
            continue
        at = np.stack([np.asarray(objects[name], float) for name in (a, b)])
        at = at[:, np.isfinite(at).all(axis=0)]
        if a == "x" and at.size:
            at = np.stack(job.wcs.pixel_to_world(*at))
        if at.size and not (_apart(ra0, dec0, *at) <= reach).any():
            key, near = ("xImage, yImage", "its pixels") if a == "x" else ("ra, dec", f"{ra0[0]:.4f}, {dec0[0]:.4f}")
            raise InputError("no object lies near the frame", file=truth, key=key, allowed=f"near {near}")


def _apart(*places: FloatArray) -> FloatArray:
    """Return the angle [deg] between places ra, dec [deg] and others."""
    return np.degrees(angular_separation(*(np.radians(v) for v in places)))


def own_table(
    objects: ObjectTable, job: Job, bands: Collection[str], notes: list[str]
) -> tuple[dict[str, AnyArray], dict[str, IntArray]]:
    """Return ({column: values} of the objects that can be drawn, {reason: ids of those left out}).

    objects: of `read_objects`; job: the campaign.job.Job of the frame; bands: Camera.bands. What is assumed is added to
    `notes`.
    """
    count = len(objects)
    found: dict[str, AnyArray] = {"id": _ids(objects, notes)}
    found["obj_type"] = objects["obj_type"].astype(np.int16)  # FITS knows no int8
    found["ra"], found["dec"] = _places(objects, job, notes)
    found |= {name: _known(objects[name]) for name in _KEPT if name in objects}
    for name, none in _SHAPE.items():
        if name not in objects:
            notes.append(f"{name}: {none}")
    shape = {name: _known(objects[name], 0.0) if name in objects else np.zeros(count) for name in _SHAPE}
    kappa = shape["kappa"]
    shear = {"gamma1": shape["g1"] * (1 - kappa), "gamma2": shape["g2"] * (1 - kappa)}
    found |= {"e1": shape["e1"], "e2": shape["e2"], "kappa": kappa} | shear
    found |= _sizes(objects, notes)
    found |= _magnitudes(
        objects, job.chip.filter, bands, (1 - kappa) ** 2 - shear["gamma1"] ** 2 - shear["gamma2"] ** 2
    )
    return _drawable(found, bands)


def _known(values: ArrayLike, blank: float = np.nan) -> FloatArray:
    values = np.asarray(values, dtype=float)
    return np.where(np.isfinite(values) & (values > _UNKNOWN), values, blank)


def _ids(objects: ObjectTable, notes: list[str]) -> IntArray:
    if "id" in objects:
        ids = np.asarray(objects["id"])
        whole = ids.dtype.kind == "i" or (np.isfinite(ids) & (ids == np.floor(ids)) & (np.abs(ids) < 2**63)).all()
        if whole and len(np.unique(ids)) == len(ids):
            return ids.astype(np.int64)
    notes.append("obj_ID: counted from 1, for there are none, or some twice")
    return np.arange(1, len(objects) + 1)


def _places(objects: ObjectTable, job: Job, notes: list[str]) -> tuple[FloatArray, FloatArray]:
    """Return ICRS ra, dec [deg] that this exposure puts on the objects' pixels."""
    if {"x", "y"} <= set(objects):
        x, y = (np.asarray(objects[name], float) for name in ("x", "y"))
        seen = np.isfinite(x) & np.isfinite(y)
        ra, dec = np.full((2, len(x)), np.nan)
        if seen.any():
            ra[seen], dec[seen] = icrs(*job.wcs.pixel_to_world(x[seen], y[seen]), job.observer)
        return ra, dec
    notes.append("xImage, yImage: the places are ra, dec, taken as apparent directions")
    ra, dec = (np.asarray(objects[name], float) for name in ("ra", "dec"))
    return icrs(ra, dec, job.observer) if len(ra) else (ra, dec)


def _profiles(objects: ObjectTable, galaxy: BoolArray, notes: list[str]) -> dict[str, FloatArray]:
    """Return the Sersic indices and knots of a truth table that has them; images are not among its files."""
    if "image_file" in objects and (objects["image_file"] != "").any():
        notes.append("image_file: galaxies of an image are disks of its size")
    names = [name for name in ("n_disk", "n_bulge", "knots", "knots_frac") if name in objects]
    return {name: np.where(galaxy, objects[name], OPTIONAL[name][1]) for name in names}


def _sizes(objects: ObjectTable, notes: list[str]) -> dict[str, FloatArray]:
    """Return the sizes [arcsec], the bulge's share of the light, and of a truth table all that profiles are made of."""
    galaxy = objects["obj_type"] == GALAXY
    if {"size_disk", "size_bulge", "bulge_frac"} <= set(objects):
        sizes = {name: np.where(galaxy, objects[name], 0.0) for name in ("size_disk", "size_bulge", "bulge_frac")}
        return sizes | _profiles(objects, galaxy, notes)
    if "size" not in objects:
        notes.append("size: galaxies without sizes are left out")
    size = np.where(galaxy, _known(objects["size"], 0.0) if "size" in objects else 0.0, 0.0)
    share = np.zeros(len(galaxy))
    if {"bulgemass", "diskmass"} <= set(objects):
        bulge, disk = (np.maximum(_known(objects[name], 0.0), 0.0) for name in ("bulgemass", "diskmass"))
        share = np.divide(bulge, bulge + disk, out=share, where=galaxy & (bulge + disk > 0))
    if galaxy.any() and not share.any():
        notes.append("bulgemass, diskmass: galaxies are disks")
    notes.append("size: the same half-light radius for disk and bulge")
    return {"size_disk": size, "size_bulge": size, "bulge_frac": share}


def _magnitudes(objects: ObjectTable, filter_: str, bands: Collection[str], det_a: FloatArray) -> dict[str, FloatArray]:
    """Return {mag_B: AB before the lens}: the truth's are magnified by 1 / |det A|."""
    with np.errstate(divide="ignore"):
        lens = -2.5 * np.log10(np.abs(det_a))
    given = {f"mag_{band}": objects[f"mag_{band}"] for band in bands if f"mag_{band}" in objects}
    if not given:
        here = [band for band in bands if band == filter_.lower()] or list(bands)  # a grating: flat in all
        given = {f"mag_{band}": objects["mag"] for band in here}
    return {name: np.asarray(values, float) + lens for name, values in given.items()}


def _drawable(columns: dict[str, AnyArray], bands: Collection[str]) -> tuple[dict[str, AnyArray], dict[str, IntArray]]:
    """Return (columns of the rows that the table may have, {reason: ids of the others})."""
    table = ObjectTable.complete(columns, bands)
    left = {}
    mags = np.stack([np.asarray(columns[name]) for name in columns if name.startswith("mag_")])
    with np.errstate(invalid="ignore"):
        faults = {"no magnitude": ~np.isfinite(mags).any(axis=0)}
        faults[f"a magnitude outside {BRIGHTEST:g} to {FAINTEST:g}"] = ((mags < BRIGHTEST) | (mags > FAINTEST)).any(0)
    faults |= {reason: mask for reason, mask in reasons(table).items() if reason != STRONGLY_LENSED}
    good = np.ones(len(table), bool)
    for reason, mask in faults.items():
        if (good & mask).any():
            left[reason] = columns["id"][good & mask]
        good &= ~mask
    return {name: np.asarray(values)[good] for name, values in columns.items()}, left
