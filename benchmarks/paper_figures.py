"""The paper's validation figures (section 6: magnitudes, brightness, colours) from csstsim's data.

    snakemake --profile profiles/default --config campaign=examples/ten_images.yaml
    python benchmarks/paper_bricks.py
    python benchmarks/paper_figures.py

Magnitudes and counts are from ten whole r images, both r chips of an exposure of each Cycle-9 field drawn by lot. The
colours are from ten merged bricks, those in which the middles of these images lie. Draws docs/figures/paper_figures.png
and prints the main numbers of it.
"""

import argparse
from pathlib import Path

from evidence.record import Record

import numpy as np
from matplotlib.figure import Figure
from paper_bricks import IMAGES, OUTPUT, RADIUS, TOY_RADIUS, campaigns, make, toy_images

from csstsim.campaign.opened import OpenCampaign
from csstsim.catalog.table import GALAXY, ObjectTable
from csstsim.measure.bricks.validation import compare
from csstsim.measure.bricks.validation.measured_frame import MeasuredFrame, distinct, truth_inside
from csstsim.measure.bricks.validation.trials import joined, magnitude_at_fraction, matched, trials
from csstsim.report.colour_panel import colours
from csstsim.report.style import BLACK, BLUE, ORANGE, band_styles
from csstsim.stages.level0 import truth_of

EDGES = np.arange(16.0, 29.01, 0.25)
FEWEST = 10  # objects of a bin
PSF_RANGE, KRON_RANGE = (19.0, 25.5), (19.0, 23.0)  # mag
KINDS = ("stars and quasars", BLUE, "psf"), ("galaxies", ORANGE, "kron")


def frames_of(run):
    """Yield (MeasuredFrame, its judged truth with measured magnitudes `mag_out`, NaN where not found) of each image."""
    for job in run.imaging_jobs:
        frame = MeasuredFrame(truth_of(run, job), ObjectTable.read(run.paths.measure(*job.key)), *_chip(run))
        truth = truth_inside(frame)
        row = matched(truth, frame.measured, frame.pixel)
        galaxy = truth["obj_type"] == GALAXY
        mag = np.where(galaxy, frame.measured["mag_kron"][row], frame.measured["mag_psf"][row])
        saturated = (frame.measured["flags"][row] & compare.SATURATED) != 0
        yield frame, truth.with_columns(mag_out=np.where((row >= 0) & ~saturated, mag, np.nan))


def magnitudes(axes, truths, band, fewest):
    """Draw measured minus true magnitudes against true ones, for isolated stars and galaxies."""
    for mine, (kind, tint, light), panel in zip((False, True), KINDS, axes, strict=True):
        given, off = (
            np.concatenate([values(t)[(t["obj_type"] == GALAXY) == mine] for t in truths])
            for values in (lambda t: t[f"mag_{band}"].astype(float), lambda t: t["mag_out"] - t[f"mag_{band}"])
        )
        alone = np.concatenate([~t["blended"][(t["obj_type"] == GALAXY) == mine] for t in truths])
        good = alone & np.isfinite(off)
        panel.plot(given[good], off[good], ".", color=tint, ms=1.5, alpha=0.3, rasterized=True)
        which = np.digitize(given[good], EDGES)
        bins = [
            (EDGES[k - 1] + 0.125, off[good][which == k]) for k in range(1, len(EDGES)) if (which == k).sum() >= fewest
        ]
        x, parts = zip(*bins, strict=True)
        for share, line in ((50, "-"), (16, ":"), (84, ":")):
            panel.plot(x, [np.percentile(part, share) for part in parts], line, color=BLACK, lw=1.5)
        panel.axhline(0.0, color="#666666", lw=0.8)
        panel.set(xlim=(16, 28), ylim=(-1, 1), xlabel=f"true {band} [AB mag]", ylabel=f"{light} out - in [mag]")
        panel.set_title(f"{kind}: {good.sum()} isolated ones found, of {len(given)}; median, 16 and 84%", fontsize=10)


def offsets(record, truths, band):
    """Record how far measured magnitudes of isolated stars and galaxies are from true ones."""
    true = np.concatenate([t[f"mag_{band}"].astype(float) for t in truths])
    off = np.concatenate([t["mag_out"] for t in truths]) - true
    galaxy, alone = (np.concatenate([t[name] for t in truths]) for name in ("obj_type", "blended"))
    good = np.isfinite(off) & ~alone.astype(bool)
    for mine, key, what, (low, high) in (
        (False, "psf", "PSF magnitudes of isolated stars", PSF_RANGE),
        (True, "kron", "Kron magnitudes of isolated galaxies", KRON_RANGE),
    ):
        some = off[good & ((galaxy == GALAXY) == mine) & (true > low) & (true < high)]
        error = 1.25 * float(np.std(some)) / max(len(some), 1) ** 0.5
        what = f"{what} of {low:g} to {high:g} mag, out less in, median"
        record.value(f"{key}_off", float(np.median(some)) if len(some) else np.nan, what, unit="mag", error=error)


def distributions(axes, truths, frames, band):
    """Draw counts by magnitude: true objects, those found, and measured sources by the classifier's kind."""
    star = np.concatenate([frame.measured["star"] for frame in frames])
    bright = np.concatenate([frame.measured["snr"] for frame in frames]) > 5.0
    for mine, (kind, tint, light) in zip((False, True), KINDS, strict=True):
        given = np.concatenate([t[f"mag_{band}"][(t["obj_type"] == GALAXY) == mine] for t in truths])
        found = np.concatenate([np.isfinite(t["mag_out"][(t["obj_type"] == GALAXY) == mine]) for t in truths])
        listed = np.concatenate([frame.measured[f"mag_{light}"] for frame in frames])[(star != mine) & bright]
        style = {"bins": EDGES, "histtype": "step", "color": tint, "log": True}
        axes.hist(given, **style, ls="-", lw=1.0, label=f"{kind}, true ({len(given)})")
        axes.hist(given[found], **style, lw=2.5, label=f"... found ({found.sum()}), by true magnitude")
        axes.hist(
            listed[np.isfinite(listed)], **style, ls=":", lw=1.5, label=f"listed as such at S/N > 5 ({len(listed)})"
        )
    axes.set(xlim=(16, 29), ylim=(1, None), xlabel=f"{band} [AB mag]", ylabel="objects in 0.25 mag, ten images")
    axes.set_title("Brightness, input and output", fontsize=10)
    axes.legend(fontsize=8, loc="upper left")


def shares(axes, record, table, band, depth):
    """Draw the fraction of isolated objects found against magnitude, and record where it is one half."""
    galaxy, found = table["galaxy"].astype(bool), table["found"] > 0
    for mine, (kind, tint, _) in zip((False, True), KINDS, strict=True):
        some = galaxy == mine
        n, seen = (np.histogram(table["mag"][part], EDGES)[0] for part in (some, some & found))
        good = n > 9
        axes.plot(EDGES[:-1][good] + 0.125, seen[good] / n[good], "-o", color=tint, ms=3, label=kind)
        half, key = magnitude_at_fraction(table["mag"][some], found[some]), kind.split()[0]
        record.value(f"isolated_{key}", int(some.sum()), f"isolated {kind}")
        what = f"half of the isolated {kind} are found at this {band}"
        record.value(f"half_{key}", np.nan if half is None else half, what, unit="mag")
    axes.axvline(depth, color="#666666", ls=":", label="5 sigma of a point source")
    axes.axhline(0.95, color="#666666", ls="--", lw=1, label="95%")
    axes.set(xlim=(20, 29), ylim=(0, 1.05), xlabel=f"true {band} [AB mag]", ylabel="fraction found in one exposure")
    axes.set_title("Detection", fontsize=10)
    axes.legend(fontsize=8, loc="lower left")
    judged = ~galaxy & (table["snr"] > 5.0) & (table["snr"] < compare.SNR_MAX)
    n, part = int(judged.sum()), float(found[judged].mean())
    record.value("points", n, "isolated point sources of S/N 5 to 500")
    record.value(
        "points_found", part, "of them found, fraction", error=(part * (1 - part) / max(n, 1)) ** 0.5, above=0.95
    )


def brick_colours(runs):
    """Return validation.compare.colours of merged bricks, {brick: its OpenCampaign}."""
    parts = []
    for pix, run in runs.items():
        sources = ObjectTable.read(run.paths.merge(pix))
        jobs = run.merge_bricks[pix]
        tables = (ObjectTable.read(run.paths.measure(*job.key)) for job in jobs)
        truths = [
            truth_inside(MeasuredFrame(truth_of(run, job), t, *_chip(run))) for job, t in zip(jobs, tables, strict=True)
        ]
        truth = distinct(truths, [f"mag_{band}" for band in "ugr"])
        parts.append(compare.colours(truth, sources, compare.match(truth, sources), "ugr"))
    joined_up = {name: np.concatenate([part[name] for part in parts], axis=-1) for name in parts[0]}
    return joined_up | {"bands": tuple("ugr")}


def _chip(run):
    return run.camera.detector.channel_ny, run.camera.telescope.pixel_scale


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=Path, default=IMAGES)
    parser.add_argument("--radius", type=float, default=RADIUS, help="That of paper_bricks.py, arcmin.")
    with Record(parser) as record:
        figures(record)


def figures(record: Record) -> None:
    """Draw the figure, and record its main numbers."""
    options, output = record.options, OUTPUT
    if record.toy:
        options.images, options.radius = toy_images(record.results / "paper_images_of_figures"), TOY_RADIUS
        output = record.results / "paper_bricks_of_figures"
    run = OpenCampaign(options.images)
    frames, truths = zip(*frames_of(run), strict=True)
    band = frames[0].band
    table = joined([trials(truth, frame) for frame, truth in zip(frames, truths, strict=True)])
    figure = Figure(figsize=(13, 14), layout="constrained")
    panels = figure.subplots(3, 2)
    magnitudes(panels[0], truths, band, 1 if record.toy else FEWEST)
    distributions(panels[1, 0], truths, frames, band)
    shares(panels[1, 1], record, table, band, float(np.median([frame.info["depth_5sigma"] for frame in frames])))
    offsets(record, truths, band)
    galaxy = np.concatenate([truth["obj_type"] == GALAXY for truth in truths])
    record.value("galaxies", int(galaxy.sum()), f"galaxies of the {len(frames)} images")
    record.value("stars", int((~galaxy).sum()), f"stars and quasars of the {len(frames)} images")
    merged = campaigns(options.images, output, options.radius)
    for pix, one in merged.items() if record.toy else ():
        make(one, pix)
    colour = brick_colours(merged)
    colours(panels[2, 0], colour, band_styles(run.camera.filters))
    off = np.hypot(*(colour["output"] - colour["input"]))
    for mine, (kind, tint, _) in zip((False, True), KINDS, strict=True):
        some = colour["galaxy"] == mine
        panels[2, 1].hist(off[some], np.linspace(0, 0.6, 25), histtype="step", color=tint, lw=1.5, label=kind)
        key = kind.split()[0]
        record.value(f"coloured_{key}", int(some.sum()), f"{kind} with colours")
        record.value(
            f"colours_{key}", float(np.median(off[some])), f"colours of {kind}, out from in, median", unit="mag"
        )
    panels[2, 1].set(xlabel="distance of measured from true colours [mag]", ylabel="sources")
    panels[2, 1].set_title("Colours of the same sources, out - in", fontsize=10)
    panels[2, 1].legend(fontsize=8)
    figure.suptitle(f"{len(frames)} whole {band} images; colours of {len(merged)} merged bricks")
    figure.savefig(record.figure("paper_figures.png"), dpi=85)


if __name__ == "__main__":
    main()
