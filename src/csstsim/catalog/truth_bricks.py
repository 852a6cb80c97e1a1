"""Bricks: the embedded universe cut into HEALPix pixels of NSIDE 256 (order 8, nested), one parquet file each.

A brick's content depends only on campaign seed, brick number, config/universe/, the dust map, the camera's filters,
lensing, structure, and the list of bright stars if the campaign asks for them. So any subset, made in any order on any
machine, shows the same sky. A position is the centre of an order-29 pixel of the brick (0.4 mas apart), so it lies
exactly inside. Such pixels have equal area: stars are uniform on the brick, and galaxies with `structure: none`.
The files follow the HATS layout, with its `_healpix_29` column.
"""

from __future__ import annotations

from functools import lru_cache, partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from csstsim.base.digest import digest
from csstsim.base.errors import InputError
from csstsim.base.healpix import BRICKS, HATS_ORDER, ORDER, pixel_centre
from csstsim.base.release import release
from csstsim.base.rng import stream
from csstsim.base.units import SOLAR_RADIUS_PC
from csstsim.catalog.flags import STRONG_LENSING
from csstsim.catalog.light.embedded_spectra import rates
from csstsim.catalog.light.photometry import rate_to_mag, subband_weights
from csstsim.catalog.table import COLUMNS, GALAXY, QUASAR, STAR, ObjectTable
from csstsim.instrument.camera import Camera, load_camera
from csstsim.universe.coefficients import COEFFICIENTS
from csstsim.universe.parameters import Universe

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from csstsim.base.types import AnyArray, FloatArray, IntArray, PathLike
    from csstsim.campaign.sections import Lensing
    from csstsim.universe.galaxies.band_rates import BandRates
    from csstsim.universe.galaxies.clustered import ClusteredGalaxies
    from csstsim.universe.galaxies.galaxies import GalaxyPopulation
    from csstsim.universe.lensing.lensing_field import LensingField
    from csstsim.universe.structure.matter_field import MatterField

AREA_DEG2 = 4 * 180.0**2 / np.pi / BRICKS
ID_BITS = 22  # id = brick x 2^22 + row
COMPANION = {"coeff0": "teff2", "coeff1": "logg2", "coeff2": "area2"}  # of a star (catalog.light.embedded_spectra)
SED_COLUMNS = ("sed_scale", *(f"coeff{k}" for k in range(COEFFICIENTS)))


def make_brick(
    seed: int,
    pix: int,
    universe: Universe,
    camera: Camera,
    lensing: Lensing,
    structure: str = "haloes",
    bright_stars: FloatArray | None = None,
) -> ObjectTable:
    """Return the ObjectTable of brick `pix`: stars, galaxies, quasars, then real bright stars.

    universe: universe.parameters.Universe; camera: instrument.camera.Camera; lensing: sections.Lensing; structure:
    sections.CatalogConfig.structure; bright_stars: rows (n, 4) of universe.stars.bright_stars, or None for none.
    Magnitudes are those of the spectra: with the Milky Way's extinction, without lensing magnification. Raises
    InputError for a brick number that does not exist.
    """
    if not 0 <= pix < BRICKS:
        raise InputError("no such brick", key="brick", value=pix, allowed=f"0..{BRICKS - 1}")
    stars = _stars(seed, pix, universe, camera)
    galaxies = _galaxies(seed, pix, universe, camera, lensing, structure)
    quasars = _quasars(seed, pix, universe, camera, galaxies, lensing, structure)
    last = [] if bright_stars is None else [_bright(pix, universe, camera, bright_stars)]  # the others keep their ids
    rows = len(stars) + len(galaxies) + len(quasars) + sum(map(len, last))
    if rows >= 2**ID_BITS:
        raise InputError(f"a brick holds at most {2**ID_BITS - 1} objects", file=universe.folder, value=rows)
    first = np.int64(pix) << ID_BITS
    host = quasars["host"]
    quasars = quasars.with_columns(host=np.where(host >= 0, first + len(stars) + host, -1))
    table = ObjectTable.concat([stars, galaxies, quasars, *last]).with_columns(
        id=first + np.arange(rows, dtype=np.int64)
    )
    table = with_magnitudes(table, universe, camera)
    table.meta = brick_meta(seed, pix, universe, camera, lensing, structure, bright_stars)
    return table


def brick_meta(
    seed: int,
    pix: int,
    universe: Universe,
    camera: Camera,
    lensing: Lensing,
    structure: str = "haloes",
    bright_stars: FloatArray | None = None,
) -> dict[str, Any]:
    """Return the inputs on which a brick's content depends, as recorded in its file."""
    return {
        "product": "truth brick",
        "csstsim": release(),
        "seed": seed,
        "brick": pix,
        "universe": universe.digest,
        "camera": camera.digest_for("truth"),
        "lensing": lensing.model_dump(mode="json"),
        "structure": structure,
        "bright_stars": None if bright_stars is None else digest(bright_stars.tolist()),
    }


def write_brick(
    path: PathLike,
    pix: int,
    *,
    seed: int,
    universe: Universe,
    camera: Camera,
    lensing: Lensing,
    structure: str = "haloes",
    bright_stars: FloatArray | None = None,
) -> None:
    """Make brick `pix` and write it (temporary name, fsync, rename)."""
    make_brick(seed, pix, universe, camera, lensing, structure, bright_stars).write(path)


def read_brick(path: PathLike, expect: Mapping[str, Any] | None = None) -> ObjectTable:
    """Read a brick's file. Raises InputError if it is unreadable or its record differs from `expect` (brick_meta)."""
    table = ObjectTable.read(path)
    if table.meta.get("product") != "truth brick":
        raise InputError("not a truth brick", file=path, key="product", value=table.meta.get("product"))
    for key, value in (expect or {}).items():
        if table.meta.get(key) != value:
            raise InputError(
                "the brick was made for another configuration; make it again",
                file=path,
                key=key,
                value=table.meta.get(key),
                allowed=value,
            )
    missing = next((name for name in COLUMNS if name not in table), None)
    if missing:
        raise InputError("made before bricks had this column; remove it and make it again", file=path, key=missing)
    return table


class Positions(NamedTuple):
    """Positions of objects (n,): ra, dec [deg] and order-29 nested HEALPix pixels."""

    ra: FloatArray
    dec: FloatArray
    healpix: IntArray


def random_positions(pix: int, generator: np.random.Generator, count: int) -> Positions:
    """Return `count` uniform random positions in brick `pix`."""
    bits = 2 * (HATS_ORDER - ORDER)
    healpix = (np.int64(pix) << bits) + generator.integers(0, 1 << bits, count)
    return Positions(*pixel_centre(1 << HATS_ORDER, healpix), healpix)


def _stars(seed: int, pix: int, universe: Universe, camera: Camera) -> ObjectTable:
    from csstsim.universe.stars.stars import draw_stars

    with universe.faults_of("stars"):
        sample_positions = partial(random_positions, pix)
        columns = draw_stars(_streams(seed, pix, "stars"), pix, sample_positions, universe.numbers["stars"])
    radius = columns.pop("radius")
    distance = columns.pop("distance")
    columns |= {name: columns.pop(own) for name, own in COMPANION.items()}
    columns |= {
        "sed_scale": (radius * SOLAR_RADIUS_PC / distance) ** 2,
        "av": universe.r_v * universe.dust.star_ebv(columns["ra"], columns["dec"], distance),
    }
    return _complete(STAR, columns, camera)


def _bright(pix: int, universe: Universe, camera: Camera, stars: FloatArray) -> ObjectTable:
    from csstsim.universe.stars.bright_stars import bright_stars

    with universe.faults_of("stars"):
        columns = bright_stars(pix, stars, universe.star_seds, universe.numbers["stars"])
    return _complete(STAR, columns, camera)


def _galaxies(seed: int, pix: int, universe: Universe, camera: Camera, lensing: Lensing, structure: str) -> ObjectTable:
    streams = _streams(seed, pix, "galaxies")
    if structure == "none":
        columns = _population(universe, camera).draw(streams, AREA_DEG2)
        positions = random_positions(pix, streams("position"), len(columns["z"]))
    else:
        columns = _clustered(seed, universe, camera, structure).draw(pix, streams, AREA_DEG2)
        positions = Positions(columns["ra"], columns["dec"], columns["_healpix_29"])
    _add_positions(columns, positions, seed, pix, universe, lensing, structure)
    return _complete(GALAXY, columns, camera)


@lru_cache(maxsize=4)
def _clustered(seed: int, universe: Universe, camera: Camera, structure: str) -> ClusteredGalaxies:
    """The galaxy population in haloes or along the smooth density of one campaign seed."""
    from csstsim.universe.galaxies.clustered import ClusteredGalaxies
    from csstsim.universe.galaxies.occupation import Occupation

    population = _population(universe, camera)
    matter = universe.matter_field(seed, haloes=structure == "haloes")
    haloes = universe.numbers["structure"]["haloes"]
    drawn = None
    if matter.haloes is not None:
        drawn = np.log10(haloes["tiers"][0]), haloes["z_min"], haloes["z_max"]
    occupation = Occupation(universe.numbers["occupation"], population.grid, matter.mass_function, drawn)
    return ClusteredGalaxies(population, occupation, matter)


@lru_cache(maxsize=4)
def _population(universe: Universe, camera: Camera) -> GalaxyPopulation:
    """The galaxy population, with counts in the i band of CSST without the Milky Way's dust.

    So the galaxies do not depend on the camera (config/universe/galaxies.yaml).
    """
    from csstsim.universe.galaxies.galaxies import GalaxyPopulation

    csst = camera if camera.shipped else load_camera()
    filter_ = csst.bands["i"]
    weights = subband_weights(filter_, csst.telescope).sum(axis=0, keepdims=True)
    zeropoint = filter_.zeropoint(csst.telescope)
    return GalaxyPopulation(universe.numbers["galaxies"], universe.galaxy_seds, universe.cosmology, weights, zeropoint)


def _quasars(
    seed: int, pix: int, universe: Universe, camera: Camera, galaxies: ObjectTable, lensing: Lensing, structure: str
) -> ObjectTable:
    """Quasars have the positions of their hosts; one without a host has a random position."""
    from csstsim.universe.quasars.quasars import draw_quasars

    streams = _streams(seed, pix, "quasars")
    columns = draw_quasars(streams, AREA_DEG2, galaxies, universe.numbers["quasars"], universe.cosmology)
    positions = random_positions(pix, streams("position"), len(columns["z"]))
    host = columns["host"]
    if len(galaxies):
        of_hosts = [galaxies[name][np.maximum(host, 0)] for name in ("ra", "dec", "_healpix_29")]
        positions = Positions(
            *(np.where(host >= 0, hosted, random) for hosted, random in zip(of_hosts, positions, strict=True))
        )
    _add_positions(columns, positions, seed, pix, universe, lensing, structure)
    return _complete(QUASAR, columns, camera)


def _add_positions(
    columns: dict[str, AnyArray],
    positions: Positions,
    seed: int,
    pix: int,
    universe: Universe,
    lensing: Lensing,
    structure: str,
) -> None:
    """Add position, extinction by the whole dust column and lensing to the columns of extragalactic objects."""
    from csstsim.universe.lensing.lensing import lens, stretch

    field = _matter(seed, universe, structure) if lensing.field == "cosmic" else None
    ra, dec, healpix = positions
    columns |= {"ra": ra, "dec": dec, "_healpix_29": healpix, "av": universe.r_v * universe.dust.ebv(ra, dec)}
    columns |= lens(pix, ra, dec, columns["z"], lensing, field)
    if (
        structure == "haloes" and field is not None
    ):  # next to a critical curve a galaxy is an arc, which thin shear draws as a line
        arc = stretch(*(columns[name] for name in ("kappa", "gamma1", "gamma2")))
        columns["flags"] = np.where(arc > universe.numbers["lensing"]["stretch_max"], STRONG_LENSING, 0)


def _matter(seed: int, universe: Universe, structure: str) -> MatterField | LensingField:
    """The matter that lenses: the MatterField that galaxies follow, too, or the LensingField of `none`."""
    if structure == "none":
        return universe.lensing_field(seed)
    return universe.matter_field(seed, haloes=structure == "haloes")


def _complete(obj_type: int, columns: Mapping[str, AnyArray], camera: Camera) -> ObjectTable:
    """Return the ObjectTable of one kind of object, its columns in order; magnitudes are added later."""
    count = len(columns["ra"])
    tail = {name: np.asarray(columns.get(name, np.zeros(count)), np.float32) for name in SED_COLUMNS}
    tail["_healpix_29"] = columns["_healpix_29"]
    head = {name: values for name, values in columns.items() if name in COLUMNS}
    return ObjectTable.complete(head | {"obj_type": np.full(count, obj_type, np.int8)} | tail, camera.bands)


def with_magnitudes(table: ObjectTable, universe: Universe, camera: Camera) -> ObjectTable:
    """Return a table of the embedded sky with the magnitudes of its spectra in the camera's bands."""
    weights = _weights(camera)
    many = _band_rates(universe, camera) if (table["obj_type"] == GALAXY).any() else None
    light = rates(universe, table, weights, many)
    return table.with_columns(
        **{
            f"mag_{band}": rate_to_mag(light[:, k], filter_, camera.telescope).astype(np.float32)
            for k, (band, filter_) in enumerate(camera.bands.items())
        }
    )


@lru_cache(maxsize=4)
def _band_rates(universe: Universe, camera: Camera) -> BandRates | None:
    """Tables of galaxies' light in the shipped bands, for all bricks of a process; None for a camera with others.

    Those may be too sharp for tables.
    """
    from csstsim.universe.galaxies.band_rates import BandRates

    weights = _weights(camera)
    if not (camera.shipped or np.array_equal(weights, _weights(load_camera()))):
        return None
    return BandRates(universe.galaxy_seds, weights)


def _weights(camera: Camera) -> FloatArray:
    return np.stack([subband_weights(f, camera.telescope).sum(axis=0) for f in camera.bands.values()])


def _streams(seed: int, pix: int, kind: str) -> Callable[[str], np.random.Generator]:
    return lambda name: stream(seed, "brick", pix, kind, name)
