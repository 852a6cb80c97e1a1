"""`csstsim measure` on a full-depth r chip with every layer: CPU seconds by part, memory, sources.

    python benchmarks/measure_chip.py

The chip is that of chip_stages.py, once with the shipped density of traps and once with the paper's; each is made first
if it does not exist. Of three runs, after one that compiles the kernels, the cheapest counts. A part's time excludes
that of the parts within it; "start-up and the rest" is the remainder.
"""

import argparse
import functools
import importlib
import json
import os
import subprocess
import sys
import time
from pathlib import Path

from evidence.record import Record

import yaml
from chip_stages import campaign, jobs, measured, observation
from private_memory import PrivateMemory

from csstsim.campaign.opened import OpenCampaign
from csstsim.catalog.table import ObjectTable

RUNS = 3
LIMITS = 15.0, 1.0  # CPU s, GB
PARTS = {
    "calibrate": ["csstsim.stages.calibrate:calibrated_frame"],
    "charge moved back": ["csstsim.measure.calibration.charge_correction:put_back"],
    "PSF": ["csstsim.stages.psf:open_psf", "csstsim.measure.catalogue:psf_model"],
    "cosmic rays": ["csstsim.measure.catalogue:fill_bad_pixels"],
    "background": ["csstsim.measure.detection.detect:subtract_background"],
    "bright stars": [
        "csstsim.measure.catalogue:bright_stars", "csstsim.measure.detection.bright_stars:BrightStars.subtract_from",
        "csstsim.measure.detection.bright_stars:BrightStars.restore_to",
        "csstsim.measure.detection.bright_stars:BrightStars.add_noise_to",
    ],
    "isophotes": ["csstsim.measure.catalogue:isophotes"],
    "peaks": ["csstsim.measure.catalogue:peaks"],
    "windowed positions, radii": ["csstsim.measure.detection.detect:_sources"],
    "combine": ["csstsim.measure.catalogue:combine"],
    "PSF photometry": ["csstsim.measure.catalogue:fit_sources"],
    "Kron and aperture photometry": ["csstsim.measure.catalogue:kron_flux", "csstsim.measure.catalogue:aperture_flux"],
    "tracks": ["csstsim.measure.catalogue:tracks"],
    "total fluxes": ["csstsim.measure.catalogue:profile_tables", "csstsim.measure.catalogue:total_light"],
    "position errors": ["csstsim.measure.catalogue:position_errors"],
    "moments": ["csstsim.measure.catalogue:_shapes", "csstsim.measure.catalogue:_sky_shapes"],
    "astrometry": [
        "csstsim.measure.catalogue:icrs", "csstsim.optics.geometry.wcs:ChipWCS.pixel_to_world",
        "csstsim.optics.geometry.wcs:ChipWCS.jacobian",
    ],
    "writing": ["csstsim.catalog.table:ObjectTable.write"],
}  # fmt: skip


def timed(arguments):
    """Run `csstsim` in this process with its parts timed; print {part: CPU s} as the last line."""
    from csstsim.command_line.main import main

    spent, within = dict.fromkeys(PARTS, 0.0), [0.0]

    def clocked(function, part):
        @functools.wraps(function)
        def call(*args, **options):
            within.append(0.0)
            start = time.process_time()
            try:
                return function(*args, **options)
            finally:
                all_of_it = time.process_time() - start
                spent[part] += all_of_it - within.pop()
                within[-1] += all_of_it

        return call

    for part, places in PARTS.items():
        for place in places:
            module, _, name = place.partition(":")
            *owners, name = name.split(".")
            owner = functools.reduce(getattr, owners, importlib.import_module(module))
            setattr(owner, name, clocked(getattr(owner, name), part))
    main(arguments, standalone_mode=False)
    print(json.dumps(spent))


def measure(file, obsid, chip):
    """Run the measurement; return (all CPU s, {part: CPU s}, GB)."""
    command = [sys.executable, __file__, "--timed", "measure", file, "--obsid", obsid, "--chip", chip]
    process = subprocess.Popen([str(part) for part in command], stdout=subprocess.PIPE, text=True)
    with PrivateMemory(process.pid) as memory:
        said = process.stdout.read()
        _, status, used = os.wait4(process.pid, 0)
    if status:
        sys.exit("csstsim measure failed")
    return used.ru_utime + used.ru_stime, json.loads(said.splitlines()[-1]), memory.largest


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--timed", nargs=argparse.REMAINDER, help=argparse.SUPPRESS)
    if "--timed" in sys.argv:
        timed(parser.parse_args().timed)
        return
    with Record(parser) as record:
        report(record)


def report(record: Record) -> None:
    """Record the cost of the measurement by part, and in all with the paper's traps."""
    paper = campaign(record.toy)
    sources, total, parts, memory = cheapest(shipped(paper), record.toy)
    record.value("sources", sources, "detections of the r chip")
    times = parts | {"start-up and the rest": total - sum(parts.values()), "all": total}
    record.table("parts", ["part", "CPU-s"], [[name, f"{cpu:.1f}"] for name, cpu in times.items()])
    record.value("charge_cpu", parts["charge moved back"], "charge moved back", unit="CPU-s")
    for name, unit, value, limit in zip(("cpu", "gb"), ("CPU-s", "GB"), (total, memory), LIMITS, strict=True):
        record.value(name, value, f"`csstsim measure` of the chip, {unit}", unit=unit, below=limit)
    _, total, parts, _ = cheapest(paper, record.toy)
    record.value("paper_cpu", total, "`csstsim measure` of the chip with the paper's traps", unit="CPU-s")
    record.value("paper_charge_cpu", parts["charge moved back"], "charge moved back, the paper's traps", unit="CPU-s")


def shipped(paper: Path) -> Path:
    """Write the campaign of chip_stages.py with the shipped density of traps beside it; return its file."""
    folder = paper.parent / "shipped"
    folder.mkdir(exist_ok=True)
    content, science = yaml.safe_load(paper.read_text()), folder / "science.yaml"
    science.write_text(yaml.safe_dump(observation(None), sort_keys=False))
    content |= {"output": str(folder), "observations": {"SCIE": str(science)}}
    (folder / "campaign.yaml").write_text(yaml.safe_dump(content, sort_keys=False))
    return folder / "campaign.yaml"


def cheapest(file: Path, toy: bool) -> tuple[int, float, dict[str, float], float]:
    """Return (detections, all CPU s, {part: CPU s}, GB) of the r chip of a campaign, which is made if it is missing."""
    run = OpenCampaign(file)
    _, obsid, chip = next(jobs(run, ["r"]))
    job = run.job(obsid, chip)
    if toy or not run.paths.level0(job).exists():
        measured(file, obsid, chip)
    measure(file, obsid, chip)
    total, parts, memory = min((measure(file, obsid, chip) for _ in range(1 if toy else RUNS)), key=lambda run: run[0])
    return len(ObjectTable.read(run.paths.measure(*job.key), ["x"])), total, parts, memory


if __name__ == "__main__":
    main()
