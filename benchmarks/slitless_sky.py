"""The sky through the gratings: levels, dependence on colour, cost.

    python benchmarks/slitless_sky.py

Records tables and draws slitless_sky.png, for the shipped numbers (config/instrument).
"""

import argparse
import time

from evidence.record import Record

import matplotlib.pyplot as plt
import numpy as np

from csstsim.base.rng import Streams
from csstsim.base.shipped import SHIPPED
from csstsim.instrument.camera import load_camera
from csstsim.instrument.chip import Window
from csstsim.instrument.pointing import Pointing
from csstsim.layers import sky_background
from csstsim.optics.geometry.wcs import ChipWCS
from csstsim.optics.sky import dispersed
from csstsim.optics.sky.dispersed import disperse, landing, nominal_spectrum, order_rows, sky_spectrum
from csstsim.optics.sky.parameters import sky_numbers
from csstsim.simulation.exposure import Exposure
from csstsim.simulation.state import State

CAMERA = load_camera(SHIPPED / "instrument")
NUMBERS = sky_numbers(CAMERA.sky)
SHOWN = 5  # GV
RUNS = 3  # of which the cheapest counts
FINE = 64  # px between rows that are taken for exact
COLOURS = {-2: "tab:purple", -1: "tab:blue", 0: "tab:red", 1: "tab:green", 2: "tab:orange"}
ORBIT = (2596.0, 4496.0, -4357.0), (6.0, 3.0, -2.1)


def filter_of(chip):
    return CAMERA.filters[CAMERA.chips[chip].filter]


def shares(chip, window, spectrum=None):
    """Return the sky in units of that of a whole first order, (ny, nx)."""
    out, full = np.zeros(window.shape, np.float32), np.broadcast_to(np.float32(1.0), window.shape)
    spectrum = nominal_spectrum(filter_of(chip), NUMBERS) if spectrum is None else spectrum
    disperse(out, lambda rows: np.ascontiguousarray(full[rows]), CAMERA.gratings[chip], window, spectrum)
    return out


def blank(chip, kind="SCIE"):
    """Return the state of a chip without losses; only the light of science exposures passes the gratings."""
    chip = CAMERA.chips[chip]
    pointing = Pointing(kind, 60.0, -40.0, -113.4, "2027-06-26T20:35:58", 150.0, *ORBIT)
    return State.blank(Exposure(pointing, chip, chip.full_window, ChipWCS(chip, pointing), CAMERA))


def levels(record):
    """Record the sky over a whole first order (filter.sky), that at the split, and the CPU seconds of the map."""
    lines = []
    shares(SHOWN, Window(0, 8, 0, 8))  # compiles
    for chip in [SHOWN] if record.toy else CAMERA.gratings:
        window, split = CAMERA.chips[chip].full_window, int(CAMERA.gratings[chip].split)
        spent = []
        for _ in range(RUNS):
            start = time.process_time()
            out = shares(chip, window)
            spent.append(time.process_time() - start)
        mean, middle = out.mean(dtype=float), out[:, split - 100 : split + 100].mean(dtype=float)
        numbers = (f"{value:.3f}" for value in (mean, out.min(), out.max(), middle))
        lines.append([chip, filter_of(chip).name, f"{mean * filter_of(chip).sky:.4f}", *numbers, f"{min(spent):.2f}"])
        if chip == SHOWN:
            record.value("map_cpu", min(spent), "the dispersed sky of a chip", unit="CPU-s")
    header = ["chip", "grating", "e-/s/px", "mean over a first order", "minimum", "maximum", "at the split", "CPU-s"]
    record.table("levels", header, lines)


def colour(record):
    """Record the effect of the sky's spectrum, which matters only where a piece's light ends."""
    lines = []
    for chip in (3, SHOWN, 1):
        row = Window(0, CAMERA.chips[chip].detector.nx, 4600, 4601)
        nominal = shares(chip, row)
        for name, parts in (("zodiacal", {"zodiacal": 1.0}), ("earth", {"earth": 1.0}), ("Sun, stars", {"sun": 1.0})):
            other = shares(chip, row, sky_spectrum(filter_of(chip), parts, 60.0, NUMBERS))
            ratio, mean = np.abs(other / nominal - 1).max(), other.mean() / nominal.mean() - 1
            lines.append([filter_of(chip).name, name, f"{ratio:.4f}", f"{mean:.1e}"])
    header = ["grating", "spectrum", "largest difference from the nominal along a row", "of the mean level"]
    record.table("colour", header, lines)


def cost(record):
    """Record the CPU seconds of the layer without its response, with gratings and as if there were none."""
    lines = []
    for model, gratings in ((False, True), (False, False), (True, True), (True, False)):
        spent = []
        for _ in range(RUNS):
            state = blank(SHOWN, "SCIE" if gratings else "FLAT")
            state.image += 1.0
            param = sky_background.Param(enable_straylight_model=model)
            start = time.process_time()
            sky_background.apply(state, param, Streams(1, "1", SHOWN, "sky_background"))
            spent.append(time.process_time() - start)
        lines.append(
            ["yes" if v else "no" for v in (model, gratings)] + [f"{min(spent):.2f}", f"{state.header['sky_rate']:.4f}"]
        )
    record.table("cost", ["stray-light model", "gratings", "CPU-s of a chip", "e-/s/px"], lines)


def approximations(record: Record) -> None:
    """Record how far |dF| is from 1 by order, and what rows computed every NODE px leave out."""
    chip = CAMERA.chips[SHOWN].detector
    x, y = (axis.ravel() for axis in np.meshgrid(np.linspace(0, chip.nx, 9), np.linspace(0, chip.ny, 9)))
    for number in (1, 2):
        most = 0.0
        for gratings in CAMERA.gratings.values():
            for grating, _ in gratings.pieces:
                order = grating.orders[number]
                for wave in order.range:
                    xx, yx = np.subtract(landing(order, x + 1, y, wave), landing(order, x - 1, y, wave)) / 2
                    xy, yy = np.subtract(landing(order, x, y + 1, wave), landing(order, x, y - 1, wave)) / 2
                    most = max(most, np.abs(xx * yy - xy * yx - 1).max())
        record.value(f"determinant_{number}", most, f"determinant of dF in the order +{number}, less 1, largest")
    window, coarse = Window(0, chip.nx, 1024, 1536), dispersed.NODE
    seen = shares(SHOWN, window)
    try:
        dispersed.NODE = FINE
        exact = shares(SHOWN, window)
    finally:
        dispersed.NODE = coarse
    record.value("rows", np.abs(seen - exact).max(), f"rows every {coarse} px and every {FINE} px, largest difference")


def figure(record):
    """Draw the sky of a chip, by order."""
    chip, spectrum, gratings = CAMERA.chips[SHOWN], nominal_spectrum(filter_of(SHOWN), NUMBERS), CAMERA.gratings[SHOWN]
    nx, ny, row = chip.detector.nx, chip.detector.ny, chip.detector.ny // 2
    out, rate = shares(SHOWN, chip.full_window), filter_of(SHOWN).sky
    plot, (top, middle, near) = plt.subplots(3, 1, figsize=(8, 9), height_ratios=(1.6, 1.2, 1.2), layout="constrained")
    drawn = top.imshow(
        rate * out[::16, ::16], extent=(0, nx, 0, ny), origin="lower", aspect="auto", cmap="magma", vmin=0
    )
    plot.colorbar(drawn, ax=top, label="e-/s/px")
    top.set(title=f"nominal sky of chip {SHOWN} ({chip.filter}), no noise", xlabel="x [px]", ylabel="y [px]")
    line, x = Window(0, nx, row, row + 1), np.arange(nx)
    zeroth = 0.0
    for (grating, piece), style in zip(gratings.pieces, ("-", "--"), strict=True):
        for number, order in grating.orders.items():
            values = rate * order_rows(order, piece, np.array([float(row)]), line, spectrum)[0]
            label, colour = f"{number:+d} {grating.name}" if number else f"0 {grating.name}", COLOURS[number]
            middle.plot(x, np.where(values > 0, values, np.nan), style, color=colour, label=label)
            if number == 0:
                near.step(x, values, style, color=colour, label=label, where="mid")
                zeroth = zeroth + values
    middle.plot(x, rate * out[row], color="k", lw=1.5, label="sum")
    middle.axhline(rate, color="0.6", lw=0.8, ls=":", label="filter.sky")
    middle.set(title=f"row {row}, by order and piece", yscale="log", ylim=(5e-4, 1), xlim=(0, nx))
    near.step(x, zeroth, color="k", lw=1, label="sum of the two", where="mid")
    split = gratings.split
    near.set(title="zeroth orders at the split", xlim=(split - 30, split + 30), ylim=(0, 2.4 * zeroth[0]))
    for axis in (middle, near):
        axis.set(xlabel="x [px]", ylabel="e-/s/px")
        axis.legend(fontsize=6, loc="center left", bbox_to_anchor=(1.0, 0.5))
    plot.savefig(record.figure("slitless_sky.png"), dpi=85)
    plt.close(plot)


if __name__ == "__main__":
    with Record(argparse.ArgumentParser(description=__doc__.splitlines()[0])) as record:
        for part in (levels, colour, cost, approximations, figure):
            part(record)
