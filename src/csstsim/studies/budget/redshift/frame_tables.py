"""The tables of spectra of one or more campaigns, after a check that no frame or object id occurs in two of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn

import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.files.relative_to_file import relative_to_file
from csstsim.base.process.progress import progress
from csstsim.base.release import check_recipe
from csstsim.base.types import PathLike
from csstsim.catalog.table import GALAXY, QUASAR, STAR, ObjectTable
from csstsim.measure.spectra import line_columns, spectrum_columns
from csstsim.stages.level0 import truth_of

if TYPE_CHECKING:
    from csstsim.campaign.job import Job
    from csstsim.campaign.opened import OpenCampaign

POSITION_TOLERANCE = 0.5  # arcsec: positions of one id that differ by more are of two objects
COLUMNS = spectrum_columns.COLUMNS, line_columns.COLUMNS  # of the two tables of a frame
FIXED_TYPES = GALAXY, QUASAR, STAR  # types of objects with one position at J2000 in all exposures


class FrameTables(NamedTuple):
    """The tables of a spectroscopic frame: its spectra, its lines, and the truth of its Level-0 file."""

    spectra: ObjectTable
    lines: ObjectTable
    truth: ObjectTable


class _Position(NamedTuple):
    """The position of an object [deg], and the file of the campaign that has it."""

    ra: float
    dec: float
    file: PathLike


def read_frame_tables(
    runs: Sequence[OpenCampaign], folder: PathLike | None = None, log: Callable[[str], object] = print
) -> list[FrameTables]:
    """Return the FrameTables of the campaigns' spectroscopic frames that have been extracted.

    runs: campaign.opened.OpenCampaign; folder: of tables, relative to each campaign's file, or None: the campaign's.
    Raises InputError for two campaigns with one frame, for one id at two positions, and for tables of another recipe.
    """
    check_frames(runs)
    frames: list[FrameTables] = []
    positions = Positions()
    for run in runs:
        frames_of_run = _campaign_tables(run, folder, log)
        for frame in frames_of_run:
            positions.add(frame.truth, run.file)
        frames += frames_of_run
    return frames


def check_frames(runs: Iterable[OpenCampaign]) -> None:
    """Raise InputError for two campaigns with a common frame: its noise would be counted twice as independent."""
    file_of_frame: dict[tuple[Any, ...], Path] = {}
    for run in runs:
        frames = {(*job.key, *sorted(run.recipe(job).items())) for job in run.slitless_jobs}
        common = sorted(frames & file_of_frame.keys())
        if common:
            first, *_ = common
            obsid, chip, *_ = first
            raise InputError(
                f"has the frame of exposure {obsid}, chip {chip}, which {file_of_frame[first]} has, too",
                file=run.file,
                key="--also",
                allowed="campaigns without a common frame",
            )
        file_of_frame |= dict.fromkeys(frames, run.file)


class Positions:
    """The position of the object of each id."""

    def __init__(self) -> None:
        self.known: dict[int, _Position] = {}  # by id

    def add(self, truth: ObjectTable, file: PathLike) -> None:
        """Add the objects of a truth table. Raises InputError if an id is beyond POSITION_TOLERANCE of its position."""
        fixed = np.isin(truth["obj_type"], FIXED_TYPES)
        columns = (np.asarray(truth[name])[fixed].tolist() for name in ("id", "ra_orig", "dec_orig"))
        for id_, ra, dec in zip(*columns, strict=True):
            known = self.known.setdefault(id_, _Position(ra, dec, file))
            east = (ra - known.ra + 180) % 360 - 180
            if 3600 * np.hypot(east * np.cos(np.radians(dec)), dec - known.dec) > POSITION_TOLERANCE:
                here = f"{ra:.5f} {dec:+.5f}"
                there = f"in {known.file}, at {known.ra:.5f} {known.dec:+.5f}"
                raise InputError(
                    f"the id {id_} is of two objects, at {here} and, {there}",
                    file=file,
                    key="id",
                    value=id_,
                    allowed=f"one position for one id, to {POSITION_TOLERANCE:g} arcsec",
                )


def _campaign_tables(run: OpenCampaign, folder: PathLike | None, log: Callable[[str], object]) -> list[FrameTables]:
    frames: list[FrameTables] = []
    jobs = run.slitless_jobs
    if not jobs:
        raise InputError("has no spectroscopic frame", file=run.file, allowed="exposures of chips behind a grating")
    for job in progress(jobs, "frames"):
        paths = _tables(run, job, folder)
        if all(path.is_file() for path in paths):
            spectra, lines = (ObjectTable.read(path) for path in paths)
            for path, table, columns in zip(paths, (spectra, lines), COLUMNS, strict=True):
                check_recipe(path, table.meta, run.recipe(job, "measure"))
                _check_columns(path, table, columns)
            frames.append(FrameTables(spectra, lines, truth_of(run, job)))
    if not frames:
        first, *_ = jobs
        _raise_missing(run, first, folder)
    if len(frames) < len(jobs):
        log(f"left out: {len(jobs) - len(frames)} of {len(jobs)} frames of {run.file}, not extracted yet")
    return frames


def _check_columns(path: Path, table: ObjectTable, columns: Iterable[str]) -> None:
    if missing := [name for name in columns if name not in table]:
        raise InputError(
            f"the table lacks {', '.join(missing)}; remove it, and `csstsim extract` makes it again",
            file=path,
            key=missing[0],
            allowed=", ".join(columns),
        )


def _tables(run: OpenCampaign, job: Job, folder: PathLike | None) -> tuple[Path, Path]:
    """Return the paths of a frame's tables of spectra and lines."""
    spectra = run.paths.spectra(*job.key)
    lines = run.paths.lines(*job.key)
    if folder is None:
        return spectra, lines
    tables_folder = relative_to_file(run.file, folder)
    return tables_folder / spectra.name, tables_folder / lines.name


def _raise_missing(run: OpenCampaign, job: Job, folder: PathLike | None) -> NoReturn:
    """Raise the InputError of a campaign none of whose frames has its tables; job: of the first frame."""
    missing = next(path for path in _tables(run, job, folder) if not path.is_file())
    obsid, chip = job.key
    step = f"csstsim extract {run.file} --obsid {obsid} --chip {chip}"
    if folder is None:
        raise InputError(f"no such table of spectra; `{step}` makes it", file=missing.absolute())
    raise InputError(
        "no table of spectra",
        file=missing.parent.absolute(),
        key="--spectra",
        value=str(folder),
        allowed=f"a folder of tables by `csstsim extract`, as {missing.name}",
    )
