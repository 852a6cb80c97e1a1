"""The figure of benchmarks/calibration_stacks.py."""

import matplotlib
import numpy as np
from stack_reduction import estimate

matplotlib.use("agg")
from matplotlib import pyplot as plt


def draw(rows, found, area, path):
    """Draw found minus configured values, the photon transfer, the trail."""
    figure = plt.figure(figsize=(12, 8), layout="constrained")
    grid = figure.add_gridspec(3, 12)
    names = [name for name in dict.fromkeys(row.quantity for row in rows if row.channel != "all" and row.error)]
    names = [name for name in names if name not in ("read noise, overscan", "nonlinearity, cubic", "bias, active")]
    for place, name in enumerate(names):
        axis = figure.add_subplot(grid[place // 4, 3 * (place % 4) : 3 * (place % 4) + 3])
        mine = [row for row in rows if row.quantity == name]
        off = [row.found - row.configured for row in mine]
        axis.axhline(0, color="k", lw=0.8)
        axis.errorbar([row.channel for row in mine], off, [row.error for row in mine], fmt="o", ms=3, lw=1)
        middle = np.mean([row.configured for row in mine])
        axis.set_title(f"{name}: {middle:.4g} {mine[0].unit}", fontsize=9)
        axis.tick_params(labelsize=7)
        axis.set_xticks([1, 4, 8, 12, 16])
        axis.set_xlabel("channel", fontsize=7)
        axis.set_ylabel(f"found - configured [{mine[0].unit}]" if mine[0].unit else "found - configured", fontsize=7)
    axes = [figure.add_subplot(grid[2, 4 * k : 4 * k + 4]) for k in range(3)]
    draw_transfer(axes[:2], rows, found, area)
    draw_trail(axes[2], found)
    figure.savefig(path, dpi=80)


def draw_transfer(axes, rows, found, area):
    """Draw variance against mean of all channels, and its ratio to the line of the configured gain."""
    gains = [row.configured for row in rows if row.quantity == "gain"]
    for f, gain in zip(found, gains, strict=True):
        axes[0].plot(f["level"], f["variance"], ".", ms=3)
        axes[1].plot(f["level"] * gain, f["variance"] * gain / f["level"], ".", ms=3)
    mean, gain = np.linspace(0, 1.05 * found[0]["level"].max(), 100), np.mean(gains)
    axes[0].plot(mean, mean / gain, "k", lw=0.8, label=f"mean / {gain:.3f}, configured")
    left = estimate.deficit(area, mean * gain)
    axes[0].plot(mean, mean / gain * left, "k--", lw=0.8, label="with the brighter-fatter effect, fitted")
    axes[1].axhline(1, color="k", lw=0.8)
    axes[1].plot(mean * gain, left, "k--", lw=0.8)
    axes[0].set(
        xlabel="mean, linearised [DN]", ylabel="variance of a frame [DN$^2$]", title="photon transfer, 16 channels"
    )
    axes[1].set(xlabel="mean [e-]", ylabel="variance x configured gain / mean", title="the same over the line")
    axes[0].legend(fontsize=7)
    for axis in axes:
        small(axis)


def draw_trail(axis, found):
    """Draw the parallel overscan behind the flats, mean of all channels."""
    seen = np.mean([f["trail"] * f["gain"] for f in found], axis=0)
    number = np.arange(1, len(seen) + 1)
    axis.plot(number, seen, ".", ms=4, label="found, mean of the channels")
    axis.plot(
        number, np.mean([f["trail wanted"] for f in found], axis=0), "k", lw=0.8, label="from the traps' densities"
    )
    axis.set(xlabel="row of the parallel overscan", ylabel="electrons", title="trail behind the flats")
    axis.legend(fontsize=7)
    small(axis)


def small(axis):
    axis.title.set_fontsize(9)
    for label in (axis.xaxis.label, axis.yaxis.label):
        label.set_fontsize(8)
    axis.tick_params(labelsize=7)
