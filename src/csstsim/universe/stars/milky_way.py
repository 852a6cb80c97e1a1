"""Density laws of the Milky Way: a thin disc of seven ages, thick disc, halo and bulge (Robin et al. 2003).

Galactic axes: X towards the centre, Y towards l = 90 deg, Z towards the north pole, origin at the Sun, kpc. Left out:
warp, spiral arms, streams, clusters, the bulge's tilt out of the plane.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from csstsim.base.sphere import frames, ra_dec, unit_vectors
from csstsim.base.types import FloatArray, Floats

# Galactic frame in the ICRS (ESA 1997, Hipparcos vol. 1, 1.5.3): north pole, longitude of the ascending node.
_POLE = np.radians([192.85948, 27.12825])
_NODE = np.radians(32.93192)


def _axes() -> FloatArray:
    pole, node, _ = frames(*_POLE)  # the galactic plane crosses the equator northwards at the pole's east
    third = np.cross(pole, node)
    return np.array([np.cos(_NODE) * node - np.sin(_NODE) * third, np.sin(_NODE) * node + np.cos(_NODE) * third, pole])


GALACTIC = _axes()  # rows: the galactic axes in the ICRS


def direction(ra: Floats, dec: Floats) -> FloatArray:
    """Return (3, ...) galactic unit vectors of ICRS positions [deg]."""
    vectors = np.ascontiguousarray(np.moveaxis(unit_vectors(ra, dec), -1, 0))  # einsum's rounding depends on the order
    return np.einsum("ij,j...->i...", GALACTIC, vectors)


def equatorial(l: Floats, b: Floats) -> tuple[FloatArray, FloatArray]:  # noqa: E741
    """Return ra, dec [deg] of galactic positions [deg]."""
    return ra_dec(unit_vectors(l, b) @ GALACTIC)


@dataclass(frozen=True)
class Component:
    """One row of `components`; ages in Gyr, `density` in 1e-3 Msun / pc3 at the Sun, speeds in km/s, `imf` slopes."""

    name: str
    law: str
    age0: float
    age1: float
    density: float
    eps: float
    feh: float
    feh_sd: float
    gradient: float
    sigma_u: float
    sigma_v: float
    sigma_w: float
    rotation: float
    imf: Sequence[float]


def components(numbers: Mapping[str, Any]) -> list[Component]:
    """Return the Components of the numbers (config/universe/stars.yaml)."""
    table = numbers["components"]
    return [Component(**dict(zip(table["columns"], row, strict=True))) for row in table["rows"]]


def density(component: Component, position: FloatArray, numbers: Mapping[str, Any]) -> FloatArray:
    """Return the density at (3, ...) galactic positions [kpc], 1 at the Sun (the bulge: 1 at the centre)."""
    sun = numbers["sun"]
    laws = numbers["laws"]
    x = position[0] - sun["r0"]
    y = position[1]
    z = position[2] + sun["z"]
    r = np.hypot(x, y)
    r0 = sun["r0"]
    shape = LAWS[component.law]
    law = laws[component.law]
    height_factor = 1.0
    if component.law in _FLARING:
        start, slope = laws["flare"]
        height_factor = 1 + slope * np.maximum(r - start, 0.0)  # the number of stars in a column does not change
    value = shape(_Point(r, z / height_factor, x, y), component.eps, r0, law) / height_factor
    if component.law == "bulge":
        return value
    return value / shape(_Point(r0, sun["z"], -r0, 0.0), component.eps, r0, law)


class _Point(NamedTuple):
    """Positions about the galactic centre [kpc]: distance from the axis, height, and x (away from the Sun), y."""

    r: Floats
    z: Floats
    x: Floats
    y: Floats


def _young(at: _Point, eps: float, r0: float, law: Sequence[float]) -> FloatArray:
    disc, hole = law
    a2 = at.r**2 + (at.z / eps) ** 2
    return np.exp(-a2 / disc**2) - np.exp(-a2 / hole**2)


def _disc(at: _Point, eps: float, r0: float, law: Sequence[float]) -> FloatArray:
    disc, hole = law
    a2 = at.r**2 + (at.z / eps) ** 2
    return np.exp(-np.sqrt(0.25 + a2 / disc**2)) - np.exp(-np.sqrt(0.25 + a2 / hole**2))


def _thick(at: _Point, eps: float, r0: float, law: Sequence[float]) -> FloatArray:
    scale, hz, xl = law
    z = np.abs(at.z)
    low = 1.0 - z**2 / (xl * (2 * hz + xl))
    return np.exp(-(at.r - r0) / scale) * np.where(z < xl, low, np.exp((xl - z) / hz) / (1.0 + xl / (2 * hz)))


def _halo(at: _Point, eps: float, r0: float, law: Sequence[float]) -> FloatArray:
    power, core, edge, steep = law
    a = np.maximum(np.sqrt(at.r**2 + (at.z / eps) ** 2), core)
    return (a / r0) ** power * (np.maximum(a, edge) / edge) ** (steep - power)


def _bulge(at: _Point, eps: float, r0: float, law: Sequence[float]) -> FloatArray:
    x0, y0, z0, cut, width, angle = law
    turn = np.radians(90.0 - angle)
    # The near end of the long axis lies at positive longitude.
    along = -at.x * np.cos(turn) + at.y * np.sin(turn)
    across = at.x * np.sin(turn) + at.y * np.cos(turn)
    rs2 = np.sqrt(((along / x0) ** 2 + (across / y0) ** 2) ** 2 + (at.z / z0) ** 4)
    return np.exp(-0.5 * rs2 - 0.5 * (np.maximum(at.r - cut, 0.0) / width) ** 2)


_FLARING = ("young", "disc", "thick")
LAWS = {"young": _young, "disc": _disc, "thick": _thick, "halo": _halo, "bulge": _bulge}
