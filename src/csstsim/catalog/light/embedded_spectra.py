"""Spectra of a table of the embedded universe, made from the parameters stored with each row.

    S(lambda) = sed_scale x 10^(-0.4 av k(lambda)) x model(row)      photon / s / m2 / angstrom, observed frame

The model is an atmosphere (teff, logg, feh) for stars, with sed_scale = (R / d)^2, and redshifted components with
intergalactic absorption (z, coeff0..19) for galaxies and quasars. The light of a star's close companion is added to its
own: an atmosphere (coeff0, coeff1, feh) times coeff2, the squared ratio of the radii; coeff0 = 0 if there is none.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

import csstsim.base.process.no_blas  # noqa: F401
from csstsim.catalog.table import ASTEROID, GALAXY, QUASAR, SATELLITE, STAR, ObjectTable
from csstsim.instrument.filter import GRID
from csstsim.universe.coefficients import COEFFICIENTS
from csstsim.universe.parameters import Universe

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from csstsim.base.types import AnyArray, BoolArray, FloatArray, IntArray
    from csstsim.universe.galaxies.band_rates import BandRates

_MIX = tuple(f"coeff{k}" for k in range(COEFFICIENTS))
_LIGHT = ("obj_type", "z", "teff", "logg", "feh", "av", "sed_scale", *_MIX)


def spectrum_parameters(table: ObjectTable) -> ObjectTable:
    """Return the columns of a table that its spectra depend on: a third of them, so rows are taken faster."""
    return ObjectTable({name: table[name] for name in _LIGHT if name in table})


def coefficients(columns: Mapping[str, AnyArray]) -> FloatArray:
    """Return the (n, 20) coefficients of a table or mapping of columns."""
    return np.column_stack([columns[name] for name in _MIX])


def rates(universe: Universe, table: ObjectTable, weights: FloatArray, many: BandRates | None = None) -> FloatArray:
    """Return (n, bands): int S w dlambda for `weights` (bands, 18001) on the paper's grid.

    The same light as `spectra` to 1e-4; with `many`, galaxies to 1e-3 in a fifth of the time. many:
    galaxies.band_rates.BandRates of these weights.
    """
    out = np.zeros((len(table), len(weights)))
    for chosen, some in kinds(table):
        if as_star(some["obj_type"][0]):
            part = pairs(universe.star_seds.rates, some, some["av"], weights)
        elif some["obj_type"][0] == GALAXY:
            light = some["z"], coefficients(some), some["av"]
            part = universe.galaxy_seds.rates(*light, weights) if many is None else many.rates(*light)
        else:
            part = universe.quasar_seds.rates(some["z"], coefficients(some), some["av"], weights)
        out[chosen] = part * some["sed_scale"].astype(float)[:, None]
    return out


def pairs(light: Callable[..., FloatArray], some: ObjectTable, *args: FloatArray) -> FloatArray:
    """Return light(teff, logg, feh, *args) of the stars `some`, (n, m), with that of their companions.

    The first of `args`, if any, is A(V) of each star.
    """
    out = light(some["teff"], some["logg"], some["feh"], *args)
    two = np.flatnonzero(some["coeff0"] > 0) if "coeff0" in some else ()
    if len(two):
        args = (args[0][two], *args[1:]) if args else args
        more = light(some["coeff0"][two], some["coeff1"][two], some["feh"][two], *args)
        out[two] += some["coeff2"][two].astype(float)[:, None] * more
    return out


def spectra(universe: Universe, table: ObjectTable) -> FloatArray:
    """Return (n, 18001) spectra on the paper's grid."""
    out = np.zeros((len(table), len(GRID)))
    for chosen, some in kinds(table):
        scale = some["sed_scale"].astype(float)
        if as_star(some["obj_type"][0]):
            dimming = 10 ** (-0.4 * some["av"].astype(float)[:, None] * universe.extinction)
            part = pairs(universe.star_seds.surface, some) * dimming * scale[:, None]
        else:
            seds = universe.galaxy_seds if some["obj_type"][0] == GALAXY else universe.quasar_seds
            part = seds.spectra(some["z"], coefficients(some), scale, some["av"])
        out[chosen] = part
    return out


def as_star(obj_type: np.integer[Any] | IntArray) -> BoolArray:
    """Whether objects have the spectrum of a star: stars, and what reflects sunlight."""
    return (obj_type == STAR) | (obj_type == ASTEROID) | (obj_type == SATELLITE)


def kinds(table: ObjectTable) -> Iterator[tuple[BoolArray, ObjectTable]]:
    """Yield (mask, rows) of stars and what reflects sunlight, of galaxies and of quasars, where there are any."""
    table = spectrum_parameters(table)
    for kind in (STAR, GALAXY, QUASAR):
        chosen = as_star(table["obj_type"]) if kind == STAR else table["obj_type"] == kind
        if chosen.any():
            yield chosen, table.take(chosen)
