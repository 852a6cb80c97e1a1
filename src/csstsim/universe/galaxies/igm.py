"""The intergalactic medium: mean absorption of the Lyman forest and the Lyman continuum (Madau 1995, ApJ 441, 18).

    tau(lambda, z) = sum_lines A_l (lambda / lambda_l)^p                        lambda < lambda_l (1 + z)
                   + sum_t C_t x^p_t ((1 + z)^q_t - x^q_t), x = lambda / 912    lambda < 912 (1 + z)

The four terms of the continuum, which include Lyman limit systems, are in Madau's footnote 3.

Left out: scatter between sight-lines, damped systems.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numba
import numpy as np

from csstsim.base.types import FloatArray

LYMAN_LIMIT = 912.0  # angstrom


class IgmTables(NamedTuple):
    """Optical depths at observed `wavelength` (w,) [A, rising], for kernels.

    edges (lines,): rest wavelengths [A], Lyman alpha first; depths (lines, w): A_l (lambda / lambda_l)^p; continuum
    (terms, w): C_t x^p_t; limits (w,): sum_t C_t x^(p_t + q_t); powers (terms,): q_t.
    """

    wavelength: FloatArray
    edges: FloatArray
    depths: FloatArray
    continuum: FloatArray
    limits: FloatArray
    powers: FloatArray


class Intergalactic:
    """Mean absorption by the intergalactic medium at observed wavelengths [A, rising]. `tables`: an IgmTables."""

    def __init__(self, wavelength: FloatArray, numbers: Mapping[str, Any]) -> None:
        wavelength = np.asarray(wavelength, dtype=float)
        lines = sorted(numbers["lines"], reverse=True)  # Lyman alpha first
        edges = np.array([line for line, _ in lines], dtype=float)
        depths = np.array(
            [numbers["tau_alpha"] * strength * (wavelength / line) ** numbers["power"] for line, strength in lines]
        )
        limit = wavelength / LYMAN_LIMIT
        factor, power, redshift_power = np.array(numbers["continuum"], dtype=float).T[:, :, None]
        continuum = factor * limit**power
        limits = (continuum * limit**redshift_power).sum(axis=0)
        self.tables = IgmTables(wavelength, edges, depths, continuum, limits, redshift_power[:, 0])

    def absorb(self, values: FloatArray, z: float) -> FloatArray:
        """Multiply `values`, one per wavelength, by the transmission towards redshift z, in place; return them."""
        absorb(values, 0, len(values), float(z), self.tables)
        return values


@numba.njit(cache=True)
def absorb(values: FloatArray, begin: int, end: int, z: float, tables: IgmTables) -> None:
    """Multiply values[begin:end], at the wavelengths of `tables`, by the transmission towards redshift z."""
    edges = tables.edges
    reach = (1.0 + z) ** tables.powers
    for i in range(begin, end):
        rest = tables.wavelength[i] / (1.0 + z)
        if not rest < edges[0]:
            break
        tau = 0.0
        for line in range(len(edges)):
            if rest < edges[line]:
                tau += tables.depths[line, i]
        if rest < LYMAN_LIMIT:
            tau += continuum_depth(i, reach, tables)
        values[i] *= np.exp(-tau)


@numba.njit(inline="always")
def continuum_depth(i: int, reach: FloatArray, tables: IgmTables) -> float:
    """Return the optical depth of the Lyman continuum at wavelength i; reach = (1 + z)^powers (terms,)."""
    tau = -tables.limits[i]
    for term in range(len(reach)):
        tau += tables.continuum[term, i] * reach[term]
    return max(tau, 0.0)
