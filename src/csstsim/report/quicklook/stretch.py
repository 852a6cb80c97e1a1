"""From pixel values to grey levels: limits from the background and its noise, and three stretches."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, cast

import numpy as np

from csstsim.base.arrays.robust_sigma import robust_sigma
from csstsim.base.errors import InputError
from csstsim.base.types import AnyArray, FloatArray, PathLike

if TYPE_CHECKING:
    from astropy.visualization import ImageNormalize
    from matplotlib.colors import Normalize

STRETCHES = ("asinh", "log", "linear")
BELOW = 2.0  # sigma below the background: the black level
MIN_WHITE = 10.0  # sigma above the background: the white level, or the lowest one of asinh and log
BRIGHT = 99.9  # percentile of the pixels: their white level, between MIN_WHITE ...
MAX_WHITE = {"asinh": 1000.0, "log": np.inf}  # ... and so many sigma
SOFT = 3.0  # sigma up to which asinh and log are linear


class Limits(NamedTuple):
    """Black level, white level and the background's scatter, in the unit of the pixels."""

    low: float
    high: float
    sigma: float


def robust_limits(values: FloatArray, stretch: str) -> Limits:
    """Return the Limits of finite `values` (any shape)."""
    level = cast("float", np.median(values))
    sigma = _scatter(values, level)
    above = MIN_WHITE
    if stretch in MAX_WHITE:
        above = float(np.clip((np.percentile(values, BRIGHT) - level) / sigma, MIN_WHITE, MAX_WHITE[stretch]))
    return Limits(float(level - BELOW * sigma), float(level + above * sigma), float(sigma))


def _scatter(values: FloatArray, level: float) -> float:
    """Return the background's scatter; it is above zero even if most or all pixels have one value."""
    spreads = (robust_sigma(values, level), np.ptp(np.percentile(values, (0.1, 99.9))), np.ptp(values))
    floor = 1e-6 * abs(level)  # smaller differences are float32 rounding
    return cast("float", next((s for s in spreads if s > floor), 0.01 * abs(level) or 1.0))


def make_norm(
    image: AnyArray,
    stretch: str | None,
    limits: tuple[float, float] | None = None,
    *,
    file: PathLike | None = None,
    bits: int | None = None,
) -> ImageNormalize:
    """Return the matplotlib norm of an image (NaN allowed) with one of STRETCHES; `limits` (low, high) or robust ones.

    stretch None: asinh, of a mask log. bits: the sum of a mask's bits, which has no background: limits are 0 and bits.
    Raises InputError if no pixel is finite or the limits are not low < high.
    """
    from astropy.visualization import AsinhStretch, ImageNormalize, LinearStretch, LogStretch

    values = image[np.isfinite(image)].astype(np.float64)
    if not values.size:
        raise InputError("no pixel of the part to be shown has a finite value", file=file)
    stretch = stretch or ("asinh" if bits is None else "log")
    low, high, sigma = robust_limits(values, stretch) if bits is None else (0.0, float(bits), 1 / SOFT)
    if limits is not None:
        if not (np.isfinite(limits).all() and 0 < limits[1] - limits[0] < np.inf):  # a difference may overflow
            raise InputError("not a range", file=file, key="--limits", value=tuple(limits), allowed="LOW < HIGH")
        low, high = limits
    soft = float(np.clip(SOFT * sigma / (high - low), 1e-4, 1.0))
    shape = {"asinh": lambda: AsinhStretch(soft), "log": lambda: LogStretch(1 / soft), "linear": LinearStretch}
    # not clipped: clipping would give a grey to pixels without a value
    return ImageNormalize(vmin=low, vmax=high, stretch=shape[stretch](), clip=False)


def bit_ticks(norm: Normalize) -> tuple[list[int], list[str]]:
    """Return (values, labels) at 0 and the powers of 2 within a norm's limits, for the colour bar of a mask."""
    every = [0, *(2**k for k in range(64))]
    values = [value for value in every if norm.vmin <= value <= norm.vmax]
    return values, [str(value) for value in values]


def ticks(norm: Normalize, count: int = 7) -> tuple[FloatArray, list[str]]:
    """Return (values, labels) at even steps of grey, for a colour bar; labels have just enough digits to differ."""
    values = np.asarray(norm.inverse(np.linspace(0.0, 1.0, count)), float)
    digits = max(0, int(np.ceil(-np.log10(np.diff(values).min()))) + 1)
    return values, [f"{value:.{digits}f}" if digits < 6 else f"{value:.6g}" for value in values]
