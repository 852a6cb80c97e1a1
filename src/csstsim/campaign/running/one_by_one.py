"""Several products in one process, which can go on where an earlier one was stopped.

Snakemake removes all files of a job that failed before it runs it again. So what is finished has a second name (a hard
link) in chips/ until all of the job's products are. The next attempt takes it from there if it has the same recipe. On
a file system without hard links, the next attempt makes everything again. A process whose parent was killed keeps the
second names: it is not known to be finished, and will be started again.
"""

import os
import shutil
import time
from pathlib import Path

from csstsim.base.digest import digest
from csstsim.base.process.memory import release
from csstsim.base.process.progress import progress
from csstsim.campaign.products import kinds
from csstsim.campaign.running.job_log import finished_earlier, part_log

RULES = "level0", "measure", "extract"
CPU = "cpu_s"  # a file beside the second names: what they took


def one_by_one(run, rule, jobs, make, resume=False, say=print):
    """Call make(job) for the jobs of an exposure, one after the other.

    rule: one of RULES, whose products `make` writes; resume: but for those that an earlier attempt finished.
    """
    folder, parent = _folder(run, jobs[0].obsid, rule), os.getppid()
    for job in progress(jobs, "chips"):
        with job.named():
            kept, files = _names(run, rule, job) if resume else (None, ())
            if resume and kept.is_dir():
                say(finished_earlier("chip", job.chip.id, _link(kept, files[0].parent)))
                continue
            begun = time.process_time()
            with part_log("chip", job.chip.id):
                make(job)
            if job is not jobs[-1]:  # the end of the process frees the rest
                release()
            if resume:
                _keep(files, kept, time.process_time() - begun)
    if resume and os.getppid() == parent:
        shutil.rmtree(folder, ignore_errors=True)


def _names(run, rule, job):
    """Return the folder of a job's second names, whose name says what decides the products, and the products."""
    files = kinds(run)[rule].files_of(job)
    if rule == "level0":
        files.append(run.paths.level0_cosmic(job))  # which a layer may save
    recipe = run.recipe(job, rule if rule == "level0" else "measure")
    return _folder(run, job.obsid, rule) / digest([job.key, recipe]), files


def forget(run):
    """Remove the second names in a finished campaign."""
    for rule in RULES:
        for folder in _folder(run, "", rule).parent.glob(f"*_{rule}"):
            shutil.rmtree(folder, ignore_errors=True)


def _folder(run, obsid, rule):
    return run.paths.output / "chips" / f"{obsid}_{rule}"


def _keep(files, folder, cpu):
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


def _link(kept, folder):
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
