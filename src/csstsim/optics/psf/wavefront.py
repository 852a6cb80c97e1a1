"""The wavefront error of the telescope over its pupil and over the focal plane (paper, section 5.1.1).

Modelled, in nm of optical path, the same at every wavelength (the train is mirrors):

* design residual, and alignment + gravity release + thermal errors: two sets of Noll Zernike coefficients,
  each coefficient a quadratic polynomial of the position in the focal plane of the whole camera;
* mirror figure: one Gaussian random screen (normal heights, as measured; paper section 5.1.1) with a power-law
  spectrum between two spatial frequencies, fixed for the camera and the same at every field point.

Piston and tilt are excluded: a shift of the image is part of the distortion model. The numbers are in
config/instrument/psf.yaml. Zernike order and sign: Noll (1976, JOSA 66, 207), coefficient = rms over the disc.

optics.psf.chip_errors adds the errors that differ between chips (filter, position of the detector). Left out: beam walk
on mirrors away from the pupil, drift of the wavefront in time.
"""

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from csstsim.base.errors import InputError
from csstsim.base.rng import stream
from csstsim.base.types import ComplexArray, FloatArray, IntArray

TERMS = 6  # 1, X, Y, X^2, X Y, Y^2
_SCREEN_PERIOD = 2.0  # period of the screen in pupil diameters, so that the pupil contains no repetition
_RMS_GRID = 301  # samples across the disc on which the screen's rms and tilt are defined


def noll_to_nm(noll: int) -> tuple[int, int]:
    """Return (n, m) of Noll index `noll` >= 1; m < 0 means the sine term."""
    n = (math.isqrt(8 * noll - 7) - 1) // 2
    rest = noll - n * (n + 1) // 2 - 1
    m = 2 * ((rest + 1) // 2) if n % 2 == 0 else 2 * (rest // 2) + 1
    return n, (m if noll % 2 == 0 else -m)


def zernike(noll: int, u: FloatArray, v: FloatArray) -> FloatArray:
    """Return the Noll Zernike polynomial at (u, v) (arrays of one shape), with rms 1 over the unit disc.

    Outside the disc it is the same polynomial.
    """
    n, m = noll_to_nm(noll)
    order = abs(m)
    r2 = u * u + v * v
    radial = np.zeros_like(r2)
    for k in range((n - order) // 2 + 1):
        top = (-1) ** k * math.factorial(n - k)
        bottom = math.factorial(k) * math.factorial((n + order) // 2 - k) * math.factorial((n - order) // 2 - k)
        radial += top / bottom * r2 ** ((n - order) // 2 - k)
    # r^|m| e^(i |m| theta) = (u + i v)^|m|, so no angle is ever needed
    turn = np.ones_like(r2, dtype=complex)
    for _ in range(order):
        turn *= u + 1j * v
    norm = math.sqrt(n + 1) if m == 0 else math.sqrt(2 * (n + 1))
    return norm * radial * (turn.real if m >= 0 else turn.imag)


@dataclass(frozen=True)
class MirrorScreen:
    """A periodic Gaussian random surface as a finite Fourier series, so it can be evaluated exactly anywhere."""

    mode: IntArray  # (K,) integer frequencies, cycles per period
    amplitude: ComplexArray  # (K, K) complex, nm; axis 0 is v
    plane: FloatArray  # (3,) piston and tilts over the disc, nm, removed on evaluation

    def __call__(self, u: FloatArray, v: FloatArray) -> FloatArray:
        """Return the optical path error (nm) on the grid v x u of pupil coordinates (1 = edge of the pupil)."""
        wave_u, wave_v = (np.exp(1j * math.pi / _SCREEN_PERIOD * np.outer(t, self.mode)) for t in (u, v))
        height = (wave_v @ self.amplitude @ wave_u.T).real
        return height - self.plane[0] - self.plane[1] * u - self.plane[2] * v[:, None]


def mirror_screen(rms: float, slope: float, cycles: tuple[float, float]) -> MirrorScreen:
    """Return the camera's `MirrorScreen`.

    `rms`: nm of optical path over the pupil. The two-dimensional power spectrum is ~ f^-slope for f between
    `cycles` = (lowest, highest) cycles per pupil diameter. The random stream has a fixed name and seed, so the same
    arguments give the same mirrors in every campaign.
    """
    low, high = cycles
    kmax = math.ceil(high * _SCREEN_PERIOD)
    mode = np.arange(-kmax, kmax + 1)
    frequency = np.hypot(mode, mode[:, None]) / _SCREEN_PERIOD
    rng = stream(0, "optics", "mirror")
    # Normal real and imaginary parts for all frequencies in `mode`, also those outside `cycles`
    draw = rng.standard_normal((2, mode.size, mode.size))
    inside = (frequency >= low) & (frequency <= high)
    power = np.where(inside, np.maximum(frequency, low), np.inf) ** (-slope)
    amplitude = (draw[0] + 1j * draw[1]) * np.sqrt(power)

    t = np.linspace(-1, 1, _RMS_GRID)
    disc = t**2 + t[:, None] ** 2 <= 1
    height = MirrorScreen(mode, amplitude, np.zeros(3))(t, t)[disc]
    u, v = (axis[disc] for axis in np.meshgrid(t, t))
    design = np.stack([np.ones_like(u), u, v], axis=1)
    plane = np.linalg.lstsq(design, height, rcond=None)[0]
    scale = rms / np.std(height - design @ plane)
    return MirrorScreen(mode, amplitude * scale, plane * scale)


@dataclass(frozen=True)
class Wavefront:
    """The camera's wavefront error: Zernike coefficients over the field, and the mirror screen."""

    noll: tuple[int, ...]  # Noll indices of the coefficients
    table: FloatArray  # (J, 6) nm: polynomial of (X, Y) for each index
    field_scale: float  # px of the mosaic at which X or Y is 1
    screen: MirrorScreen

    def coefficients(self, x: ArrayLike, y: ArrayLike) -> FloatArray:
        """Return Zernike coefficients, nm, shape (..., J), at mosaic position x, y (px from the boresight)."""
        fx = np.asarray(x, float) / self.field_scale
        fy = np.asarray(y, float) / self.field_scale
        field = np.stack([np.ones_like(fx), fx, fy, fx * fx, fx * fy, fy * fy], axis=-1)
        return field @ self.table.T

    def basis(self, u: FloatArray, v: FloatArray) -> FloatArray:
        """Return the Zernike polynomials, shape (J, len(v), len(u)), on a grid of pupil coordinates."""
        grid_u, grid_v = np.meshgrid(u, v)
        return np.stack([zernike(j, grid_u, grid_v) for j in self.noll])


def number(params: Mapping[str, Any], *keys: str) -> float:
    """Return the non-negative number at `keys` of the mapping `params`; InputError naming psf.yaml and the key."""
    value: Any = params
    for key in keys:
        value = value.get(key) if isinstance(value, dict) else None
    if not _is_number(value) or value < 0:
        raise InputError("must be a number", file="psf.yaml", key=".".join(keys), value=value, allowed=">= 0")
    return float(value)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e300  # false for NaN


def filter_noll(params: Mapping[str, Any]) -> list[int]:
    """Return the sorted Noll indices of the filters' figure. Raises InputError unless all are integers above 3."""
    noll = (params.get("filter_figure") or {}).get("noll")
    if not isinstance(noll, list) or not noll or not all(type(j) is int and j > 3 for j in noll):
        raise InputError("bad list", file="psf.yaml", key="filter_figure.noll", value=noll, allowed="Noll indices >= 4")
    return sorted(set(noll))


def load_wavefront(params: Mapping[str, Any], *, parts: Collection[str] = ("design", "static", "mirror")) -> Wavefront:
    """Return the `Wavefront` described by the mapping `params` (psf.yaml, unwrapped).

    `parts`: error sources to include, for studying them separately. Raises InputError for a missing
    or impossible number, and for a table whose rows are not a Noll index and six numbers.
    """
    total: dict[int, FloatArray] = {}
    for name in ("design", "static"):
        rows = params.get(name) or ()
        for row in rows if isinstance(rows, list | tuple) else [rows]:
            noll = row[0] if isinstance(row, list) and len(row) == TERMS + 1 else None
            if type(noll) is not int or noll < 4 or not all(_is_number(nm) for nm in row[1:]):
                allowed = f"a Noll index >= 4 and {TERMS} finite numbers (nm)"
                raise InputError("bad row", file="psf.yaml", key=name, value=row, allowed=allowed)
            weight = 1.0 if name in parts else 0.0
            total[noll] = total.get(noll, 0.0) + weight * np.asarray(row[1:], float)
    rms, slope, low, high = (number(params, "mirror", key) for key in ("rms", "slope", "cycles_min", "cycles_max"))
    if not 1 / _SCREEN_PERIOD <= low < high:
        allowed = f"{1 / _SCREEN_PERIOD} <= cycles_min < cycles_max"
        raise InputError("bad range", file="psf.yaml", key="mirror", value=(low, high), allowed=allowed)
    for noll in (4, *filter_noll(params)):  # indices that optics.psf.chip_errors adds to
        total.setdefault(noll, np.zeros(TERMS))
    screen = mirror_screen(rms if "mirror" in parts else 0.0, slope, (low, high))
    noll = tuple(sorted(total))
    return Wavefront(noll, np.array([total[j] for j in noll]).reshape(-1, TERMS), number(params, "field_scale"), screen)
