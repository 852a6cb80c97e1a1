"""Figures of the validation: one per brick, and the sky map of the report (paper, section 6)."""

from __future__ import annotations

import io
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from csstsim.base.healpix import brick_corners
from csstsim.base.plural import number_of
from csstsim.report import band_panels, exposure_panels, psf_panels
from csstsim.report.colour_panel import colours
from csstsim.report.style import BLACK, BLUE, GREY, ORANGE

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence
    from typing import Any

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from csstsim.base.types import FloatArray
    from csstsim.report.style import BandStyle

MAX_POINTS = 3000  # points drawn per panel and kind; more would only overlap
# inch
WIDTH = 13.0
HEIGHT = 3.2  # of a row of panels
ROW_HEIGHT = 1.75  # of a row of small panels
MAX_NUMBERED = 40  # bricks; the numbers of more do not fit into the sky map
COLUMNS = 4  # panels of magnitudes in a row
MAX_BANDS = 8  # small panels in a row


class _Block(NamedTuple):
    """Rows of panels in a grid of their own: number of columns, height of a row [inch]."""

    columns: int
    height: float
    rows: list[list[Axes]]


def brick_figure(
    result: Mapping[str, Any],
    arrays: dict[str, Any],
    styles: Mapping[str, BandStyle],
    *,
    threshold: float | None = None,
    snr_min: float | None = None,
) -> bytes:
    """Return the PNG bytes of a brick's figure: a column for each band, then all bands, magnitudes, shapes of stars.

    A panel or row without data is left out.

    `result`, `arrays`: as validation.validate.validate_brick returns them; `styles`: report.style.band_styles of the
    camera's filters; `threshold`, `snr_min`: the completeness gate, drawn when given.
    """
    arrays = arrays | {"styles": styles}
    observed = [band for band in styles if band in result["bands"]]
    magnitudes: list[Callable[[Axes], bool]] = [
        partial(_residuals, style=styles[band], arrays=arrays["residual"][band], numbers=result["bands"][band])
        for band in observed
    ]
    by_band: list[Callable[..., bool]] = [
        partial(band_panels.completeness, threshold=threshold, snr_min=snr_min),
        band_panels.found_by_magnitude,
        band_panels.counts,
        band_panels.positions,
        band_panels.fluxes,
    ]
    figure = new_figure((WIDTH, 1.0))
    blocks = [
        *(
            _trellis(
                figure, observed[k : k + MAX_BANDS], [partial(d, result=result, arrays=arrays) for d in by_band], styles
            )
            for k in range(0, len(observed), MAX_BANDS)
        ),
        _block(figure, COLUMNS, HEIGHT, [*magnitudes, _legend] if magnitudes else []),
        _block(
            figure,
            2,
            1.2 * HEIGHT,
            [
                partial(colours, colour=arrays["colour"], styles=styles),
                *(partial(draw, result=result, arrays=arrays) for draw in exposure_panels.PANELS),
            ],
        ),
        _block(
            figure,
            2,
            1.3 * HEIGHT,
            [partial(draw, arrays=arrays) for draw in (psf_panels.size, psf_panels.ellipticity)],
        ),
    ]
    _arrange(figure, blocks)
    purity = "" if result["purity"] is None else f" ({100.0 * result['purity']:.0f} % match a true object)"
    figure.suptitle(
        f"Brick {result['brick']} (NSIDE 256, nested): {number_of(result['sources'], 'merged source')}{purity}, "
        f"{number_of(result['truth'], 'true object')}, {number_of(result['frames'], 'frame')}"
    )
    return png(figure)


def _block(figure: Figure, columns: int, height: float, draws: Iterable[Callable[[Axes], bool]]) -> _Block:
    """Return the block of the panels that have something to show. A function draws and returns whether there was."""
    panels = []
    for draw in draws:
        axes = figure.add_subplot()
        if draw(axes):
            panels.append(axes)
        else:
            axes.remove()
    return _Block(columns, height, [panels[k : k + columns] for k in range(0, len(panels), columns)])


def _trellis(
    figure: Figure, bands: Sequence[str], draws: Iterable[Callable[..., bool]], styles: Mapping[str, BandStyle]
) -> _Block:
    """Return the block of small panels, a column for each band and a row for each function that has any data.

    The axes' names are at the first column, and under the middle one. A panel without data says so.
    """
    rows: list[list[Axes]] = []
    for draw in draws:
        row = [figure.add_subplot() for _ in bands]
        filled = [draw(axes, band) for axes, band in zip(row, bands, strict=True)]
        if not any(filled):
            for axes in row:
                axes.remove()
            continue
        keyed = filled.index(True)
        for k, axes in enumerate(row):
            axes.tick_params(labelsize=7, labelleft=k == 0)
            axes.yaxis.label.set(fontsize=8, visible=k == 0)
            axes.xaxis.label.set(fontsize=8, visible=k == len(row) // 2)
            if not filled[k]:
                style: dict[str, Any] = {"ha": "center", "va": "center", "fontsize": 8, "color": GREY}
                axes.text(0.5, 0.5, "too few sources", transform=axes.transAxes, **style)
            key = axes.get_legend()
            if key and k != keyed:
                key.remove()
        if not rows:
            for axes, band in zip(row, bands, strict=True):
                axes.set_title(styles[band].label, fontsize=10)
        rows.append(row)
    return _Block(max(len(bands), COLUMNS), ROW_HEIGHT, rows)


def _arrange(figure: Figure, blocks: Iterable[_Block]) -> None:
    """Place the blocks one under another, and give the figure its height."""
    filled = [block for block in blocks if block.rows]
    heights = [block.height * len(block.rows) for block in filled] or [0.1]
    figure.set_size_inches(WIDTH, sum(heights) + 0.4)
    grid = figure.add_gridspec(len(heights), 1, height_ratios=heights)
    for number, block in enumerate(filled):
        inner = grid[number, 0].subgridspec(len(block.rows), block.columns)
        for row, panels in enumerate(block.rows):
            for column, axes in enumerate(panels):
                axes.set_subplotspec(inner[row, column])


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
