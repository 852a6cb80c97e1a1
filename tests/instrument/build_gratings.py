"""Builder of config/instrument/gratings/: the 24 aXe configurations and the sensitivities they name.

    python tests/instrument/build_gratings.py [config/instrument]

Traces are fitted (csstsim.optics.trace_fit) to 10 x 10 x 8 samples of what gratings.yaml describes
(csstsim.optics.grating_rays); sensitivities are filters.yaml's throughput times the orders' efficiency.
"""

import sys
from pathlib import Path

import numpy as np
from astropy.io import fits

from csstsim.atomic import atomic_path
from csstsim.config import SHIPPED
from csstsim.instrument.axe import axe_text
from csstsim.instrument.camera import load_camera
from csstsim.instrument.grating import sensitivity
from csstsim.instrument.load import read_data
from csstsim.optics.grating_rays import trajectories
from csstsim.optics.trace_fit import fit_traces, residuals

STEP = 10  # samples of the filter's grid: 5 angstrom
ABOUT = """Grating {name} of the CSST Survey Camera, chip {chip}, {side} of column {split}: csstsim.
Estimates but for the dispersion and the size of the order +0 (gratings.yaml has sources).
Fitted to 10 x 10 x 8 trajectories, worst residual [px]: {worst}.
Pixels count from 0; beams A to E are the orders +1, 0, +2, -1, -2.
Builder: tests/instrument/build_gratings.py"""


def build(folder):
    """Write the files of an instrument folder; return {grating: {order: worst residual in px}}."""
    folder = Path(folder)
    camera, numbers = load_camera(folder), read_data(folder / "gratings.yaml")
    pupil, worst = read_data(folder / "ghosts.yaml")["geometry"]["pupil_distance"], {}
    (folder / "gratings").mkdir(exist_ok=True)
    for number, row in numbers["chips"].items():
        chip = camera.chips[number]
        for side, samples in sampled(chip, row, camera, numbers, pupil).items():
            fitted, name = fit_traces(samples), row[side]
            worst[name] = {order: residuals(fitted[order], rows).max() for order, rows in samples.items()}
            for order, one in fitted.items():
                one["sensitivity"] = f"{chip.filter}_{_label(order)}.fits"
            about = ABOUT.format(name=name, chip=number, side=side, split=row["split"],
                                 worst=", ".join(f"{k:+d}: {v:.2f}" for k, v in worst[name].items()))  # fmt: skip
            with atomic_path(folder / "gratings" / f"{name}.conf") as temporary:
                temporary.write_text(axe_text(fitted, about.splitlines()))
    for name in numbers["dispersion"]:
        for order, share in numbers["efficiency"].items():
            _write_sensitivity(
                folder / "gratings" / f"{name}_{_label(order)}.fits", camera, camera.filters[name], share
            )
    return worst


def sampled(chip, row, camera, numbers, pupil):
    """Return {side: samples of trajectories} of a chip's two gratings."""
    nx, ny, (left, right, low, high) = chip.detector.nx, chip.detector.ny, row["reach"]
    line, y = row["split"] - 0.5, (-0.5 - low, ny - 0.5 + high)
    spans = {"left": (-0.5 - left, line, *y), "right": (line, nx - 0.5 + right, *y)}
    signs = {"left": numbers["direction"], "right": -numbers["direction"]}
    filter_ = camera.filters[chip.filter]
    return {side: trajectories(chip, spans[side], signs[side], filter_, numbers, pupil) for side in spans}


def _label(order):
    return f"{'m' if order < 0 else 'p'}{abs(order)}"


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
    for grating, orders in build(*(sys.argv[1:] or [SHIPPED / "instrument"])).items():
        print(grating, ", ".join(f"{order:+d}: {px:.3f} px" for order, px in orders.items()))
