"""How many slabs per pixel a spectrum needs (render.slitless.slabs): the fewest whose error is allowed.

Light between slabs is assigned to them by cubic interpolation. The error is small where a spectrum is smooth over a few
pixels and large in lines. As a fraction of the object's S/N it is

    error = slabs_flat + roughness x slabs         (numbers of config/render.yaml, by slabs to a pixel)

where the roughness is the rms of the light about its running mean, 0 for a flat spectrum and 1 for a spectrum of only
lines of 2 angstrom. It is 0.01 for most stars and 0.2 for galaxies with emission lines.
"""

import numpy as np

from csstsim.base.types import BoolArray, FloatArray, Floats, IntArray
from csstsim.render.settings import load_numbers

_WIDTH = 13  # bins of the running mean: three pixels
_LINES = 0.77  # rms about the running mean of lines of 2 angstrom, over the rms of their light
_WEAK = 0.5  # fraction of the allowed error that an order weaker than the brightest may add


def roughness(light: FloatArray) -> FloatArray:
    """Return the roughness (n,), 0 to 1, of spectra (n, bins) [electrons]."""
    running = np.cumsum(np.pad(light, ((0, 0), (_WIDTH // 2 + 1, _WIDTH // 2))), axis=1)
    mean = (running[:, _WIDTH:] - running[:, :-_WIDTH]) / _WIDTH
    power = (light**2).sum(axis=1)
    rough = np.sqrt(((light - mean) ** 2).sum(axis=1) / np.where(power > 0, power, 1.0))
    return np.minimum(rough / _LINES, 1.0)


def fewest(rough: Floats, allowed: FloatArray) -> IntArray:
    """Return the fewest slabs per pixel whose error is allowed, else the largest number; arrays are broadcast."""
    error = load_numbers().error
    counts = sorted(error.slabs)
    wrong = [error.slabs_flat[count] + rough * error.slabs[count] > allowed for count in counts]
    return np.array(counts)[np.minimum(np.sum(wrong, axis=0), len(counts) - 1)]


def fewest_by_order(electrons: FloatArray, rough: FloatArray, short: BoolArray, allowed: FloatArray) -> IntArray:
    """Return (n, orders): the fewest slabs to a pixel of each order.

    electrons: (n, orders); rough, allowed: (n,); short: (orders,) bool, an order much shorter than the first, where
    even a flat spectrum is as narrow as a line.
    """
    maximum = electrons.max(axis=1, keepdims=True)
    fraction = np.where(maximum > 0, electrons / np.where(maximum > 0, maximum, 1.0), 0.0)
    limit = allowed[:, None] * np.where(fraction < 1, _WEAK, 1.0) / np.maximum(fraction, 1e-9)
    return fewest(np.where(short, 1.0, rough[:, None]), limit)
