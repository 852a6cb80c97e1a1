"""`csstsim budget shear`: runs a plan, or only its first field, and writes table, figures and page."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from csstsim.base.files.output_folder import output_folder
from csstsim.base.process.one_thread import one_thread
from csstsim.studies.budget.shear.bars import bars
from csstsim.studies.budget.shear.figures import chart, waterfall
from csstsim.studies.budget.shear.page import write_page, write_rows
from csstsim.studies.budget.shear.plan import ALL, BASE, DEFAULT, load_plan
from csstsim.studies.budget.shear.plan_faults import check_bars
from csstsim.studies.budget.shear.run import run_fields, setting_names
from csstsim.studies.budget.shear.volume import report

if TYPE_CHECKING:
    from csstsim.base.types import PathLike
    from csstsim.studies.budget.shear.plan import ShearPlan


@one_thread
def budget(
    file: PathLike | None, output: PathLike, log: Callable[[str], object], *, only_plan: bool = False, **changes: Any
) -> list[dict[str, Any]]:
    """Simulate the fields of a plan and derive the budget; with only_plan, one field of each sample, and the volume.

    changes: keywords of load_plan. Returns the rows of bars.bars, with the sample. Raises InputError.
    """
    plan = load_plan(file, **changes)
    folder = output_folder(output)
    check_bars(plan, file or DEFAULT)
    for line in summary(plan, file, only_plan):
        log(line)
    paths = run_fields(plan, folder, log, first=1 if only_plan else None)
    rows = [{"sample": name} | row for name in plan.samples for row in bars(plan, paths[name])]
    for line in report(rows):
        log(line)
    if only_plan:
        return rows
    write_rows(folder / "budget.ecsv", rows, plan)
    for name in plan.samples:
        waterfall(folder / f"waterfall_{name}.png", rows, name, plan.summed)
        chart(folder / f"chart_{name}.png", rows, name)
    write_page(folder / "index.html", rows, plan, _command(file, output, **changes))
    log(f"{folder / 'index.html'}: figures and table; budget.ecsv in the same folder")
    return rows


def summary(plan: ShearPlan, file: PathLike | None, only_plan: bool) -> list[str]:
    """Return the lines that are printed first: what will be simulated, and how long that takes."""
    limits = {name: sample.magnitude for name, sample in plan.samples.items()}
    samples = "; ".join(f"{name}, {bright:g} to {faint:g} mag" for name, (bright, faint) in limits.items())
    lines = [
        f"plan: {file or 'config/budget/shear.yaml'}; shear {plan.shear:g}; estimators {', '.join(plan.estimators)}",
        f"samples: {samples}",
        f"effects: {', '.join(plan.bars)}",
        f"windows: {plan.fields} of each sample, {plan.size} px wide, a galaxy every {plan.spacing} px, chips "
        f"{', '.join(map(str, plan.chips))}{_more(plan)}",
    ]
    work = f"{len(setting_names(plan))} settings (a line each in the first window), two arms; this takes minutes"
    if only_plan:
        return [*lines, f"now one window of each sample is simulated, for its errors and CPU time: {work}"]
    all_windows = plan.windows(BASE) * len(plan.samples)
    return [*lines, f"now {all_windows} windows, those that are not there yet: {work}"]


def _more(plan: ShearPlan) -> str:
    """Return the end of the plan's line: the bars with more windows than fields, and their numbers."""
    names = [*plan.bars, *([ALL] if plan.summed else [])]
    words = [f"{plan.windows(name)} of {name}" for name in names if plan.windows(name) > plan.fields]
    return "; " + ", ".join(words) if words else ""


def _command(
    file: PathLike | None,
    output: PathLike,
    *,
    fields: int | None = None,
    samples: Sequence[str] | None = None,
    effects: Sequence[str] | None = None,
    estimators: Sequence[str] | None = None,
) -> str:
    """Return the command that made the page."""
    words: list[PathLike | int] = ["csstsim", "budget", "shear", *([file] if file else []), "--output", output]
    words += ["--fields", fields] if fields else []
    for name, names in (("--samples", samples), ("--effects", effects), ("--estimators", estimators)):
        words += [name, ",".join(names)] if names else []
    return shlex.join(map(str, words))
