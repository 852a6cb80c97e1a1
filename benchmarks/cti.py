"""Charge transfer inefficiency: cost and accuracy, also of other methods, and the paper's figure of two stamps.

    python benchmarks/cti.py [--columns 512]
    python benchmarks/cti.py --only-mcti --mcti MCTI

1. CPU time per half-column and per chip (least of three) at 4, 40 and 200 e- of sky, on columns with a chip's density
   of objects and cosmic rays; for comparison, on fewer columns, every trap visits every packet.
2. Losses and trails of a spot of 500, 5000 and 30000 e- over 3 rows, 147 and 4000 rows from the amplifier: csstsim,
   its limit of many small electrons (mean field), a linear model, arcticpy (csstsim.bench.readout.arctic).
   The spread of the errors against CPU time goes to docs/figures/cti_speed_accuracy.png.
3. How arcticpy treats the traps of a packet's own first rows (docs/detector_cti.md).
4. Input, output and trail of a stamp 147 and 4000 rows from the amplifier: docs/figures/cti_trails.png.
5. Two whole chips.
6. Rows through their registers: cost of a chip; trails of a spot and of a flat field.
7. With --mcti, the paper's own code, of a checkout of github.com/ZunLuo/MCTI (alone with --only-mcti): losses and
   trails of three spots in a column of Poisson sky, charge deferred into the overscan, cost. It is in the chart of
   part 2, too.
"""

import argparse
import math
import time

from evidence.record import Record

import matplotlib
import numba
import numpy as np

from csstsim.base.counter import unit, word
from csstsim.bench.readout.arctic import THERE, arctic
from csstsim.bench.readout.cti import (
    CTI,
    DENSITY,
    FEW,
    HALF_COLUMNS,
    KEYS,
    OVERSCAN,
    PARTS,
    ROWS,
    SKY,
    TAU,
    WELL,
    cpu,
    exact,
    half_column,
    scene,
    speed_accuracy,
    stochastic,
)  # fmt: skip
from csstsim.bench.readout.mcti import Mcti
from csstsim.detector.charge_transfer.cti import transfer
from csstsim.detector.charge_transfer.serial import transfer_rows
from csstsim.detector.charge_transfer.traps import buffers, draw_traps

matplotlib.use("Agg")
from matplotlib import pyplot as plt

REGISTER = tuple(CTI["serial"]["species"][name] for name in ("density", "timescale"))
REGISTER_WELL = tuple(CTI["serial"]["well"][name] for name in ("beta", "full_well", "notch"))
EUCLID = (0.0442, 0.1326, 3.9782), (0.8, 4.0, 20.0)  # serial species in PyAutoCTI's examples
PRESCAN, CHANNEL, SERIAL_OVERSCAN = 27, 1152, 71
SPOT_ROWS, SPOT, FIRST_ROWS = (200, 700, 1200), 5000, 50  # of three spots [e-] in a column; overscan rows looked at


@numba.njit
def every_packet(image, density, timescale, well, head, room):
    """Run the same process with every trap visiting every packet."""
    level, tau, own, next_ = room
    for x in range(image.shape[1]):
        column = image[:, x]
        draw_traps(word(np.uint64(1), np.uint64(x)), density, timescale, well, np.ones(len(head)), head, *room)
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


SKIES = (4, 40, 200)  # e-


def costs(columns):
    """Print the table of costs."""
    exact(np.ones((9, 9), np.float32))
    print("sky e-        csstsim: ms/half-column  s/chip    every packet: ms/half-column  s/chip")
    for sky in SKIES:
        plain = cpu(plain_loop, scene(np.random.default_rng(sky), FEW, sky), 2) / FEW
        numbers = [t * s for t in (half_column(columns, sky), plain) for s in (1e3, HALF_COLUMNS)]
        print("{:6d} {:22.3f} {:16.2f} {:25.2f} {:13.0f}".format(sky, *numbers), flush=True)


def first_transfers():
    """Print a spot of 5000 e- without sky, 60 rows from the amplifier: arcticpy with and without emptied traps."""
    column = np.zeros(160, np.float32)
    column[60:63] = 5000

    def say(name, moved):
        change = moved - column
        parts = "".join(f"{change[60 + a : 60 + b].sum():9.2f}" for a, b in ((0, 3), (3, 11), (11, 51), (51, 100)))
        print(f"{name:50s}{parts}   all {change.sum():7.2f}")

    print("\nspot 60 rows from the amplifier, no sky: electrons added to the spot, rows 1-8, 9-48, 49-97 behind it")
    say("csstsim, 20000 columns", stochastic(1000)(column, 50))
    for empty in (False, True):
        moved = arctic(column, DENSITY, TAU, WELL, 0, empty_traps_for_first_transfers=empty)
        say(f"arcticpy 0, empty_traps_for_first_transfers={empty}", moved)


def chip(sky, columns=HALF_COLUMNS // 2):
    """Return the CPU seconds of both halves of a chip's columns, made of repeated columns of `scene`."""
    image = np.tile(scene(np.random.default_rng(2), 256, sky), (2, columns // 256))
    start = time.process_time()
    for half in range(2):
        rows = image[half * ROWS : (half + 1) * ROWS]
        transfer(rows, DENSITY, TAU, WELL, KEYS, flip=bool(half), overscan=OVERSCAN)
    return time.process_time() - start


def along_rows(image, species=REGISTER, register=1):
    keys = np.uint64(register), np.uint64(2)
    return transfer_rows(image, *species, REGISTER_WELL, keys, prescan=PRESCAN, overscan=SERIAL_OVERSCAN)


def serial(registers=1000):
    """Print the cost of a chip's rows, and the trails of a spot and a flat field, means of many registers."""
    along_rows(np.ones((1, 9), np.float32))
    print("\nrows through their registers, CPU s per chip: densities of cti.yaml, of PyAutoCTI's examples")
    for sky in SKIES:
        image = scene(np.random.default_rng(sky), CHANNEL, sky)
        rows = 16 * (ROWS + OVERSCAN) / ROWS
        seconds = [rows * cpu(lambda part, s=s: along_rows(part, s), image) for s in (REGISTER, EUCLID)]
        print("sky {:3d} e-: {:6.2f} {:6.2f}".format(sky, *seconds), flush=True)

    def mean(row):
        """Return the mean change by the registers of a row and its overscan."""
        total = np.zeros(CHANNEL + SERIAL_OVERSCAN)
        for register in range(registers):
            image = np.repeat(row[None], 4, 0)
            trail, _ = along_rows(image, register=register)
            total += np.hstack([image - row, trail]).mean(0, dtype=float) / registers
        return total

    sky = np.full(CHANNEL, SKY, np.float32)
    for flux in (500, 5000, 30000):
        spot = sky.copy()
        spot[1000:1003] = flux
        found = {"this program": mean(spot) - mean(sky)}
        if THERE:
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


def papers_code(mcti, columns=4000, batches=20):
    """Print what three spots in columns of Poisson sky lose and trail, here and in the paper's code, and the cost.

    The columns are divided into batches with traps of their own; their scatter gives the errors.
    """
    for sky in (5, 40):
        rng = np.random.default_rng(sky)
        image = rng.poisson(sky, (SPOT_ROWS[-1] + PARTS[-1][1], columns)).astype(np.float32)
        for row in SPOT_ROWS:
            image[row : row + 3] = SPOT
        found = {"csstsim": [], "MCTI": []}
        seconds = dict.fromkeys(found, 0.0)
        for batch, part in enumerate(np.array_split(image, batches, axis=1)):
            keys = np.uint64(2 * batch + 1), np.uint64(2 * batch + 2)
            for name in found:
                start, moved = time.process_time(), part.copy()
                if name == "csstsim":
                    trail, _ = transfer(moved, DENSITY, TAU, WELL, keys, overscan=FIRST_ROWS)
                else:
                    out = mcti.transfer(part, DENSITY, TAU, WELL, FIRST_ROWS, batch + 1)
                    moved, trail = out[: len(part)], out[len(part) :]
                seconds[name] += time.process_time() - start
                change = (moved - part).mean(1, dtype=float)
                lines = [[change[row + a : row + b].sum() for a, b in PARTS] for row in SPOT_ROWS]
                found[name].append([*np.ravel(lines), trail.mean(dtype=float)])
        print(f"\nspots of {SPOT} e- over 3 rows, Poisson sky of {sky} e-, {columns} columns: csstsim, MCTI, ratio")
        ours, theirs = (np.array(found[name]) for name in found)
        mean, other = ours.mean(0), theirs.mean(0)
        error = np.hypot(ours.std(0), theirs.std(0)) / np.sqrt(batches - 1) / abs(other)
        names = [
            f"row {row:4d} {part}" for row in SPOT_ROWS for part in ("spot", "rows 1-8", "rows 9-48", "rows 49-198")
        ]
        for name, *numbers in zip(
            [*names, f"overscan rows 1-{FIRST_ROWS}, each"], mean, other, mean / other, error, strict=True
        ):
            print("{:28s} {:9.4f} {:9.4f}   {:.4f} +- {:.4f}".format(name, *numbers))
        print(f"CPU time: MCTI / csstsim {seconds['MCTI'] / seconds['csstsim']:.0f}", flush=True)


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


def main(record: Record) -> None:
    """Run the parts that are asked for."""
    given, toy = record.options, record.toy
    mcti = given.mcti and Mcti(given.mcti)
    if mcti:
        with record.printed("papers_code"):
            papers_code(mcti)
    if given.only_mcti:
        return
    columns = 16 if toy else given.columns
    with record.printed("costs"):
        costs(columns)
    with record.printed("losses"):
        found = speed_accuracy(record.figure("cti_speed_accuracy.png"), print, columns, mcti, quick=toy)
    for key, name in (("arctic", "arcticpy 5"), ("exact", "exact, event by event")):
        if name in found:
            record.value(f"{key}_cpu", found[name].cpu, f"a chip's charge transfer by {name}", unit="CPU-s")
    if THERE:
        with record.printed("first_transfers"):
            first_transfers()
    else:
        record.skip("arcticpy", "not installed")
    trails(record.figure("cti_trails.png"))
    for sky in (4, SKY):
        seconds = chip(sky, 256 if toy else HALF_COLUMNS // 2)
        record.value(f"chip_cpu_{sky}", seconds, f"charge transfer of a whole chip, sky of {sky} e-", unit="CPU-s")
    with record.printed("registers"):
        serial(20 if toy else 1000)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--columns", type=int, default=512)
    parser.add_argument("--mcti", metavar="FOLDER", help="a checkout of github.com/ZunLuo/MCTI; it needs cc")
    parser.add_argument("--only-mcti", action="store_true", help="the seventh part only")
    with Record(parser) as record:
        main(record)
