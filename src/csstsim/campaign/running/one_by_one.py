"""Several products in one process, which can go on where an earlier one was stopped.

Snakemake removes all files of a job that failed before it runs it again. So what is finished has a second name (a hard
link) in chips/ until all of the job's products are. The next attempt takes it from there if it has the same recipe. On
a file system without hard links, the next attempt makes everything again. A process whose parent was killed keeps the
second names: it is not known to be finished, and will be started again.

A chip that fails does not take the others with it: they are made, then the process fails with the reasons. As Snakemake
removes all files of that job, a file in logs/apart/ says which chip failed. From the next run on, the workflow makes
such a chip by itself (`apart`), so the job of the others succeeds. Within a run the jobs stay as at its start.
"""

from __future__ import annotations

import os
import shutil
import time
import traceback
from pathlib import Path
from typing import TYPE_CHECKING

from csstsim.base.digest import digest
from csstsim.base.errors import CsstsimError, InputError
from csstsim.base.files.atomic import atomic_path
from csstsim.base.plural import number_of
from csstsim.base.process.memory import release
from csstsim.base.process.progress import progress
from csstsim.base.stage_records import STAGES
from csstsim.campaign.products import kinds
from csstsim.campaign.running.job_log import finished_earlier, part_log

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from csstsim.campaign.job import Job
    from csstsim.campaign.opened import OpenCampaign

RULES = tuple(stage.instead_of or stage.name for stage in STAGES.values() if stage.exposure_rule)
CPU = "cpu_s"  # a file beside the second names: what they took
# reasons of failures before and since the start of the workflow
_OLD = ".txt"
_NEW = ".new"


def one_by_one(
    run: OpenCampaign,
    rule: str,
    jobs: Sequence[Job],
    make: Callable[[Job], object],
    resume: bool = False,
    say: Callable[[str], object] = print,
) -> None:
    """Call make(job) for the jobs of an exposure, one after the other.

    rule: one of RULES, whose products `make` writes; resume: but for those that an earlier attempt finished. Raises
    what `make` raised, for several jobs after all have been tried: InputError if that is all it was, CsstsimError else.
    """
    folder = _folder(run, jobs[0].obsid, rule)
    parent = os.getppid()
    failed: dict[int, Exception] = {}
    for job in progress(jobs, "chips"):
        kept, files = _names(run, rule, job) if resume else (None, [])
        if kept is not None and kept.is_dir():
            say(finished_earlier("chip", job.chip.id, _link(kept, files[0].parent)))
            continue
        begun = time.process_time()
        try:
            with job.named(), part_log("chip", job.chip.id):
                make(job)
        except Exception as exc:
            if len(jobs) == 1:
                raise
            if not isinstance(exc, CsstsimError):
                traceback.print_exc()
            failed[job.chip.id] = exc
            if resume:
                _set_apart(run, rule, job, exc)
            continue
        if job is not jobs[-1]:  # the end of the process frees the rest
            release()
        if kept is not None:
            _keep(files, kept, time.process_time() - begun)
    if failed:
        reasons = "; ".join(f"chip {number}: {_reason(exc)}" for number, exc in failed.items())
        kind = InputError if all(isinstance(exc, InputError) for exc in failed.values()) else CsstsimError
        others = f"{number_of(len(failed), 'chip')} of {len(jobs)} failed, the others are made"
        raise kind(f"exposure {jobs[0].obsid}: {others}: {reasons}")
    if resume and os.getppid() == parent:
        shutil.rmtree(folder, ignore_errors=True)


def apart(run: OpenCampaign, rule: str, *, start: bool = False) -> set[tuple[str, int]]:
    """Return {(obsid, chip number), ...} that failed in a job of several chips before the workflow's last start.

    start: now is a start, so failures since the last one count, too.
    """
    endings = (_OLD, _NEW) if start else (_OLD,)
    names = [path.stem.split("_") for kind in endings for path in _apart(run, rule).glob(f"*_*{kind}")]
    return {(obsid, int(chip)) for obsid, chip in names if chip.isdigit()}


def without_psf(run: OpenCampaign, number: int, exc: Exception) -> None:
    """Set a chip apart in all exposures of the sky, because its PSF set cannot be made: they would wait for it."""
    for job in run.jobs:
        if job.chip.id == number and job.pointing.type == "SCIE":
            _set_apart(run, "level0", job, exc)


def started(run: OpenCampaign) -> None:
    """Let failures so far count: this is the start of the workflow."""
    for path in [path for rule in RULES for path in _apart(run, rule).glob(f"*{_NEW}")]:
        path.replace(path.with_suffix(_OLD))


def failed_since(run: OpenCampaign) -> bool:
    """Whether chips have failed among others since the start of the workflow."""
    return any(path for rule in RULES for path in _apart(run, rule).glob(f"*{_NEW}"))


def _apart(run: OpenCampaign, rule: str) -> Path:
    return run.paths.output / "logs" / "apart" / rule


def _set_apart(run: OpenCampaign, rule: str, job: Job, exc: Exception) -> None:
    path = _apart(run, rule) / f"{job.obsid}_{job.chip.id:02d}{_NEW}"
    with atomic_path(path) as temporary:
        Path(temporary).write_text(f"{_reason(exc)}\n")


def _reason(exc: Exception) -> str:
    return str(exc) if isinstance(exc, CsstsimError) else f"{type(exc).__name__}: {exc}"


def _names(run: OpenCampaign, rule: str, job: Job) -> tuple[Path, list[Path]]:
    """Return the folder of a job's second names, whose name says what decides the products, and the products."""
    files = kinds(run)[rule].files_of(job)
    if rule == "level0":
        files.append(run.paths.level0_cosmic(job))  # which a layer may save
    recipe = run.recipe(job, STAGES[rule].recipe)
    return _folder(run, job.obsid, rule) / digest([job.key, recipe]), files


def forget(run: OpenCampaign) -> None:
    """Remove the second names in a finished campaign."""
    for rule in RULES:
        for folder in _folder(run, "", rule).parent.glob(f"*_{rule}"):
            shutil.rmtree(folder, ignore_errors=True)


def _folder(run: OpenCampaign, obsid: str, rule: str) -> Path:
    return run.paths.output / "chips" / f"{obsid}_{rule}"


def _keep(files: Iterable[Path], folder: Path, cpu: float) -> None:
    """Give files a second name in a folder, which is there once all have. cpu: seconds that they took."""
    part = folder.with_name(f"{folder.name}.part")
    shutil.rmtree(part, ignore_errors=True)
    part.mkdir(parents=True)
    try:
        for path in filter(Path.exists, files):
            os.link(path, part / path.name)
        (part / CPU).write_text(f"{cpu:.1f}")
        part.rename(folder)
    except OSError:  # no hard links here
        shutil.rmtree(part, ignore_errors=True)


def _link(kept: Path, folder: Path) -> float:
    """Give kept files their names in a folder again, newer than their inputs, as Snakemake expects.

    Return the CPU s that they took.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for path in kept.iterdir():
        if path.name != CPU:
            (folder / path.name).unlink(missing_ok=True)
            os.utime(path)
            os.link(path, folder / path.name)
    return float((kept / CPU).read_text())
