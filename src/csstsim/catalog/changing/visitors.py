"""Asteroids and satellites of an exposure as rows of the embedded sky: positions, rates, spectra.

They reflect sunlight, so their spectra are those of stars like the Sun (asteroids of type S: of a cooler one).
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from csstsim.base.errors import CsstsimError
from csstsim.base.healpix import hats_index
from csstsim.base.sphere import frames, ra_dec, unit_vectors
from csstsim.base.units import ARCSEC_PER_RAD, DAY_S, ab_photon_density
from csstsim.catalog.astrometry.ephemeris import Observer, mjd_tt
from csstsim.catalog.astrometry.reduction import icrs
from csstsim.catalog.changing.columns import MOTION
from csstsim.catalog.changing.motion import HOUR_S, Interval
from csstsim.catalog.table import ASTEROID, SATELLITE, ObjectTable
from csstsim.catalog.truth_bricks import SED_COLUMNS, with_magnitudes
from csstsim.universe.changing.numbers import number_error, numbers_of

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

    from csstsim.base.types import AnyArray
    from csstsim.instrument.camera import Camera
    from csstsim.instrument.pointing import Pointing
    from csstsim.instrument.telescope import Telescope
    from csstsim.universe.parameters import Universe

# ids; those of bricks are below
FIRST_ASTEROID = 1 << 50
FIRST_SATELLITE = 1 << 52
_SUN = {"teff": 5770.0, "logg": 4.44, "feh": 0.0}
_MARGIN = 0.05  # deg around the focal plane
_V = np.arange(5100.0, 5901.0, 10.0)  # angstrom: the mean flux density there has the magnitude V


def visitors(
    kinds: Collection[str],
    seed: int,
    universe: Universe,
    camera: Camera,
    pointing: Pointing,
    observer: Observer,
    interval: Interval,
) -> ObjectTable:
    """Return the ObjectTable of the asteroids and satellites (kinds: which) near the focal plane in an exposure.

    Its columns are those of truth bricks and catalog.changing.columns.MOTION. Raises InputError for a wrong parameter.
    """
    ra, dec = icrs(pointing.ra, pointing.dec, observer)
    boresight = float(ra), float(dec)
    radius = _radius(camera)
    tables = [_table({"ra": np.zeros(0)}, universe, camera)]
    for kind, make in (("asteroids", _asteroids), ("satellites", _satellites)):
        if kind not in kinds:
            continue
        numbers = numbers_of(universe.folder, kind)
        try:
            columns = make(seed, observer, interval, boresight, radius, camera.telescope, numbers)
        except CsstsimError:
            raise
        except (KeyError, TypeError, ValueError, IndexError) as exc:
            raise number_error(universe.folder, kind, exc) from exc
        tables.append(_table(columns, universe, camera))
    return ObjectTable.concat(tables)


def _radius(camera: Camera) -> float:
    """Return the radius [rad] about the boresight that contains all chips."""
    corners = [
        np.hypot(abs(chip.xc) + 0.6 * chip.detector.nx, abs(chip.yc) + 0.6 * chip.detector.ny)
        for chip in camera.chips.values()
    ]
    return max(corners) * camera.telescope.pixel_scale / ARCSEC_PER_RAD + np.radians(_MARGIN)


def _asteroids(
    seed: int,
    observer: Observer,
    interval: Interval,
    boresight: tuple[float, float],
    radius: float,
    _telescope: Telescope,
    numbers: Mapping[str, Any],
) -> dict[str, AnyArray]:
    from csstsim.universe.changing.asteroids import LIGHT_DAY_AU, seen_from

    sun = observer.astrom["eh"] * observer.astrom["em"]
    velocity = observer.astrom["v"] * LIGHT_DAY_AU
    middle = mjd_tt(interval.middle)
    half = 0.5 * interval.exptime / DAY_S
    asteroids = _asteroids_of_exposure(seed, middle, tuple(sun + half * velocity), boresight, radius, repr(numbers))
    ends = [
        seen_from(
            asteroids["orbit"], asteroids["H"], middle + step, sun + (half + step) * velocity, numbers["phase_slope"]
        )[0]
        for step in (-half, half)
    ]
    ra, dec = ra_dec(asteroids["vector"])
    _, east, north = frames(np.radians(ra), np.radians(dec))
    hours = interval.exptime / HOUR_S
    rates = [np.einsum("ni,ni->n", ends[1] - ends[0], a) * ARCSEC_PER_RAD / hours for a in (east, north)]
    colours = numbers["colours"]
    s_type = (asteroids["id"] * 2654435761 % 2**32) / 2**32 < np.array(colours["s_share"])[asteroids["zone"]]
    return {
        "id": FIRST_ASTEROID + asteroids["id"],
        "obj_type": np.full(len(ra), ASTEROID),
        "ra": ra,
        "dec": dec,
        "rate_ra": rates[0],
        "rate_dec": rates[1],
        "rate_mjd": np.full(len(ra), interval.middle),
        "teff": np.where(s_type, colours["teff"]["S"], colours["teff"]["C"]),
        "V": asteroids["V"],
    }


@lru_cache(4)
def _asteroids_of_exposure(
    seed: int, mjd: float, sun: tuple[float, ...], boresight: tuple[float, float], radius: float, numbers: str
) -> dict[str, AnyArray]:
    """Return the asteroids of an exposure, computed once for all of its chips in a process."""
    import ast

    from csstsim.universe.changing.asteroids import asteroids_near

    return asteroids_near(seed, mjd, sun, unit_vectors(*boresight), radius, ast.literal_eval(numbers))


def _satellites(
    seed: int,
    _observer: Observer,
    interval: Interval,
    boresight: tuple[float, float],
    radius: float,
    telescope: Telescope,
    numbers: Mapping[str, Any],
) -> dict[str, AnyArray]:
    from csstsim.universe.changing.satellites import crossing

    satellites = crossing(seed, interval.start, interval.exptime, boresight, radius, telescope.diameter_m, numbers)
    angle = np.radians(satellites["angle"])
    rate = satellites["speed"] * HOUR_S
    return {
        "id": FIRST_SATELLITE + satellites["id"],
        "obj_type": np.full(len(angle), SATELLITE),
        "ra": satellites["ra"],
        "dec": satellites["dec"],
        "rate_ra": rate * np.sin(angle),
        "rate_dec": rate * np.cos(angle),
        "rate_mjd": interval.start + satellites["time"] / DAY_S,
        "trail_width": satellites["width"],
        "V": satellites["V"],
    }


def _table(columns: Mapping[str, AnyArray], universe: Universe, camera: Camera) -> ObjectTable:
    """Return the ObjectTable of asteroids or satellites with spectra of their magnitudes V."""
    count = len(columns["ra"])
    star = {name: np.asarray(columns.get(name, np.full(count, value)), float) for name, value in _SUN.items()}
    tail: dict[str, AnyArray] = dict.fromkeys(SED_COLUMNS, np.zeros(count, np.float32))
    if count:
        surface = universe.star_seds.surface(star["teff"], star["logg"], star["feh"], _V).mean(axis=1)
        scale = 10 ** (-0.4 * columns["V"]) * ab_photon_density(_V).mean() / surface
        tail["sed_scale"] = scale.astype(np.float32)
    tail["_healpix_29"] = hats_index(columns["ra"], columns.get("dec", columns["ra"]))
    motion = {
        name: np.asarray(columns.get(name, np.full(count, default)), dtype)
        for name, (dtype, default, _) in MOTION.items()
    }
    head = {name: values for name, values in columns.items() if name not in (*MOTION, "V")}
    table = ObjectTable.complete(head | star | tail | motion, camera.bands)
    return with_magnitudes(table, universe, camera)
