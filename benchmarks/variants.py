"""Cost of variants of a detector's parameter on a finished whole chip whose light was kept; the bits are the same.

    python benchmarks/variants.py                 # the table of docs/variants.md
    python benchmarks/variants.py gain irradiated # some of them
    python benchmarks/variants.py --figure        # docs/figures/variants.png: two detectors on the same light

The chip of config/full_chip.yaml is selected and drawn once with `keep: light`. Then each variant is read out. Prints
the CPU seconds of `csstsim readout` and `csstsim level0` of each, the least of RUNS with the start of the processes, of
`csstsim render` where its light is another one, and the comparison by `csstsim compare` with a campaign alone. Exit
code 1 if one of those with a limit takes more than MOST, or a bit differs.
"""

import argparse
import base64
import re
import shutil
import sys

import keep_light
import yaml
from keep_light import BEFORE, JOB, MOST, ROOT, campaign, run

from csstsim.campaign.config import load_campaign
from csstsim.campaign.opened import OpenCampaign

FOLDER = keep_light.FOLDER = ROOT / "results" / "variants"
VARIANTS = {  # name: changed numbers of the camera, or the density of traps
    "gain": {"detector.gain": 1.4, "detector.gain_spread": 0.03},
    "nonlinearity": {"detector.nonlinearity_quadratic": -1.0e-6, "detector.nonlinearity_cubic": 2.0e-12},
    "bias": {"detector.bias": 800.0, "detector.bias_spread": 60.0},
    "brighter_fatter": {"brighter_fatter.scale": 1.0},
    "traps": 0.05,
    "irradiated": 1.0,
    "read_noise": {"detector.read_noise": 8.0},
}
RUNS = 3  # of a stage; the least is taken, as other work on the machine only adds
WINDOW = {"x0": 3000, "x1": 4600, "y0": 3000, "y1": 4500}  # px, of the figure
UNLIMITED = {"irradiated", "read_noise"}  # fifty times the traps; fainter objects may be drawn with less care


def keys(name):
    """Return {key: value} of a variant."""
    change = VARIANTS[name]
    if isinstance(change, dict):
        return {"instrument": change}
    keep_light.observe(change)
    return {"observations": {"SCIE": str((FOLDER / "science.yaml").rename(FOLDER / f"{name}.yaml"))}}


def cost(names):
    """Print the cost of variants; return whether all keep their limit. Ends the process if a bit differs."""
    variants = {name: keys(name) for name in names}
    keep_light.observe(BEFORE)
    base = campaign("base", keep="light", variants=variants)
    opened = OpenCampaign(base)
    for pix in opened.sky_bricks:
        if not opened.paths.truth(pix).exists():
            run("csstsim", "truth", base, "--brick", str(pix))
    run("csstsim", "psf", base, "--chip", JOB[-1])
    for stage in ("select", "render"):
        print(f"{stage}: {run('csstsim', stage, base, *JOB)[0]:.1f} CPU s", flush=True)
    good = True
    for name, changed in variants.items():
        one = f"{base}@{name}"
        made = FOLDER / "base" / "variants" / name
        shutil.rmtree(made, ignore_errors=True)
        drawn = 0.0
        if not OpenCampaign(one).in_base(JOB[1], int(JOB[-1]), "render"):
            drawn = sum(run("csstsim", stage, one, *JOB)[0] for stage in ("select", "render"))
        cpu = [min(run("csstsim", stage, one, *JOB)[0] for _ in range(RUNS)) for stage in ("readout", "level0")]
        limit = "" if name in UNLIMITED else f", most {MOST}"
        light = f"light {drawn:.1f} + " if drawn else ""
        print(f"{name}: {light}readout {cpu[0]:.1f} + level0 {cpu[1]:.1f} = {drawn + sum(cpu):.1f} CPU s{limit}")
        good &= name in UNLIMITED or sum(cpu) <= MOST
        alone = campaign("alone")
        alone.write_text(yaml.safe_dump(yaml.safe_load(alone.read_text()) | changed))
        shutil.rmtree(FOLDER / "alone", ignore_errors=True)
        for kind in ("truth", "psf"):
            shutil.copytree(FOLDER / "base" / kind, FOLDER / "alone" / kind)
        whole, _ = run("csstsim", "chip", alone, *JOB)
        (file,) = (made / "level0").rglob("*.fits")
        other = FOLDER / "alone" / file.relative_to(made)
        said = run("csstsim", "compare", file, other)[1].strip()  # ends here if a bit differs
        print(f"  from nothing {whole:.1f} CPU s; compare: {said}", flush=True)
    return good


def figure():
    """Draw docs/figures/variants.png: irradiated less shipped device, in r and GI, corrected in three passes."""
    changed = keys("irradiated")
    keep_light.observe(BEFORE)
    content = load_campaign(ROOT / "config/full_chip.yaml").model_dump(mode="json")
    select = content["select"] | {"chips": [9, 10]}
    measurement = content["measurement"] | {"cti_passes": 3}
    base = campaign(
        "figure", keep="light", variants={"irradiated": changed}, window=WINDOW, select=select, measurement=measurement
    )
    keep_light.snakemake(base)
    page = OpenCampaign(base).paths.variants_page.read_text()
    (found,) = re.findall(r'src="data:image/png;base64,([^"]+)"', page)
    (ROOT / "docs/figures/variants.png").write_bytes(base64.b64decode(found))
    return True


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("variants", nargs="*", metavar="VARIANT", help=f"of {', '.join(VARIANTS)} [default: all]")
    parser.add_argument("--figure", action="store_true")
    given = parser.parse_args()
    FOLDER.mkdir(parents=True, exist_ok=True)
    return not (figure() if given.figure else cost(given.variants or VARIANTS))


if __name__ == "__main__":
    sys.exit(main())
