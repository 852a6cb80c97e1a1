"""A process that makes several products goes on where an earlier one was stopped.

Snakemake removes all files of a job that failed before it runs it again. So what is finished has a second name (a hard
link) in chips/ until all of the job's products are. The next attempt takes it from there if it has the same recipe. On
a file system without hard links, the next attempt makes everything again.
"""

import os
import shutil
from pathlib import Path

from csstsim.base.digest import digest
from csstsim.base.process.progress import progress
from csstsim.campaign.job_log import part_log
from csstsim.campaign.products import kinds


def one_by_one(run, rule, jobs, make, say=print):
    """Call make(job) for the jobs of an exposure, one after the other, but for those that are finished.

    rule: level0, measure or extract, whose products `make` writes.
    """
    kind, stage = kinds(run)[rule], rule if rule == "level0" else "measure"
    folder = run.paths.output / "chips" / f"{jobs[0].obsid}_{rule}"
    for job in progress(jobs, "chips"):
        kept, files = folder / digest([job.key, run.recipe(job, stage)]), kind.files_of(job)
        if rule == "level0":
            files.append(run.paths.level0_cosmic(job))  # which a layer may save
        with job.named():
            if kept.is_dir():
                _link(kept, files[0].parent)
                say(f"chip {job.chip.id} is finished")
                continue
            with part_log("chip", job.chip.id):
                make(job)
            if len(jobs) > 1:
                _keep(files, kept)
    shutil.rmtree(folder, ignore_errors=True)


def _keep(files, folder):
    """Give files a second name in a folder, which is there once all have."""
    part = folder.with_name(f"{folder.name}.part")
    shutil.rmtree(part, ignore_errors=True)
    part.mkdir(parents=True)
    try:
        for path in filter(Path.exists, files):
            os.link(path, part / path.name)
        part.rename(folder)
    except OSError:  # no hard links here
        shutil.rmtree(part, ignore_errors=True)


def _link(kept, folder):
    """Give kept files their names in a folder again. They are newer than their inputs, as Snakemake expects."""
    folder.mkdir(parents=True, exist_ok=True)
    for path in kept.iterdir():
        (folder / path.name).unlink(missing_ok=True)
        os.utime(path)
        os.link(path, folder / path.name)
