"""Close pairs of stars and galaxies: what several codes find of them, by separation and S/N, and with which flux.

    apt-get install source-extractor psfex; pip install photutils scikit-image
    python benchmarks/pairs.py [--side 44] [--seed 5]

A grid of pairs 7.4" apart on an r chip, in two exposures of full depth with all layers. The objects of a pair are 0.15"
to 1.5" apart. 40% are stars; galaxies have 0.08" to 0.4" and index 1 or 4. The brighter ones have 22.3 to 26 mag, flux
ratios are 0.1 to 1. The codes are those of catalogue_codes.py, on the same calibrated images. The fainter one of a pair
is found if it has a detection of its own within 2.5 px. What is found by chance is taken off: detections at the place
mirrored about the brighter one. The goal of csstsim is the best of the others, less twice its error.
"""

import argparse
import subprocess
import sys
import tempfile
from itertools import pairwise
from pathlib import Path

from evidence.record import Record

import numpy as np
import yaml
from astropy.table import Table
from catalogue_codes import CODES, DEEP, OURS, run_code, why_not
from matplotlib.figure import Figure
from scipy.spatial import cKDTree

from csstsim.base.arrays.robust_sigma import SIGMA_PER_MAD
from csstsim.base.shipped import SHIPPED
from csstsim.campaign.opened import OpenCampaign
from csstsim.catalog.table import ObjectTable
from csstsim.io.truth import read_truth
from csstsim.measure.bricks.match import one_to_one
from csstsim.measure.bricks.validation.compare import area_ratio, half_light
from csstsim.measure.bricks.validation.trials import MATCH_PX
from csstsim.stages.measure import measured_table
from csstsim.studies.bench.chart import OURS as OUR_COLOUR
from csstsim.studies.bench.chart import PEERS

RA, DEC, CHIP = 150.1, 2.2, 9
STEP, JITTER = 7.4, 0.04  # arcsec
SEPARATION = 0.15, 1.5  # arcsec
MAGNITUDES, RATIO = (22.3, 26.0), 0.1
STARS, SIZES, BULGES = 0.4, (0.08, 0.4), 0.3  # fraction; arcsec; fraction of the galaxies with index 4
BRIGHT = 18.5, 20.0  # mag, of two rows of stars below the grid
EDGE, NEAR = 30.0, 20.0  # px
LINES = (0.15, 0.25, 0.35, 0.5, 0.7, 0.9, 1.2, 1.5)  # arcsec
COLUMNS = (
    "snr", "snr_fainter", "arcsec", "ratio", "found", "found_fainter", "chance", "galaxy", "galaxy_fainter", "flux",
    "flux_fainter",
)  # fmt: skip


def objects(side: int, seed: int) -> Table:
    """Return the table of side x side pairs; ids 2 k + 1 and 2 k + 2 are a pair."""
    rng = np.random.default_rng(seed)
    grid = (np.arange(side) - (side - 1) / 2) * STEP
    north, east = (v.ravel() + rng.uniform(-JITTER, JITTER, side**2) for v in np.meshgrid(grid, grid, indexing="ij"))
    n = len(east)
    apart, angle = rng.uniform(*SEPARATION, n), rng.uniform(0, 2 * np.pi, n)
    mag = rng.uniform(*MAGNITUDES, n)
    fainter = mag - 2.5 * np.log10(10 ** rng.uniform(np.log10(RATIO), 0, n))
    parts = []
    for k, m in enumerate((mag, fainter)):
        star, bulge = rng.random((2, n)) < np.array([[STARS], [BULGES]])
        e, turn = rng.rayleigh(0.15, n).clip(0, 0.6), rng.uniform(0, 2 * np.pi, n)
        size = rng.uniform(*SIZES, n)
        parts.append(
            {
                "id": 2 * np.arange(n) + k + 1,
                "ra": RA + (east + k * apart * np.cos(angle)) / 3600 / np.cos(np.radians(DEC)),
                "dec": DEC + (north + k * apart * np.sin(angle)) / 3600,
                "mag_r": m,
                "type": np.where(star, "star", "galaxy"),
                "size": np.where(star, 0.0, size),
                "n": np.where(bulge, 4.0, 1.0),
                "e1": np.where(star, 0.0, e * np.cos(turn)),
                "e2": np.where(star, 0.0, e * np.sin(turn)),
            }
        )
    for row in (1, 2):  # for the model of the PSF that psfex makes
        stars = {name: np.zeros(side) for name in parts[0]} | {
            "id": 1_000_000 * row + 2 * np.arange(side),
            "ra": RA + grid / 3600 / np.cos(np.radians(DEC)),
            "dec": np.full(side, DEC + (grid[0] - row * STEP) / 3600),
            "mag_r": rng.uniform(*BRIGHT, side),
            "type": np.full(side, "star"),
            "n": np.ones(side),
        }
        parts.append(stars)
    return Table({name: np.concatenate([part[name] for part in parts]) for name in parts[0]})


def campaign(folder: Path, side: int, seed: int) -> OpenCampaign:
    """Write the campaign of the pairs into a folder and make its frames; return it."""
    folder.mkdir(parents=True, exist_ok=True)
    objects(side, seed).write(folder / "objects.csv", overwrite=True)
    program = Path(sys.executable).parent / "csstsim"
    aim = [program, "aim", RA, DEC, "--filter", "r", "--chip", CHIP, "--output", folder / "r.csv"]
    (folder / "r.csv").unlink(missing_ok=True)
    subprocess.run(list(map(str, aim)), check=True, stdout=subprocess.DEVNULL)
    content = {
        "schema_version": 1, "name": "pairs", "survey_table": "r.csv", "output": "out", "seed": seed,
        "select": {
            "types": ["SCIE"], "chips": [CHIP],
            "region": {"ra": RA, "dec": DEC, "radius": 0.5 * (side + 6) * STEP / 60},
        },
        "window": "region", "observations": {"SCIE": str(SHIPPED / "observations/science.yaml")},
        "catalog": {
            "kind": "csstsim.catalog.own_table:TableCatalog", "options": {"file": str(folder / "objects.csv")},
        },
        "psf": {"grid": 6 if side > 10 else 2},
    }  # fmt: skip
    file = folder / "campaign.yaml"
    file.write_text(yaml.safe_dump(content, sort_keys=False))
    run = OpenCampaign(file)
    for job in run.jobs:
        for verb in ("chip", "calibrate", "measure"):
            line = [program, verb, file, "--obsid", job.obsid, "--chip", job.chip.id]
            subprocess.run(list(map(str, line)), check=True, stdout=subprocess.DEVNULL)
    return run


def compared(truth: ObjectTable, info: dict, table: ObjectTable, pixel: float) -> tuple[np.ndarray, int]:
    """Return the rows (pairs, COLUMNS) of a frame's catalogue, and the number of its false detections near objects."""
    truth = truth.with_columns(half_light_px=half_light(truth) / pixel)
    electrons = truth["electrons"].astype(float)
    snr = electrons / np.sqrt(electrons + info["n_eff"] * area_ratio(truth, info["n_eff"]) * info["rms"] ** 2)
    places = np.column_stack([truth["x"], truth["y"]]).astype(float)
    seen = np.column_stack([table["x"], table["y"]]).astype(float)
    known = np.isfinite(seen).all(axis=1)
    seen, flux = seen[known], table["flux"][known]
    row = one_to_one(places, seen, np.full(len(places), MATCH_PX))
    light = np.where(row >= 0, np.append(flux, np.nan)[row] / electrons, np.nan)
    of_id = {number: k for k, number in enumerate(truth["id"].tolist())}
    pairs = np.array([(k, of_id[n + 1]) for n, k in of_id.items() if n % 2 and n + 1 in of_id]).reshape(-1, 2)
    first, second = np.take_along_axis(pairs, np.argsort(-electrons[pairs], axis=1), axis=1).T
    x0, x1, y0, y1 = info["window"]

    def inside(some: np.ndarray) -> np.ndarray:
        return ((some > (x0 + EDGE, y0 + EDGE)) & (some < (x1 - EDGE, y1 - EDGE))).all(axis=1)

    kept = inside(places[first])
    first, second = first[kept], second[kept]
    tree = cKDTree(seen)
    distance, nearest = tree.query(2 * places[first] - places[second])
    found, galaxy = row >= 0, truth["obj_type"] == 1
    columns = (
        snr[first], snr[second], pixel * np.hypot(*(places[first] - places[second]).T),
        electrons[second] / electrons[first], found[first], found[second],
        (distance < MATCH_PX) & (nearest != row[first]), galaxy[first], galaxy[second], light[first], light[second],
    )  # fmt: skip
    away, _ = cKDTree(places).query(seen)
    near, _ = cKDTree(places[snr > 5]).query(seen)
    return np.array(columns, float).T, int((inside(seen) & (away > MATCH_PX) & (near < NEAR)).sum())


def chosen(pairs: ObjectTable) -> dict[str, np.ndarray]:
    """Return {row of the table: mask of pairs}; of the brighter ones if the row begins with that word."""
    close, snr, fainter, apart = pairs["arcsec"] < 0.9, pairs["snr"], pairs["snr_fainter"], pairs["arcsec"]
    rows = {}
    for low, high in ((6, 8), (8, 12), (12, 30), (30, 500)):
        rows[f'fainter, below 0.9", S/N {low} - {high}'] = close & (fainter > low) & (fainter <= high)
    for low, high in ((8, 12), (12, 30), (30, 500)):
        rows[f'brighter, below 0.9", S/N {low} - {high}'] = close & (snr > low) & (snr <= high)
    for one, first in (("star", 0), ("galaxy", 1)):
        for other, second in (("star", 0), ("galaxy", 1)):
            kinds = (pairs["galaxy"] == first) & (pairs["galaxy_fainter"] == second)
            rows[f'fainter, {other} by a {one}, 0.3" to 0.9", S/N 8 - 30'] = (
                kinds & close & (apart > 0.3) & (fainter > 8) & (fainter <= 30)
            )
    for low, high in pairwise(LINES):
        between = (apart > low) & (apart <= high)
        rows[f'fainter, {low:g}" to {high:g}", S/N 15 - 40, ratio > 0.3'] = (
            between & (fainter > 15) & (fainter <= 40) & (pairs["ratio"] > 0.3)
        )
        rows[f'fainter, {low:g}" to {high:g}", S/N 6 - 12'] = between & (fainter > 6) & (fainter <= 12)
    return rows


def fraction(pairs: ObjectTable, some: np.ndarray, brighter: bool) -> float:
    """Return the fraction found, without what is found by chance; NaN without pairs."""
    if not some.any():
        return np.nan
    if brighter:
        return float(pairs["found"][some].mean())
    chance = pairs["chance"][some].mean()
    return float((pairs["found_fainter"][some].mean() - chance) / max(1 - chance, 1e-9))


def show(tables: dict[str, ObjectTable], false: dict[str, int], record: Record) -> None:
    """Record the fractions by row and code, and the fluxes."""
    rows, fractions = [], {}
    for name, some in chosen(tables[OURS]).items():
        each = {code: fraction(pairs, some, name.startswith("brighter")) for code, pairs in tables.items()}
        fractions[name] = each
        rows.append([f"{name} ({some.sum()})", *(f"{value:.2f}" for value in each.values())])
        others = [value for code, value in each.items() if code != OURS]
        if name.count('"') == 1:
            key = "".join(c if c.isalnum() else "_" for c in name.replace('below 0.9", S/N ', "").replace(" ", ""))
            best = max(others, default=np.nan)
            error = np.sqrt(max(each[OURS] * (1 - each[OURS]), 0.01) / max(some.sum(), 1))
            goal = bool(each[OURS] >= best - 2 * error) if others else None
            record.value(key, each[OURS], f"found, {name}", error=error, goal=goal)
            if others:
                record.value(f"{key}_others", best, f"the best of the others, {name}")
    for what, column, snr in (("brighter", "flux", "snr"), ("fainter", "flux_fainter", "snr_fainter")):
        for low, high in ((0.3, 0.9), (0.9, 1.5)):
            cells = []
            for code, pairs in tables.items():
                some = (pairs["arcsec"] > low) & (pairs["arcsec"] <= high) & (pairs[snr] > 8) & (pairs[snr] <= 30)
                ratio = pairs[column][some & np.isfinite(pairs[column])]
                middle = float(np.median(ratio)) if len(ratio) else np.nan
                cells.append(f"{middle:.3f}")
                if code == OURS:
                    scatter = SIGMA_PER_MAD * np.median(np.abs(ratio - middle)) if len(ratio) else np.nan
                    error = 1.25 * scatter / np.sqrt(max(len(ratio), 1))
                    key = f"flux_{what}_{'close' if low < 0.5 else 'apart'}"
                    name = f'total flux over the true one, median: {what}, {low}" to {high}", S/N 8 - 30'
                    record.value(key, middle, name, error=error if np.isfinite(error) else None, above=0.95, below=1.05)
            rows.append([f'flux over the true one, {what}, {low}" to {high}", S/N 8 - 30', *cells])
    rows.append([f"false detections within {NEAR:g} px of objects above S/N 5", *map(str, false.values())])
    if DEEP in false:
        limit = false[DEEP] * 1.5
        record.value("false", false[OURS], "false detections near objects", goal=false[OURS] <= limit)
    record.table("codes", ["", *tables], rows)
    draw(record.figure("pairs.png"), fractions)


def draw(path: Path, fractions: dict[str, dict[str, float]]) -> None:
    """Draw what is found of the fainter ones by separation."""
    figure = Figure(figsize=(10.5, 3.8), layout="constrained")
    for axis, end in zip(figure.subplots(1, 2, sharey=True), ("S/N 15 - 40, ratio > 0.3", "S/N 6 - 12"), strict=True):
        rows = [
            each for name, each in fractions.items() if name.endswith(end) and " to " in name and "by a" not in name
        ]
        middle = 0.5 * (np.array(LINES[:-1]) + LINES[1:])
        for k, code in enumerate(rows[0]):
            style = {"color": OUR_COLOUR, "lw": 2.5, "zorder": 3} if code == OURS else {"color": PEERS, "lw": 1.2}
            axis.plot(middle, [row[code] for row in rows], marker="osD^vPX"[k % 7], ms=4, label=code, **style)
        axis.axhline(0.5, color="0.8", lw=1)
        axis.set(title=f"the fainter of a pair, {end}", xlabel="separation [arcsec]", ylim=(0, 1.03))
        axis.grid(color="0.9", lw=0.5)
    figure.axes[0].set_ylabel("fraction found")
    figure.legend(*figure.axes[1].get_legend_handles_labels(), loc="outside right center", frameon=False, fontsize=9)
    figure.savefig(path, dpi=100)


def main(record: Record) -> None:
    """Make the frames, run the codes and compare."""
    given = record.options
    folder = record.results.resolve() / "pairs"
    run = campaign(folder, 4 if record.toy else given.side, given.seed)
    pixel = run.camera.telescope.pixel_scale
    tables, false = {}, {}
    for code in CODES:
        if reason := why_not(code):
            record.skip(code, reason)
            continue
        parts = []
        false[code] = 0
        for job in run.jobs:
            with tempfile.TemporaryDirectory(dir=folder) as place:
                table, _ = run_code(code, run, job, Path(place), 1)
            info = measured_table(run, job, ["x"]).meta
            rows, wrong = compared(read_truth(run.paths.level0_truth(job)), info, table, pixel)
            parts.append(rows)
            false[code] += wrong
        tables[code] = ObjectTable(dict(zip(COLUMNS, np.concatenate(parts).T, strict=True)))
    record.value("pairs", len(tables[OURS]), "pairs in all exposures")
    show(tables, false, record)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--side", type=int, default=44, help="pairs along a side of the grid")
    parser.add_argument("--seed", type=int, default=5)
    with Record(parser) as record:
        main(record)
