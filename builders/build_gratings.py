"""Builder of config/instrument/gratings/: the 24 aXe configurations and their sensitivity files.

    python builders/build_gratings.py [config/instrument]             writes files that differ
    python builders/build_gratings.py --check [config/instrument]     writes nothing; exit code 1 if any differs
    python builders/build_gratings.py --samples GI1 > samples.csv     input of `csstsim fit-grating`

Traces are fitted (csstsim.optics.gratings.trace_fit) to 10 x 10 x 8 sampled trajectories of the gratings described by
gratings.yaml (grating_rays); sensitivities are filters.yaml's throughput times the orders' efficiency.

Files are the same if coefficients are equal to 1e-8 of themselves, or to a fit's rounding, which moves no light by more
than 1e-8 px; and sensitivities to 1e-6 of the largest. Texts must be equal.
"""

import argparse
import csv
import sys
from pathlib import Path
from typing import TextIO

import numpy as np
from astropy.io import fits
from grating_rays import trajectories
from kept import Keeper, same_fits

from csstsim.base.shipped import SHIPPED
from csstsim.instrument.axe import BEAMS, COEFFICIENTS, axe_text, read_axe, sensitivity_file
from csstsim.instrument.camera import load_camera
from csstsim.instrument.grating import sensitivity
from csstsim.instrument.load import read_data
from csstsim.optics.gratings.trace_fit import COLUMNS, fit_traces, residuals

STEP = 10  # samples of the filter's grid: 5 angstrom
NUMBERS = tuple(f"{COEFFICIENTS[name].format(beam)} " for name in COEFFICIENTS for beam in BEAMS)  # begin their lines
RELATIVE, SENSITIVITY = 1e-8, 1e-6
ROUNDING = np.array([1e-9, 1e-13, 1e-13, 1e-17, 1e-17, 1e-17])  # of coefficients of 1, m, n, m^2, m n, n^2
ABOUT = """Grating {name} of the CSST Survey Camera, chip {chip}, {side} of column {split}: csstsim.
Estimates but for the dispersion and the size of the order +0 (gratings.yaml has sources).
Fitted to 10 x 10 x 8 trajectories, worst residual [px]: {worst}.
Pixels count from 0; beams A to E are the orders +1, 0, +2, -1, -2.
Builder: builders/build_gratings.py"""


Residuals = dict[str, dict[int, float]]  # {grating: {order: worst [px]}}


def build(folder: Path | str, keeper: Keeper | None = None) -> Residuals:
    """Write the files of an instrument folder that differ; return the fit's residuals."""
    folder, keeper, worst = Path(folder), keeper or Keeper(), {}
    camera, numbers = load_camera(folder), read_data(folder / "gratings.yaml")
    for name, (chip, side, split, samples) in described(camera, numbers).items():
        fitted, worst[name] = fitted_to(samples)
        for order, one in fitted.items():
            one["sensitivity"] = sensitivity_file(chip.filter, order)
        about = ABOUT.format(name=name, chip=chip.id, side=side, split=split,
                             worst=", ".join(f"{k:+d}: {v:.2f}" for k, v in worst[name].items()))  # fmt: skip
        with keeper.file(folder / "gratings" / f"{name}.conf", same_traces) as new:
            new.write_text(axe_text(fitted, about.splitlines()))
    for name in numbers["dispersion"]:
        for order, share in numbers["efficiency"].items():
            with keeper.file(folder / "gratings" / sensitivity_file(name, order), same_fits(SENSITIVITY)) as new:
                _write_sensitivity(new, camera, camera.filters[name], share)
    return worst


def fitted_to(samples):
    """Return the traces {order: coefficients} fitted to trajectories, and {order: worst residual [px]}."""
    fitted = fit_traces(samples)
    return fitted, {order: float(residuals(fitted[order], rows).max()) for order, rows in samples.items()}


def same_traces(one: Path, other: Path) -> bool:
    """Tell whether two .conf files describe the same grating, but for rounding."""
    first, second = read_axe(one), read_axe(other)
    if first.keys() != second.keys() or _words(one) != _words(other):
        return False
    pairs = [(first[order][name], second[order][name]) for order in first for name in COEFFICIENTS]
    return all((np.abs(a - b) <= RELATIVE * np.abs(a) + ROUNDING).all() for a, b in pairs)


def _words(path):
    """Return the lines of a .conf file without coefficients."""
    return [line for line in path.read_text().splitlines() if not line.startswith(NUMBERS)]


def described(camera, numbers):
    """Return {grating: (chip, side, split column, samples of trajectories)} of gratings.yaml's description."""
    pupil, out = camera.ghosts["geometry"]["pupil_distance"], {}
    for number, row in numbers["chips"].items():
        chip, line = camera.chips[number], row["split"] - 0.5
        nx, ny, (left, right, low, high) = chip.detector.nx, chip.detector.ny, row["reach"]
        spans = {"left": (-0.5 - left, line), "right": (line, nx - 0.5 + right)}
        signs = {"left": numbers["direction"], "right": -numbers["direction"]}
        for side, span in spans.items():
            piece = *span, -0.5 - low, ny - 0.5 + high
            samples = trajectories(chip, piece, signs[side], camera.filters[chip.filter], numbers, pupil)
            out[row[side]] = chip, side, row["split"], samples
    return out


def print_samples(name: str, file: TextIO | None = None) -> None:
    """Print the trajectories of a shipped grating as CSV, into a file or on the screen."""
    folder = SHIPPED / "instrument"
    samples = described(load_camera(folder), read_data(folder / "gratings.yaml"))[name][-1]
    writer = csv.writer(file or sys.stdout, lineterminator="\n")
    writer.writerow(COLUMNS)
    for order, rows in samples.items():
        writer.writerows([order, *(f"{v:.5f}" for v in row)] for row in rows)


def _write_sensitivity(path, camera, filter_, share):
    first, last = np.flatnonzero(filter_.throughput)[[0, -1]]
    at = np.arange(first - first % STEP, last + STEP, STEP)
    wave, throughput = filter_.wavelength[at], share * filter_.throughput[at]
    values = sensitivity(wave, throughput, camera.telescope)
    columns = [
        fits.Column("WAVELENGTH", "E", "angstrom", array=wave),
        fits.Column("SENSITIVITY", "E", "electron / s / angstrom / (erg / s / cm2 / angstrom)", array=values),
        fits.Column("ERROR", "E", array=np.zeros_like(wave)),
    ]
    fits.BinTableHDU.from_columns(columns).writeto(path)


def main() -> int:
    """Do what is asked for; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", type=Path, default=SHIPPED / "instrument")
    parser.add_argument("--check", action="store_true", help="write nothing; exit code 1 if a file differs")
    parser.add_argument("--samples", metavar="GRATING", help="print its trajectories")
    options = parser.parse_args()
    if options.samples:
        print_samples(options.samples)
        return 0
    keeper = Keeper(options.check)
    for grating, orders in build(options.folder, keeper).items():
        print(grating, ", ".join(f"{order:+d}: {px:.3f} px" for order, px in orders.items()))
    return keeper.code()


if __name__ == "__main__":
    sys.exit(main())
