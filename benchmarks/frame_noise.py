"""Whole-frame noise and the response of pixels: CPU ns per pixel, and numpy's in the same run.

    python benchmarks/frame_noise.py

Frames have the chip's width; the best of five runs counts, with numba compiled before. numpy only draws the noise that
the kernels also add in place.
"""

import argparse
import time

from evidence.record import Record

import numpy as np

from csstsim.base.rng import stream
from csstsim.detector import prnu
from csstsim.detector.noise import add_gaussian, add_poisson

WIDTH, ROWS, REPEATS, KEY = 9216, 1024, 5, np.uint64(20271)


def cost(work, pixels):
    """Return ns of CPU per pixel of work(), the best of REPEATS."""
    best = np.inf
    for _ in range(REPEATS + 1):
        start = time.process_time()
        work()
        best = min(best, time.process_time() - start)
    return 1e9 * best / pixels


def main(record: Record) -> None:
    """Time each kind of noise."""
    rows = 64 if record.toy else ROWS
    rng = stream(1, "frame noise")
    frame, expected = np.zeros((rows, WIDTH), np.float32), np.zeros((rows, WIDTH), np.float32)

    def ours(mean):
        frame[...] = mean
        add_poisson(frame, KEY)

    copy = cost(lambda: np.copyto(frame, expected), frame.size)
    here = cost(lambda: add_gaussian(frame, 5.0, KEY), frame.size)
    there = cost(lambda: rng.standard_normal(frame.shape, np.float32), frame.size)
    lines = [["Gaussian, float32", f"{here:.1f}", f"{there:.1f}"]]
    ramp = np.linspace(0.95, 1.05, frame.size, dtype=np.float32).reshape(frame.shape)
    for mean in (0.1, 4.0, 40.0, 120.0, 1e3, 1e4):
        expected[...] = mean * ramp
        here = cost(lambda: ours(expected), frame.size) - copy
        there = cost(lambda: rng.poisson(expected), frame.size)
        lines.append([f"Poisson, mean {mean:g} ± 5%", f"{here:.1f}", f"{there:.1f}"])
    frame[...] = 1
    here = cost(lambda: prnu.multiply(frame, 0, 0, 0.01, KEY), frame.size)
    there = cost(lambda: 1 + np.float32(0.01) * rng.standard_normal(frame.shape, np.float32), frame.size)
    lines.append(["response of pixels (`PRNU_effect`)", f"{here:.1f}", f"{there:.1f}"])
    record.table("costs", ["CPU ns a pixel", "csstsim", "numpy"], lines)


if __name__ == "__main__":
    with Record(argparse.ArgumentParser(description=__doc__.splitlines()[0])) as record:
        main(record)
