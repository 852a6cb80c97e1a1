"""A full-depth grating chip of the standard scene with all layers, catalogue to spectra: CPU s by stage, memory.

    python benchmarks/standard_scene.py --chip 29 1 3     # makes the scene on a GV, a GI and a GU chip
    python benchmarks/slitless_chip.py [--chips 29 1 3]

Runs `csstsim chip` with the layers of science.yaml, once with the shipped traps of a young detector, once with the
density of traps of the paper's tests. A first run makes the PSF set and the compiled kernels; of three more the
cheapest counts. Then `csstsim extract` extracts the spectra of the frame with the shipped traps.
"""

import argparse
import os
import re
import subprocess
import sys
from pathlib import Path

from evidence.record import Record

import yaml
from chip_stages import PAPER, ROOT, RUNS, TOY, measured, observation
from private_memory import PrivateMemory
from toy_sky import toy_sky

from csstsim.campaign.opened import OpenCampaign

TRAPS = {"shipped": None, "paper": 1.0}  # densities: of a young detector, of the paper's tests


def campaign(number, traps, toy=False):
    """Write the campaign of the scene on a chip, with all layers, or of a window with few objects; return its file."""
    folder = ROOT / "results" / "standard_scene" / f"chip_{number:02d}"
    if toy:
        folder = ROOT / "results" / "toy" / "slitless_chip"
        folder.mkdir(parents=True, exist_ok=True)
        content = yaml.safe_load((ROOT / "config/full_chip.yaml").read_text())
        content |= {"survey_table": str(ROOT / "survey_tables/demo.csv"), "output": str(folder), "window": TOY}
        content["select"] = {"types": ["SCIE"], "obsids": ["10100000004"], "chips": [number]}
        file = folder / "all_layers.yaml"
        file.write_text(yaml.safe_dump(content))
        middle = (float(corner.mean()) for corner in OpenCampaign(file).jobs[0].footprint())
        content |= toy_sky(folder, *middle, radius=0.01)
    else:
        content = yaml.safe_load((folder / "campaign.yaml").read_text())
    (folder / "science.yaml").write_text(yaml.safe_dump(observation(traps), sort_keys=False))
    content["observations"] = {"SCIE": str(folder / "science.yaml")}
    file = folder / "all_layers.yaml"
    file.write_text(yaml.safe_dump(content, sort_keys=False))
    return file


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--chips", type=int, nargs="+", default=[29, 1, 3])
    parser.add_argument("--runs", type=int, default=RUNS)
    with Record(parser) as record:
        options, rows = record.options, []
        for number in options.chips[:1] if record.toy else options.chips:
            for name, traps in TRAPS.items():
                file, runs = campaign(number, traps, record.toy), 1 if record.toy else options.runs
                rows.append(cost_of(number, name, file, runs, record))
                if traps is None:
                    extraction(file, runs, record)
        header = ["chip", "objects", "traps", "select", "render", "readout", "level0", "start-up", "all", "GB"]
        record.table("chips", header, rows)


def cost_of(number, name, file, count, record):
    """Run the chip, record its cost, and return its row of the table."""
    job = OpenCampaign(file).jobs[0]
    runs = [measured(file, *map(str, job.key)) for _ in range(count + 1)][1:]
    stages, total, memory, said = min(runs, key=lambda run: run[1])
    objects = next(line.split()[0] for line in said.splitlines() if "objects reach" in line)
    key, what = f"{job.chip.filter}_{name}", f"{job.chip.filter} chip, {name} traps"
    record.value(f"{key}_cpu", total, what, unit="CPU-s")
    record.value(f"{key}_gb", memory, f"{what}: private memory", unit="GB")
    record.value(f"{key}_fewer", PAPER / total, f"{what}: the paper's mean over it")
    cells = [f"{stages.get(stage, 0.0):.1f}" for stage in ("select", "render", "readout", "level0")]
    ends = f"{total - sum(stages.values()):.1f}", f"{total:.1f}", f"{memory:.2f}"
    return [f"{job.chip.filter}, {number}", objects, name, *cells, *ends]


def extraction(file: Path, count: int, record: Record) -> None:
    """Record the cost of the frame's spectra: the cheapest of several runs, start-up included."""
    job = OpenCampaign(file).jobs[0]
    line = [Path(sys.executable).parent / "csstsim", "extract", file, "--obsid", job.obsid, "--chip", job.chip.id]
    runs = []
    for _ in range(count):
        process = subprocess.Popen([str(word) for word in line], stdout=subprocess.PIPE, text=True)
        with PrivateMemory(process.pid) as memory:
            said = process.stdout.read()
            _, status, used = os.wait4(process.pid, 0)
        if status:
            sys.exit(f"csstsim extract failed: {said}")
        runs.append((used.ru_utime + used.ru_stime, memory.largest, int(re.search(r"^(\d+) spectr", said, re.M)[1])))
    cpu, gb, spectra = min(runs)
    key, what = job.chip.filter, f"csstsim extract, {job.chip.filter} chip"
    record.value(f"{key}_spectra", spectra, f"{what}: spectra")
    record.value(f"{key}_extract_cpu", cpu, what, unit="CPU-s")
    record.value(f"{key}_extract_gb", gb, f"{what}: private memory", unit="GB")


if __name__ == "__main__":
    main()
