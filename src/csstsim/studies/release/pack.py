"""`csstsim release pack`: a small public benchmark from a finished campaign, and its truth in a separate folder.

DIR/public/  README.md frames.csv filters.csv raw/ calibrated/ psf/ gratings/ MANIFEST.* ro-crate-metadata.json
DIR/truth/   README.md objects.parquet frames.json frames/ workflow/ MANIFEST.* ro-crate-metadata.json
"""

from __future__ import annotations

import csv
import io
import shutil
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.files.atomic import atomic_path
from csstsim.base.plural import number_of
from csstsim.base.process.progress import progress
from csstsim.base.resampling import on_grid
from csstsim.base.shipped import ROOT
from csstsim.delivery.manifest import CRATE_FILE, FILES, file_hash, write_manifest
from csstsim.studies.release.crate import Crate, CrateFile, licence_of, write_crate
from csstsim.studies.release.made_with import inputs, tables_version, write_made_with
from csstsim.studies.release.pack_frames import write_frame
from csstsim.studies.release.pack_readme import readme, truth_readme
from csstsim.studies.release.pack_truth import COLUMNS, write_truth
from csstsim.studies.release.run_record import run_record
from csstsim.studies.release.star_psf import STARS_MIN

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
    from typing import Any

    from csstsim.base.types import PathLike
    from csstsim.campaign.job import Job
    from csstsim.campaign.opened import OpenCampaign
    from csstsim.catalog.table import ObjectTable

PUBLIC = "public"
TRUTH = "truth"
CITATION = "CITATION.cff"
KINDS = {
    "raw": "a frame as read",
    "calibrated": "a calibrated frame",
    "psf": "the PSF of an image, of its stars",
    "gratings": "a grating",
    "frames": "truth of a frame",
}
FOLDERS = {
    "raw": "frames as read, RICE tiles",
    "calibrated": "calibrated images and frames of spectra",
    "psf": "PSF models of the images' own stars, PSFEx's form",
    "gratings": "traces, dispersion and sensitivities",
    "frames": "truth tables of the frames",
    "workflow": "what the frames were made with",
}
CURVE_STEP = 10.0  # angstrom


def pack(
    run: OpenCampaign,
    output: PathLike,
    log: Callable[[str], object],
    authors: Iterable[str] = (),
    licence: str = "CC-BY-4.0",
) -> None:
    """Write the pack of a finished campaign.opened.OpenCampaign into the folder `output`, which is empty or missing.

    MANIFEST.sha256 is written last: a pack without it is not finished. If anything fails, no file is left. authors:
    names; licence: SPDX name or address. Raises InputError, also for a campaign that is not finished.
    """
    output = Path(output)
    if output.exists() and (not output.is_dir() or any(output.iterdir())):
        raise InputError("exists already, and is not empty", file=output, key="--output")
    licence_of(licence)
    jobs = [job for job in run.jobs if job.pointing.type == "SCIE"]
    _check_finished(run, jobs)
    public = output / PUBLIC
    truth = output / TRUTH
    with _all_or_nothing(public, truth):
        rows, table = _write_pack(run, jobs, public, truth, log, {"authors": tuple(authors), "licence": licence})
    size = sum(path.stat().st_size for path in output.rglob("*") if path.is_file())
    log(f"{output}: {_number_of_frames(rows)}, {number_of(len(table), 'true object')}, {size / 1e9:.3g} GB")
    log(f"{public}: to give away; {truth}: to keep, for `csstsim release score CATALOGUE --truth {truth}`")


@contextmanager
def _all_or_nothing(*folders: Path) -> Iterator[None]:
    """Make the folders; remove them if the body of the `with` statement fails."""
    try:
        for folder in folders:
            folder.mkdir(parents=True)
        yield
    except BaseException:
        for folder in folders:
            shutil.rmtree(folder, ignore_errors=True)
        raise


def _write_pack(
    run: OpenCampaign,
    jobs: Sequence[Job],
    public: Path,
    truth: Path,
    log: Callable[[str], object],
    credit: Mapping[str, Any],
) -> tuple[list[dict[str, Any]], ObjectTable]:
    """Write the files of a pack; return the rows of frames.csv and the true objects.

    The frames take minutes, so they are written after the files that csstsim copies. credit: authors and licence of
    both Crates.
    """
    _write(public / CITATION, (ROOT / CITATION).read_text(encoding="utf-8"))
    _write(public / "filters.csv", _csv(_curves(run, jobs)))
    _gratings(run, jobs, public / "gratings")
    made_with = write_made_with(run, truth)
    frames = [write_frame(run, job, public) for job in progress(jobs, "frames")]
    rows = [frame.row for frame in frames]
    for row in rows:
        if row["kind"] == "imaging" and not row["psf"]:
            stars = f"fewer than {STARS_MIN} of its stars are bright, alone and off the edge"
            log(f"{row['name']}: no PSF model, for {stars}")
    _write(public / "frames.csv", _csv(rows))
    _write(public / "README.md", readme(run.config.name, rows, credit["licence"]))
    table = write_truth(run, jobs, frames, truth)
    first, *others = (job.chip.filter for job in _imaging(jobs))
    band = "r" if "r" in others else first
    _write(truth / "README.md", truth_readme(run.config.name, COLUMNS, band.lower()))
    _write_metadata(
        public,
        Crate(
            name=f"{run.config.name}: simulated frames",
            description=_number_of_frames(rows),
            files=_files(public),
            folders=FOLDERS,
            **credit,
        ),
    )
    files = {name: file._replace(kind=made_with.get(name, file.kind)) for name, file in _files(truth).items()}
    _write_metadata(
        truth,
        Crate(
            name=f"{run.config.name}: the truth",
            description=f"the true sky of {_number_of_frames(rows)}",
            files=files,
            folders=FOLDERS,
            run=run_record(run.paths.output),
            inputs=tuple(inputs(run)),
            version=tables_version(),
            **credit,
        ),
    )
    return rows, table


def _check_finished(run: OpenCampaign, jobs: Sequence[Job]) -> None:
    """Raise InputError if a product that a pack needs is missing, or if there is no image."""
    if not _imaging(jobs):
        raise InputError("has no science exposure of an imaging chip: there is nothing to find", file=run.file)
    for job in jobs:
        needed = [run.paths.level0(job), run.paths.level0_truth(job), run.paths.psf(job.chip.id)]
        needed += [run.paths.measure(*job.key)] if job.chip.kind == "imaging" else []
        for path in needed:
            if not path.is_file():
                raise InputError(
                    "not made yet: finish the campaign first (`csstsim status` tells how far it is)", file=path
                )


def _imaging(jobs: Iterable[Job]) -> list[Job]:
    return [job for job in jobs if job.chip.kind == "imaging"]


def _number_of_frames(rows: Sequence[Mapping[str, Any]]) -> str:
    kinds = {"imaging": ("image", None), "slitless": ("spectroscopic frame", None)}
    counts = {kind: sum(row["kind"] == kind for row in rows) for kind in kinds}
    return " and ".join(number_of(n, *kinds[kind]) for kind, n in counts.items() if n)


def _curves(run: OpenCampaign, jobs: Iterable[Job]) -> list[dict[str, str]]:
    """Return the rows of filters.csv: wavelength [angstrom], and the throughput of each filter of the pack."""
    names = list(dict.fromkeys(job.chip.filter for job in jobs))
    curves = [run.camera.filters[name] for name in names]
    low = min(curve.wavelength[0] for curve in curves)
    high = max(curve.wavelength[-1] for curve in curves)
    grid = np.arange(low, high + CURVE_STEP / 2, CURVE_STEP)
    values = [on_grid(grid, curve.wavelength, curve.throughput) for curve in curves]
    nonzero = np.any(values, axis=0)
    columns = zip(grid[nonzero], *(value[nonzero] for value in values), strict=True)
    return [
        {"wavelength_angstrom": f"{wave:g}"}
        | {name: f"{value:.6g}" for name, value in zip(names, throughputs, strict=True)}
        for wave, *throughputs in columns
    ]


def _gratings(run: OpenCampaign, jobs: Iterable[Job], folder: Path) -> None:
    """Copy the files of the gratings of a pack's chips, and write chips.csv."""
    chips = {job.chip.id: job.chip for job in jobs if job.chip.kind == "slitless"}
    if not chips:
        return
    source = Path(run.camera.folder) / "gratings"
    gratings: set[str] = set()
    rows: list[dict[str, Any]] = []
    for chip in chips.values():
        pair = run.camera.gratings[chip.id]
        rows.append(
            {
                "chip": chip.id,
                "filter": chip.filter,
                "left": pair.left.name,
                "right": pair.right.name,
                "split": pair.split,
            }
        )
        gratings |= {pair.left.name, pair.right.name}
    filters = {chip.filter for chip in chips.values()}
    files = [source / f"{name}.conf" for name in sorted(gratings)]
    files += sorted(path for filter_ in filters for path in source.glob(f"{filter_}_*.fits"))
    for path in files:
        with atomic_path(folder / path.name) as temporary:
            shutil.copyfile(path, temporary)
    _write(folder / "chips.csv", _csv(rows))


def _csv(rows: Sequence[Mapping[str, Any]]) -> str:
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def _write(path: Path, text: str) -> None:
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _files(folder: Path) -> dict[str, CrateFile]:
    """Return {path: CrateFile} of the files below a folder."""
    paths = sorted(path for path in folder.rglob("*") if path.is_file())
    names = [path.relative_to(folder).as_posix() for path in paths]
    return {
        name: CrateFile(KINDS.get(name.partition("/")[0], path.name), path.stat().st_size, file_hash(path))
        for name, path in zip(names, paths, strict=True)
    }


def _write_metadata(folder: Path, crate: Crate) -> None:
    """Write a folder's crate, then its manifest, which lists the crate as well."""
    write_crate(folder, crate)
    kinds = {name: file.kind for name, file in crate.files.items()} | {CRATE_FILE: "metadata"}
    write_manifest(folder, {name: kind for name, kind in kinds.items() if name not in FILES})
