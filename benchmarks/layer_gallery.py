"""Gallery of the layers, each alone on the same stamp: before, after, difference.

    python benchmarks/layer_gallery.py [--folder results/bench]

Layers that add light start from an empty image or from the light they add to, others from the electrons of objects and
sky, expected or counted (layer_cells.py). layer_stamp.py describes the stamp. Writes layers_light.png and
layers_charge.png, and prints one measured number for each layer.
"""

import argparse
from pathlib import Path

from evidence.record import Record

import numpy as np
from layer_cells import GALLERY
from layer_stamp import STEPS, find_stamp
from matplotlib import colormaps
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import AsinhNorm, Normalize
from matplotlib.figure import Figure
from PIL import Image

from csstsim.studies.bench.setting import make_setting

DPI, PANEL, GAP, TOP = 100, 192, 4, 56  # px of the picture; a pixel of the stamp has 2 x 2 of them
CELL_X, CELL_Y, EDGE = 604, 282, 6
SHADES = 49  # of a colour map: odd, so that zero is white; few, so that the files stay small
UNITS = {"electron": "e\u207b", "DN": "DN"}


def draw(stamp, names, path):
    """Write the cells of these layers, two in a row, as one picture; return what was measured of each."""
    size = np.array([2 * (CELL_X - EDGE), -(-len(names) // 2) * CELL_Y])
    figure, found = Figure(figsize=size / DPI, dpi=DPI), []
    for i, name in enumerate(names):
        corner = EDGE + i % 2 * CELL_X, size[1] - i // 2 * CELL_Y
        found.append(_draw_cell(figure, lambda x, y, corner=corner: (corner + np.array([x, -y])) / size, stamp, name))
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    picture = np.asarray(canvas.buffer_rgba())[..., :3] | 3  # 64 greys, so that a palette holds all colours
    Image.fromarray(picture).quantize(256, dither=Image.Dither.NONE).save(path, optimize=True)
    return found


def _draw_cell(figure, place, stamp, name):
    """Draw one layer's cell; return its name and number.

    place: function of px right and down from the cell's upper left corner.
    """
    cell, step = GALLERY[name], STEPS[name]
    before, after, laid, header = stamp.pair(cell.base, name)
    difference = cell.difference(laid, after)
    number = cell.number(before, after, difference, header)
    figure.text(*place(0, 22), step.keyword, size=10.5, weight="bold")
    figure.text(*place(3 * PANEL + 2 * GAP, 22), number, size=9, ha="right")
    figure.text(*place(0, 37), f"{step.module.STAGE}: {cell.what}", size=8.5, color="0.3")
    before, after, difference = (image[cell.part] for image in (before, after, difference))
    units = [UNITS[unit] for unit in step.module.UNITS]
    grey = _norm(*cell.grey), "gray"
    _draw_panel(figure, place, 0, before, *grey, f"before [{units[0]}]")
    shown = _draw_panel(figure, place, 1, after, *grey, f"after [{units[1]}]")
    _draw_bar(figure, place, (PANEL + GAP) // 2, shown)
    shown = _draw_panel(figure, place, 2, difference, _norm(-cell.colour[1], *cell.colour), "RdBu_r", cell.label)
    _draw_bar(figure, place, 2 * (PANEL + GAP), shown)
    return [f"`{step.keyword}`", number]


def _draw_panel(figure, place, column, image, norm, colours, title):
    """Draw an image in the middle of its column, each pixel as a whole number of the picture's pixels."""
    left, (height, width) = column * (PANEL + GAP), np.array(image.shape) * (PANEL // max(image.shape))
    figure.text(*place(left + PANEL / 2, TOP - 4), title, size=8, ha="center")
    axes = _axes(figure, place, left + (PANEL - width) // 2, TOP + (PANEL - height) // 2, width, height)
    axes.set(xticks=[], yticks=[])
    axes.spines[:].set(linewidth=0.5, color="0.6")
    return axes.imshow(image, norm=norm, cmap=colormaps[colours].resampled(SHADES), origin="lower")


def _draw_bar(figure, place, left, shown):
    """Draw the scale of a panel, below the column that begins at `left`."""
    axes = _axes(figure, place, left + 14, TOP + PANEL + 4, PANEL - 28, 6)
    bar = figure.colorbar(shown, cax=axes, orientation="horizontal")
    ticks = [float(f"{tick:.1g}") for tick in shown.norm.inverse(np.linspace(0, 1, 5))]
    bar.set_ticks(ticks, labels=[f"{t:g}" if abs(t) < 1e4 else f"{t:.0e}".replace("e+0", "e") for t in ticks])
    bar.minorticks_off()
    bar.outline.set_linewidth(0.5)
    axes.tick_params(labelsize=7.5, length=2, pad=1)


def _axes(figure, place, x, y, width, height):
    low, high = place(x, y + height), place(x + width, y)
    return figure.add_axes((*low, *(high - low)))


def _norm(low, width, high):
    return Normalize(low, high) if width is None else AsinhNorm(width, low, high)


def main() -> None:
    """Draw both pictures; record what the layers did."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--folder", type=Path, default=Path("results/bench"), help="of the PSF set, made if missing")
    with Record(parser) as record:
        folder = record.options.folder
        folder.mkdir(parents=True, exist_ok=True)
        stamp = find_stamp(make_setting(folder, "r"))
        print(f"chip {stamp.setting.chip.id}, seed {stamp.seed}, exposure {stamp.obsid}, {stamp.window}")
        names = list(GALLERY)[: 4 if record.toy else None]
        rows = draw(stamp, names[: len(names) // 2], record.figure("layers_light.png"))
        rows += draw(stamp, names[len(names) // 2 :], record.figure("layers_charge.png"))
        record.table("numbers", ["layer", "measured on the stamp"], rows)


if __name__ == "__main__":
    main()
