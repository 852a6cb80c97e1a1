"""Variable quasars: a damped random walk (Kelly, Bechtold & Siemiginowska 2009; MacLeod et al. 2010).

The walk m(t) has the covariance SF^2 / 2 exp(-|dt| / tau). Its steps, one per day since the file's `start`, depend only
on the campaign's seed and the quasar's id, so the curve does not depend on the order of epochs. It is linear between
days, and constant before the start. In each band the same steps are scaled by that band's SF and damped by its tau. The
damping time is stretched by 1 + z.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from csstsim.base.rng import stream
from csstsim.base.types import AnyArray, FloatArray

PIVOT = 4000.0  # angstrom
MASS = 1e9  # solar masses


def quasar_changes(
    seed: int,
    table: Mapping[str, AnyArray],
    mjd: Sequence[float] | FloatArray,
    wavelength: float,
    numbers: Mapping[str, Any],
) -> FloatArray:
    """Return (n, times) mag by which quasars are fainter than on average at MJDs (times,), at a wavelength [angstrom].

    table: ids, z, coeff0 (M1450) of quasars.
    """
    from scipy.signal import lfilter

    z = table["z"].astype(float)
    m1450 = table["coeff0"].astype(float)
    days = np.maximum(np.asarray(mjd, float) - numbers["start"], 0.0)
    steps = int(days.max(initial=0.0)) + 2
    out = np.zeros((len(z), len(days)))
    for i, number in enumerate(table["id"].tolist()):
        normal = stream(seed, "quasar light", number).standard_normal(steps + 1)
        scatter, tau = walk_parameters(z[i], m1450[i], normal[0], wavelength, numbers)
        damping = np.exp(-1.0 / (tau * (1 + z[i])))
        normal[1] /= np.sqrt(1 - damping**2)  # the stationary state
        curve = scatter * np.sqrt(1 - damping**2) * lfilter([1.0], [1.0, -damping], normal[1:])
        out[i] = np.interp(days, np.arange(steps), curve)
    return out


def walk_parameters(
    z: float, m1450: float, normal: float, wavelength: float, numbers: Mapping[str, Any]
) -> tuple[float, float]:
    """Return rms [mag] and damping time [day, rest frame] of a quasar; normal: standard normal deviate of its mass."""
    m_i = m1450 + numbers["walk"]["shift"]
    mean_0, mean_slope = numbers["mass"]["mean"]
    width_0, width_slope = numbers["mass"]["width"]
    mean = mean_0 + mean_slope * m_i
    width = width_0 + width_slope * m_i
    log_mass = mean + max(width, 0.0) * normal - np.log10(MASS)
    terms = np.array([1.0, np.log10(wavelength / (1 + z) / PIVOT), m_i + 23.0, log_mass])
    structure = 10.0 ** (np.array(numbers["walk"]["structure"]) @ terms)
    tau = 10.0 ** (np.array(numbers["walk"]["time"]) @ terms)
    return structure / np.sqrt(2.0), tau
