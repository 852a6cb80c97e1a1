"""A full-depth grating chip of the standard scene with all layers, catalogue to spectra: CPU s by stage, memory.

    python benchmarks/standard_scene.py --chip 29 1 3     # makes the scene on a GV, a GI and a GU chip
    python benchmarks/slitless_chip.py [--chips 29 1 3]

Runs `csstsim chip` with the layers of science.yaml, once with the shipped traps of a young detector, once with the
density of traps of the paper's tests. A first run makes the PSF set and the compiled kernels; of three more the
cheapest counts. Then `csstsim extract` extracts the spectra of the frame with the shipped traps. Those of faint stars
are compared with the truth, summed and weighted by their errors.
"""

import argparse
import os
import re
import subprocess
import sys
from pathlib import Path

from evidence.record import Record

import numpy as np
import yaml
from chip_stages import PAPER, ROOT, RUNS, TOY, measured, observation
from private_memory import PrivateMemory
from toy_sky import toy_sky

from csstsim.campaign.job import Job
from csstsim.campaign.opened import OpenCampaign
from csstsim.catalog.table import STAR, ObjectTable
from csstsim.io.truth import read_truth
from csstsim.measure.bricks.validation.gates.data import clipped_mean
from csstsim.measure.spectra.spectrum_columns import BESIDE, CUT, DIM, EDGE, IMAGED, LOST, MASKED, SATURATED, UNEVEN

UNUSABLE = DIM | LOST | CUT | BESIDE | UNEVEN | IMAGED | SATURATED | EDGE | MASKED
COLUMNS = 100  # usable ones of a star's spectrum
FAINT = 5.0, 150.0  # electrons a column
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
    unbiased(OpenCampaign(file), job, record)


def unbiased(run: OpenCampaign, job: Job, record: Record) -> None:
    """Record the electrons of faint stars' spectra less those of the truth, by plain sums and weighted by errors.

    The mean over stars is clipped at four sigma: neighbours that are too faint to be modelled are bright next to the
    faintest stars.
    """
    truth = read_truth(run.paths.level0_truth(job))
    table = ObjectTable.read(run.paths.spectra(*job.key))
    good = (table["flags"] & UNUSABLE == 0) & (truth["obj_type"][table["row"]] == STAR)
    row = table["row"][good]
    electrons, model, error = (table[name][good].astype(float) for name in ("electrons", "model", "electrons_err"))

    def total(values: np.ndarray) -> np.ndarray:
        return np.bincount(row, values, len(truth))

    columns = total(np.ones(len(row)))
    mean = total(model) / np.maximum(columns, 1)
    faint = (columns >= COLUMNS) & (mean > FAINT[0]) & (mean < FAINT[1])
    weight = error**-2.0
    norm, weights = np.maximum(columns, 1), np.maximum(total(weight), 1e-30)
    ways = {
        "sum": (total(electrons - model) / norm, np.sqrt(total(error**2)) / norm),
        "weighted": (total((electrons - model) * weight) / weights, weights**-0.5),
    }
    for way, (off, sigma) in ways.items():
        middle, error_of_mean, n = clipped_mean(off[faint], sigma[faint], 0.0)
        name, what = f"{job.chip.filter}_faint_{way}", f"electrons of a column less the true ones, faint stars, {way}"
        if not n:
            record.value(name, np.nan, what)
            continue
        goal = abs(middle) <= 0.01 * float(mean[faint].mean()) + 2 * error_of_mean
        what = f"{what}: {job.chip.filter} chip, {n} stars"
        record.value(name, middle, what, unit="electron", error=error_of_mean, goal=bool(goal))


if __name__ == "__main__":
    main()
