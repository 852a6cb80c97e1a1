"""CPU seconds of `csstsim select` and `render` of a whole r chip, its sky with and without structure.

    python benchmarks/structure_chip.py [--repeat 2] [--folder FOLDER]

The campaign is config/full_chip.yaml. Bricks and PSF are made before and not counted; each stage is a process, and the
two skies take turns. Exit code 1 if the chip with structure costs more than 1.1 times the other.
"""

import argparse
import resource
import subprocess
import tempfile
from pathlib import Path

from evidence.record import Record

import pyarrow.parquet as pq
import yaml
from toy_sky import TOY_PSF

from csstsim.campaign.opened import OpenCampaign

ROOT = Path(__file__).resolve().parents[1]
LIMIT = 1.1


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeat", type=int, default=2)
    parser.add_argument("--folder", help="bricks of a run before are used again")
    with Record(parser) as record, tempfile.TemporaryDirectory(prefix="structure_chip_") as made:
        compare(record, Path(record.options.folder or made))


def compare(record: Record, folder: Path) -> None:
    """Select and render with both skies in turns; record the cost. At toy size the window is small."""
    runs = {structure: prepared(folder / structure, structure, record.toy) for structure in ("none", "haloes")}
    cost = {structure: [] for structure in runs}
    for _ in range(1 if record.toy else record.options.repeat):
        for structure, run in runs.items():
            (job,) = run.jobs
            cost[structure].append(
                [cpu_seconds(stage, run.file, *job.options.split()) for stage in ("select", "render")]
            )
    for structure, run in runs.items():
        (job,) = run.jobs
        rows = pq.read_metadata(run.paths.stage(*job.key, "select.parquet")).num_rows
        select, render = (min(values) for values in zip(*cost[structure], strict=True))
        record.value(f"{structure}_objects", rows, f"structure {structure}: objects that reach the chip")
        record.value(f"{structure}_select", select, f"structure {structure}: select", unit="CPU-s")
        record.value(f"{structure}_render", render, f"structure {structure}: render", unit="CPU-s")
    ratio = min(map(sum, cost["haloes"])) / min(map(sum, cost["none"]))
    record.value("ratio", ratio, "select and render with haloes over without structure", below=LIMIT)


def prepared(folder, structure, toy):
    """Return the campaign with its bricks and PSF made."""
    folder.mkdir(parents=True, exist_ok=True)
    data = yaml.safe_load((ROOT / "config" / "full_chip.yaml").read_text())
    data |= {"survey_table": str(ROOT / "survey_tables" / "demo.csv"), "output": "out"}
    data |= {"catalog": {"structure": structure}}
    if toy:
        data["window"] = {"x0": 2800, "x1": 3000, "y0": 4800, "y1": 5000}  # one brick reaches it
        data["psf"] = TOY_PSF
    (folder / "campaign.yaml").write_text(yaml.safe_dump(data))
    run = OpenCampaign(folder / "campaign.yaml")
    (job,) = run.jobs
    for pix in run.truth_bricks(job):
        if not run.paths.truth(pix).exists():
            cpu_seconds("truth", run.file, "--brick", pix)
    cpu_seconds("psf", run.file, "--chip", job.chip.id)
    return run


def cpu_seconds(*words):
    def used():
        return sum(resource.getrusage(resource.RUSAGE_CHILDREN)[:2])

    before = used()
    command = ["csstsim", *map(str, words)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return used() - before


if __name__ == "__main__":
    main()
