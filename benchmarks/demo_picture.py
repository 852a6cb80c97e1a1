"""Make docs/figures/demo.png, the README's picture, from the finished demo (make run).

    python benchmarks/demo_picture.py

Left: g, r, i of the first position angle, resampled (nearest pixel) to the r exposure's pixels on the sky, with asinh
stretch; defects and cosmic rays are filled as by `measure`. Right: the windowed r-band readout, with the four channels'
bias, gain, prescan and overscan.
"""

import argparse
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from csstsim.campaign.opened import OpenCampaign
from csstsim.io.level0 import read_level0
from csstsim.measure.bad_pixels import mend
from csstsim.measure.photometry import psf_model
from csstsim.stages.calibrate import calibrated_frame
from csstsim.stages.psf import open_psf

ROOT = Path(__file__).parents[1]
TARGET = ROOT / "docs" / "figures" / "demo.png"
SIDE = 1300  # px of the field shown


def electrons(run, job):
    """Return a job's calibrated image less its median, electrons / s, with defects and cosmic rays filled."""
    _, calibrated = calibrated_frame(run, job)
    image = calibrated.electrons
    mend(calibrated, psf_model(open_psf(run, job.chip), (job.window.x0, job.window.y0), image.shape))
    return (image - np.median(image)) / job.pointing.exptime


def main():
    run = OpenCampaign(ROOT / "config" / "campaign.yaml", ROOT / "results" / "demo")
    jobs = {job.chip.filter: job for job in reversed(run.imaging_jobs)}
    base = jobs["r"]
    mid_x, mid_y = (base.window.x0 + base.window.x1) / 2, (base.window.y0 + base.window.y1) / 2
    grid = np.arange(SIDE) - SIDE / 2
    x, y = np.meshgrid(mid_x + grid, mid_y + grid)
    sky = base.wcs.pixel_to_world(x, y)
    planes = []
    for band, weight in (("i", 1.0), ("r", 0.9), ("g", 1.1)):
        job, image = jobs[band], electrons(run, jobs[band])
        px, py = (np.rint(v).astype(int) for v in job.wcs.world_to_pixel(*sky))
        inside = job.window.contains(px, py)
        plane = np.zeros_like(x)
        plane[inside] = image[py[inside] - job.window.y0, px[inside] - job.window.x0]
        planes.append(weight * plane)
    rgb = np.arcsinh(np.stack(planes, axis=-1) / 0.04) / np.arcsinh(60.0)
    figure = Figure(figsize=(12, 6.4), layout="constrained")
    left, right = figure.subplots(1, 2)
    left.imshow(np.clip(rgb + 0.04, 0, 1), origin="lower", extent=np.array([0, SIDE, 0, SIDE]) * 0.074 / 60)
    left.set(title="g, r, i: three exposures of 150 s", xlabel="arcmin", ylabel="arcmin")
    file = read_level0(run.paths.level0(base.pointing, base.chip.id))
    part = file.frame().astype(float)
    shown = right.imshow(
        part, origin="lower", cmap="gray", vmin=np.percentile(part, 0.5) - 5, vmax=np.percentile(part, 99) + 15,
        interpolation="antialiased",
    )  # fmt: skip
    right.set(title="the r readout: four channels, prescan, overscan", xlabel="column read", ylabel="row read")
    figure.colorbar(shown, ax=right, label="DN", shrink=0.8)
    TARGET.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(TARGET, dpi=80)
    print(TARGET)


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    main()
