"""Cost of variants of a detector's parameter on a finished whole chip whose light was kept; the bits are the same.

    python benchmarks/variants.py [--variants 5]

The chip of config/full_chip.yaml is selected and drawn once with `keep: light`. Then each variant, a density of traps,
is read out. Prints the CPU seconds of `csstsim readout` and `csstsim level0` of each with the start of the processes,
and the comparison by `csstsim compare` with a campaign alone. Exit code 1 if one takes more than MOST or a bit differs.
"""

import argparse
import shutil
import sys

import keep_light
import yaml
from keep_light import JOB, MOST, ROOT, campaign, run

from csstsim.campaign.opened import OpenCampaign

FOLDER = keep_light.FOLDER = ROOT / "results" / "variants"
DENSITIES = 0.01, 0.05, 0.1, 0.3, 1.0


def layers(name, density):
    """Write the layers with a density of traps; return the file."""
    keep_light.observe(density)
    return (FOLDER / "science.yaml").rename(FOLDER / f"{name}.yaml")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--variants", type=int, default=len(DENSITIES))
    FOLDER.mkdir(parents=True, exist_ok=True)
    files = {f"traps_{k}": layers(f"traps_{k}", DENSITIES[k]) for k in range(parser.parse_args().variants)}
    keep_light.observe(keep_light.BEFORE)
    variants = {name: {"observations": {"SCIE": str(file)}} for name, file in files.items()}
    base = campaign("base", keep="light", variants=variants)
    opened = OpenCampaign(base)
    for pix in opened.sky_bricks:
        if not opened.paths.truth(pix).exists():
            run("csstsim", "truth", base, "--brick", str(pix))
    run("csstsim", "psf", base, "--chip", JOB[-1])
    for stage in ("select", "render"):
        print(f"{stage}: {run('csstsim', stage, base, *JOB)[0]:.1f} CPU s")
    good = True
    for name, file in files.items():
        cpu = [run("csstsim", stage, f"{base}@{name}", *JOB)[0] for stage in ("readout", "level0")]
        print(f"{name}: readout {cpu[0]:.1f} + level0 {cpu[1]:.1f} = {sum(cpu):.1f} CPU s, most {MOST}")
        good &= sum(cpu) <= MOST
        alone = campaign("alone")
        content = yaml.safe_load(alone.read_text()) | {"observations": {"SCIE": str(file)}}
        alone.write_text(yaml.safe_dump(content))
        shutil.rmtree(FOLDER / "alone", ignore_errors=True)
        for kind in ("truth", "psf"):
            shutil.copytree(FOLDER / "base" / kind, FOLDER / "alone" / kind)
        run("csstsim", "chip", alone, *JOB)
        (made,) = (FOLDER / "base" / "variants" / name / "level0").rglob("*.fits")
        other = FOLDER / "alone" / made.relative_to(FOLDER / "base" / "variants" / name)
        print(run("csstsim", "compare", made, other)[1].strip())  # ends here if a bit differs
    return not good


if __name__ == "__main__":
    sys.exit(main())
