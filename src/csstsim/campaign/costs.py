"""Expected cost of each job of a campaign: CPU seconds and memory, by config/costs.yaml.

A cost is a sum of terms, each a number times a quantity of the job. The file lists the terms and what measured them.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from pydantic import Field

from csstsim.base.errors import InputError
from csstsim.base.model import Model, validate
from csstsim.base.shipped import SHIPPED
from csstsim.base.stage_records import STAGES
from csstsim.campaign.variants import made_by_base
from csstsim.instrument.load import read_data

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path
    from typing import Any, TypeAlias

    from csstsim.base.stage_records import Stage
    from csstsim.base.types import PathLike
    from csstsim.campaign.job import Job
    from csstsim.campaign.opened import OpenCampaign

    Key: TypeAlias = tuple[str, int] | int | str | None  # of a job: `expected` says which rule has which
    Costs: TypeAlias = dict[str, dict[Any, "Cost"]]  # {rule: {Key: Cost}}

FILE = SHIPPED / "costs.yaml"
# Rules of `--config chips=exposure`, each with the stage that it runs chip by chip
EXPOSURES = {stage.exposure_rule: stage.name for stage in STAGES.values() if stage.exposure_rule}
# and these with what `--config chips=whole` runs, in place of what is run by default
INSTEAD = (*(stage.name for stage in STAGES.values() if stage.instead_of), *EXPOSURES)
WAVELENGTHS = 4  # of a PSF set
PICTURES = 30  # frames in the report's focal plane, but always a whole exposure

Quantity = Literal[
    "job", "mpix", "kobject", "preview", "standard", "noise_free", "reference", "image", "frame", "read_mpix", "brick"
]
Terms = dict[Quantity, Annotated[float, Field(ge=0)]]


class Numbers(Model):
    """The terms of the CPU time and the memory of a rule's jobs."""

    cpu_s: Terms = Field(min_length=1)
    memory_mb: Terms = Field(min_length=1)

    def cost(self, quantities: Mapping[Quantity, float]) -> Cost:
        """Return the Cost of a job. quantities: {Quantity: number}; what is not there is 0."""
        sums = (
            sum(number * quantities.get(name, 0.0) for name, number in terms.items())
            for terms in (self.cpu_s, self.memory_mb)
        )
        return Cost(*sums)


@dataclass(frozen=True, slots=True)
class Cost:
    """CPU time and memory of one job."""

    cpu_s: float  # user and system, start of the process included
    memory_mb: float  # most at a time


@cache
def load_costs(file: PathLike = FILE) -> dict[str, Numbers]:
    """Return {entry: Numbers} of config/costs.yaml: those that the stages name, and `shared`. Raises InputError."""
    entries = validate(dict[str, Numbers], read_data(file), file)
    known = ("shared", *(entry for stage in STAGES.values() for entry in stage.costs))
    for name in known:
        if name not in entries:
            raise InputError("missing", file=file, key=name)
    for name in entries:
        if name not in known:
            raise InputError("unknown", file=file, key=name, allowed=", ".join(known))
    return entries


def expected(run: OpenCampaign) -> Costs:
    """Return {rule: {key: Cost}} of the jobs of a campaign, in the order of the workflow. run: an OpenCampaign.

    Keys are (obsid, chip) of jobs, bricks, chips (psf, masters), exposures, or None (report). The INSTEAD rules are
    listed as well as those that they would replace. Objects of a user's catalogue are not counted. A truth brick or PSF
    set that another campaign has made (`share`) costs what linking it does. What a variant's base makes is left out.
    """
    numbers = load_costs()
    found: Costs = {stage.name: {} for stage in STAGES.values()}
    for stage, entry, key, quantities in _quantities(run):
        if not made_by_base(run, stage.name, key):
            found[stage.name][key] = numbers[entry].cost(quantities)
    for rule, path_of in (("truth", run.paths.truth), ("psf", run.paths.psf)):
        shared = [key for key in found[rule] if _is_shared(run, path_of(key))]
        found[rule] |= dict.fromkeys(shared, numbers["shared"].cost({"job": 1}))
    for rule, of_chips in EXPOSURES.items():
        found[rule] = _exposures(found[of_chips], numbers[of_chips].cpu_s.get("job", 0.0))
    return {rule: costs for rule, costs in found.items() if costs}


def _is_shared(run: OpenCampaign, path: Path) -> bool:
    """Whether a product is only to be linked, or was: another campaign has made it, or has it, too."""
    common = run.in_share(path)
    return common is not None and common.exists() and (not path.exists() or common.stat().st_nlink > 2)


def _exposures(chips: Mapping[tuple[str, int], Cost], start: float) -> dict[str, Cost]:
    """Return {obsid: Cost} of exposures, a process each, from {(obsid, chip): Cost}; `start`: CPU s of starting one."""
    found: dict[str, list[Cost]] = {}
    for (obsid, _), cost in chips.items():
        found.setdefault(obsid, []).append(cost)
    return {
        obsid: Cost(sum(cost.cpu_s - start for cost in costs) + start, max(cost.memory_mb for cost in costs))
        for obsid, costs in found.items()
    }


def each_once(costs: Costs) -> Costs:
    """Return {rule: {key: Cost}} of the workflow as it is by default: each job once, without INSTEAD."""
    return {rule: jobs for rule, jobs in costs.items() if rule not in INSTEAD}


def _quantities(run: OpenCampaign) -> Iterator[tuple[Stage, str, Key, dict[Quantity, float]]]:
    """Yield (stage, its entry in the file, key, {Quantity: number}) of each job."""
    quantities = _Quantities(run)
    for stage in [stage for stage in STAGES.values() if stage.costs]:
        for one in getattr(run, stage.made_for):
            if stage.unit != "job":
                yield stage, stage.costs[0], one, quantities.of(stage, one)
            elif not stage.layered or run.has_stage(one.pointing, stage.name):
                yield stage, stage.costs[-1 if run.has_orders(one) else 0], one.key, quantities.of(stage, one)


class _Quantities:
    """The quantities that the costs of a campaign's jobs are sums of."""

    def __init__(self, run: OpenCampaign) -> None:
        self._run = run
        self._objects = expected_objects(run, run.imaging_jobs + run.slitless_jobs)  # {job.key: how many}
        self._bricks_of = Counter(job.key for jobs in run.merge_bricks.values() for job in jobs)

    def of(self, stage: Stage, one: Any) -> dict[Quantity, float]:
        """Return {Quantity: number} of a stage for a job, chip or brick, or for the campaign."""
        run = self._run
        if stage.unit == "job":
            return self._of_job(one)
        if stage.made_for == "merge_bricks":
            return self._of_brick(run.merge_bricks[one])
        if stage.made_for == "sky_chips":
            return {"job": 1, "image": run.config.psf.grid**2 * WAVELENGTHS}
        if stage.made_for == "calibration_jobs":
            jobs = run.calibration_jobs[one]
            return {"job": 1, "mpix": megapixels(jobs[0]), "read_mpix": len(jobs) * megapixels(jobs[0])}
        return self._of_report() if stage.unit == "campaign" else {"job": 1}

    def _of_job(self, job: Job) -> dict[Quantity, float]:
        thousands = self._objects.get(job.key, 0.0) / 1000.0
        return {"job": 1, "mpix": megapixels(job), "kobject": thousands, self._run.config.fidelity: thousands}

    def _of_brick(self, jobs: Sequence[Job]) -> dict[Quantity, float]:
        """Return those of a brick. A frame's pixels are shared out among the bricks it touches."""
        pixels = [megapixels(job) for job in jobs]
        on_it = sum(size / self._bricks_of[job.key] for size, job in zip(pixels, jobs, strict=True))
        return {"job": 1, "frame": len(jobs), "read_mpix": sum(pixels), "mpix": on_it}

    def _of_report(self) -> dict[Quantity, float]:
        run = self._run
        by_exposure = Counter(job.obsid for job in run.imaging_jobs + run.slitless_jobs)
        shown = min(len(run.jobs), max([PICTURES, *by_exposure.values()]))
        read = shown / len(run.jobs) * sum(map(megapixels, run.jobs))
        return {"job": 1, "read_mpix": read, "brick": len(run.merge_bricks)}


def megapixels(job: Job) -> float:
    """Return the pixels of a job's window, in millions."""
    return job.window.nx * job.window.ny / 1e6


def expected_objects(run: OpenCampaign, jobs: Sequence[Job]) -> dict[tuple[str, int], float]:
    """Return {job.key: galaxies and stars expected on its window}: i and V counts down to the campaign's limit.

    Empty for a user's catalogue.
    """
    if not (jobs and run.embedded):
        return {}
    from csstsim.universe.galaxies.galaxies import cumulative_counts
    from csstsim.universe.stars.stars import expected_counts

    numbers = run.universe.numbers
    limit = run.config.catalog.mag_limit
    mag, galaxies = cumulative_counts(numbers["galaxies"])
    total = galaxies[-1] if limit is None else np.interp(limit, mag, galaxies)
    faint = numbers["stars"]["limits"][1]
    pointings = {job.obsid: (job.pointing.ra, job.pointing.dec) for job in jobs}
    ra, dec = np.transpose(list(pointings.values()))
    with run.universe.faults_of("stars"):
        stars = expected_counts(ra, dec, numbers["stars"], min(limit or faint, faint))
    density = {obsid: float(total + count) for obsid, count in zip(pointings, stars, strict=True)}  # deg-2
    pixel = (run.camera.telescope.pixel_scale / 3600.0) ** 2
    return {job.key: megapixels(job) * 1e6 * pixel * density[job.obsid] for job in jobs}
