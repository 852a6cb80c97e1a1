"""Cost of dispersed spectra, and accuracy by the number of slabs: the numbers of config/render.yaml.

    python benchmarks/spectra.py [--filter GV]

* photons: ns per electron of all orders (stars, galaxies), and ns per object with almost no electrons;
* slabs: a fit  constant + slab_pixel x slabs x (2 reach + 1)^2  over stamps of several sizes, at most four per pixel;
* the paper's method (bench.slitless.peers) and GalSim's slabs, in the same run;
* error of 1, 2, 4 and 8 slabs per pixel against 16, visible error over S/N: the largest over positions in a pixel. For
  galaxies with the number that render.slitless.slabs uses;
* visible error of a star of 1e5 electrons on a node against direct optics, by four slabs per pixel and by the paper.
"""

import argparse
import time
from dataclasses import replace

from evidence.record import Record

import galsim
import numpy as np
from bench_setting import setting_of

from csstsim.base.counter import object_keys
from csstsim.base.rng import stream
from csstsim.optics.psf.psf_file import pixel_response
from csstsim.render.canvas import Canvas
from csstsim.render.slitless import slabs as engine
from csstsim.render.slitless.dispersed_photons import shoot_spectra
from csstsim.render.slitless.slabs import draw_spectra
from csstsim.render.slitless.traces import Traces
from csstsim.studies.bench.imaging.measures import visible
from csstsim.studies.bench.imaging.peers import BANDS, galaxy_of
from csstsim.studies.bench.setting import Setting
from csstsim.studies.bench.slitless import peers as spectrum_peers
from csstsim.studies.bench.slitless.cases import SPECTRA, make_spectrum_case
from csstsim.studies.bench.slitless.methods import METHODS, PER_PX, slabs
from csstsim.studies.bench.slitless.truth import SpectrumTruth
from csstsim.studies.bench.sweep import measure_case, significance

SHAPES = {"star": {}, "galaxy n = 1": {"size": 0.3, "e": 0.3}, "galaxy n = 4": {"size": 0.3, "bulge": 1.0, "e": 0.3}}
BRIGHT, MANY, PLACES, FINEST = 1e5, 300, 4, 16
REACHES, TOY_REACHES = (32, 48, 80, 128), (16, 32)
TOY_SHAPES = {"star": {}, "galaxy n = 1": {"size": 0.1, "e": 0.3}}


def galsim_slabs(per_px):
    """Return the prepare of GalSim's slabs: a monochromatic stamp every 1 / per_px of a pixel of the trace.

    Each is at its exact position, with the light of the bins nearest to it; PSF objects are made once.
    """

    def prepare(setting, case):
        scene, per_pixel, window = case.scene, setting.psf.oversampling, case.window
        reach = int(case.row["reach"][0])
        dx, dy, light = spectrum_peers.trace(setting, case)
        points = [
            galsim.InterpolatedImage(
                galsim.ImageD(pixel_response(spectrum_peers.cells(setting, scene, band), per_pixel)),
                scale=1 / per_pixel, normalization="sb", x_interpolant="quintic",
            )
            for band in range(BANDS)
        ]  # fmt: skip
        profiles = points if case.star else [galsim.Convolve(galaxy_of(scene), point) for point in points]
        which = np.round((dx - dx.min()) * per_px).astype(int)
        total = np.bincount(which, light)
        lit = np.flatnonzero(total)
        x = scene.x[0] + dx.min() + lit / per_px
        y = scene.y[0] + np.bincount(which, light * dy)[lit] / total[lit]
        mixture = np.stack([np.bincount(which, light * w)[lit] for w in setting.disperser.psf_weights])

        def draw(copies):
            image = np.zeros(window.shape)
            for _ in range(copies):
                for k in range(len(lit)):
                    parts = [profiles[band] * mixture[band, k] for band in range(BANDS) if mixture[band, k] > 0]
                    column, row = round(x[k]), round(y[k])
                    stamp = galsim.ImageD(2 * reach + 1, 2 * reach + 1)
                    galsim.Sum(parts).drawImage(
                        stamp, scale=1.0, method="no_pixel", offset=(x[k] - column, y[k] - row)
                    )  # fmt: skip
                    spectrum_peers.add(image, stamp.array, column - reach - window.x0, row - reach - window.y0)
            return image

        return draw

    return prepare


def cpu(function, repeats=5):
    function()
    best = np.inf
    for _ in range(repeats):
        start = time.process_time()
        function()
        best = min(best, time.process_time() - start)
    return best


def copies(setting, case, count):
    """Return (Scene, Traces) of `count` copies of the object."""
    visits = np.repeat(case.visits, count, axis=0)
    visits[:, 0] = np.arange(count)
    traces = Traces(np.repeat(case.binned_density[None], count, axis=0), visits, setting.disperser)
    return case.scene.take(np.zeros(count, int)), traces


def photons(setting, case, count):
    """Return the CPU ns per object of photons of all orders."""
    canvas, keys = Canvas(None, case.window), object_keys(np.uint64(1), np.arange(count))
    canvas.count()
    some = copies(setting, case, count)
    took = cpu(lambda: shoot_spectra(canvas, *some, keys, setting.table))
    return 1e9 * took / count


def slab_costs(setting, case, reaches=REACHES):
    """Return (constant, ns per pixel of the stamp for each slab)."""
    canvas, (one, traces) = Canvas(np.zeros(case.window.shape), case.window), copies(setting, case, 1)
    count = setting.disperser.length * engine.densities(case.scene, engine.PER_PX)[0]
    pixels = np.array([count * (2.0 * reach + 1) ** 2 for reach in reaches])
    took = [
        1e9 * cpu(lambda reach=reach: draw_spectra(canvas, one.sized(reach), traces, setting.mixer), 3)
        for reach in reaches
    ]
    slope, constant = np.polyfit(pixels, took, 1)
    return constant, slope


def finest_of(setting, case):
    """Return the image of unit light with FINEST slabs per pixel for objects of any size."""
    as_it_is, engine._SLABS = engine._SLABS, (1e9, 1e9)
    try:
        return slabs(FINEST)(setting, case)(1) / case.electrons
    finally:
        engine._SLABS = as_it_is


def shares(setting, spectrum, shape, places=PLACES):
    """Return {per_px: largest visible error over S/N}."""
    out = dict.fromkeys(PER_PX, 0.0)
    for place in range(places):
        case = make_spectrum_case(setting, stream(place, "spectra"), 0, BRIGHT, spectrum=spectrum, **shape)
        finest = finest_of(setting, case)
        snr = significance(finest, case, setting)
        for per_px in PER_PX:
            image = slabs(per_px)(setting, case)(1) / case.electrons
            seen, _ = visible(image, finest, setting.variance, case.electrons, np.inf)
            out[per_px] = max(out[per_px], seen / snr)
    return out


def against_optics(setting: Setting) -> dict[str, tuple[float, float, float]]:
    """Return {spectrum: (S/N, visible error of four slabs per pixel, of the paper's method)} of a star on a node."""
    truth, found = SpectrumTruth(setting), {}
    for spectrum in SPECTRA:
        case = make_spectrum_case(setting, stream(2, "spectra"), 0, BRIGHT, spectrum=spectrum)
        direct = truth(case)
        images = [prepare(setting, case)(1) / BRIGHT for prepare in (slabs(4), spectrum_peers.paper)]
        seen = [visible(image, direct, setting.variance, BRIGHT, np.inf)[0] for image in images]
        found[spectrum] = significance(direct, case, setting), *seen
    return found


def main(record: Record) -> None:
    """Record costs and errors."""
    setting, toy = setting_of(record, record.options.filter), record.toy
    rates = setting.disperser.rates[0].sum(axis=1)
    orders = rates.sum() / rates[setting.disperser.orders.index(1)]
    record.value("orders", orders, "electrons of all orders over those of the first")
    peers = {"the paper's method": spectrum_peers.paper, "GalSim slabs, 1 per pixel": galsim_slabs(1)}
    shapes, rows = TOY_SHAPES if toy else SHAPES, []
    for name, shape in shapes.items():
        case = make_spectrum_case(setting, stream(1, "spectra"), 0, BRIGHT, spectrum="flat", **shape)
        nothing = photons(setting, case.brighter(1e-3), MANY)
        each = photons(setting, case, 3) / (BRIGHT * orders)
        constant, slope = slab_costs(setting, case, TOY_REACHES if toy else REACHES)
        ms = [each * BRIGHT * orders / 1e6]
        for prepare in (slabs(4), *peers.values()):
            ms.append(1e3 * measure_case(replace(METHODS[0], prepare=prepare), setting, case, 0.0, 0)[1])
        key = name.replace(" ", "").replace("=", "").replace("galaxy", "")
        record.value(f"{key}_ns", each, f"an electron of a {name} through the grating", unit="CPU-ns")
        rows.append([
            name, f"{each:.0f}", f"{nothing / 1e3:.0f}", f"{constant / 1e6:.1f}", f"{slope:.2f}",
            *(f"{value:,.{1 if value < 20 else 0}f}" for value in ms),
        ])  # fmt: skip
        print(*rows[-1], sep="; ", flush=True)
    record.table("costs", [
        "object", "photons, ns an electron", "an object of none, us", "slabs: ms", "and ns a pixel of each slab",
        f"{BRIGHT:.0e} electrons, ms: photons".replace("e+0", "e"), "slabs, 4 per pixel", *peers,
    ], rows)  # fmt: skip
    rows = []
    for name, shape in shapes.items():
        for spectrum in ("flat", "lines"):
            found = shares(setting, spectrum, shape, 1 if toy else PLACES)
            rows.append([f"{name}, {spectrum}", *(f"{value:.1e}".replace("e-0", "e-") for value in found.values())])
    record.table("slabs", ["slabs per pixel", *map(str, PER_PX)], rows)
    found = against_optics(setting)
    record.table("star", ["spectrum", "S/N", "slabs, 4 per pixel", "the paper's method"], [
        [spectrum, f"{snr:.0f}", f"{ours:.2g}", f"{paper:.2g}"] for spectrum, (snr, ours, paper) in found.items()
    ])  # fmt: skip
    smooth = [ours for spectrum, (_, ours, _) in found.items() if spectrum != "lines"]
    papers = [paper for *_, paper in found.values()]
    star = f"star of {BRIGHT:.0e} electrons, visible error against direct optics"
    record.value("star_smooth", max(smooth), f"{star}: smooth spectra, the largest", unit="of its noise")
    record.value("star_lines", found["lines"][1], f"{star}: lines", unit="of its noise")
    record.value("paper_minimum", min(papers), f"{star}: the paper's method, minimum", unit="of its noise")
    record.value("paper_maximum", max(papers), f"{star}: the paper's method, the largest", unit="of its noise")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--filter", default="GV")
    with Record(parser) as record:
        main(record)
