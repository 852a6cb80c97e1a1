"""One galaxy through every layer: the image after each layer is added, and what that layer changed.

    python benchmarks/film_strip.py

A galaxy of r = 17 and a saturated star in an r exposure, the paper's density of traps. Light is the expected one
(`fidelity: noise_free`), so that photon noise comes with its layer. Electrons, with overscan and gain taken out.
"""

import argparse
import tempfile

from evidence.record import Record

import matplotlib
import numpy as np
from astropy.table import Table

import csstsim

matplotlib.use("agg")
from matplotlib import pyplot as plt
from matplotlib.colors import AsinhNorm, SymLogNorm

RA, DEC, SIZE, OBSID, CHIP = 150.1, 2.2, 150, "10100000001", 9
OBJECTS = {
    "ra": [RA - 0.0004, RA + 0.0009, RA - 0.0011, RA + 0.0002], "dec": [DEC, DEC + 0.0009, DEC - 0.001, DEC - 0.0012],
    "mag_r": [17.0, 14.6, 21.0, 20.5], "type": ["galaxy", "star", "star", "galaxy"], "size": [1.6, 0.0, 0.0, 0.5],
    "e1": [0.35, 0.0, 0.0, -0.2], "e2": [0.15, 0.0, 0.0, 0.1], "bulge_frac": [0.25, 0.0, 0.0, 0.0],
}  # fmt: skip
NEEDED = {"prescan_overscan", "bias", "gain", "quantization_and_output"}  # of a file that can be reduced
STEPS = (  # layers added at a time, and a caption
    (("scie_obs",), "objects and losses"), (("sky_background",), "sky"), (("PRNU_effect",), "pixels' response"),
    (("cosmic_rays", "poisson_and_dark"), "photon noise, dark,\ncosmic rays"),
    (("brighter_fatter",), "brighter-fatter"), (("detector_defects",), "defects"), (("blooming",), "blooming"),
    (("CTE_effect",), "charge transfer"), (("nonlinearity",), "nonlinearity"), (("readout_noise",), "read noise"),
)  # fmt: skip


def frames():
    """Return [(caption, electrons)] after each of STEPS."""
    with tempfile.TemporaryDirectory() as cache:
        sim = csstsim.Simulation(cache=cache).aim(RA, DEC, CHIP, size=SIZE, pa=20.0)
        sim = sim.replace(catalog=Table(OBJECTS), fidelity="noise_free", layers={"CTE_effect": {"density_scale": 1.0}})
        names, on, found = [next(iter(layer)) for layer in sim.layers], set(NEEDED), []
        for added, caption in STEPS:
            on.update(added)
            off = {name: None for name in names if name not in on}
            found.append((caption, sim.replace(layers=off).chip(OBSID, CHIP).electrons.astype(float)))
    return found


def main(record: Record) -> None:
    """Draw the strip: for each step the image, and below it the change."""
    found = frames()
    columns = len(found) // 2
    heights = (1, 1, 0.03, 1, 1)  # two rows of image and change, a gap between them
    figure, axes = plt.subplots(5, columns, figsize=(2.1 * columns, 9.5), height_ratios=heights, layout="constrained")
    before = np.zeros((SIZE, SIZE))
    for k, (caption, image) in enumerate(found):
        top, bottom = axes[3 * (k // columns) : 3 * (k // columns) + 2, k % columns]
        top.imshow(image, origin="lower", cmap="gray", norm=AsinhNorm(30.0, -30.0, 60_000.0))
        change = image - before
        largest = max(float(np.percentile(np.abs(change), 99.9)), 1.0)
        linear = max(float(np.percentile(np.abs(change), 50.0)), largest / 300.0, 0.1)
        same = np.percentile(change, 5) > 0.8 * largest  # the sky: half the scale, not its end
        record.value(f"change_{k + 1}", largest, f"largest change by {' '.join(caption.split())}", unit="e-")
        size = f"{largest:,.0f}" if largest >= 100 else f"{largest:.2g}"
        bottom.set_xlabel(f"change: {size} e\u207b everywhere" if same else f"change: up to {size} e\u207b", fontsize=8)
        largest, linear = (2 * largest, 2 * largest) if same else (largest, linear)
        bottom.imshow(change, origin="lower", cmap="RdBu_r", norm=SymLogNorm(linear, vmin=-largest, vmax=largest))
        top.set_title(f"{k + 1}. {'+ ' if k else ''}{caption}", fontsize=9)
        before = image
    for each in axes.flat:
        each.set(xticks=[], yticks=[])
    for gap in axes[2]:
        gap.axis("off")
    figure.savefig(record.figure("film_strip.png"), dpi=90)


if __name__ == "__main__":
    with Record(argparse.ArgumentParser(description=__doc__.splitlines()[0])) as record:
        main(record)
