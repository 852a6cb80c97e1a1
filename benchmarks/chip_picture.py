"""A whole chip as it was read: all sixteen channels with prescan and overscan, logarithmic, with an inset.

    csstsim chip examples/release.yaml --obsid 10101000153 --chip 24    # i, as in the paper's figure; prints FILE
    python benchmarks/chip_picture.py FILE                              # docs/figures/i_chip.jpg

Shows DN over FLOOR, which lies below every channel's bias, as means of 8 x 8 pixels; the inset has single pixels. x, y
count from 0 on the mosaic of 10000 x 9400 px (docs/level0.md).
"""

import argparse
from pathlib import Path

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from csstsim.io.level0 import read_level0

BIN, FLOOR = 8, 430.0  # px; DN
TICKS = 20, 50, 100, 200, 400  # DN over FLOOR


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", type=Path)
    parser.add_argument("--inset", type=int, nargs=3, metavar=("X", "Y", "SIZE"), default=(7430, 6130, 720))
    parser.add_argument("--output", type=Path, default=Path("docs/figures/i_chip.jpg"))
    given = parser.parse_args()
    level0 = read_level0(given.file)
    frame = level0.frame()
    ny, nx = (n // BIN * BIN for n in frame.shape)
    coarse = frame[:ny, :nx].reshape(ny // BIN, BIN, nx // BIN, BIN).mean(axis=(1, 3)) - FLOOR
    x, y, size = given.inset
    part = frame[y : y + size, x : x + size] - FLOOR
    figure = Figure(figsize=(13, 7.2), layout="constrained")
    whole, inset = figure.subplots(1, 2, width_ratios=(1.45, 1))
    style = {"norm": LogNorm(TICKS[0], TICKS[-1]), "cmap": "magma", "origin": "lower"}
    shown = whole.imshow(np.maximum(coarse, 1.0), extent=(0, nx, 0, ny), **style)
    inset.imshow(np.maximum(part, 1.0), extent=(x, x + size, y, y + size), **style, interpolation="nearest")
    whole.add_patch(Rectangle((x, y), size, size, fill=False, ec="w", lw=1))
    bar = figure.colorbar(shown, ax=inset, location="bottom", label=f"DN - {FLOOR:.0f}", shrink=0.8)
    bar.set_ticks(TICKS, labels=[str(tick) for tick in TICKS])
    bar.minorticks_off()
    header = level0.header
    whole.set_title(f"{header['FILTER']}, chip {header['CHIPLAB']}: DN as read, means of {BIN} x {BIN} px", fontsize=10)
    inset.set_title(f"the white square: {size} x {size} px", fontsize=10)
    for axes in (whole, inset):
        axes.set(xlabel="x [px]", ylabel="y [px]")
    figure.savefig(given.output, dpi=95, pil_kwargs={"quality": 88})
    print(given.output, given.output.stat().st_size // 1000, "kB")


if __name__ == "__main__":
    main()
