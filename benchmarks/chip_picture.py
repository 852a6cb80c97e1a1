"""A whole chip as it was read: all sixteen channels with prescan and overscan, logarithmic, with an inset.

    python benchmarks/chip_picture.py [FILE]

FILE is a Level-0 file; without it chip 24 (i, as in the paper's figure) of examples/release.yaml is made if it is not
there. Shows DN over FLOOR, which lies below every channel's bias, as means of 8 x 8 pixels; the inset has single
pixels. x, y count from 0 on the mosaic of 10000 x 9400 px (docs/level0.md). Also the CPU time of `csstsim show`.
"""

import argparse
import tempfile
from pathlib import Path

from evidence.record import Record

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from start_of_stages import MAIN, cpu_seconds
from toy_campaign import made_frames

from csstsim.base.shipped import ROOT
from csstsim.campaign.opened import OpenCampaign
from csstsim.command_line.main import main as csstsim
from csstsim.io.level0 import read_level0

SHOWN = "10101000153", 24
BIN, FLOOR = 8, 430.0  # px; DN
TICKS = 20, 50, 100, 200, 400  # DN over FLOOR


def main() -> None:
    """Draw the picture."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", nargs="?", type=Path)
    parser.add_argument("--inset", type=int, nargs=3, metavar=("X", "Y", "SIZE"), default=(7430, 6130, 720))
    with Record(parser) as record:
        if record.toy:
            _, run = made_frames(record.results / "chip_picture")
            file, inset = run.paths.level0(run.jobs[0]), (20, 20, 60)
        else:
            file, inset = record.options.file or shown_chip(), record.options.inset
        picture(file, inset, record.figure("i_chip.jpg"))
        with tempfile.TemporaryDirectory() as folder:
            cpu, _ = cpu_seconds("-c", MAIN, "show", file, "--output", Path(folder) / "chip.png")
        record.value("show_cpu", cpu, "`csstsim show` of the whole chip", unit="CPU-s")


def shown_chip() -> Path:
    """Return the Level-0 file of the paper's figure, made if it is not there."""
    campaign = ROOT / "examples" / "release.yaml"
    run = OpenCampaign(campaign)
    job = run.job(*SHOWN)
    if not run.paths.level0(job).exists():
        csstsim(["chip", str(campaign), "--obsid", SHOWN[0], "--chip", str(SHOWN[1])], standalone_mode=False)
    return run.paths.level0(job)


def picture(file: Path, inset: tuple[int, int, int], target: Path) -> None:
    """Draw a Level-0 file and a square of it (x, y, side) [px]."""
    level0 = read_level0(file)
    frame = level0.frame()
    ny, nx = (n // BIN * BIN for n in frame.shape)
    coarse = frame[:ny, :nx].reshape(ny // BIN, BIN, nx // BIN, BIN).mean(axis=(1, 3)) - FLOOR
    x, y, size = inset
    part = frame[y : y + size, x : x + size] - FLOOR
    figure = Figure(figsize=(13, 7.2), layout="constrained")
    whole, near = figure.subplots(1, 2, width_ratios=(1.45, 1))
    style = {"norm": LogNorm(TICKS[0], TICKS[-1]), "cmap": "magma", "origin": "lower"}
    shown = whole.imshow(np.maximum(coarse, 1.0), extent=(0, nx, 0, ny), **style)
    near.imshow(np.maximum(part, 1.0), extent=(x, x + size, y, y + size), **style, interpolation="nearest")
    whole.add_patch(Rectangle((x, y), size, size, fill=False, ec="w", lw=1))
    bar = figure.colorbar(shown, ax=near, location="bottom", label=f"DN - {FLOOR:.0f}", shrink=0.8)
    bar.set_ticks(TICKS, labels=[str(tick) for tick in TICKS])
    bar.minorticks_off()
    header = level0.header
    whole.set_title(f"{header['FILTER']}, chip {header['CHIPLAB']}: DN as read, means of {BIN} x {BIN} px", fontsize=10)
    near.set_title(f"the white square: {size} x {size} px", fontsize=10)
    for axes in (whole, near):
        axes.set(xlabel="x [px]", ylabel="y [px]")
    figure.savefig(target, dpi=95, pil_kwargs={"quality": 88})


if __name__ == "__main__":
    main()
