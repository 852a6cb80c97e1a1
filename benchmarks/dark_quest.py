"""Mean shear about haloes in the Dark Quest simulations, by their emulator (Nishimichi et al. 2019, ApJ 884, 29).

The package `dark_emulator` (pip install dark_emulator george colossus) asks scipy for names that newer ones have not.
"""

import contextlib
import io

import numpy as np


def emulator(numbers):
    """Return the emulator for the numbers of cosmology.yaml, or None if it is not installed."""
    import scipy.integrate
    import scipy.misc

    scipy.misc.derivative = lambda f, x, dx=1e-4, args=(): (f(x + dx, *args) - f(x - dx, *args)) / (2 * dx)
    scipy.integrate.simps, scipy.integrate.trapz = scipy.integrate.simpson, scipy.integrate.trapezoid
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            from dark_emulator import darkemu

            found = darkemu.base_class()
    except ImportError:
        return None
    h = numbers["h0"] / 100
    baryons, neutrinos = numbers["omega_b"] * h**2, 0.00064
    matter = numbers["omega_m"] * h**2 - baryons - neutrinos
    amplitude = 3.047
    for _ in range(3):  # ln(1e10 A_s) that gives sigma_8
        found.set_cosmology(np.array([baryons, matter, numbers["omega_lambda"], amplitude, numbers["n_s"], -1.0]))
        amplitude += 2 * np.log(numbers["sigma_8"] / found.get_sigma8())
    return found


def delta_sigma(emulated, mass, z, radius, h):
    """Return Delta Sigma [solar mass / Mpc^2, comoving] at `radius` [Mpc] of haloes of `mass` [solar]."""
    return 1e12 * h * emulated.get_DeltaSigma_mass(np.asarray(radius) * h, mass * h, z)
