"""What a campaign makes: a row for each kind of product, with the rules that make it and its files.

The workflow's targets and inputs, its last message, `csstsim status` and what `csstsim verify` expects come from here.
io.paths has the paths of files, campaign.costs the cost of a rule.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from csstsim.bricks.hats import ABOUT
from csstsim.bricks.validation.verdict import headline, sentence
from csstsim.campaign.costs import STAGES
from csstsim.campaign.variants import made_by_base
from csstsim.io.paths import LIGHT

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
    target: bool = True  # made again if it is missing from a finished campaign, and not only if a job needs it
    end: str = ""  # part of the workflow's last message, with {n} for their number and {s} for a plural

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
    """Return {rule: Kind} of an opened.OpenCampaign, in the order of the workflow; a kind may have no products.

    Truth bricks and PSF sets are not targets: a new one would be newer than all chips, and all would be made again.
    """
    paths = run.paths
    config = run.config
    kept = [
        job
        for job in (run.jobs if config.keep == "light" else ())
        if run.has_stage(job.pointing, "render") and not run.in_base(*job.key, "render")
    ]
    calibrated = run.imaging_jobs if config.measurement.keep_calibrated else ()
    page = [None] if run.science_jobs else []
    truth = " with truth" if run.science_jobs else ""
    table = (
        Kind(
            "truth bricks", ("truth",), lambda: _own(run, "truth", run.sky_bricks), lambda pix: [paths.truth(pix)],
            target=False,
        ),
        Kind(
            "PSF sets", ("psf",), lambda: _own(run, "psf", run.sky_chips),
            lambda c: [paths.psf(c), paths.psf_tables(c)], target=False,
        ),
        Kind("light of chips", STAGES[:2], lambda: kept, partial(_light, run), end="light of {n} chip{s} in chips/"),
        Kind(
            "Level-0 files", STAGES[2:] if kept else STAGES, lambda: run.jobs, partial(_level0, run),
            end=f"{{n}} Level-0 file{{s}}{truth} in level0/",
        ),
        Kind(
            "masters", ("masters",), lambda: run.calibration_jobs, lambda c: [paths.masters(c)],
            end="masters of {n} chip{s} in masters/",
        ),
        Kind(
            "calibrated images", ("calibrate",), lambda: calibrated, lambda job: [paths.calibrated(*job.key)],
            end="calibrated images of {n} chip{s} in calibrated/",
        ),
        Kind("measured tables", ("measure",), lambda: run.imaging_jobs, lambda job: [paths.measure(*job.key)]),
        Kind(
            "spectra", ("extract",), lambda: run.slitless_jobs,
            lambda job: [*_drawn(paths.spectra(*job.key)), paths.lines(*job.key)],
            end="spectra of {n} chip{s} in spectra/",
        ),
        Kind(
            "merged bricks", ("merge",), lambda: run.merge_bricks, lambda pix: [paths.merge(pix)],
            end="merged catalogues of {n} brick{s} in merge/",
        ),
        Kind("validated bricks", ("validate",), lambda: run.merge_bricks, lambda pix: _drawn(paths.validate(pix))),
        Kind("report", ("report",), lambda: page, lambda _: _report(run), end="the report: report/index.html"),
        Kind(
            "comparison of variants", ("variants",), lambda: page if run.variants else [],
            lambda _: [paths.variants_page], end="the variants side by side: report/variants.html",
        ),
    )  # fmt: skip
    return {kind.rules[-1]: kind for kind in table}


def pairs_of_base(run: OpenCampaign, job: Job, rule: str) -> list[tuple[Path, Path]]:
    """Return [(file of the base, file of the variant)] of what a rule makes of a job; [] if the base has not yet."""
    assert run.base is not None  # it is a variant
    theirs, own = (kinds(owner)[rule].files_of(job) for owner in (run.base, run))
    if not all(path.is_file() for path in theirs):
        return []
    pairs = list(zip(theirs, own, strict=True))
    rays = [owner.paths.level0_cosmic(job) for owner in (run.base, run)]  # which a layer may save
    return [*pairs, (rays[0], rays[1])] if rule == "level0" and rays[0].is_file() else pairs


def _own(run: OpenCampaign, rule: str, numbers: Iterable[int]) -> list[int]:
    """Return the bricks or chips whose product the campaign makes, and not the base of which it is a variant."""
    return [number for number in numbers if not made_by_base(run, rule, number)]


def _light(run: OpenCampaign, job: Job) -> list[Path]:
    return [run.paths.stage(*job.key, name) for name in (LIGHT if run.has_orders(job) else LIGHT[:-1])]


def _level0(run: OpenCampaign, job: Job) -> list[Path]:
    orders = [run.paths.level0_orders(job)] if run.has_orders(job) else []
    text = [run.paths.level0_cat(job)] if "cat" in run.config.truth else []
    return [run.paths.level0(job), run.paths.level0_truth(job), *text, *orders]


def _drawn(path: Path) -> list[Path]:
    """Return a product and its figure."""
    return [path, path.with_suffix(".png")]


def _report(run: OpenCampaign) -> list[Path]:
    page = run.paths.report
    catalogue = [run.paths.merge_catalogue / name for name in ABOUT] if run.merge_bricks else []
    return [page, page.with_name("verdict.json"), *catalogue]


def summary(run: OpenCampaign, made: Mapping[str, Kind]) -> str:
    """Return what the campaign made, where to look, and the verdict, in lines. made: what `kinds` returned."""
    counts = [(kind.end, len(kind.made_for)) for kind in made.values() if kind.end]
    said = [end.format(n=n, s="" if n == 1 else "s") for end, n in counts if n]
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
