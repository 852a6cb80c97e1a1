"""The report's panel of the sky: components by exposure, and earthshine by limb angle (stray-light model only)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from csstsim.report.style import BLACK, BLUE, GREEN, ORANGE, PURPLE, SKY, legend

if TYPE_CHECKING:
    from collections.abc import Mapping

    from csstsim.base.types import FloatArray
    from csstsim.report.style import BandStyle

# component: colour, marker
COMPONENTS = {
    "zodiacal": (BLACK, "."),
    "earth": (BLUE, "o"),
    "sun": (ORANGE, "*"),
    "moon": (GREEN, "x"),
    "planets": (PURPLE, "+"),
    "stars": (SKY, "_"),
}
MIN_LEVEL = 1e-9  # e-/s/px; less counts as none
FRACTION = 0.1  # of the zodiacal light: a line marks this much earthshine


def sky_by_exposure(
    levels: Mapping[str, Mapping[str, FloatArray]], limbs: Mapping[str, FloatArray], styles: Mapping[str, BandStyle]
) -> bytes:
    """Return PNG bytes: components by exposure in the band with the most sky, earthshine by limb angle in every band.

    levels: {band: {component: e-/s/px (n,)}} and limbs: {band: limb angle [deg] (n,)} of the n exposures of each band,
    in order of time; styles: report.style.band_styles of the camera's filters.
    """
    from csstsim.report.figures import new_figure, png

    figure = new_figure((13.0, 4.6))
    by_time, by_limb = figure.subplots(1, 2)
    band = max(levels, key=lambda name: levels[name]["zodiacal"].mean())
    for name, (colour, marker) in COMPONENTS.items():
        present = np.flatnonzero(levels[band][name] > MIN_LEVEL)
        if len(present):
            by_time.plot(present + 1, levels[band][name][present], marker, color=colour, ms=5, label=name)
    by_time.set(yscale="log", xlabel="exposure, in order of time", ylabel=f"{band} [e-/s/px]")
    by_time.set_title("Components of the sky; absent ones are omitted", fontsize=10)
    by_time.set_ylim(None, 50 * by_time.get_ylim()[1])  # room for the legend
    legend(by_time, loc="upper center", ncols=6, columnspacing=1.0)
    for name, parts in levels.items():
        ratio = parts["earth"] / parts["zodiacal"]
        style = styles[name.lower()]
        illuminated = parts["earth"] > MIN_LEVEL
        label = f"{style.label}: {np.mean(ratio > FRACTION):.0%} above {FRACTION:.0%}"
        by_limb.plot(
            limbs[name][illuminated],
            ratio[illuminated],
            style.marker or ".",
            color=style.colour,
            ms=3,
            ls="",
            label=label,
        )
    by_limb.axhline(FRACTION, color="#666666", lw=0.8, ls=":")
    by_limb.set(yscale="log", xlabel="limb angle at the start [deg]", ylabel="earthshine / zodiacal light")
    by_limb.set_title("Earthshine; exposures over the dark Earth have none", fontsize=10)
    by_limb.set_ylim(1e-7, None)
    legend(by_limb, loc="lower left", ncols=3)
    return png(figure)
