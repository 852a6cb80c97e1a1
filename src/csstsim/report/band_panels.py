"""Panels of a brick's figure of which each shows one band: detection, counts, effects of charge transfer.

Each function draws into `axes` and returns whether there was anything to draw. `result` and `arrays` are those of
validation.validate.validate_brick; arrays["styles"] is report.style.band_styles of the camera's filters. The axes have
the same limits in all bands.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from csstsim.measure.bricks.validation.validate import SNR_EDGES
from csstsim.report.style import BLUE, GREY, MIN_SOURCES, ORANGE, legend, snr_axis

if TYPE_CHECKING:
    from collections.abc import Mapping

    from matplotlib.axes import Axes

STEP = 0.5  # mag
MIN_COUNTED = 20  # true objects of a bin: with fewer, the Poisson error exceeds 22%
BRIGHTEST = -8.5  # mag, of the counts' axis: relative to the depth of an exposure
LINE: dict[str, Any] = {"ms": 3, "lw": 1.0}


def completeness(
    axes: Axes,
    band: str,
    result: Mapping[str, Any],
    arrays: Mapping[str, Any],
    *,
    threshold: float | None = None,
    snr_min: float | None = None,
) -> bool:
    """Draw the completeness of isolated point sources against true S/N; `threshold`, `snr_min`: of its gate."""
    n, found = arrays["completeness"][band]
    good = n >= MIN_SOURCES
    edges = np.array(SNR_EDGES, float)
    if threshold is not None:
        axes.axhline(threshold, color=GREY, ls="--", lw=0.8)
    if snr_min is not None:
        axes.axvline(snr_min, color=GREY, ls=":", lw=0.8)
    fraction = found[good] / n[good]
    # Wilson's interval, which holds for fractions near 1 and few sources
    z2 = 1.0
    m = n[good]
    mid = (fraction + z2 / (2 * m)) / (1 + z2 / m)
    half = np.sqrt(fraction * (1 - fraction) / m + z2 / (4 * m**2)) / (1 + z2 / m)
    error = np.maximum([fraction - (mid - half), mid + half - fraction], 0.0)
    style = arrays["styles"][band]
    middle = np.sqrt(edges[:-1] * edges[1:])[good]
    axes.errorbar(middle, fraction, error, color=style.colour, marker=style.marker, **LINE)
    axes.set(xlim=(1, SNR_EDGES[-1]), ylim=(-0.03, 1.05), ylabel="completeness of\nisolated point sources")
    snr_axis(axes)
    return bool(good.any())


def found_by_magnitude(axes: Axes, band: str, result: Mapping[str, Any], arrays: Mapping[str, Any]) -> bool:
    """Draw the fraction of isolated stars and of isolated galaxies that are found in single exposures."""
    table = arrays["trials"][band]
    galaxy = table["galaxy"].astype(bool)
    found = table["found"] > 0
    known = np.isfinite(table["mag"])
    edges = np.arange(18.0, 29.1, STEP)
    for kind, line, colour, label in ((~galaxy, "o-", BLUE, "star, quasar"), (galaxy, "s--", ORANGE, "galaxy")):
        n = np.histogram(table["mag"][kind & known], edges)[0]
        n_found = np.histogram(table["mag"][kind & known & found], edges)[0]
        good = n >= MIN_SOURCES
        if good.any():
            axes.plot(edges[:-1][good] + STEP / 2, n_found[good] / n[good], line, color=colour, label=label, **LINE)
    axes.axhline(0.5, color=GREY, ls=":", lw=0.8)
    axes.set(
        xlim=(18, 29),
        xticks=(20, 24, 28),
        ylim=(-0.03, 1.05),
        xlabel="true magnitude [AB]",
        ylabel="fraction found in\none exposure",
    )
    return legend(axes, loc="lower left")


def counts(axes: Axes, band: str, result: Mapping[str, Any], arrays: Mapping[str, Any]) -> bool:
    """Draw the ratio of merged sources to true objects against magnitude minus the depth of an exposure."""
    numbers = result["bands"][band]
    style = arrays["styles"][band]
    edges, true, measured = (np.array(numbers["counts"][name], float) for name in ("edges", "in", "out"))
    good = true >= MIN_COUNTED
    x = 0.5 * (edges[1:] + edges[:-1])[good] - numbers["depth_5sigma"]
    error = np.sqrt(measured[good]) / true[good]
    axes.errorbar(x, measured[good] / true[good], error, color=style.colour, marker=style.marker, **LINE)
    axes.axhline(1.0, color=GREY, lw=0.8)
    axes.set(xlim=(BRIGHTEST, 1.5), ylim=(0, 1.6), xlabel="true magnitude - depth of an exposure [mag]")
    axes.set(ylabel="merged sources /\ntrue objects")
    return bool(good.any())


def positions(axes: Axes, band: str, result: Mapping[str, Any], arrays: Mapping[str, Any]) -> bool:
    """Draw stars' position residuals along the columns against S/N; positive is away from the amplifier."""
    axes.set(ylabel="position, out - in [mas],\naway from the amplifier", ylim=(-6, 6))
    return _transfer(axes, band, result, arrays, "deferred_mas", 1.0)


def fluxes(axes: Axes, band: str, result: Mapping[str, Any], arrays: Mapping[str, Any]) -> bool:
    """Draw stars' relative flux residuals against S/N."""
    axes.set(ylabel="flux in one exposure,\nout / in - 1 [%]", ylim=(-12, 12))
    return _transfer(axes, band, result, arrays, "light", 100.0)


def _transfer(
    axes: Axes, band: str, result: Mapping[str, Any], arrays: Mapping[str, Any], name: str, unit: float
) -> bool:
    parts = result["bands"][band]["transfer"]
    rows = [(part["snr"], part[name]) for part in parts if part[name]["n"] >= MIN_SOURCES]
    x = [np.sqrt(low * high) for (low, high), _ in rows]
    y, error = ([unit * part[key] for _, part in rows] for key in ("median", "error"))
    style = arrays["styles"][band]
    axes.errorbar(x, y, error, color=style.colour, marker=style.marker, **LINE)
    axes.axhline(0.0, color=GREY, lw=0.8)
    axes.set_xlim(1, SNR_EDGES[-1])
    snr_axis(axes)
    return bool(rows)
