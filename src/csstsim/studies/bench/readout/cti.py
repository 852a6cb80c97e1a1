"""Speed against accuracy of charge transfer: the exact process, approximations, and arcticpy and MCTI if installed.

Accuracy is measured by the electrons that a spot loses and trails: 500, 5000 and 30000 e- over 3 rows, 147 and 4000
rows from the amplifier. Speed is measured on columns of 4616 rows with a chip's density of objects and cosmic rays.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np
from scipy.signal import lfilter

from csstsim.base.shipped import SHIPPED
from csstsim.base.types import FloatArray, PathLike
from csstsim.detector.charge_transfer.cti import transfer
from csstsim.detector.charge_transfer.parameters import Columns, TrapKeys, trap_model
from csstsim.instrument.load import read_data
from csstsim.studies.bench.readout.arctic import INSTALLED, arctic

if TYPE_CHECKING:
    from csstsim.studies.bench.readout.mcti import Mcti

CTI = read_data(SHIPPED / "instrument" / "cti.yaml")
WELL = CTI["well"]["beta"], CTI["well"]["full_well"], CTI["well"]["notch"]
DENSITY = np.array(CTI["species"]["density"])
TAU = np.array(CTI["species"]["timescale"])
TRAPS = trap_model(DENSITY, TAU, WELL)
KEYS = TrapKeys(np.uint64(1), np.uint64(2))
ROWS = 4616
OVERSCAN = 84
HALF_COLUMNS = 18432
CHIP = 9216 * 9232
# numbers on a chip; electrons of the faintest object
OBJECTS = 76638
RAYS = 5801
ELECTRONS = 60
SPOTS = [(flux, row) for row in (147, 4000) for flux in (500, 5000, 30000)]
SKY = 40
PIXELS_BEHIND = 198
SLOW_COLUMNS = 8  # columns, for the slow methods
LOSS = 1.2e-5  # per transfer, linear model: the loss of 5000 e- over 3 rows from row 4000
PARTS = ((0, 3), (3, 11), (11, 51), (51, 201))
Transfer: TypeAlias = Callable[[FloatArray, int], FloatArray]  # arguments: a column with a spot, the spot's row


class TimedMethod(NamedTuple):
    """A method of charge transfer, and its CPU seconds per half-column."""

    seconds: float
    transfer: Transfer


class MethodCost(NamedTuple):
    """The cost and the error of a method of charge transfer."""

    cpu: float  # s per chip
    error: float  # rms, relative, of spots' losses and trails
    parts: FloatArray  # (SPOTS, PARTS): electrons that spots lose and trail


def speed_accuracy(
    file: PathLike, log: Callable[[str], object], columns: int = 512, mcti: Mcti | None = None, quick: bool = False
) -> dict[str, MethodCost]:
    """Print cost, losses and trails of each method; draw the chart. Returns {name: MethodCost}.

    mcti: bench.readout.mcti.Mcti, or None; quick: with a hundredth of the columns, so with larger errors.
    """
    exact(np.ones((9, 9), np.float32))
    costs = accuracy(timed_methods(half_column(columns, SKY), mcti, quick), log)
    chart(costs, file)
    return costs


def half_column(columns: int, sky: int) -> float:
    """Return the CPU seconds of the exact process on a half-column of a chip, a mean over `columns`."""
    image = scene(np.random.default_rng(sky), columns, sky)
    return cpu(lambda part: exact(part, OVERSCAN), image) / columns


def exact(image: FloatArray, overscan: int = 0) -> tuple[FloatArray, int]:
    """Transfer charge [e-] of `image` (rows, columns), in place, by the exact process; return that of cti.transfer."""
    return transfer(image, TRAPS, KEYS, Columns(overscan=overscan))


def scene(rng: np.random.Generator, columns: int, sky: float) -> FloatArray:
    """Return half-columns with a Poisson sky, Gaussian objects of power-law fluxes and straight cosmic rays [e-]."""
    image = rng.poisson(sky, (ROWS, columns)).astype(float)
    yy, xx = np.mgrid[-8:9, -8:9]
    for _ in range(rng.poisson(OBJECTS / CHIP * image.size)):
        y = rng.integers(8, ROWS - 8)
        x = rng.integers(0, columns)
        shape = np.exp(-(yy**2 + xx**2) / (2 * rng.uniform(0.9, 3) ** 2))
        flux = ELECTRONS * min(1 + rng.pareto(0.8), 5e4)
        stamp = rng.poisson(flux * shape / shape.sum())
        low = max(int(x) - 8, 0)
        high = min(int(x) + 9, columns)
        image[y - 8 : y + 9, low:high] += stamp[:, low - x + 8 : high - x + 8]
    for _ in range(rng.poisson(RAYS / CHIP * image.size)):
        length = rng.uniform(0, 20)
        turn = rng.uniform(0, np.pi)
        step = np.arange(0, length + 1, 0.5)
        y = (rng.uniform(0, ROWS) + step * np.sin(turn)).astype(int) % ROWS
        x = (rng.uniform(0, columns) + step * np.cos(turn)).astype(int) % columns
        np.add.at(image, (y, x), np.rint(10 ** rng.normal(3.3, 0.255) / len(step)))
    return np.minimum(image, 90000).astype(np.float32)


def cpu(work: Callable[[FloatArray], object], image: FloatArray, repeats: int = 3) -> float:
    """Return the minimum CPU seconds of work(copy of image) in `repeats` runs."""
    times = []
    for _ in range(repeats):
        copy = image.copy()
        start = time.process_time()
        work(copy)
        times.append(time.process_time() - start)
    return min(times)


def linear(image: FloatArray) -> None:
    """Transfer in place by a linear model: each transfer traps any electron with probability LOSS."""
    transfers = np.arange(1, len(image) + 1)[:, None]
    change = np.zeros_like(image)
    for density, tau in zip(DENSITY, TAU, strict=True):
        loss = LOSS * density / DENSITY.sum()
        stay = np.exp(-1 / tau)
        lost = (loss * transfers * image).astype(np.float32)
        change -= lost
        change[1:] += lfilter([1 - stay], [1, -stay], lost[:-1], axis=0)
    image += change


def spot_column(flux: float, row: int) -> FloatArray:
    """Return a column [e-, float32] of sky with 3 px of `flux` from `row` on, and the pixels behind them."""
    column = np.full(row + 3 + PIXELS_BEHIND, SKY, np.float32)
    column[row : row + 3] = flux
    return column


def spot_change(method: Transfer, flux: float, row: int) -> FloatArray:
    """Return how `method` (column to column, a mean of realisations) changes a spot's electrons in each of PARTS."""
    sky = spot_column(SKY, row)
    spot = spot_column(flux, row)
    change = (method(spot, row) - spot) - (method(sky, row) - sky)
    return np.array([change[row + a : row + b].sum() for a, b in PARTS])


def stochastic(columns: int, scale: int = 1) -> Transfer:
    """Return the exact process as a method, with `scale` times as many electrons and traps, each as much smaller."""

    def method(column: FloatArray, row: int) -> FloatArray:
        n = max(columns, columns * 1000 // row)
        image = np.repeat(scale * column[:, None], n, 1)
        transfer(image, trap_model(scale * DENSITY, TAU, (WELL[0], scale * WELL[1], scale * WELL[2])), KEYS)
        return image.mean(1, dtype=float) / scale

    return method


def linear_column(column: FloatArray, row: int) -> FloatArray:
    """Return a column [e-] after the linear model; `row` is unused, but the other methods have it."""
    image = column[:, None].copy()
    linear(image)
    return image[:, 0]


def by_arctic(express: int, scan: bool) -> Callable[..., FloatArray]:
    """Return arcticpy's method; scan: with its `overscan_start` just behind the spot."""

    def method(column: FloatArray, row: int = 0) -> FloatArray:
        return arctic(column, DENSITY, TAU, WELL, express, **({"overscan_start": row + 3} if scan else {}))

    return method


def by_mcti(mcti: Mcti) -> Transfer:
    """Return MCTI's method: as many columns as give the trails to 1%, fewer the longer they are."""

    def method(column: FloatArray, row: int) -> FloatArray:
        image = np.repeat(column[:, None], max(300, 1_500_000 // row), 1)
        return mcti.transfer(image, DENSITY, TAU, WELL).mean(1)

    return method


def timed_methods(seconds: float, mcti: Mcti | None = None, quick: bool = False) -> dict[str, TimedMethod]:
    """Return {name: TimedMethod}; seconds: CPU time of the exact process per half-column."""
    image = scene(np.random.default_rng(5), 128, SKY)
    reduction = 100 if quick else 1

    def cost_per_column(work: Callable[[FloatArray], object], n: int = SLOW_COLUMNS) -> float:
        return cpu(work, image[:, :n], 1) / n

    large_well = (WELL[0], 30 * WELL[1], 30 * WELL[2])
    methods = {
        "exact, event by event": TimedMethod(seconds, stochastic(3000 // reduction)),
        "mean field": TimedMethod(
            cost_per_column(lambda part: transfer(30 * part, trap_model(30 * DENSITY, TAU, large_well), KEYS)),
            stochastic(100 // reduction, 30),
        ),
        "linear": TimedMethod(cost_per_column(linear, image.shape[1]), linear_column),
    }
    if INSTALLED:
        for express in (1, 2, 5):
            method = by_arctic(express, False)
            cost = cost_per_column(method, 64)
            methods[f"arcticpy {express}"] = TimedMethod(cost, method)
            methods[f"arcticpy {express}, overscan_start"] = TimedMethod(cost, by_arctic(express, True))
    if mcti is not None:
        methods["MCTI, the paper's code"] = TimedMethod(
            cost_per_column(lambda part: mcti.transfer(part, DENSITY, TAU, WELL, OVERSCAN), 32),
            by_mcti(mcti),
        )
    return methods


def accuracy(methods: Mapping[str, TimedMethod], log: Callable[[str], object]) -> dict[str, MethodCost]:
    """Print losses and trails by method; return {name: MethodCost}."""
    reference = None
    costs = {}
    log(f"\nspot over 3 rows, sky {SKY} e-: electrons added to the spot | rows 1-8, 9-48, 49-198 behind it")
    for name, method in methods.items():
        parts = np.array([spot_change(method.transfer, flux, row) for flux, row in SPOTS])
        reference = parts if reference is None else reference
        error = parts / reference - 1
        costs[name] = MethodCost(method.seconds * HALF_COLUMNS, np.sqrt((error**2).mean()), parts)
        against = f"error against the first: rms {costs[name].error:.2%}, largest {abs(error).max():.1%}"
        log(f"{name}: {costs[name].cpu:.1f} CPU s per chip; {against}")
        for (flux, row), (spot, *behind) in zip(SPOTS, parts, strict=True):
            log(f"   {flux:6d} e- at {row:4d}: {spot:9.2f} |" + "".join(f"{value:9.2f}" for value in behind))
    return costs


def chart(costs: Mapping[str, MethodCost], file: PathLike) -> None:
    """Draw rms error against CPU seconds."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(figsize=(6, 4), layout="constrained")
    for name, method in costs.items():
        is_exact = not method.error
        position = method.cpu, method.error or 1e-3
        axes.plot(*position, "k*" if is_exact else "o", ms=13 if is_exact else 6)
        label = "csstsim: exact (0; errors are against it)" if is_exact else name
        axes.annotate(
            label, position, xytext=(5, 3), textcoords="offset points", fontsize=7, rotation=30 * (method.error > 0)
        )
    axes.set(
        xscale="log",
        yscale="log",
        xlabel="CPU s per chip, sky 40 e$^-$",
        ylabel="rms relative error of spot losses and trails",
        xlim=(1, 4e3),
        ylim=(7e-4, 2),
    )
    figure.savefig(file, dpi=110)
    plt.close(figure)
