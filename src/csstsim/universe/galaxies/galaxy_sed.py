"""Spectra of galaxies: 20 coefficients on rest-frame components, redshifted and absorbed (paper, section 3.2.2).

    S(lambda) = scale x IGM(lambda, z) x 10^(-0.4 av k(lambda)) x max(0, sum_k c_k P_k(lambda / (1 + z)))

in photon / s / m2 / angstrom. The components P (config/universe/galaxy_spectra.fits; builder:
builders/build_galaxy_spectra.py) are sampled on 600-11000 A by 2.9 A and linear in between. They span mixtures of five
stellar populations and their emission lines behind a dust screen. Coefficients are linear in the masses of stars.
Negative sums of components, which occur where a spectrum is a thousand times fainter than usual, are set to zero.
"""

from collections.abc import Mapping
from typing import Any

import fitsio
import numba
import numpy as np
from numpy.typing import ArrayLike

from csstsim.base.errors import InputError
from csstsim.base.files.damage import reading
from csstsim.base.files.fits_headers import check_headers
from csstsim.base.types import FloatArray, Floats, PathLike
from csstsim.instrument.filter import GRID
from csstsim.universe.coefficients import COEFFICIENTS
from csstsim.universe.galaxies.galaxy_rates import Cells, integrate
from csstsim.universe.galaxies.igm import LYMAN_LIMIT, Intergalactic

TEN_PC_MPC = 1e-5
_JUMP = 3e-3  # change of A(lambda)/A(V) between two samples; a larger one marks where two pieces of the law meet
_LN_MAG = 0.4 * np.log(10.0)


class GalaxySeds:
    """Spectra of galaxies from (z, coefficients, scale, av); see the module.

    path: galaxy_spectra.fits; igm: numbers of igm.Intergalactic; extinction: k = A(lambda)/A(V) on GRID. Raises
    InputError for a file of another form.
    """

    def __init__(self, path: PathLike, igm: Mapping[str, Any], extinction: FloatArray) -> None:
        check_headers(path)
        with reading(path, "galaxies' spectra"), fitsio.FITS(path) as file:
            header = file[0].read_header()
            self.start = float(header["WAVE0"])
            self.step = float(header["DWAVE"])
            self.basis = file["BASIS"].read().astype(float)  # (20, samples)
            self._stars = file["STARS"].read().astype(float)
            self._lines = file["LINES"].read().astype(float)
            self._dust = file["DUST"].read().astype(float)
            templates = file["TEMPLATES"].read()
            self.templates = {name: templates[name].astype(float) for name in ("surviving", "metals", "m300")}
            fits_together = self.basis.ndim == 2 and self._stars.shape[2] == self.basis.shape[0] == COEFFICIENTS
        if not fits_together:
            raise InputError("wrong number of components", file=path, value=self.basis.shape[0], allowed=COEFFICIENTS)
        self.wavelength = self.start + self.step * np.arange(self.basis.shape[1])  # angstrom, rest frame
        self.extinction = np.asarray(extinction, dtype=float)
        self._cuts = np.flatnonzero(np.abs(np.diff(self.extinction)) > _JUMP) + 1
        self.igm = igm
        self.forest = Intergalactic(GRID, igm)
        self.cells = self._make_cells()

    def _make_cells(self) -> Cells:
        """Return the Cells of the components.

        The nodes are those of the basis, the edges of the forest's transmission, and more where it falls steeply.
        """
        steep_nodes = np.arange(LYMAN_LIMIT - 90, LYMAN_LIMIT, self.step / 4)
        nodes = np.union1d(self.wavelength, [LYMAN_LIMIT, *(line for line, _ in self.igm["lines"]), *steep_nodes])
        return Cells(nodes, np.array([np.interp(nodes, self.wavelength, row) for row in self.basis]))

    @staticmethod
    def depth(av: Floats) -> FloatArray:
        """Return the optical depth in V for A(V) [mag]."""
        return _LN_MAG * np.asarray(av, dtype=float)

    def coefficients(self, mix: FloatArray, dust: ArrayLike, lines: FloatArray) -> FloatArray:
        """Return (n, 20) coefficients of galaxies at 10 pc.

        mix: (n, 5) solar masses formed in each template; dust: (n,) A(V) [mag] of the galaxy's own dust, at most 3;
        lines: (n,) factor on the emission lines.
        """
        x = np.clip(np.asarray(dust, dtype=float), self._dust[0], self._dust[-1]) / (self._dust[1] - self._dust[0])
        mix = np.asarray(mix, dtype=float)
        return mixed(x, mix, mix * np.asarray(lines, dtype=float)[:, None], self._stars, self._lines)

    def metallicity(self, mix: FloatArray) -> FloatArray:
        """Return the mass fraction of metals (n,) in the living stars of mixtures (n, 5), as of `coefficients`."""
        living = np.asarray(mix, dtype=float) * self.templates["surviving"]
        return living @ self.templates["metals"] / living.sum(axis=1)

    def spectra(
        self,
        z: FloatArray,
        coefficients: FloatArray,
        scale: FloatArray,
        av: FloatArray,
        wavelength: FloatArray = GRID,
        igm: bool = True,
    ) -> FloatArray:
        """Return (n, len(wavelength)) spectra; z, scale and av [mag] (n,), coefficients (n, 20).

        `igm=False` leaves the intergalactic medium out.
        """
        out = np.zeros((len(z), len(wavelength)))
        forest = self.forest if wavelength is GRID else Intergalactic(wavelength, self.igm)
        curve = self.extinction if wavelength is GRID else np.interp(wavelength, GRID, self.extinction)
        nodes, basis = self.cells  # `rates` sets negative values at these nodes to zero
        for i, (redshift, mix) in enumerate(zip(np.asarray(z, dtype=float), coefficients, strict=True)):
            rest = np.maximum(np.einsum("k,kw->w", np.asarray(mix, dtype=float), basis), 0.0)
            out[i] = float(scale[i]) * np.interp(wavelength / (1 + redshift), nodes, rest, left=0.0)
            if igm:
                forest.absorb(out[i], redshift)
            out[i] *= np.exp(-_LN_MAG * float(av[i]) * curve)
        return out

    def rates(self, z: FloatArray, coefficients: FloatArray, av: FloatArray, weights: FloatArray) -> FloatArray:
        """Return (n, bands): int S w dlambda at unit scale, for `weights` (bands, 18001) on the paper's grid.

        The same as summing `spectra` over the grid, to 1e-4 (see galaxy_rates).
        """
        dust = self.depth(av)
        finite = dust[np.isfinite(dust)]
        mean_dust = (
            finite.mean() if len(finite) else 0.0
        )  # it is applied to the weights, because galaxies differ little from it
        weights = np.asarray(weights, dtype=float) * np.exp(-mean_dust * self.extinction)
        moments = np.zeros((len(weights), len(GRID) + 1, 3))
        for power in range(3):
            np.cumsum(weights * (GRID - GRID[0]) ** power, axis=1, out=moments[:, 1:, power])
        ranges = np.array([nonzero_range(row) for row in weights]).reshape(len(weights), 2)
        return integrate(
            np.asarray(z, dtype=float),
            np.ascontiguousarray(coefficients, dtype=float),
            dust - mean_dust,
            moments,
            ranges,
            self.cells,
            self.extinction,
            self._cuts,
            self.forest.tables,
        )


def distance_scale(luminosity_distance: Floats) -> FloatArray:
    """Return the factor from a galaxy's photon density at 10 pc to that at `luminosity_distance` [Mpc].

    S(lambda) = S_10(lambda / (1 + z)) (10 pc / d_L)^2: in photon density the factors (1 + z) from the stretched
    bandwidth and from the photon energy cancel.
    """
    return (TEN_PC_MPC / np.asarray(luminosity_distance, dtype=float)) ** 2


@numba.njit(cache=True)
def mixed(
    x: FloatArray, stars: FloatArray, lines: FloatArray, star_tables: FloatArray, line_tables: FloatArray
) -> FloatArray:
    """Return (n, k): tables (templates, dust, k), interpolated at x (n,) steps of dust, times masses (n, templates)."""
    out = np.zeros((len(x), star_tables.shape[2]))
    for g in range(len(x)):
        cell = min(int(x[g]), star_tables.shape[1] - 2)
        fraction = x[g] - cell
        for m in range(len(star_tables)):
            for tables, factor in ((star_tables[m], stars[g, m]), (line_tables[m], lines[g, m])):
                lower = tables[cell]
                upper = tables[cell + 1]
                for k in range(len(lower)):
                    out[g, k] += factor * (lower[k] * (1 - fraction) + upper[k] * fraction)
    return out


def nonzero_range(weights: FloatArray) -> tuple[int, int]:
    """Return the first sample of nonzero weights (samples,) and the one after the last."""
    used = np.flatnonzero(weights)
    return (used[0], used[-1] + 1) if len(used) else (0, 0)
