"""`csstsim budget shear`: runs a plan, or its first field alone, and writes table, figures and page."""

from pathlib import Path

from csstsim.base.process.one_thread import one_thread
from csstsim.budget.shear.bars import bars
from csstsim.budget.shear.figures import chart, waterfall
from csstsim.budget.shear.page import write_page, write_rows
from csstsim.budget.shear.plan import DEFAULT, load_plan
from csstsim.budget.shear.run import fields
from csstsim.budget.shear.volume import report


@one_thread
def budget(file, output, say, *, only_plan=False, count=None, effects=None, estimators=None):
    """Make the fields of a plan, and from them the budget; with only_plan, one field of each sample, and the volume.

    Returns the rows of bars.bars, with the sample. Raises InputError.
    """
    plan, folder = load_plan(file, fields=count, effects=effects, estimators=estimators), Path(output)
    paths = fields(plan, folder, say, first=1 if only_plan else None, file=file or DEFAULT)
    rows = [{"sample": name} | row for name in plan.samples for row in bars(plan, paths[name])]
    for line in report(rows):
        say(line)
    if only_plan:
        return rows
    write_rows(folder / "budget.ecsv", rows, plan)
    for name in plan.samples:
        waterfall(folder / f"waterfall_{name}.png", rows, name, plan.summed)
        chart(folder / f"chart_{name}.png", rows, name)
    write_page(folder / "index.html", rows, plan, f"csstsim budget shear {file or ''}".strip())
    say(f"{folder / 'index.html'}: figures and table; budget.ecsv beside it")
    return rows
