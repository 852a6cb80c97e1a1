"""Draw the lens: python picture.py [PNG]      g, r, i in colour at two epochs, their difference, the GV spectrum."""

import sys

import matplotlib
import numpy as np
from astropy.visualization import make_lupton_rgb
from scipy.ndimage import shift

import csstsim

matplotlib.use("Agg")
import matplotlib.pyplot as plt

FIRST, CHIPS, GV, HALF = 10100000001, (8, 9, 7), 2, 34  # obsid of the first exposure; g, r, i; px
STRIP = 940, 500, 24  # px: the first order is from so far left of the lens to so far; half its height
CLEAN = {"cosmic_rays": None, "detector_defects": None, "CTE_effect": None}


def around(sim, obsid, chip, left=HALF, right=HALF, half=HALF):
    """Return the electrons around the lens, without sky; the lens is in the middle of a pixel."""
    frame = sim.chip(str(obsid), chip)
    x, y = (frame.truth[name][0] - 1 - low for name, low in (("xImage", frame.window.x0), ("yImage", frame.window.y0)))
    column, row = round(x), round(y)
    image = shift(frame.electrons - np.median(frame.electrons), (row - y, column - x), order=3)
    return image[row - half : row + half + 1, column - left : column + right + 1]


def main(path):
    """Simulate the frames and write the picture."""
    sim = csstsim.Simulation("campaign.yaml").replace(layers=CLEAN)
    one, two = ([around(sim, first + k, chip) for k, chip in enumerate(CHIPS)] for first in (FIRST, FIRST + 4))
    figure, axes = plt.subplot_mosaic([["one", "two", "change"], ["GV"] * 3], figsize=(10, 5), height_ratios=[3, 1.3])
    for name, title, (g, r, i) in (("one", "g, r, i", one), ("two", "60 days later", two)):
        axes[name].imshow(make_lupton_rgb(i, r, g, stretch=400, Q=9), origin="lower")
        axes[name].set_title(title)
    axes["change"].imshow(two[0] - one[0], origin="lower", cmap="RdBu", vmin=-1500, vmax=1500)
    axes["change"].set_title("change in g (blue: brighter)")
    left, right, half = STRIP
    strip = around(sim, FIRST + 3, GV, left, -right, half)
    axes["GV"].imshow(np.arcsinh(strip / 40), vmin=-0.5, origin="lower", cmap="magma", aspect="auto")
    axes["GV"].set_title("GV, first order: Mg II of the quasar's images, [O II] of the arcs")
    for axis in axes.values():
        axis.set_xticks([]), axis.set_yticks([])
    figure.tight_layout()
    figure.savefig(path, dpi=100)


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "lens.png")
