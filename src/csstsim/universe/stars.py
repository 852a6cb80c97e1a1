"""Stars of the embedded universe: density laws x initial mass function x evolution, and motions in six dimensions.

    dN / dOmega = sum over components of integral rho(l, b, d) / rho(Sun) x n(bright < V - 5 log10(d / 10 pc) < faint) d^2 dd

Laws in milky_way, types of stars in star_types and stellar_evolution, motions in kinematics, numbers in
config/universe/stars.yaml. The limits hold for V without extinction. The counts at the corners of a brick are summed
along the sight-line; inside it they go bilinearly between the corners, so the sky has no seams: neighbours share them.
Left out: binaries, clusters, streams, the warp, spiral arms, extinction in the choice (bricks dim what is chosen).
"""

import json
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from csstsim.universe.kinematics import galactic_velocity, sky_motion
from csstsim.universe.milky_way import density, direction
from csstsim.universe.star_types import COLUMNS, Types, make_types

_CHUNK = 256  # sight-lines at a time, for memory
_NSIDE, _BITS = 256, 21  # a brick is 2^21 x 2^21 pixels of order 29
_MODULUS = np.arange(-5.0, 27.0, 0.1)  # edges of the steps in distance modulus: 1 pc to 2.3 Mpc
_PC_PER_KPC = 1000.0
_SQUARE_DEGREE = (np.pi / 180.0) ** 2


@dataclass(frozen=True, eq=False)
class Galaxy:
    """The Galaxy that the numbers make; cached by `galaxy`."""

    numbers: dict
    types: list[Types]

    def rates(self, ra, dec, faint):
        """Yield, for each of the types, (p, steps): stars deg-2 with V < faint in each step of distance at ra, dec."""
        middle = 0.5 * (_MODULUS[1:] + _MODULUS[:-1])
        position = direction(ra, dec)[:, :, None] * (_parsec(middle) / _PC_PER_KPC)
        volume = np.diff(_parsec(_MODULUS) ** 3) / 3.0 * _SQUARE_DEGREE  # pc3 / deg2
        law = {
            c.name: density(c, position, self.numbers)
            for c in {types.component.name: types.component for types in self.types}.values()
        }
        bright = self.numbers["limits"][0]
        for types in self.types:
            yield (
                law[types.component.name] * volume * (types.brighter(faint - middle) - types.brighter(bright - middle))
            )


def _parsec(modulus):
    return 10.0 ** (0.2 * modulus + 1.0)


def galaxy(numbers):
    """Return the Galaxy of the numbers (config/universe/stars.yaml as read)."""
    return _galaxy(json.dumps(numbers))


@lru_cache(maxsize=4)
def _galaxy(text):
    numbers = json.loads(text)
    return Galaxy(numbers, make_types(numbers))


def expected_counts(ra, dec, numbers, v_max):
    """Return the expected stars per deg2 between the bright limit and V = v_max (a float), of the shape of ra, dec."""
    model = galaxy(numbers)
    ra, dec = np.broadcast_arrays(np.asarray(ra, float), np.asarray(dec, float))
    out = np.empty(ra.size)
    for part in np.array_split(np.arange(ra.size), -(-ra.size // _CHUNK) or 1):
        out[part] = sum(rate.sum(axis=1) for rate in model.rates(ra.flat[part], dec.flat[part], v_max))
    return out.reshape(ra.shape)


def draw_stars(rng, pix, place, numbers):
    """Return the columns of the stars of brick `pix` as a dict of arrays of one length.

    rng(name): the numpy Generator of one quantity; place(generator, count): ra, dec [deg] and order-29 HEALPix pixels
    of uniform random positions in the brick. Columns: ra, dec [deg], _healpix_29, teff [K], logg, feh, stellarmass
    [Msun], radius [Rsun], distance [pc], parallax [mas], pmra (with cos dec), pmdec [mas/yr], rv [km/s].
    """
    model = galaxy(numbers)
    bright, faint = numbers["limits"]
    rates = np.stack(list(model.rates(*_corners(pix), faint)), axis=1)
    totals = rates.sum(axis=(1, 2))
    count = rng("count").poisson(totals.max() * _area())
    ra, dec, healpix = place(rng("position"), count)
    share = _bilinear(healpix) * totals
    density_ = share.sum(axis=1)
    keep = rng("thinning").random(count) * totals.max() < density_
    ra, dec, healpix, share = ra[keep], dec[keep], healpix[keep], share[keep] / density_[keep, None]
    count = len(ra)
    u = rng("cell").random((2, count))
    corner = np.minimum((u[0, :, None] > np.cumsum(share, axis=1)).sum(axis=1), 3)
    flat = rates.reshape(4, -1).cumsum(axis=1)
    cell = np.empty(count, np.int64)
    for k in range(4):
        mine = corner == k
        cell[mine] = np.searchsorted(flat[k], u[1, mine] * flat[k, -1], side="right")
    kind, step = np.divmod(cell, rates.shape[2])
    # Evenly in volume within the step, whose rate is that of its middle.
    v = rng("distance").random(count)
    near, far = 10 ** (0.6 * _MODULUS[step]), 10 ** (0.6 * _MODULUS[step + 1])
    distance = 10.0 * (near + v * (far - near)) ** (1 / 3)
    modulus = 5.0 * np.log10(distance / 10.0)
    chosen, position = rng("type").random(count), direction(ra, dec) * distance / _PC_PER_KPC
    normal = rng("velocity").standard_normal((3, count))
    columns = np.empty((len(COLUMNS), count))
    velocity = np.empty((3, count))
    for k, types in enumerate(model.types):
        mine = np.flatnonzero(kind == k)
        columns[:, mine] = types.choose(chosen[mine], bright - modulus[mine], faint - modulus[mine])
        velocity[:, mine] = galactic_velocity(types.component, normal[:, mine], position[:, mine], numbers)
        radial = np.hypot(position[0, mine] - numbers["sun"]["r0"], position[1, mine])
        columns[3, mine] += types.component.gradient * (radial - numbers["sun"]["r0"])
    _, teff, logg, feh, mass, radius = columns
    pmra, pmdec, rv = sky_motion(ra, dec, distance / _PC_PER_KPC, velocity)
    return {
        "ra": ra, "dec": dec, "_healpix_29": healpix, "teff": teff, "logg": logg, "feh": feh, "stellarmass": mass,
        "radius": radius, "distance": distance, "parallax": 1000.0 / distance, "pmra": pmra, "pmdec": pmdec, "rv": rv,
    }  # fmt: skip


def _area():
    return 4 * 180.0**2 / np.pi / (12 * _NSIDE**2)


def _corners(pix):
    """Return ra, dec [deg] of the brick's corners: north, west, south, east."""
    import healpy

    vectors = healpy.boundaries(_NSIDE, pix, nest=True)
    return healpy.vec2ang(vectors.T, lonlat=True)


def _bilinear(healpix):
    """Return (n, 4) weights of the corners at order-29 pixels of a brick."""
    x, y = (_every_other(healpix >> shift) / (1 << _BITS) for shift in (0, 1))
    return np.stack([x * y, (1 - x) * y, (1 - x) * (1 - y), x * (1 - y)], axis=1)


def _every_other(bits):
    """The number that the lowest _BITS even bits make."""
    out = np.zeros_like(bits)
    for k in range(_BITS):
        out |= ((bits >> (2 * k)) & 1) << k
    return out
