"""Cost of one full-depth chip with every layer, from the catalogue to the Level-0 file: CPU seconds by stage, memory.

    python benchmarks/chip_stages.py [--filters r NUV]

Runs `csstsim chip` on the demo's field with the layers of science.yaml and the paper's density of traps. A first run
makes truth bricks, PSF sets and compiled kernels; of three more the cheapest counts. Start-up is the process's time
outside its stages: interpreter, imports, checks of the campaign.
"""

import argparse
import os
import re
import subprocess
import sys
from pathlib import Path

from evidence.record import Record

import yaml
from private_memory import PrivateMemory
from toy_sky import toy_sky

from csstsim.base.files.atomic import atomic_path
from csstsim.campaign.config import load_campaign
from csstsim.campaign.opened import OpenCampaign
from csstsim.instrument.camera import load_camera

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "results" / "chip_stages" / load_camera(ROOT / "config/instrument").digest  # one per camera
TOY = {"x0": 4300, "x1": 5000, "y0": 4300, "y1": 5000}
RUNS = 3
PAPER = 14_742  # CPU s a chip: 300,000 CPU-hours for 73,260 files (paper, section 5.6)


def observation(traps=1.0):
    """Return the shipped science exposure with the paper's density of traps times `traps`; None: as shipped."""
    content = yaml.safe_load((ROOT / "config/observations/science.yaml").read_text())
    for layer in content["layers"]:
        if "CTE_effect" in layer and traps is not None:
            layer["CTE_effect"]["density_scale"] = traps
    return content


def campaign(toy=False):
    """Write the campaign, the demo's exposures of whole chips with all layers; return its file.

    toy: of a small window, with a table of objects. Commands that run at once may share it.
    """
    folder = ROOT / "results" / "toy" / "chip_stages" if toy else FOLDER
    folder.mkdir(parents=True, exist_ok=True)
    _write(folder / "science.yaml", observation())
    content = load_campaign(ROOT / "config/full_chip.yaml").model_dump(mode="json")
    content |= {"name": "chip_stages", "output": str(folder), "select": {"types": ["SCIE"]}}
    content["observations"] = {"SCIE": str(folder / "science.yaml")}
    file = folder / "campaign.yaml"
    if toy:
        content["window"] = TOY
        draft = folder / f"draft_{os.getpid()}.yaml"
        _write(draft, content)
        run = OpenCampaign(draft, copied=True)
        _, obsid, chip = next(jobs(run, ["r"]))
        content["select"] = content["select"] | {"obsids": [obsid]}
        middle = (float(corner.mean()) for corner in run.job(obsid, chip).footprint())
        content |= toy_sky(folder, *middle)
        draft.unlink()
    _write(file, content)
    return file


def _write(file: Path, content: dict) -> None:
    with atomic_path(file) as temporary:
        temporary.write_text(yaml.safe_dump(content, sort_keys=False))


def jobs(run, filters):
    """Yield (filter, obsid, chip) of the exposure in each filter that covers the demo's field."""
    demo = OpenCampaign(ROOT / "config/campaign.yaml")
    for name in filters:
        job = next(job for job in demo.jobs if job.chip.filter == name)
        yield name, job.obsid, job.chip.id


def measured(file, obsid, chip):
    """Run the chip; return ({stage: CPU s}, all CPU s, GB, its output)."""
    command = [Path(sys.executable).parent / "csstsim", "chip", file, "--obsid", obsid, "--chip", chip]
    process = subprocess.Popen([str(part) for part in command], cwd=ROOT, stdout=subprocess.PIPE, text=True)
    with PrivateMemory(process.pid) as memory:
        said = process.stdout.read()
        _, status, used = os.wait4(process.pid, 0)
    if status:
        sys.exit(f"csstsim chip failed: {said}")
    stages = {name: float(cpu) for name, cpu in re.findall(r"^(\w+): [\d.]+ s, ([\d.]+) CPU-s$", said, re.MULTILINE)}
    return stages, used.ru_utime + used.ru_stime, memory.largest, said


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--filters", nargs="+", default=["r", "NUV"])
    with Record(parser) as record:
        report(record)


def report(record: Record) -> None:
    """Record the cost by filter and stage."""
    file, runs = campaign(record.toy), 1 if record.toy else RUNS
    run = OpenCampaign(file)
    for band, obsid, chip in jobs(run, record.options.filters[: 1 if record.toy else None]):
        measured(file, obsid, chip)
        stages, total, memory, said = min((measured(file, obsid, chip) for _ in range(runs)), key=lambda run: run[1])
        objects = int(re.search(r"^([0-9]+) objects", said, re.MULTILINE)[1])
        record.value(f"{band}_objects", objects, f"objects that reach the {band} chip")
        rows = []
        for name, cpu in (stages | {"start-up": total - sum(stages.values()), "all": total}).items():
            record.value(f"{band}_{name.replace('-', '_')}", cpu, f"{band} chip: {name}", unit="CPU-s")
            rows.append([name, f"{cpu:.1f}"])
        rows.append(["the paper's mean over its files, with spectra", f"{PAPER} ({PAPER / total:.0f} times)"])
        record.table(f"{band}_stages", [f"{band} chip", "CPU-s"], rows)
        record.value(f"{band}_gb", memory, f"{band} chip: private memory", unit="GB")


if __name__ == "__main__":
    main()
