"""The hidden truth of a pack: a table of the objects on its images, and the truth tables of its frames."""

from __future__ import annotations

import json
import shutil
from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.files.atomic import atomic_path
from csstsim.base.sphere import ra_dec, unit_vectors
from csstsim.catalog.flags import NOT_RENDERED, OFF_CHIP
from csstsim.catalog.table import ObjectTable
from csstsim.studies.release.pack_frames import stem
from csstsim.studies.release.score.field import FRAMES, OBJECTS

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from csstsim.base.types import AnyArray
    from csstsim.campaign.job import Job
    from csstsim.campaign.opened import OpenCampaign
    from csstsim.studies.release.pack_frames import PackFrame

COLUMNS = {  # of objects.parquet; B: each band of the pack
    "id": "the object",
    "obj_type": "0 star, 1 galaxy, 2 quasar",
    "ra": "deg, ICRS at the epoch of the images, proper motion and parallax in it",
    "dec": "deg",
    "z": "redshift; 0 of a star",
    "size": "arcsec, half-light radius, of disk and bulge weighted with their light, before lensing; 0 of a point",
    "e1": "ellipticity (a - b) / (a + b) with lensing, axis 1 along +RA (east); 0 of a point",
    "e2": "the same, axis 2 at 45 deg towards north",
    "g1": "reduced shear, axes of e1",
    "g2": "the same",
    "mag_B": "AB, with lensing",
    "snr_B": "predicted S/N in all images of the band together",
    "n_B": "images of the band that contain its position",
}

TYPES = {  # of those that are not float64
    "id": np.int64,
    "obj_type": np.int8,
    "n_B": np.int32,
    "z": np.float32,
    "size": np.float32,
}


def true_objects(run: OpenCampaign, jobs: Sequence[Job]) -> ObjectTable:
    """Return the ObjectTable of COLUMNS: the objects rendered on the images of `jobs`, each once, sorted by id.

    Objects that move during an exposure are left out.
    """
    from csstsim.stages.level0 import truth_of

    bands = list(dict.fromkeys(job.chip.filter.lower() for job in jobs))
    frames = [_frame_objects(truth_of(run, job), job, run) for job in jobs]
    names = list(frames[0])
    rows = {name: np.concatenate([frame[name] for frame in frames]) for name in names}
    ids, first, index = np.unique(rows["id"], return_index=True, return_inverse=True)
    n = len(ids)
    vectors = unit_vectors(rows["ra"], rows["dec"]).reshape(-1, 3)
    mean = np.asarray(np.stack([np.bincount(index, vectors[:, k], n) for k in range(3)], axis=1), float)
    columns = {name: rows[name][first] for name in names if name not in ("band", "snr", "mag")}
    columns["ra"], columns["dec"] = ra_dec(mean) if n else (np.zeros(0), np.zeros(0))
    for band in bands:
        of_band = rows["band"] == band
        images = np.bincount(index[of_band], minlength=n)
        with np.errstate(invalid="ignore"):
            columns[f"mag_{band}"] = np.bincount(index[of_band], rows["mag"][of_band], n) / images
        columns[f"snr_{band}"] = np.sqrt(np.bincount(index[of_band], rows["snr"][of_band] ** 2, n))
        columns[f"n_{band}"] = images.astype(np.int32)
    return ObjectTable(columns)


def _frame_objects(truth: ObjectTable, job: Job, run: OpenCampaign) -> dict[str, AnyArray]:
    """Return {column: (n,)} of the rendered objects whose positions are in a frame's window."""
    selected = job.window.contains(truth["x"], truth["y"]) & (truth["flags"] & (NOT_RENDERED | OFF_CHIP) == 0)
    selected &= (truth["electrons"] > 0) & (truth.get("trail_length", np.zeros(len(truth))) == 0)
    truth = truth.take(selected)
    e, g = (truth[f"{name}1"].astype(float) + 1j * truth[f"{name}2"].astype(float) for name in "eg")
    e = (e + g) / (1 + np.conj(g) * e)  # Seitz & Schneider 1997
    galaxy = truth["obj_type"] == 1
    e = np.where(galaxy, e, 0.0)
    band = job.chip.filter.lower()
    zeropoint = run.camera.filters[job.chip.filter].zeropoint(run.camera.telescope)
    mag_rendered = zeropoint - 2.5 * np.log10(truth["electrons"] / job.pointing.exptime)
    mag = truth[f"mag_{band}"].astype(float)
    return {
        "id": truth["id"], "obj_type": truth["obj_type"], "ra": truth["ra_epoch"], "dec": truth["dec_epoch"],
        "z": truth["z"], "size": np.where(galaxy, truth["size"], 0.0).astype(np.float32), "e1": e.real, "e2": e.imag,
        "g1": truth["g1"], "g2": truth["g2"], "band": np.full(len(truth), band),
        "mag": np.where(np.isfinite(mag), mag, mag_rendered), "snr": truth["snr"].astype(float),
    }  # fmt: skip


def write_truth(run: OpenCampaign, jobs: Sequence[Job], frames: Sequence[PackFrame], folder: Path) -> ObjectTable:
    """Write true objects, list of frames (PackFrames, in the order of jobs) and the frames' tables into `folder`."""
    imaging = [job for job in jobs if job.chip.kind == "imaging"]
    table = true_objects(run, imaging)
    table.write(folder / OBJECTS, {"about": COLUMNS})
    entries = [
        {"file": frame.row["calibrated"], "filter": job.chip.filter, "kind": job.chip.kind, "corners": frame.corners}
        for job, frame in zip(jobs, frames, strict=True)
    ]
    with atomic_path(folder / FRAMES) as temporary:
        temporary.write_text(json.dumps({"name": run.config.name, "frames": entries}, indent=1) + "\n")
    (folder / "frames").mkdir(exist_ok=True)
    for job in jobs:
        files = {run.paths.level0_truth(job): "truth"}
        files |= {run.paths.level0_orders(job): "orders"} if run.has_orders(job) else {}
        for path, kind in files.items():
            with atomic_path(folder / "frames" / f"{stem(job)}.{kind}.parquet") as temporary:
                shutil.copyfile(path, temporary)
    return table
