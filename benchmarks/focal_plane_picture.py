"""A whole exposure in colour: its 30 chips where they are on the focal plane, and zooms down to single pixels.

    python benchmarks/focal_plane_picture.py     # docs/figures/exposure.jpg, docs/_static/exposure.html

Makes the Level-0 files that are not there yet (twenty CPU-minutes, as `csstsim chip config/c9_w5.yaml --obsid
10105000113 --chip N` does). Reads Level-0 files: electrons above each channel's overscan, nothing else corrected, in
means of STEP x STEP pixels.
Each chip has the colour of its filter, and an asinh stretch above its median. The page zooms (exposure_page.py).
"""

import argparse
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

from evidence.record import Record

import matplotlib
import numpy as np

from csstsim.base.shipped import ROOT
from csstsim.campaign.opened import OpenCampaign
from csstsim.instrument.chip import Window
from csstsim.io.level0 import read_level0
from csstsim.report.thumbnail import binned

matplotlib.use("agg")
from exposure_page import write_page
from matplotlib import pyplot as plt
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.patches import ConnectionPatch, Rectangle
from matplotlib.transforms import Affine2D
from toy_campaign import made_frames

CAMPAIGN, OBSID = ROOT / "config" / "c9_w5.yaml", "10105000113"
PAGE = ROOT / "docs" / "_static" / "exposure.html"
BLACK, GREY = "#06070b", "#a3a9b6"  # of the page; of its text
TINTS = {  # violet to red, as the eye sees them; gratings paler
    "NUV": "#a77bf3", "u": "#5f7dff", "g": "#27b7c4", "r": "#55c04a", "i": "#e8b92e", "z": "#f07f2e", "y": "#dd4a4a",
    "GU": "#8f9be8", "GV": "#86c9b4", "GI": "#dba08c",
}  # fmt: skip
STEP = 24  # px of a chip to one of the picture
ZOOMS = (  # chip, x0, y0, side, step [px]: each panel of the last row after that of the first one's chip
    (9, 4300, 4000, 1600, 2), (9, 4836, 4235, 200, 1), (29, 1000, 6000, 1600, 2),
)  # fmt: skip
SIDE, GAP, HEAD, STRIP, FOOT, DPI = 400, 16, 52, 54, 34, 100  # px of the picture: panels, margins, lines of text
LABEL = 900  # px of the focal plane below a chip, for its number
WHITE, GROWS, SOFT = 60.0, 0.6, 4.0  # sigma above the median: white at a step of 1 px, and the linear part


class Shown(NamedTuple):
    """A part of a chip in colour, (ny, nx, 3) uint8, first row at the bottom."""

    chip: object
    window: Window
    step: int
    rgb: np.ndarray


def stretched(image, tint, step):
    """Return an image in a filter's colour (ny, nx, 3) uint8: black to the tint to white, asinh above the median."""
    white = WHITE * step**GROWS
    level = np.nanmedian(image)
    noise = 1.4826 * np.nanmedian(np.abs(image - level))
    low, high = np.arcsinh(-2.0 / SOFT), np.arcsinh(white / SOFT)
    shade = (np.arcsinh((np.nan_to_num(image, nan=level) - level) / noise / SOFT) - low) / (high - low)
    colours = LinearSegmentedColormap.from_list("", [(0.0, BLACK), (0.6, tint), (1.0, "white")], 1024)
    return colours(np.clip(shade, 0.0, 1.0), bytes=True)[..., :3]


def pictures(run, obsid, zooms_of):
    """Return ({chip: Shown of the whole chip}, [Shown of zooms_of, in the form of ZOOMS]) of an exposure's files."""
    whole, zooms = {}, {}
    for job in run.jobs:
        if job.obsid != obsid:
            continue
        chip, tint = job.chip, TINTS[job.chip.filter]
        file = read_level0(run.paths.level0(job))
        whole[chip.id] = Shown(
            chip, chip.full_window, STEP, stretched(binned(file, chip.full_window, STEP), tint, STEP)
        )
        for k, (number, x0, y0, side, step) in enumerate(zooms_of):
            if number == chip.id:
                window = Window(x0, x0 + side, y0, y0 + side)
                zooms[k] = Shown(chip, window, step, stretched(binned(file, window, step), tint, step))
    return whole, [zooms[k] for k in sorted(zooms)]


def corner(chip, window):
    """Return where the first pixel of a window lies on the focal plane [px], before the chip's turn."""
    return chip.xc - chip.detector.nx / 2 + window.x0, chip.yc - chip.detector.ny / 2 + window.y0


def put(axes, shown):
    """Draw a part of a chip in its place: axes in px of the focal plane, +x to the right, +y up. Return its turn."""
    chip, (ny, nx) = shown.chip, shown.rgb.shape[:2]
    x0, y0 = corner(chip, shown.window)
    turn = Affine2D().rotate_deg_around(chip.xc, chip.yc, chip.rotation) + axes.transData
    extent = (x0, x0 + nx * shown.step, y0, y0 + ny * shown.step)
    axes.imshow(shown.rgb, origin="lower", extent=extent, interpolation="antialiased").set_transform(turn)
    return turn


def draw_plane(axes, whole, marked):
    """Draw all chips with number and filter below each; white outlines for those in `marked`."""
    for shown in whole.values():
        chip, tint = shown.chip, TINTS[shown.chip.filter]
        turn = put(axes, shown)
        outline = Rectangle(corner(chip, shown.window), chip.detector.nx, chip.detector.ny, fill=False, lw=0.9)
        axes.add_patch(outline)
        outline.set(edgecolor="white" if chip.id in marked else tint, alpha=1 if chip.id in marked else 0.5)
        outline.set_transform(turn)
        foot = chip.yc - chip.detector.ny / 2 - 0.15 * LABEL
        axes.text(chip.xc, foot, f"{chip.id}  {chip.filter}", color=tint, size=10.5, ha="center", va="top")
    x, y = np.array([(c.xc, c.yc) for c in (s.chip for s in whole.values())]).T
    nx, ny = (max(getattr(s.chip.detector, n) for s in whole.values()) / 2 + 100 for n in ("nx", "ny"))
    axes.set(xlim=(x.min() - nx, x.max() + nx), ylim=(y.min() - ny - LABEL, y.max() + ny), aspect="equal")
    axes.axis("off")


def draw_panels(figure, place, whole, zooms):
    """Draw the last row: the first zoom's chip, then the zooms; a box shows each in the panel before it."""
    panels, before = [whole[zooms[0].chip.id], *zooms], None
    for k, shown in enumerate(panels):
        axes = figure.add_axes(place(GAP + k * (SIDE + GAP), FOOT, SIDE, SIDE))
        w, chip = shown.window, shown.chip
        axes.imshow(shown.rgb, origin="lower", extent=(w.x0, w.x1, w.y0, w.y1), interpolation="antialiased")
        axes.set(xticks=[], yticks=[])
        axes.spines[:].set(color="white", linewidth=0.8)
        arcmin = w.nx * chip.telescope.pixel_scale / 60.0
        size = f"{arcmin:.1f}\u2032" if arcmin > 1 else f"{60 * arcmin:.0f}\u2033"
        text = f"chip {chip.id}, {chip.filter}: {w.nx} \u00d7 {w.ny} px, {size}"
        axes.text(0.5, -0.03, text, transform=axes.transAxes, color=TINTS[chip.filter], size=10, ha="center", va="top")
        if before is not None and before[1].chip is chip:
            before[0].add_patch(Rectangle((w.x0, w.y0), w.nx, w.ny, fill=False, ec="white", lw=0.9))
            for y in (w.y0, w.y1):
                figure.add_artist(ConnectionPatch(
                    (w.x1, y), (w.x0, y), "data", "data", axesA=before[0], axesB=axes, color="white", lw=0.6, alpha=0.7
                ))  # fmt: skip
        before = axes, shown


def draw_strip(figure, width, y, height, filters):
    """Write each filter's name and wavelengths, in its colour, on a line `y` px above the bottom."""
    step = (width - 2 * GAP) / len(TINTS)
    for k, (name, tint) in enumerate(TINTS.items()):
        wave = filters[name].wavelength[filters[name].throughput > 0.5 * filters[name].throughput.max()] / 10.0
        text = f"{name}  {wave.min():.0f}\u2013{wave.max():.0f} nm"
        figure.text((GAP + (k + 0.5) * step) / width, y / height, text, color=tint, size=10.5, ha="center", va="center")


def draw(run, whole, zooms, obsid, output):
    """Write the picture: title, focal plane, colours, zooms."""
    width = GAP + (len(zooms) + 1) * (SIDE + GAP)
    axes = plt.figure(facecolor=BLACK, dpi=DPI).add_axes((0, 0, 1, 1))
    figure = axes.figure
    draw_plane(axes, whole, {zoom.chip.id for zoom in zooms})
    (x0, x1), (y0, y1) = axes.get_xlim(), axes.get_ylim()
    tall = (width - 2 * GAP) * (y1 - y0) / (x1 - x0)
    below = FOOT + SIDE + STRIP
    height = below + tall + HEAD

    def place(x, y, nx, ny):
        return x / width, y / height, nx / width, ny / height

    figure.set_size_inches(width / DPI, height / DPI)
    axes.set_position(place(GAP, below, width - 2 * GAP, tall))
    draw_strip(figure, width, FOOT + SIDE + STRIP / 2, height, run.camera.filters)
    draw_panels(figure, place, whole, zooms)
    megapixels = sum(s.chip.detector.nx * s.chip.detector.ny for s in whole.values()) / 1e6
    title = f"One exposure of the Survey Camera, simulated: {len(whole)} chips, {megapixels:,.0f} million pixels"
    figure.text(0.5, 1 - 0.5 * HEAD / height, title, color="white", size=15, ha="center", va="center")
    figure.savefig(output, dpi=DPI, facecolor=BLACK, pil_kwargs={"quality": 80, "optimize": True})


def main() -> None:
    """Draw the picture and the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("campaign", nargs="?", type=Path, default=CAMPAIGN)
    parser.add_argument("--obsid", default=OBSID)
    parser.add_argument("--folder", type=Path, help="of the campaign's output, if it is another one")
    with Record(parser) as record:
        options = record.options
        if record.toy:
            options.obsid, page = "10100000001", record.results / "exposure.html"
            _, run = made_frames(record.results / "exposure", select={"types": ["SCIE"], "chips": [8, 9]})
            zooms = (9, 20, 20, 100, 1), (9, 40, 40, 50, 1)
        else:
            run, page, zooms = OpenCampaign(options.campaign, options.folder), PAGE, ZOOMS
            make_missing(options.campaign, run, options.obsid)
        whole, zoomed = pictures(run, options.obsid, zooms)
        draw(run, whole, zoomed, options.obsid, record.figure("exposure.jpg"))
        write_page(page, list(whole.values()), zoomed, TINTS)


def make_missing(campaign: Path, run: OpenCampaign, obsid: str) -> None:
    """Make the Level-0 files of an exposure that are not there, each in a process of its own."""
    program = Path(sys.executable).parent / "csstsim"
    for job in run.jobs:
        if job.obsid == obsid and not run.paths.level0(job).exists():
            words = [program, "chip", campaign, "--obsid", obsid, "--chip", job.chip.id]
            subprocess.run([str(word) for word in words], check=True, stdout=subprocess.DEVNULL)


if __name__ == "__main__":
    main()
