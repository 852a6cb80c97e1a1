"""The tables of spectra of one or more campaigns, after a check that they can be added: no noise or id counts twice."""

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

SAME = 0.5  # arcsec: one id at positions further apart is two objects
COLUMNS = spectrum_columns.COLUMNS, line_columns.COLUMNS  # of the two tables of a frame
STAY = GALAXY, QUASAR, STAR  # types of objects that have one position in all exposures, at J2000


class FrameTables(NamedTuple):
    """The tables of a spectroscopic frame: its spectra, its lines, and the truth beside its Level-0 file."""

    spectra: ObjectTable
    lines: ObjectTable
    truth: ObjectTable


class _Position(NamedTuple):
    """Where an object is [deg], and the file of the campaign that has it there."""

    ra: float
    dec: float
    file: PathLike


def extracted(
    runs: Sequence[OpenCampaign], folder: PathLike | None = None, log: Callable[[str], object] = print
) -> list[FrameTables]:
    """Return the FrameTables of the campaigns' spectroscopic frames that have been extracted.

    runs: campaign.opened.OpenCampaign; folder: of tables, relative to each campaign's file, or None: the campaign's.
    Raises InputError for two campaigns with one frame, for one id at two positions, and for tables of another recipe.
    """
    check_frames(runs)
    found: list[FrameTables] = []
    positions = Positions()
    for run in runs:
        frames = _of_campaign(run, folder, log)
        for frame in frames:
            positions.add(frame.truth, run.file)
        found += frames
    return found


def check_frames(runs: Iterable[OpenCampaign]) -> None:
    """Raise InputError for two campaigns with the same frame: their noise is the same, and would count as two."""
    seen: dict[tuple[Any, ...], Path] = {}
    for run in runs:
        mine = {(*job.key, *sorted(run.recipe(job).items())) for job in run.slitless_jobs}
        twice = sorted(mine & seen.keys())
        if twice:
            first, *_ = twice
            obsid, chip, *_ = first
            raise InputError(
                f"has the frame of exposure {obsid}, chip {chip}, which {seen[first]} has, too",
                file=run.file,
                key="--also",
                allowed="campaigns without a common frame",
            )
        seen |= dict.fromkeys(mine, run.file)


class Positions:
    """Where the object of each id is."""

    def __init__(self) -> None:
        self.known: dict[int, _Position] = {}  # by id

    def add(self, truth: ObjectTable, file: PathLike) -> None:
        """Add the objects of a truth table. Raises InputError for an id that is further than SAME from where it was."""
        stay = np.isin(truth["obj_type"], STAY)
        columns = (np.asarray(truth[name])[stay].tolist() for name in ("id", "ra_orig", "dec_orig"))
        for k, ra, dec in zip(*columns, strict=True):
            known = self.known.setdefault(k, _Position(ra, dec, file))
            east = (ra - known.ra + 180) % 360 - 180
            if 3600 * np.hypot(east * np.cos(np.radians(dec)), dec - known.dec) > SAME:
                here = f"{ra:.5f} {dec:+.5f}"
                raise InputError(
                    f"the id {k} is of two objects, at {here} and, in {known.file}, at {known.ra:.5f} {known.dec:+.5f}",
                    file=file,
                    key="id",
                    value=k,
                    allowed=f"one position for one id, to {SAME:g} arcsec",
                )


def _of_campaign(run: OpenCampaign, folder: PathLike | None, log: Callable[[str], object]) -> list[FrameTables]:
    found: list[FrameTables] = []
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
            found.append(FrameTables(spectra, lines, truth_of(run, job)))
    if not found:
        first, *_ = jobs
        _refuse(run, first, folder)
    if len(found) < len(jobs):
        log(f"left out: {len(jobs) - len(found)} of {len(jobs)} frames of {run.file}, not extracted yet")
    return found


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
    there = relative_to_file(run.file, folder)
    return there / spectra.name, there / lines.name


def _refuse(run: OpenCampaign, job: Job, folder: PathLike | None) -> NoReturn:
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
