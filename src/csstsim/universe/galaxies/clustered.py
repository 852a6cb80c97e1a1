"""The galaxies of a brick with structure: members of haloes near it, and galaxies that follow the smooth density.

A halo's members may lie in several bricks. Each brick draws all haloes that extend into it, and keeps the members that
lie in it. So no galaxy is lost or duplicated at a border, whichever bricks are made. Properties other than redshift,
mass and type come from the brick's random streams, as without structure (universe.galaxies.galaxies).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.healpix import HATS_ORDER, ORDER, pixel_centre, pixel_towards
from csstsim.base.sphere import frames
from csstsim.base.types import AnyArray, ComplexArray, FloatArray, Floats
from csstsim.universe.galaxies.alignments import radial_alignment, sheared, tidal_alignment, turned_to
from csstsim.universe.galaxies.field_galaxies import ORDER as FIELD_ORDER
from csstsim.universe.galaxies.field_galaxies import draw_field
from csstsim.universe.galaxies.galaxies import QUIESCENT
from csstsim.universe.galaxies.members import draw_members, redshift

if TYPE_CHECKING:
    from csstsim.universe.galaxies.galaxies import GalaxyPopulation
    from csstsim.universe.galaxies.occupation import Occupation
    from csstsim.universe.structure.matter_field import MatterField

# Values of the column `satellite`
SATELLITE = 1
CENTRAL = 0
NO_HALO = -1


class ClusteredGalaxies:
    """population: a GalaxyPopulation; occupation: its Occupation; matter: structure.matter_field.MatterField."""

    def __init__(self, population: GalaxyPopulation, occupation: Occupation, matter: MatterField) -> None:
        self.population = population
        self.occupation = occupation
        self.matter = matter
        self._cosmology = population.cosmology
        self._grid = population.grid

    def draw(self, pix: int, rng: Callable[[str], np.random.Generator], area: float) -> dict[str, AnyArray]:
        """Return the columns of the galaxies of brick `pix` of `area` [deg2], as GalaxyPopulation.draw.

        Further columns: ra, dec [deg], _healpix_29, halomass [solar], satellite. `rng(name)` gives the brick's
        generator of one quantity.
        """
        sample = self.sample(pix, rng, area)
        columns = self.population.properties(rng, sample["z"], sample["log_mass"], sample["gal_type"])
        columns |= {name: sample[name] for name in ("ra", "dec", "_healpix_29", "halomass", "satellite")}
        e = self._aligned(pix, rng, columns, sample)
        columns |= {"e1": e.real.astype(np.float32), "e2": e.imag.astype(np.float32)}
        return self.population.brighter_than_limit(columns)

    def sample(self, pix: int, rng: Callable[[str], np.random.Generator], area: float) -> dict[str, AnyArray]:
        """Return position, z, log_mass, gal_type, halomass, satellite, offset and axis of all galaxies, faint ones too.

        offset, axis (n, 3): of members.Members, zero where there is no halo.
        """
        parts = [self._field(pix, rng, area)]
        if self.matter.haloes is not None:
            parts.append(self._members(pix))
        sample = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
        ra, dec = pixel_centre(1 << HATS_ORDER, sample["_healpix_29"])
        return sample | {"ra": ra, "dec": dec}

    def _field(self, pix: int, rng: Callable[[str], np.random.Generator], area: float) -> dict[str, AnyArray]:
        """Return the galaxies of haloes that are not drawn, sampled in pixels of FIELD_ORDER and rows of redshift."""
        occupation = self.occupation
        bits = 2 * (FIELD_ORDER - ORDER)
        pixels = (np.int64(pix) << bits) + np.arange(1 << bits)
        ra, dec = pixel_centre(1 << FIELD_ORDER, pixels)
        delta, variance = self._density(ra, dec)
        field = draw_field(rng("field"), occupation.remainder * (area / len(pixels)), occupation.bias, delta, variance)
        galaxies = self._grid.draw_in_cells(rng("mass"), field.kind, field.row, field.column)
        bits_below = 2 * (HATS_ORDER - FIELD_ORDER)
        healpix = (pixels[field.pixel] << bits_below) + rng("position").integers(0, 1 << bits_below, len(field.pixel))
        count = len(field.pixel)
        no_halo = np.zeros((count, 3))
        return {
            "z": galaxies.z,
            "log_mass": galaxies.log_mass,
            "gal_type": galaxies.kind,
            "_healpix_29": healpix,
            "halomass": np.full(count, np.nan),
            "satellite": np.full(count, NO_HALO, np.int8),
            "offset": no_halo,
            "axis": no_halo,
        }

    def _density(self, ra: FloatArray, dec: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the overdensity (rows, positions) and variance (rows,) of the shells at the rows' middle redshifts."""
        z = 0.5 * (self._grid.z[1:] + self._grid.z[:-1])
        shell = np.searchsorted(self.matter.shells.edges, self._cosmology.comoving_distance(z))
        _, first, row = np.unique(shell, return_index=True, return_inverse=True)
        ra_of = np.tile(ra, len(first))
        dec_of = np.tile(dec, len(first))
        delta, variance = self.matter.density(ra_of, dec_of, np.repeat(z[first], len(ra)))
        shape = len(first), len(ra)
        return delta.reshape(shape)[row], variance.reshape(shape)[row, 0]

    def _members(self, pix: int) -> dict[str, AnyArray]:
        """Return the galaxies of drawn haloes that lie in the brick."""
        occupation = self.occupation
        distance = self._cosmology.comoving_distance
        radius = self.matter.mass_function.virial_radius
        stretch = occupation.numbers["satellites"]["axis_ratio"] ** (-2 / 3)

        def reach(z: Floats, log_mass: FloatArray) -> FloatArray:
            return np.arctan2(stretch * radius(10.0 ** np.asarray(log_mass)), distance(z))

        assert self.matter.haloes is not None  # `sample` asks for their members
        haloes = self.matter.haloes.near(pix, reach)
        z = haloes["z"]
        mass = haloes["log_mass"]
        members = draw_members(occupation, z, mass, haloes["concentration"], radius(10**mass), haloes["key"])
        halo = members.halo
        centre, east, north = frames(np.radians(haloes["ra"]), np.radians(haloes["dec"]))
        x, y, outwards = (v[:, None] for v in members.offset.T)
        position = centre[halo] * (distance(z)[halo, None] + outwards) + east[halo] * x + north[halo] * y
        healpix = pixel_towards(1 << HATS_ORDER, position)
        inside = np.flatnonzero(healpix >> (2 * (HATS_ORDER - ORDER)) == pix)
        return {
            "z": redshift(z[halo], members.speed)[inside],
            "log_mass": members.log_mass[inside],
            "gal_type": members.kind[inside],
            "_healpix_29": healpix[inside],
            "halomass": 10 ** mass[halo[inside]],
            "satellite": members.satellite[inside],
            "offset": members.offset[inside],
            "axis": members.axis[inside],
        }

    def _aligned(
        self,
        pix: int,
        rng: Callable[[str], np.random.Generator],
        columns: Mapping[str, AnyArray],
        sample: Mapping[str, AnyArray],
    ) -> ComplexArray:
        """Return complex ellipticities (n,) that follow haloes and tidal field."""
        numbers = self.occupation.numbers["alignment"]
        e = columns["e1"].astype(float) + 1j * columns["e2"]
        red = sample["gal_type"] == QUIESCENT
        satellite = sample["satellite"]
        normal = rng("alignment").standard_normal(len(e))
        massive = np.flatnonzero((satellite == CENTRAL) & (sample["halomass"] >= 10 ** numbers["central_from"]))
        east, north, _ = sample["axis"][massive].T
        e[massive] = turned_to(e[massive], east, north, normal[massive], numbers)
        red_satellites = np.flatnonzero((satellite == SATELLITE) & red)
        east, north, _ = sample["offset"][red_satellites].T
        e[red_satellites] = sheared(e[red_satellites], radial_alignment(east, north, numbers))
        tidal = np.flatnonzero(red & (satellite != SATELLITE))
        z = columns["z"][tidal].astype(float)
        plus, cross = self.matter.tidal(pix, columns["ra"][tidal], columns["dec"][tidal], z)
        e[tidal] = sheared(e[tidal], tidal_alignment(z, plus + 1j * cross, self._cosmology, numbers))
        return e
