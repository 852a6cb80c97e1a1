"""Cost of running each stage of a chip in its own process: CPU seconds of a stage without objects, and of the demo.

    python benchmarks/start_of_stages.py [--runs 9] [--demo]

`csstsim select` on a pixel of the demo that no object reaches may cost at most 1.5 times a process that imports numba
and pyarrow, calls a compiled function (the faintest galaxies near the pixel need one) and reads the same bricks. With
--demo (a quarter of an hour), the whole demo by four stages per chip may cost at most 1.35 times that by one process
per chip (`--config chips=whole`), including Snakemake. Costs are medians of the user and system time of all processes,
with everything compiled before. Exit code 1 above either limit.
"""

import argparse
import os
import shutil
import statistics
import subprocess
import sys
from pathlib import Path

from evidence.record import Record

import yaml
from toy_sky import toy_sky

from csstsim.campaign.config import load_campaign
from csstsim.campaign.opened import OpenCampaign

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "results" / "start_of_stages"
JOB = ("10100000001", 12)
PIXEL = {"x0": 4972, "x1": 4973, "y0": 4498, "y1": 4499}  # no object reaches it, however faint
MOST_EMPTY, MOST_DEMO = 1.5, 1.35
TOY = {  # one small frame of the demo
    "select": {"types": ["SCIE"], "obsids": [JOB[0]], "chips": [JOB[1]]},
    "window": {"x0": 4800, "x1": 5100, "y0": 4400, "y1": 4700},
}
MAIN = "import sys; from csstsim.command_line.main import main; sys.exit(main())"
READ = """
import sys, numpy, pyarrow.parquet as parquet
from csstsim.base.counter import object_keys
object_keys(numpy.uint64(1), numpy.arange(3))
for path in sys.argv[1:]:
    table = parquet.read_table(path)
    columns = [table[name].to_numpy() for name in table.column_names]
"""


def cpu_seconds(*line):
    """Return (user and system seconds, output) of a process and its children."""
    environment = os.environ | {"PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)  # as any user's: modules are compiled once
    process = subprocess.Popen(
        [sys.executable, *map(str, line)], cwd=ROOT, env=environment, text=True, stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
    )  # fmt: skip
    said = process.stdout.read()
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        sys.exit(f"{line}: exit code {process.returncode}\n{said[-2000:]}")
    return used.ru_utime + used.ru_stime, said


def campaign(name, **changes):
    """Write the demo with another output and other keys; return its file."""
    content = (
        load_campaign(ROOT / "config/campaign.yaml").model_dump(mode="json") | {"output": str(FOLDER / name)} | changes
    )
    file = FOLDER / f"{name}.yaml"
    file.write_text(yaml.safe_dump(content, sort_keys=False))
    return file


def empty(runs, record):
    """Record the cost of select without objects; return it over the cost of its necessary imports and reads."""
    sky = toy_sky(FOLDER / "far", 300.09, -59.8) if record.toy else {}
    file = campaign("empty", window=PIXEL, **sky)
    run, (obsid, chip) = OpenCampaign(file), JOB
    bricks = run.truth_bricks(run.job(obsid, chip)) if run.embedded else ()
    for pix in bricks:
        if not run.paths.truth(pix).exists():
            cpu_seconds("-c", MAIN, "truth", file, "--brick", pix)
    lines = {
        "import numba, pyarrow; call a compiled function; read the bricks": ("-c", READ, *map(run.paths.truth, bricks)),
        "csstsim select": ("-c", MAIN, "select", file, "--obsid", obsid, "--chip", chip),
    }
    medians, rows = [], []
    for name, line in lines.items():
        said = cpu_seconds(*line)[1]  # the first, which compiles, does not count
        if "select" in name and "\n0 objects reach the window" not in said:
            sys.exit(f"an object reaches the pixel {PIXEL}: look for another\n{said}")
    took = [
        [cpu_seconds(*line)[0] for line in lines.values()] for _ in range(runs)
    ]  # in turn, so that other load affects both
    for name, times in zip(lines, zip(*took, strict=True), strict=True):
        medians.append(statistics.median(times))
        rows.append([f"`{name}`", f"{medians[-1]:.2f}", f"{min(times):.2f} to {max(times):.2f}"])
    record.table("empty", ["process", "CPU-s, median", "minimum to maximum"], rows)
    return medians[1] / medians[0]


def demo(record):
    """Record the cost of the demo by stages and by whole chips, both compiled; return the ratio."""
    took = {}
    changes = TOY | toy_sky(FOLDER, 300.09, -59.87) if record.toy else {}
    for chips in ("stages", "whole") if record.toy else ("whole", "stages", "whole"):  # the first of three compiles
        shutil.rmtree(FOLDER / chips, ignore_errors=True)
        line = "-m", "snakemake", "--profile", "profiles/default", "--cores", 1
        took[chips] = cpu_seconds(*line, "--config", f"campaign={campaign(chips, **changes)}", f"chips={chips}")[0]
    record.table("demo", ["demo, chips=", "CPU-s"], [[f"`{chips}`", f"{cpu:.0f}"] for chips, cpu in took.items()])
    return took["stages"] / took["whole"]


def main() -> None:
    """Run the parts that are asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=9)
    parser.add_argument("--demo", action="store_true", help="the whole demo, too")
    with Record(parser) as record:
        FOLDER.mkdir(parents=True, exist_ok=True)
        ratio = empty(2 if record.toy else record.options.runs, record)
        what = "CPU-s of `select` without objects over its necessary imports and reads"
        record.value("empty_ratio", ratio, what, below=MOST_EMPTY)
        if record.options.demo:
            record.value("demo_ratio", demo(record), "CPU-s of the demo by stages over whole chips", below=MOST_DEMO)


if __name__ == "__main__":
    main()
