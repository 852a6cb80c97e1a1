"""Panels of a brick's figure: stars' sizes and shapes compared with the PSF model's, as maps over the chip."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from csstsim.measure.bricks.validation.trials import SHAPES
from csstsim.report.style import BLACK, MIN_SOURCES

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from typing import Any

    from matplotlib.axes import Axes

    from csstsim.base.types import FloatArray

SNR = 50.0, 500.0  # of the stars
CELLS = 8  # along each axis
# limit of the colours [%]; distortion of a whisker as long as a cell
RANGE = 2.0
WHISKER = 0.01


def size(axes: Axes, arrays: Mapping[str, Any]) -> bool:
    """Draw stars' sizes over the PSF model's, minus 1: medians of all bands in cells of the chip; return if any."""
    edges, (residual, _, _) = _cell_medians(arrays)
    if edges:
        image = axes.pcolormesh(*edges, 100.0 * residual.T, cmap="RdBu_r", vmin=-RANGE, vmax=RANGE)
        bar = axes.inset_axes((1.03, 0.0, 0.05, 1.0))  # colorbar's own axes would break the layout
        axes.figure.colorbar(image, cax=bar, label="size out / PSF model - 1 [%]")
    return _chip_axes(axes, edges, "Sizes of stars, S/N > 50, all bands")


def ellipticity(axes: Axes, arrays: Mapping[str, Any]) -> bool:
    """Draw stars' distortions minus the PSF model's as whiskers, as `size` does."""
    edges, (_, e1, e2) = _cell_medians(arrays)
    if edges:
        e = np.hypot(e1, e2)
        angle = 0.5 * np.arctan2(e2, e1)
        middle = np.meshgrid(*(0.5 * (edge[1:] + edge[:-1]) for edge in edges), indexing="ij")
        axes.quiver(
            *middle, e * np.cos(angle), e * np.sin(angle), headaxislength=0, headlength=0, headwidth=1, pivot="middle",
            angles="xy", scale_units="xy", scale=WHISKER / np.diff(edges[0])[0], width=0.004, color=BLACK,
        )  # fmt: skip
    return _chip_axes(axes, edges, f"Distortions of stars minus the PSF model's; a cell's width is {WHISKER}")


def _cell_medians(arrays: Mapping[str, Any]) -> tuple[list[FloatArray], FloatArray]:
    """Return (edges of cells along x and y, the cells' medians of trials.SHAPES).

    A cell with fewer than MIN_SOURCES stars is NaN; if all cells have fewer, no edges are returned.
    """
    none = np.full((3, CELLS, CELLS), np.nan)
    parts: dict[str, list[FloatArray]] = {name: [] for name in ("x", "y", *SHAPES)}
    for table in arrays["trials"].values():
        good = (table["sound"] > 0) & ~table["galaxy"].astype(bool) & (table["lonely"] > 0)
        good &= (table["snr"] > SNR[0]) & (table["snr"] < SNR[1]) & np.isfinite(table["psf_size"])
        for name in parts:
            parts[name].append(table[name][good])
    stars = {name: np.concatenate(values) if values else np.zeros(0) for name, values in parts.items()}
    if len(stars["x"]) < MIN_SOURCES:
        return [], none
    edges: list[FloatArray] = [np.linspace(stars[name].min(), stars[name].max() + 1.0, CELLS + 1) for name in "xy"]
    cell = np.ravel_multi_index(
        [np.digitize(stars[n], e[1:-1]) for n, e in zip("xy", edges, strict=True)], (CELLS,) * 2
    )
    medians = np.full((3, CELLS**2), np.nan)
    full = np.flatnonzero(np.bincount(cell) >= MIN_SOURCES)
    if not len(full):
        return [], none
    for k in full:
        medians[:, k] = [np.median(stars[name][cell == k]) for name in SHAPES]
    return edges, medians.reshape(3, CELLS, CELLS)


def _chip_axes(axes: Axes, edges: Sequence[FloatArray], title: str) -> bool:
    if not edges:
        return False
    axes.set(xlim=edges[0][[0, -1]], ylim=edges[1][[0, -1]], box_aspect=1)
    axes.set(xlabel="x on the chip [px]", ylabel="y [px]")
    axes.set_title(title, fontsize=10)
    return True
