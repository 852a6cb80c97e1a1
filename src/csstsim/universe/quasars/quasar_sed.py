"""Spectra of quasars: a broken power law with Gaussian emission lines, redshifted and absorbed (paper, section 3.2.1).

    S(lambda) = scale C(w) (1 + sum_i W_i G(w; w_i, sigma_i)) IGM(lambda, z) 10^(-0.4 A(V) k(lambda)),  w = lambda/(1+z)

in photon / s / m2 / angstrom. C is the continuum, f_nu ~ nu^slope in pieces, with AB magnitude 0 at 1450 A rest for
scale 1; G is a Gaussian of unit area, so W_i is the line's rest equivalent width, which falls with luminosity
(Baldwin effect) and varies by family of lines. The coefficients hold the parameters of one quasar:

    0: M1450;  1..4: slope minus the mean slope, by piece;  5...: log10 of the strength of each family of lines

The form is that of simqso (McGreer, Moustakas & Schindler 2021, ascl:2106.008). Left out: single absorption lines,
broad absorption troughs, dust of the host, variability, asymmetric lines.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from csstsim.base.types import FloatArray
from csstsim.base.units import ab_photon_density
from csstsim.instrument.filter import GRID
from csstsim.universe.coefficients import COEFFICIENTS
from csstsim.universe.galaxies.igm import Intergalactic

NORM = 1450.0  # angstrom, rest: where a quasar's absolute magnitude is given
_LINE_REACH = 6.0  # sigma; 1e-9 of a line's flux is beyond
_CHUNK = 64  # spectra in memory at a time: 64 x 18,001 samples are 9 MB


class _Line(NamedTuple):
    """An emission line: centre, rest equivalent width and sigma [angstrom], and the index of its family."""

    centre: float
    width: float
    sigma: float
    family: int


class QuasarSeds:
    """Spectra of quasars from (z, coefficients, scale, av); see the module.

    numbers: config/universe/quasars.yaml; igm_numbers: those of igm.Intergalactic; extinction_curve: A(lambda)/A(V)
    on the paper's grid, (18001,). Raises KeyError, TypeError or ValueError for invalid numbers.
    """

    def __init__(
        self, numbers: Mapping[str, Any], igm_numbers: Mapping[str, Any], extinction_curve: FloatArray
    ) -> None:
        self._igm_numbers = igm_numbers
        self._extinction_curve = np.asarray(extinction_curve, dtype=float)
        continuum = numbers["continuum"]
        self._breaks = np.array([0.0, *continuum["breaks"], np.inf])
        self._slopes = np.array(continuum["slopes"], dtype=float)
        if len(self._slopes) != len(self._breaks) - 1 or (np.diff(self._breaks) <= 0).any():
            raise ValueError("quasars.continuum: one slope more than breaks, breaks rising")
        self._m1450 = numbers["families"]["m1450"]
        self.families = {name: part for name, part in numbers["families"].items() if name != "m1450"}
        self.first_family = 1 + len(self._slopes)
        if self.first_family + len(self.families) > COEFFICIENTS:
            raise ValueError(f"quasars.families: at most {COEFFICIENTS - self.first_family}")
        names = list(self.families)
        rows = [*numbers["lines"]["table"], *numbers["small_blue_bump"]["table"]]
        self._lines = [_Line(float(w), float(ew), float(sigma), names.index(name)) for w, ew, sigma, name in rows]

    def spectra(
        self, z: FloatArray, coefficients: FloatArray, scale: FloatArray, av: FloatArray, wavelength: FloatArray = GRID
    ) -> FloatArray:
        """Return (n, len(wavelength)) photon / s / m2 / angstrom.

        z, scale, av (n,); coefficients (n, 20); wavelength [A], rising. Beyond the paper's grid the extinction curve is
        constant.
        """
        wavelength = np.asarray(wavelength, dtype=float)
        igm = Intergalactic(wavelength, self._igm_numbers)
        curve = -0.4 * np.log(10) * np.interp(wavelength, GRID, self._extinction_curve)
        out = np.empty((len(z), len(wavelength)))
        for i, (redshift, quasar) in enumerate(zip(np.asarray(z, dtype=float), coefficients, strict=True)):
            quasar = np.asarray(quasar, dtype=float)
            rest = wavelength / (1 + redshift)
            out[i] = self._continuum(rest, quasar) * self._emission(rest, quasar) / (1 + redshift)
            igm.absorb(out[i], redshift)
            out[i] *= float(scale[i]) * np.exp(float(av[i]) * curve)
        return out

    def rates(self, z: FloatArray, coefficients: FloatArray, av: FloatArray, weights: FloatArray) -> FloatArray:
        """Return (n, bands): int S w dlambda at scale 1, for `weights` (bands, 18001) on the paper's grid."""
        used = np.flatnonzero(np.any(weights, axis=0))
        band = slice(used[0], used[-1] + 1) if len(used) else slice(0, 0)
        total = np.zeros((len(z), len(weights)))
        for start in range(0, len(z), _CHUNK):
            chunk = slice(start, start + _CHUNK)
            one = np.ones(len(z[chunk]))
            seds = self.spectra(z[chunk], coefficients[chunk], one, av[chunk], GRID[band])
            # einsum, not a BLAS product: the same bits for any number of threads
            total[chunk] = np.einsum("nw,bw->nb", seds, weights[:, band])
        return total

    def widths(self, coefficients: FloatArray) -> FloatArray:
        """Return the rest equivalent width [A] of each line of one quasar, in the order of the tables."""
        parameters = np.asarray(coefficients, dtype=float)
        luminosity = -0.4 * (parameters[0] - self._m1450)  # dex
        factor = [
            part["strength"] * 10 ** (part["baldwin"] * luminosity + parameters[self.first_family + k])
            for k, part in enumerate(self.families.values())
        ]
        return np.array([line.width * factor[line.family] for line in self._lines])

    def _continuum(self, rest: FloatArray, parameters: FloatArray) -> FloatArray:
        """Return the photon density [photon / s / m2 / A of rest wavelength]; AB 0 at 1450 A."""
        ln_wave = np.log(rest)
        ln_breaks = np.log(self._breaks[1:-1])
        slopes = self._slopes + parameters[1 : self.first_family]
        # ln f_nu falls by slope x d ln(lambda): first its value at each break, then along the piece from there
        pivot = np.searchsorted(ln_breaks, np.log(NORM))
        knots = np.concatenate([ln_breaks[:pivot], [np.log(NORM)], ln_breaks[pivot:]])
        all_slopes = np.insert(slopes, pivot, slopes[pivot])
        steps = -all_slopes[1:-1] * np.diff(knots)
        value = np.concatenate([[0.0], np.cumsum(steps)])
        value -= value[pivot]
        piece = np.searchsorted(knots, ln_wave)
        anchor = np.maximum(piece - 1, 0)
        ln_f = value[anchor] - all_slopes[piece] * (ln_wave - knots[anchor])
        return np.exp(ln_f) * ab_photon_density(rest)

    def _emission(self, rest: FloatArray, parameters: FloatArray) -> FloatArray:
        """Return 1 plus the lines, in units of the continuum."""
        out = np.ones_like(rest)
        for line, width in zip(self._lines, self.widths(parameters), strict=True):
            reach = _LINE_REACH * line.sigma
            near = slice(*np.searchsorted(rest, (line.centre - reach, line.centre + reach)))
            offset = (rest[near] - line.centre) / line.sigma
            out[near] += width / (line.sigma * np.sqrt(2 * np.pi)) * np.exp(-0.5 * offset**2)
        return out
