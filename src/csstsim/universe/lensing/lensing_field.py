"""A Gaussian convergence and shear field on the whole sky; each brick can be computed independently.

Matter between z = 0 and z_max lies in shells, each with its own random potential (potential_field), and

    kappa(n, z_s) = sum_i w_i(z_s) kappa_i(n)          (Born approximation)

The amplitudes are fitted such that kappa_i has the shell's Limber spectrum of halofit.
Left out: everything beyond the two-point function (haloes, skewness), deflection, lens-lens coupling, rotation.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.optimize import nnls

from csstsim.base.types import FloatArray, IntArray
from csstsim.universe.lensing.cosmology import Cosmology
from csstsim.universe.lensing.lens_spectra import Shells, even_edges
from csstsim.universe.lensing.potential_field import PotentialField
from csstsim.universe.lensing.power_spectrum import MatterPower


class LensingField(PotentialField):
    """The lensing field of one campaign seed.

    cosmology_numbers, lensing_numbers: the mappings of config/universe/cosmology.yaml and lensing.yaml. Raises
    KeyError or ValueError for a number that is missing or out of range.
    """

    def __init__(self, seed: int, cosmology_numbers: Mapping[str, Any], lensing_numbers: Mapping[str, Any]) -> None:
        z_max = lensing_numbers["z_max"]
        count = lensing_numbers["shells"]
        l_max = lensing_numbers["l_max"]
        if not (0 < z_max <= 20 and 1 <= count <= 100 and 50 <= l_max <= 40000):
            raise ValueError("lensing: needs 0 < z_max <= 20, 1 <= shells <= 100 and 50 <= l_max <= 40000")
        cosmology = Cosmology(cosmology_numbers)
        shells = Shells(MatterPower(cosmology, cosmology_numbers), even_edges(cosmology, z_max, count), z_max)
        super().__init__(seed, shells, shells.count, l_max, "lensing")
        powers = self.powers(self.ell)
        ones = np.ones(len(self.ell))
        fits = [nnls(powers / spectrum[:, None], ones)[0] for spectrum in shells.spectra(self.ell)]
        self.amplitude = np.sqrt(fits)  # (shells, widths)

    def spectrum(self, ell: FloatArray | IntArray, z: float) -> FloatArray:
        """Return the C_l of kappa of the field, for sources at redshift z (float)."""
        weights = self.shells.weights(np.array([z]))[0]
        return np.einsum("i,is,ls->l", weights**2, self.amplitude**2, self.powers(ell))
