"""Fourier optics of one wavelength: from a wavefront to cells on the detector (paper, section 5.1).

Pupil function on a grid -> FFT -> intensity -> FFT -> optical transfer function, times jitter (Gaussian), charge
diffusion (Gaussian) and the cell (sinc), shifted, back to a lattice of cells. A result is a CELL INTEGRAL: the
fraction of all the light of a star that falls in that cell, so an array sums to the light inside its box (< 1).

* The intensity of a pupil of diameter D has no frequency above D/lambda. The transforms have at least twice as many
  samples as the pupil has across, so all steps up to the cell integrals are exact for the sampled pupil. Frequencies
  above those of the lattice of cells are folded onto it (the aliasing of sampling).
* The pupil has at least 256 samples across, more if needed for the period of the transform to be twice the box. Edge
  samples are weighted by the fraction of their square inside the disc; the resulting sinc envelope of the far wings is
  divided out. Fluxes are accurate to 5e-5 of the star (tests: Airy's closed form). The envelope is divided out after
  the blurring, which makes a blurred image too bright and too large: by 1e-3 of its flux at BLUR_PX, the maximum.
* Single precision, with a noise of 1e-10 of the star's light per cell.

Left out: polarisation, pupil vignetting over the field, diffusion that depends on wavelength.
"""

import math
from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

import numba
import numpy as np
import scipy.fft
from numpy.typing import ArrayLike

from csstsim.base.errors import InputError
from csstsim.base.types import ComplexArray, FloatArray
from csstsim.base.units import ARCSEC_PER_RAD
from csstsim.optics.psf.sampling import CELLS
from csstsim.optics.psf.wavefront import Wavefront, number

BLUR_PX = 2.0  # pixel rms per axis: the largest jitter and diffusion together
Kernel: TypeAlias = Callable[[FloatArray], FloatArray]  # of frequencies [cycles per cell] (see `blur`)
NO_CENTROID = (
    "the centroid of a PSF does not converge: the wavefront error of psf.yaml is too large, or diameter_m, "
    "focal_length_m or pixel_scale of telescope.yaml do not fit it"
)
_PUPIL_SAMPLES = 256
_PERIOD = 2.0  # of the transform, in boxes
_EDGE_STEPS = 32  # chords per pupil sample for the area of an edge sample
_WINDOW_REACH = 5.0  # sigmas beyond which the transform of a centring window is negligible


class Diffraction:
    """The optics at one wavelength: from Zernike coefficients to a transfer function, and from that to cells.

    Units: image positions in cells, frequencies in cycles per cell. `frequency` (size,) has the frequencies of a
    transfer function's rows, in FFT order; its first size/2 + 1 are those of the columns.
    """

    def __init__(
        self, wavelength: float, diameter_m: float, cell_arcsec: float, wavefront: Wavefront, cells: int = CELLS
    ) -> None:
        """`wavelength` in angstrom, `cell_arcsec` the side of a cell, `cells` (even) cells along the box."""
        lam_d = wavelength * 1e-10 / diameter_m * ARCSEC_PER_RAD / cell_arcsec  # cells
        self.cells = cells
        wanted = max(_PERIOD * cells, _PUPIL_SAMPLES * lam_d)
        self.period = 2 * scipy.fft.next_fast_len(math.ceil(wanted / 2), real=True)
        across = self.period / lam_d
        n = math.ceil(across) + 1
        self.size = 2 * scipy.fft.next_fast_len(n)
        u = (np.arange(n) - (n - 1) / 2) / (across / 2)
        mask = _disc_coverage(u)
        self.inside = mask > 0
        self.mask = mask[self.inside].astype(np.float32)
        self.light = float(mask.sum())
        to_radian = 2 * np.pi / (wavelength / 10)  # per nm
        self.basis = (to_radian * wavefront.basis(u, u)[:, self.inside]).astype(np.float32)
        self.screen = (to_radian * wavefront.screen(u, u)[self.inside]).astype(np.float32)
        self.frequency = scipy.fft.fftfreq(self.size) * (self.size / self.period)

    def phase(self, coefficients: ArrayLike) -> FloatArray:
        """Return the phase (radian) at the pupil samples inside the disc; their weights are `mask`."""
        return self.screen + np.asarray(coefficients, np.float32) @ self.basis

    def transfer(self, coefficients: ArrayLike) -> ComplexArray:
        """Return the transfer function (size, size/2+1), complex64, for Zernike coefficients in nm.

        It is 1 at frequency 0, except for the light beyond the transform's period.
        """
        phase = self.phase(coefficients)
        pupil = np.zeros(self.inside.shape, np.complex64)
        field = np.empty(phase.shape, np.complex64)
        np.multiply(self.mask, np.cos(phase), out=field.real)
        np.multiply(self.mask, -np.sin(phase), out=field.imag)  # e^-i phase, e^-i k x: GalSim's sign, conjugated
        pupil[self.inside] = field
        amplitude = scipy.fft.fft(pupil, self.size, axis=0)
        amplitude = scipy.fft.fft(amplitude, self.size, axis=1, overwrite_x=True)
        return scipy.fft.rfft2(_intensity(amplitude, 1 / (self.size**2 * self.light)))

    def image(
        self, transfer: ComplexArray, kernel: Kernel, centre: tuple[float, float] | FloatArray = (0.0, 0.0)
    ) -> FloatArray:
        """Return the cells (cells, cells) around `centre` (x, y; in cells from the image of an untilted wavefront).

        `kernel(frequency)` is the one-dimensional transfer function of the blurring (see `blur`).
        """
        half = self.cells // 2
        rows = np.arange(-half, half)
        # A cell centre lies half a cell from the middle of the array
        turn = [np.exp(2j * np.pi * self.frequency * (0.5 + c)) * kernel(self.frequency) for c in centre]
        turn_x, turn_y = (t.astype(np.complex64) for t in turn)
        spectrum = _fold_rows(transfer, turn_x, turn_y, self.period)
        lines = scipy.fft.ifft(spectrum, axis=0, overwrite_x=True)[rows]
        cells = scipy.fft.irfft(_fold_columns(lines, self.period), self.period, axis=1)[:, rows]
        envelope = [np.sinc((rows + 0.5 + c) / self.period) ** -2 for c in centre]
        return np.maximum(cells * (envelope[1][:, None] * envelope[0]), 0.0)  # clips rounding, 1e-9 of the peak

    def smoothed(
        self, transfer: ComplexArray, kernel: Kernel, sigma: float, position: tuple[float, float] | FloatArray
    ) -> FloatArray:
        """Return the image smoothed by a Gaussian of `sigma` at `position` (x, y): value, gradient, second derivatives.

        (6,): 1, x, y, xx, xy, yy, computed from the transforms, hence independent of the number of cells. The gradient
        is the first moment in a Gaussian window at that position, over sigma^2.
        """
        reach = min(math.ceil(_WINDOW_REACH / (2 * np.pi * sigma) * self.period), self.size // 2)
        f = self.frequency[:reach]
        window = np.exp(-2 * (np.pi * f * sigma) ** 2) * kernel(f)
        turn_x, turn_y = (window * np.exp(2j * np.pi * f * c) for c in position)
        turn_x[1:] *= 2  # for the half of the plane that a real transform does not store
        return _derivatives(transfer, turn_x, turn_y, 2 * np.pi * f) / self.period**2


@numba.njit(cache=True)
def _derivatives(transfer: ComplexArray, turn_x: ComplexArray, turn_y: ComplexArray, k: FloatArray) -> FloatArray:
    """Return the sums of the real part of turn_y turn_x transfer (i k)^n, n = 0, 1, 2 (see `smoothed`)."""
    out = np.zeros(6)
    for row in range(-len(k) + 1, len(k)):
        zeroth = first = second = 0.0j
        for column in range(len(k)):
            term = transfer[row, column] * turn_x[column]
            zeroth += term
            first += term * k[column]
            second += term * k[column] ** 2
        turn = turn_y[row] if row >= 0 else np.conj(turn_y[-row])
        along = k[row] if row >= 0 else -k[-row]
        zeroth = zeroth * turn
        first = first * turn
        second = second * turn
        out[0] += zeroth.real
        out[1] -= first.imag
        out[2] -= along * zeroth.imag
        out[3] -= second.real
        out[4] -= along * first.real
        out[5] -= along**2 * zeroth.real
    return out


@numba.njit(cache=True)
def _intensity(amplitude: ComplexArray, scale: float) -> FloatArray:
    out = np.empty(amplitude.shape, np.float32)
    for i in range(amplitude.shape[0]):
        for j in range(amplitude.shape[1]):
            a = amplitude[i, j]
            out[i, j] = (a.real * a.real + a.imag * a.imag) * scale
    return out


@numba.njit(cache=True)
def _fold_rows(transfer: ComplexArray, turn_x: ComplexArray, turn_y: ComplexArray, period: int) -> ComplexArray:
    """Return turn_y[row] turn_x[column] transfer with its rows (frequencies in FFT order) summed modulo `period`."""
    size, columns = transfer.shape
    out = np.zeros((period, columns), np.complex64)
    for row in range(size):
        to = (row if row < size // 2 else row - size) % period
        for column in range(columns):
            out[to, column] += transfer[row, column] * turn_y[row] * turn_x[column]
    return out


@numba.njit(cache=True)
def _fold_columns(lines: ComplexArray, period: int) -> ComplexArray:
    """Return the columns of a real image's half spectrum summed modulo `period`: (rows, period/2 + 1)."""
    rows, columns = lines.shape
    half = period // 2
    out = np.zeros((rows, half + 1), np.complex64)
    for row in range(rows):
        for column in range(columns):
            # Column k also gives, conjugated, column -k
            to = column % period
            if to <= half:
                out[row, to] += lines[row, column]
            back = (period - to) % period
            if column > 0 and back <= half:
                out[row, back] += np.conj(lines[row, column])
    return out


def _disc_coverage(u: FloatArray) -> FloatArray:
    """Return the fraction of each grid square inside the unit disc; the squares are centred on `u` x `u`."""
    step = u[1] - u[0]
    quarter = u[: (u.size + 1) // 2]  # the rest by symmetry
    inside = np.zeros((quarter.size, quarter.size))
    for offset in (np.arange(_EDGE_STEPS) + 0.5) / _EDGE_STEPS - 0.5:
        chord = np.sqrt(np.maximum(1 - (quarter + offset * step) ** 2, 0))
        inside += np.clip((chord - np.abs(quarter[:, None])) / step + 0.5, 0, 1)
    half = np.hstack([inside, inside[:, : u.size // 2][:, ::-1]])
    return np.vstack([half, half[: u.size // 2][::-1]]) / _EDGE_STEPS


def blur(psf_params: Mapping[str, Any], cell_arcsec: float, cell_um: float, *, cell: bool = True) -> Kernel:
    """Return kernel(frequency): jitter, charge diffusion and, if `cell`, the integral over a cell, along one axis.

    `psf_params`: `jitter` (arcsec rms per axis) and `diffusion` (um rms per axis). Frequency in cycles per cell.
    """
    jitter = number(psf_params, "jitter")
    diffusion = number(psf_params, "diffusion")
    variance = (jitter / cell_arcsec) ** 2 + (diffusion / cell_um) ** 2
    return lambda f: np.exp(-2 * (np.pi * f) ** 2 * variance) * (np.sinc(f) if cell else 1.0)


def check_blur(psf_params: Mapping[str, Any], pixel_arcsec: float, pixel_um: float) -> None:
    """Raise InputError for numbers that `blur` refuses, or that blur by more than BLUR_PX."""
    jitter = number(psf_params, "jitter")
    diffusion = number(psf_params, "diffusion")
    if (width := math.hypot(jitter / pixel_arcsec, diffusion / pixel_um)) > BLUR_PX:
        raise InputError(
            f"the PSF is too wide for its box: jitter and diffusion are {width:.1f} pixel rms",
            file="psf.yaml",
            key="jitter, diffusion",
            value=f"{jitter:g} arcsec, {diffusion:g} um",
            allowed=f"up to {BLUR_PX:g} pixel",
        )


def windowed_centroid(image: FloatArray, sigma: float) -> tuple[float, float]:
    """Return (x, y), in samples from the array's middle, where the Gaussian-windowed first moments vanish.

    `sigma` in samples. Raises InputError if the iteration leaves the array or does not converge: no compact source.
    """
    axis = np.arange(image.shape[0]) - (image.shape[0] - 1) / 2
    x = y = 0.0
    for _ in range(100):
        wx, wy = (np.exp(-0.5 * ((axis - c) / sigma) ** 2) for c in (x, y))
        line_x = wy @ image
        line_y = image @ wx
        total = line_x @ wx
        # Twice the windowed mean: the window halves the step for a source as wide as itself
        dx = 2 * (line_x @ (wx * (axis - x))) / total
        dy = 2 * (line_y @ (wy * (axis - y))) / total
        x = x + dx
        y = y + dy
        if not math.hypot(x, y) < axis[-1]:
            break
        if math.hypot(dx, dy) < 1e-9:
            return x, y
    raise InputError(NO_CENTROID)
