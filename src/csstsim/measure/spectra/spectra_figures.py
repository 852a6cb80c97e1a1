"""Figures of extracted spectra: compared with the truth, and their pixels with the traces of all orders."""

from __future__ import annotations

import io
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from csstsim.base.plural import number_of
from csstsim.base.types import FloatArray, IntArray
from csstsim.catalog.table import STAR, TYPES
from csstsim.measure.spectra.spectrum_columns import BESIDE, CONTAMINATED, CUT, DIM, IMAGED, LOST, SATURATED, UNEVEN

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from csstsim.catalog.table import ObjectTable
    from csstsim.measure.spectra.extract import DispersedImage

COLOURS = {1: "#D55E00", 0: "#0072B2", 2: "#009E73", -1: "#CC79A7", -2: "#E69F00"}  # Okabe & Ito (2008), by order
OURS = "#0072B2"
TRUE = "#D55E00"
ROWS = 30  # px of a cutout, on either side of the trace
COLUMNS_MIN = 200  # columns without a flag that a shown spectrum has
UNSHOWN = DIM | LOST | CUT | SATURATED | CONTAMINATED | BESIDE | UNEVEN | IMAGED
MARKED = 2.0  # minimum electrons per pixel of the trace of an order that is marked


def spectra_figure(
    truth: ObjectTable, frame: DispersedImage, orders: ObjectTable, table: ObjectTable, dpi: int = 90
) -> bytes:
    """Return the PNG bytes of a frame's figure: extracted and true spectra, and their pixels, of `chosen` objects.

    truth: table of io.truth; frame: measure.spectra.extract.DispersedImage; orders: of io.orders; table: of
    measure.spectra.extract.
    """
    rows = chosen(truth, table)
    if not rows:
        figure = Figure(figsize=(6, 1))
        figure.text(0.5, 0.5, none_shown(table), ha="center", va="center")
        return _png(figure, dpi)
    figure = Figure(figsize=(max(6.5 * len(rows), 10), 5.5 + 2.4 * len(rows)), layout="constrained")
    above, below = figure.subfigures(2, 1, squeeze=False, height_ratios=(5.5, 2.4 * len(rows)))[:, 0]
    axes = above.subplots(2, len(rows), sharex="col", squeeze=False, height_ratios=(2.2, 1))
    for column, row in zip(axes.T, rows, strict=True):
        spectrum_rows = good_rows(table, row)
        assert spectrum_rows is not None  # it is chosen
        spectrum_panels(column, table, spectrum_rows, title(truth, row))
    above.legend(
        *axes[0, 0].get_legend_handles_labels(), ncols=3, loc="outside upper center", fontsize=8, frameon=False
    )
    cutouts = below.subplots(len(rows), 1, squeeze=False)[:, 0]
    for axis, row in zip(cutouts, rows, strict=True):
        cutout_panel(axis, frame, orders, row, title(truth, row))
    cutouts[-1].set_xlabel("x [px]")
    lines = [Line2D([], [], color=c, label=f"order {n:+d}" if n else "order 0") for n, c in COLOURS.items()]
    lines.append(Line2D([], [], color="k", ls="--", label="other objects' orders"))
    below.legend(handles=lines, ncols=6, loc="outside lower center", fontsize=8, frameon=False)
    return _png(figure, dpi)


def _png(figure: Figure, dpi: int) -> bytes:
    data = io.BytesIO()
    figure.savefig(data, format="png", dpi=dpi)
    return data.getvalue()


def chosen(truth: ObjectTable, table: ObjectTable) -> list[int]:
    """Return rows of the truth table: the star with the most light, the galaxy with the strongest line.

    Both have enough columns that are not saturated or contaminated (`good_rows`).
    """
    rows, count = np.unique(table["row"], return_counts=True)
    order = np.argsort(table["row"], kind="stable")
    groups = {int(row): order[end - n : end] for row, n, end in zip(rows, count, np.cumsum(count), strict=True)}
    spectra = {row: group for row, group in groups.items() if _good_columns(table, group)}
    stars = {r: table["model"][m].sum() for r, m in spectra.items() if truth["obj_type"][r] == STAR}
    others = {r: line_strength(table, m) for r, m in spectra.items() if truth["obj_type"][r] != STAR}
    return [max(group, key=group.__getitem__) for group in (stars, others) if group]


def title(truth: ObjectTable, row: int) -> str:
    """Return the title of an object's panel."""
    kind = TYPES[truth["obj_type"][row]]
    text = f"{kind}, {truth['mag'][row]:.2f} mag"
    if kind == "galaxy":
        text += f", z = {truth['z'][row]:.3f}, half-light radius {truth['size_disk'][row]:.2f} arcsec"
    return text


def none_shown(table: ObjectTable) -> str:
    """Return the reason why a table has no spectrum for the figure."""
    count = len(np.unique(table["row"]))
    if not count:
        return "no spectrum was bright enough to be extracted"
    several = number_of(count, "spectrum", "spectra")
    return f"{several} extracted, none with {COLUMNS_MIN} columns free of contamination and defects"


def good_rows(table: ObjectTable, row: int, columns_min: int = COLUMNS_MIN) -> IntArray | None:
    """Return the rows of one object in a table of measure.spectra.extract; None: too few good columns."""
    rows = np.flatnonzero(table["row"] == row)
    return rows if _good_columns(table, rows, columns_min) else None


def _good_columns(table: ObjectTable, rows: IntArray, columns_min: int = COLUMNS_MIN) -> bool:
    """Return whether at least `columns_min` of the rows are neither saturated nor contaminated."""
    return int((table["flags"][rows] & UNSHOWN == 0).sum()) >= columns_min


def line_strength(table: ObjectTable, rows: IntArray) -> float:
    """Return the height of the strongest line of a spectrum's model above its continuum, in sigma."""
    good = rows[table["flags"][rows] & (DIM | LOST) == 0]
    shape = table["model"][good] / table["sensitivity"][good]
    width = 25  # px
    inner = slice(width, -width)
    continuum = np.median(np.lib.stride_tricks.sliding_window_view(shape, 2 * width + 1), axis=1)
    excess = (shape[inner] - continuum) * table["sensitivity"][good][inner] / table["electrons_err"][good][inner]
    return float(np.nanmax(excess))


def spectrum_panels(axes: Iterable[Axes], table: ObjectTable, rows: IntArray, title: str) -> None:
    """Plot one spectrum into two axes without a legend: electrons extracted and true, and their difference in sigma."""
    part = table.take(rows)
    wave = part["wavelength"]
    good = part["flags"] & (LOST | CUT) == 0
    above, below = axes
    above.errorbar(
        wave[good],
        part["electrons"][good],
        part["electrons_err"][good],
        fmt=".",
        ms=2,
        lw=0.5,
        color=OURS,
        label="extracted (optimal)",
    )
    above.plot(wave, part["model"], color=TRUE, lw=1, label="true spectrum x throughput, at the resolution")
    above.plot(wave, part["contamination"], color="0.5", lw=1, label="subtracted contamination")
    above.set_ylabel("electron / column")
    above.set_title(title, fontsize=10)
    pull = (part["electrons"] - part["model"]) / part["electrons_err"]
    below.axhspan(-1, 1, color="0.9", lw=0)
    below.plot(wave[good], pull[good], ".", ms=2, color=OURS)
    below.set_ylim(-5, 5)
    below.set_ylabel("difference [sigma]")
    below.set_xlabel("wavelength [angstrom]")
    shown = good & (part["flags"] & DIM == 0)
    below.text(
        0.01,
        0.06,
        f"mean {pull[shown].mean():+.2f}, scatter {pull[shown].std():.2f}",
        fontsize=7,
        transform=below.transAxes,
    )


def cutout_panel(axis: Axes, frame: DispersedImage, orders: ObjectTable, row: int, title: str, order: int = 1) -> None:
    """Plot the pixels around one object's spectrum, and the traces of all orders of all objects there.

    frame: measure.spectra.extract.DispersedImage; orders: table of io.orders; row: of the truth table. Lines are the
    traces of the object, dashed lines those of other objects; a ring is a zeroth order.
    """
    window = frame.window
    # a bright object may have light of its wing, but no trace, in a second grating
    order_rows = np.flatnonzero((orders["row"] == row) & (orders["order"] == order))
    k = int(order_rows[np.argmax(orders["drawn"][order_rows])])
    lit = np.array([orders["wave_min"][k], orders["wave_max"][k]])
    ends, height = _ends(orders, k, lit)
    x0 = max(int(ends.min()) - 60, window.x0)
    x1 = min(int(ends.max()) + 60, window.x1)
    y0 = max(int(height.mean()) - ROWS, window.y0)
    y1 = min(int(height.mean()) + ROWS, window.y1)
    image = frame.electrons[y0 - window.y0 : y1 - window.y0, x0 - window.x0 : x1 - window.x0]
    level = np.nanmedian(image)
    spread = frame.noise
    axis.imshow(
        image,
        origin="lower",
        cmap="gray_r",
        vmin=float(level - 3 * spread),
        vmax=float(level + 12 * spread),
        aspect="auto",
        extent=(x0 - 0.5, x1 - 0.5, y0 - 0.5, y1 - 0.5),
        interpolation="nearest",
    )
    for k in _visible(orders, x0, x1, y0, y1):
        ends, height = _ends(orders, k, np.array([orders["wave_min"][k], orders["wave_max"][k]]))
        style: dict[str, Any] = {"color": COLOURS[int(orders["order"][k])], "lw": 0.8}
        if np.ptp(ends) < 5:
            axis.plot(ends.mean(), height.mean(), "o", ms=8, mfc="none", mec=style["color"])
            continue
        is_own = orders["row"][k] == row
        for shift in (-6, 6):  # above and below the light, not over it
            axis.plot(ends, height + shift, ls="-" if is_own else "--", alpha=1.0 if is_own else 0.6, **style)
    axis.set_xlim(x0 - 0.5, x1 - 0.5)
    axis.set_ylim(y0 - 0.5, y1 - 0.5)
    axis.set_title(title, fontsize=10)
    axis.set_ylabel("y [px]")


def _visible(orders: ObjectTable, x0: int, x1: int, y0: int, y1: int) -> IntArray:
    """Return the rows of orders that are MARKED and whose traces touch the box."""
    ends, height = _ends(orders, slice(None), np.array([orders["wave_min"], orders["wave_max"]]))  # NaN: nothing
    in_box = (
        (ends.max(axis=0) >= x0) & (ends.min(axis=0) <= x1) & (height.max(axis=0) >= y0) & (height.min(axis=0) <= y1)
    )
    return np.flatnonzero(in_box & (orders["drawn"] > MARKED * np.maximum(np.ptp(ends, axis=0), 1.0)))


def _ends(orders: ObjectTable, k: int | slice, wave: FloatArray) -> tuple[FloatArray, FloatArray]:
    return (
        orders["x"][k] + orders["p"][k] + orders["q"][k] * wave,
        orders["y"][k] + orders["r"][k] + orders["s"][k] * wave,
    )
