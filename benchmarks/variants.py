"""Cost of variants of a detector's parameter on a finished whole chip whose rendered electrons were kept; same bits.

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
import io
import re
import shutil

from evidence.record import Record

import keep_light
import yaml
from keep_light import BEFORE, JOB, MOST, ROOT, campaign, run
from PIL import Image
from toy_sky import toy_sky

from csstsim.campaign.config import load_campaign
from csstsim.campaign.opened import OpenCampaign

FOLDER = ROOT / "results" / "variants"
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


def cost(names, record):
    """Record the cost of variants. Ends the process if a bit differs."""
    variants = {name: keys(name) for name in names}
    keep_light.observe(BEFORE)
    small, runs = (keep_light.TOY | toy_sky(FOLDER, 300.09, -59.87), 1) if record.toy else ({}, RUNS)
    base = campaign("base", keep="light", variants=variants, **small)
    opened, rows = OpenCampaign(base), []
    for pix in opened.sky_bricks if opened.embedded else ():
        if not opened.paths.truth(pix).exists():
            run("csstsim", "truth", base, "--brick", str(pix))
    run("csstsim", "psf", base, "--chip", JOB[-1])
    for stage in ("select", "render"):
        record.value(
            f"{stage}_cpu", run("csstsim", stage, base, *JOB)[0], f"`csstsim {stage}` of the chip", unit="CPU-s"
        )
    for name, changed in variants.items():
        one = f"{base}@{name}"
        made = FOLDER / "base" / "variants" / name
        shutil.rmtree(made, ignore_errors=True)
        drawn = 0.0
        if not OpenCampaign(one).in_base(JOB[1], int(JOB[-1]), "render"):
            drawn = sum(run("csstsim", stage, one, *JOB)[0] for stage in ("select", "render"))
        cpu = [min(run("csstsim", stage, one, *JOB)[0] for _ in range(runs)) for stage in ("readout", "level0")]
        what = f"variant {name}: readout and level0"
        record.value(f"{name}_cpu", sum(cpu), what, unit="CPU-s", below=None if name in UNLIMITED else MOST)
        alone = campaign("alone", **small)
        alone.write_text(yaml.safe_dump(yaml.safe_load(alone.read_text()) | changed))
        shutil.rmtree(FOLDER / "alone", ignore_errors=True)
        for kind in ("truth", "psf") if opened.embedded else ("psf",):
            shutil.copytree(FOLDER / "base" / kind, FOLDER / "alone" / kind)
        whole, _ = run("csstsim", "chip", alone, *JOB)
        (file,) = (made / "level0").rglob("*.fits")
        other = FOLDER / "alone" / file.relative_to(made)
        said = run("csstsim", "compare", file, other)[1].strip()  # ends here if a bit differs
        print(said)
        rows.append([name, *(f"{v:.1f}" if v else "" for v in (drawn, *cpu, drawn + sum(cpu), whole))])
    header = ["variant", "rendering, CPU-s", "readout", "level0", "all", "from the beginning"]
    record.table("costs", header, rows)


def figure(record):
    """Draw variants.png: irradiated less shipped device, in r and GI, corrected in three passes."""
    changed = keys("irradiated")
    keep_light.observe(BEFORE)
    content = load_campaign(ROOT / "config/full_chip.yaml").model_dump(mode="json")
    select = content["select"] | {"chips": [9] if record.toy else [9, 10]}
    measurement = content["measurement"] | {"cti_passes": 3}
    small = {"window": WINDOW}
    if record.toy:
        small = toy_sky(FOLDER, 60.112, -40.035, 300, 0.02)
        small["window"] = {"x0": 4400, "x1": 4700, "y0": 4400, "y1": 4700}
    base = campaign(
        "figure", keep="light", variants={"irradiated": changed}, select=select, measurement=measurement, **small
    )
    keep_light.snakemake(base)
    page = OpenCampaign(base).paths.variants_page.read_text()
    (found,) = re.findall(r'src="data:image/webp;base64,([^"]+)"', page)
    Image.open(io.BytesIO(base64.b64decode(found))).save(record.figure("variants.png"), optimize=True)


def main() -> None:
    """Run what is asked for."""
    global FOLDER
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("variants", nargs="*", metavar="VARIANT", help=f"of {', '.join(VARIANTS)} [default: all]")
    parser.add_argument("--figure", action="store_true")
    with Record(parser) as record:
        given = record.options
        FOLDER = keep_light.FOLDER = record.results / ("variants_figure" if given.figure else "variants")
        FOLDER.mkdir(parents=True, exist_ok=True)
        if given.figure:
            figure(record)
        else:
            cost(given.variants or (list(VARIANTS)[:1] if record.toy else VARIANTS), record)


if __name__ == "__main__":
    main()
