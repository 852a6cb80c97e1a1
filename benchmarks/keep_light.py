"""Cost of another detector if a chip's rendered electrons were kept: rules that run again, CPU seconds; same bits.

    python benchmarks/keep_light.py [--runs 5]

The campaign of config/full_chip.yaml with `keep: light` is made once (five minutes). Then a parameter of the readout
is changed. Prints the rules that Snakemake would run, and those it runs; the CPU seconds of `csstsim readout` and
`csstsim level0` with the start of each process (median of runs); and the comparison by `csstsim compare` with a chip
made from nothing. Exit code 1 if render is among the rules, if readout and level0 take more than MOST, or if a bit
differs. At toy size the campaign has a small window.
"""

import argparse
import re
import shutil
import statistics
import sys
from pathlib import Path

from evidence.record import Record

import yaml
from start_of_stages import cpu_seconds
from toy_sky import toy_sky

from csstsim.campaign.config import load_campaign
from csstsim.campaign.opened import OpenCampaign

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "results" / "keep_light"
JOB = "--obsid", "10100000004", "--chip", "9"
BEFORE, AFTER = 0.02, 0.03  # density of traps; the shipped one first
TOY = {"window": {"x0": 5000, "x1": 5300, "y0": 4500, "y1": 4800}}
MOST = 6.0  # CPU s per chip
AGAIN = {"readout", "level0", "look", "measure", "merge", "validate", "report"}


def run(name, *arguments):
    """Return (user and system seconds, output) of a command of this environment."""
    return cpu_seconds(Path(sys.executable).parent / name, *arguments)


def campaign(name, **changes):
    """Write a campaign of the name `name` with an output of its own; return its file."""
    content = load_campaign(ROOT / "config/full_chip.yaml").model_dump(mode="json")
    content |= {"name": "keep_light", "output": str(FOLDER / name)} | changes
    content["observations"] = {"SCIE": str(FOLDER / "science.yaml")}
    file = FOLDER / f"{name}.yaml"
    file.write_text(yaml.safe_dump(content, sort_keys=False))
    return file


def observe(density_scale):
    """Write the layers of config/observations/science.yaml with another density of traps, a number of the readout."""
    content = yaml.safe_load((ROOT / "config/observations/science.yaml").read_text())
    step = next(entry for entry in content["layers"] if "CTE_effect" in entry)
    step["CTE_effect"] = (step["CTE_effect"] or {}) | {"density_scale": density_scale}
    (FOLDER / "science.yaml").write_text(yaml.safe_dump(content, sort_keys=False))


def snakemake(file, *more):
    """Return the rules that Snakemake runs, or would."""
    _, said = run("snakemake", "--profile", "profiles/default", *more, "--config", f"campaign={file}")
    return set(re.findall(r"^(\w+) +\d+$", said, re.MULTILINE)) - {"all", "total"}


def main() -> None:
    """Make the campaign, change the readout, and compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=5)
    with Record(parser) as record:
        compare(record)


def compare(record: Record) -> None:
    """Make the campaign twice, of which one kept the light, and record what a changed readout costs."""
    runs, window = record.options.runs, {}
    if record.toy:
        runs, window = 1, TOY | toy_sky(FOLDER, 300.09, -59.87)
    FOLDER.mkdir(parents=True, exist_ok=True)
    observe(BEFORE)
    kept, fresh = campaign("kept", keep="light", **window), campaign("fresh", **window)
    snakemake(kept)
    place = OpenCampaign(kept).paths.chips / "10100000004_09"
    size = sum(path.stat().st_size for path in place.iterdir())
    record.value("kept_gb", size / 1e9, "kept of a chip", unit="GB")
    print(f"kept files: ({', '.join(sorted(path.name for path in place.iterdir()))})")

    observe(AFTER)
    again = snakemake(kept, "--dry-run")
    rules = ", ".join(sorted(again))
    record.value("rules", rules, "rules that a changed parameter of CTE_effect runs again", goal=again == AGAIN)
    snakemake(kept, "--until", "level0")
    cpu = {
        stage: statistics.median(run("csstsim", stage, kept, *JOB)[0] for _ in range(runs))
        for stage in ("readout", "level0")
    }
    (place / "readout.fits").unlink()
    total = sum(cpu.values())
    for stage, seconds in cpu.items():
        record.value(f"{stage}_cpu", seconds, f"`csstsim {stage}` of the chip", unit="CPU-s")
    record.value("again_cpu", total, "both", unit="CPU-s", below=MOST)

    shutil.rmtree(FOLDER / "fresh", ignore_errors=True)
    for name in ("psf",) if record.toy else ("truth", "psf"):  # they do not depend on the detector
        shutil.copytree(FOLDER / "kept" / name, FOLDER / "fresh" / name)
    whole, _ = run("csstsim", "chip", fresh, *JOB)
    record.value("whole_cpu", whole, "the chip from the beginning", unit="CPU-s")
    files = sorted(path for path in (FOLDER / "kept" / "level0").rglob("*") if path.is_file())
    for path in files:
        other = FOLDER / "fresh" / path.relative_to(FOLDER / "kept")
        print(run("csstsim", "compare", path, other)[1].strip())  # ends here if a bit differs


if __name__ == "__main__":
    main()
