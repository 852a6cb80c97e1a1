"""Time and memory of a campaign's jobs, measured and expected (csstsim.campaign.costs): a table by rule.

Snakemake writes a benchmark file for each job. It samples a job every half second and, after a quarter of a minute,
every half minute, so it misses what follows its last sample. The last line of the log, if there is one, is exact.
"""

import csv
from statistics import fmean

from csstsim.campaign.costs import expected
from csstsim.campaign.job_log import Took, took

MOST = 1e12  # larger figures are invalid


def run_times(run):
    """Return the rows of the table, {heading: value}: a rule each, all of them, and that for each Level-0 file.

    Empty if there are no benchmark files. run: campaign.opened.OpenCampaign.
    """
    found = measured(run.paths.output)
    costs, rows, sums = expected(run) if found else {}, [], [0.0, 0.0, 0.0]
    for rule, jobs in found.items():
        known = costs.get(rule, {}).values()
        rows.append(_row(rule, jobs, known))
        wall, cpu = (sum(_known(jobs, name)) for name in ("wall_s", "cpu_s"))
        should = len(jobs) * fmean(cost.cpu_s for cost in known) if known else 0.0
        sums = [total + part for total, part in zip(sums, (wall, cpu, should), strict=True)]
    return rows and [*rows, _total("all", 1, sums), _total("all, for a Level-0 file", len(run.jobs), sums)]


def measured(output):
    """Return {rule: [Took of each job]} from the benchmark files and logs of an output folder; None where unknown."""
    found = {}
    for folder in sorted(path for path in (output / "benchmarks").glob("*") if path.is_dir()):
        jobs = [job for path in sorted(folder.glob("*.tsv")) for job in _read(path, output / "logs" / folder.name)]
        if jobs:
            found[folder.name] = jobs
    return found


def _read(path, logs):
    """Yield the Took of each run that a benchmark file has."""
    try:
        said = took((logs / path.name).with_suffix(".log").read_text(errors="replace"))
    except OSError:
        said = None
    for row in csv.DictReader(path.read_text(errors="replace").splitlines(), delimiter="\t"):
        wall, cpu, memory = (_number(row.get(name)) for name in ("s", "cpu_time", "max_rss"))
        yield Took(wall, said.cpu_s, said.memory_mb) if said else Took(wall, cpu, memory)


def _number(text):
    """Return a figure of a benchmark file; None for 'NA' (a job too short to sample) and in a truncated line."""
    try:
        value = float(text)
    except (TypeError, ValueError):
        return None
    return value if 0 <= value < MOST else None


def _known(jobs, name):
    """Return the known values of one figure of the jobs, as a list."""
    return [value for job in jobs if (value := getattr(job, name)) is not None]


def _row(rule, jobs, costs):
    """Return a rule's row: sums, then CPU time and memory of a job, measured and expected."""
    wall, cpu, memory = (_known(jobs, name) for name in ("wall_s", "cpu_s", "memory_mb"))
    cpu_mean = fmean(cpu) if cpu else None
    memory_most = max(memory, default=None)
    should = fmean(cost.cpu_s for cost in costs) if costs else None
    room = max((cost.memory_mb for cost in costs), default=None)
    return {
        "step": rule, "jobs": len(jobs), "wall [s]": _shown(sum(wall), 1), "CPU [s]": _shown(sum(cpu), 1),
        "CPU of a job: mean": _shown(cpu_mean, 1), "most": _shown(max(cpu, default=None), 1),
        "expected [s]": _shown(should, 1), "mean / expected": _ratio(cpu_mean, should),
        "memory of a job: mean": _shown(fmean(memory) if memory else None), "largest": _shown(memory_most),
        "expected [MB]": _shown(room), "largest / expected": _ratio(memory_most, room),
    }  # fmt: skip


def _total(name, count, sums):
    """Return a row of sums over all rules, divided by `count`."""
    wall, cpu, should = (total / count for total in sums)
    return {
        "step": name, "wall [s]": _shown(wall, 1), "CPU [s]": _shown(cpu, 1), "expected [s]": _shown(should, 1),
        "mean / expected": _ratio(cpu, should),
    }  # fmt: skip


def _shown(value, digits=None):
    return None if value is None else round(value, digits)


def _ratio(value, should):
    return round(value / should, 2) if value is not None and should else None
