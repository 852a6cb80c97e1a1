"""The figures of a score's page: PNG bytes."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from csstsim.inject.recovery.bins import fraction, number
from csstsim.report.style import BLACK, BLUE, ORANGE, SKY, VERMILION
from csstsim.studies.release.score.numbers import edges_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping
    from typing import Any

    from matplotlib.axes import Axes

    from csstsim.base.types import AnyArray, BoolArray, FloatArray, IntArray

KINDS = {"all": (BLACK, "o"), "points": (BLUE, "s"), "galaxies": (VERMILION, "^")}
MOST = 4000  # points of a cloud
BEYOND = 1.0  # mag: of the faintest object found, at which the axis ends


def figures(result: Mapping[str, Any], arrays: Mapping[str, Any]) -> Iterator[tuple[str, bytes, str]]:
    """Yield (title, PNG bytes, caption) of what a result (score.evaluate) has."""
    from matplotlib.figure import Figure

    from csstsim.report.figures import png

    for title, draw, caption in _panels(result, arrays):
        figure = Figure(figsize=(7.0, 4.6), dpi=110, layout="constrained")
        draw(figure.subplots())
        yield title, png(figure), caption


def _panels(result: Mapping[str, Any], arrays: Mapping[str, Any]) -> Iterator[tuple[str, Callable[[Axes], None], str]]:
    band = f" in {result['band']}" if result["band"] else ", each in its brightest band"
    yield (
        "Completeness",
        lambda axes: _completeness(axes, result, band),
        "The share of true objects that have a source, by true magnitude, with 68% bounds (bins of five and more). "
        "Dashed: merged ones, which lie in the source of a brighter object, counted in.",
    )
    if result.get("purity_by_magnitude"):
        yield (
            "Purity",
            lambda axes: _purity(axes, result),
            "The share of sources that belong to a true object, by their own magnitude, with 68% bounds. Dashed: "
            "second sources of one object counted in. Grey: the share that would be real by chance, from the shifted "
            "catalogue.",
        )
    for band, cloud in arrays["photometry"].items():
        if len(cloud["mag"]):
            yield (
                f"Photometry in {band}",
                partial(_photometry, cloud=cloud, band=band),
                "Magnitude less the true one, of objects that are alone. Bars: mean and scatter in bins, without "
                "outliers.",
            )
    if len(arrays["positions"]["east"]):
        yield (
            "Places",
            lambda axes: _positions(axes, arrays["positions"]),
            "Source less truth, of objects that are alone and of S/N above 20. The bars cross at the mean, and are as "
            "long as the scatter to both sides.",
        )
    if any(len(true) for true, _ in arrays.get("shapes", {}).values()):
        yield (
            "Shapes",
            lambda axes: _shapes(axes, arrays["shapes"]),
            "Ellipticity of resolved galaxies that are alone, of S/N above 10, against the true one, on the sky's "
            "axes. A slope of 1 needs the PSF undone.",
        )
    if len(arrays.get("redshifts", {"true": ()})["true"]):
        yield (
            "Redshifts",
            lambda axes: _redshifts(axes, arrays["redshifts"]),
            "Redshift against the true one; dashed: 0.15 (1 + z) off.",
        )


def _errors(axes: Axes, bins: Iterable[Mapping[str, Any]], name: str, **look: Any) -> list[Mapping[str, Any]]:
    kept = [one for one in bins if one["n"] >= 5]
    if kept:
        p, low, high = np.transpose([fraction(one[name], one["n"]) for one in kept])
        at = [(one["low"] + one["high"]) / 2 for one in kept]
        axes.errorbar(at, p, [p - low, high - p], markersize=4, linewidth=1, **look)
    return kept


def _completeness(axes: Axes, result: Mapping[str, Any], band: str) -> None:
    for kind, (colour, marker) in KINDS.items():
        kept = _errors(
            axes, result["completeness_by_magnitude"][kind], "found", color=colour, marker=marker, label=kind
        )
        at = [(one["low"] + one["high"]) / 2 for one in kept]
        axes.plot(at, [(one["found"] + one["merged"]) / one["n"] for one in kept], "--", color=colour, linewidth=0.8)
    axes.set(xlabel=f"true magnitude{band} [AB]", ylabel="completeness", ylim=(-0.03, 1.05))
    faintest = [one["high"] for one in result["completeness_by_magnitude"]["all"] if one["found"]]
    if faintest:  # objects that nothing finds may be five magnitudes fainter
        axes.set_xlim(right=max(faintest) + BEYOND)
    if axes.get_legend_handles_labels()[1]:
        axes.legend()


def _purity(axes: Axes, result: Mapping[str, Any]) -> None:
    bins = result["purity_by_magnitude"]
    kept = _errors(axes, bins, "real", color=BLUE, marker="o")
    at = [(one["low"] + one["high"]) / 2 for one in kept]
    axes.plot(at, [(one["real"] + one["second"]) / one["n"] for one in kept], "--", color=BLUE, linewidth=0.8)
    if np.isfinite(result["purity"]["chance"]):
        axes.axhline(result["purity"]["chance"], color="#999999", linewidth=1.2)
    axes.set(xlabel=f"magnitude in {result['band']} [AB]", ylabel="purity", ylim=(-0.03, 1.05))


def _photometry(axes: Axes, cloud: Mapping[str, AnyArray], band: str) -> None:
    most = 0.0
    for name, kind, colour in (("points", ~cloud["galaxy"], BLUE), ("galaxies", cloud["galaxy"], VERMILION)):
        mag = cloud["mag"][kind]
        off = cloud["off"][kind]
        some = _some(len(mag))
        axes.plot(mag[some], off[some], ".", color=colour, markersize=3, alpha=0.45)
        edges = edges_of(mag)
        held = [(number(off[rows]), mag[rows].mean()) for rows in _by_bin(mag, edges)]
        held = [(one, at) for one, at in held if np.isfinite(one.mean)]
        if held:
            at = [place for _, place in held]
            mean, scatter = (np.array([getattr(one, key) for one, _ in held]) for key in ("mean", "scatter"))
            axes.errorbar(at, mean, scatter, color=colour, marker="o", markersize=4, capsize=2, label=name)
            most = max(most, *(np.abs(mean) + 1.5 * scatter))
    axes.axhline(0, color="#999999", linewidth=0.8)
    axes.set(xlabel=f"true magnitude in {band} [AB]", ylabel="magnitude less true [mag]")
    if most > 0:
        axes.set_ylim(-1.1 * most, 1.1 * most)
        axes.legend()


def _by_bin(mag: FloatArray, edges: FloatArray) -> list[BoolArray]:
    at = np.digitize(mag, edges) - 1
    return [at == k for k in range(len(edges) - 1) if (at == k).any()]


def _positions(axes: Axes, cloud: Mapping[str, AnyArray]) -> None:
    most = 1e-3
    for name, kind, colour in (("points", ~cloud["galaxy"], BLUE), ("galaxies", cloud["galaxy"], ORANGE)):
        east = cloud["east"][kind]
        north = cloud["north"][kind]
        if not len(east):
            continue
        some = _some(len(east))
        held = (number(east), number(north))
        axes.plot(east[some], north[some], ".", color=colour, markersize=3, alpha=0.4, label=name)
        if np.isfinite(held[0].mean):
            axes.errorbar(held[0].mean, held[1].mean, held[1].scatter, held[0].scatter, color=colour, linewidth=2.5)
            most = max(most, *(abs(one.mean) + 3 * one.scatter for one in held))
    axes.axhline(0, color="#999999", linewidth=0.8)
    axes.axvline(0, color="#999999", linewidth=0.8)
    axes.set(xlabel="east [mas]", ylabel="north [mas]", xlim=(-most, most), ylim=(-most, most), aspect="equal")
    axes.legend()


def _shapes(axes: Axes, clouds: Mapping[str, tuple[FloatArray, FloatArray]]) -> None:
    for (axis, (true, seen)), colour in zip(clouds.items(), (BLUE, VERMILION), strict=True):
        some = _some(len(true))
        axes.plot(true[some], seen[some], ".", color=colour, markersize=3, alpha=0.5, label=axis)
    axes.plot([-0.6, 0.6], [-0.6, 0.6], color="#999999", linewidth=0.8)
    axes.set(xlabel="true ellipticity", ylabel="ellipticity", xlim=(-0.7, 0.7), ylim=(-0.7, 0.7), aspect="equal")
    axes.legend()


def _redshifts(axes: Axes, cloud: Mapping[str, FloatArray]) -> None:
    some = _some(len(cloud["true"]))
    top = 1.05 * max(cloud["true"].max(), np.percentile(cloud["seen"], 99))
    axes.plot(cloud["true"][some], cloud["seen"][some], ".", color=BLUE, markersize=3, alpha=0.4)
    line = np.array([0.0, top])
    axes.plot(line, line, color="#999999", linewidth=0.8)
    for sign in (-1, 1):
        axes.plot(line, line + sign * 0.15 * (1 + line), "--", color=SKY, linewidth=0.8)
    axes.set(xlabel="true redshift", ylabel="redshift", xlim=(0, top), ylim=(0, top), aspect="equal")


def _some(n: int) -> IntArray:
    """Return rows of at most MOST points, evenly chosen."""
    return np.unique(np.linspace(0, n - 1, min(n, MOST)).astype(int)) if n else np.zeros(0, int)
