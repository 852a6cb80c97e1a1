"""The colour-colour diagram (paper, section 6): true colours as contours, measured colours as points."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from csstsim.report.style import BLACK, BLUE, ORANGE, legend

if TYPE_CHECKING:
    from collections.abc import Mapping
    from typing import Any

    from matplotlib.axes import Axes

    from csstsim.base.types import FloatArray
    from csstsim.report.style import BandStyle

MAX_POINTS = 3000  # points drawn per kind; more would only overlap
CONTOURS_FROM = 50  # sources; fewer are drawn as points
FRACTIONS = 0.9, 0.6, 0.3  # of the sources, enclosed by each contour
# side of a density cell [mag]; sigma of the smoothing [cells]
CELL = 0.05
BLUR = 2.0
LIMITS = (-1.5, 4.0), (-1.0, 2.5)  # mag, of the axes: they hold u - g and g - r of stars and galaxies
KINDS = ("star or quasar", BLUE, "o"), ("galaxy", ORANGE, "s")


def colours(axes: Axes, colour: Mapping[str, Any], styles: Mapping[str, BandStyle]) -> bool:
    """Draw true and measured colours of the same sources (validation.compare.colours); return whether there are any.

    styles: report.style.band_styles.
    """
    names = [styles[band].label for band in colour["bands"]]
    if not names:
        return False
    true = colour["input"]
    measured = colour["output"]
    galaxy = colour["galaxy"]
    for (kind, tint, marker), of_kind in zip(KINDS, (~galaxy, galaxy), strict=True):
        n = int(of_kind.sum())
        if n == 0:
            continue
        shown = np.flatnonzero(of_kind)[:: n // MAX_POINTS + 1]
        size = 4 if n < CONTOURS_FROM else 3
        axes.plot(
            *measured[:, shown], marker, ls="", color=tint, ms=size, mew=0, label=f"{kind} ({n}), measured", zorder=2
        )
        if n < CONTOURS_FROM:
            axes.plot(*true[:, shown], marker, ls="", mfc="none", mec=BLACK, mew=0.7, ms=5.5, label=f"{kind}, true")
        else:
            _contours(axes, true[:, of_kind], "-" if kind == "galaxy" else "--", f"{kind}, true: 30, 60, 90%")
    axes.set(
        xlim=LIMITS[0],
        ylim=LIMITS[1],
        xlabel="{} - {} [AB mag]".format(*names),
        ylabel="{1} - {2} [AB mag]".format(*names),
    )
    axes.set_title(f"Colours of the same sources, true and measured, at S/N > 10 in {', '.join(names)}", fontsize=10)
    return legend(axes, loc="upper left")


def _contours(axes: Axes, points: FloatArray, line: str, label: str) -> None:
    """Draw contours of the smoothed density that enclose FRACTIONS of the `points` (2, n)."""
    from scipy.ndimage import gaussian_filter

    edges = [np.arange(low, high + CELL / 2, CELL) for low, high in LIMITS]
    first, second = points
    density = gaussian_filter(np.histogram2d(first, second, bins=edges)[0], BLUR)
    falling = np.sort(density.ravel())[::-1]
    levels = falling[[np.searchsorted(np.cumsum(falling), fraction * density.sum()) for fraction in FRACTIONS]]
    middle = [0.5 * (e[1:] + e[:-1]) for e in edges]
    axes.contour(*middle, density.T, np.unique(levels), colors=BLACK, linewidths=1.1, linestyles=line, zorder=3)
    axes.plot([], [], line, color=BLACK, lw=1.1, label=label)
