"""Expected counts of the mock's stars in any band, behind the dust, as a survey of given resolution would count them.

A pair closer than the `beam` is one source of its summed light, a wider one two. For the share of wide pairs, the
separations are those of solar stars. Counts are of the model itself (no drawing), so they have no noise.
"""

import numpy as np
import speclite.filters
from scipy.special import ndtr

from csstsim.base.units import SOLAR_RADIUS_PC, ab_photon_density
from csstsim.instrument.filter import GRID
from csstsim.universe.dust.dust_map import galactic
from csstsim.universe.dust.extinction import star_ebv
from csstsim.universe.stars.milky_way import components, density, direction
from csstsim.universe.stars.star_types import make_types

FIRST, STEP, STEPS = -12.0, 0.05, 1000  # the grid of absolute magnitudes
MODULUS = np.arange(-1.0, 24.01, 0.25)
PARSEC = 10 ** (0.2 * 0.5 * (MODULUS[1:] + MODULUS[:-1]) + 1)
VOLUME = np.diff(10 ** (0.6 * MODULUS + 3)) / 3 * np.radians(1) ** 2  # pc3 / deg2
USUAL = 5500.0, 4.5  # Teff, log g of the star whose extinction stands for all


class StarCounts:
    """Counts in the speclite filter `band`; zero: AB minus the magnitudes wanted; beam [arcsec].

    numbers: config/universe/stars.yaml as read; universe: universe.parameters.Universe.
    """

    def __init__(self, numbers, universe, band, zero=0.0, beam=0.5):
        self.numbers, self._universe, self._types = numbers, universe, make_types(numbers)
        weights = (speclite.filters.load_filter(band).interpolator(GRID) * (GRID[1] - GRID[0]))[None]
        unit = np.einsum("bw,w->b", weights, ab_photon_density(GRID)) * 10 ** (0.4 * -zero)
        one, dimmed = (universe.star_seds.rates([USUAL[0]], [USUAL[1]], [0.0], av, weights)[0, 0] for av in (0.0, 0.5))
        self._extinction = 2.5 * np.log10(one / dimmed) / 0.5  # A / A(V)
        self._light = [self._of(types, weights, unit) for types in self._types]
        laws = numbers["binaries"]["laws"]
        log_a, spread = (np.interp(0.0, np.log(laws["mass"]), laws[name]) for name in ("log_a", "spread"))
        self._wide = 1.0 - ndtr((np.log10(beam * PARSEC) - log_a) / spread)

    def _of(self, types, weights, unit):
        """Return (2, n) light of the stars and of their companions at 10 pc, in units of magnitude 0."""
        _, teff, logg, feh, _, radius = types.table
        out, two = np.zeros((2, len(teff))), np.flatnonzero(types.pair[0])
        parts = ((slice(None), teff, logg, radius), (two, *types.pair[[2, 3, 5]][:, two]))
        for light, (rows, *star, size) in zip(out, parts, strict=True):
            rates = self._universe.star_seds.rates(*star, feh[rows], 0.0, weights)[:, 0]
            light[rows] = rates * (size * SOLAR_RADIUS_PC / 10) ** 2 / unit
        return out

    def functions(self, tilts=None):
        """Return {component: (A, B)}: local numbers [pc-3] brighter than the grid; what wide pairs add.

        tilts: {component: changes of its three mass-function slopes}, at constant local mass.
        """
        out = {}
        for types, (own, other) in zip(self._types, self._light, strict=True):
            name, share, weight = types.component.name, types.pair[0], np.diff(types.total)
            if share.any() and name in (tilts or {}):
                weight = _tilted(weight, types, tilts[name], self.numbers["imf_breaks"])
            bins = (
                (own, weight, 1.0 - share, 0.0), (own + other, weight, share, -share), (own, weight, 0.0, share),
                (other, weight, 0.0, share),
            )  # fmt: skip
            total = np.zeros((2, STEPS))
            for light, number, *shares in bins:
                at = (-2.5 * np.log10(np.maximum(light, 1e-30)) - FIRST) / STEP
                at = np.clip(at.astype(int), 0, STEPS - 1)
                total += [np.bincount(at, number * s, STEPS).cumsum() for s in shares]
            out[name] = out.get(name, 0.0) + total
        return out

    def brighter(self, ra, dec, limits, numbers=None, tilts=None):
        """Return (n, limits) stars per deg2 brighter than `limits` at ra, dec [deg], (n,).

        numbers: other laws and densities than those given at first, whose ages and metals hold.
        """
        ra, dec = np.atleast_1d(np.asarray(ra, float)), np.atleast_1d(np.asarray(dec, float))
        numbers = self.numbers if numbers is None else numbers
        first = {c.name: c.density for c in components(self.numbers)}
        dust, latitude = self._universe.numbers["dust"], galactic(ra, dec)[1]
        ebv = star_ebv(
            self._universe.dust.ebv(ra, dec)[:, None], PARSEC, latitude[:, None], dust["height"], dust["reach"]
        )
        dim = self._extinction * self._universe.r_v * ebv + 5 * np.log10(PARSEC / 10)
        position = direction(ra, dec)[:, :, None] * (PARSEC / 1000)
        out, functions = np.zeros((len(ra), len(limits))), self.functions(tilts)
        for component in components(numbers):
            grow = component.density / first[component.name] if component.density else 1.0
            there = grow * density(component, position, numbers) * VOLUME
            single, split = functions[component.name]
            for k, limit in enumerate(limits):
                at = np.clip(((limit - dim - FIRST) / STEP - 0.5).astype(int), 0, STEPS - 1)
                out[:, k] += (there * (single[at] + self._wide * split[at])).sum(axis=1)
        return out


def _tilted(weight, types, tilt, breaks):
    mass, share, second = types.table[4], types.pair[0], types.pair[4]
    low, high = breaks
    power = np.where(mass < low, tilt[0], np.where(mass < high, tilt[1], tilt[2]))
    edge = np.where(mass < low, low, high)
    factor = (mass / edge) ** power * np.where(mass < low, (low / high) ** tilt[1], 1.0)
    every = mass + share * second
    return weight * factor * (weight @ every) / ((weight * factor) @ every)
