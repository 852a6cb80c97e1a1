"""Builder of config/instrument/gratings/: the 24 aXe configurations and their sensitivity files.

    python builders/build_gratings.py [config/instrument]
    python builders/build_gratings.py --samples GI1 > samples.csv     input of `csstsim fit-grating`

Traces are fitted (csstsim.optics.gratings.trace_fit) to 10 x 10 x 8 sampled trajectories of the gratings described by
gratings.yaml (grating_rays); sensitivities are filters.yaml's throughput times the orders' efficiency.
"""

import csv
import sys
from pathlib import Path

import numpy as np
from astropy.io import fits
from grating_rays import trajectories

from csstsim.base.files.atomic import atomic_path
from csstsim.base.shipped import SHIPPED
from csstsim.instrument.axe import axe_text, sensitivity_file
from csstsim.instrument.camera import load_camera
from csstsim.instrument.grating import sensitivity
from csstsim.instrument.load import read_data
from csstsim.optics.gratings.trace_fit import COLUMNS, fit_traces, residuals

STEP = 10  # samples of the filter's grid: 5 angstrom
ABOUT = """Grating {name} of the CSST Survey Camera, chip {chip}, {side} of column {split}: csstsim.
Estimates but for the dispersion and the size of the order +0 (gratings.yaml has sources).
Fitted to 10 x 10 x 8 trajectories, worst residual [px]: {worst}.
Pixels count from 0; beams A to E are the orders +1, 0, +2, -1, -2.
Builder: builders/build_gratings.py"""


def build(folder):
    """Write the files of an instrument folder; return {grating: {order: worst residual in px}}."""
    folder, worst = Path(folder), {}
    camera, numbers = load_camera(folder), read_data(folder / "gratings.yaml")
    (folder / "gratings").mkdir(exist_ok=True)
    for name, (chip, side, split, samples) in described(camera, numbers).items():
        fitted = fit_traces(samples)
        worst[name] = {order: residuals(fitted[order], rows).max() for order, rows in samples.items()}
        for order, one in fitted.items():
            one["sensitivity"] = sensitivity_file(chip.filter, order)
        about = ABOUT.format(name=name, chip=chip.id, side=side, split=split,
                             worst=", ".join(f"{k:+d}: {v:.2f}" for k, v in worst[name].items()))  # fmt: skip
        with atomic_path(folder / "gratings" / f"{name}.conf") as temporary:
            temporary.write_text(axe_text(fitted, about.splitlines()))
    for name in numbers["dispersion"]:
        for order, share in numbers["efficiency"].items():
            path = folder / "gratings" / sensitivity_file(name, order)
            _write_sensitivity(path, camera, camera.filters[name], share)
    return worst


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


def print_samples(name):
    """Print the trajectories of a shipped grating as CSV."""
    folder = SHIPPED / "instrument"
    samples = described(load_camera(folder), read_data(folder / "gratings.yaml"))[name][-1]
    writer = csv.writer(sys.stdout, lineterminator="\n")
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
    with atomic_path(path) as temporary:
        fits.BinTableHDU.from_columns(columns).writeto(temporary, overwrite=True)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--samples"]:
        print_samples(sys.argv[2])
        sys.exit()
    for grating, orders in build(*(sys.argv[1:] or [SHIPPED / "instrument"])).items():
        print(grating, ", ".join(f"{order:+d}: {px:.3f} px" for order, px in orders.items()))
