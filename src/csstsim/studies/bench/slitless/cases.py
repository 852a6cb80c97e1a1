"""The objects of the slitless benchmark: those of imaging (bench.imaging.cases), each with one of these spectra in turn

    flat   N
    hot    N ~ lambda^-3, the Rayleigh-Jeans side of a black body
    cool   N ~ lambda^-4 / (exp(h c / lambda k T) - 1), 3500 K
    lines  a tenth of the photons flat, the rest in three Gaussian lines of 2 angstrom (sigma) at random wavelengths

with N photons / s / m2 / angstrom. `electrons` are those of the first order; the window has its trace and a margin.
Objects are not near the line between the two gratings.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Self, cast

import numpy as np

from csstsim.base.types import FloatArray, IntArray
from csstsim.base.units import C_A_S, H_J_S
from csstsim.instrument.chip import Window
from csstsim.instrument.filter import GRID
from csstsim.render.scene import make_scene
from csstsim.studies.bench.imaging.cases import Case, Shape, half_of, make_cases, make_row, position
from csstsim.studies.bench.setting import disperser_of

if TYPE_CHECKING:
    from csstsim.optics.gratings.dispersion import Disperser
    from csstsim.render.scene import Scene
    from csstsim.studies.bench.setting import Setting

SPECTRA = ("flat", "hot", "cool", "lines")
LINES = 3
SIGMA_A = 2.0
CONTINUUM = 0.1
LARGEST = 0.5  # arcsec, half-light radius: stamps of larger bright bulges take minutes
HALF_MAX = 96  # px
FROM_SPLIT = 400  # px: minimum distance from the line between the gratings
_COOL = H_J_S * C_A_S / (1.380649e-23 * 3500.0)  # h c / k T [angstrom]


@dataclass(frozen=True, eq=False)
class SpectrumCase(Case):
    """One object with a spectrum, alone on the window of its first order."""

    spectrum: str  # of SPECTRA
    density: FloatArray  # photon / m2 / angstrom of the exposure, on filter.GRID
    binned_density: FloatArray  # (bins,) means over the Disperser's bins
    lines: FloatArray  # angstrom, centres of the spectrum's lines, the brightest first
    visits: IntArray  # (1, 3) of Disperser.visits

    def about(self) -> dict[str, Any]:
        """Return {column: value} that describe the object and name its spectrum."""
        return super().about() | {"spectrum": self.spectrum}

    def brighter(self, electrons: float) -> Self:
        """Return the same object with another number of electrons."""
        factor = electrons / self.electrons
        case = super().brighter(electrons)
        return replace(case, density=self.density * factor, binned_density=self.binned_density * factor)


def make_spectrum_cases(setting: Setting, count: int, seed: int = 1, largest: float = LARGEST) -> list[SpectrumCase]:
    """Return `count` SpectrumCases, half of them stars; no half-light radius is above `largest` [arcsec]."""
    cases = make_cases(setting, count, seed, min(largest, LARGEST), make_spectrum_case)
    return cast(list[SpectrumCase], cases)  # all by make_spectrum_case


def make_spectrum_case(
    setting: Setting,
    rng: np.random.Generator,
    i: int,
    electrons: float,
    bulge: float = 0.0,
    size: float = 0.0,
    e: float = 0.0,
    spectrum: str | None = None,
) -> SpectrumCase:
    """Return the SpectrumCase of a galaxy of `size` [arcsec], or of a star if it is 0; even `i` are at a node."""
    disperser = disperser_of(setting)
    spectrum = spectrum or SPECTRA[i // 2 % len(SPECTRA)]
    at_node = i % 2 == 0
    at = position(setting, rng, at_node)
    while abs(at.x - disperser.gratings.split) < FROM_SPLIT:
        at = position(setting, rng, at_node)
    density, lines = density_of(spectrum, rng, disperser)
    grating = int(at.x > disperser.gratings.split)
    binned_density = means(density, disperser.edges)
    first_order = binned_density * disperser.rates[grating, disperser.orders.index(1)]
    factor = electrons / first_order.sum()
    fractions = disperser.psf_weights @ first_order / first_order.sum()
    table = make_row(setting, rng, i, at, Shape(electrons, bulge, size, e), fractions)
    scene = make_scene(table, setting.wcs, setting.psf, setting.exptime)
    visits = np.array([[0, grating, 0]])
    window = trace_window(disperser, visits, scene, half_of(table, HALF_MAX))
    return SpectrumCase(
        table, scene, window, electrons, at_node, spectrum, density * factor, binned_density * factor, lines, visits
    )


def means(density: FloatArray, edges: FloatArray) -> FloatArray:
    """Return the (bins,) means of a density on filter.GRID over bins whose edges [angstrom] are on it."""
    running = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1])) * (GRID[1] - GRID[0])])
    return np.diff(running[np.searchsorted(GRID, edges)]) / np.diff(edges)


def trace_window(disperser: Disperser, visits: IntArray, scene: Scene, half: int) -> Window:
    """Return the Window of the first order of a Scene's one object, and of `half` px around it."""
    x0, x1, y0, y1 = disperser.boxes(visits, scene.x, scene.y)[0, disperser.orders.index(1)].tolist()
    middle = round(0.5 * (y0 + y1))
    return Window(round(x0) - half, round(x1) + half + 1, middle - half, middle + half + 1)


def density_of(spectrum: str, rng: np.random.Generator, disperser: Disperser) -> tuple[FloatArray, FloatArray]:
    """Return (density on GRID in arbitrary units, centres of its lines [angstrom])."""
    wave = GRID / 5000.0
    if spectrum == "flat":
        return np.ones(len(GRID)), np.empty(0)
    if spectrum == "hot":
        return wave**-3, np.empty(0)
    if spectrum == "cool":
        return wave**-4 / np.expm1(_COOL / GRID), np.empty(0)
    low, high = disperser.wavelengths[[0, -1]]
    centres = rng.uniform(low, high, LINES)
    fractions = np.arange(LINES, 0, -1) / np.arange(1, LINES + 1).sum()
    shapes = np.exp(-0.5 * ((GRID - centres[:, None]) / SIGMA_A) ** 2) / (SIGMA_A * np.sqrt(2 * np.pi))
    return CONTINUUM / (high - low) + (1 - CONTINUUM) * fractions @ shapes, centres
