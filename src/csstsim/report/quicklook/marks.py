"""Marks of the brightest true objects on a picture. Colours are Okabe & Ito's (2008); shapes differ as well."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from csstsim.base.errors import InputError
from csstsim.catalog.light.object_spectra import ROW
from csstsim.catalog.table import TYPES
from csstsim.io.truth import read_truth

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from csstsim.catalog.table import ObjectTable
    from csstsim.report.quicklook.picture import Bounds

STYLES = {"star": ("o", "#E69F00"), "galaxy": ("s", "#56B4E9"), "quasar": ("D", "#CC79A7")}
STYLES |= {"asteroid": ("^", "#009E73"), "satellite": ("v", "#D55E00")}
PLURALS = {"galaxy": "galaxies"} | {name: f"{name}s" for name in ("star", "quasar", "asteroid", "satellite")}
_SIZE = 7.0  # points


def load_marks(path: Path, table: Path | None = None) -> ObjectTable:
    """Return the truth table of the Level-0 file `path`, in the same folder, or that of the file `table`.

    Raises InputError if there is none or it lacks a column that is drawn.
    """
    source = path.with_suffix(".truth.parquet") if table is None else table
    if not source.is_file():
        raise InputError(
            "no such truth table",
            file=source,
            key="--truth",
            allowed="the .truth.parquet next to a Level-0 file; --truth-table names one elsewhere",
        )
    truth = read_truth(source)
    missing = [name for name in ("obj_type", "electrons") if name not in truth]
    if missing and len(truth):
        raise InputError("the truth table lacks a column", file=source, key=missing[0])
    return truth


def brightest(truth: ObjectTable, bounds: Bounds, limit: int) -> ObjectTable:
    """Return the rows of the `limit` objects with the most electrons in `bounds` (x0, x1, y0, y1), brightest first."""
    if not len(truth):
        return truth
    x0, x1, y0, y1 = bounds
    x, y, electrons = (np.asarray(truth[name], float) for name in ("x", "y", "electrons"))
    inside = (x >= x0 - 0.5) & (x < x1 - 0.5) & (y >= y0 - 0.5) & (y < y1 - 0.5) & (electrons > 0)
    rows = np.flatnonzero(inside)
    return truth.take(rows[np.argsort(-electrons[rows], kind="stable")[:limit]])


def draw_marks(axes: Axes, chosen: ObjectTable) -> None:
    """Mark the rows of a truth table on axes of chip pixels, with a legend below."""
    for number, name in enumerate(TYPES):
        rows = chosen.take(chosen["obj_type"] == number) if len(chosen) else chosen
        if not len(rows) and name not in ("star", "galaxy"):
            continue  # most frames have none
        marker, colour = STYLES[name]
        x: ArrayLike = rows["x"] if len(rows) else []
        y: ArrayLike = rows["y"] if len(rows) else []
        label = f"{len(rows)} {name if len(rows) == 1 else PLURALS[name]}"
        axes.plot(x, y, marker, ms=_SIZE, mfc="none", mec=colour, mew=1.2, label=label)


def legend_title(chosen: ObjectTable) -> str:
    """Return the title of the legend for the marked rows, on an image in a filter or behind a grating."""
    if not len(chosen):
        return "truth: no object in this part"
    magnitudes = chosen["mag"][np.isfinite(chosen["mag"])]
    faintest = f", to {magnitudes.max():.1f} mag" if magnitudes.size else ""
    where = ", where light would fall without the grating" if ROW in chosen else ""
    return f"truth, brightest {len(chosen)}{faintest}{where}"
