"""Errors of an image against the truth: of its moments, of the worst pixel, and the error visible above the noise.

Moments are weighted with a Gaussian about the centroid; its sigma is 3 px, or the half-light radius if that is more:

    x = sum w I x / sum w I,  Qij = sum w I dx_i dx_j / sum w I,  size^2 = Qxx + Qyy,  e = (Qxx - Qyy, 2 Qxy) / size^2

The statistical error of a moment follows from the contribution of each random electron to it. An ideal filter detects
an error d with significance sqrt(sum d^2 / variance), the `visible` error in noise units. The expected contribution of
random electrons to that sum is subtracted, so that a bias shows in few realisations.

The stored PSF ends at the edge of its box; in an exposure a wing continues it. So pixels on that edge are excluded from
the worst pixel and from the visible error.
"""

from dataclasses import dataclass

import numpy as np

from csstsim.base.types import BoolArray, FloatArray

WINDOW_PX = 3.0
NAMES = ("flux", "x_mas", "y_mas", "e1", "e2", "size2", "pixel", "visible")
EDGE_PX = 1.5  # pixels nearer to the edge of the PSF's box, on either side, are excluded
_STEPS = 300
_SETTLED_PX = 1e-9


@dataclass(frozen=True)
class Moments:
    """`value`, `spread` (6,): flux, x, y [px], e1, e2, size^2 [px^2]; `spread` is the error from one electron."""

    value: FloatArray
    spread: FloatArray

    @property
    def flux(self) -> float:
        """The flux."""
        flux: float = self.value[0]
        return flux

    @property
    def size2(self) -> float:
        """The square of the size [px^2]."""
        size2: float = self.value[5]
        return size2


def moments(image: FloatArray, sigma: float = WINDOW_PX) -> Moments:
    """Return the Moments of an image of expected flux, about the middle of the array; `sigma` of the weight in px."""
    axis = np.arange(image.shape[0]) - (image.shape[0] - 1) / 2
    x = y = 0.0
    for _ in range(_STEPS):
        wx = np.exp(-0.5 * ((axis - x) / sigma) ** 2)
        wy = np.exp(-0.5 * ((axis - y) / sigma) ** 2)
        column_sums = wy @ image
        flux = column_sums @ wx
        new_x = column_sums @ (wx * axis) / flux
        new_y = (wy * axis) @ (image @ wx) / flux
        step = max(abs(new_x - x), abs(new_y - y))
        x = new_x
        y = new_y
        if step < _SETTLED_PX:
            break
    dx = axis - x
    dy = (axis - y)[:, None]
    fraction = image * wy[:, None] * wx / flux
    xx = (fraction * dx * dx).sum()
    yy = (fraction * dy * dy).sum()
    xy = (fraction * dx * dy).sum()
    size2 = xx + yy
    r2 = dx * dx + dy * dy
    e1 = (xx - yy) / size2
    e2 = 2 * xy / size2
    # Contribution of each electron; the divisors account for the weight, which moves with the centroid
    per_electron = (
        dx / (1 - xx / sigma**2),
        dy / (1 - yy / sigma**2),
        (dx * dx - dy * dy - e1 * r2) / size2,
        (2 * dx * dy - e2 * r2) / size2,
        r2 - size2,
    )
    total = image.sum()
    weight = fraction * wy[:, None] * wx / flux
    spread = [np.sqrt(max((weight * part**2).sum(), 0.0)) for part in per_electron]
    return Moments(np.array([total, x, y, e1, e2, size2]), np.array([np.sqrt(total), *spread]))


def errors(
    image: FloatArray,
    truth: FloatArray,
    variance: float,
    electrons: float,
    drawn: float = np.inf,
    *,
    box: float = np.inf,
    sigma: float = WINDOW_PX,
    mas_per_px: float = 74.0,
) -> tuple[FloatArray, FloatArray]:
    """Return (errors, their statistical errors), each (8,), in the order of NAMES, of an image per unit of flux.

    variance: of a pixel without the object [e-^2]; electrons: of the object; drawn: electrons that the image was
    rendered with; box: half the side of the PSF's box [px].
    Flux, size2: relative; pixel: largest difference over the peak; visible: in noise units, at `electrons`, negative
    if the images differ by less than chance would make them.
    """
    measured = moments(image, sigma)
    expected = moments(truth, sigma)
    scale = np.array([1 / expected.flux, mas_per_px, mas_per_px, 1.0, 1.0, 1 / expected.size2])
    axis = np.abs(np.arange(len(image)) - (len(image) - 1) / 2)
    counted = np.abs(np.maximum(axis, axis[:, None]) - box) > EDGE_PX
    difference = np.where(counted, image - truth, 0.0)
    visible_error, visible_chance = visible(image, truth, variance, electrons, drawn, counted)
    peak = np.abs(difference).argmax()
    values = [*(measured.value - expected.value) * scale, np.abs(difference).max() / truth.max(), visible_error]
    chance = [
        *expected.spread * np.abs(scale) / np.sqrt(drawn),
        np.sqrt(max(float(truth.flat[peak]), 0.0) / drawn) / truth.max(),
        visible_chance,
    ]
    return np.array(values), np.array(chance)


def visible(
    image: FloatArray,
    truth: FloatArray,
    variance: float,
    electrons: float,
    drawn: float,
    counted: BoolArray | bool = True,
) -> tuple[float, float]:
    """Return (visible error, that expected from chance alone) over the pixels that are `counted`; see `errors`."""
    noise2 = electrons * np.maximum(truth, 0) + variance
    visible_error = (electrons**2 * (image - truth) ** 2 / noise2 * counted).sum()
    # For a Poisson number n of mean m, (n - m)^2 - n has mean 0 and variance 2 m^2
    visible_error -= (electrons**2 / drawn * image / noise2 * counted).sum()
    shot = electrons**2 / drawn * np.maximum(truth, 0) / noise2 * counted
    return np.sign(visible_error) * np.sqrt(abs(visible_error)), (2 * (shot**2).sum()) ** 0.25
