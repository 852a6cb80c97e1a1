"""The intergalactic medium: mean absorption of the Lyman forest and the Lyman continuum (Madau 1995, ApJ 441, 18).

    tau(lambda, z) = sum_lines A_l (lambda / lambda_l)^p                        lambda < lambda_l (1 + z)
                   + C (lambda / 912)^3 ((1 + z)^0.46 - (lambda / 912)^0.46)    lambda < 912 (1 + z)

Left out: scatter between sight-lines, damped systems.
"""

import numba
import numpy as np

LYMAN_LIMIT = 912.0  # angstrom
CONTINUUM_POWER = 0.46  # of (1 + z) in the optical depth below the Lyman limit (Madau 1995, footnote 3)


class Intergalactic:
    """Mean absorption by the intergalactic medium at observed wavelengths [A, rising]."""

    def __init__(self, wavelength, numbers):
        wavelength = np.asarray(wavelength, dtype=float)
        lines = sorted(numbers["lines"], reverse=True)  # Lyman alpha first
        edges = np.array([line for line, _ in lines], dtype=float)
        depths = np.array([
            numbers["tau_alpha"] * strength * (wavelength / line) ** numbers["power"] for line, strength in lines
        ])  # fmt: skip
        limit = wavelength / LYMAN_LIMIT
        # What `absorb` needs, as plain arrays: kernels elsewhere take them too.
        self.arrays = (wavelength, edges, depths, numbers["continuum"] * limit**3, limit**CONTINUUM_POWER)

    def absorb(self, values, z):
        """Multiply `values`, one a wavelength, by the transmission towards redshift z, in place; return them."""
        absorb(values, 0, len(values), float(z), *self.arrays)
        return values


@numba.njit(cache=True)
def absorb(values, begin, end, z, wavelength, edges, depths, continuum, limits):
    """Multiply values[begin:end] by the transmission towards redshift z; arrays of Intergalactic."""
    reach = (1.0 + z) ** CONTINUUM_POWER
    for i in range(begin, end):
        rest = wavelength[i] / (1.0 + z)
        if not rest < edges[0]:
            break
        tau = 0.0
        for line in range(len(edges)):
            if rest < edges[line]:
                tau += depths[line, i]
        if rest < LYMAN_LIMIT:
            tau += max(continuum[i] * (reach - limits[i]), 0.0)
        values[i] *= np.exp(-tau)
