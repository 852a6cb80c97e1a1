"""The transform of an image at any frequencies: a lattice of spots, each a quadratic B-spline of one pixel.

For pixels k at r_k with coefficients c_k, in pixels of the image,

    F(f) = sinc^3(f_x) sinc^3(f_y) sum_k c_k exp(-2 pi i f . r_k).

The sum is a Fourier transform of type 2 with frequencies off the lattice (Dutt & Rokhlin 1993; the window is that of
Barnett, Magland & af Klinteberg 2019): divide by the window's transform, pad to twice the size, transform, and sum the
6 x 6 nearest values weighted by the window. The error is below 1e-5 of the light.
"""

import math

import numba
import numpy as np
import scipy.fft

from csstsim.base.types import ComplexArray, FloatArray

_WIDTH = 6  # values along an axis
_SHAPE = 2.30 * _WIDTH
_FINER = 1024  # of the window's table, to a value's distance
_U = (np.arange(_WIDTH * _FINER // 2 + 2)) / _FINER
_WINDOW = np.where(
    _U <= _WIDTH / 2, np.exp(_SHAPE * (np.sqrt(np.maximum(1 - (2 * _U / _WIDTH) ** 2, 0.0)) - 1)), 0.0
)  # at distances 0 to half the width


class LatticeTransform:
    """The transform of (rows, columns) coefficients; its origin is the centre of pixel (rows // 2, columns // 2)."""

    def __init__(self, coefficients: FloatArray) -> None:
        shape = tuple(scipy.fft.next_fast_len(2 * max(n, _WIDTH)) for n in coefficients.shape)
        padded = np.zeros(shape)
        ny, nx = coefficients.shape
        padded_ny, padded_nx = shape
        rows = np.arange(ny) - ny // 2
        columns = np.arange(nx) - nx // 2
        even = _window_transform(rows / padded_ny)[:, None] * _window_transform(columns / padded_nx)
        padded[np.ix_(rows % padded_ny, columns % padded_nx)] = coefficients / even
        self._values = scipy.fft.fft2(padded).astype(np.complex64)

    def at(self, matrix: FloatArray, size: int, last: int) -> ComplexArray:
        """Return (2 last + 1, last + 1) complex64: rows -last..last, columns 0..last, in 1 / size cycles per pixel.

        matrix (2, 2): chip pixel per pixel of the image. Frequencies of a modulus above `last` are 0.
        """
        out = np.zeros((2 * last + 1, last + 1), np.complex64)
        _sum(out, self._values, np.asarray(matrix, float) / size, _WINDOW)
        return out


def _window_transform(x: FloatArray) -> FloatArray:
    """Return the transform of the window at |x| <= 1/4 cycles per value."""
    nodes, weights = np.polynomial.legendre.leggauss(60)
    t = nodes * _WIDTH / 2
    window = np.exp(_SHAPE * (np.sqrt(1 - nodes**2) - 1)) * weights * _WIDTH / 2
    return np.einsum("t,xt->x", window, np.cos(2 * np.pi * np.asarray(x)[:, None] * t))


@numba.njit(inline="always")
def _sinc3(f: float) -> float:
    x = math.pi * f
    s = 1.0 if abs(x) < 1e-8 else math.sin(x) / x
    return s * s * s


@numba.njit(cache=True)
def _weights(out: FloatArray, position: float, table: FloatArray) -> int:
    """Fill `out` with the window's values around a position; return the index of the first."""
    first = math.ceil(position - 0.5 * len(out))
    for j in range(len(out)):
        u = abs(position - (first + j)) * _FINER
        k = int(u)
        out[j] = table[k] + (u - k) * (table[k + 1] - table[k])
    return first


@numba.njit(cache=True)
def _sum(out: ComplexArray, values: ComplexArray, matrix: FloatArray, table: FloatArray) -> None:
    last = out.shape[1] - 1
    rows, columns = values.shape
    across = np.empty(_WIDTH)
    along = np.empty(_WIDTH)
    for row in range(out.shape[0]):
        ky = row - last
        for kx in range(int(math.sqrt(last * last - ky * ky)) + 1):
            fx = matrix[0, 0] * kx + matrix[1, 0] * ky
            fy = matrix[0, 1] * kx + matrix[1, 1] * ky
            fade = _sinc3(fx) * _sinc3(fy)
            if abs(fade) < 1e-9:
                continue
            first_x = _weights(along, fx * columns, table)
            first_y = _weights(across, fy * rows, table)
            real = imaginary = 0.0
            for a in range(_WIDTH):
                line = values[(first_y + a) % rows]
                r = i = 0.0
                for b in range(_WIDTH):
                    value = line[(first_x + b) % columns]
                    r += along[b] * value.real
                    i += along[b] * value.imag
                real += across[a] * r
                imaginary += across[a] * i
            out[row, kx] = fade * complex(real, imaginary)
