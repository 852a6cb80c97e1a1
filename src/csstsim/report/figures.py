"""Figures of the validation: one per brick, and the sky map of the report (paper, section 6)."""

from __future__ import annotations

import io
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.healpix import brick_corners
from csstsim.base.plural import number_of
from csstsim.measure.bricks.validation.validate import SNR_EDGES
from csstsim.report import exposure_panels, psf_panels
from csstsim.report.colour_panel import colours
from csstsim.report.style import BLACK, BLUE, MIN_SOURCES, ORANGE, legend, snr_axis

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence
    from typing import Any

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from csstsim.base.types import FloatArray, IntArray
    from csstsim.report.style import BandStyle

MAX_POINTS = 3000  # points drawn per panel and kind; more would only overlap
HEIGHT = 3.2  # inch, of a row of panels
MAX_NUMBERED = 40  # bricks; the numbers of more do not fit into the sky map
COLUMNS = 4  # panels of bands in a row


def brick_figure(
    result: Mapping[str, Any],
    arrays: dict[str, Any],
    styles: Mapping[str, BandStyle],
    *,
    threshold: float | None = None,
    snr_min: float | None = None,
) -> bytes:
    """Return the PNG bytes of a brick's figure: completeness, colours, magnitude residuals by band, single exposures.

    A panel without data is left out.

    `result`, `arrays`: as validation.validate.validate_brick returns them; `styles`: report.style.band_styles of the
    camera's filters; `threshold`, `snr_min`: the completeness gate, drawn when given.
    """
    arrays = arrays | {"styles": styles}
    bands: list[Callable[[Axes], bool]] = [
        partial(_residuals, style=styles[band], arrays=arrays["residual"][band], numbers=result["bands"][band])
        for band in styles
        if band in result["bands"]
    ]
    groups = (
        (
            2,
            1.25,
            [
                partial(
                    _completeness, curves=arrays["completeness"], styles=styles, threshold=threshold, snr_min=snr_min
                ),
                partial(colours, colour=arrays["colour"], styles=styles),
            ],
        ),
        (COLUMNS, 1.0, [*bands, _legend] if bands else []),
        (3, 1.1, [partial(draw, result=result, arrays=arrays) for draw in exposure_panels.PANELS]),
        (2, 1.3, [partial(draw, arrays=arrays) for draw in (psf_panels.size, psf_panels.ellipticity)]),
    )
    figure = _arranged(groups)
    purity = "" if result["purity"] is None else f" ({100.0 * result['purity']:.0f} % match a true object)"
    figure.suptitle(
        f"Brick {result['brick']} (NSIDE 256, nested): {number_of(result['sources'], 'merged source')}{purity}, "
        f"{number_of(result['truth'], 'true object')}, {number_of(result['frames'], 'frame')}"
    )
    return png(figure)


def _arranged(groups: Iterable[tuple[int, float, Sequence[Callable[[Axes], bool]]]]) -> Figure:
    """Return a figure of panels without those that have nothing to show; groups: (columns, height, functions of axes).

    A function draws into axes and returns whether there was anything to draw. Each group begins a row.
    """
    figure = new_figure((13.0, 1.0))
    rows = []
    for columns, height, draws in groups:
        tried = [(figure.add_subplot(), draw) for draw in draws]
        drawn = []
        for axes, draw in tried:
            if draw(axes):
                drawn.append(axes)
            else:
                axes.remove()
        rows += [(columns, height, drawn[k : k + columns]) for k in range(0, len(drawn), columns)]
    heights = [height for _, height, _ in rows] or [0.1]
    figure.set_size_inches(13.0, HEIGHT * sum(heights) + 0.4)
    grid = figure.add_gridspec(len(heights), 12, height_ratios=heights)
    for row, (columns, _, drawn) in enumerate(rows):
        wide = 12 // columns
        for index, axes in enumerate(drawn):
            axes.set_subplotspec(grid[row, wide * index : wide * (index + 1)])
    return figure


def sky_map(
    footprints: Sequence[tuple[str, FloatArray, FloatArray]],
    bricks: Sequence[int],
    styles: Mapping[str, BandStyle],
    pointings: Sequence[tuple[float, float]] = (),
) -> bytes:
    """Return the PNG bytes of the sky map: bricks and the windows on them, in degrees from their centre.

    `footprints`: [(band or grating, ra[4], dec[4])], corners in order; `bricks`: pixel numbers; `styles`:
    report.style.band_styles; `pointings`: [(ra, dec)] of the boresights. They are shown in a second panel, because they
    may lie far from the windows of a small region.
    """
    figure = new_figure((15.0, 7.0) if pointings else (9.0, 7.5))
    field, *boresights = figure.subplots(1, 2 if pointings else 1, squeeze=False)[0]
    corners = [brick_corners(pix) for pix in bricks]
    centre = _centre([(ra, dec) for _, ra, dec in footprints] + corners)
    for axes in (field, *boresights):
        for pix, (ra, dec) in zip(bricks, corners, strict=True):
            x, y = _offsets(ra, dec, centre)
            axes.fill(x, y, facecolor="#f2f2f2", edgecolor="#999999", lw=0.8, zorder=1)
            if axes is field and len(bricks) <= MAX_NUMBERED:
                style = {"ha": "center", "va": "center", "fontsize": 7, "color": "#444444", "zorder": 3}
                axes.annotate(str(pix), (x.mean(), y.mean()), **style)
        _windows(axes, footprints, styles, centre)
        axes.set(xlabel="offset east [deg]", ylabel="offset north [deg]")
        axes.set_aspect("equal", adjustable="datalim")  # else a lone boresight makes a narrow panel
        axes.invert_xaxis()  # east to the left
    field.set_title(f"Windows and bricks around RA {centre[0]:.4f}, Dec {centre[1]:+.4f} deg (ICRS)", fontsize=10)
    for axes in boresights:
        ra, dec = np.transpose(pointings)
        east, north = _offsets(ra, dec, centre)
        axes.plot(east, north, "+", color=BLACK, ms=9, mew=1.5, zorder=4)
        axes.set_title(f"Boresights (+): {len(pointings)}", fontsize=10)
    if footprints:
        (boresights or [field])[0].legend(title="filter", fontsize=8, loc="center left", bbox_to_anchor=(1.01, 0.5))
    return png(figure)


def _windows(
    axes: Axes,
    footprints: Iterable[tuple[str, FloatArray, FloatArray]],
    styles: Mapping[str, BandStyle],
    centre: tuple[float, float],
) -> None:
    """Draw the outlines of windows: bands differ in colour; gratings are grey and differ in dashes."""
    labelled = set()
    for band, ra, dec in footprints:
        style = styles[band]
        outline: dict[str, Any] = {"lw": 1.2, "ls": style.line, "label": None if band in labelled else style.label}
        labelled.add(band)
        axes.fill(*_offsets(ra, dec, centre), facecolor="none", edgecolor=style.colour, zorder=2, **outline)


def _completeness(
    axes: Axes,
    curves: Mapping[str, tuple[IntArray, IntArray]],
    styles: Mapping[str, BandStyle],
    threshold: float | None,
    snr_min: float | None,
) -> bool:
    edges = np.array(SNR_EDGES, float)
    middle = np.sqrt(edges[:-1] * edges[1:])
    drawn = [band for band, (n, _) in curves.items() if (n >= MIN_SOURCES).any()]
    for index, band in enumerate(drawn):
        n, found = curves[band]
        good = n >= MIN_SOURCES
        fraction = found[good] / n[good]
        # Wilson's interval, which holds for fractions near 1 and few sources
        z2 = 1.0
        m = n[good]
        mid = (fraction + z2 / (2 * m)) / (1 + z2 / m)
        half = np.sqrt(fraction * (1 - fraction) / m + z2 / (4 * m**2)) / (1 + z2 / m)
        error = np.maximum([fraction - (mid - half), mid + half - fraction], 0.0)
        shift = 1.02 ** (index - (len(drawn) - 1) / 2)  # bands side by side
        axes.errorbar(
            middle[good] * shift,
            fraction,
            error,
            color=styles[band].colour,
            marker=styles[band].marker,
            ms=4,
            lw=1.2,
            capsize=2,
            label=f"{styles[band].label} ({n.sum()})",
        )
    if threshold is not None:
        axes.axhline(threshold, color="#666666", ls="--", lw=1)
    if snr_min is not None:
        axes.axvline(snr_min, color="#666666", ls=":", lw=1)
    axes.set(xlim=(1, SNR_EDGES[-1]), ylim=(-0.03, 1.05), ylabel="fraction found")
    snr_axis(axes)
    axes.set_title("Completeness of isolated point sources", fontsize=10)
    return legend(axes, title="filter (sources)")


def _residuals(
    axes: Axes, style: BandStyle, arrays: Mapping[str, tuple[FloatArray, FloatArray]], numbers: Mapping[str, Any]
) -> bool:
    axes.axhline(0.0, color="#666666", lw=0.8)
    lines = []
    for kind, colour, marker in (("galaxy", ORANGE, "."), ("star", BLUE, "+")):
        given, residual = arrays[kind]
        shown = slice(None, None, max(1, len(given) // MAX_POINTS + 1))
        axes.plot(given[shown], residual[shown], marker, color=colour, ms=3.5, alpha=0.5, ls="", rasterized=True)
        _running_median(axes, given, residual, colour)
        stat = numbers[kind]
        if stat["n"]:
            error = "" if stat["error"] is None else f" ± {1e3 * stat['error']:.0f}"
            lines.append(f"{kind}: {1e3 * stat['median']:+.0f}{error} mmag ({stat['n']})")
    axes.axvline(numbers["depth_5sigma"], color="#666666", ls=":", lw=1)
    axes.set(xlim=(16.5, 27.5), ylim=(-1.0, 1.0), xlabel=f"{style.label} true [AB mag]", ylabel="out - in [mag]")
    axes.text(0.03, 0.03, "\n".join(lines), fontsize=7.5, transform=axes.transAxes, va="bottom")
    axes.set_title(style.label, fontsize=10)
    return any(len(given) for given, _ in arrays.values())


def _running_median(axes: Axes, x: FloatArray, y: FloatArray, colour: str) -> None:
    edges = np.arange(16.5, 28.0, 0.5)
    which = np.digitize(x, edges)
    rows = [(edges[k - 1] + 0.25, np.median(y[which == k])) for k in range(1, len(edges)) if (which == k).sum() >= 10]
    if len(rows) > 1:
        line = axes.plot(*zip(*rows, strict=True), color=colour, lw=2)[0]
        import matplotlib.patheffects as effects

        line.set_path_effects([effects.Stroke(linewidth=4, foreground="white"), effects.Normal()])


def _legend(axes: Axes) -> bool:
    axes.axis("off")
    axes.plot([], [], "+", color=BLUE, ms=8, label="star or quasar, PSF magnitude")
    axes.plot([], [], ".", color=ORANGE, ms=9, label="galaxy, total magnitude")
    axes.plot([], [], color="#444444", lw=2, label="running median (colour of its kind)")
    axes.plot([], [], color="#666666", ls=":", label="5 sigma depth of one exposure")
    axes.legend(
        loc="center",
        fontsize=9,
        frameon=False,
        title="Magnitudes out - in, isolated sources.\nNumbers: median and its error\nat S/N > 20 (sources)",
        title_fontsize=9,
    )
    return True


def _centre(polygons: Sequence[tuple[FloatArray, FloatArray]]) -> tuple[float, float]:
    from csstsim.base.sphere import ra_dec, unit_vectors

    if not polygons:
        return 0.0, 0.0
    mean = np.concatenate([unit_vectors(ra, dec) for ra, dec in polygons]).mean(axis=0)
    ra, dec = ra_dec(mean[None])
    return float(ra[0]), float(dec[0])


def _offsets(ra: FloatArray, dec: FloatArray, centre: tuple[float, float]) -> tuple[FloatArray, FloatArray]:
    """Return offsets east and north of `centre` [deg] in Lambert's azimuthal equal-area projection.

    It works at RA 0, at the poles and on the far side of the sky.
    """
    ra, dec, ra0, dec0 = (np.radians(v) for v in (ra, dec, *centre))
    depth = np.sin(dec) * np.sin(dec0) + np.cos(dec) * np.cos(dec0) * np.cos(ra - ra0)
    north = np.sin(dec) * np.cos(dec0) - np.cos(dec) * np.sin(dec0) * np.cos(ra - ra0)
    stretch = np.degrees(np.sqrt(2.0 / np.maximum(1.0 + depth, 1e-12)))
    return stretch * np.cos(dec) * np.sin(ra - ra0), stretch * north


def new_figure(size: tuple[float, float]) -> Figure:
    """Return an empty matplotlib figure of a size [inch], without pyplot's window."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def png(figure: Figure) -> bytes:
    """Return a figure as the bytes of a PNG."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png")
    return stream.getvalue()
