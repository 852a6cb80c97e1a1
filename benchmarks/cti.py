"""Charge transfer inefficiency: cost, accuracy and the cost of other ways, and the paper's figure of two stamps.

    python benchmarks/cti.py [--columns 512 | --serial]

1. CPU time per half-column and per chip (least of three) at 4, 40 and 200 e- of sky, on columns with a chip's density
   of objects and cosmic rays; beside it, on fewer columns, each packet visited by each trap.
2. What a spot loses and trails, for 500, 5000 and 30000 e- over 3 rows, 147 and 4000 rows from the amplifier: this
   program, its limit of many small electrons (mean field), a linear model, arcticpy (if installed; tests/cti_peer.py).
   The spread of the errors against CPU time goes to docs/figures/cti_speed_accuracy.png.
3. What arcticpy does with the traps of a packet's own first rows (docs/detector_cti.md).
4. Input, output and trail of a stamp 147 and 4000 rows from the amplifier: docs/figures/cti_trails.png.
5. Two whole chips.
6. Rows through their registers (all that --serial does): cost of a chip; what a spot and a flat field leave behind.
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
from csstsim.detector.serial import transfer_rows
from csstsim.detector.traps import buffers, draw_traps
from csstsim.instrument.load import read_data

matplotlib.use("Agg")
from matplotlib import pyplot as plt

ROOT = Path(__file__).resolve().parents[1]
CTI = read_data(ROOT / "config" / "instrument" / "cti.yaml")
WELL = tuple(CTI["well"][name] for name in ("beta", "full_well", "notch"))
DENSITY, TAU = (np.array(CTI["species"][name]) for name in ("density", "timescale"))
REGISTER = tuple(CTI["serial"]["species"][name] for name in ("density", "timescale"))
REGISTER_WELL = tuple(CTI["serial"]["well"][name] for name in ("beta", "full_well", "notch"))
EUCLID = (0.0442, 0.1326, 3.9782), (0.8, 4.0, 20.0)  # serial species in PyAutoCTI's examples
PRESCAN, CHANNEL, SERIAL_OVERSCAN = 27, 1152, 71
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


def by_arctic(express, scan):
    """arcticpy's method; scan: its `overscan_start` just behind the spot."""
    return lambda column, row=None: arctic(
        column, DENSITY, TAU, WELL, express, **({"overscan_start": row + 3} if scan else {})
    )


def ways(columns, seconds):
    """Return {name: (CPU s for a half-column, method for spot_change)}."""
    image = scene(np.random.default_rng(5), min(columns, 128), SKY)

    def each(work, n=FEW):
        return cpu(work, image[:, :n], 1) / n

    many = (WELL[0], 30 * WELL[1], 30 * WELL[2])
    found = {
        "exact, event by event": (seconds, stochastic(3000)),
        "mean field": (each(lambda part: transfer(30 * part, 30 * DENSITY, TAU, many, KEYS)), stochastic(100, 30)),
        "linear": (each(linear, image.shape[1]), linear_column),
    }
    if importlib.util.find_spec("arcticpy"):
        for express in (1, 2, 5):
            method = by_arctic(express, False)
            found[f"arcticpy {express}"] = each(method, 64), method
            found[f"arcticpy {express}, overscan_start"] = found[f"arcticpy {express}"][0], by_arctic(express, True)
    return found


def accuracy(columns, seconds):
    """Print losses and trails by method; return {name: (s/chip, rms relative error)}."""
    reference, found = None, {}
    print(f"\nspot over 3 rows, sky {SKY} e-: electrons added to the spot | rows 1-8, 9-48, 49-198 behind it")
    for name, (cost, method) in ways(columns, seconds).items():
        parts = np.array([spot_change(method, *spot) for spot in SPOTS])
        reference = parts if reference is None else reference
        error = parts / reference - 1
        found[name] = cost * HALF_COLUMNS, np.sqrt((error**2).mean())
        print(f"{name}: {found[name][0]:.1f} s/chip; against the first, rms {found[name][1]:.2%}", end="")
        print(f", most {abs(error).max():.1%}", flush=True)
        for (flux, row), part in zip(SPOTS, parts, strict=True):
            print(f"   {flux:6d} e- at {row:4d}: {part[0]:9.2f} |" + "".join(f"{value:9.2f}" for value in part[1:]))
    return found


def first_transfers():
    """Print a spot of 5000 e- on no sky, 60 rows from the amplifier: arcticpy with and without emptied traps."""
    column = np.zeros(160, np.float32)
    column[60:63] = 5000

    def say(name, moved):
        change = moved - column
        parts = "".join(f"{change[60 + a : 60 + b].sum():9.2f}" for a, b in ((0, 3), (3, 11), (11, 51), (51, 100)))
        print(f"{name:50s}{parts}   all {change.sum():7.2f}")

    print("\nspot 60 rows from the amplifier, no sky: electrons added to the spot, rows 1-8, 9-48, 49-97 behind it")
    say("this program, 20000 columns", stochastic(1000)(column, 50))
    for empty in (False, True):
        moved = arctic(column, DENSITY, TAU, WELL, 0, empty_traps_for_first_transfers=empty)
        say(f"arcticpy 0, empty_traps_for_first_transfers={empty}", moved)


def chip(sky=SKY):
    """Print the cost of a whole chip, both halves; columns of `scene` repeated."""
    image = np.tile(scene(np.random.default_rng(2), 256, sky), (2, HALF_COLUMNS // 512))
    start = time.process_time()
    for half in range(2):
        rows = image[half * ROWS : (half + 1) * ROWS]
        transfer(rows, DENSITY, TAU, WELL, KEYS, flip=bool(half), overscan=OVERSCAN)
    print(f"\na whole chip of {image.shape}, sky {sky} e-: {time.process_time() - start:.2f} CPU s")


def along_rows(image, species=REGISTER, register=1):
    keys = np.uint64(register), np.uint64(2)
    return transfer_rows(image, *species, REGISTER_WELL, keys, prescan=PRESCAN, overscan=SERIAL_OVERSCAN)


def serial(sky_levels=(4, 40, 200)):
    """Print the cost of a chip's rows, and what trails behind a spot and a flat field, mean of 1000 registers."""
    along_rows(np.ones((1, 9), np.float32))
    print("\nrows through their registers, CPU s a chip: densities of cti.yaml, of PyAutoCTI's examples")
    for sky in sky_levels:
        image = scene(np.random.default_rng(sky), CHANNEL, sky)
        rows = 16 * (ROWS + OVERSCAN) / ROWS
        seconds = [rows * cpu(lambda part, s=s: along_rows(part, s), image) for s in (REGISTER, EUCLID)]
        print("sky {:3d} e-: {:6.2f} {:6.2f}".format(sky, *seconds), flush=True)

    def mean(row):
        """What 1000 registers change in a row and its overscan."""
        total = np.zeros(CHANNEL + SERIAL_OVERSCAN)
        for register in range(1000):
            image = np.repeat(row[None], 4, 0)
            trail, _ = along_rows(image, register=register)
            total += np.hstack([image - row, trail]).mean(0, dtype=float) / 1000
        return total

    sky = np.full(CHANNEL, SKY, np.float32)
    for flux in (500, 5000, 30000):
        spot = sky.copy()
        spot[1000:1003] = flux
        found = {"this program": mean(spot) - mean(sky)}
        if importlib.util.find_spec("arcticpy"):
            how = {"overscan_start": PRESCAN + 1003}
            rows = (np.pad(row, (PRESCAN, SERIAL_OVERSCAN)) for row in (spot, sky))
            moved = [arctic(row, *REGISTER, REGISTER_WELL, **how)[PRESCAN:] for row in rows]
            found["arcticpy 5"] = moved[0] - moved[1] - np.pad(spot - sky, (0, SERIAL_OVERSCAN))
        print(f"spot {flux} e- over columns 1000-1002: spot, 1-2, 3-8, 9-48 behind")
        for name, change in found.items():
            parts = [change[1000 + a : 1000 + b].sum() for a, b in ((0, 3), (3, 5), (5, 11), (11, 51))]
            print(f"   {name:12s}", np.round(parts, 2))
    for level in (1000, 20000):
        scan = mean(np.full(CHANNEL, level, np.float32))[CHANNEL:]
        eper = scan.sum() / level / (PRESCAN + CHANNEL)
        print(f"flat {level} e-: overscan columns 1-5", np.round(scan[:5], 2), f"EPER {eper:.1e} per transfer")


def chart(found, file):
    figure, axes = plt.subplots(figsize=(6, 4), layout="constrained")
    for name, (seconds, rms) in found.items():
        place = seconds, rms or 1e-3
        axes.plot(*place, "o" if rms else "k*", ms=6 if rms else 13)
        label = name if rms else "this program: exact (0; errors are against it)"
        axes.annotate(label, place, xytext=(5, 3), textcoords="offset points", fontsize=7, rotation=30 * (rms > 0))
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
    parser.add_argument("--serial", action="store_true", help="the sixth section only")
    given = parser.parse_args()
    if given.serial:
        return serial()
    columns = given.columns
    figures = ROOT / "docs" / "figures"
    chart(accuracy(columns, costs(columns)), figures / "cti_speed_accuracy.png")
    if importlib.util.find_spec("arcticpy"):
        first_transfers()
    trails(figures / "cti_trails.png")
    for sky in (4, SKY):
        chip(sky)
    serial()


if __name__ == "__main__":
    main()
