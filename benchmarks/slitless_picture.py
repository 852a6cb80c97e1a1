"""A GV chip as in the paper's figure: the frame in a logarithmic stretch, with an inset of a star's orders.

    python benchmarks/standard_scene.py --chip 29 1 3     # makes the scene on a GV chip
    python benchmarks/slitless_picture.py                 # docs/figures/slitless.png

Shows electrons of the Level-0 file, after overscan and gain, as means of 8 x 8 pixels. The inset shows a star of some
1e7 electrons whose orders 0, 1 and 2 all lie on the chip.
"""

import argparse
from pathlib import Path

from evidence import ROOT
from evidence.record import Record

import matplotlib
import numpy as np
import yaml
from PIL import Image
from slitless_toy import toy_campaign

from csstsim.campaign.opened import OpenCampaign
from csstsim.io.orders import read_orders
from csstsim.stages import chip as chip_stage
from csstsim.stages.calibrate import calibrated_frame

matplotlib.use("agg")
from matplotlib import pyplot as plt
from matplotlib.colors import LogNorm
from matplotlib.patches import Rectangle

SCENE = ROOT / "results" / "standard_scene" / "chip_29" / "campaign.yaml"
BIN, ROWS = 8, 110
ELECTRONS = 1e7
NAMES = {0: "order 0", 1: "order +1", 2: "order +2"}


def campaign(folder: Path) -> Path:
    """Write the campaign of the scene with an output folder of its own; return its file."""
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / "campaign.yaml"
    file.write_text(yaml.safe_dump(yaml.safe_load(SCENE.read_text()) | {"output": str(folder)}, sort_keys=False))
    return file


def star(orders):
    """Return ({order: (x0, x1, y)}, electrons of the first) of the star on the chip with light nearest to ELECTRONS."""
    chosen = {}
    for row in np.unique(orders["row"][(orders["order"] == 1) & (orders["electrons"] > ELECTRONS / 4)]):
        mine = np.flatnonzero(orders["row"] == row)
        found = {int(orders["order"][k]): k for k in mine if orders["order"][k] in NAMES}
        if set(found) == set(NAMES) and all(orders["drawn"][k] > 0.9 * orders["electrons"][k] for k in found.values()):
            chosen[row] = found
    first = {row: abs(np.log(orders["electrons"][found[1]] / ELECTRONS)) for row, found in chosen.items()}
    found = chosen[min(first, key=first.get)]
    out = {}
    for order, k in found.items():
        wave = np.array([orders["wave_min"][k], orders["wave_max"][k]])
        ends = np.sort(orders["x"][k] + orders["p"][k] + orders["q"][k] * wave)
        out[order] = *ends, orders["y"][k] + orders["r"][k] + orders["s"][k] * wave.mean()
    return out, orders["electrons"][found[1]]


def main(record: Record) -> None:
    """Draw the chip, and its picture."""
    folder = record.results / "slitless_picture"
    run = OpenCampaign(toy_campaign(folder) if record.toy else campaign(folder))
    job = run.slitless_jobs[0]
    chip_stage.chip(run, job, log=lambda text: None)
    _, calibrated = calibrated_frame(run, job)
    image = np.maximum(calibrated.electrons, 1.0)
    places, electrons = star(read_orders(run.paths.level0_orders(job)))
    record.value("electrons", float(electrons), "of the first order of the star in the inset")
    ny, nx = (n // BIN * BIN for n in image.shape)
    coarse = image[:ny, :nx].reshape(ny // BIN, BIN, nx // BIN, BIN).mean(axis=(1, 3))
    sky = np.median(coarse)
    figure, (whole, inset) = plt.subplots(
        2, 1, figsize=(7.2, 9.2), height_ratios=(7, 1.7), layout="constrained", dpi=75
    )
    whole.imshow(coarse, norm=LogNorm(0.6 * sky, 12 * sky), cmap="magma", origin="lower", extent=(0, nx, 0, ny))
    whole.set_title(f"{job.chip.filter}, chip {job.chip.id}: electrons of 150 s, the standard scene", fontsize=10)
    whole.set_xlabel("x [px]")
    whole.set_ylabel("y [px]")
    ends, heights = [v for place in places.values() for v in place[:2]], [place[2] for place in places.values()]
    x0, x1 = max(int(min(ends)) - 80, 0), min(int(max(ends)) + 80, nx)
    y0 = int(np.clip(np.mean(heights) - ROWS, 0, ny - 2 * ROWS))
    part = image[y0 : y0 + 2 * ROWS, x0:x1]
    inset.imshow(part, norm=LogNorm(0.5 * sky, 100 * sky), cmap="magma", origin="lower", aspect="auto",
                 extent=(x0, x1, y0, y0 + 2 * ROWS), interpolation="antialiased")  # fmt: skip
    arrow = {"color": "w", "width": 0.5, "headwidth": 4}
    for order, (left, right, y) in places.items():
        at = (left + right) / 2, y - 12
        inset.annotate(NAMES[order], at, (0, -22), textcoords="offset points", color="w", ha="center", arrowprops=arrow)
    inset.set_xlabel("x [px]")
    whole.add_patch(Rectangle((x0, y0), x1 - x0, 2 * ROWS, fill=False, ec="w", lw=1))
    figure.set_dpi(75)
    figure.canvas.draw()
    picture = Image.fromarray(np.asarray(figure.canvas.buffer_rgba())).convert("RGB")
    picture.quantize(96).save(record.figure("slitless.png"), optimize=True)


if __name__ == "__main__":
    with Record(argparse.ArgumentParser(description=__doc__.splitlines()[0])) as record:
        main(record)
