"""The map of the focal plane: the chips with their numbers, filters and gratings, and the pixels to aim at.

python benchmarks/focal_plane.py            # docs/figures/focal_plane.png
"""

import argparse
from pathlib import Path

from evidence.record import Record

import matplotlib
import numpy as np

from csstsim.base.shipped import SHIPPED
from csstsim.instrument.camera import Camera, load_camera
from csstsim.optics.geometry.pointing_for import aim_point
from csstsim.report.style import band_styles

matplotlib.use("agg")
from matplotlib import pyplot as plt


def report_orders(camera: Camera, record: Record) -> None:
    """Record how far a target's first order lands from its undispersed position, where it is aimed at."""
    far = []
    for number, gratings in camera.gratings.items():
        target = aim_point(camera, camera.chips[number]).target
        for grating, _ in gratings.pieces:
            p, q, *_ = grating.orders[1].lines(*target)
            far += [abs(p + q * wave) for wave in grating.orders[1].range]
    for word, distance in (("minimum", min(far)), ("maximum", max(far))):
        what = f"distance of the first order from the undispersed position, {word} over gratings and wavelengths"
        record.value(f"first_order_{word}", distance, what, unit="px")


def draw(camera: Camera, path: Path) -> None:
    """Draw the map, +x to the right and +y up, in arcmin from the boresight."""
    scale, shown = camera.telescope.pixel_scale / 60.0, band_styles(camera.filters)
    figure, axes = plt.subplots(figsize=(8.0, 7.4), layout="constrained")
    for chip in camera.chips.values():
        nx, ny = chip.detector.nx, chip.detector.ny

        def place(x, y, chip=chip, nx=nx, ny=ny):
            turn = np.radians(chip.rotation)
            u, v = np.asarray(x) - (nx - 1) / 2, np.asarray(y) - (ny - 1) / 2
            c, s = np.cos(turn), np.sin(turn)
            return (chip.xc + c * u - s * v) * scale, (chip.yc + s * u + c * v) * scale

        colour = shown[chip.filter.lower()].colour
        axes.fill(*place([0, nx, nx, 0], [0, 0, ny, ny]), facecolor=colour, alpha=0.18)
        axes.plot(*place([0, nx, nx, 0, 0], [0, 0, ny, ny, 0]), color=colour, lw=1.0)
        if chip.kind == "slitless":
            split = camera.gratings[chip.id].split
            axes.plot(*place([split, split], [0, ny]), color=colour, lw=0.8, ls="--")
        axes.plot(*place(*aim_point(camera, chip).target), marker="+", color="black", ms=7, ls="")
        at = place((nx - 1) / 2, 0.74 * ny)
        axes.annotate(f"{chip.id}  {chip.filter}", at, ha="center", va="center", fontsize=11, weight="bold")
    axes.plot(0, 0, marker="o", ms=6, mfc="white", mec="black", ls="")
    axes.annotate(
        "ra, dec of the survey table",
        (0, 0),
        (0, -34.5),
        ha="center",
        fontsize=9,
        arrowprops={"arrowstyle": "-", "lw": 0.8},
    )
    axes.set(
        xlabel="+x: east at pa = 0 [arcmin]", ylabel="+y: north at pa = 0 [arcmin]", aspect="equal", ylim=(-37, None)
    )
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    with Record(parser) as record:
        camera = load_camera(SHIPPED / "instrument")
        draw(camera, record.figure("focal_plane.png"))
        report_orders(camera, record)
