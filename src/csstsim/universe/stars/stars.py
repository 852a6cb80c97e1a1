"""Stars of the embedded universe: density laws x initial mass function x evolution, and motions in six dimensions.

    dN / dOmega = sum over components of integral rho(l, b, d) / rho(Sun) n(bright <= M_V + mu < faint) d^2 dd

with mu = 5 log10(d / 10 pc) and n the local number of stars per pc3 (Robin et al. 2003, A&A 409, 523). Laws in
milky_way, types of stars in star_types and stellar_evolution, motions in kinematics, numbers in
config/universe/stars.yaml. The limits hold for V without extinction. Counts are summed along the sight-line at the
corners of a brick and interpolated bilinearly in it. Neighbours share corners, so the sky is continuous. [Fe/H] follows
the radial gradient at the star's position; its other parameters do not change with it. The density is that of systems:
companions (binaries) are added to it. Left out: clusters, streams, the warp, spiral arms, extinction in the selection
(truth bricks dim the selected stars).
"""

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import hpgeom
import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.healpix import BRICKS, HATS_ORDER, NSIDE, ORDER, every_other, pixel_border
from csstsim.base.types import AnyArray, FloatArray, Floats, IntArray
from csstsim.universe.stars.binaries import Companions, join, separations, wide
from csstsim.universe.stars.kinematics import galactic_velocity, sky_motion
from csstsim.universe.stars.milky_way import components, density, direction
from csstsim.universe.stars.star_types import COLUMNS, Types, make_types

STARS_MAX = 3e6  # per brick: about 2 GB
_CHUNK = 256  # sight-lines at a time, to limit memory
_BITS = HATS_ORDER - ORDER  # a brick is 2^21 x 2^21 pixels of order 29
_MODULUS = np.arange(-5.0, 27.0, 0.1)  # edges of the steps in distance modulus: 1 pc to 2.3 Mpc
_PC_PER_KPC = 1000.0
AREA_DEG2 = 4 * 180.0**2 / np.pi / BRICKS
_SQUARE_DEGREE = (np.pi / 180.0) ** 2
_FEH = COLUMNS.index("feh")


@dataclass(frozen=True, eq=False)
class Galaxy:
    """The model of the Galaxy defined by the numbers; cached by `galaxy`."""

    numbers: dict[str, Any]
    types: list[Types]

    def rates(self, ra: FloatArray, dec: FloatArray, faint: float) -> Iterator[FloatArray]:
        """Yield, for each of the types, (p, steps): stars deg-2 with V < faint in each step of distance at ra, dec."""
        middle = 0.5 * (_MODULUS[1:] + _MODULUS[:-1])
        position = direction(ra, dec)[:, :, None] * (_parsec(middle) / _PC_PER_KPC)
        volume = np.diff(_parsec(_MODULUS) ** 3) / 3.0 * _SQUARE_DEGREE  # pc3 / deg2
        law = {c.name: density(c, position, self.numbers) for c in components(self.numbers)}
        bright = self.numbers["limits"][0]
        for types in self.types:
            yield (
                law[types.component.name] * volume * (types.brighter(faint - middle) - types.brighter(bright - middle))
            )


def _parsec(modulus: FloatArray) -> FloatArray:
    return 10.0 ** (0.2 * modulus + 1.0)


def galaxy(numbers: Mapping[str, Any]) -> Galaxy:
    """Return the Galaxy of the numbers (config/universe/stars.yaml as read).

    Raises InputError for a number that is missing or wrong.
    """
    return _galaxy(json.dumps(numbers))


@lru_cache(maxsize=4)
def _galaxy(text: str) -> Galaxy:
    numbers = json.loads(text)
    try:
        return Galaxy(numbers, make_types(numbers))
    except (KeyError, TypeError, ValueError, IndexError) as exc:
        what = f"a number is missing or wrong: {type(exc).__name__} {exc}"
        raise InputError(what, file="universe/stars.yaml") from exc


def expected_counts(ra: Floats, dec: Floats, numbers: Mapping[str, Any], v_max: float) -> FloatArray:
    """Return the expected stars per deg2 between the bright limit and V = v_max (float), in the shape of ra, dec."""
    model = galaxy(numbers)
    ra, dec = np.broadcast_arrays(np.asarray(ra, float), np.asarray(dec, float))
    out = np.empty(ra.size)
    for part in np.array_split(np.arange(ra.size), -(-ra.size // _CHUNK) or 1):
        out[part] = sum(rate.sum(axis=1) for rate in model.rates(ra.flat[part], dec.flat[part], v_max))
    return out.reshape(ra.shape)


def draw_stars(
    rng: Callable[[str], np.random.Generator],
    pix: int,
    sample_positions: Callable[[np.random.Generator, int], tuple[FloatArray, FloatArray, IntArray]],
    numbers: Mapping[str, Any],
) -> dict[str, AnyArray]:
    """Return the columns of the stars of brick `pix` as a dict of arrays of one length.

    rng(name): the numpy Generator of one quantity; sample_positions(generator, count): ra, dec [deg] and order-29
    HEALPix pixels of uniform random positions in the brick. Columns: ra, dec [deg], _healpix_29, teff [K], logg, feh,
    stellarmass [Msun], radius [Rsun], distance [pc], parallax [mas], pmra (with cos dec), pmdec [mas/yr], rv [km/s];
    teff2 [K], logg2, area2 of a close companion (0: none). Wide companions are the last rows. The limits of V apply at
    a star's own distance, to half a step in the last steps of a component.
    """
    model = galaxy(numbers)
    ra, dec, healpix, kind, step = _draw_cells(rng, pix, sample_positions, model)
    near3 = _parsec(_MODULUS[step]) ** 3
    far3 = _parsec(_MODULUS[step + 1]) ** 3
    distance = (near3 + rng("distance").random(len(ra)) * (far3 - near3)) ** (1 / 3)
    position = direction(ra, dec) * distance / _PC_PER_KPC
    columns, pair, velocity = _draw_types(rng, kind, distance, position, model)
    motion = sky_motion(ra, dec, distance / _PC_PER_KPC, velocity)
    columns = {"ra": ra, "dec": dec, "_healpix_29": healpix, **columns, "distance": distance}
    columns |= {"parallax": 1000.0 / distance, **motion._asdict()}
    return _add_companions(rng, columns, pair, pix, numbers)


class _Cells(NamedTuple):
    """Positions of stars (n,): ra, dec [deg], order-29 pixel, and indices of their types and steps of distance."""

    ra: FloatArray
    dec: FloatArray
    healpix: IntArray
    kind: IntArray
    step: IntArray


class _TypedStars(NamedTuple):
    """Stars with types: truth columns (n,), rows of Companions (8, n), galactic velocities (3, n) [km/s]."""

    columns: dict[str, AnyArray]
    pair: FloatArray
    velocity: FloatArray


def _add_companions(
    rng: Callable[[str], np.random.Generator],
    columns: dict[str, AnyArray],
    pair: FloatArray,
    pix: int,
    numbers: Mapping[str, Any],
) -> dict[str, AnyArray]:
    """Return the columns with close companions in teff2, logg2 and area2, and wide ones as rows at the end."""
    chance, quantile, tilt, turn = rng("companions").random((4, pair.shape[1]))
    companion = Companions(*pair)
    distance = columns["distance"]
    separation = separations(quantile, tilt, pair, distance, numbers["binaries"]["widest"])
    separation = np.where(chance < companion.probability, separation, np.inf)
    bright, faint = numbers["limits"]
    v = companion.m_v + 5.0 * np.log10(distance) - 5.0
    join(columns, pair, separation, numbers)
    wide_stars = wide(columns, pair, separation, turn, pix, (bright <= v) & (v < faint), numbers)
    return {name: np.concatenate([values, wide_stars[name]]) for name, values in columns.items()}


def _draw_cells(
    rng: Callable[[str], np.random.Generator],
    pix: int,
    sample_positions: Callable[[np.random.Generator, int], tuple[FloatArray, FloatArray, IntArray]],
    model: Galaxy,
) -> _Cells:
    """Return the _Cells of a Poisson number of stars."""
    rates = np.stack(list(model.rates(*_corners(pix), model.numbers["limits"][1])), axis=1)
    totals = rates.sum(axis=(1, 2))
    if totals.max() * AREA_DEG2 > STARS_MAX:
        count = f"{totals.max() * AREA_DEG2:.3g}"
        raise InputError(
            f"brick {pix} would hold {count} stars: it is near the Galactic plane, or the limits are too faint",
            file="universe/stars.yaml",
            key="limits",
            value=model.numbers["limits"],
            allowed=f"{STARS_MAX:g} stars a brick",
        )
    count = rng("count").poisson(totals.max() * AREA_DEG2)
    ra, dec, healpix = sample_positions(rng("position"), count)
    from_corners = _bilinear(healpix) * totals
    density_at = from_corners.sum(axis=1)
    keep = rng("thinning").random(count) * totals.max() < density_at
    # Draw a corner by its fraction of the density, then one of that corner's cells.
    u = rng("cell").random((2, keep.sum()))
    before = u[0, :, None] * density_at[keep, None] >= np.cumsum(from_corners[keep], axis=1)
    corner = np.minimum(before.sum(axis=1), 3)
    summed = rates.reshape(4, -1).cumsum(axis=1)
    cell = np.empty(len(corner), np.int64)
    for k in range(4):
        rows = corner == k
        cell[rows] = np.searchsorted(summed[k], u[1, rows] * summed[k, -1], side="right")
    kind, step = np.divmod(cell, rates.shape[2])
    return _Cells(ra[keep], dec[keep], healpix[keep], kind, step)


def _draw_types(
    rng: Callable[[str], np.random.Generator], kind: IntArray, distance: FloatArray, position: FloatArray, model: Galaxy
) -> _TypedStars:
    """Return the _TypedStars of stars at galactic positions (3, n) [kpc]; kind: indices of `model.types`."""
    bright, faint = model.numbers["limits"]
    modulus = 5.0 * np.log10(distance) - 5.0
    r0 = model.numbers["sun"]["r0"]
    chosen = rng("type").random(len(kind))
    normal = rng("velocity").standard_normal((3, len(kind)))
    table = np.empty((len(COLUMNS), len(kind)))
    pair = np.empty((len(Companions._fields), len(kind)))
    velocity = np.empty((3, len(kind)))
    for k, types in enumerate(model.types):
        rows = np.flatnonzero(kind == k)
        at = position[:, rows]
        row = types.choose(chosen[rows], bright - modulus[rows], faint - modulus[rows])
        table[:, rows] = types.table[:, row]
        pair[:, rows] = types.pair[:, row]
        table[_FEH, rows] += types.component.gradient * (np.hypot(at[0] - r0, at[1]) - r0)
        velocity[:, rows] = galactic_velocity(types.component, normal[:, rows], at, model.numbers)
    return _TypedStars(dict(zip(COLUMNS[1:], table[1:], strict=True)), pair, velocity)


def _corners(pix: int) -> tuple[FloatArray, FloatArray]:
    """Return ra, dec [deg] of the brick's corners: north, west, south, east."""
    theta, phi = hpgeom.vector_to_angle(pixel_border(NSIDE, pix), lonlat=False)
    return np.degrees(phi), 90.0 - np.degrees(theta)


def _bilinear(healpix: IntArray) -> FloatArray:
    """Return (n, 4) weights of the corners at order-29 pixels of a brick."""
    x = every_other(healpix, _BITS) / (1 << _BITS)
    y = every_other(healpix >> 1, _BITS) / (1 << _BITS)
    return np.stack([x * y, (1 - x) * y, (1 - x) * (1 - y), x * (1 - y)], axis=1)
