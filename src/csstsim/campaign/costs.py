"""Expected cost of each job of a campaign: CPU time [s] and memory [MB], from config/costs.yaml.

A cost is a sum of terms, each a coefficient times a quantity of the job. The file lists the terms and their sources.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Annotated, Literal, NamedTuple

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

    JobKey: TypeAlias = tuple[str, int] | int | str | None  # which of these depends on the rule: see `expected`
    Costs: TypeAlias = dict[str, dict[Any, "Cost"]]  # {rule: {JobKey: Cost}}

FILE = SHIPPED / "costs.yaml"
MACHINE = "one core of an AMD EPYC"  # that the numbers of the file were measured on
# {rule of `--config chips=exposure`: the stage that it runs for each chip}
EXPOSURES = {stage.exposure_rule: stage.name for stage in STAGES.values() if stage.exposure_rule}
# Rules of `--config chips=whole` and `chips=exposure`, which replace rules of the default workflow
ALTERNATIVES = (*(stage.name for stage in STAGES.values() if stage.instead_of), *EXPOSURES)
WAVELENGTHS = 4  # of a PSF set
PICTURES = 30  # maximum number of frames in the report's focal plane, if one exposure does not have more

Quantity = Literal[
    "job", "mpix", "kobject", "preview", "standard", "noise_free", "reference", "image", "frame", "read_mpix", "brick"
]
Terms = dict[Quantity, Annotated[float, Field(ge=0)]]


class CostTerms(Model):
    """The coefficients {quantity: number} of the CPU time [s] and the memory [MB] of a rule's jobs."""

    cpu_s: Terms = Field(min_length=1)
    memory_mb: Terms = Field(min_length=1)

    def cost(self, quantities: Mapping[Quantity, float]) -> Cost:
        """Return the Cost of a job. quantities: {Quantity: number}; others are 0."""
        sums = (
            sum(number * quantities.get(name, 0.0) for name, number in terms.items())
            for terms in (self.cpu_s, self.memory_mb)
        )
        return Cost(*sums)


@dataclass(frozen=True, slots=True)
class Cost:
    """CPU time and memory of one job."""

    cpu_s: float  # user and system, with the start of the process
    memory_mb: float  # maximum


@cache
def load_costs(file: PathLike = FILE) -> dict[str, CostTerms]:
    """Return {entry: CostTerms} of config/costs.yaml: those in the stage records, and `shared`. Raises InputError."""
    entries = validate(dict[str, CostTerms], read_data(file), file)
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

    Keys are (obsid, chip) of jobs, bricks, chips (psf, masters), exposures, or None (report). The rules in ALTERNATIVES
    are listed in addition to the rules that they replace. Objects of a user's catalogue are not counted. The cost of a
    truth brick or PSF set that another campaign has made (`share`) is that of linking it. The products of a variant's
    base are left out.
    """
    terms = load_costs()
    expected_costs: Costs = {stage.name: {} for stage in STAGES.values()}
    for stage, entry, key, quantities in _job_quantities(run):
        if not made_by_base(run, stage.name, key):
            expected_costs[stage.name][key] = terms[entry].cost(quantities)
    for rule, path_of in (("truth", run.paths.truth), ("psf", run.paths.psf)):
        shared = [key for key in expected_costs[rule] if _is_shared(run, path_of(key))]
        expected_costs[rule] |= dict.fromkeys(shared, terms["shared"].cost({"job": 1}))
    for rule, chip_rule in EXPOSURES.items():
        expected_costs[rule] = _exposures(expected_costs[chip_rule], terms[chip_rule].cpu_s.get("job", 0.0))
    return {rule: costs for rule, costs in expected_costs.items() if costs}


def _is_shared(run: OpenCampaign, path: Path) -> bool:
    """Return whether another campaign has made a product, so that it is only linked."""
    shared = run.in_share(path)
    return shared is not None and shared.exists() and (not path.exists() or shared.stat().st_nlink > 2)


def _exposures(chips: Mapping[tuple[str, int], Cost], start: float) -> dict[str, Cost]:
    """Return {obsid: Cost} of exposures, one process each, from {(obsid, chip): Cost}.

    start: CPU time of the start of a process [s], contained in the cost of each chip.
    """
    by_exposure: dict[str, list[Cost]] = {}
    for (obsid, _), cost in chips.items():
        by_exposure.setdefault(obsid, []).append(cost)
    return {
        obsid: Cost(sum(cost.cpu_s - start for cost in costs) + start, max(cost.memory_mb for cost in costs))
        for obsid, costs in by_exposure.items()
    }


def default_workflow(costs: Costs) -> Costs:
    """Return {rule: {key: Cost}} of the default workflow: each job once, without ALTERNATIVES."""
    return {rule: jobs for rule, jobs in costs.items() if rule not in ALTERNATIVES}


class _JobQuantities(NamedTuple):
    stage: Stage
    entry: str  # of costs.yaml
    key: JobKey
    quantities: dict[Quantity, float]


def _job_quantities(run: OpenCampaign) -> Iterator[_JobQuantities]:
    """Yield the _JobQuantities of each job."""
    quantities = _Quantities(run)
    for stage in [stage for stage in STAGES.values() if stage.costs]:
        for unit in getattr(run, stage.made_for):
            if stage.unit != "job":
                yield _JobQuantities(stage, stage.costs[0], unit, quantities.of(stage, unit))
            elif not stage.layered or run.has_stage(unit.pointing, stage.name):
                entry = stage.costs[-1 if run.has_orders(unit) else 0]
                yield _JobQuantities(stage, entry, unit.key, quantities.of(stage, unit))


class _Quantities:
    """The quantities from which the costs of a campaign's jobs are computed."""

    def __init__(self, run: OpenCampaign) -> None:
        self._run = run
        self._objects = expected_objects(run, run.imaging_jobs + run.slitless_jobs)  # {job.key: number}
        self._bricks_of = Counter(job.key for jobs in run.merge_bricks.values() for job in jobs)

    def of(self, stage: Stage, unit: Any) -> dict[Quantity, float]:
        """Return {Quantity: number} of a stage for a unit: a job, exposure, chip or brick, or None for the campaign."""
        run = self._run
        if stage.unit == "job":
            return self._of_job(unit)
        if stage.made_for == "merge_bricks":
            return self._of_brick(run.merge_bricks[unit])
        if stage.unit == "exposure":
            return {"job": 1, "frame": len(run.science_exposures[unit])}
        if stage.made_for == "sky_chips":
            return {"job": 1, "image": run.config.psf.grid**2 * WAVELENGTHS}
        if stage.made_for == "calibration_jobs":
            jobs = run.calibration_jobs[unit]
            return {"job": 1, "mpix": megapixels(jobs[0]), "read_mpix": len(jobs) * megapixels(jobs[0])}
        return self._of_report() if stage.unit == "campaign" else {"job": 1}

    def _of_job(self, job: Job) -> dict[Quantity, float]:
        thousands = self._objects.get(job.key, 0.0) / 1000.0
        return {"job": 1, "mpix": megapixels(job), "kobject": thousands, self._run.config.fidelity: thousands}

    def _of_brick(self, jobs: Sequence[Job]) -> dict[Quantity, float]:
        """Return those of a brick. A frame's pixels are divided equally among the bricks it touches."""
        pixels = [megapixels(job) for job in jobs]
        on_brick = sum(size / self._bricks_of[job.key] for size, job in zip(pixels, jobs, strict=True))
        return {"job": 1, "frame": len(jobs), "read_mpix": sum(pixels), "mpix": on_brick}

    def _of_report(self) -> dict[Quantity, float]:
        run = self._run
        by_exposure = Counter(job.obsid for job in run.imaging_jobs + run.slitless_jobs)
        shown = min(len(run.jobs), max([PICTURES, *by_exposure.values()]))
        read = shown / len(run.jobs) * sum(map(megapixels, run.jobs))
        return {"job": 1, "read_mpix": read, "brick": len(run.merge_bricks)}


def megapixels(job: Job) -> float:
    """Return the number of pixels of a job's window, in millions."""
    return job.window.nx * job.window.ny / 1e6


def expected_objects(run: OpenCampaign, jobs: Sequence[Job]) -> dict[tuple[str, int], float]:
    """Return {job.key: expected number of galaxies and stars on its window}, by i and V counts to the campaign's limit.

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
