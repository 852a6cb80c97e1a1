"""CPU seconds of `csstsim select` and `render` of a whole r chip, its sky with and without structure.

    python benchmarks/structure_chip.py [--repeat 2] [--folder FOLDER]

The campaign is config/full_chip.yaml. Bricks and PSF are made before and not counted; each stage is a process, and the
two skies take turns. Exit code 1 if the chip with structure costs more than 1.1 times the other.
"""

import argparse
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

import pyarrow.parquet as pq
import yaml

from csstsim.campaign.opened import OpenCampaign

ROOT = Path(__file__).resolve().parents[1]
LIMIT = 1.1


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeat", type=int, default=2)
    parser.add_argument("--folder", help="bricks of a run before are used again")
    options = parser.parse_args()
    folder = Path(options.folder or tempfile.mkdtemp(prefix="structure_chip_"))
    runs = {structure: prepared(folder / structure, structure) for structure in ("none", "haloes")}
    cost = {structure: [] for structure in runs}
    for _ in range(options.repeat):
        for structure, run in runs.items():
            (job,) = run.jobs
            cost[structure].append(
                [cpu_seconds(stage, run.file, *job.options.split()) for stage in ("select", "render")]
            )
    for structure, run in runs.items():
        (job,) = run.jobs
        rows = pq.read_metadata(run.paths.stage(*job.key, "select.parquet")).num_rows
        select, render = (min(values) for values in zip(*cost[structure], strict=True))
        print(f"{structure}: {rows} objects, select {select:.1f}, render {render:.1f} CPU s")
    ratio = min(map(sum, cost["haloes"])) / min(map(sum, cost["none"]))
    print(f"haloes over none: {ratio:.2f}, at most {LIMIT}")
    sys.exit(int(ratio > LIMIT))


def prepared(folder, structure):
    """Return the campaign with its bricks and PSF made."""
    folder.mkdir(parents=True, exist_ok=True)
    data = yaml.safe_load((ROOT / "config" / "full_chip.yaml").read_text())
    data |= {"survey_table": str(ROOT / "survey_tables" / "demo.csv"), "output": "out"}
    data |= {"catalog": {"structure": structure}}
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
