"""A field of stars and galaxies with known positions, magnitudes, shapes and redshifts, and catalogues made from it."""

import numpy as np
from astropy.coordinates import SkyCoord
from astropy.table import Table

from csstsim.catalog.table import GALAXY, STAR, ObjectTable
from csstsim.studies.release.score.field import Field

SIDE, SPACING = 120.0, 6.0  # arcsec: a grid, so that no object is near another


def field(ra=150.0, dec=2.0, band="r", faintest=24.0, close=False):
    """Return the Field of a grid about ra, dec [deg]; close: each galaxy has a faint neighbour 0.4" to its north."""
    side = np.arange(-SIDE / 2, SIDE / 2 + 0.1, SPACING)
    east, north = (v.ravel() for v in np.meshgrid(side, side))
    rng = np.random.default_rng(7)
    n = len(east)
    kind = np.where(np.arange(n) % 3 == 0, STAR, GALAXY).astype(np.int8)
    columns = {
        "id": np.arange(n), "obj_type": kind, f"mag_{band}": rng.uniform(18.0, faintest, n),
        "size": np.where(kind == GALAXY, 0.4, 0.0), "z": np.where(kind == GALAXY, rng.uniform(0.1, 2.0, n), 0.0),
        "e1": np.where(kind == GALAXY, rng.normal(0, 0.15, n), 0.0),
        "e2": np.where(kind == GALAXY, rng.normal(0, 0.15, n), 0.0),
        f"snr_{band}": np.full(n, 100.0),
    }  # fmt: skip
    if close:
        galaxies = np.flatnonzero(kind == GALAXY)
        more = {name: values[galaxies].copy() for name, values in columns.items()}
        more["id"] += n
        more[f"mag_{band}"] = more[f"mag_{band}"] + 3.0
        columns = {name: np.concatenate([columns[name], more[name]]) for name in columns}
        east, north = np.append(east, east[galaxies]), np.append(north, north[galaxies] + 0.4)
    at = offset_positions(ra, dec, east, north)
    half = SIDE / 2 + 4.0
    corners = offset_positions(ra, dec, np.array([-half, half, half, -half]), np.array([-half, -half, half, half]))
    frames = [{"file": "a.fits", "filter": band, "kind": "imaging", "corners": np.transpose(corners).tolist()}]
    return Field("test", ObjectTable({"ra": at[0], "dec": at[1]} | columns), frames)


def offset_positions(ra, dec, east, north):
    """Return ra, dec [deg] of offsets [arcsec] from a position, by astropy: right at poles, too."""
    there = SkyCoord(ra, dec, unit="deg").skyoffset_frame()
    sky = SkyCoord(east / 3600.0, north / 3600.0, unit="deg", frame=there).icrs
    return sky.ra.deg, sky.dec.deg


def table(truth, rows=None, **changes):
    """Return an astropy Table of the truth's own values, some rows, with columns changed."""
    names = [name for name in truth if name not in ("id", "obj_type", "size") and not name.startswith("snr")]
    rows = np.arange(len(truth)) if rows is None else rows
    return Table({name: np.asarray(truth[name])[rows] for name in names} | changes)
