"""The figures of a score's page: PNG bytes."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from csstsim.inject.recovery.bins import fraction, number
from csstsim.report.style import BLACK, BLUE, ORANGE, SKY, VERMILION
from csstsim.studies.release.score.statistics import bin_edges

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping
    from typing import Any

    from matplotlib.axes import Axes

    from csstsim.base.types import AnyArray, BoolArray, FloatArray, IntArray

KINDS = {"all": (BLACK, "o"), "points": (BLUE, "s"), "galaxies": (VERMILION, "^")}
POINTS_MAX = 4000  # plotted points of a cloud
MARGIN_MAG = 1.0  # mag, from the faintest bin with an object found to the end of the axis


class ScoreFigure(NamedTuple):
    """A figure: its title, its PNG bytes and its caption."""

    title: str
    png: bytes
    caption: str


class _Panel(NamedTuple):
    """A figure before it is drawn: its title, the function that draws it on axes, and its caption."""

    title: str
    draw: Callable[[Axes], None]
    caption: str


def figures(result: Mapping[str, Any], arrays: Mapping[str, Any]) -> Iterator[ScoreFigure]:
    """Yield the ScoreFigures for which a result (score.evaluate) has data."""
    from matplotlib.figure import Figure

    from csstsim.report.figures import png

    for panel in _panels(result, arrays):
        figure = Figure(figsize=(7.0, 4.6), dpi=110, layout="constrained")
        panel.draw(figure.subplots())
        yield ScoreFigure(panel.title, png(figure), panel.caption)


def _panels(result: Mapping[str, Any], arrays: Mapping[str, Any]) -> Iterator[_Panel]:
    band = f" in {result['band']}" if result["band"] else ", each in its brightest band"
    yield _Panel(
        "Completeness",
        lambda axes: _completeness(axes, result, band),
        "The fraction of true objects that have a source, by true magnitude, with 68% bounds (bins of five and more). "
        "Dashed: merged ones, which lie in the source of a brighter object, counted in.",
    )
    if result.get("purity_by_magnitude"):
        yield _Panel(
            "Purity",
            lambda axes: _purity(axes, result),
            "The fraction of sources that belong to a true object, by their own magnitude, with 68% bounds. Dashed: "
            "second sources of one object counted in. Grey: the fraction that would be real by chance, from the "
            "shifted catalogue.",
        )
    for band, cloud in arrays["photometry"].items():
        if len(cloud["mag"]):
            yield _Panel(
                f"Photometry in {band}",
                partial(_photometry, cloud=cloud, band=band),
                "Magnitude less the true one, of objects that are alone. Bars: mean and scatter in bins, without "
                "outliers.",
            )
    if len(arrays["positions"]["east"]):
        yield _Panel(
            "Positions",
            lambda axes: _positions(axes, arrays["positions"]),
            "Source less truth, of objects that are alone and of S/N above 20. The bars cross at the mean, and are as "
            "long as the scatter to both sides.",
        )
    if any(len(true) for true, _ in arrays.get("shapes", {}).values()):
        yield _Panel(
            "Shapes",
            lambda axes: _shapes(axes, arrays["shapes"]),
            "Ellipticity of resolved galaxies that are alone, of S/N above 10, against the true one, on the sky's "
            "axes. A slope of 1 needs the PSF undone.",
        )
    if len(arrays.get("redshifts", {"true": ()})["true"]):
        yield _Panel(
            "Redshifts",
            lambda axes: _redshifts(axes, arrays["redshifts"]),
            "Redshift against the true one; dashed: 0.15 (1 + z) off.",
        )


def _plot_fractions(axes: Axes, bins: Iterable[Mapping[str, Any]], name: str, **style: Any) -> list[Mapping[str, Any]]:
    shown = [bin_ for bin_ in bins if bin_["n"] >= 5]
    if shown:
        values, low, high = np.transpose([fraction(bin_[name], bin_["n"]) for bin_ in shown])
        middles = [(bin_["low"] + bin_["high"]) / 2 for bin_ in shown]
        axes.errorbar(middles, values, [values - low, high - values], markersize=4, linewidth=1, **style)
    return shown


def _completeness(axes: Axes, result: Mapping[str, Any], band: str) -> None:
    for kind, (colour, marker) in KINDS.items():
        shown = _plot_fractions(
            axes, result["completeness_by_magnitude"][kind], "found", color=colour, marker=marker, label=kind
        )
        middles = [(bin_["low"] + bin_["high"]) / 2 for bin_ in shown]
        axes.plot(
            middles, [(bin_["found"] + bin_["merged"]) / bin_["n"] for bin_ in shown], "--", color=colour, linewidth=0.8
        )
    axes.set(xlabel=f"true magnitude{band} [AB]", ylabel="completeness", ylim=(-0.03, 1.05))
    faintest = [bin_["high"] for bin_ in result["completeness_by_magnitude"]["all"] if bin_["found"]]
    if faintest:  # objects that nothing finds may be five magnitudes fainter
        axes.set_xlim(right=max(faintest) + MARGIN_MAG)
    if axes.get_legend_handles_labels()[1]:
        axes.legend()


def _purity(axes: Axes, result: Mapping[str, Any]) -> None:
    bins = result["purity_by_magnitude"]
    shown = _plot_fractions(axes, bins, "real", color=BLUE, marker="o")
    middles = [(bin_["low"] + bin_["high"]) / 2 for bin_ in shown]
    axes.plot(middles, [(bin_["real"] + bin_["second"]) / bin_["n"] for bin_ in shown], "--", color=BLUE, linewidth=0.8)
    if np.isfinite(result["purity"]["chance"]):
        axes.axhline(result["purity"]["chance"], color="#999999", linewidth=1.2)
    axes.set(xlabel=f"magnitude in {result['band']} [AB]", ylabel="purity", ylim=(-0.03, 1.05))


def _photometry(axes: Axes, cloud: Mapping[str, AnyArray], band: str) -> None:
    limit = 0.0
    for name, kind, colour in (("points", ~cloud["galaxy"], BLUE), ("galaxies", cloud["galaxy"], VERMILION)):
        mag = cloud["mag"][kind]
        difference = cloud["off"][kind]
        rows = _thinned(len(mag))
        axes.plot(mag[rows], difference[rows], ".", color=colour, markersize=3, alpha=0.45)
        bins = [(mag[of_bin].mean(), number(difference[of_bin])) for of_bin in _by_bin(mag, bin_edges(mag))]
        bins = [(mean_mag, numbers) for mean_mag, numbers in bins if np.isfinite(numbers.mean)]
        if bins:
            mean_mags = [mean_mag for mean_mag, _ in bins]
            mean = np.array([numbers.mean for _, numbers in bins])
            scatter = np.array([numbers.scatter for _, numbers in bins])
            axes.errorbar(mean_mags, mean, scatter, color=colour, marker="o", markersize=4, capsize=2, label=name)
            limit = max(limit, *(np.abs(mean) + 1.5 * scatter))
    axes.axhline(0, color="#999999", linewidth=0.8)
    axes.set(xlabel=f"true magnitude in {band} [AB]", ylabel="magnitude less true [mag]")
    if limit > 0:
        axes.set_ylim(-1.1 * limit, 1.1 * limit)
        axes.legend()


def _by_bin(mag: FloatArray, edges: FloatArray) -> list[BoolArray]:
    bin_number = np.digitize(mag, edges) - 1
    return [bin_number == k for k in range(len(edges) - 1) if (bin_number == k).any()]


def _positions(axes: Axes, cloud: Mapping[str, AnyArray]) -> None:
    limit = 1e-3
    for name, kind, colour in (("points", ~cloud["galaxy"], BLUE), ("galaxies", cloud["galaxy"], ORANGE)):
        east = cloud["east"][kind]
        north = cloud["north"][kind]
        if not len(east):
            continue
        rows = _thinned(len(east))
        axes.plot(east[rows], north[rows], ".", color=colour, markersize=3, alpha=0.4, label=name)
        x = number(east)
        y = number(north)
        if np.isfinite(x.mean):
            axes.errorbar(x.mean, y.mean, y.scatter, x.scatter, color=colour, linewidth=2.5)
            limit = max(limit, abs(x.mean) + 3 * x.scatter, abs(y.mean) + 3 * y.scatter)
    axes.axhline(0, color="#999999", linewidth=0.8)
    axes.axvline(0, color="#999999", linewidth=0.8)
    axes.set(xlabel="east [mas]", ylabel="north [mas]", xlim=(-limit, limit), ylim=(-limit, limit), aspect="equal")
    axes.legend()


def _shapes(axes: Axes, clouds: Mapping[str, tuple[FloatArray, FloatArray]]) -> None:
    for (axis, (true, measured)), colour in zip(clouds.items(), (BLUE, VERMILION), strict=True):
        rows = _thinned(len(true))
        axes.plot(true[rows], measured[rows], ".", color=colour, markersize=3, alpha=0.5, label=axis)
    axes.plot([-0.6, 0.6], [-0.6, 0.6], color="#999999", linewidth=0.8)
    axes.set(xlabel="true ellipticity", ylabel="ellipticity", xlim=(-0.7, 0.7), ylim=(-0.7, 0.7), aspect="equal")
    axes.legend()


def _redshifts(axes: Axes, cloud: Mapping[str, FloatArray]) -> None:
    rows = _thinned(len(cloud["true"]))
    top = 1.05 * max(cloud["true"].max(), np.percentile(cloud["seen"], 99))
    axes.plot(cloud["true"][rows], cloud["seen"][rows], ".", color=BLUE, markersize=3, alpha=0.4)
    line = np.array([0.0, top])
    axes.plot(line, line, color="#999999", linewidth=0.8)
    for sign in (-1, 1):
        axes.plot(line, line + sign * 0.15 * (1 + line), "--", color=SKY, linewidth=0.8)
    axes.set(xlabel="true redshift", ylabel="redshift", xlim=(0, top), ylim=(0, top), aspect="equal")


def _thinned(n: int) -> IntArray:
    """Return the rows of at most POINTS_MAX of n points, evenly spaced."""
    return np.unique(np.linspace(0, n - 1, min(n, POINTS_MAX)).astype(int)) if n else np.zeros(0, int)
