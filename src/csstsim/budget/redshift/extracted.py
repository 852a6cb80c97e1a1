"""The tables of spectra of one or more campaigns, after a check that they can be added: no noise or id counts twice."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.files.beside import beside
from csstsim.base.process.progress import progress
from csstsim.base.release import check_recipe
from csstsim.base.types import PathLike
from csstsim.catalog.table import GALAXY, QUASAR, STAR, ObjectTable
from csstsim.measure.spectra import line_columns, spectrum_columns
from csstsim.stages.level0 import truth_of

if TYPE_CHECKING:
    from csstsim.campaign.job import Job
    from csstsim.campaign.opened import OpenCampaign

SAME = 0.5  # arcsec: one id at places further apart is two objects
COLUMNS = spectrum_columns.COLUMNS, line_columns.COLUMNS  # of the two tables of a frame
STAY = GALAXY, QUASAR, STAR  # types of objects that have one place in all exposures, at J2000


def extracted(
    runs: Sequence[OpenCampaign], folder: PathLike | None = None, say: Callable[[str], object] = print
) -> list[tuple[ObjectTable, ObjectTable, ObjectTable]]:
    """Return [(spectra, lines, truth)] of the campaigns' spectroscopic frames that have been extracted.

    runs: campaign.opened.OpenCampaign; folder: of tables, beside each campaign's file, or None: the campaign's. Raises
    InputError for two campaigns with one frame, for one id at two places, and for tables of another recipe.
    """
    check_frames(runs)
    found: list[tuple[ObjectTable, ObjectTable, ObjectTable]] = []
    places = Places()
    for run in runs:
        frames = _of_campaign(run, folder, say)
        for *_, truth in frames:
            places.add(truth, run.file)
        found += frames
    return found


def check_frames(runs: Iterable[OpenCampaign]) -> None:
    """Raise InputError for two campaigns with the same frame: their noise is the same, and would count as two."""
    seen: dict[tuple[Any, ...], Path] = {}
    for run in runs:
        mine = {(*job.key, *sorted(run.recipe(job).items())) for job in run.slitless_jobs}
        twice = sorted(mine & seen.keys())
        if twice:
            obsid, chip = twice[0][:2]
            raise InputError(
                f"has the frame of exposure {obsid}, chip {chip}, which {seen[twice[0]]} has, too",
                file=run.file,
                key="--also",
                allowed="campaigns without a common frame",
            )
        seen |= dict.fromkeys(mine, run.file)


class Places:
    """Where the object of each id is."""

    def __init__(self) -> None:
        self.known: dict[int, tuple[float, float, PathLike]] = {}  # id: (ra [deg], dec [deg], campaign's file)

    def add(self, truth: ObjectTable, file: PathLike) -> None:
        """Add the objects of a truth table. Raises InputError for an id that is further than SAME from where it was."""
        stay = np.isin(truth["obj_type"], STAY)
        columns = (np.asarray(truth[name])[stay].tolist() for name in ("id", "ra_orig", "dec_orig"))
        for k, ra, dec in zip(*columns, strict=True):
            x, y, other = self.known.setdefault(k, (ra, dec, file))
            east = (ra - x + 180) % 360 - 180
            if 3600 * np.hypot(east * np.cos(np.radians(dec)), dec - y) > SAME:
                raise InputError(
                    f"the id {k} is of two objects, at {ra:.5f} {dec:+.5f} and, in {other}, at {x:.5f} {y:+.5f}",
                    file=file,
                    key="id",
                    value=k,
                    allowed=f"one place for one id, to {SAME:g} arcsec",
                )


def _of_campaign(
    run: OpenCampaign, folder: PathLike | None, say: Callable[[str], object]
) -> list[tuple[ObjectTable, ObjectTable, ObjectTable]]:
    found: list[tuple[ObjectTable, ObjectTable, ObjectTable]] = []
    jobs = run.slitless_jobs
    if not jobs:
        raise InputError("has no spectroscopic frame", file=run.file, allowed="exposures of chips behind a grating")
    for job in progress(jobs, "frames"):
        paths = _tables(run, job, folder)
        if all(path.is_file() for path in paths):
            tables = [ObjectTable.read(path) for path in paths]
            for path, table, columns in zip(paths, tables, COLUMNS, strict=True):
                check_recipe(path, table.meta, run.recipe(job, "measure"))
                _check_columns(path, table, columns)
            found.append((tables[0], tables[1], truth_of(run, job)))
    if not found:
        _refuse(run, jobs[0], folder)
    if len(found) < len(jobs):
        say(f"left out: {len(jobs) - len(found)} of {len(jobs)} frames of {run.file}, not extracted yet")
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
    there = beside(run.file, folder)
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
