"""Figures of the validation: one per brick, and the sky map of the report (paper, section 6)."""

import io

import numpy as np

from csstsim.base.healpix import brick_corners
from csstsim.base.plural import number_of
from csstsim.bricks.validate import SNR_EDGES
from csstsim.report import exposure_panels, psf_panels
from csstsim.report.colour_panel import colours
from csstsim.report.style import BLACK, BLUE, FEWEST, ORANGE, legend_or_note, snr_axis

MAX_POINTS = 3000  # points drawn per panel and kind; more would only overlap
MAX_NUMBERED = 40  # bricks; the sky map has no room for the numbers of more
COLUMNS = 4  # panels of bands in a row


def brick_figure(result, arrays, looks, *, threshold=None, snr_min=None):
    """Return the PNG bytes of a brick's figure: completeness, colours, magnitude residuals by band, single exposures.

    `result`, `arrays`: as bricks.validate.validate_brick returns them; `looks`: report.style.looks of the
    camera's filters; `threshold`, `snr_min`: the completeness gate, drawn when given.
    """
    bands = {band: look for band, look in looks.items() if look.marker}
    rows = len(bands) // COLUMNS + 1  # with a place for the legend
    heights = (1.25, *[1.0] * rows, 1.1, 1.1, 1.3)
    figure = _figure((13.0, 21.5 * sum(heights) / 6.75))
    grid = figure.add_gridspec(len(heights), 12, height_ratios=heights)
    _completeness(figure.add_subplot(grid[0, :6]), arrays["completeness"], looks, threshold, snr_min)
    colours(figure.add_subplot(grid[0, 6:]), arrays["colour"], looks)
    places = [grid[1 + n // COLUMNS, 3 * (n % COLUMNS) : 3 * (n % COLUMNS) + 3] for n in range(rows * COLUMNS)]
    for place, (band, look) in zip(places, bands.items(), strict=False):
        _residuals(figure.add_subplot(place), look, arrays["residual"].get(band), result["bands"].get(band))
    _legend(figure.add_subplot(places[-1]))
    arrays = arrays | {"looks": looks}
    for number, draw in enumerate(exposure_panels.PANELS):
        row, column = rows + 1 + number // 3, 4 * (number % 3)
        draw(figure.add_subplot(grid[row, column : column + 4]), result, arrays)
    for number, draw in enumerate((psf_panels.size, psf_panels.ellipticity)):
        draw(figure.add_subplot(grid[-1, 6 * number : 6 * number + 6]), arrays)
    purity = "" if result["purity"] is None else f" ({100.0 * result['purity']:.0f} % match a true object)"
    figure.suptitle(
        f"Brick {result['brick']} (NSIDE 256, nested): {number_of(result['sources'], 'merged source')}{purity}, "
        f"{number_of(result['truth'], 'true object')}, {number_of(result['frames'], 'frame')}"
    )
    return _png(figure)


def sky_map(footprints, bricks, looks, pointings=()):
    """Return the PNG bytes of the sky map: bricks and the windows on them, in degrees from their centre.

    `footprints`: [(band or grating, ra[4], dec[4])], corners in order; `bricks`: pixel numbers; `looks`:
    report.style.looks; `pointings`: [(ra, dec)] of the boresights. They are shown in a second panel, because they may
    lie far from the windows of a small region.
    """
    figure = _figure((15.0, 7.0) if pointings else (9.0, 7.5))
    near, *far = figure.subplots(1, 2 if pointings else 1, squeeze=False)[0]
    corners = [brick_corners(pix) for pix in bricks]
    centre = _centre([(ra, dec) for _, ra, dec in footprints] + corners)
    for axes in (near, *far):
        for pix, (ra, dec) in zip(bricks, corners, strict=True):
            x, y = _offsets(ra, dec, centre)
            axes.fill(x, y, facecolor="#f2f2f2", edgecolor="#999999", lw=0.8, zorder=1)
            if axes is near and len(bricks) <= MAX_NUMBERED:
                style = {"ha": "center", "va": "center", "fontsize": 7, "color": "#444444", "zorder": 3}
                axes.annotate(str(pix), (x.mean(), y.mean()), **style)
        _windows(axes, footprints, looks, centre)
        axes.set(xlabel="offset east [deg]", ylabel="offset north [deg]")
        axes.set_aspect("equal", adjustable="datalim")  # else a lone boresight makes a narrow panel
        axes.invert_xaxis()  # east to the left
    near.set_title(f"Windows and bricks around RA {centre[0]:.4f}, Dec {centre[1]:+.4f} deg (ICRS)", fontsize=10)
    for axes in far:
        axes.plot(*_offsets(*np.transpose(pointings), centre), "+", color=BLACK, ms=9, mew=1.5, zorder=4)
        axes.set_title(f"Boresights (+): {len(pointings)}", fontsize=10)
    if footprints:
        (far or [near])[0].legend(title="filter", fontsize=8, loc="center left", bbox_to_anchor=(1.01, 0.5))
    return _png(figure)


def _windows(axes, footprints, looks, centre):
    """Draw the outlines of windows: bands differ in colour; gratings are grey and differ in dashes."""
    seen = set()
    for band, ra, dec in footprints:
        look = looks[band]
        style = {"lw": 1.2, "ls": look.line, "label": None if band in seen else look.label}
        seen.add(band)
        axes.fill(*_offsets(ra, dec, centre), facecolor="none", edgecolor=look.colour, zorder=2, **style)


def _completeness(axes, curves, looks, threshold, snr_min):
    edges = np.array(SNR_EDGES, float)
    middle = np.sqrt(edges[:-1] * edges[1:])
    drawn = [band for band, (n, _) in curves.items() if (n >= FEWEST).any()]
    for place, band in enumerate(drawn):
        n, found = curves[band]
        good = n >= FEWEST
        fraction = found[good] / n[good]
        # Wilson's interval, which holds for fractions near 1 and few sources
        z2, m = 1.0, n[good]
        mid = (fraction + z2 / (2 * m)) / (1 + z2 / m)
        half = np.sqrt(fraction * (1 - fraction) / m + z2 / (4 * m**2)) / (1 + z2 / m)
        error = np.maximum([fraction - (mid - half), mid + half - fraction], 0.0)
        shift = 1.02 ** (place - (len(drawn) - 1) / 2)  # bands side by side
        axes.errorbar(
            middle[good] * shift, fraction, error, color=looks[band].colour, marker=looks[band].marker, ms=4, lw=1.2,
            capsize=2, label=f"{looks[band].label} ({n.sum()})",
        )  # fmt: skip
    if threshold is not None:
        axes.axhline(threshold, color="#666666", ls="--", lw=1)
    if snr_min is not None:
        axes.axvline(snr_min, color="#666666", ls=":", lw=1)
    axes.set(xlim=(1, SNR_EDGES[-1]), ylim=(-0.03, 1.05), ylabel="fraction found")
    snr_axis(axes)
    axes.set_title("Completeness of isolated point sources", fontsize=10)
    legend_or_note(axes, drawn, "no point sources", title="filter (sources)")


def _residuals(axes, look, arrays, numbers):
    axes.axhline(0.0, color="#666666", lw=0.8)
    lines = []
    for kind, colour, marker in (("galaxy", ORANGE, "."), ("star", BLUE, "+")):
        given, residual = arrays[kind] if arrays else np.zeros((2, 0))
        shown = slice(None, None, max(1, len(given) // MAX_POINTS + 1))
        axes.plot(given[shown], residual[shown], marker, color=colour, ms=3.5, alpha=0.5, ls="", rasterized=True)
        _running_median(axes, given, residual, colour)
        stat = numbers[kind] if numbers else {"n": 0}
        if stat["n"]:
            error = "" if stat["error"] is None else f" ± {1e3 * stat['error']:.0f}"
            lines.append(f"{kind}: {1e3 * stat['median']:+.0f}{error} mmag ({stat['n']})")
    if numbers:
        axes.axvline(numbers["depth_5sigma"], color="#666666", ls=":", lw=1)
    else:
        axes.text(0.5, 0.8, "not observed", ha="center", transform=axes.transAxes, color="#444444")
    axes.set(xlim=(16.5, 27.5), ylim=(-1.0, 1.0), xlabel=f"{look.label} true [AB mag]", ylabel="out - in [mag]")
    axes.text(0.03, 0.03, "\n".join(lines), fontsize=7.5, transform=axes.transAxes, va="bottom")
    axes.set_title(look.label, fontsize=10)


def _running_median(axes, x, y, colour):
    edges = np.arange(16.5, 28.0, 0.5)
    which = np.digitize(x, edges)
    rows = [(edges[k - 1] + 0.25, np.median(y[which == k])) for k in range(1, len(edges)) if (which == k).sum() >= 10]
    if len(rows) > 1:
        line = axes.plot(*zip(*rows, strict=True), color=colour, lw=2)[0]
        import matplotlib.patheffects as effects

        line.set_path_effects([effects.Stroke(linewidth=4, foreground="white"), effects.Normal()])


def _legend(axes):
    axes.axis("off")
    axes.plot([], [], "+", color=BLUE, ms=8, label="star or quasar, PSF magnitude")
    axes.plot([], [], ".", color=ORANGE, ms=9, label="galaxy, Kron magnitude")
    axes.plot([], [], color="#444444", lw=2, label="running median (colour of its kind)")
    axes.plot([], [], color="#666666", ls=":", label="5 sigma depth of one exposure")
    axes.legend(
        loc="center", fontsize=9, frameon=False, title="Magnitudes out - in, isolated sources.\n"
        "Numbers: median and its error\nat S/N > 20 (sources)", title_fontsize=9,
    )  # fmt: skip


def _centre(polygons):
    from csstsim.base.sphere import ra_dec, unit_vectors

    if not polygons:
        return 0.0, 0.0
    mean = np.concatenate([unit_vectors(ra, dec) for ra, dec in polygons]).mean(axis=0)
    ra, dec = ra_dec(mean[None])
    return float(ra[0]), float(dec[0])


def _offsets(ra, dec, centre):
    """Return offsets east and north of `centre` [deg] in Lambert's azimuthal equal-area projection.

    It works at RA 0, at the poles and on the far side of the sky.
    """
    ra, dec, ra0, dec0 = (np.radians(v) for v in (ra, dec, *centre))
    depth = np.sin(dec) * np.sin(dec0) + np.cos(dec) * np.cos(dec0) * np.cos(ra - ra0)
    north = np.sin(dec) * np.cos(dec0) - np.cos(dec) * np.sin(dec0) * np.cos(ra - ra0)
    stretch = np.degrees(np.sqrt(2.0 / np.maximum(1.0 + depth, 1e-12)))
    return stretch * np.cos(dec) * np.sin(ra - ra0), stretch * north


def _figure(size):
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _png(figure):
    stream = io.BytesIO()
    figure.savefig(stream, format="png")
    return stream.getvalue()
