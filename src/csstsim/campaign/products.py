"""What a campaign makes: the products of each stage of the workflow, by its record (base.stage_records).

The workflow's targets and inputs, its last message, `csstsim status` and what `csstsim verify` expects come from here.
io.paths has the paths of files, campaign.costs the cost of a rule.
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

SHOWN = 10  # failing gates in the workflow's last message


@dataclass(frozen=True)
class Kind:
    """Products of one kind."""

    name: str
    rules: tuple[str, ...]  # the last one writes the product; the others only prepare it
    look_up: Callable[[], Collection[Any]]  # () -> `made_for`
    # job, chip or brick -> its files: the product first, then others the rule writes
    files_of: Callable[[Any], list[Path]]
    target: bool = True  # as Stage.target
    end: str = ""  # as Stage.summary

    @property
    def made_for(self) -> Collection[Any]:
        """The jobs, chips' numbers or bricks that have one each; [None] for one of the whole campaign.

        Looked up only when asked: one job of a survey need not know all bricks.
        """
        return self.look_up()

    def files(self, some: Iterable[Any] | None = None) -> list[str]:
        """Return the files of some jobs, chips or bricks, or of all, as strings."""
        return [str(path) for one in (self.made_for if some is None else some) for path in self.files_of(one)]


def kinds(run: OpenCampaign) -> dict[str, Kind]:
    """Return {rule: Kind} of an opened.OpenCampaign, in the order of the workflow; a kind may have no products."""
    return {
        stage.name: Kind(
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
    """Return the stages that only prepare a stage's product, as nothing of theirs is kept, and the stage itself."""
    found: list[str] = []
    for before in map(STAGES.__getitem__, stage.inputs):
        if not _is_kept(run, before):
            found += [rule for rule in _rules(run, before) if rule not in found]
    return *found, stage.name


def _is_kept(run: OpenCampaign, stage: Stage) -> bool:
    return stage.kept == "yes" or (stage.kept == "light" and run.config.keep == "light")


def _made_for(run: OpenCampaign, stage: Stage) -> Collection[Any]:
    """Return the jobs, chips or bricks of which the campaign has a product; of a variant, without the base's files."""
    if not _is_kept(run, stage):
        return []
    found = getattr(run, stage.made_for)
    if stage.layered and stage.kept == "light":
        found = [job for job in found if run.has_stage(job.pointing, stage.name)]
    if stage.of_base == "file":
        found = [one for one in found if not made_by_base(run, stage.name, getattr(one, "key", one))]
    return found


def _files_of(run: OpenCampaign, stage: Stage, one: Any) -> list[Path]:
    """Return the files of a job, chip or brick; with the report those that make a catalogue of the merged bricks."""
    files = [run.paths.of(product.name, one) for product in stage.products if _is_written(run, product, one)]
    if stage.name == "report" and run.merge_bricks:
        files += [run.paths.merge_catalogue / name for name in ABOUT]
    return files


def _is_written(run: OpenCampaign, product: Product, one: Any) -> bool:
    """Whether a stage writes one of its products for a job, chip or brick."""
    if product.only == "cat":
        return "cat" in run.config.truth
    return product.only != "orders" or run.has_orders(one)


def pairs_of_base(run: OpenCampaign, job: Job, rule: str) -> list[tuple[Path, Path]]:
    """Return [(file of the base, file of the variant)] of what a rule makes of a job; [] if the base has not yet."""
    assert run.base is not None  # it is a variant
    theirs, own = (kinds(owner)[rule].files_of(job) for owner in (run.base, run))
    if not all(path.is_file() for path in theirs):
        return []
    pairs = list(zip(theirs, own, strict=True))
    rays = [owner.paths.level0_cosmic(job) for owner in (run.base, run)]  # which a layer may save
    return [*pairs, (rays[0], rays[1])] if rule == "level0" and rays[0].is_file() else pairs


def summary(run: OpenCampaign, made: Mapping[str, Kind]) -> str:
    """Return what the campaign made, where to look, and the verdict, in lines. made: what `kinds` returned."""
    counts = [(kind.end, len(kind.made_for)) for kind in made.values() if kind.end]
    truth = " with truth" if run.science_jobs else ""
    said = [end.format(n=n, s="" if n == 1 else "s", truth=truth) for end, n in counts if n]
    return "\n".join([f"\n{run.title}, in {run.paths.output}:", *(f"  {line}" for line in said), *_verdict(run)])


def _verdict(run: OpenCampaign) -> list[str]:
    """Return the verdict in a sentence, and one for each gate that fails; [] of a campaign without gates."""
    file = run.paths.report.with_name("verdict.json")
    if not (run.merge_bricks and file.is_file()):
        return []
    verdict = json.loads(file.read_text())
    failed = [sentence(gate) for gate in verdict["gates"] if gate["passed"] is False]
    more = [f"... and {len(failed) - SHOWN} more, in the report"] if len(failed) > SHOWN else []
    return [headline(verdict), *(f"  {line}" for line in failed[:SHOWN] + more)]
