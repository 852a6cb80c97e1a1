"""The input files of the jobs of the workflow, and the recipes that determine them.

The rules (workflow/rules) state what a job runs, what it writes and what it may use. Its inputs depend on the campaign:
the rules get them from here. Snakemake calls an `Input` with the wildcards of a job: obsid and chip, or pix of a brick.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, Protocol, TypeVar, cast

from csstsim.base.stage_records import STAGES
from csstsim.campaign.job import Job
from csstsim.campaign.opened import OpenCampaign
from csstsim.campaign.products import kinds
from csstsim.campaign.running.one_by_one import failed_chips
from csstsim.io.level0_names import FORMS
from csstsim.optics.psf.sampling import psf_cube
from csstsim.stages.parts.rerendered import may_rerender


class Wildcards(Protocol):
    """Wildcards of the file names of a job, as text; a job has those that its rule names."""

    obsid: str
    chip: str  # two digits
    pix: str


ItemT = TypeVar("ItemT")
Recipe = dict[str, Any]
Input = Callable[[Wildcards], list[str]]
Outputs = tuple[tuple[str, tuple[str, ...]], ...]  # of each chip of an exposure, the patterns of its files


@dataclass(frozen=True)
class Group:
    """Exposures that one rule makes, each of them in one process.

    chips_of: {obsid: chips}; files: (chip, patterns of its files) of each chip, the same for all of these exposures;
    log: suffix of the names of their logs.
    """

    number: int
    chips_of: Mapping[str, list[str]]
    files: Outputs
    obsids: list[str]
    log: str

    @property
    def outputs(self) -> list[str]:
        """The patterns of the files of all chips."""
        return [pattern for _, patterns in self.files for pattern in patterns]

    @property
    def options(self) -> str:
        """The options that name the chips on the command line."""
        return " ".join(f"--chip {int(chip)}" for chip, _ in self.files)


class RuleFiles:
    """The input files of the jobs of a campaign.

    ancient: Snakemake's mark of a file whose date is ignored; main: whether this is the process that plans the jobs.
    """

    def __init__(self, run: OpenCampaign, ancient: Callable[[str], str], *, main: bool) -> None:
        self.run = run
        self.kinds = kinds(run)
        self.jobs = {(job.obsid, f"{job.chip.id:02d}"): job for job in run.jobs}
        self._ancient = ancient
        self._main = main
        self._stem = f"{{name}}_{{obsid}}_{{chip}}_{FORMS[run.config.level0_names].ending}"
        self._source = "embedded" if run.embedded else "own"

    def made(self, rule: str, items: Iterable[Any] | None = None) -> list[str]:
        """Return the files that a rule makes for some jobs, chips or bricks, or for all."""
        return self.kinds[rule].files(items)

    def job(self, wildcards: Wildcards) -> Job:
        """Return the job of an exposure and a chip."""
        return self.jobs[wildcards.obsid, wildcards.chip]

    def recipe(self, stage: str) -> Callable[[Wildcards], Recipe]:
        """Return the recipe of the product of a stage: the stage reruns if it changes, and only then."""
        return lambda wildcards: self.run.recipe(self.job(wildcards), STAGES[stage].recipe)

    def exposure_recipe(self, stage: str) -> Callable[[Wildcards], str]:
        """Return the recipe of a stage's product of an exposure: the stage reruns if it changes, and only then."""
        return lambda wildcards: self.run.exposure_recipe(wildcards.obsid, STAGES[stage].recipe)

    def outputs(self, stage: str, *, orders: bool = False) -> list[str]:
        """Return the patterns of the files that a stage writes; orders: for jobs with a truth table of orders."""
        text = "cat" in self.run.config.truth
        wanted = {"": True, "cat": text, "orders": orders, "joint": self.run.config.measurement.joint}
        patterns = [self.run.paths.pattern(product.name) for product in STAGES[stage].products if wanted[product.only]]
        return [pattern.replace("{stem}", self._stem) for pattern in patterns]

    def minutes(self, stage: str) -> int:
        """Return the minutes that a job of a stage may take in this campaign."""
        record = STAGES[stage]
        found = [record.minutes_in[key] for key in (self.run.config.fidelity, self._source) if key in record.minutes_in]
        return max(found, default=record.minutes)

    # Inputs of the stages of a chip

    def truth(self, wildcards: Wildcards) -> list[str]:
        """Return the truth bricks whose objects may reach a chip's window, for exposures that see the sky."""
        if not self.run.embedded or not self._sees_the_sky(wildcards):
            return []
        return self._shared(self.made("truth", self.run.truth_bricks(self.job(wildcards))))

    def library(self, wildcards: Wildcards) -> list[str]:
        """Return the file of a chip in a library of PSFs, where the campaign takes its sets from one."""
        library = self.run.psf_library
        return [str(psf_cube(library, int(wildcards.chip)))] if library else []

    def psf(self, wildcards: Wildcards) -> list[str]:
        """Return the PSF set of a chip and its tables, for exposures that see the sky."""
        return self._shared(self.made("psf", [int(wildcards.chip)])) if self._sees_the_sky(wildcards) else []

    def objects(self, wildcards: Wildcards) -> list[str]:
        """Return the selected objects, the PSF, and the light of the base that a variant may use."""
        psf = self.psf(wildcards)
        return psf and [self._handed_on(wildcards, "select.parquet"), *psf, *self._light_of_base(wildcards)]

    def stage_before(self, stage: str) -> Input:
        """Return the input of the stage after a stage: the image of that stage, if it has layers."""

        def product(wildcards: Wildcards) -> list[str]:
            has = self.run.has_stage(self.run.pointings[wildcards.obsid], stage)
            return [self._handed_on(wildcards, f"{stage}.fits")] if has else []

        return product

    def rendered(self, wildcards: Wildcards) -> list[str]:
        """Return the table of rendered objects, and that of their orders, where there is a render stage."""
        if not self.run.has_stage(self.run.pointings[wildcards.obsid], "render"):
            return []
        spectra = self.run.has_orders(self.job(wildcards))
        names = ("drawn.parquet", "orders.parquet") if spectra else ("drawn.parquet",)
        return [self._handed_on(wildcards, name) for name in names]

    def of_job(self, rule: str) -> Input:
        """Return the input of a chip in an exposure: the products of a rule of the same chip and exposure."""
        return lambda wildcards: self.made(rule, [self.job(wildcards)])

    def level0(self, wildcards: Wildcards) -> list[str]:
        """Return a Level-0 file."""
        return self.of_job("level0")(wildcards)[:1]

    def measured_with(self, wildcards: Wildcards) -> list[str]:
        """Return the inputs of the measurement of a Level-0 file in addition to it: the PSF set, master frames."""
        chip = int(wildcards.chip)
        masters = [str(self.run.masters(chip))] if self.run.config.measurement.calibration == "frames" else []
        return [*self._shared(self.made("psf", [chip])[:1]), *masters]

    def joint_with(self, wildcards: Wildcards) -> list[str]:
        """Return the inputs of a merged brick in addition to the measurements: with `joint`, the PSF sets."""
        if not self.run.config.measurement.joint:
            return []
        chips = sorted({job.chip.id for job in self.run.merge_bricks[int(wildcards.pix)]})
        return self._shared([path for chip in chips for path in self.made("psf", [chip])[:1]])

    def unless_equal(self, rule: str, *inputs: Input) -> Input:
        """Return the input of a rule: `inputs`, or the base's products of the rule, if a variant's are equal."""
        stage = STAGES[rule].recipe

        def files(wildcards: Wildcards) -> list[str]:
            job = self.job(wildcards)
            if self.run.in_base(*job.key, stage):
                return self._made_by_base(rule, job)
            return [file for one in inputs for file in one(wildcards)]

        return files

    # Inputs of masters, bricks and exposures

    def calibration_frames(self, wildcards: Wildcards) -> list[str]:
        """Return the bias, dark and lamp exposures of a chip."""
        return self.made("level0", self.run.calibration_jobs[int(wildcards.chip)])

    def on_brick(self, rule: str) -> Input:
        """Return the input of a brick: the products of a rule, of the frames on the brick."""
        return lambda wildcards: self.made(rule, self.run.merge_bricks[int(wildcards.pix)])

    def on_exposure(self, rule: str) -> Input:
        """Return the input of an exposure: the products of a rule, of those of its chips that have one."""
        keys = {job.key for job in getattr(self.run, STAGES[rule].made_for)}
        chips = self.run.science_exposures
        return lambda wildcards: self.made(rule, [job for job in chips[wildcards.obsid] if job.key in keys])

    def merged(self, wildcards: Wildcards) -> list[str]:
        """Return the merged catalogue of a brick."""
        return self.made("merge", [int(wildcards.pix)])

    # Exposures whose chips one process makes

    def groups(self, jobs: Iterable[Job], rule: str) -> Iterator[Group]:
        """Yield the Groups of jobs of a rule.

        Exposures are in one group if their files have the same patterns. A chip that failed is a group of its own.
        """
        failed = failed_chips(self.run, rule, start=self._main)
        jobs = list(jobs)
        single = [job for job in jobs if job.key in failed]
        number = 0
        for k, group_jobs in enumerate([[job for job in jobs if job.key not in failed], *([job] for job in single)]):
            chips_of = by_exposure(group_jobs)
            by_files: dict[Outputs, list[str]] = {}
            for obsid, chips in chips_of.items():
                files = tuple((chip, self._outputs_of(rule, obsid, chip)) for chip in chips)
                by_files.setdefault(files, []).append(obsid)
            for files, obsids in by_files.items():
                yield Group(number, chips_of, files, obsids, f"_{files[0][0]}" if k else "")
                number += 1

    def _outputs_of(self, rule: str, obsid: str, chip: str) -> tuple[str, ...]:
        patterns = self.outputs(rule, orders=self.run.has_orders(self.jobs[obsid, chip]))
        return tuple(pattern.replace("{chip}", chip) for pattern in patterns)

    def recipes(self, stage: str, group: Group) -> Callable[[Wildcards], list[Recipe]]:
        """Return the recipes of the products of a stage for the chips of an exposure."""
        return of_exposure(lambda wildcards: [self.recipe(stage)(wildcards)], group)

    def _sees_the_sky(self, wildcards: Wildcards) -> bool:
        return self.run.pointings[wildcards.obsid].type == "SCIE"

    def _shared(self, files: Sequence[str]) -> list[str]:
        """Return the files, as ancient ones if campaigns share them: the newest link sets their date."""
        return [self._ancient(file) for file in files] if self.run.config.share else list(files)

    def _handed_on(self, wildcards: Wildcards, name: str) -> str:
        """Return a file that one stage of a chip writes for the next."""
        return str(self.run.paths.stage(wildcards.obsid, int(wildcards.chip), name))

    def _light_of_base(self, wildcards: Wildcards) -> list[str]:
        """Return the stored light of the base, if a variant may differ from it in objects only."""
        job = self.job(wildcards)
        base = self.run.base
        stored = base is not None and base.config.keep == "light" and may_rerender(self.run, job)
        return self._made_by_base("render", job) if stored else []

    def _made_by_base(self, rule: str, job: Job) -> list[str]:
        assert self.run.base is not None
        return kinds(self.run.base)[rule].files([job])


def by_exposure(jobs: Iterable[Job]) -> dict[str, list[str]]:
    """Return {obsid: [chip, ...]} of jobs."""
    found: dict[str, list[str]] = {}
    for job in jobs:
        found.setdefault(job.obsid, []).append(f"{job.chip.id:02d}")
    return found


def of_exposure(one: Callable[[Wildcards], list[ItemT]], group: Group) -> Callable[[Wildcards], list[ItemT]]:
    """Return a function of an exposure: the list of what `one` returns for each of its chips, without repetition."""

    def gathered(wildcards: Wildcards) -> list[ItemT]:
        found: list[ItemT] = []
        for chip in group.chips_of[wildcards.obsid]:
            chip_wildcards = cast("Wildcards", SimpleNamespace(obsid=wildcards.obsid, chip=chip))
            found += [item for item in one(chip_wildcards) if item not in found]
        return found

    return gathered
