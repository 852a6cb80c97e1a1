"""Colours, names and legends shared by the figures of the validation.

Colours are Okabe & Ito's (2008), which colour-blind readers can tell apart; stars and galaxies differ in marker too.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping
    from typing import Any

    from matplotlib.axes import Axes

    from csstsim.instrument.filter import Filter

BLUE = "#0072B2"
ORANGE = "#E69F00"
GREEN = "#009E73"
VERMILION = "#D55E00"
PURPLE = "#CC79A7"
SKY = "#56B4E9"
BLACK = "#000000"
# of bands, blue to red
COLOURS = (PURPLE, BLUE, SKY, GREEN, ORANGE, VERMILION, BLACK)
MARKERS = "osD^v<>"
# of gratings
GREY = "#666666"
DASHES = (":", "--", "-.")
MIN_SOURCES = 3  # of a bin that is drawn


@dataclass(frozen=True)
class BandStyle:
    """How a filter is shown: `label` is the camera's name of it; bands have markers, gratings line styles."""

    label: str
    colour: str
    marker: str | None = None
    line: str = "-"


def band_styles(filters: Mapping[str, Filter]) -> dict[str, BandStyle]:
    """Return {name in lower case: BandStyle} of the camera's filters, {name: instrument.filter.Filter}."""
    bands = [name for name, filter_ in filters.items() if filter_.kind == "imaging"]
    styles = {}
    for number, name in enumerate(bands):  # few bands are spread over the colours; many reuse them
        position = int((number + 0.5) * len(COLOURS) / len(bands)) if len(bands) < len(COLOURS) else number
        cycle, index = divmod(position, len(COLOURS))
        styles[name.lower()] = BandStyle(name, COLOURS[index], MARKERS[(index + cycle) % len(MARKERS)])
    for number, name in enumerate(name for name in filters if name not in bands):
        styles[name.lower()] = BandStyle(name, GREY, line=DASHES[number % len(DASHES)])
    return styles


def snr_axis(axes: Axes) -> None:
    """Make x the true S/N, logarithmic, with ticks far enough apart for their numbers."""
    axes.set(xscale="log", xlabel="true S/N")
    low, high = axes.get_xlim()
    ticks = (1, 5, 20, 100, 500)
    axes.set_xticks(ticks, [str(tick) for tick in ticks])
    axes.minorticks_off()
    axes.set_xlim(low, high)


def legend(axes: Axes, **keywords: Any) -> bool:
    """Draw the legend and return True if anything was plotted under a label, else return False; keywords: legend's."""
    if not axes.get_legend_handles_labels()[1]:
        return False
    axes.legend(fontsize=8, title_fontsize=8, **({"loc": "lower right"} | keywords))
    return True
