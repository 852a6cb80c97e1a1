"""The paper's figures that need no simulation: throughputs, lamps, and the five fields on the sky.

    python benchmarks/paper_static_figures.py

Draws throughputs.png (the paper's figure of response curves, with the wavelengths of the PSFs), led_bands.png (the
lamps' lines over the bands) and fields.png (the pointings of Cycle 9 on the sky), and records their main numbers.
Everything is read from config/instrument/ and survey_tables/.
"""

import argparse

from evidence.record import Record

import healpy
import numpy as np
from astropy.coordinates import BarycentricMeanEcliptic, Galactic, SkyCoord
from make_tables import FIELDS, RADIUS
from matplotlib.figure import Figure

from csstsim.base.healpix import NSIDE, brick_corners
from csstsim.base.shipped import SHIPPED
from csstsim.base.sphere import angle, offsets, unit_vectors
from csstsim.campaign.survey_table import load_survey_table
from csstsim.detector.channels import ReadoutFrame
from csstsim.instrument.camera import load_camera
from csstsim.optics.throughput.led import load_leds
from csstsim.report.style import BLACK, BLUE, ORANGE, band_styles
from csstsim.universe.dust.dust_map import galactic
from csstsim.universe.parameters import load_universe

PAPER = {"W1": 2.3, "W2": 2.3, "W3": 2.7, "W4": 2.7, "W5": 2.5, "all": 12.5}  # TB, its Table 1
BRICKS, PIXEL = 366, 2  # the paper's number; bytes of a pixel of a Level-0 file
SIDE = np.arange(0.25, 180.0, 0.5)  # deg, half the sky in cells of half a degree


def drawn_filters(camera):
    """Yield (Filter, its line style for matplotlib, whether it is a grating) of a camera."""
    shown = band_styles(camera.filters)
    for name, one in camera.filters.items():
        style = shown[name.lower()]
        yield one, {"color": style.colour, "ls": style.line, "label": style.label}, one.kind == "slitless"


def throughputs(camera, record):
    """Return the Figure of the response curves; dashed lines are where the PSFs are sampled. Records those."""
    figure = Figure(figsize=(10, 6.4), layout="constrained")
    panels = dict(zip((False, True), figure.subplots(2, 1, sharex=True), strict=True))
    columns = {}
    for one, style, grating in drawn_filters(camera):
        panel, name = panels[grating], style.pop("label")
        some = one.throughput > 0
        panel.plot(0.1 * one.wavelength[some], one.throughput[some], lw=1.6, **style, label=name)
        tops = one.at(one.psf_wavelength)
        for wave, top in zip(0.1 * one.psf_wavelength, tops, strict=True):
            panel.plot([wave, wave], [0, top], color=style["color"], lw=0.8, ls=style["ls"] if grating else "--")
        waves = [f"{0.1 * wave:.0f}" for wave in one.psf_wavelength]
        numbers = f"{one.throughput.max():.3f}", f"{0.1 * one.pivot:.0f}", f"{one.zeropoint(camera.telescope):.2f}"
        columns[name] = [*waves, *numbers]
    heads = *(f"PSF {k + 1} [nm]" for k in range(len(waves))), "highest throughput", "pivot [nm]", "zero point [AB mag]"
    rows = [[head, *(cells[k] for cells in columns.values())] for k, head in enumerate(heads)]
    record.table("throughputs", ["", *columns], rows)
    for grating, panel in panels.items():
        panel.set(xlim=(240, 1100), ylim=(0, None), ylabel="electrons per photon at the aperture")
        panel.set_title("gratings, first order" if grating else "imaging bands", fontsize=10)
        panel.legend(fontsize=8, ncols=2, loc="upper right")
    panels[True].set_xlabel("wavelength [nm]; lines below the curves: the four wavelengths of the PSF")
    return figure


def led_bands(camera, record):
    """Return the Figure of the lamps' lines over the throughput of the bands; records what each band receives."""
    figure = Figure(figsize=(10, 5.6), layout="constrained")
    top, middle = figure.subplots(2, 1, sharex=True, height_ratios=(1, 1.4))
    leds = load_leds(camera.leds)
    flats = {f"{wave:g}" for wave in camera.leds["flat"]["wavelengths"]}
    for led in leds.values():
        wave, line = 0.1 * next(iter(camera.filters.values())).wavelength, led.line / led.line.max()
        some, tint = line > 1e-3, BLUE if led.name in flats else ORANGE
        top.fill_between(wave[some], line[some], color=tint, alpha=0.5, lw=0)
        top.annotate(led.name, (float(led.name), 1.03), rotation=90, ha="center", va="bottom", fontsize=8, color=tint)
    top.set(ylim=(0, 1.5), yticks=[0, 1], ylabel="line, peak 1")
    top.set_title("lamps [nm]: width as set in leds.yaml; orange: no flat of its own was taken", fontsize=10)
    rows = []
    for one, style, grating in drawn_filters(camera):
        name = style.pop("label")
        some = one.throughput > 0
        width = 1.0 if grating else 1.8
        middle.plot(0.1 * one.wavelength[some], one.throughput[some], **style, lw=width, label=name)
        share = {led.name: np.trapezoid(led.line * one.throughput, one.wavelength) for led in leds.values()}
        rows.append([name, ", ".join(f"{led} ({part:.2f})" for led, part in share.items() if part > 0.01)])
    record.table("led_bands", ["band", "lamps [nm] of whose photons it counts more than 1% (the fraction)"], rows)
    for led in leds.values():
        middle.axvline(float(led.name), color="#999999", lw=0.6, ls=":", zorder=0)
    middle.set(xlim=(240, 1100), ylim=(0, None), xlabel="wavelength [nm]", ylabel="electrons per photon")
    middle.legend(fontsize=8, ncols=2, loc="upper right")
    return figure


def on_map(ra, dec):
    """Return x, y of a Mollweide axis for ra, dec [deg]: east to the left, ra 180 in the middle."""
    return np.radians(180.0 - np.asarray(ra) % 360.0), np.radians(dec)


def curve(axes, frame, style, label):
    """Draw a frame's equator."""
    where = SkyCoord(np.linspace(0, 360, 721), np.zeros(721), unit="deg", frame=frame).icrs
    x, y = on_map(where.ra.deg, where.dec.deg)
    order = np.argsort(x)
    axes.plot(x[order], y[order], style, lw=1.0, label=label)


def whole_bricks(ra, dec):
    """Return how many bricks lie wholly in a field's circle: along the border of each, 32 points do."""
    centre = unit_vectors(ra, dec)
    near = healpy.query_disc(NSIDE, centre, np.radians(RADIUS), inclusive=True, nest=True)
    return sum(int((angle(unit_vectors(*brick_corners(pix, 8)), centre) < RADIUS).all()) for pix in near)


def sky(camera, record):
    """Return the Figure of the fields on the sky, over the dust, and of each field's pointings; records both."""
    figure = Figure(figsize=(10, 7.4), layout="constrained")
    whole, row = figure.subfigures(2, 1, height_ratios=(2.4, 1))
    axes = whole.add_subplot(projection="mollweide")
    ra, dec = np.meshgrid(2 * SIDE, SIDE - 90.0)
    ebv = load_universe(SHIPPED / "universe").dust.ebv(ra.ravel(), dec.ravel()).reshape(ra.shape)
    x, y = on_map(ra, dec)
    shown = axes.pcolormesh(
        x, y, np.log10(np.maximum(ebv, 1e-3)), cmap="Greys", vmin=-2.2, vmax=0.6, shading="nearest", rasterized=True
    )
    whole.colorbar(shown, ax=axes, shrink=0.6, label="log E(B-V)")
    curve(axes, Galactic(), "--", "Galactic equator")
    curve(axes, BarycentricMeanEcliptic(), ":", "ecliptic")
    small = row.subplots(1, len(FIELDS), sharex=True, sharey=True)
    pixels = np.prod(ReadoutFrame.of(camera.detector, None).stored_shape("channels"))
    rows, total, bricks = [], 0, 0

    def cells(name, exposures, bricks, paper):
        size = float(exposures * len(camera.chips) * pixels * PIXEL)
        return [name, exposures, bricks, paper, f"{size / 1e12:.2f}", f"{2 * size / 2**40:.2f}"]

    for (name, (ra0, dec0, *_)), panel in zip(FIELDS.items(), small, strict=True):
        table = load_survey_table(SHIPPED.parent / "survey_tables" / f"{name}.csv", camera.orbit).values()
        name = name.upper()
        ra, dec = np.array([[pointing.ra, pointing.dec] for pointing in table]).T
        axes.plot(*on_map(ra, dec), ".", color=BLACK, ms=2)
        lat = float(galactic(ra0, dec0)[1])
        axes.annotate(
            f"{name}, b = {lat:.0f}°",
            on_map(ra0, dec0),
            (9, 7),
            textcoords="offset points",
            fontsize=9,
            bbox={"fc": "w", "ec": "none", "pad": 1},
        )
        east, north = offsets(ra, dec, ra0, dec0)
        panel.plot(east, north, ".", color=BLACK, ms=2.5)
        turn = np.linspace(0, 2 * np.pi, 200)
        panel.plot(RADIUS * np.cos(turn), RADIUS * np.sin(turn), color=ORANGE, lw=1.2)
        panel.set_title(f"{name} ({ra0:g}°, {dec0:g}°): {len(ra)}", fontsize=9)
        panel.set(aspect="equal", xlim=(1.8, -1.8), ylim=(-1.8, 1.8), xlabel="east [deg]")
        whole = whole_bricks(ra0, dec0)
        rows.append(cells(f"{name} ({ra0:g}°, {dec0:g}°)", len(ra), whole, PAPER[name]))
        total, bricks = total + len(ra), bricks + whole
    heads = (
        "bricks wholly in 5 deg²",
        "paper [TB]",
        "Level-0 files here, 10¹² bytes",
        "with the rotated half, 2⁴⁰ bytes",
    )
    record.table(
        "fields", ["field", "exposures, paper and here", *heads], [*rows, cells("all", total, bricks, PAPER["all"])]
    )
    record.value("bricks", bricks, "bricks wholly within the five circles", goal=bricks == BRICKS)
    record.value("file", pixels * PIXEL / 1e6, "pixels of a Level-0 file", unit="MB")
    small[0].set_ylabel("north [deg]")
    hours = range(330, 0, -30)
    axes.set_xticks(np.radians([180 - h for h in hours]), [f"{h}°" for h in hours], fontsize=7)
    axes.grid(lw=0.3)
    axes.legend(fontsize=8, loc="lower right", bbox_to_anchor=(1.0, -0.08))
    axes.set_title(
        f"Boresights of the {total} exposures of Cycle 9; below: each field, its 5 square degrees in orange",
        fontsize=10,
        pad=14,
    )
    return figure


def main() -> None:
    """Draw all three."""
    with Record(argparse.ArgumentParser(description=__doc__.splitlines()[0])) as record:
        camera = load_camera()
        for name, draw in (("throughputs", throughputs), ("led_bands", led_bands), ("fields", sky)):
            figure = draw(camera, record)
            figure.savefig(record.figure(f"{name}.png"), dpi=90)


if __name__ == "__main__":
    main()
