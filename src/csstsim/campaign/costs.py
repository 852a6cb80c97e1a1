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

from csstsim.base.model import Model, validate
from csstsim.base.shipped import SHIPPED
from csstsim.campaign.variants import made_by_base
from csstsim.instrument.load import read_data

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path
    from typing import Any, TypeAlias

    from csstsim.base.types import PathLike
    from csstsim.campaign.job import Job
    from csstsim.campaign.opened import OpenCampaign

    Key: TypeAlias = tuple[str, int] | int | str | None  # of a job: `expected` says which rule has which
    Costs: TypeAlias = dict[str, dict[Any, "Cost"]]  # {rule: {Key: Cost}}

FILE = SHIPPED / "costs.yaml"
STAGES = ("select", "render", "readout", "level0")  # of a chip, one process each
# Rules of `--config chips=whole` and `chips=exposure`, in place of the four stages and of what follows chip by chip
EXPOSURES = {"exposure": "chip", "measure_exposure": "measure", "extract_exposure": "extract"}
INSTEAD = ("chip", *EXPOSURES)
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


class Rules(Model):
    """The whole file: the rules of the workflow; NAME_spectra is the rule NAME for spectroscopic chips."""

    truth: Numbers
    psf: Numbers
    shared: Numbers
    select: Numbers
    select_spectra: Numbers
    render: Numbers
    render_spectra: Numbers
    readout: Numbers
    level0: Numbers
    level0_spectra: Numbers
    chip: Numbers
    chip_spectra: Numbers
    calibrate: Numbers
    measure: Numbers
    extract: Numbers
    merge: Numbers
    validate_: Numbers = Field(alias="validate")
    masters: Numbers
    report: Numbers


@dataclass(frozen=True, slots=True)
class Cost:
    """CPU time and memory of one job."""

    cpu_s: float  # user and system, start of the process included
    memory_mb: float  # most at a time


@cache
def load_costs(file: PathLike = FILE) -> dict[str, Numbers]:
    """Return {rule: Numbers} of config/costs.yaml. Raises InputError."""
    rules = validate(Rules, read_data(file), file)
    return {field.alias or name: getattr(rules, name) for name, field in Rules.model_fields.items()}


def expected(run: OpenCampaign) -> Costs:
    """Return {rule: {key: Cost}} of the jobs of a campaign, in the order of the workflow. run: an OpenCampaign.

    Keys are (obsid, chip) of jobs, bricks, chips (psf, masters), exposures, or None (report). The INSTEAD rules are
    listed as well as those that they would replace. Objects of a user's catalogue are not counted. A truth brick or PSF
    set that another campaign has made (`share`) costs what linking it does. What a variant's base makes is left out.
    """
    numbers = load_costs()
    found: Costs = {rule: {} for rule in numbers if not rule.endswith("_spectra")}
    for rule, key, quantities in _quantities(run):
        if made_by_base(run, rule.removesuffix("_spectra"), key):
            continue
        found[rule.removesuffix("_spectra")][key] = numbers[rule].cost(quantities)
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


def _quantities(run: OpenCampaign) -> Iterator[tuple[str, Key, dict[Quantity, float]]]:
    """Yield (rule or NAME_spectra, key, {Quantity: number}) of each job."""
    science = run.imaging_jobs + run.slitless_jobs
    for pix in run.sky_bricks:
        yield "truth", pix, {"job": 1}
    for chip in run.sky_chips:
        yield "psf", chip, {"job": 1, "image": run.config.psf.grid**2 * WAVELENGTHS}
    yield from _of_chips(run, expected_objects(run, science))
    yield from _of_bricks(run)
    for chip, jobs in run.calibration_jobs.items():
        pixels = megapixels(jobs[0])
        yield "masters", chip, {"job": 1, "mpix": pixels, "read_mpix": len(jobs) * pixels}
    if science:
        by_exposure = Counter(job.obsid for job in science)
        shown = min(len(run.jobs), max(PICTURES, *by_exposure.values()))
        read = shown / len(run.jobs) * sum(map(megapixels, run.jobs))
        yield "report", None, {"job": 1, "read_mpix": read, "brick": len(run.merge_bricks)}


def _of_chips(
    run: OpenCampaign, objects: Mapping[tuple[str, int], float]
) -> Iterator[tuple[str, Key, dict[Quantity, float]]]:
    """Yield the rules of each (exposure, chip). objects: {job.key: how many}."""
    for job in run.jobs:
        thousands = objects.get(job.key, 0.0) / 1000.0
        quantities: dict[Quantity, float] = {
            "job": 1,
            "mpix": megapixels(job),
            "kobject": thousands,
            run.config.fidelity: thousands,
        }
        spectra = run.has_orders(job)
        science = job.pointing.type == "SCIE"
        suffix = "_spectra" if spectra else ""
        if science:
            yield f"select{suffix}", job.key, quantities
        for stage in STAGES[1:]:
            if run.has_stage(job.pointing, stage):
                yield stage if stage == "readout" else f"{stage}{suffix}", job.key, quantities
        yield f"chip{suffix}", job.key, quantities
        if spectra:
            yield "extract", job.key, quantities
    for job in run.imaging_jobs:
        if run.config.measurement.keep_calibrated:
            yield "calibrate", job.key, {"job": 1, "mpix": megapixels(job)}
        yield "measure", job.key, {"job": 1, "mpix": megapixels(job)}


def _of_bricks(run: OpenCampaign) -> Iterator[tuple[str, Key, dict[Quantity, float]]]:
    """Yield the rules of each brick. A frame's pixels are shared out among the bricks it touches."""
    touched = Counter(job.key for jobs in run.merge_bricks.values() for job in jobs)
    for pix, jobs in run.merge_bricks.items():
        pixels = [megapixels(job) for job in jobs]
        on_it = sum(size / touched[job.key] for size, job in zip(pixels, jobs, strict=True))
        quantities: dict[Quantity, float] = {"job": 1, "frame": len(jobs), "read_mpix": sum(pixels), "mpix": on_it}
        yield "merge", pix, quantities
        yield "validate", pix, quantities


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
