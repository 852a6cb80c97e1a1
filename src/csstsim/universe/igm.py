"""The intergalactic medium: mean absorption of the Lyman forest and the Lyman continuum (after Madau 1995)."""

import numpy as np

LYMAN_LIMIT = 912.0  # angstrom
_CONTINUUM_POWER = 0.46  # of (1 + z) in the optical depth below the Lyman limit (Madau 1995, footnote 3)


class Intergalactic:
    """Mean absorption by the intergalactic medium at observed wavelengths [A, rising]."""

    def __init__(self, wavelength, numbers):
        self._wave = wavelength
        self._lines = [
            (line, numbers["tau_alpha"] * strength * (wavelength / line) ** numbers["power"])
            for line, strength in numbers["lines"]
        ]
        # Lyman continuum: absorbers between where this wavelength meets the limit and the source.
        limit = wavelength / LYMAN_LIMIT
        self._continuum = numbers["continuum"] * limit**3
        self._limit_power = limit**_CONTINUUM_POWER

    def absorb(self, values, z):
        """Multiply `values`, one a wavelength, by the transmission towards redshift z, in place; return them."""
        blue = np.searchsorted(self._wave, max(line for line, _ in self._lines) * (1 + z))
        if blue == 0:
            return values
        tau = np.zeros(blue)
        for line, optical_depth in self._lines:
            end = min(np.searchsorted(self._wave, line * (1 + z)), blue)
            tau[:end] += optical_depth[:end]
        end = min(np.searchsorted(self._wave, LYMAN_LIMIT * (1 + z)), blue)
        tau[:end] += self._continuum[:end] * ((1 + z) ** _CONTINUUM_POWER - self._limit_power[:end])
        values[:blue] *= np.exp(-tau)
        return values
