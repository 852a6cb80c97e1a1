"""Radial profiles of galaxies convolved with PSF and pixel: tables of discs and bulges for `total_light`.

A profile is the mean over the angle of an elliptical galaxy, convolved with the mean over the angle of the PSF and its
pixel, per px^2, for a source of flux 1. Both means are Hankel transforms, so the convolution is a product:

    P(r) = 1 / (2 pi) int S(k) T(k) J_0(k r) k dk,

S the transform of the galaxy, T that of the PSF. The PSF's box does not contain all the flux: the rest is scattered
further than most galaxies are measured. So T(0) < 1, and the flux of a fit is the total flux.

A family has the profiles of a sky's galaxies: discs with bulges, or Sersic profiles of any index. Either family fits
galaxies of the other, with a wrong total: the index that fits a bulge gives its disc wide wings (0.05 to 0.1 mag too
bright), and a disc with a bulge has fainter wings than a profile of index 2 (0.05 mag too faint).
measure.light.family chooses between them.

Between nodes a profile is linear in r^2; at the nodes it has the least-squares values.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from csstsim.base.types import FloatArray, IntArray
from csstsim.catalog.profiles.sersic import light_beyond

if TYPE_CHECKING:
    from csstsim.optics.psf.psf_file import PsfSet

SIZES = 0.25 * 2.0 ** (np.arange(33) / 4)  # px: half-light radii sqrt(a b)
BULGE_SIZE = 0.5  # half-light radius of a bulge over that of its disc
AXIS_RATIOS = np.array([1.0, 0.8, 0.6, 0.45, 0.3, 0.2])
REACH = 128.0  # px: largest radius
GROWTH = 1.33  # of r^2 from node to node
GAAP_FWHM = 1.0  # arcsec, of the Gaussian aperture for colours
PART_PX = 2400  # px: maximum size of the parts of the frame in which the PSF's mean over the angle is constant
_K_MAX = 2.0 * np.pi  # per px: nothing passes a pixel and an optical system this fine
_ORDER = 16  # of the quadrature in each panel of k
_PER_CYCLE = 3.2  # its points for each cycle of J_0 at the largest radius
_ANGLES = (np.arange(24) + 0.5) * np.pi / 48.0  # a quadrant


class ProfileFamily(NamedTuple):
    """Kinds of profile by concentration: Sersic index of the disc and of the bulge, fraction of the flux in the bulge.

    `fractions`: of galaxies that are of each kind, relative; an assumption, of little weight (total_light says where).
    """

    name: str
    kinds: tuple[tuple[float, float, float], ...]
    fractions: tuple[float, ...]


BULGES = ProfileFamily(
    "discs with bulges",
    (
        (0.5, 4.0, 0.0),
        (0.7, 4.0, 0.0),
        (1.0, 4.0, 0.0),
        (1.0, 4.0, 0.1),
        (1.0, 4.0, 0.2),
        (1.0, 4.0, 0.35),
        (1.0, 4.0, 0.5),
        (1.0, 4.0, 0.75),
        (1.0, 4.0, 1.0),
        (1.0, 6.0, 1.0),
    ),
    (0.3, 0.5, 1.0, 1.0, 1.0, 1.0, 1.0, 1.5, 2.6, 2.6),
)
SERSIC = ProfileFamily(
    "Sersic",
    tuple((index, 4.0, 0.0) for index in (0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0, 6.0)),
    (0.3, 0.5, 1.0, 1.8, 1.9, 1.8, 2.6, 2.6),  # kinds of both families have the same part in both, for their choice
)
FAMILIES = (BULGES, SERSIC)


@dataclass(frozen=True)
class ProfileTables:
    """Profiles at the nodes, for parts of a frame.

    `family`: of the profiles, with J kinds. `nodes` (K,): r^2, px^2, multiples of 1/2. float32, per px^2: `point`
    (parts, K, 1), `galaxy` (parts, AXIS_RATIOS, K, SIZES x J). `gaap` (AXIS_RATIOS, SIZES, J): fraction of the flux in
    the Gaussian aperture for colours, before the PSF.
    `pixel`: arcsec; `origin`: of the frame on the chip, px; `step`: width and height of a part, px; `across`: parts
    in a row.
    """

    family: ProfileFamily
    nodes: FloatArray
    point: FloatArray
    galaxy: FloatArray
    gaap: FloatArray
    pixel: float
    origin: tuple[int, int]
    step: tuple[float, float]
    across: int

    def part(self, x: FloatArray, y: FloatArray) -> IntArray:
        """Return the index (n,) of the part at positions on the chip, px; outside the frame that of the nearest."""
        x0, y0 = self.origin
        width, height = self.step
        column = np.clip((np.nan_to_num(x) - x0) // width, 0, self.across - 1).astype(np.int64)
        row = np.clip((np.nan_to_num(y) - y0) // height, 0, self.across - 1).astype(np.int64)
        return row * self.across + column


def profile_tables(
    psf: PsfSet, origin: tuple[int, int], shape: tuple[int, int], pixel: float, families: tuple[ProfileFamily, ...]
) -> tuple[ProfileTables, ...]:
    """Return the `ProfileTables` of a frame for each family.

    `psf`, `origin`, `shape` as in `photometry.psf_model`, `pixel`: arcsec.
    """
    from scipy.special import j0

    across = int(np.ceil(max(shape) / PART_PX))
    x0, y0 = origin
    ny, nx = shape
    width = nx / across
    height = ny / across
    middle = np.arange(across) + 0.5
    positions = [(x0 + i * width, y0 + j * height) for j in middle for i in middle]
    nodes = _nodes(REACH**2)
    k, weight = _wavenumbers(float(np.sqrt(nodes[-1])))
    radius, to_nodes = _projection(nodes)
    back = (to_nodes @ (j0(radius[:, None] * k) * (k * weight / (2.0 * np.pi)))).astype(np.float32)
    variance = (GAAP_FWHM / pixel) ** 2 / (8.0 * np.log(2.0))
    aperture = variance * np.exp(-0.5 * variance * k**2) * k * weight
    galaxies = [_galaxy_transforms(k, family.kinds) for family in families]
    gaap = [galaxy @ aperture for galaxy in galaxies]
    transforms = [galaxy.reshape(-1, k.size).astype(np.float32).T for galaxy in galaxies]
    point = []
    convolved: list[list[FloatArray]] = [[] for _ in families]
    for transform in _psf_transforms(psf, positions, k):
        at_nodes = back * transform.astype(np.float32)
        point.append(at_nodes.sum(axis=1, keepdims=True))
        for parts, galaxy in zip(convolved, transforms, strict=True):
            parts.append((at_nodes @ galaxy).reshape(nodes.size, AXIS_RATIOS.size, -1).swapaxes(0, 1))
    points = np.array(point)
    return tuple(
        ProfileTables(family, nodes, points, np.array(parts), fraction, pixel, origin, (width, height), across)
        for family, parts, fraction in zip(families, convolved, gaap, strict=True)
    )


def _nodes(top: float) -> FloatArray:
    """Return squared radii from 0 to `top` or a little more, multiples of 1/2."""
    nodes = [0.0]
    while nodes[-1] < top:
        nodes.append(max(nodes[-1] + 0.5, round(2.0 * GROWTH * nodes[-1]) / 2.0))
    return np.array(nodes)


def _wavenumbers(reach: float) -> tuple[FloatArray, FloatArray]:
    """Return (k, weight) of a Gauss-Legendre quadrature to _K_MAX that follows J_0(k r) up to r = `reach` px."""
    step = _ORDER / _PER_CYCLE * 2.0 * np.pi / reach
    inner = step * 2.0 ** np.arange(-7, 1)  # the wings of large galaxies
    edges = np.concatenate([[0.0], inner, np.linspace(step, _K_MAX, int(np.ceil(_K_MAX / step)))[1:]])
    x, w = np.polynomial.legendre.leggauss(_ORDER)
    half = 0.5 * np.diff(edges)[:, None]
    middle = 0.5 * (edges[1:] + edges[:-1])[:, None]
    return (middle + half * x).ravel(), (half * w).ravel()


def _projection(nodes: FloatArray, samples: int = 6) -> tuple[FloatArray, FloatArray]:
    """Return (r (m,), matrix (K, m)): values at r times the matrix are the least-squares values at the nodes."""
    x, w = np.polynomial.legendre.leggauss(samples)
    low = nodes[:-1, None]
    width = np.diff(nodes)[:, None]
    t = np.broadcast_to(0.5 * (x + 1.0), (nodes.size - 1, samples))
    hats = np.zeros((nodes.size, nodes.size - 1, samples))
    row = np.arange(nodes.size - 1)
    hats[row, row] = 1.0 - t
    hats[row + 1, row] = t
    flat = hats.reshape(nodes.size, -1)
    weighted = flat * (0.5 * width * w).ravel()
    return np.sqrt((low + width * t).ravel()), np.linalg.solve(weighted @ flat.T, weighted)


def _psf_transforms(psf: PsfSet, positions: Iterable[tuple[float, float]], k: FloatArray) -> Iterator[FloatArray]:
    """Yield the Hankel transform at `k` of the PSF with its pixel, mean over the angle, at positions on the chip."""
    from scipy.special import j0

    from csstsim.optics.psf.psf_file import half_pixels, pixel_response

    bessel = None
    for position in positions:
        image = pixel_response(np.mean(half_pixels(psf.at(*position), psf.oversampling), axis=0, dtype=np.float64), 2)
        offset = np.arange(image.shape[0]) - image.shape[0] // 2
        square, ring = np.unique(offset[:, None] ** 2 + offset**2, return_inverse=True)
        if bessel is None:
            bessel = j0(0.5 * np.sqrt(square)[:, None] * k)
        yield 0.25 * np.bincount(ring.ravel(), image.ravel()) @ bessel  # cells of half a pixel


def _galaxy_transforms(k: FloatArray, kinds: tuple[tuple[float, float, float], ...]) -> FloatArray:
    """Return the transforms (AXIS_RATIOS, SIZES, kinds, k) of galaxies of flux 1, mean over the angle."""
    from csstsim.catalog.profiles.log_table import nodes
    from csstsim.catalog.profiles.sersic import K2_HIGH, K2_LOW, tables

    # ln (k r_e)^2
    table_log_k2 = np.log(nodes(K2_LOW, K2_HIGH))
    log_k2 = np.linspace(-24.0, 16.0, 1600)
    means = {}
    for index in {index for kind in kinds for index in kind[:2]}:
        transform = tables(index, np.inf)[0]
        for ratio in AXIS_RATIOS:
            stretch = np.log(ratio * np.cos(_ANGLES) ** 2 + np.sin(_ANGLES) ** 2 / ratio)
            means[index, ratio] = np.interp(log_k2 + stretch[:, None], table_log_k2, transform).mean(axis=0)
    profile_log_k2 = 2.0 * np.log(SIZES[:, None] * k)
    out = np.empty((AXIS_RATIOS.size, SIZES.size, len(kinds), k.size))
    for j, (disc, bulge, bulge_fraction) in enumerate(kinds):
        disc_shift, bulge_shift = 2.0 * np.log(_component_sizes(disc, bulge, bulge_fraction))
        for i, ratio in enumerate(AXIS_RATIOS):
            disc_part = np.interp(profile_log_k2 + disc_shift, log_k2, means[disc, ratio])
            bulge_part = np.interp(profile_log_k2 + bulge_shift, log_k2, means[bulge, ratio])
            out[i, :, j] = (1.0 - bulge_fraction) * disc_part + bulge_fraction * bulge_part
    return out


def _component_sizes(disc: float, bulge: float, bulge_fraction: float) -> tuple[float, float]:
    """Return the half-light radii of disc and bulge for a galaxy of half-light radius 1."""
    if bulge_fraction in (0.0, 1.0):
        return 1.0, 1.0
    # half-light radius of the disc, by bisection
    low = 0.5
    high = 2.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        disc_outside = light_beyond(1.0, middle, disc)
        bulge_outside = light_beyond(1.0, BULGE_SIZE * middle, bulge)
        outside = (1.0 - bulge_fraction) * disc_outside + bulge_fraction * bulge_outside
        low, high = (middle, high) if outside < 0.5 else (low, middle)
    return middle, BULGE_SIZE * middle
