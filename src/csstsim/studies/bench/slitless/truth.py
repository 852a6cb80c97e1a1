"""The independent truth of a spectrum: direct optics at sixteen wavelengths, summed along the first order's trace.

As in bench.imaging.truth, the PSF is that of the object's position on 8 x 8 cells per pixel, without a stored PSF or
GalSim. Here it is made at NODES wavelengths over the whole order instead of the PSF set's four, with cubic
interpolation between them. The transform of the image is the sum, over wavelengths half an angstrom apart, of

    light(lambda)  PSF(k, lambda)  profile(k)  exp(-2 pi i k . position(lambda)),

some pixels of the trace at a time. So it includes what four wavelengths and the Disperser's bins leave out. It stops at
HIGHEST cycles per pixel: beyond, jitter, diffusion and the pixel leave less than 1e-4.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from types import SimpleNamespace
from typing import TYPE_CHECKING, NamedTuple, cast

import numpy as np
import scipy.fft

from csstsim.base.arrays.polynomial_weights import lagrange_weights
from csstsim.base.types import ComplexArray, FloatArray
from csstsim.instrument.filter import GRID
from csstsim.optics.psf.chip_errors import chip_coefficients
from csstsim.optics.psf.psf_file import pixel_response
from csstsim.optics.psf.psf_set import centre_of, chip_optics
from csstsim.optics.psf.wavefront import load_wavefront
from csstsim.optics.scatter.scattered_light import scattered_light
from csstsim.studies.bench.imaging.cases import Position
from csstsim.studies.bench.imaging.truth import CELLS_PER_PIXEL, brightness, profile, repeats, waves
from csstsim.studies.bench.setting import disperser_of

if TYPE_CHECKING:
    from csstsim.instrument.filter import Filter
    from csstsim.optics.psf.diffraction import Diffraction, Kernel
    from csstsim.optics.scatter.halo import Wing
    from csstsim.render.scene import Scene
    from csstsim.studies.bench.setting import Setting
    from csstsim.studies.bench.slitless.cases import SpectrumCase

NODES = 16
HIGHEST = 1.25  # cycles per pixel
_BLOCK = 32  # px of the trace in one transform
_MARGIN = 64  # px between repeats of a window


class _Frequencies(NamedTuple):
    """Frequencies of a transform [cycles per pixel]: kx (n + 1,), ky (2 n + 1,), multiples of 1 / period [px]."""

    kx: FloatArray
    ky: FloatArray
    period: int


class _Part(NamedTuple):
    """Part of a spectrum: positions (samples,) on the image [px], and weights (NODES, samples): light by wavelength."""

    x: FloatArray
    y: FloatArray
    weights: FloatArray


class SpectrumTruth:
    """Direct optics of one spectroscopic chip; call it with a SpectrumCase."""

    def __init__(self, setting: Setting) -> None:
        camera = setting.camera
        m = CELLS_PER_PIXEL
        self._setting = setting
        self._wavefront = load_wavefront(camera.psf)
        cells = setting.psf.image.shape[-1] // setting.psf.oversampling * m
        first, last = disperser_of(setting).edges[[0, -1]]
        self._waves = np.linspace(first, last, NODES)

        def optics(wavelengths: FloatArray) -> tuple[list[Diffraction], Kernel, Wing]:
            filter_ = cast(
                "Filter", SimpleNamespace(name=setting.filter.name, psf_wavelength=wavelengths)
            )  # all it reads
            diffraction_and_kernel = chip_optics(setting.chip, filter_, camera.psf, self._wavefront, m, cells)
            wing = scattered_light(camera, filter_).wing
            assert wing is not None  # of the shipped camera
            return *diffraction_and_kernel, wing

        self._four = optics(setting.filter.psf_wavelength)  # for the centre of the stored PSF
        self._all = [optics(self._waves[k : k + 4]) for k in range(0, NODES, 4)]

    def psf(self, x: float, y: float) -> FloatArray:
        """Return (NODES, n, n): flux in pixels on the lattice of cells, for a star of unit flux at chip pixel x, y."""
        setting = self._setting
        m = CELLS_PER_PIXEL
        coefficients = chip_coefficients(self._wavefront, setting.camera.psf, setting.chip, x, y)
        optics, kernel, _ = self._four
        centre = centre_of(optics, [one.transfer(coefficients) for one in optics], kernel, m)
        responses: list[FloatArray] = []
        for optics, kernel, wing in self._all:
            images = np.stack([one.image(one.transfer(coefficients), kernel, centre) for one in optics])
            responses += [pixel_response(np.pad(image, m), m) for image in wing.add_to(images, m)]
        return np.stack(responses)

    def __call__(self, case: SpectrumCase) -> FloatArray:
        """Return the flux in each pixel of the case's window, for an object of unit flux, float64."""
        scene = case.scene
        disperser = disperser_of(self._setting)
        window = case.window
        first = disperser.orders.index(1)
        grating = case.visits[0, 1]
        throughput = disperser.gratings.pieces[grating][0].orders[1].throughput
        nonzero = np.flatnonzero(throughput * case.density)
        light = (throughput * case.density)[nonzero] * disperser.area * (GRID[1] - GRID[0]) / case.electrons
        p, q, r, s = disperser.lines(case.visits, scene.x, scene.y)[0, first]
        x = scene.x[0] + p + q * GRID[nonzero] - window.x0
        y = scene.y[0] + r + s * GRID[nonzero] - window.y0
        images = self.psf(scene.x[0], scene.y[0])
        period = window.ny + _BLOCK + _MARGIN + images.shape[-1] // CELLS_PER_PIXEL
        highest = math.floor(HIGHEST * period)
        k = _Frequencies(np.arange(highest + 1) / period, np.arange(-highest, highest + 1) / period, period)
        shape = profile(scene, k.kx, k.ky) if not case.star else 1.0
        transforms = [_transform(image, period, highest) * shape for image in images]
        weights = _cubic(self._waves, GRID[nonzero]) * light
        out = np.zeros(window.shape)
        block = np.floor(x / _BLOCK).astype(int)
        for b in np.unique(block):
            in_block = block == b
            _add(out, transforms, _Part(x[in_block], y[in_block], weights[:, in_block]), scene, k)
        return out


def _add(
    out: FloatArray, transforms: Sequence[ComplexArray], part: _Part, scene: Scene, frequencies: _Frequencies
) -> None:
    """Add a part of a spectrum to `out`; transforms (NODES,): of the object at each wavelength of `psf`."""
    kx, ky, period = frequencies
    half = (period - _MARGIN) // 2
    middle = round(0.5 * (part.x.min() + part.x.max()))
    columns = np.arange(max(middle - half, 0), min(middle + half + 1, out.shape[1]))
    along = waves(kx, part.x - middle).conj()
    across = waves(ky, part.y).conj()
    total = 0.0
    for transform, light in zip(transforms, part.weights, strict=True):
        if light.any():
            total = total + transform * ((across * light) @ along.T)
    twice = np.where(kx > 0, 2.0, 1.0)  # kx > 0 stands for kx < 0 as well
    rows = np.arange(out.shape[0])
    image = (waves(ky, rows).T @ total @ (twice[:, None] * waves(kx, columns - middle))).real / period**2
    of_samples = part.weights.sum(axis=0)
    at = Position(float(np.average(part.x, weights=of_samples)), float(np.average(part.y, weights=of_samples)))
    electrons = sum(t[len(ky) // 2, 0].real * w.sum() for t, w in zip(transforms, part.weights, strict=True))
    out[:, columns] += image - electrons * repeats(scene, columns, rows, at, period)
    outside = np.setdiff1d(np.arange(out.shape[1]), columns)  # so far out the PSF does not change the profile
    out[:, outside] += electrons * brightness(scene, outside, rows, at)


def _transform(response: FloatArray, period: int, highest: int) -> ComplexArray:
    """Return the transform of a lattice of cells about its middle, at k / period: (2 highest + 1, highest + 1)."""
    m = CELLS_PER_PIXEL
    padded = np.zeros((period * m, period * m), np.float32)
    middle = len(response) // 2
    padded[: len(response), : len(response)] = response
    spectrum = scipy.fft.rfft2(padded)[np.arange(-highest, highest + 1)][:, : highest + 1] / m**2
    k = np.arange(-highest, highest + 1) / period / m
    return spectrum * np.exp(2j * np.pi * k * middle)[:, None] * np.exp(2j * np.pi * k[highest:] * middle)


def _cubic(nodes: FloatArray, values: FloatArray) -> FloatArray:
    """Return (nodes, values): weights of the cubic through the four nodes about each value; nodes are evenly spaced."""
    at = (values - nodes[0]) / (nodes[1] - nodes[0])
    first = np.clip(np.floor(at).astype(int) - 1, 0, len(nodes) - 4)
    t = at - first
    weights = np.empty((4, len(values)))
    lagrange_weights(t, 4, weights)
    out = np.zeros((len(nodes), len(values)))
    out[first + np.arange(4)[:, None], np.arange(len(values))] = weights
    return out
