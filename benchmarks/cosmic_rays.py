"""Cosmic rays on chips of 150 s: pixels struck before and after diffusion, lengths, energies, cost, and a picture.

python benchmarks/cosmic_rays.py
"""

import argparse
import time

from evidence.record import Record

import matplotlib
import numpy as np

matplotlib.use("agg")
import matplotlib.pyplot as plt

from csstsim.base.rng import stream
from csstsim.base.shipped import SHIPPED
from csstsim.detector.cosmic_ray import deposit, draw_tracks
from csstsim.instrument.camera import load_camera

THRESHOLDS = np.array([1, 2, 5, 10, 20, 50, 100, 200, 500, 1000])  # e-
SIGMAS = (0.2, 0.4, 0.6)  # px; the first is that of the paper
SHOWN = (300, 300)
KEY = np.uint64(1)
CHIPS, EXPECTED = 8, 0.75  # permille of the pixels struck in 150 s, of the paper


def main(record: Record) -> None:
    """Draw the rays of a chip, count the pixels they strike, and draw the figure."""
    detector = load_camera(SHIPPED / "instrument").detector
    rays, shape = detector.cosmic_rays, (detector.ny, detector.nx)
    seconds = 150 + detector.readout_time / 2
    deposit((9, 9), draw_tracks((9, 9), 1e4, rays, stream(1, "compile")), 0.2, KEY)
    start = time.process_time()
    tracks = draw_tracks(shape, seconds, rays, stream(1, "benchmark"))
    found = deposit(shape, tracks, rays.diffusion, KEY)
    record.value("cpu", time.process_time() - start, "the rays of a whole chip", unit="CPU-s")
    record.value("tracks", found.hits, "tracks on a chip of 150 s")
    record.value("electrons", found.electrons.sum(), "electrons of all tracks", unit="e-")

    before = above(deposit(shape, tracks, 0.0, KEY).electrons)
    size = shape[0] * shape[1]
    after = {sigma: above(deposit(shape, tracks, sigma, KEY).electrons) for sigma in SIGMAS}
    chips = (draw_tracks(shape, seconds, rays, stream(1, "chips", k)) for k in range(2 if record.toy else CHIPS))
    struck = 1e3 / size * np.array([above(deposit(shape, each, 0.0, KEY).electrons)[0] for each in chips])
    mean, error = struck.mean(), struck.std() / np.sqrt(len(struck) - 1)
    what = f"pixels struck before diffusion, in {len(struck)} chips"
    near = abs(mean - EXPECTED) < 4 * error
    record.value("struck", mean, what, unit="permille", error=error, goal=bool(near))
    header = ["charge from [e-]", "before", *(f"{sigma} px{more}" for sigma in SIGMAS for more in ("", ": ratio"))]
    rows = [
        [threshold, f"{1e3 * before[i] / size:.3f}",
         *(cell for n in after.values() for cell in (f"{1e3 * n[i] / size:.3f}", f"{n[i] / before[i]:.2f}"))]
        for i, threshold in enumerate(THRESHOLDS)
    ]  # fmt: skip
    record.table("struck_by_charge", header, rows)
    picture(
        record.figure("cosmic_rays.png"),
        rays,
        seconds,
        draw_tracks(shape, (1 if record.toy else 100) * seconds, rays, stream(1, "shapes")),
        before,
        after,
    )


def above(electrons):
    return np.array([np.count_nonzero(electrons >= threshold) for threshold in THRESHOLDS])


def picture(path, rays, seconds, tracks, before, after):
    figure, axes = plt.subplots(2, 2, figsize=(9, 7.4))
    image, many = np.zeros(SHOWN, np.int32), draw_tracks(SHOWN, 20 * seconds, rays, stream(1, "picture"))
    pixel, electrons, _ = deposit(SHOWN, many, rays.diffusion, KEY)
    image.reshape(-1)[pixel] = electrons
    axes[0, 0].imshow(np.arcsinh(image), cmap="magma", origin="lower")
    axes[0, 0].set(title=f"{SHOWN[1]} x {SHOWN[0]} px, the rays of 20 exposures of 150 s", xlabel="px", ylabel="px")
    for sigma, counts in after.items():
        axes[0, 1].semilogx(THRESHOLDS, counts / before, "o-", ms=3, label=f"diffusion {sigma} px")
    axes[0, 1].set(title="pixels struck, after / before diffusion", xlabel="charge from [e-]", ylim=(0, None))
    axes[0, 1].axhspan(2, 3, color="0.9", label="paper's expectation")
    axes[0, 1].legend(fontsize=8)
    length, n = np.hypot(tracks.dx, tracks.dy), len(tracks.x)
    edges = np.arange(0, 102, 2.0)
    axes[1, 0].hist(length, edges, weights=np.full(n, 1 / n / 2), log=True, color="C0", label=f"{n} tracks")
    axes[1, 0].step([0, 20, 20, 100, 100], [0.95 / 20] * 2 + [0.05 / 80] * 2 + [1e-5], "k--", label="paper")
    axes[1, 0].set(xlabel="length [px]", ylabel="density [1/px]", ylim=(1e-4, 0.1))
    axes[1, 0].legend(fontsize=8)
    grid, sigma = np.linspace(2, 4.6, 105), 0.6 / np.sqrt(8 * np.log(2))
    axes[1, 1].hist(np.log10(tracks.electrons), grid, density=True, color="C0")
    density = np.exp(-0.5 * ((grid - 3.3) / sigma) ** 2) / sigma / np.sqrt(2 * np.pi)
    axes[1, 1].plot(grid, density, "k--", label="paper: N(3.3, FWHM 0.6)")
    axes[1, 1].set(xlabel="log10 of a track's electrons", ylabel="density")
    axes[1, 1].legend(fontsize=8)
    figure.tight_layout()
    figure.savefig(path, dpi=80)


if __name__ == "__main__":
    with Record(argparse.ArgumentParser(description=__doc__.splitlines()[0])) as record:
        main(record)
