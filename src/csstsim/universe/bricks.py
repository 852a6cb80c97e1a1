"""Bricks: the embedded universe cut into HEALPix pixels of NSIDE 256 (order 8, nested), one parquet file each.

What a brick holds depends on (campaign seed, brick number, config/universe/, the camera's filters, lensing) and on
nothing else, so any subset in any order on any machine is the same sky. A position is the centre of a random order-29
pixel of the brick (0.4 mas apart): HEALPix pixels of one order have equal area, so objects are uniform on
the brick and exactly inside it. The files follow the HATS layout, with its `_healpix_29` column.
"""

import numpy as np

from csstsim import __version__
from csstsim.catalog.photometry import rate_to_mag, subband_weights
from csstsim.catalog.table import BANDS, GALAXY, STAR, ObjectTable
from csstsim.errors import InputError
from csstsim.rng import stream
from csstsim.universe.galaxies import draw_galaxies
from csstsim.universe.galaxy_sed import COEFFICIENTS
from csstsim.universe.lensing import lens
from csstsim.universe.stars import draw_stars, sin_latitude

NSIDE = 256
N_BRICKS = 12 * NSIDE**2
AREA_DEG2 = 4 * 180.0**2 / np.pi / N_BRICKS
ID_BITS = 20  # id = brick x 2^20 + row
_DEEP_ORDER, _ORDER = 29, 8
SED_COLUMNS = ("sed_scale", *(f"coeff{k}" for k in range(COEFFICIENTS)))


def make_brick(seed, pix, universe, camera, lensing):
    """Return the ObjectTable of brick `pix`: stars, then galaxies.

    universe: numbers.Universe; camera: instrument.camera.Camera; lensing: config.Lensing. Magnitudes are of
    the unlensed spectra. Raises InputError for a brick number that does not exist.
    """
    if not 0 <= pix < N_BRICKS:
        raise InputError("no such brick", key="brick", value=pix, allowed=f"0..{N_BRICKS - 1}")
    stars, galaxies = _stars(seed, pix, universe, camera), _galaxies(seed, pix, universe, camera, lensing)
    rows = len(stars) + len(galaxies)
    if rows >= 2**ID_BITS:
        raise InputError(f"a brick holds at most {2**ID_BITS - 1} objects", file=universe.folder, value=rows)
    table = ObjectTable.concat([stars, galaxies]).with_columns(id=(pix << ID_BITS) + np.arange(rows, dtype=np.int64))
    table.meta = brick_meta(seed, pix, universe, camera, lensing)
    return table


def brick_meta(seed, pix, universe, camera, lensing):
    """Return what a brick's content depends on, as recorded in its file."""
    return {
        "product": "truth brick",
        "csstsim": __version__,
        "seed": seed,
        "brick": pix,
        "universe": universe.digest,
        "camera": camera.digest,
        "lensing": lensing.model_dump(),
    }


def write_brick(path, pix, *, seed, universe, camera, lensing):
    """Make brick `pix` and write it (temporary name, fsync, rename)."""
    make_brick(seed, pix, universe, camera, lensing).write(path)


def read_brick(path, expect=None):
    """Read a brick's file. Raises InputError if it is unreadable or its record differs from `expect` (brick_meta)."""
    table = ObjectTable.read(path)
    if table.meta.get("product") != "truth brick":
        raise InputError("not a truth brick", file=path, key="product", value=table.meta.get("product"))
    for key, value in (expect or {}).items():
        if table.meta.get(key) != value:
            raise InputError(
                "the brick was made for something else; make it again",
                file=path,
                key=key,
                value=table.meta.get(key),
                allowed=value,
            )
    return table


def _stars(seed, pix, universe, camera):
    import healpy

    centre = healpy.pix2ang(NSIDE, pix, nest=True, lonlat=True)
    columns = draw_stars(_streams(seed, pix, "stars"), AREA_DEG2, sin_latitude(*centre), universe.stars)
    v, seds = columns.pop("v"), universe.star_seds
    columns["sed_scale"] = (10 ** (-0.4 * (v - seds.unit_v_mag(columns["teff"], columns["feh"])))).astype(np.float32)
    rates = seds.integrate(columns["teff"], columns["feh"], _band_weights(camera)) * columns["sed_scale"][:, None]
    columns |= {f"coeff{k}": np.zeros(len(v), np.float32) for k in range(COEFFICIENTS)}
    columns |= {"obj_type": np.full(len(v), STAR, np.int8)}
    return _complete(seed, pix, "stars", columns, rates, camera)


def _galaxies(seed, pix, universe, camera, lensing):
    columns = draw_galaxies(_streams(seed, pix, "galaxies"), AREA_DEG2, universe.galaxies)
    i, seds = columns.pop("i"), universe.galaxy_seds
    mix = np.column_stack([columns[f"coeff{k}"] for k in range(COEFFICIENTS)])
    rates = seds.integrate(columns["z"], mix, _band_weights(camera))
    wanted = 10 ** (0.4 * (camera.filters["i"].zeropoint(camera.telescope) - i))
    columns["sed_scale"] = (wanted / rates[:, BANDS.index("i")]).astype(np.float32)
    rates *= columns["sed_scale"][:, None]
    columns |= {"obj_type": np.full(len(i), GALAXY, np.int8)}
    table = _complete(seed, pix, "galaxies", columns, rates, camera)
    field = universe.lensing_field(seed) if lensing.field == "cosmic" else None
    return table.with_columns(**lens(pix, table["ra"], table["dec"], table["z"], lensing, field))


def _complete(seed, pix, kind, columns, rates, camera):
    """Add position and magnitudes and put the columns in their order."""
    import healpy

    deep = 2 * (_DEEP_ORDER - _ORDER)
    children = _streams(seed, pix, kind)("position").integers(0, 1 << deep, len(rates))
    healpix = (np.int64(pix) << deep) + children
    ra, dec = healpy.pix2ang(1 << _DEEP_ORDER, healpix, nest=True, lonlat=True)
    for k, band in enumerate(BANDS):
        columns[f"mag_{band}"] = rate_to_mag(rates[:, k], _filters(camera)[k], camera.telescope).astype(np.float32)
    order = {name: columns.pop(name) for name in SED_COLUMNS}
    return ObjectTable.complete(columns | {"ra": ra, "dec": dec} | order | {"_healpix_29": healpix})


def _streams(seed, pix, kind):
    return lambda name: stream(seed, "brick", pix, kind, name)


def _filters(camera):
    """The seven imaging filters in the order of BANDS; names in files may be upper case (NUV)."""
    by_name = {name.lower(): f for name, f in camera.filters.items()}
    missing = [band for band in BANDS if band not in by_name]
    if missing:
        raise InputError("the camera lacks a filter", file=camera.folder, key="filters", value=missing[0])
    return [by_name[band] for band in BANDS]


def _band_weights(camera):
    """Return (7, 18001): electrons / s per photon density in each whole filter."""
    return np.stack([subband_weights(f, camera.telescope).sum(axis=0) for f in _filters(camera)])
