"""Fluxes of isolated true galaxies and stars of a full-depth r chip against their electrons; stars told from galaxies.

    python benchmarks/galaxy_light.py [CAMPAIGN]

Measures the first frame of the campaign (default: that of chip_stages.py, made first if it does not exist) and prints,
by the truth's S/N and the bulge's fraction of the light, the median error, the scatter and the width of the pulls of
total and Kron fluxes. Then galaxies and stars called such by magnitude, the pulls of stars' positions, detections
without a shape, and the CPU seconds of the total fluxes in a run with compiled kernels. An object is isolated if all
others within NEAR have less than SHARE of its light together, and none within FAR has more than BRIGHT times its light.
"""

import argparse
import time
from itertools import pairwise

from evidence.record import Record

import numpy as np
from chip_stages import campaign, measured

from csstsim.campaign.job import Job
from csstsim.campaign.opened import OpenCampaign
from csstsim.catalog.table import GALAXY, ObjectTable
from csstsim.io.truth import read_truth
from csstsim.measure import catalogue
from csstsim.measure.bricks.match import one_to_one
from csstsim.measure.source_columns import BAD_PIXELS, BLENDED, NO_SHAPE, SATURATED, SHARP, TRUNCATED

NEAR, SHARE, FAR, BRIGHT = 30.0, 0.02, 150.0, 100.0  # px
EDGE = 100  # px from the edge of the chip
REACH = 2.7  # px, or half the half-light radius, in which an object has its detection
SPOILT = BLENDED | TRUNCATED | SATURATED | SHARP | BAD_PIXELS
SNR = 5, 8, 13, 20, 35, 60, 120, 500
TOGETHER = 20, 500
MAGNITUDES = 18, 22, 23, 24, 24.5, 25, 25.5, 26
FEW = 8
FILTER = "r"


def timed():
    """Make the functions of total fluxes count their CPU seconds; return the list they are added to."""
    spent = []

    def clocked(function):
        def call(*args):
            start = time.process_time()
            try:
                return function(*args)
            finally:
                spent.append(time.process_time() - start)

        return call

    for name in ("profile_tables", "total_light"):
        setattr(catalogue, name, clocked(getattr(catalogue, name)))
    return spent


def isolated(truth):
    """Return the mask of objects whose light no other object disturbs."""
    from scipy.spatial import cKDTree

    light = truth["electrons"].astype(float)
    tree = cKDTree(np.column_stack([truth["x"], truth["y"]]))
    near, alone = np.zeros(len(light)), np.ones(len(light), bool)
    for one, other in (np.s_[:, 0], np.s_[:, 1]), (np.s_[:, 1], np.s_[:, 0]):
        pairs = tree.query_pairs(NEAR, output_type="ndarray")
        np.add.at(near, pairs[one], light[pairs[other]])
        pairs = tree.query_pairs(FAR, output_type="ndarray")
        alone[pairs[one][light[pairs[other]] > BRIGHT * light[pairs[one]]]] = False
    return alone & (near < SHARE * light)


def spread(values):
    """Return the scatter of values, from their median absolute deviation."""
    return 1.4826 * np.median(np.abs(values - np.median(values)))


def fluxes(truth, found, row, judged, record):
    """Record errors and pulls by kind and S/N."""
    galaxy, bulge = truth["obj_type"] == GALAXY, np.nan_to_num(truth["bulge_frac"])
    kinds = {
        "galaxies": galaxy, "discs": galaxy & (bulge < 0.15), "bulges": galaxy & (bulge > 0.5),
        "mixed": galaxy & (bulge >= 0.15) & (bulge <= 0.5), "stars": ~galaxy,
    }  # fmt: skip
    header = ["S/N", "n", "`flux_total`", "scatter", "pulls", "`flux_kron`", "scatter", "pulls"]
    for kind, some in kinds.items():
        lines = []
        for low, high in (*pairwise(SNR), TOGETHER):
            rows = np.flatnonzero(some & judged & (truth["snr"] >= low) & (truth["snr"] < high))
            if len(rows) < FEW and not record.toy:
                continue
            true, cells = truth["electrons"][rows], []
            for name in ("total", "kron"):
                flux, error = (found[f"flux_{name}{end}"][row[rows]] for end in ("", "_err"))
                off = -2.5 * np.log10(np.maximum(flux / true, 0.01))
                middle, chance = np.median(off), 1.25 * spread(off) / max(len(rows), 1) ** 0.5
                what = f"{kind}, S/N {low} to {high}: median {name} less true magnitude"
                if kind in ("galaxies", "stars"):
                    record.value(f"{kind}_{name}_{low}_{high}", middle, what, unit="mag", error=chance)
                beside = f" ± {chance:.3f}" if name == "total" else ""
                pulls = spread((flux - true) / error)
                cells += [f"{middle:+.3f}{beside}", f"{spread(off):.3f}", f"{pulls:.2f}"]
            lines.append([f"{low} to {high}", len(rows), *cells])
        record.table(kind, header, lines)


def separation(truth, found, row, judged, record):
    """Record fractions of galaxies and stars that are called such, and of those called stars that are."""
    galaxy = truth["obj_type"] == GALAXY
    star, narrow = found["star"][row], (found["spread"] < catalogue.STAR_SPREAD + 2.5 * found["spread_err"])[row]
    lines = []

    def fraction(some: np.ndarray, of: np.ndarray) -> str:
        return f"{(some & of).sum() / of.sum():.2f}" if of.any() else "-"

    for low, high in pairwise(MAGNITUDES):
        inside = judged & (truth["mag"] >= low) & (truth["mag"] < high)
        galaxies, stars = inside & galaxy, inside & ~galaxy
        called = fraction(~star, galaxies), stars.sum(), fraction(star, stars)
        pure = (fraction(~galaxy, inside & some) for some in (star, narrow))
        lines.append([f"{low:g} to {high:g}", galaxies.sum(), *called, *pure])
    header = ["r [mag]", "galaxies", "called such", "stars", "called such", "called stars that are"]
    record.table("separation", [*header, "the same by `spread` alone"], lines)


def positions_and_shapes(
    truth: ObjectTable, found: ObjectTable, row: np.ndarray, judged: np.ndarray, record: Record
) -> None:
    """Record the width of the pulls of stars' positions, and the fraction of detections without a shape."""
    stars = np.flatnonzero((truth["obj_type"] != GALAXY) & judged)
    for low, high in (5, 20), (20, 100), (100, 500):
        some = stars[(truth["snr"][stars] >= low) & (truth["snr"][stars] < high)]
        off = np.cos(np.radians(truth["dec_epoch"][some])), np.ones(len(some))
        off = [
            3600 * (found[name][row[some]] - truth[f"{name}_epoch"][some]) * scale / found["pos_err"][row[some]]
            for name, scale in zip(("ra", "dec"), off, strict=True)
        ]
        what = f"stars, S/N {low} to {high}: width of the pulls of positions, of {len(some)} stars"
        pulls, chance = spread(np.concatenate(off)), 0.83 / max(len(some), 1) ** 0.5
        record.value(f"position_pulls_{low}_{high}", pulls, what, error=chance * pulls)
    without, faint = (found["flags"] & NO_SHAPE) > 0, ~(found["snr"] >= 5)
    record.value("no_shape_faint", without[faint].mean(), "detections of S/N < 5 without a shape, fraction")
    record.value("no_shape_bright", without[~faint].mean(), "detections of S/N >= 5 without a shape, fraction")


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("campaign", nargs="?")
    with Record(parser) as record:
        report(record)


def report(record: Record) -> None:
    """Measure the chip, and compare with the truth."""
    from csstsim.command_line.main import main as csstsim

    file = record.options.campaign or campaign(record.toy)
    run = OpenCampaign(file)
    job = next(job for job in run.jobs if job.chip.filter == FILTER)
    if record.toy or not run.paths.level0(job).exists():
        measured(file, job.obsid, job.chip.id)
    spent = timed()
    for _ in range(1 if record.toy else 2):  # the first compiles the kernels
        spent.clear()
        csstsim(["measure", str(file), "--obsid", job.obsid, "--chip", str(job.chip.id)], standalone_mode=False)
    truth, found, row, judged = compared(run, job)
    fluxes(truth, found, row, judged, record)
    separation(truth, found, row, judged, record)
    positions_and_shapes(truth, found, row, judged, record)
    record.value("detections", len(found), "detections")
    record.value("evaluated", int(judged.sum()), "isolated objects that are evaluated")
    record.value("total_cpu", sum(spent), "CPU time of the total fluxes", unit="CPU-s")


def compared(run: OpenCampaign, job: Job) -> tuple[ObjectTable, ObjectTable, np.ndarray, np.ndarray]:
    """Return (truth, sources, the source of each true object or -1, mask of isolated objects with a good source)."""
    truth, found = read_truth(run.paths.level0_truth(job)), ObjectTable.read(run.paths.measure(*job.key))
    x, y = truth["x"], truth["y"]
    size = np.where(truth["obj_type"] == GALAXY, np.nan_to_num(truth["size"]), 0.0) / run.camera.telescope.pixel_scale
    bright = np.flatnonzero(truth["snr"] > 2.0)
    row = np.full(len(truth), -1)
    row[bright] = one_to_one(
        np.column_stack([x, y])[bright],
        np.column_stack([found["x"], found["y"]]),
        np.maximum(REACH, 0.5 * size)[bright],
    )
    inside = (np.minimum(x, y) > EDGE) & (x < job.chip.detector.nx - EDGE) & (y < job.chip.detector.ny - EDGE)
    judged = isolated(truth) & inside & (row >= 0) & ((found["flags"][row] & SPOILT) == 0)
    return truth, found, row, judged


if __name__ == "__main__":
    main()
