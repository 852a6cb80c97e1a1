"""The picture itself: image, colour bar, grid, marks, inset."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, cast

import numpy as np

from csstsim.report.quicklook.blocks import block_max, block_mean
from csstsim.report.quicklook.marks import draw_marks, legend_title
from csstsim.report.quicklook.sky_grid import draw_grid
from csstsim.report.quicklook.stretch import bit_ticks, make_norm, ticks

if TYPE_CHECKING:
    from astropy.visualization import ImageNormalize
    from astropy.visualization.wcsaxes import WCSAxes
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage

    from csstsim.catalog.table import ObjectTable
    from csstsim.report.quicklook.picture import Bounds, Picture

SIDE = 900  # px of the longer side of the image in the figure, twice that of the inset; larger images are averaged
DPI = 100
BAD = "#7A1F1F"  # pixels without a value
FRAME = "#D55E00"
# inch
LEFT = 0.9
RIGHT = 2.85
BOTTOM = 1.0
TOP = 1.25
INSET_RIGHT = 1.3
MIN_WIDTH = 8.0


def draw(
    picture: Picture,
    bounds: Bounds,
    stretch: str | None,
    limits: tuple[float, float] | None = None,
    marks: ObjectTable | None = None,
    inset: Bounds | None = None,
    side: int = SIDE,
) -> Figure:
    """Return the matplotlib Figure of the part `bounds` (x0, x1, y0, y1, half-open) of a Picture.

    marks: rows of a truth table, or None; inset: bounds of a part that is also shown enlarged, or None;
    side: pixels of the figure along the longer side of the image, half as many along the inset's.
    """
    from astropy.visualization.wcsaxes import WCSAxes
    from matplotlib.figure import Figure

    width, height = _inches(bounds, side)
    inset_size = _inches(inset, side // 2) if inset else (0.0, 0.0)
    page = Page(
        max(LEFT + width + RIGHT + (inset_size[0] + INSET_RIGHT if inset else 0.0), MIN_WIDTH),
        BOTTOM + max(height, inset_size[1]) + TOP,
    )
    figure = Figure(figsize=(page.width, page.height), dpi=DPI)
    axes = WCSAxes(figure, page.part(LEFT, BOTTOM, width, height), wcs=None)
    figure.add_axes(axes)
    shown = _image(axes, picture, bounds, side, stretch, limits)
    _pixel_labels(axes, picture.on_chip)
    _bar(figure, page.part(LEFT + width + 1.15, BOTTOM, 0.18, height), shown, picture)
    if picture.wcs is not None:
        draw_grid(axes, picture.wcs, picture.header.get("POSKIND") == "APPARENT")
    if inset:
        _outline(axes, inset)
        x = LEFT + width + RIGHT
        y = BOTTOM + (max(height, inset_size[1]) - inset_size[1]) / 2
        inset_axes = figure.add_axes(page.part(x, y, *inset_size))  # type: ignore[call-overload]  # four numbers
        shown = _inset(inset_axes, picture, inset, side // 2, stretch, limits)
        _bar(figure, page.part(x + inset_size[0] + 0.15, y, 0.18, inset_size[1]), shown, picture)
    if marks is not None:
        draw_marks(axes, marks)
        if inset:
            draw_marks(inset_axes, marks)
        _legend(figure, axes, legend_title(marks))
    figure.text(LEFT / page.width, 1 - 0.12 / page.height, picture.title, va="top", fontsize=10)
    figure.text(0.99, 0.06 / page.height, picture.remark, ha="right", fontsize=7)
    return figure


@dataclass(frozen=True)
class Page:
    """The figure's size in inches."""

    width: float
    height: float

    def part(self, x: float, y: float, width: float, height: float) -> list[float]:
        """Return a rectangle [inches from the lower left] as fractions of the figure, as matplotlib takes it."""
        return [x / self.width, y / self.height, width / self.width, height / self.height]


def _scale(bounds: Bounds, side: int) -> tuple[int, int]:
    """Return (step, zoom): the chip pixels averaged along each axis, and the figure pixels per mean along each."""
    longer = max(bounds[1] - bounds[0], bounds[3] - bounds[2])
    step = -(-longer // side)
    return step, side // -(-longer // step)


def _inches(bounds: Bounds, side: int) -> tuple[float, float]:
    """Return (width, height) [inch] of the image: whole figure pixels per mean, at least a quarter of `side` each."""
    step, zoom = _scale(bounds, side)
    width, height = (max(n / step * zoom, side / 4) / DPI for n in (bounds[1] - bounds[0], bounds[3] - bounds[2]))
    return width, height


def _image(
    axes: Axes, picture: Picture, bounds: Bounds, side: int, stretch: str | None, limits: tuple[float, float] | None
) -> AxesImage:
    """Show the pixels of `bounds`, means of blocks (of a mask: maxima) of `side` px or fewer, in chip coordinates."""
    from matplotlib import colormaps

    x0, x1, y0, y1 = bounds
    step, _ = _scale(bounds, side)
    means = (block_mean if picture.bits is None else block_max)(picture.part(bounds), step)
    extent = np.array([x0, x0 + step * means.shape[1], y0, y0 + step * means.shape[0]]) - 0.5
    norm = make_norm(means, stretch, limits, file=picture.path, bits=picture.bits)
    shown = axes.imshow(
        means,
        origin="lower",
        extent=extent,  # type: ignore[arg-type]  # four numbers
        aspect="auto",
        interpolation="nearest",
        cmap=colormaps["gray"].with_extremes(bad=BAD),
        norm=norm,
    )
    axes.set(xlim=(x0 - 0.5, x1 - 0.5), ylim=(y0 - 0.5, y1 - 0.5))
    return shown


def _pixel_labels(axes: WCSAxes, on_chip: bool) -> None:
    for coordinate, name, side in zip(axes.coords, "xy", "bl", strict=True):
        coordinate.set_axislabel(f"{name} [px]" if on_chip else f"{name} [px of the frame]")
        coordinate.set_ticks_position(side)


def _bar(figure: Figure, rectangle: list[float], shown: AxesImage, picture: Picture) -> None:
    bar = figure.colorbar(shown, cax=figure.add_axes(rectangle))  # type: ignore[call-overload]  # four numbers
    values, labels = (ticks if picture.bits is None else bit_ticks)(cast("ImageNormalize", shown.norm))
    bar.set_ticks(values, labels=labels)  # type: ignore[arg-type]  # or an array of them
    bar.ax.minorticks_off()
    bar.set_label(picture.unit or "unit not given")


def _outline(axes: Axes, bounds: Bounds) -> None:
    from matplotlib.patches import Rectangle

    x0, x1, y0, y1 = bounds
    axes.add_patch(Rectangle((x0 - 0.5, y0 - 0.5), x1 - x0, y1 - y0, fill=False, ec=FRAME, lw=1.6))


def _inset(
    axes: Axes, picture: Picture, bounds: Bounds, side: int, stretch: str | None, limits: tuple[float, float] | None
) -> AxesImage:
    """Show `bounds` on separate axes with separate limits: single pixels are noisier than means of many."""
    from matplotlib.ticker import MaxNLocator

    shown = _image(axes, picture, bounds, side, stretch, limits)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MaxNLocator(5, integer=True))
    axes.spines[:].set(color=FRAME, linewidth=1.6)
    axes.set_title("inset", fontsize=9, color=FRAME)
    return shown


def _legend(figure: Figure, axes: Axes, title: str) -> None:
    figure.legend(
        *axes.get_legend_handles_labels(),
        title=title,
        loc="lower left",
        bbox_to_anchor=(0.01, 0.005),
        ncols=3,
        fontsize=8,
        title_fontsize=8,
        facecolor="0.25",
        labelcolor="w",
    ).get_title().set_color("w")
