"""What the figures of the validation share: colours, names, legends.

Colours are Okabe & Ito's (2008), told apart by colour-blind readers; stars and galaxies differ in marker too.
"""

from csstsim.catalog.table import BANDS

BLUE, ORANGE, GREEN, VERMILION, PURPLE, SKY, BLACK = (
    "#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7", "#56B4E9", "#000000",
)  # fmt: skip
BAND_COLOURS = dict(zip(BANDS, (PURPLE, BLUE, SKY, GREEN, ORANGE, VERMILION, BLACK), strict=True))
BAND_MARKERS = dict(zip(BANDS, "osD^v<>", strict=True))
FEWEST = 3  # sources a bin needs to be drawn


def band_label(band):
    """Return the band as it is written in text: NUV, u, g, ..."""
    return band.upper() if band == "nuv" else band


def legend_or_note(axes, anything, note, **keywords):
    """Draw the legend if `anything` was plotted under a label, else write `note` in the middle; keywords: legend's."""
    if anything and axes.get_legend_handles_labels()[1]:  # what there is may be too few to be drawn
        axes.legend(fontsize=8, title_fontsize=8, **({"loc": "lower right"} | keywords))
    else:
        axes.text(0.5, 0.5, note, ha="center", transform=axes.transAxes, color="#444444")
