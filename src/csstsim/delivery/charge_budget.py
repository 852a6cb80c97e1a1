"""Compares the charge of an image with its truth: the electrons in the pixels are those that the simulation put there.

Charge is conserved: electrons of objects, sky, dark current, cosmic rays and defects reach the amplifiers, except those
that stayed in traps or bloomed out of the window. The truth table's metadata have this budget
(io.truth.electron_budget). DN become electrons by the image's own overscan and its header's gains and nonlinearity. DN
are integers, so each channel is a histogram, and a whole chip costs a second and some MB.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from csstsim.detector.cubic import linearise
from csstsim.measure.calibration.calibrate import overscan_level

if TYPE_CHECKING:
    from collections.abc import Iterator

    from csstsim.base.types import IntArray
    from csstsim.catalog.table import ObjectTable
    from csstsim.io.level0 import Level0

SIGMA = 6.0  # one in 1e9 sound files
# Fraction of all charge that the budget leaves out: electrons of pixels beyond a window in traps, charge that
# brighter-fatter moves over its edge, the curvature of the nonlinearity within the noise. Sound files have 2e-4.
UNBUDGETED = 1e-3
SUMS = 1e-5  # relative, of sums of single precision pixels against a table


@dataclass(frozen=True)
class Charge:
    """Electrons read from a window: their number, its standard error by readout and bias, and pixels clipped."""

    electrons: float
    error: float
    clipped: int
    clipped_at: float  # electrons, the minimum of the channels


def charge_of(file: Level0, full_well: float) -> Charge:
    """Return the Charge of an io.level0.Level0, overscans included, because trails end there. full_well: e-."""
    total = 0.0
    variance = 0.0
    clipped = 0
    clipped_at = np.inf
    top = int(file.header["SATURATE"])
    for block, channel in zip(file.readout.blocks, file.channels(), strict=True):
        counts = _histogram(channel.active)
        counts += _histogram(channel.serial_overscan)
        counts += _histogram(channel.parallel_overscan)
        gain = file.gain[channel.number]
        pixels = int(counts.sum())
        if channel.serial_overscan.size:
            level, scatter = overscan_level(channel.serial_overscan, from_right=block.flip_x)
            bias_weight = pixels / channel.serial_overscan.size
        else:  # layout `chip`: the levels that the file states
            level, noise = file.levels[channel.number]
            scatter = noise / gain
            bias_weight = 0.0
        used = np.union1d(np.flatnonzero(counts), top)
        nonlinearity = file.nonlinearity.get(channel.number, (0.0, 0.0))
        charge = linearise((used - level) * gain, *nonlinearity, full_well)
        total += float(counts[used] @ charge)
        noise = max(scatter, 12**-0.5) * gain
        variance += noise**2 * pixels * (1 + bias_weight)
        clipped += int(counts[top:].sum())
        clipped_at = min(clipped_at, float(charge[np.searchsorted(used, top)]))
    return Charge(total, variance**0.5, clipped, clipped_at)


def _histogram(pixels: IntArray) -> IntArray:
    """Return (65536,) the number of pixels of each DN."""
    return np.bincount(pixels.reshape(-1), minlength=1 << 16)


def charge_faults(file: Level0, truth: ObjectTable) -> Iterator[str]:
    """Yield where a Level-0 file and its truth (read_truth's table, with the budget in `meta`) disagree."""
    budget = truth.meta["electrons"]
    full_well = truth.meta["full_well"]
    drawn = float(np.sum(truth["drawn"])) if "drawn" in truth else 0.0
    if abs(drawn - budget["objects"]) > 1 + SUMS * budget["objects"]:
        yield f"its objects sum to {drawn:.6g} electrons drawn; the image was given {budget['objects']:.6g}"
    arrived = sum(budget[name] for name in ("light", "dark", "rays", "defects"))
    expected = arrived - budget["trapped"] - budget.get("bloomed", 0.0)
    charge = charge_of(file, full_well)
    poisson = max(budget["light"] + budget["dark"], 0.0)
    tolerance = (
        SIGMA * (charge.error**2 + poisson) ** 0.5 + UNBUDGETED * abs(expected) + budget.get("bias_structure", 0)
    )
    clipped_charge = 0.0  # charge that clipped pixels may have beyond the converter's range
    if charge.clipped:
        clipped_charge = charge.clipped * max(full_well - charge.clipped_at, 0.0) if "bloomed" in budget else np.inf
    if not -tolerance - clipped_charge <= charge.electrons - expected <= tolerance:
        yield (
            f"the image holds {charge.electrons:.6g} electrons; its truth, sky, dark current and rays make "
            f"{expected:.6g} +- {tolerance:.2g}"
        )
