"""Budgets of shear (docs/budget_shear.md): the bright sample, neighbours with a shear of their own, and a blind test.

    python benchmarks/budget_shear.py         # an hour; goes on where it was stopped
    python benchmarks/budget_shear.py grid    # the base by spacing, stamp and position angle: why m1 differs from m2

The first runs `csstsim budget shear` of the bright sample and of config/budget/shear_neighbours.yaml. Frames of hidden
shear are answered with the mean shape of each by hsm, over 1 + m of the base; errors are those of the mean of rings.
"""

import argparse
import csv
import shutil
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from evidence.record import Record

import numpy as np
import yaml
from astropy.io import fits

from csstsim.base.shipped import SHIPPED
from csstsim.studies.budget.shear.blind import blind, reveal
from csstsim.studies.budget.shear.command import budget
from csstsim.studies.budget.shear.estimators import Shapes, Stamps, hsm
from csstsim.studies.budget.shear.response import NAMES
from csstsim.studies.budget.shear.run import to_sky
from csstsim.studies.budget.shear.sample import EDGE, RING
from csstsim.studies.budget.shear.volume import GOALS, sigma_m, volume

Row = dict[str, Any]
BRIGHT, NEAR = SHIPPED / "budget" / "shear.yaml", SHIPPED / "budget" / "shear_neighbours.yaml"
FIELDS, BLIND = 20, 6  # windows
TOY_EFFECTS = {"noise", "noiseless", "nonlinearity", "undetected", "other_shear", "blending"}
GRID = (48, 48, 0, 4), (48, 48, 45, 4), (96, 48, 0, 4), (96, 48, 45, 4), (96, 96, 0, 2)  # px, px, deg, windows
CELLS, TOY_CELLS = 20, 4  # galaxies along a side of a window of the grid


def made(record: Record, name: str, plan: Path, **changes: Any) -> list[Row]:
    """Run a plan with changed keys; return its rows of bars."""
    folder, content = record.results / "budget_shear" / name, yaml.safe_load(plan.read_text()) | changes
    content["samples"] = {"bright": content["samples"]["bright"]}
    content["estimators"] = [kind for kind in ("hsm", "own", "fpfs") if kind != "fpfs" or find_spec("anacal")]
    if record.toy and "spacing" not in changes:
        effects = {name: effect for name, effect in content["effects"].items() if name in TOY_EFFECTS}
        content |= {"size": _side(content["spacing"], TOY_CELLS), "fields": 1, "whole": 1}
        content["effects"] = {
            name: effect | ({"times": 1} if "times" in effect else {}) for name, effect in effects.items()
        }
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "plan.yaml").write_text(yaml.safe_dump(content, sort_keys=False))
    return budget(str(folder / "plan.yaml"), folder, print)


def _side(spacing: int, cells: int) -> int:
    return 2 * EDGE + spacing * cells


def report_bars(record: Record, name: str, rows: list[Row]) -> None:
    """Record the bars by the first estimator, and m by all."""
    kinds = list(dict.fromkeys(row["estimator"] for row in rows))
    lines = []
    for row in (row for row in rows if row["estimator"] == kinds[0]):
        bar = row["kind"] in ("base", "bar") and np.isfinite(sigma_m(row))
        hours = f"{volume(row, min(GOALS)).hours:.2g}" if bar else ""
        lines.append([row["about"], row["windows"], *(_pair(row, number) for number in NAMES), hours])
    header = ["effect", "windows", "m1", "m2", "c1", "c2", "alpha", "sigma(m) 1e-4: CPU-h"]
    record.table(f"{name}_{kinds[0]}", header, lines)
    of = {kind: {row["effect"]: row for row in rows if row["estimator"] == kind} for kind in kinds}
    lines = [
        [row["about"], *(_pair(of[kind][effect], f"m{axis}") for kind in kinds for axis in (1, 2))]
        for effect, row in of[kinds[0]].items()
    ]
    record.table(f"{name}_estimators", ["effect", *(f"{kind} m{axis}" for kind in kinds for axis in (1, 2))], lines)


def _pair(row: Row, name: str) -> str:
    unit = 1e-2 if name == "alpha" else 1e-4
    value, error = row[name] / unit, row[f"{name}_err"] / unit
    digits = 2 if 0 < error < 0.1 else 1
    return f"{value:+.{digits}f} ± {error:.{digits}f}" if np.isfinite(error) else f"{value:+.1f}"


def report_cost(record: Record, rows: list[Row]) -> None:
    """Record the errors of bars, what smaller ones cost, and what noise that the arms share gains."""
    first = rows[0]["estimator"]
    of = [row for row in rows if row["estimator"] == first and row["kind"] == "bar" and np.isfinite(sigma_m(row))]
    record.value("rows", len(of), "rows of effects of the bright sample")
    record.value("largest_error", max(map(sigma_m, of)), "the largest error of m among them", below=GOALS[0])
    record.value("rows_below", sum(sigma_m(row) < GOALS[1] for row in of), f"of them with one below {GOALS[1]:g}")
    hours = [[volume(row, goal).hours for row in of] for goal in GOALS]
    most = int(np.argmax(hours[1]))
    cells = [
        f"{sum(hours[0]):.2g} CPU-h",
        f"{sum(hours[1]):.2g} CPU-h",
        f"{of[most]['about']}, {hours[1][most]:.2g} CPU-h",
    ]
    record.table("cost", ["all bars to 3e-4", "all bars to 1e-4", "the dearest bar at 1e-4"], [cells])
    for row in (row for row in rows if row["kind"] == "rest"):
        for axis in (1, 2):
            sigma = row[f"m{axis}"] / (row[f"m{axis}_err"] or np.nan)
            what = f"m{axis} of all effects at once less the sum of bars, by {row['estimator']}"
            record.value(f"rest_m{axis}_{row['estimator']}", sigma, what, unit="sigma")
    lines = [
        [row["estimator"], *(f"{row[name]:.4f}" for name in ("scatter", "scatter_two")), f"{row['gain']:.1f}"]
        for row in rows
        if row["kind"] == "base"
    ]
    record.table("gains", ["estimator", "one seed", "two seeds", "gain"], lines)
    gains = [row["gain"] for row in of if np.isfinite(row["gain"])]
    record.value("gain_min", min(gains), f"the smallest gain with an effect, by {first}")
    record.value("gain_max", max(gains), f"the largest gain with an effect, by {first}")


def blind_test(record: Record, base: Row) -> None:
    """Hide shears, answer with hsm over 1 + m of the base, and record the score."""
    folder = record.results / "budget_shear"
    key, given, answer = folder / "key.json", folder / "blind", folder / "answer.csv"
    shutil.rmtree(given, ignore_errors=True)
    key.unlink(missing_ok=True)
    blind(str(folder / "bright" / "plan.yaml"), str(key), str(given), print, count=2 if record.toy else BLIND)
    write_answer(given, (base["m1"], base["m2"]), answer)
    score = reveal(str(key), str(answer), print, str(given))
    for name in ("m1", "m2", "c1", "c2"):
        error = score.get(f"{name}_err", np.nan)
        within = abs(score.get(name, np.nan)) < 4 * error
        record.value(f"blind_{name}", score.get(name, np.nan), f"blind test: {name}", error=error, goal=within)
    record.value("blind_chi2", score["chi2"], f"blind test: chi-square of {2 * score['fields']} numbers")


def write_answer(folder: Path, m: tuple[float, float], file: Path) -> None:
    """Write the answer to a blind test; m: of the base."""
    with open(file, "w", newline="") as out:
        writer = csv.writer(out)
        writer.writerow(["field", "g1", "g2", "g1_err", "g2_err"])
        for number, path in enumerate(sorted(folder.glob("field_*.fits"))):
            with fits.open(path) as hdus:
                image, psf, where = hdus["IMAGE"].data, hdus["PSF"].data, hdus["GALAXIES"].data
            half = psf.shape[-1] // 2
            side = np.arange(-half, half)
            x, y = (np.rint(where[name]).astype(int) for name in ("x", "y"))
            stamps = image[y[:, None, None] + side[:, None], x[:, None, None] + side].astype(float)
            shapes = hsm(Stamps(stamps, psf.astype(float), 0.0, 0.0), None)
            e = to_sky(Shapes(shapes.e, shapes.response), np.array(where["jacobian"], float), True).e
            rings = np.array([ring.mean() for ring in e.reshape(-1, RING) if np.isfinite(ring).all()])
            error = [np.std(part, ddof=1) / np.sqrt(len(rings)) for part in (rings.real, rings.imag)]
            mean = rings.mean()
            writer.writerow([number, mean.real / (1 + m[0]), mean.imag / (1 + m[1]), *error])


def grid(record: Record) -> None:
    """Record m of the base and of neighbours that are not found, by spacing, stamp and position angle."""
    effect, lines = yaml.safe_load(NEAR.read_text())["effects"]["undetected"], []
    for spacing, stamp, pa, windows in GRID:
        side = _side(spacing, TOY_CELLS if record.toy else CELLS)
        keys = {"spacing": spacing, "stamp": stamp, "pa": pa, "size": side, "fields": 1 if record.toy else windows}
        rows = made(record, f"grid_{spacing}_{stamp}_{pa}", NEAR, **keys, effects={"undetected": effect})
        of = {(row["estimator"], row["effect"]): row for row in rows}
        wanted = ("hsm", "base"), ("fpfs", "base"), ("hsm", "undetected")
        cells = [_pair(of[which], f"m{axis}") if which in of else "" for which in wanted for axis in (1, 2)]
        lines.append([f"{spacing} px", f"{stamp} px", pa, *cells])
        base = of["hsm", "base"]
        apart, error = 1e4 * (base["m1"] - base["m2"]), 1e4 * float(np.hypot(base["m1_err"], base["m2_err"]))
        what = f"m1 - m2 of the base: spacing {spacing}, stamps {stamp} px, position angle {pa}"
        record.value(f"apart_{spacing}_{stamp}_{pa}", apart, what, unit="1e-4", error=error)
    heads = ["hsm m1", "hsm m2", "fpfs m1", "fpfs m2", "neighbours not found, m1", "m2"]
    record.table("grid", ["spacing", "stamp", "position angle", *heads], lines)


def whole(record: Record) -> None:
    """Record both budgets and the blind test."""
    bright = made(record, "bright", BRIGHT, fields=FIELDS)
    report_bars(record, "bright", bright)
    report_cost(record, bright)
    report_bars(record, "near", made(record, "near", NEAR))
    blind_test(record, bright[0])
    folder, seconds = record.results / "budget_shear", 0.0
    for name, picture in (("waterfall", "budget_shear"), ("chart", "budget_shear_cost")):
        shutil.copyfile(folder / "bright" / f"{name}_bright.png", record.figure(f"{picture}.png"))
    for path in (folder / "bright" / "fields").glob("*.npz"):
        with np.load(path) as arrays:
            seconds += sum(float(arrays[key]) for key in arrays.files if key.endswith("|seconds"))
    record.value("cpu", seconds / 60, "windows of the bright sample", unit="CPU-min")


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("part", nargs="?", choices=["grid"])
    with Record(parser) as record:
        if not find_spec("anacal"):
            record.skip("fpfs", "AnaCal is not installed (pip install --no-deps anacal)")
        (grid if record.options.part else whole)(record)


if __name__ == "__main__":
    main()
