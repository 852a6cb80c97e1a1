"""The figure of docs/clients.md: residuals of SCAMP's places, its distortion less the true one, the coadd's PSF."""

import matplotlib
import numpy as np

from client_codes.scamp import clipped_rms

matplotlib.use("Agg")
from matplotlib import pyplot as plt


def draw(path, judged, coadds):
    """Draw residuals {chip: judgements of its frames} and coadds {chip: results} as clients.py has them."""
    figure, axes = plt.subplots(1, 3 if coadds else 2, figsize=(13 if coadds else 8, 3.8), layout="constrained")
    east, north, snr = (
        np.concatenate([each[name] for found in judged.values() for each in found]) for name in ("dx", "dy", "snr")
    )
    points = axes[0].scatter(east, north, c=snr, s=4, cmap="viridis", vmin=20, vmax=200, rasterized=True)
    figure.colorbar(points, ax=axes[0], label="S/N", shrink=0.8)
    rms = [clipped_rms(v) for v in (east, north)]
    axes[0].set(
        xlim=(-8, 8), ylim=(-8, 8), aspect="equal", xlabel="east, SCAMP - truth [mas]", ylabel="north [mas]",
        title=f"{len(east)} places, rms {rms[0]:.2f}, {rms[1]:.2f} mas",
    )  # fmt: skip
    chip, found = next(iter(judged.items()))
    worst = max(found, key=lambda each: each["off"].max())["off"]
    shown = axes[1].imshow(1e3 * worst, origin="lower", extent=(0, 9.2, 0, 9.2), vmin=0, cmap="magma")
    figure.colorbar(shown, ax=axes[1], label="fit - true WCS [0.001 px]", shrink=0.8)
    axes[1].set(xlabel="x [1000 px]", ylabel="y [1000 px]", title=f"chip {chip}, its worst exposure")
    if coadds:
        chip, result = next(iter(coadds.items()))
        for (name, (width, *light)), mark in zip(result["psf"].items(), ("k--", "k-", "o"), strict=True):
            axes[2].plot((2, 3, 5), light, mark, label=f"{name}: FWHM {width:.2f} px")
        measured, expected = result["noise"]
        axes[2].set(
            xlabel="radius [px]", ylabel="light, of that within 6 px",
            title=f"coadd of chip {chip}, noise {measured / expected:.2f} of theory",
        )  # fmt: skip
        axes[2].legend(fontsize=8)
    figure.savefig(path, dpi=110)
    plt.close(figure)
