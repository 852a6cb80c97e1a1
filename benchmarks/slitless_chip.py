"""A full-depth grating chip of the standard scene with all layers, catalogue to Level-0 file: CPU s by stage, memory.

    python benchmarks/standard_scene.py --chip 29 1 3     # makes the scene on a GV, a GI and a GU chip
    python benchmarks/slitless_chip.py [--chips 29 1 3]

Runs `csstsim chip` with the layers of science.yaml, once with the shipped traps of a young detector, once with the
density of traps of the paper's tests. A first run makes the PSF set and the compiled kernels; of three more the
cheapest counts.
"""

import argparse

import yaml
from chip_stages import PAPER, ROOT, RUNS, measured, observation

from csstsim.campaign.opened import OpenCampaign

TRAPS = {"traps as shipped": None, "the paper's traps": 1.0}


def campaign(number, traps):
    """Write the campaign of the scene on a chip, with all layers; return its file."""
    folder = ROOT / "results" / "standard_scene" / f"chip_{number:02d}"
    content = yaml.safe_load((folder / "campaign.yaml").read_text())
    (folder / "science.yaml").write_text(yaml.safe_dump(observation(traps), sort_keys=False))
    content["observations"] = {"SCIE": str(folder / "science.yaml")}
    file = folder / "all_layers.yaml"
    file.write_text(yaml.safe_dump(content, sort_keys=False))
    return file


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--chips", type=int, nargs="+", default=[29, 1, 3])
    parser.add_argument("--runs", type=int, default=RUNS)
    options = parser.parse_args()
    for number in options.chips:
        for name, traps in TRAPS.items():
            show(number, name, campaign(number, traps), options.runs)


def show(number, name, file, count):
    """Run the chip and print its cost."""
    job = OpenCampaign(file).jobs[0]
    runs = [measured(file, *map(str, job.key)) for _ in range(count + 1)][1:]
    stages, total, memory, said = min(runs, key=lambda run: run[1])
    objects = next(line.split()[0] for line in said.splitlines() if "objects reach" in line)
    parts = ", ".join(f"{stage} {cpu:.1f}" for stage, cpu in stages.items())
    print(
        f"{job.chip.filter}, chip {number}, {objects} objects, {name}: {total:.1f} CPU s ({parts}, start-up "
        f"{total - sum(stages.values()):.1f}), {memory:.2f} GB private; a factor {PAPER / total:.0f} below the "
        "paper's mean; all runs " + ", ".join(f"{run[1]:.1f}" for run in runs),
        flush=True,
    )


if __name__ == "__main__":
    main()
