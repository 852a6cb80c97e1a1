"""Spectra of a table of the embedded universe, computed from the parameters stored with each row.

    S(lambda) = sed_scale x 10^(-0.4 av k(lambda)) x model(row)      photon / s / m2 / angstrom, observed frame

The model is an atmosphere (teff, logg, feh) for stars, with sed_scale = (R / d)^2, and redshifted components with
intergalactic absorption (z, coeff0..19) for galaxies and quasars. The spectrum of a star's close companion is added to
its own: an atmosphere (coeff0, coeff1, feh) times coeff2, the squared ratio of the radii; coeff0 = 0 if there is none.
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

_COEFFICIENTS = tuple(f"coeff{k}" for k in range(COEFFICIENTS))
_PARAMETERS = ("obj_type", "z", "teff", "logg", "feh", "av", "sed_scale", *_COEFFICIENTS)


def spectrum_parameters(table: ObjectTable) -> ObjectTable:
    """Return the columns of a table on which its spectra depend: a third of them, so rows are selected faster."""
    return ObjectTable({name: table[name] for name in _PARAMETERS if name in table})


def coefficients(columns: Mapping[str, AnyArray]) -> FloatArray:
    """Return the (n, 20) coefficients of a table or mapping of columns."""
    return np.column_stack([columns[name] for name in _COEFFICIENTS])


def rates(universe: Universe, table: ObjectTable, weights: FloatArray, tables: BandRates | None = None) -> FloatArray:
    """Return (n, bands): int S w dlambda for `weights` (bands, 18001) on the paper's grid.

    Equal to integrals of `spectra` to 1e-4; with `tables`, galaxies to 1e-3 in a fifth of the time. tables:
    galaxies.band_rates.BandRates of these weights.
    """
    out = np.zeros((len(table), len(weights)))
    for chosen, group in by_spectrum(table):
        if as_star(group["obj_type"][0]):
            rate = with_companions(universe.star_seds.rates, group, group["av"], weights)
        elif group["obj_type"][0] == GALAXY:
            parameters = group["z"], coefficients(group), group["av"]
            rate = universe.galaxy_seds.rates(*parameters, weights) if tables is None else tables.rates(*parameters)
        else:
            rate = universe.quasar_seds.rates(group["z"], coefficients(group), group["av"], weights)
        out[chosen] = rate * group["sed_scale"].astype(float)[:, None]
    return out


def with_companions(spectrum: Callable[..., FloatArray], stars: ObjectTable, *args: FloatArray) -> FloatArray:
    """Return spectrum(teff, logg, feh, *args) of stars, (n, m), with that of their companions added.

    The first of `args`, if any, is A(V) of each star.
    """
    out = spectrum(stars["teff"], stars["logg"], stars["feh"], *args)
    double = np.flatnonzero(stars["coeff0"] > 0) if "coeff0" in stars else ()
    if len(double):
        args = (args[0][double], *args[1:]) if args else args
        companions = spectrum(stars["coeff0"][double], stars["coeff1"][double], stars["feh"][double], *args)
        out[double] += stars["coeff2"][double].astype(float)[:, None] * companions
    return out


def spectra(universe: Universe, table: ObjectTable) -> FloatArray:
    """Return (n, 18001) spectra on the paper's grid."""
    out = np.zeros((len(table), len(GRID)))
    for chosen, group in by_spectrum(table):
        scale = group["sed_scale"].astype(float)
        if as_star(group["obj_type"][0]):
            dimming = 10 ** (-0.4 * group["av"].astype(float)[:, None] * universe.extinction)
            part = with_companions(universe.star_seds.surface, group) * dimming * scale[:, None]
        else:
            seds = universe.galaxy_seds if group["obj_type"][0] == GALAXY else universe.quasar_seds
            part = seds.spectra(group["z"], coefficients(group), scale, group["av"])
        out[chosen] = part
    return out


def as_star(obj_type: np.integer[Any] | IntArray) -> BoolArray:
    """Whether objects have the spectrum of a star: stars, asteroids and satellites."""
    return (obj_type == STAR) | (obj_type == ASTEROID) | (obj_type == SATELLITE)


def by_spectrum(table: ObjectTable) -> Iterator[tuple[BoolArray, ObjectTable]]:
    """Yield (mask, rows) of objects with a star's spectrum, of galaxies and of quasars, if the table has any."""
    table = spectrum_parameters(table)
    for kind in (STAR, GALAXY, QUASAR):
        chosen = as_star(table["obj_type"]) if kind == STAR else table["obj_type"] == kind
        if chosen.any():
            yield chosen, table.take(chosen)
