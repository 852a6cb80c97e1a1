"""Correction of charge transfer: flux of blobs still lost to traps, added noise, and CPU seconds.

    python benchmarks/charge_correction.py

Blobs of 3 x 3 px on 40 e- of sky stand 2000 rows from the amplifier. Their light is what is above the median in five
rows. Traps have the paper's density, or that of config/observations/science.yaml. The noise is that of a frame of SKY
electrons of sky and the read noise, in the same rows.
"""

import argparse
import time
from collections.abc import Callable

from evidence.record import Record

import numpy as np

from csstsim.base.rng import stream
from csstsim.base.shipped import SHIPPED
from csstsim.detector.bfe_kernel import detector_kernel
from csstsim.detector.brighter_fatter import move_back
from csstsim.detector.charge_transfer.cti import transfer
from csstsim.detector.charge_transfer.parameters import Columns, TrapKeys, trap_model
from csstsim.detector.charge_transfer.restored import restore_columns
from csstsim.instrument.camera import load_camera
from csstsim.simulation.sim_steps import SimSteps
from csstsim.studies.bench.readout.cti import DENSITY, ROWS, TAU, WELL

COLUMNS, TOY_COLUMNS = 2000, 40
FLUXES, PASSES = (100, 1000, 20_000), (1, 2, 3)  # e-
HEIGHT, BLOBS, SKY = 240, range(30, 240, 60), {"blobs": 40.0, "noise": 29.3}  # px; rows of blobs; e-
PLACE = Columns(lead=2000, n_rows=ROWS)
KEYS, OTHERS = TrapKeys(np.uint64(7), np.uint64(8)), TrapKeys(np.uint64(99), np.uint64(100))
NOISE_PASSES = 0, 1, 2, 3, 5
HALF_COLUMNS = 18432


def moved(image: np.ndarray, density: np.ndarray) -> np.ndarray:
    """Return an image after the transfer."""
    out = image.copy()
    transfer(out, trap_model(density, TAU, WELL), KEYS, PLACE)
    return out


def back(image: np.ndarray, density: np.ndarray, passes: int, keys: TrapKeys = KEYS) -> np.ndarray:
    """Return an image with the transfer undone."""
    out = image.copy()
    restore_columns(out, trap_model(density, TAU, WELL), keys, passes, PLACE)
    return out


def light(image: np.ndarray) -> np.ndarray:
    """Return the light of each column's blobs above the median, their mean."""
    above = image - np.median(image)
    return np.mean([above[row - 2 : row + 3].sum(axis=0) for row in BLOBS], axis=0)


def blobs(densities: dict[str, np.ndarray], record: Record) -> None:
    """Record the light that blobs lose, and what is left of the loss."""
    columns, rows = TOY_COLUMNS if record.toy else COLUMNS, []
    for traps, density in densities.items():
        for flux in FLUXES:
            image = np.full((HEIGHT, columns), SKY["blobs"], np.float32)
            for row in BLOBS:
                image[row - 1 : row + 2] += np.float32(flux / 3)
            true = stream(5, "blobs", flux).poisson(image).astype(np.float32)
            read = moved(true, density)
            ways = [back(read, density, passes) for passes in PASSES] + [back(read, density, PASSES[-1], OTHERS)]
            lost, *left = (light(true) - light(each) for each in (read, *ways))
            cells = [f"{100 * each.mean() / lost.mean():.2f} ± {100 * error(each) / lost.mean():.2f}" for each in left]
            if density is DENSITY:
                for key, which, each in (
                    ("left", "", left[-2]),
                    ("left_other", ", others of the same density", left[-1]),
                ):
                    what = f"left of the loss of {flux:,} e- after three passes, the paper's traps{which}"
                    goal = {"below": 0.1} if flux == FLUXES[1] else {}
                    record.value(
                        f"{key}_{flux}", each.mean() / lost.mean(), what, error=error(each) / lost.mean(), **goal
                    )
            rows.append([traps, f"{flux:,}", f"{100 * lost.mean() / flux:.2f}", *cells])
    one = "left of the loss after 1 pass, %"
    header = ["traps", "blob, e-", "light lost, %", one, "2 passes", "3 passes", "3 passes, other traps"]
    record.table("blobs", header, rows)
    record.value("count", columns * len(BLOBS), "blobs in each mean")


def error(values: np.ndarray) -> float:
    """Return the error of a mean."""
    return values.std() / np.sqrt(len(values) - 1)


def noise(density: np.ndarray, read_noise: float, record: Record) -> None:
    """Record the rms of the pixels of a frame without objects by the number of passes."""
    rng, shape = stream(6, "noise"), (HEIGHT, TOY_COLUMNS if record.toy else COLUMNS)
    read = moved(rng.poisson(SKY["noise"], shape).astype(np.float32), density)
    read += rng.normal(0, read_noise, shape).astype(np.float32)
    for passes in NOISE_PASSES:
        rms = back(read, density, passes).std(dtype=float)
        what = f"rms of pixels after {passes} passes, the paper's traps, sky of {SKY['noise']} e-"
        record.value(f"noise_{passes}", rms, what, unit="e-", error=rms / np.sqrt(2 * read.size))


def seconds(work: Callable[[], object]) -> float:
    """Return the least CPU seconds of two calls."""
    times = []
    for _ in range(2):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return min(times)


def main(record: Record) -> None:
    """Measure blobs, noise and cost."""
    detector = load_camera(SHIPPED / "instrument").detector
    steps = SimSteps(SHIPPED / "observations" / "science.yaml", "SCIE")
    scale = next(step.param.density_scale for step in steps if step.name == "cte_effect")
    densities = {"the paper's": DENSITY, f"{scale:g} of them, as shipped": scale * DENSITY}
    blobs(densities, record)
    noise(DENSITY, detector.read_noise, record)
    columns = 16 if record.toy else 512
    frame = stream(7, "cost").poisson(SKY["noise"], (ROWS, columns)).astype(np.float32)
    for name, density in zip(("paper", "shipped"), densities.values(), strict=True):

        def undo(density: np.ndarray = density) -> None:
            restore_columns(frame.copy(), trap_model(density, TAU, WELL), KEYS, PASSES[-1])

        cost = seconds(undo) * HALF_COLUMNS / columns
        record.value(f"chip_{name}_cpu", cost, f"three passes of a chip's columns, {name}'s traps", unit="CPU-s")
    kernel, chip = detector_kernel(detector), (1000 if record.toy else detector.ny, detector.nx)
    image = stream(8, "cost").poisson(SKY["noise"], chip).astype(np.float32)
    cost = seconds(lambda: move_back(image.copy(), *kernel, detector.full_well))
    record.value("move_back_cpu", cost, "brighter-fatter effect of a chip undone", unit="CPU-s")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    with Record(parser) as record:
        main(record)
