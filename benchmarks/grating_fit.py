"""Residuals of the traces fitted to trajectories of light behind the gratings; nothing is written.

    python benchmarks/grating_fit.py

The fit is that of builders/build_gratings.py: 10 x 10 positions and 8 wavelengths of each grating, the paper's
sampling (section 4.2). Then `csstsim fit-grating` fits the trajectories of GI1, as a user does.
"""

import argparse

from evidence.record import Record

from build_gratings import described, fitted_to, print_samples

from csstsim.base.shipped import SHIPPED
from csstsim.command_line.main import main as command
from csstsim.instrument.camera import load_camera
from csstsim.instrument.load import read_data

GOAL = 0.2  # px in the orders 0 and +1 (the paper's)
SHOWN = "GI1"


def main(record: Record) -> None:
    """Fit, and record the residuals by filter and order."""
    folder = SHIPPED / "instrument"
    gratings = described(load_camera(folder), read_data(folder / "gratings.yaml"))
    if record.toy:
        gratings = {name: gratings[name] for name in ("GU1", "GV1", "GI1", "GI2")}
    worst = {name: fitted_to(samples)[1] for name, (*_, samples) in gratings.items()}
    orders = sorted(next(iter(worst.values())))
    rows = []
    for band in ("GU", "GV", "GI"):
        mine = [one for name, one in worst.items() if name.startswith(band)]
        rows.append([f"{band}1-8", *(span([one[order] for one in mine]) for order in orders)])
    record.table("residuals", ["px", *(f"{order:+d}" if order else "0" for order in orders)], rows)
    most = {order: max(one[order] for one in worst.values()) for order in orders}
    what = "largest residual of the fit to trajectories in the orders 0 and +1"
    record.value("most", max(most[0], most[1]), what, unit="px", below=GOAL)
    record.value("most_second", max(most[2], most[-2]), "the same in the orders -2 and +2", unit="px")
    samples, output = record.results / "grating_fit.csv", record.results / "grating_fit.conf"
    samples.parent.mkdir(parents=True, exist_ok=True)
    with open(samples, "w", newline="") as file:
        print_samples(SHOWN, file)
    with record.printed("fit_grating"):
        command(["fit-grating", str(samples), "--output", str(output), "--sensitivity", "GI"], standalone_mode=False)


def span(values: list[float]) -> str:
    """Return the range of values [px], to a hundredth."""
    low, high = (f"{value:.2f}" for value in (min(values), max(values)))
    return "< 0.001" if max(values) < 1e-3 else low if low == high else f"{low}-{high}"


if __name__ == "__main__":
    with Record(argparse.ArgumentParser(description=__doc__.splitlines()[0])) as record:
        main(record)
