"""Charge transfer inefficiency: cost, accuracy and the cost of other ways, and the paper's figure of two stamps.

    python benchmarks/cti.py [--columns 512]

1. CPU time per half-column and per chip (least of three) at 4, 40 and 200 e- of sky, on columns with a chip's density
   of objects and cosmic rays; beside it, on fewer columns, each packet visited by each trap.
2. What a spot loses and trails, for 500, 5000 and 30000 e- over 3 rows, 147 and 4000 rows from the amplifier: this
   program, its limit of many small electrons (mean field), a linear model, arcticpy (if installed; tests/cti_peer.py).
   The spread of the errors against CPU time goes to docs/figures/cti_speed_accuracy.png.
3. Input, output and trail of a stamp 147 and 4000 rows from the amplifier: docs/figures/cti_trails.png.
"""

import argparse
import importlib.util
import math
import sys
import time
from pathlib import Path

import matplotlib
import numba
import numpy as np
from scipy.signal import lfilter

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))
from cti_peer import arctic

from csstsim.counter import unit, word
from csstsim.detector.cti import transfer
from csstsim.detector.traps import buffers, draw_traps
from csstsim.instrument.load import read_data

matplotlib.use("Agg")
from matplotlib import pyplot as plt

ROOT = Path(__file__).resolve().parents[1]
CTI = read_data(ROOT / "config" / "instrument" / "cti.yaml")
WELL = tuple(CTI["well"][name] for name in ("beta", "full_well", "notch"))
DENSITY, TAU = (np.array(CTI["species"][name]) for name in ("density", "timescale"))
KEYS = np.uint64(1), np.uint64(2)
ROWS, OVERSCAN, HALF_COLUMNS, CHIP = 4616, 84, 18432, 9216 * 9232
OBJECTS, RAYS, ELECTRONS = 76638, 5801, 60  # of a chip; the faintest object's electrons
SPOTS = [(flux, row) for row in (147, 4000) for flux in (500, 5000, 30000)]
SKY, BEHIND = 40, 198
FEW = 8  # columns, for the slow ways
LOSS = 1.2e-5  # per transfer, linear model: what 5000 e- over 3 rows lose on their way from row 4000
PARTS = ((0, 3), (3, 11), (11, 51), (51, 201))


def scene(rng, columns, sky):
    """A half's columns: Poisson sky, Gaussian objects of power-law fluxes, straight cosmic rays; whole electrons."""
    image = rng.poisson(sky, (ROWS, columns)).astype(float)
    yy, xx = np.mgrid[-8:9, -8:9]
    for _ in range(rng.poisson(OBJECTS / CHIP * image.size)):
        y, x = rng.integers(8, ROWS - 8), rng.integers(8, columns - 8)
        shape = np.exp(-(yy**2 + xx**2) / (2 * rng.uniform(0.9, 3) ** 2))
        flux = ELECTRONS * min(1 + rng.pareto(0.8), 5e4)
        image[y - 8 : y + 9, x - 8 : x + 9] += rng.poisson(flux * shape / shape.sum())
    for _ in range(rng.poisson(RAYS / CHIP * image.size)):
        length, turn = rng.uniform(0, 20), rng.uniform(0, np.pi)
        step = np.arange(0, length + 1, 0.5)
        y = (rng.uniform(0, ROWS) + step * np.sin(turn)).astype(int) % ROWS
        x = (rng.uniform(0, columns) + step * np.cos(turn)).astype(int) % columns
        np.add.at(image, (y, x), np.rint(10 ** rng.normal(3.3, 0.255) / len(step)))
    return np.minimum(image, 90000).astype(np.float32)


def cpu(work, image, repeats=3):
    """Least CPU seconds of work(copy of image)."""
    times = []
    for _ in range(repeats):
        copy, start = image.copy(), time.process_time()
        work(copy)
        times.append(time.process_time() - start)
    return min(times)


def exact(image, overscan=0):
    return transfer(image, DENSITY, TAU, WELL, KEYS, overscan=overscan)


@numba.njit
def every_packet(image, density, timescale, well, head, room):
    """The same process, each trap visiting each packet."""
    level, tau, own, next_ = room
    for x in range(image.shape[1]):
        column = image[:, x]
        draw_traps(word(np.uint64(1), np.uint64(x)), density, timescale, well, 1e9, head, level, tau, own, next_)
        for row in range(len(head) - 1, -1, -1):
            trap = head[row]
            while trap >= 0:
                filled, n, leaves = False, np.uint64(0), math.exp(-1 / tau[trap])
                for k in range(row, len(column)):
                    reached = column[k] >= level[trap]
                    if reached and not filled:
                        column[k] -= 1
                        filled = True
                    elif filled and not reached:
                        n += np.uint64(1)
                        if unit(word(own[trap], n)) > leaves:
                            column[k] += 1
                            filled = False
                trap = next_[trap]


def plain_loop(image):
    every_packet(image, DENSITY, TAU, WELL, np.empty(ROWS, np.int32), buffers(DENSITY, ROWS))


def linear(image):
    """Each electron is held back alike, whatever its packet, with probability LOSS at each transfer."""
    transfers = np.arange(1, len(image) + 1)[:, None]
    change = np.zeros_like(image)
    for density, tau in zip(DENSITY, TAU, strict=True):
        share, stay = LOSS * density / DENSITY.sum(), np.exp(-1 / tau)
        lost = (share * transfers * image).astype(np.float32)
        change -= lost
        change[1:] += lfilter([1 - stay], [1, -stay], lost[:-1], axis=0)
    image += change


def spot_column(flux, row):
    column = np.full(row + 3 + BEHIND, SKY, np.float32)
    column[row : row + 3] = flux
    return column


def spot_change(method, flux, row):
    """Electrons that a spot adds to PARTS by `method` (a column to a column, mean of its realisations)."""
    sky = spot_column(SKY, row)
    spot = spot_column(flux, row)
    change = (method(spot, row) - spot) - (method(sky, row) - sky)
    return np.array([change[row + a : row + b].sum() for a, b in PARTS])


def stochastic(columns, scale=1):
    """The process with electrons and traps `scale` times as many and as small."""

    def method(column, row):
        n = max(columns, columns * 1000 // row)
        image = np.repeat(scale * column[:, None], n, 1)
        transfer(image, scale * DENSITY, TAU, (WELL[0], scale * WELL[1], WELL[2]), KEYS)
        return image.mean(1, dtype=float) / scale

    return method


def linear_column(column, row):
    image = column[:, None].copy()
    linear(image)
    return image[:, 0]


def costs(columns):
    """Print the table of costs; return the cost of a half-column at SKY [s]."""
    exact(np.ones((9, 9), np.float32))
    print("sky e-   this program: ms/half-column  s/chip    every packet: ms/half-column  s/chip")
    seconds = {}
    for sky in (4, 40, 200):
        image = scene(np.random.default_rng(sky), columns, sky)
        seconds[sky] = cpu(lambda part: exact(part, OVERSCAN), image) / columns
        plain = cpu(plain_loop, image[:, :FEW], 2)
        numbers = [t * s for t in (seconds[sky], plain / FEW) for s in (1e3, HALF_COLUMNS)]
        print("{:6d} {:22.3f} {:16.2f} {:25.2f} {:13.0f}".format(sky, *numbers), flush=True)
    return seconds[SKY]


def accuracy(columns, seconds):
    """Print losses and trails by method; return {name: (s/chip, rms and largest relative error)}."""
    image = scene(np.random.default_rng(5), min(columns, 128), SKY)
    per_column = {
        "exact, event by event": seconds,
        "mean field (30 x)": cpu(
            lambda part: transfer(part, 30 * DENSITY, TAU, (WELL[0], 30 * WELL[1], 0.0), KEYS), 30 * image[:, :16], 1
        ) / 16,
        "linear": cpu(linear, image) / image.shape[1],
    }  # fmt: skip
    methods = {
        "exact, event by event": stochastic(3000),
        "mean field (30 x)": stochastic(100, 30),
        "linear": linear_column,
    }
    if importlib.util.find_spec("arcticpy"):
        for express in (1, 2, 5):
            for name, more in ((f"arcticpy {express}", {}), (f"arcticpy {express}, overscan_start", {"start": True})):
                methods[name] = lambda column, row, express=express, more=more: arctic(
                    column, DENSITY, TAU, WELL, express, **({"overscan_start": row + 3} if more else {})
                )
                per_column[name] = (
                    cpu(lambda part, express=express: [arctic(c, DENSITY, TAU, WELL, express) for c in part.T], few, 1)
                    / 8
                )
    reference, found = None, {}
    print(f"\nspot over 3 rows, sky {SKY} e-: electrons added to the spot | rows 1-8, 9-48, 49-198 behind it")
    for name, method in methods.items():
        parts = np.array([spot_change(method, *spot) for spot in SPOTS])
        reference = parts if reference is None else reference
        error = parts / reference - 1
        found[name] = per_column[name] * HALF_COLUMNS, np.sqrt((error**2).mean()), abs(error).max()
        print(
            f"{name}: {found[name][0]:.1f} s/chip; against the first, rms {found[name][1]:.2%}, most {found[name][2]:.1%}"
        )
        for (flux, row), part in zip(SPOTS, parts, strict=True):
            print(f"   {flux:6d} e- at {row:4d}: {part[0]:9.2f} |" + "".join(f"{value:9.2f}" for value in part[1:]))
    return found


def chart(found, file):
    figure, axes = plt.subplots(figsize=(6, 4), layout="constrained")
    for name, (seconds, rms, _) in found.items():
        exact_one = rms == 0
        axes.plot(seconds, max(rms, 1e-3), "k*" if exact_one else "o", ms=13 if exact_one else 6)
        label = "exact: this program" if exact_one else name
        axes.annotate(label, (seconds, max(rms, 1e-3)), xytext=(6, 4), textcoords="offset points", fontsize=7)
    axes.set(
        xscale="log", yscale="log", xlabel="CPU s per chip, sky 40 e$^-$",
        ylabel="rms relative error of spot losses and trails", xlim=(1, 1e3), ylim=(7e-4, 2),
    )  # fmt: skip
    figure.savefig(file, dpi=110)


def trails(file):
    """Draw input, output and difference of one galaxy near and far from the amplifier."""
    rng, size = np.random.default_rng(3), 60
    yy, xx = np.mgrid[:size, :size]
    figure, axes = plt.subplots(2, 3, figsize=(7.5, 5), layout="constrained")
    light = sum(
        flux * np.exp(-np.hypot(xx - x, (yy - y) / q) / r)
        for x, y, flux, r, q in ((20, 30, 3000, 2.0, 0.6), (42, 22, 20000, 0.9, 1.0), (40, 42, 400, 2.5, 1.5))
    )
    light = rng.poisson(light + SKY)
    for row, line in zip((147, 4000), axes, strict=True):
        image = rng.poisson(SKY, (ROWS, size)).astype(np.float32)
        image[row : row + size] = light
        out = image.copy()
        exact(out)
        stamps = {"input": image, "output": out, "output - input": out - image}
        for axis, (name, stamp) in zip(line, stamps.items(), strict=True):
            stamp = stamp[row : row + size]
            low, high, colours = (-25, 25, "RdBu_r") if "-" in name else (0, 250, "gray")
            shown = axis.imshow(
                stamp, origin="lower", vmin=low, vmax=high, cmap=colours, extent=(0, size, row, row + size)
            )
            axis.set_title(name, fontsize=9)
            figure.colorbar(shown, ax=axis, shrink=0.8)
        line[0].set_ylabel("rows from the amplifier")
    figure.savefig(file, dpi=90)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--columns", type=int, default=512)
    columns = parser.parse_args().columns
    figures = ROOT / "docs" / "figures"
    chart(accuracy(columns, costs(columns)), figures / "cti_speed_accuracy.png")
    trails(figures / "cti_trails.png")


if __name__ == "__main__":
    main()
