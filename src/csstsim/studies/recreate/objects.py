"""The objects of a truth catalogue as a table that csstsim renders (catalog.own_table).

Positions are those on the image, xImage and yImage, mapped to the sky by the camera's geometry, so the objects have the
same pixels in the recreated frame. Magnitudes are `mag` without magnification, in the frame's filter (for a grating in
all bands: flat in f_nu). Shapes are size, e1, e2, kappa, g1, g2. The bulge's fraction of the flux is that of the mass.
A parquet truth table has the sizes of both components and all magnitudes.
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

_MARGIN = 0.05  # deg beyond a frame whose objects may add light to it: wings, orders of gratings
_BLANK = ("", "-", "-1", "-99", "nan", "none", "None")  # of a chip or filter that is not stated
_PLACEHOLDER = -90.0  # below: a placeholder, as -99 and -999
_COPIED = ("z", "teff", "logg", "feh", "av", "stellarmass", "bulgemass", "diskmass", "veldisp")  # not rendered
_SHAPE = {"e1": "round", "e2": "round", "kappa": "no lens", "g1": "no lens", "g2": "no lens"}


def read_objects(path: PathLike) -> ObjectTable:
    """Return the ObjectTable of a `.cat` or truth parquet file: names of csstsim, x, y from 0. Raises InputError."""
    path = Path(path)
    table = read_truth(path) if path.suffix == ".parquet" else read_cat(path)
    for name in ("mag", "obj_type"):
        if name not in table:
            raise InputError("the catalogue lacks a column", file=path, key=name)
    if not ({"x", "y"} <= set(table) or {"ra", "dec"} <= set(table)):
        raise InputError("the catalogue lacks a position", file=path, key="xImage, yImage or ra, dec")
    return table


def check_frame(objects: ObjectTable, truth: PathLike, job: Job, angle_known: bool = True) -> None:
    """Raise InputError if a catalogue is of another chip or filter than the frame's Job, or of another field.

    Positions are compared with the frame as given, x, y and ra, dec; without a known position angle, only x, y.
    """
    for name, key, allowed in (("chip", "ID_chip", str(job.chip.id)), ("filter", "filter", job.chip.filter)):
        for value in np.unique(np.asarray(objects[name]).astype(str)) if name in objects else ():
            number = value.removesuffix(".0").lstrip("0") if name == "chip" else value
            if number.lower() != allowed.lower() and value not in _BLANK:
                raise InputError("not of this frame", file=truth, key=key, value=str(value), allowed=allowed)
    window = job.window
    x = np.array([(window.x0 + window.x1) / 2])
    y = np.array([(window.y0 + window.y1) / 2])
    ra0, dec0 = job.wcs.pixel_to_world(x, y)
    corner = job.wcs.pixel_to_world(np.array([float(window.x0)]), np.array([float(window.y0)]))
    radius = _separation(ra0, dec0, *corner)[0] + _MARGIN
    for a, b in (("x", "y"), ("ra", "dec")) if angle_known else (("x", "y"),):
        if not {a, b} <= set(objects):
            continue
        position = np.stack([np.asarray(objects[name], float) for name in (a, b)])
        position = position[:, np.isfinite(position).all(axis=0)]
        if a == "x" and position.size:
            position = np.stack(job.wcs.pixel_to_world(*position))
        if position.size and not (_separation(ra0, dec0, *position) <= radius).any():
            key, near = ("xImage, yImage", "its pixels") if a == "x" else ("ra, dec", f"{ra0[0]:.4f}, {dec0[0]:.4f}")
            raise InputError("no object lies near the frame", file=truth, key=key, allowed=f"near {near}")


def _separation(*positions: FloatArray) -> FloatArray:
    """Return the angle [deg] between two positions ra, dec [deg], given as four arguments."""
    return np.degrees(angular_separation(*(np.radians(v) for v in positions)))


def campaign_table(
    objects: ObjectTable, job: Job, bands: Collection[str], notes: list[str]
) -> tuple[dict[str, AnyArray], dict[str, IntArray]]:
    """Return ({column: values} of the objects that can be rendered, {reason: ids of those left out}).

    objects: of `read_objects`; job: the campaign.job.Job of the frame; bands: Camera.bands. Assumptions are added to
    `notes`.
    """
    count = len(objects)
    columns: dict[str, AnyArray] = {"id": _ids(objects, notes)}
    columns["obj_type"] = objects["obj_type"].astype(np.int16)  # FITS knows no int8
    columns["ra"], columns["dec"] = _positions(objects, job, notes)
    columns |= {name: _known_values(objects[name]) for name in _COPIED if name in objects}
    for name, assumption in _SHAPE.items():
        if name not in objects:
            notes.append(f"{name}: {assumption}")
    shape = {name: _known_values(objects[name], 0.0) if name in objects else np.zeros(count) for name in _SHAPE}
    kappa = shape["kappa"]
    shear = {"gamma1": shape["g1"] * (1 - kappa), "gamma2": shape["g2"] * (1 - kappa)}
    columns |= {"e1": shape["e1"], "e2": shape["e2"], "kappa": kappa} | shear
    columns |= _sizes(objects, notes)
    columns |= _magnitudes(
        objects, job.chip.filter, bands, (1 - kappa) ** 2 - shear["gamma1"] ** 2 - shear["gamma2"] ** 2
    )
    return _split_renderable(columns, bands)


def _known_values(values: ArrayLike, blank: float = np.nan) -> FloatArray:
    values = np.asarray(values, dtype=float)
    return np.where(np.isfinite(values) & (values > _PLACEHOLDER), values, blank)


def _ids(objects: ObjectTable, notes: list[str]) -> IntArray:
    if "id" in objects:
        ids = np.asarray(objects["id"])
        whole = ids.dtype.kind == "i" or (np.isfinite(ids) & (ids == np.floor(ids)) & (np.abs(ids) < 2**63)).all()
        if whole and len(np.unique(ids)) == len(ids):
            return ids.astype(np.int64)
    notes.append("obj_ID: counted from 1, for there are none, or some twice")
    return np.arange(1, len(objects) + 1)


def _positions(objects: ObjectTable, job: Job, notes: list[str]) -> tuple[FloatArray, FloatArray]:
    """Return ICRS ra, dec [deg] that this exposure images on the objects' pixels."""
    if {"x", "y"} <= set(objects):
        x, y = (np.asarray(objects[name], float) for name in ("x", "y"))
        known = np.isfinite(x) & np.isfinite(y)
        ra, dec = np.full((2, len(x)), np.nan)
        if known.any():
            ra[known], dec[known] = icrs(*job.wcs.pixel_to_world(x[known], y[known]), job.observer)
        return ra, dec
    notes.append("xImage, yImage: the positions are ra, dec, taken as apparent directions")
    ra, dec = (np.asarray(objects[name], float) for name in ("ra", "dec"))
    return icrs(ra, dec, job.observer) if len(ra) else (ra, dec)


def _profiles(objects: ObjectTable, galaxy: BoolArray, notes: list[str]) -> dict[str, FloatArray]:
    """Return the Sersic indices and knots of a truth table that has them; its galaxy images are not available."""
    if "image_file" in objects and (objects["image_file"] != "").any():
        notes.append("image_file: galaxies of an image are disks of its size")
    names = [name for name in ("n_disk", "n_bulge", "knots", "knots_frac") if name in objects]
    return {name: np.where(galaxy, objects[name], OPTIONAL[name][1]) for name in names}


def _sizes(objects: ObjectTable, notes: list[str]) -> dict[str, FloatArray]:
    """Return sizes [arcsec] and the bulge's fraction of the flux; of a truth table also the rest of the profiles."""
    galaxy = objects["obj_type"] == GALAXY
    if {"size_disk", "size_bulge", "bulge_frac"} <= set(objects):
        sizes = {name: np.where(galaxy, objects[name], 0.0) for name in ("size_disk", "size_bulge", "bulge_frac")}
        return sizes | _profiles(objects, galaxy, notes)
    if "size" not in objects:
        notes.append("size: galaxies without sizes are left out")
    size = np.where(galaxy, _known_values(objects["size"], 0.0) if "size" in objects else 0.0, 0.0)
    bulge_fraction = np.zeros(len(galaxy))
    if {"bulgemass", "diskmass"} <= set(objects):
        bulge, disk = (np.maximum(_known_values(objects[name], 0.0), 0.0) for name in ("bulgemass", "diskmass"))
        bulge_fraction = np.divide(bulge, bulge + disk, out=bulge_fraction, where=galaxy & (bulge + disk > 0))
    if galaxy.any() and not bulge_fraction.any():
        notes.append("bulgemass, diskmass: galaxies are disks")
    notes.append("size: the same half-light radius for disk and bulge")
    return {"size_disk": size, "size_bulge": size, "bulge_frac": bulge_fraction}


def _magnitudes(objects: ObjectTable, filter_: str, bands: Collection[str], det_a: FloatArray) -> dict[str, FloatArray]:
    """Return {mag_B: AB before lensing}: the truth's are magnified by 1 / |det A|, det_a (n,)."""
    with np.errstate(divide="ignore"):
        magnification = -2.5 * np.log10(np.abs(det_a))
    mags = {f"mag_{band}": objects[f"mag_{band}"] for band in bands if f"mag_{band}" in objects}
    if not mags:
        bands_of_frame = [band for band in bands if band == filter_.lower()] or list(bands)  # a grating: flat in all
        mags = {f"mag_{band}": objects["mag"] for band in bands_of_frame}
    return {name: np.asarray(values, float) + magnification for name, values in mags.items()}


def _split_renderable(
    columns: dict[str, AnyArray], bands: Collection[str]
) -> tuple[dict[str, AnyArray], dict[str, IntArray]]:
    """Return (columns of the rows that can be rendered, {reason: ids of the others})."""
    table = ObjectTable.complete(columns, bands)
    left_out = {}
    mags = np.stack([np.asarray(columns[name]) for name in columns if name.startswith("mag_")])
    with np.errstate(invalid="ignore"):
        masks = {"no magnitude": ~np.isfinite(mags).any(axis=0)}
        masks[f"a magnitude outside {BRIGHTEST:g} to {FAINTEST:g}"] = ((mags < BRIGHTEST) | (mags > FAINTEST)).any(0)
    masks |= {reason: mask for reason, mask in reasons(table).items() if reason != STRONGLY_LENSED}
    renderable = np.ones(len(table), bool)
    for reason, mask in masks.items():
        if (renderable & mask).any():
            left_out[reason] = columns["id"][renderable & mask]
        renderable &= ~mask
    return {name: np.asarray(values)[renderable] for name, values in columns.items()}, left_out
