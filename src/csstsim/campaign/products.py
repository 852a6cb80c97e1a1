"""The products of a campaign, by stage of the workflow, from the records of stages (base.stage_records).

The workflow takes its targets, inputs and last message from here; `csstsim status` and `csstsim verify` take the
expected products. Paths of files are in io.paths, costs of rules in campaign.costs.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from csstsim.base.stage_records import STAGES, Product, Stage
from csstsim.campaign.variants import made_by_base
from csstsim.measure.bricks.hats import ABOUT
from csstsim.measure.bricks.validation.verdict import headline, sentence

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping
    from pathlib import Path
    from typing import Any

    from csstsim.campaign.job import Job
    from csstsim.campaign.opened import OpenCampaign

MAX_GATES = 10  # failing gates in the workflow's last message


@dataclass(frozen=True)
class ProductKind:
    """The products of one stage.

    A *unit* is what the stage makes one product for: a job, a chip number, a brick, or None for the campaign.
    """

    name: str
    rules: tuple[str, ...]  # the last one writes the product; the others only prepare it
    find_units: Callable[[], Collection[Any]]  # () -> `made_for`
    files_of: Callable[[Any], list[Path]]  # unit -> its files: the product first, then others that the rule writes
    target: bool = True  # as Stage.target
    summary: str = ""  # as Stage.summary

    @property
    def made_for(self) -> Collection[Any]:
        """The units that have one product each. They are found on request: one job does not need all bricks."""
        return self.find_units()

    def files(self, units: Iterable[Any] | None = None) -> list[str]:
        """Return the files of some units, by default of all, as strings."""
        return [str(path) for unit in (self.made_for if units is None else units) for path in self.files_of(unit)]


def kinds(run: OpenCampaign) -> dict[str, ProductKind]:
    """Return {rule: ProductKind} of an OpenCampaign, in the order of the workflow; a kind may have no products."""
    return {
        stage.name: ProductKind(
            stage.title,
            _rules(run, stage),
            partial(_made_for, run, stage),
            partial(_files_of, run, stage),
            stage.target,
            stage.summary,
        )
        for stage in STAGES.values()
        if stage.kept != "no" and not stage.instead_of
    }


def _rules(run: OpenCampaign, stage: Stage) -> tuple[str, ...]:
    """Return the stage, preceded by the stages before it whose products are not kept."""
    rules: list[str] = []
    for before in map(STAGES.__getitem__, stage.inputs):
        if not _is_kept(run, before):
            rules += [rule for rule in _rules(run, before) if rule not in rules]
    return *rules, stage.name


def _is_kept(run: OpenCampaign, stage: Stage) -> bool:
    return stage.kept == "yes" or (stage.kept == "light" and run.config.keep == "light")


def _made_for(run: OpenCampaign, stage: Stage) -> Collection[Any]:
    """Return the units for which the campaign writes a product of a stage."""
    if not _is_kept(run, stage):
        return []
    units = getattr(run, stage.made_for)
    if stage.layered and stage.kept == "light":
        units = [job for job in units if run.has_stage(job.pointing, stage.name)]
    if stage.of_base == "file":  # a variant uses the files of its base
        units = [unit for unit in units if not made_by_base(run, stage.name, getattr(unit, "key", unit))]
    return units


def _files_of(run: OpenCampaign, stage: Stage, unit: Any) -> list[Path]:
    """Return the files of a unit; for the report, also those that describe the catalogue of merged bricks."""
    files = [run.paths.of(product.name, unit) for product in stage.products if _is_written(run, product, unit)]
    if stage.name == "report" and run.merge_bricks:
        files += [run.paths.merge_catalogue / name for name in ABOUT]
    return files


def _is_written(run: OpenCampaign, product: Product, unit: Any) -> bool:
    """Return whether a stage writes one of its products for a unit."""
    if product.only == "cat":
        return "cat" in run.config.truth
    if product.only == "joint":
        return run.config.measurement.joint
    return product.only != "orders" or run.has_orders(unit)


def pairs_of_base(run: OpenCampaign, job: Job, rule: str) -> list[tuple[Path, Path]]:
    """Return [(file of the base, file of the variant)] of a rule's products of a job; [] if the base has none yet."""
    assert run.base is not None  # it is a variant
    base_files, own_files = (kinds(owner)[rule].files_of(job) for owner in (run.base, run))
    if not all(path.is_file() for path in base_files):
        return []
    more = list(zip(*(also_written(owner, job, rule) for owner in (run.base, run)), strict=True))
    return [*zip(base_files, own_files, strict=True), *(pair for pair in more if pair[0].is_file())]


def also_written(run: OpenCampaign, job: Job, rule: str) -> list[Path]:
    """Return the files that a rule may write beside the products of a job; Snakemake does not know them.

    They are the image of cosmic rays, saved by an option of a layer, and the truth as text once more, under the name
    that the campaign's form of names has for it.
    """
    if rule != "level0":
        return []
    text = run.paths.level0_catalogue(job)
    named = "cat" in run.config.truth and text != run.paths.level0_cat(job)
    return [run.paths.level0_cosmic(job), *([text] if named else [])]


def summary(run: OpenCampaign, products: Mapping[str, ProductKind]) -> str:
    """Return the workflow's last message: products, folders and the verdict. products: as `kinds` returned them."""
    counts = [(kind.summary, len(kind.made_for)) for kind in products.values() if kind.summary]
    truth = " with truth" if run.science_jobs else ""
    lines = [text.format(n=n, s="" if n == 1 else "s", truth=truth) for text, n in counts if n]
    return "\n".join([f"\n{run.title}, in {run.paths.output}:", *(f"  {line}" for line in lines), *_verdict(run)])


def _verdict(run: OpenCampaign) -> list[str]:
    """Return the verdict in a sentence, and one for each gate that fails; [] for a campaign without gates."""
    file = run.paths.report.with_name("verdict.json")
    if not (run.merge_bricks and file.is_file()):
        return []
    verdict = json.loads(file.read_text())
    failed = [sentence(gate) for gate in verdict["gates"] if gate["passed"] is False]
    more = [f"... and {len(failed) - MAX_GATES} more, in the report"] if len(failed) > MAX_GATES else []
    return [headline(verdict), *(f"  {line}" for line in failed[:MAX_GATES] + more)]
