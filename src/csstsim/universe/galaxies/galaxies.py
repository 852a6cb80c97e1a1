"""Galaxies of the embedded universe: redshift, mass and type from mass functions, all other properties from these.

(z, M, type) -> star-formation rate -> mixture of templates, dust, lines -> i magnitude of the physical mass-to-light
ratio -> i + shift(i), a small monotone change that makes the i counts exactly those of `counts` (abundance matching:
mass functions stay as published, magnitudes are shifted, colours do not change). Each quantity has its own random
stream, so a change of one does not affect the others. universe.galaxies.clustered draws positions in haloes. Left out:
merging, spiral arms.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from csstsim.base.types import AnyArray, FloatArray, IntArray
from csstsim.universe.galaxies.band_rates import BandRates
from csstsim.universe.galaxies.galaxy_sed import distance_scale
from csstsim.universe.galaxies.galaxy_shapes import (
    bulge_fraction,
    bulge_radius,
    disk_radius,
    draw_ellipticity,
    equal_area,
    to_arcsec,
    velocity_dispersion,
)
from csstsim.universe.galaxies.mass_function import TYPES, MassGrid, mass_function
from csstsim.universe.galaxies.star_formation import (
    attenuation,
    cosmic_age,
    main_sequence,
    mean_age,
    mixture,
    young_fractions,
)

if TYPE_CHECKING:
    from csstsim.universe.galaxies.galaxy_sed import GalaxySeds
    from csstsim.universe.lensing.cosmology import Cosmology

ARCMIN2_PER_DEG2 = 3600.0
YR_PER_GYR = 1e9
QUIESCENT = 1
_STEP = 0.01  # mag, of the cumulative counts


def cumulative_counts(numbers: Mapping[str, Any]) -> tuple[FloatArray, FloatArray]:
    """Return i and N(<i) [deg-2], each (n,), from the brightest tabulated magnitude to the limit for `density`."""
    knots = np.asarray(numbers["counts"], dtype=float)
    target = numbers["density"] * ARCMIN2_PER_DEG2
    mag = np.arange(knots[0, 0], knots[-1, 0] + 20.0, _STEP)
    log = np.interp(mag, knots[:, 0], np.log10(knots[:, 1]))
    log += numbers["faint_slope"] * np.maximum(mag - knots[-1, 0], 0.0)
    counts = 10**log
    total = np.concatenate([[0.0], np.cumsum(0.5 * (counts[1:] + counts[:-1]) * _STEP)])
    total += counts[0] / _bright_slope(knots)  # brighter than the table: extrapolated with its first slope
    if not total[0] < target < total[-1]:
        raise ValueError(f"galaxies.density {numbers['density']} arcmin-2 is not reached by the counts")
    end = np.searchsorted(total, target)
    limit = np.interp(target, total, mag)
    return np.append(mag[:end], limit), np.append(total[:end], target)


def try_laws(numbers: Mapping[str, Any], cosmology: Cosmology) -> None:
    """Evaluate the laws for one galaxy. Raises KeyError, TypeError or ValueError for a missing or wrong number."""
    one = np.array([10.0])
    size = numbers["size"]
    for kind in TYPES:
        mass_function(one, 1.0, kind, numbers["mass_function"], cosmology.h0)
    main_sequence(one, 1.0, numbers["star_formation"]), attenuation(one, 1.0, numbers["dust"])
    np.interp(1.0, *np.transpose(numbers["star_formation"]["quiescent_rate"]))
    disk_radius(one, 1.0, size["disk"]), bulge_radius(one, 1.0, size["bulge"])


def _bright_slope(knots: FloatArray) -> float:
    """Return d ln N / dm of the first two counts."""
    return np.log(knots[1, 1] / knots[0, 1]) / (knots[1, 0] - knots[0, 0])


class _StellarContent(NamedTuple):
    """Stars of galaxies: mixture per solar mass (n, templates); A(V) [mag] and factor on lines (n,); truth columns."""

    mix: FloatArray
    dust: FloatArray
    lines: FloatArray
    history: dict[str, FloatArray]


class GalaxyPopulation:
    """The laws of the galaxy population, prepared for drawing samples.

    numbers: galaxies.yaml; seds: galaxy_sed.GalaxySeds; weights: (1, 18001) electrons / s per photon density of the i
    filter; zeropoint: its AB magnitude of one electron / s.
    """

    def __init__(
        self, numbers: Mapping[str, Any], seds: GalaxySeds, cosmology: Cosmology, weights: FloatArray, zeropoint: float
    ) -> None:
        self.numbers = numbers
        self.seds = seds
        self.cosmology = cosmology
        self._band_rates = BandRates(seds, weights)
        self._zeropoint = zeropoint
        self.limit = cumulative_counts(numbers)[0][-1]
        self._shift = np.transpose(np.asarray(numbers["shift"], float))
        self.grid = MassGrid(numbers["mass_function"], cosmology, self._lightest_mass)

    def draw(self, rng: Callable[[str], np.random.Generator], area: float) -> dict[str, AnyArray]:
        """Return the columns of a Poisson number of galaxies on `area` [deg2], except position.

        `rng(name)` gives the generator of one quantity. Columns: z, i, size_disk, size_bulge [arcsec, half light],
        bulge_frac, e1, e2, bulgemass, diskmass [solar], veldisp [km/s], sfr [solar / yr], metallicity [mass fraction],
        stellarage [Gyr], gal_type, coeff0.., sed_scale.
        """
        count = rng("count").poisson(self.grid.total * area)
        z, log_mass, kind = self.grid.draw(rng("mass"), count)
        return self.brighter_than_limit(self.properties(rng, z, log_mass, kind))

    def brighter_than_limit(self, columns: Mapping[str, AnyArray]) -> dict[str, AnyArray]:
        """Return the rows brighter than the limit in i."""
        keep = columns["i"] < self.limit
        return {name: values[keep] for name, values in columns.items()}

    def properties(
        self, rng: Callable[[str], np.random.Generator], z: FloatArray, log_mass: FloatArray, kind: IntArray
    ) -> dict[str, AnyArray]:
        """Return the columns of galaxies of given redshift, log10 mass and type (0 star-forming, 1 quiescent)."""
        n = len(z)
        numbers = self.numbers
        bulge_to_total = bulge_fraction(log_mass, kind, rng("bulge").standard_normal(n), numbers["bulge"])
        ellipticity = draw_ellipticity(
            rng("shape"), bulge_to_total > numbers["ellipticity"]["round_share"], numbers["ellipticity"]
        )
        stars = self._stars(rng, z, log_mass, kind, np.abs(ellipticity))
        coefficients = self.seds.coefficients(10 ** log_mass[:, None] * stars.mix, stars.dust, stars.lines)
        scale = distance_scale(self.cosmology.luminosity_distance(z))
        model = self._magnitude(z, coefficients, scale)
        shift = np.interp(model, *self._shift)
        columns = self._sizes(rng, z, log_mass, bulge_to_total, np.abs(ellipticity))
        columns |= {"z": z, "bulge_frac": bulge_to_total, "e1": ellipticity.real, "e2": ellipticity.imag}
        columns |= {"bulgemass": bulge_to_total * 10**log_mass, "diskmass": (1 - bulge_to_total) * 10**log_mass}
        columns |= stars.history
        columns |= {"sed_scale": scale * 10 ** (-0.4 * shift)}
        columns |= {f"coeff{k}": column for k, column in enumerate(np.transpose(coefficients))}
        columns = {name: values.astype(np.float32) for name, values in columns.items()}
        return columns | {"i": model + shift, "gal_type": kind}

    def _magnitude(self, z: FloatArray, coefficients: FloatArray, scale: FloatArray) -> FloatArray:
        rate = self._band_rates.rates(z, coefficients, np.zeros(len(z)))[:, 0] * scale
        return self._zeropoint - 2.5 * np.log10(np.maximum(rate, 1e-300))

    def _stars(
        self,
        rng: Callable[[str], np.random.Generator],
        z: FloatArray,
        log_mass: FloatArray,
        kind: IntArray,
        ellipticity: FloatArray,
    ) -> _StellarContent:
        """Return the _StellarContent of galaxies; ellipticity: its modulus."""
        formation = self.numbers["star_formation"]
        dust = self.numbers["dust"]
        quiescent = kind == QUIESCENT
        n = len(z)
        noise = rng("rate").standard_normal(n)
        rate = np.where(
            quiescent,
            np.interp(z, *np.transpose(formation["quiescent_rate"])) + formation["quiescent_scatter"] * noise,
            main_sequence(log_mass, z, formation) + formation["scatter"] * noise,
        )
        low, high = formation["age"]
        age = cosmic_age(z, self.cosmology) * (low + (high - low) * rng("age").random(n))
        fractions = young_fractions(rate, age, formation["edges"])
        mix = mixture(fractions, formation)
        face_on = np.where(quiescent, dust["quiescent"], attenuation(log_mass, z, dust))
        tilt = ((1 + ellipticity) / (1 - ellipticity)) ** np.where(
            quiescent, 0.0, dust["inclination"]
        )  # (a / b)^inclination
        dusty = face_on * tilt * 10 ** (dust["scatter"] * rng("dust").standard_normal(n))
        lines = 10 ** (self.numbers["line_scatter"] * rng("lines").standard_normal(n))
        history = {
            "sfr": 10 ** (rate + log_mass),
            "stellarage": mean_age(rate, age) / YR_PER_GYR,
            "metallicity": self.seds.metallicity(mix),
        }
        return _StellarContent(mix, np.minimum(dusty, dust["max"]), lines, history)

    def _sizes(
        self,
        rng: Callable[[str], np.random.Generator],
        z: FloatArray,
        log_mass: FloatArray,
        bulge_to_total: FloatArray,
        ellipticity: FloatArray,
    ) -> dict[str, FloatArray]:
        size = self.numbers["size"]
        noise = rng("size").standard_normal((2, len(z)))
        disk = disk_radius(log_mass, z, size["disk"]) * 10 ** (size["disk"]["scatter"] * noise[0])
        early_type = bulge_radius(log_mass, z, size["bulge"]) * 10 ** (size["bulge"]["scatter"] * noise[1])
        half_disk = size["bulge"]["over_disk"] * disk
        bulge = np.where(bulge_to_total > 0.5, early_type, np.minimum(early_type, half_disk))
        radius = bulge_to_total * bulge + (1 - bulge_to_total) * disk
        return {
            "size_disk": to_arcsec(equal_area(disk, ellipticity), z, self.cosmology),
            "size_bulge": to_arcsec(equal_area(bulge, ellipticity), z, self.cosmology),
            "veldisp": velocity_dispersion(log_mass, radius, self.numbers["virial"]),
        }

    def _lightest_mass(self, z: FloatArray) -> FloatArray:
        """Return log10 of the mass at which a blue star-forming galaxy at redshift z is as faint as the limit."""
        formation = self.numbers["star_formation"]
        margin = self.numbers["margin"]
        rate = main_sequence(np.full(len(z), 7.0), z, formation) + margin["rate_sigmas"] * formation["scatter"]
        age = cosmic_age(z, self.cosmology) * np.mean(formation["age"])
        mix = mixture(young_fractions(rate, age, formation["edges"]), formation)
        dust = attenuation(np.full(len(z), 7.0), z, self.numbers["dust"])
        scale = distance_scale(self.cosmology.luminosity_distance(z))
        unit = self._magnitude(z, self.seds.coefficients(mix, dust, np.ones(len(z))), scale)
        faintest = np.interp(self.limit, self._shift[0] + self._shift[1], self._shift[0])
        return 0.4 * (unit - faintest) - margin["dex"]
