"""The independent truth: an object's flux in its pixels from direct optics, without a stored PSF or GalSim.

The optics at the object's position give a PSF of 8 x 8 cells per pixel, in the box of the stored one. Sums over
pixels on that lattice have every frequency that the optics transmit, so the image's transform is theirs times the
profile's. The profile's transform (circular Sersic, index n >= 1) is integrated along the imaginary axis, where the
integrand does not oscillate (the contour of the Hankel integral turned by 90 degrees, H0(1)(ix) = 2 K0(x) / (i pi)):

    S(k) = 2 / (pi N) int_0^inf exp(-b t^(1/n) cos(pi/2n)) sin(b t^(1/n) sin(pi/2n)) K0(k t) t dt

with N = n b^(-2n) Gamma(2n); for n = 1 it is (1 + (k/b)^2)^(-3/2). A transform repeats the object every `period`
pixels. The repeats next to the window, which are as smooth as the profile's own wings, are subtracted.
"""

from __future__ import annotations

import math
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.special import gamma, k0

from csstsim.base.types import ComplexArray, FloatArray, Floats, IntArray
from csstsim.base.units import ARCSEC_PER_RAD
from csstsim.optics.psf.chip_errors import chip_coefficients
from csstsim.optics.psf.psf_file import pixel_response
from csstsim.optics.psf.psf_set import chip_optics, node_psf
from csstsim.optics.psf.wavefront import load_wavefront
from csstsim.studies.bench.imaging.cases import FRACTIONS, Position

if TYPE_CHECKING:
    from csstsim.render.parts.spots import Spots
    from csstsim.render.scene import Scene
    from csstsim.studies.bench.imaging.cases import Case
    from csstsim.studies.bench.setting import Setting

CELLS_PER_PIXEL = 8
_REPEATS = 2  # on each side
_SPOTS_AT_ONCE = 2000  # of an image, summed in one step
_LOG_K = np.linspace(math.log(1e-6), math.log(1e6), 361)


class Truth:
    """Direct optics of one chip; call it with a Case."""

    def __init__(self, setting: Setting) -> None:
        camera = setting.camera
        m = CELLS_PER_PIXEL
        self._setting = setting
        self._wavefront = load_wavefront(camera.psf)
        cells = setting.psf.image.shape[-1] // setting.psf.oversampling * m
        self._optics, self._kernel = chip_optics(setting.chip, setting.filter, camera.psf, self._wavefront, m, cells)
        finest = min(setting.filter.psf_wavelength) * 1e-10 / camera.telescope.diameter_m * ARCSEC_PER_RAD
        self._highest = 1.1 * camera.telescope.pixel_scale / finest  # cycles per pixel

    def psf(self, x: float, y: float) -> FloatArray:
        """Return the flux in pixels on the lattice of cells (n, n), of a star of unit flux at chip pixel x, y."""
        setting = self._setting
        m = CELLS_PER_PIXEL
        coefficients = chip_coefficients(self._wavefront, setting.camera.psf, setting.chip, x, y)
        images, _ = node_psf(self._optics, coefficients, self._kernel, m)
        wing = setting.scattered.wing
        assert wing is not None  # of the shipped camera
        cells = np.tensordot(FRACTIONS, wing.add_to(images, m), axes=1)
        return pixel_response(np.pad(cells, m), m)  # padded: includes pixels only partly in the box

    def __call__(self, case: Case) -> FloatArray:
        """Return the flux in each pixel of the case's window, for an object of unit flux, float64."""
        scene = case.scene
        half = case.half
        response = self.psf(scene.x[0], scene.y[0])
        period = 2 * half + 1 + 2 * len(response) // CELLS_PER_PIXEL
        highest = int(self._highest * period)
        # cycles per pixel
        kx = np.arange(highest + 1) / period
        ky = np.arange(-highest, highest + 1) / period
        lattice = (np.arange(len(response)) - len(response) // 2) / CELLS_PER_PIXEL
        transform = waves(ky, -lattice) @ response @ waves(kx, -lattice).T / CELLS_PER_PIXEL**2
        transform *= profile(scene, kx, ky)
        offset = Position(scene.x[0] - case.window.x0 - half, scene.y[0] - case.window.y0 - half)
        pixels = np.arange(-half, half + 1)
        twice = np.where(kx > 0, 2.0, 1.0)  # kx > 0 stands for kx < 0 as well
        image = (waves(ky, pixels - offset.y).T @ transform @ (twice[:, None] * waves(kx, pixels - offset.x))).real
        return image / period**2 - repeats(scene, pixels, pixels, offset, period) * response[::8, ::8].sum()


def profile(scene: Scene, kx: FloatArray, ky: FloatArray) -> Floats | ComplexArray:
    """Return the transform of a Scene's one object, 1 at 0, at kx, ky [cycles per pixel]: (ky, kx)."""
    if scene.spots is not None:
        assert scene.fraction_of_parent is not None  # as all scenes with spots have
        return sum(
            fraction * _row_profile(scene.take(np.array([row])), kx, ky)
            for row, fraction in enumerate(scene.fraction_of_parent)
            if fraction > 0
        )
    return _row_profile(scene, kx, ky)


def _row_profile(scene: Scene, kx: FloatArray, ky: FloatArray) -> Floats | ComplexArray:
    if scene.spots is not None and scene.spot is not None and scene.spot[0] >= 0:
        return _of_spots(scene.spots, int(scene.spot[0]), scene.matrix[0], kx, ky)
    total: Floats = 0.0
    for fraction, (index, b, radius) in zip(scene.component_fractions[0], scene.sersic[0], strict=True):
        if fraction > 0 and index > 0:
            m = scene.matrix[0]
            q = np.hypot(m[0, 0] * kx + m[1, 0] * ky[:, None], m[0, 1] * kx + m[1, 1] * ky[:, None])
            total = total + fraction * sersic_transform(2 * np.pi * q * radius, index, b)
        elif fraction > 0:
            total = total + fraction
    return total


def _of_spots(spots: Spots, group: int, m: FloatArray, kx: FloatArray, ky: FloatArray) -> ComplexArray:
    """Return the transform of knots or of an image, spot by spot; one of an image is a quadratic B-spline."""
    u, v, flux = spots.group(group)
    x, y = m @ np.stack([u, v])
    total: ComplexArray = np.zeros((len(ky), len(kx)), complex)
    for rows in np.array_split(np.arange(len(flux)), len(flux) // _SPOTS_AT_ONCE + 1):
        total = total + (waves(ky, -y[rows]) * flux[rows]) @ waves(kx, -x[rows]).T
    if spots.image(group) is not None:
        fx = m[0, 0] * kx + m[1, 0] * ky[:, None]
        fy = m[0, 1] * kx + m[1, 1] * ky[:, None]
        total *= np.sinc(fx) ** 3 * np.sinc(fy) ** 3
    return total


def repeats(
    scene: Scene, x: FloatArray | IntArray, y: FloatArray | IntArray, offset: Position, period: int
) -> FloatArray:
    """Return the flux in pixels x, y of the repeats, every `period` pixels, of an object at `offset`."""
    shifts = range(-_REPEATS, _REPEATS + 1)
    others = [
        Position(offset.x + i * period, offset.y + j * period) for i in shifts for j in shifts if (i, j) != (0, 0)
    ]
    fraction = 1.0 if scene.fraction_of_parent is None else scene.fraction_of_parent[0]
    return fraction * sum((brightness(scene, x, y, at) for at in others), np.zeros((y.size, x.size)))


def brightness(scene: Scene, x: FloatArray | IntArray, y: FloatArray | IntArray, at: Position) -> FloatArray:
    """Return the profile of a Scene's one object, of unit flux, at pixels x, y about `at`; 0 for a point."""
    total = np.zeros((y.size, x.size))
    inverse = np.linalg.inv(scene.matrix[0])
    if scene.spots is not None and scene.spot is not None and scene.spot[0] >= 0:  # compact: its repeats are not near
        return total
    dx = x - at.x
    dy = (y - at.y)[:, None]
    for fraction, (index, b, radius) in zip(scene.component_fractions[0], scene.sersic[0], strict=True):
        if fraction > 0 and index > 0:
            centre = fraction * abs(np.linalg.det(inverse)) / (2 * np.pi * radius**2 * index * b ** (-2 * index))
            r = np.hypot(inverse[0, 0] * dx + inverse[0, 1] * dy, inverse[1, 0] * dx + inverse[1, 1] * dy) / radius
            total += centre / gamma(2 * index) * np.exp(-b * r ** (1 / index))
    return total


def waves(k: FloatArray, x: FloatArray | IntArray) -> ComplexArray:
    """Return exp(2 pi i k x), (len(k), len(x))."""
    return np.exp(2j * np.pi * k[:, None] * x)


def sersic_transform(k: FloatArray, index: float, b: float) -> FloatArray:
    """Return the transform, 1 at 0, of a circular Sersic profile (index >= 1) at k [radian per r_e]."""
    if index == 1:
        return (1 + (k / b) ** 2) ** -1.5
    with np.errstate(divide="ignore"):
        return np.where(k > math.exp(_LOG_K[0]), _table(index, float(b))(np.log(np.maximum(k, 1e-300))), 1.0)


@cache
def _table(index: float, b: float) -> CubicSpline:
    """Return the transform as a spline in log k."""
    log_t = np.linspace(math.log(1e-12), math.log(1e7), 1501)
    t = np.exp(log_t)
    root = b * t ** (1 / index)
    turn = math.pi / (2 * index)
    f = np.exp(-root * math.cos(turn)) * np.sin(root * math.sin(turn)) * t * t  # one t from dt = t d(log t)
    total = np.array([np.sum(f * k0(k * t)) for k in np.exp(_LOG_K)]) * (log_t[1] - log_t[0])
    return CubicSpline(_LOG_K, 2 / math.pi * total / (index * b ** (-2 * index) * gamma(2 * index)))
