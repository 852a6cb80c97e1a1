"""Error and cost of slabs against their number per pixel, and those of photons: docs/figures/slab_count.png.

    python benchmarks/slab_count.py [--filter GV]

Error: the visible error against the reference renderer on the same PSF set over the object's S/N, for objects of 1e6
electrons on a node. The number of slabs is forced; large rings mark the largest that render.slitless.slabs uses (four,
fewer for large objects). Photons are drawn until chance alone would show a few thousandths of S/N.
"""

import argparse

from evidence.record import Record

import numpy as np
from bench_setting import setting_of
from matplotlib.figure import Figure

from csstsim.base.rng import stream
from csstsim.render.slitless import slabs as engine
from csstsim.studies.bench.imaging.measures import visible
from csstsim.studies.bench.imaging.methods import Method
from csstsim.studies.bench.slitless.cases import make_spectrum_case
from csstsim.studies.bench.slitless.methods import METHODS, slabs, standard
from csstsim.studies.bench.sweep import measure_case, significance

SHAPES = {
    "star": {},
    "galaxy, n = 1, 0.2 arcsec": {"size": 0.2, "e": 0.3},
    "galaxy, n = 4, 0.1 arcsec": {"size": 0.1, "bulge": 1.0, "e": 0.3},
}
COUNTS, ELECTRONS, PHOTONS, SECONDS = (1, 2, 4, 8, 16), 1e6, 3e7, 0.05
TOY_COUNTS, TOY_PHOTONS, TOY_SECONDS, TOY_SHAPES = (1, 4), 1e5, 0.0, 2
COLOURS = "#0b6e99", "#1a7a3c", "#b5542d"
LINES = {"flat": "--", "lines": "-"}


def forced(per_px):
    """Return the Method of slabs with `per_px` of them per pixel for objects of any size."""
    inner = slabs(per_px)

    def prepare(setting, case):
        draw = inner(setting, case)

        def forced_draw(copies):
            as_it_is, engine._SLABS = engine._SLABS, (1e9, 1e9)
            try:
                return draw(copies)
            finally:
                engine._SLABS = as_it_is

        return forced_draw

    return Method(f"slabs {per_px}", prepare)


def main(record: Record) -> None:
    """Record and draw error and cost of each object by each number of slabs."""
    toy, setting = record.toy, setting_of(record, record.options.filter)
    counts, electrons, seconds = (TOY_COUNTS, TOY_PHOTONS, TOY_SECONDS) if toy else (COUNTS, PHOTONS, SECONDS)
    photons = next(method for method in METHODS if method.name == "photons")
    first = make_spectrum_case(
        setting, stream(7, "slab_count"), 0, ELECTRONS, spectrum="flat", **SHAPES[next(iter(SHAPES))]
    )
    for method in (forced(1), photons):
        measure_case(method, setting, first, 0.0, TOY_PHOTONS)  # compiles it
    figure = Figure(figsize=(11, 4.6), layout="constrained")
    error_axis, cost_axis = figure.subplots(1, 2)
    rows, lines, count = [], [], TOY_SHAPES if toy else len(SHAPES)
    for (name, shape), colour in list(zip(SHAPES.items(), COLOURS, strict=True))[:count]:
        for spectrum, style in LINES.items():
            case = make_spectrum_case(setting, stream(7, "slab_count"), 0, ELECTRONS, spectrum=spectrum, **shape)
            wanted = standard(setting, case) / case.electrons
            snr, found = significance(wanted, case, setting), []
            for method in (*map(forced, counts), photons):
                image, took, drawn = measure_case(method, setting, case, seconds, electrons)
                seen, chance = visible(image, wanted, setting.variance, case.electrons, drawn)
                found.append((max(seen, chance if np.isfinite(drawn) else 0.0) / snr, took))
            errors, costs = np.array(found).T
            used = int(engine.densities(case.scene, engine.PER_PX)[0])
            if spectrum == "lines":
                lines += errors[:-1][np.array(counts) >= 4].tolist()
            label = f"{name}, {spectrum}"
            rows.append([label, f"{snr:.0f}", used, *(f"{e:.1e} ({t:.2g} s)" for e, t in found)])
            print(*rows[-1], sep="; ", flush=True)
            for axis, values in ((error_axis, errors), (cost_axis, costs)):
                axis.plot(counts, values[:-1], style, color=colour, marker="o", ms=4, label=label)
                if used in counts:
                    axis.plot(used, values[counts.index(used)], "o", ms=11, mfc="none", color=colour)
                axis.plot(26, values[-1], "v" if axis is error_axis else "*", ms=8, color=colour,
                          mfc=colour if spectrum == "lines" else "white")  # fmt: skip
    heads = [f"{n} slab{'s' if n > 1 else ''} per pixel" for n in counts]
    record.table("slabs", ["object", "S/N", "slabs in use", *heads, "photons, upper limit"], rows)
    record.value("lines", max(lines), "spectrum of lines, four slabs or more: largest visible error over S/N")
    for axis, title in ((error_axis, "visible error against the reference / S/N"), (cost_axis, "CPU s per object")):
        axis.set(xscale="log", yscale="log", xlabel="slabs per pixel of the trace", title=title)
        axis.set_xticks([*counts, 26], [*map(str, counts), "photons"])
        axis.minorticks_off()
        axis.grid(color="0.9", lw=0.5)
    error_axis.legend(fontsize=8, loc="upper right")
    figure.suptitle(
        "Objects of 10$^6$ e$^-$. Rings: the number in use. Photons: triangles are upper limits, set by chance.",
        size=9.5,
    )
    figure.savefig(record.figure("slab_count.png"), dpi=100)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--filter", default="GV")
    with Record(parser) as record:
        main(record)
