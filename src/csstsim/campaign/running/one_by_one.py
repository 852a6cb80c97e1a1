"""Several products in one process, which can continue where an earlier process was stopped.

Snakemake removes all files of a failed job before it repeats the job. So each finished product has a second name (a
hard link) in chips/ until the job is complete. The next attempt uses it if its recipe is the same. Without hard links,
the next attempt makes all products again. A process whose parent was killed keeps the second names, because it will be
started again.

If one chip fails, the others are still made; then the process fails with the reasons. Snakemake removes all files of
that job, so a file in logs/apart/ records the chip. From the next run on, the workflow makes such a chip in a separate
job (`failed_chips`), so that the job of the others succeeds. Within a run, jobs do not change.
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
from csstsim.campaign.products import also_written, kinds
from csstsim.campaign.running.job_log import finished_earlier, part_log

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from csstsim.campaign.job import Job
    from csstsim.campaign.opened import OpenCampaign

RULES = tuple(stage.instead_of or stage.name for stage in STAGES.values() if stage.exposure_rule)
CPU = "cpu_s"  # file with the CPU time of the products, in the folder of their second names
_OLD = ".txt"  # suffix of failures before the start of the workflow
_NEW = ".new"  # ... and since


def one_by_one(
    run: OpenCampaign,
    rule: str,
    jobs: Sequence[Job],
    make: Callable[[Job], object],
    resume: bool = False,
    log: Callable[[str], object] = print,
) -> None:
    """Call make(job) for the jobs of an exposure, one after the other.

    rule: one of RULES, whose products `make` writes; resume: use products that an earlier attempt finished. Raises the
    exception of `make` for a single job. For several jobs, all are tried; then InputError is raised if all exceptions
    were InputErrors, else CsstsimError.
    """
    folder = _folder(run, jobs[0].obsid, rule)
    parent = os.getppid()
    failed: dict[int, Exception] = {}
    for job in progress(jobs, "chips"):
        second, files = _second_names(run, rule, job) if resume else (None, [])
        if second is not None and second.is_dir():
            log(finished_earlier("chip", job.chip.id, _link(second, files[0].parent)))
            continue
        start = time.process_time()
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
                _record_failure(run, rule, job, exc)
            continue
        if job is not jobs[-1]:  # the end of the process frees the memory of the last one
            release()
        if second is not None:
            _keep(files, second, time.process_time() - start)
    if failed:
        reasons = "; ".join(f"chip {number}: {_reason(exc)}" for number, exc in failed.items())
        kind = InputError if all(isinstance(exc, InputError) for exc in failed.values()) else CsstsimError
        others = f"{number_of(len(failed), 'chip')} of {len(jobs)} failed, the others are finished"
        raise kind(f"exposure {jobs[0].obsid}: {others}: {reasons}")
    if resume and os.getppid() == parent:
        shutil.rmtree(folder, ignore_errors=True)


def failed_chips(run: OpenCampaign, rule: str, *, start: bool = False) -> set[tuple[str, int]]:
    """Return {(obsid, chip number), ...} that failed in a job of several chips before the workflow's last start.

    start: the workflow starts now, so failures since its last start are included.
    """
    suffixes = (_OLD, _NEW) if start else (_OLD,)
    names = [path.stem.split("_") for suffix in suffixes for path in _failures(run, rule).glob(f"*_*{suffix}")]
    return {(obsid, int(chip)) for obsid, chip in names if chip.isdigit()}


def record_missing_psf(run: OpenCampaign, number: int, exc: Exception) -> None:
    """Record a chip as failed in all science exposures because its PSF set cannot be made: jobs would wait for it."""
    for job in run.jobs:
        if job.chip.id == number and job.pointing.type == "SCIE":
            _record_failure(run, "level0", job, exc)


def start_workflow(run: OpenCampaign) -> None:
    """Make the failures so far those before the start of the workflow."""
    for path in [path for rule in RULES for path in _failures(run, rule).glob(f"*{_NEW}")]:
        path.replace(path.with_suffix(_OLD))


def failed_since_start(run: OpenCampaign) -> bool:
    """Return whether chips have failed in jobs of several chips since the start of the workflow."""
    return any(path for rule in RULES for path in _failures(run, rule).glob(f"*{_NEW}"))


def _failures(run: OpenCampaign, rule: str) -> Path:
    return run.paths.output / "logs" / "apart" / rule


def _record_failure(run: OpenCampaign, rule: str, job: Job, exc: Exception) -> None:
    path = _failures(run, rule) / f"{job.obsid}_{job.chip.id:02d}{_NEW}"
    with atomic_path(path) as temporary:
        Path(temporary).write_text(f"{_reason(exc)}\n")


def _reason(exc: Exception) -> str:
    return str(exc) if isinstance(exc, CsstsimError) else f"{type(exc).__name__}: {exc}"


def _second_names(run: OpenCampaign, rule: str, job: Job) -> tuple[Path, list[Path]]:
    """Return the folder of a job's second names, which is named by a digest of the recipe, and the products."""
    files = [*kinds(run)[rule].files_of(job), *also_written(run, job, rule)]
    recipe = run.recipe(job, STAGES[rule].recipe)
    return _folder(run, job.obsid, rule) / digest([job.key, recipe]), files


def remove_second_names(run: OpenCampaign) -> None:
    """Remove the second names of products after a campaign has finished."""
    for rule in RULES:
        for folder in _folder(run, "", rule).parent.glob(f"*_{rule}"):
            shutil.rmtree(folder, ignore_errors=True)


def _folder(run: OpenCampaign, obsid: str, rule: str) -> Path:
    return run.paths.output / "chips" / f"{obsid}_{rule}"


def _keep(files: Iterable[Path], folder: Path, cpu: float) -> None:
    """Give files a second name in a folder, which exists only when it is complete. cpu: their CPU time [s]."""
    incomplete = folder.with_name(f"{folder.name}.part")
    shutil.rmtree(incomplete, ignore_errors=True)
    incomplete.mkdir(parents=True)
    try:
        for path in filter(Path.exists, files):
            os.link(path, incomplete / path.name)
        (incomplete / CPU).write_text(f"{cpu:.1f}")
        incomplete.rename(folder)
    except OSError:  # a file system without hard links
        shutil.rmtree(incomplete, ignore_errors=True)


def _link(second: Path, folder: Path) -> float:
    """Link the files of a folder of second names into a folder, newer than their inputs, as Snakemake expects.

    Return their CPU time [s].
    """
    folder.mkdir(parents=True, exist_ok=True)
    for path in second.iterdir():
        if path.name != CPU:
            (folder / path.name).unlink(missing_ok=True)
            os.utime(path)
            os.link(path, folder / path.name)
    return float((second / CPU).read_text())
