"""Real stars brighter than the stars of the embedded universe, with their positions, V magnitudes and temperatures.

A star's spectrum is that of its temperature, scaled to its V at 5500 angstrom, where V = 0 is 3636 Jy: an AB magnitude
of 0 within 0.002 mag (Bessell, Castelli & Plez 1998, A&A 333, 231). V includes extinction, so none is added. Left out:
proper motion and parallax, companions, variability.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.healpix import HATS_ORDER, ORDER, hats_index, pixel_centre
from csstsim.base.types import AnyArray, FloatArray
from csstsim.base.units import ab_photon_density

if TYPE_CHECKING:
    from csstsim.universe.stars.star_sed import StarSeds

_WINDOW = 5250.0, 5750.0  # angstrom: in the mean, single lines are negligible


def bright_stars(pix: int, stars: FloatArray, seds: StarSeds, numbers: Mapping[str, Any]) -> dict[str, AnyArray]:
    """Return the columns of the bright stars in brick `pix` as a dict of arrays of one length.

    stars: (n, 4) ra, dec [deg], V, temperature [K]; seds: universe.stars.star_sed.StarSeds; numbers: those of
    config/universe/stars.yaml. Columns: ra, dec [deg], _healpix_29, teff [K], logg, feh, sed_scale. Raises InputError
    if the numbers have no section `bright`.
    """
    healpix = hats_index(stars[:, 0], stars[:, 1])
    rows = np.flatnonzero(healpix >> 2 * (HATS_ORDER - ORDER) == pix)
    ra, dec = pixel_centre(1 << HATS_ORDER, healpix[rows])
    magnitude = stars[rows, 2]
    teff = stars[rows, 3]
    try:
        giants, dwarfs = numbers["bright"]["logg"]
        logg = np.where(teff < numbers["bright"]["giants_below"], giants, dwarfs)
    except (KeyError, TypeError, ValueError) as exc:
        raise InputError(f"a number is missing or wrong: {exc}", file="universe/stars.yaml", key="bright") from exc
    columns = {"ra": ra, "dec": dec, "_healpix_29": healpix[rows], "teff": teff, "logg": logg}
    columns["feh"] = np.zeros(len(rows))
    wave = np.arange(_WINDOW[0], _WINDOW[1] + 1, 5.0)
    surface = seds.surface(teff, logg, columns["feh"], wave) if len(rows) else np.ones((0, len(wave)))
    density = ab_photon_density(wave, magnitude[:, None]).mean(axis=1)
    return columns | {"sed_scale": density / surface.mean(axis=1)}
