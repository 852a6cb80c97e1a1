"""Charge transfer inefficiency: cost and accuracy, also of other methods, and the paper's figure of two stamps.

    python benchmarks/cti.py [--columns 512]
    python benchmarks/cti.py --mcti MCTI

1. CPU time per half-column and per chip (least of three) at 4, 40 and 200 e- of sky, on columns with a chip's density
   of objects and cosmic rays; for comparison, on fewer columns, every trap visits every packet.
2. Losses and trails of a spot of 500, 5000 and 30000 e- over 3 rows, 147 and 4000 rows from the amplifier: csstsim,
   its limit of many small electrons (mean field), a linear model, arcticpy (csstsim.studies.bench.readout.arctic).
   The spread of the errors against CPU time goes to docs/figures/cti_speed_accuracy.png.
3. How arcticpy treats the traps of a packet's own first rows (docs/detector_cti.md).
4. Input, output and trail of a stamp 147 and 4000 rows from the amplifier: docs/figures/cti_trails.png.
5. Whole chips.
6. Rows through their registers: cost of a chip; trails of a spot and of a flat field.

With --mcti, only the paper's own code, of a checkout of github.com/ZunLuo/MCTI: losses and trails of three spots in a
column of Poisson sky, charge deferred into the overscan, cost.
"""

import argparse
import math
import time
from pathlib import Path

from evidence.record import Record

import matplotlib
import numba
import numpy as np

from csstsim.base.counter import unit, word
from csstsim.detector.charge_transfer.cti import transfer
from csstsim.detector.charge_transfer.parameters import Columns, Register, TrapKeys, trap_model
from csstsim.detector.charge_transfer.serial import transfer_rows
from csstsim.detector.charge_transfer.traps import draw_traps, trap_lists
from csstsim.studies.bench.readout.arctic import INSTALLED, arctic
from csstsim.studies.bench.readout.cti import (
    CTI,
    DENSITY,
    HALF_COLUMNS,
    KEYS,
    OVERSCAN,
    PARTS,
    ROWS,
    SKY,
    SLOW_COLUMNS,
    SPOTS,
    TAU,
    TRAPS,
    WELL,
    cpu,
    exact,
    half_column,
    scene,
    speed_accuracy,
    stochastic,
)  # fmt: skip
from csstsim.studies.bench.readout.mcti import Mcti

matplotlib.use("Agg")
from matplotlib import pyplot as plt

REGISTER = tuple(CTI["serial"]["species"][name] for name in ("density", "timescale"))
REGISTER_WELL = tuple(CTI["serial"]["well"][name] for name in ("beta", "full_well", "notch"))
EUCLID = (0.0442, 0.1326, 3.9782), (0.8, 4.0, 20.0)  # serial species in PyAutoCTI's examples
PRESCAN, CHANNEL, SERIAL_OVERSCAN = 27, 1152, 71
SPOT_ROWS, SPOT, FIRST_ROWS = (200, 700, 1200), 5000, 50  # of three spots [e-] in a column; overscan rows looked at


@numba.njit
def every_packet(image, model, lists):
    """Run the same process with every trap visiting every packet."""
    head, next_, level, tau, bits = lists
    for x in range(image.shape[1]):
        column = image[:, x]
        draw_traps(word(np.uint64(1), np.uint64(x)), model, np.ones(len(head)), lists)
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
                        if unit(word(bits[trap], n)) > leaves:
                            column[k] += 1
                            filled = False
                trap = next_[trap]


def plain_loop(image):
    every_packet(image, TRAPS, trap_lists(DENSITY, ROWS))


SKIES = (4, 40, 200)  # e-


def costs(columns: int, record: Record) -> None:
    """Record the costs of half-columns and chips."""
    exact(np.ones((9, 9), np.float32))
    rows = []
    for sky in SKIES:
        plain = cpu(plain_loop, scene(np.random.default_rng(sky), SLOW_COLUMNS, sky), 2) / SLOW_COLUMNS
        ours = half_column(columns, sky)
        rows.append([
            f"{sky} e-", f"{1e3 * ours:.3f} ms", f"{HALF_COLUMNS * ours:.1f} s",
            f"{1e3 * plain:.1f} ms", f"{HALF_COLUMNS * plain:.0f} s",
        ])  # fmt: skip
    record.table("costs", ["sky", "this program", "a chip", "each packet visited by each trap", "a chip"], rows)


def losses(columns: int, record: Record) -> None:
    """Record cost and errors of each method, and what spots lose and trail."""
    found = speed_accuracy(record.figure("cti_speed_accuracy.png"), print, columns, quick=record.toy)
    ours = found["exact, event by event"]
    rows = []
    for name, method in found.items():
        largest = abs(method.parts / ours.parts - 1).max()
        rows.append([name, f"{method.cpu:.1f}", f"{method.error:.2%}", f"{largest:.1%}"])
    record.table("methods", ["method", "CPU s per chip", "rms error", "largest error"], rows)
    if not INSTALLED:
        record.skip("arcticpy", "not installed")
        return
    peer, far = found["arcticpy 5, overscan_start"].parts, [row > 1000 for _, row in SPOTS]
    rows = [
        [f"{flux:,}", row, *(f"{abs(a):.2f} / {abs(b):.2f}" for a, b in zip(*pair, strict=True))]
        for (flux, row), *pair in zip(SPOTS, ours.parts, peer, strict=True)
    ]
    record.table("spots", ["e-", "row", "spot loses, ours / arcticpy", "rows 1-8 behind", "9-48", "49-198"], rows)
    limit = "largest relative difference from arcticpy, express 5, of a spot's loss or trail"
    record.value("arctic_difference", abs(ours.parts / peer - 1).max(), limit, below=0.03)
    mean = found["mean field"].parts
    record.value("mean_field", abs(mean / peer - 1)[far].max(), f"mean field, row 4000: {limit}")
    default = found["arcticpy 5"].parts / ours.parts - 1
    record.value("default_far", default[far, 1:].max(), "excess of arcticpy's default in a trail, row 4000, largest")
    nearby = default[[row < 1000 for _, row in SPOTS], -1]
    record.value("default_near", nearby.mean(), "excess of arcticpy's default 49 to 198 rows behind a spot at row 147")
    for name in ("arcticpy 1", "arcticpy 5"):
        record.value(f"{name.replace(' ', '_')}_cpu", found[name].cpu, f"a chip's transfer by {name}", unit="CPU-s")


def first_transfers(record: Record) -> None:
    """Record a spot of 5000 e- without sky, 60 rows from the amplifier: arcticpy with and without emptied traps."""
    column = np.zeros(160, np.float32)
    column[60:63] = 5000
    rows = []

    def add(name: str, moved: np.ndarray) -> None:
        change = moved - column
        parts = [change[60 + a : 60 + b].sum() for a, b in ((0, 3), (3, 11), (11, 51), (51, 100))]
        rows.append([name, *(f"{value:.2f}" for value in (*parts, change.sum()))])

    count = 20 if record.toy else 1000  # times 20 columns at row 50
    add(f"this program, {20 * count:,} columns", stochastic(count)(column, 50))
    for empty, name in ((False, "default"), (True, "emptied")):
        moved = arctic(column, DENSITY, TAU, WELL, 0, empty_traps_for_first_transfers=empty)
        add(f"arcticpy, express 0, {name}", moved)
    head = "spot of 5000 e- at row 60, no sky"
    record.table("first_transfers", [head, "spot", "rows 1-8", "9-48", "49-97", "all"], rows)
    for name, kept in (("all", slice(None)), *((f"species_{k + 1}", slice(k, k + 1)) for k in range(len(TAU)))):
        column = np.zeros(4000, np.float32)
        column[60:63] = 5000
        made = arctic(column, DENSITY[kept], TAU[kept], WELL, 5).sum(dtype=float) - column.sum(dtype=float)
        record.value(
            f"created_{name}", made, f"charge that arcticpy's default creates behind a spot ({name})", unit="e-"
        )


def chip(sky, columns=HALF_COLUMNS // 2):
    """Return the CPU seconds of both halves of a chip's columns, made of repeated columns of `scene`."""
    image = np.tile(scene(np.random.default_rng(2), 256, sky), (2, columns // 256))
    start = time.process_time()
    for half in range(2):
        rows = image[half * ROWS : (half + 1) * ROWS]
        transfer(rows, TRAPS, KEYS, Columns(flip=bool(half), overscan=OVERSCAN))
    return time.process_time() - start


def along_rows(image, species=REGISTER, register=1):
    keys = TrapKeys(np.uint64(register), np.uint64(2))
    line = Register(prescan=PRESCAN, overscan=SERIAL_OVERSCAN)
    return transfer_rows(image, trap_model(*species, REGISTER_WELL), keys, line)


def serial(record: Record) -> None:
    """Record the cost of a chip's rows, and the trails of a spot and a flat field, means of many registers."""
    registers = 20 if record.toy else 1000
    along_rows(np.ones((1, 9), np.float32))
    lines = []
    for sky in SKIES:
        image = scene(np.random.default_rng(sky), CHANNEL, sky)[: 200 if record.toy else None]
        rows = 16 * (ROWS + OVERSCAN) / len(image)
        seconds = [rows * cpu(lambda part, s=s: along_rows(part, s), image) for s in (REGISTER, EUCLID)]
        lines.append([f"{sky} e-", *(f"{value:.1f}" for value in seconds)])
    record.table("registers", ["sky", "densities of `cti.yaml`, CPU s a chip", "of PyAutoCTI's examples"], lines)

    def mean(row: np.ndarray) -> np.ndarray:
        """Return the mean change by the registers of a row and its overscan."""
        total = np.zeros(CHANNEL + SERIAL_OVERSCAN)
        for register in range(registers):
            image = np.repeat(row[None], 4, 0)
            trail, _ = along_rows(image, register=register)
            total += np.hstack([image - row, trail]).mean(0, dtype=float) / registers
        return total

    sky, lines = np.full(CHANNEL, SKY, np.float32), []
    for flux in (500, 5000, 30000):
        spot = sky.copy()
        spot[1000:1003] = flux
        found = [mean(spot) - mean(sky)]
        if INSTALLED:
            how = {"overscan_start": PRESCAN + 1003}
            rows = (np.pad(row, (PRESCAN, SERIAL_OVERSCAN)) for row in (spot, sky))
            moved = [arctic(row, *REGISTER, REGISTER_WELL, **how)[PRESCAN:] for row in rows]
            found.append(moved[0] - moved[1] - np.pad(spot - sky, (0, SERIAL_OVERSCAN)))
        parts = [
            [abs(change[1000 + a : 1000 + b].sum()) for a, b in ((0, 3), (3, 5), (5, 11), (11, 51))] for change in found
        ]
        lines.append([f"{flux:,} e-", *(" / ".join(f"{v:.2f}" for v in both) for both in zip(*parts, strict=True))])
    head = "spot over columns 1000-1002"
    record.table("serial_spots", [head, "spot loses, ours / arcticpy", "1-2 behind", "3-8", "9-48"], lines)
    lines = []
    for level in (1000, 20000):
        scan = mean(np.full(CHANNEL, level, np.float32))[CHANNEL:]
        eper = scan.sum() / level / (PRESCAN + CHANNEL)
        lines.append([f"{level:,} e-", ", ".join(f"{v:.2f}" for v in scan[:5]), f"{eper:.1e}"])
    record.table("serial_flats", ["flat", "overscan columns 1, 2, 3, 4, 5 [e-]", "EPER per transfer"], lines)


class StandIn:
    """This program in the place of MCTI, for the size of seconds without a checkout."""

    def transfer(
        self, image: np.ndarray, density: np.ndarray, timescale: np.ndarray, well: tuple, overscan: int, seed: int = 1
    ) -> np.ndarray:
        """Return an image and its overscan after the transfer, as Mcti.transfer does."""
        moved, keys = image.copy(), TrapKeys(np.uint64(1000 + seed), np.uint64(2000 + seed))
        trail, _ = transfer(moved, trap_model(density, timescale, well), keys, Columns(overscan=overscan))
        return np.concatenate([moved, trail])


def papers_code(mcti: Mcti | StandIn, record: Record) -> None:
    """Record what three spots in columns of Poisson sky lose and trail, here and in the paper's code, and the cost.

    The columns are divided into batches with traps of their own; their scatter gives the errors.
    """
    columns, batches = (40, 4) if record.toy else (4000, 20)
    exact(np.ones((9, 9), np.float32), OVERSCAN)  # compiles
    lines, worst = [], []
    for sky in (5, 40):
        rng = np.random.default_rng(sky)
        image = rng.poisson(sky, (SPOT_ROWS[-1] + PARTS[-1][1], columns)).astype(np.float32)
        for row in SPOT_ROWS:
            image[row : row + 3] = SPOT
        found = {"csstsim": [], "MCTI": []}
        seconds = dict.fromkeys(found, 0.0)
        for batch, part in enumerate(np.array_split(image, batches, axis=1)):
            keys = TrapKeys(np.uint64(2 * batch + 1), np.uint64(2 * batch + 2))
            for name in found:
                start, moved = time.process_time(), part.copy()
                if name == "csstsim":
                    trail, _ = transfer(moved, TRAPS, keys, Columns(overscan=FIRST_ROWS))
                else:
                    out = mcti.transfer(part, DENSITY, TAU, WELL, FIRST_ROWS, batch + 1)
                    moved, trail = out[: len(part)], out[len(part) :]
                seconds[name] += time.process_time() - start
                change = (moved - part).mean(1, dtype=float)
                parts = [[change[row + a : row + b].sum() for a, b in PARTS] for row in SPOT_ROWS]
                found[name].append([*np.ravel(parts), trail.mean(dtype=float)])
        ours, theirs = (np.array(found[name]) for name in found)
        means = ours.mean(0), theirs.mean(0)
        error = np.hypot(ours.std(0), theirs.std(0)) / np.sqrt(batches - 1)
        spots = [f"{abs(a):.2f} / {abs(b):.2f}" for a, b in zip(*means, strict=True)][:-1]
        lines += [
            [f"{sky} e-", row, *spots[k : k + len(PARTS)]]
            for row, k in zip(SPOT_ROWS, range(0, len(spots), len(PARTS)), strict=True)
        ]
        worst.append([abs(means[0] / means[1] - 1).max(), (abs(means[0] - means[1]) / error).max()])
        for name, values in zip(("csstsim", "mcti"), (ours[:, -1], theirs[:, -1]), strict=True):
            what = f"charge of each of the first {FIRST_ROWS} overscan rows by {name}, sky of {sky} e-"
            spread = values.std() / np.sqrt(batches - 1)
            record.value(f"overscan_{name}_{sky}", values.mean(), what, unit="e-", error=spread)
        what = f"CPU time of MCTI over that of csstsim, columns of {len(image)} rows, sky of {sky} e-"
        record.value(f"times_{sky}", seconds["MCTI"] / seconds["csstsim"], what)
    head = ["sky", "row", "spot loses, ours / MCTI", "rows 1-8 behind", "9-48", "49-198"]
    record.table("spots", head, lines)
    relative, sigma = np.max(worst, axis=0)
    record.value("largest", relative, "largest relative difference from MCTI", below=0.02)
    record.value("largest_sigma", sigma, "largest difference from MCTI over its error", below=4)
    image = scene(np.random.default_rng(5), 2 if record.toy else 32, SKY)
    theirs = cpu(lambda part: mcti.transfer(part, DENSITY, TAU, WELL, OVERSCAN), image, 1) / image.shape[1]
    what = f"CPU time of MCTI over that of csstsim, half-columns of {ROWS} rows"
    record.value("times_half_column", theirs / half_column(512, SKY), what)


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
    """Run all parts, or that with the paper's code."""
    given, toy = record.options, record.toy
    if given.mcti:
        absent = toy and not Path(given.mcti).is_dir()
        if absent:
            record.skip("MCTI", "no checkout; this program takes its place")
        papers_code(StandIn() if absent else Mcti(given.mcti), record)
        return
    columns = 16 if toy else given.columns
    costs(columns, record)
    losses(columns, record)
    if INSTALLED:
        first_transfers(record)
    trails(record.figure("cti_trails.png"))
    for sky in (4, SKY):
        seconds = chip(sky, 256 if toy else HALF_COLUMNS // 2)
        record.value(f"chip_cpu_{sky}", seconds, f"charge transfer of a whole chip, sky of {sky} e-", unit="CPU-s")
    serial(record)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--columns", type=int, default=512)
    parser.add_argument("--mcti", metavar="FOLDER", help="a checkout of github.com/ZunLuo/MCTI; it needs cc")
    with Record(parser) as record:
        main(record)
