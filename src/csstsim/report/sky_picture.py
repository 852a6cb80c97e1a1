"""Pictures of the sky from Level-0 files: resampled to one grid, combined, in colour.

The stretch and the mixing of colours are those of Lupton et al. 2004 (PASP 116, 133).

North is up, east to the left. The exposures are resampled bilinearly through their true geometry: field distortion,
aberration. Values are AB fluxes, so a source of equal flux per frequency in all bands is white. Flat field,
nonlinearity and defects are not corrected.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.arrays.robust_sigma import robust_sigma
from csstsim.base.sphere import frames, ra_dec
from csstsim.catalog.astrometry.reduction import apparent, icrs
from csstsim.instrument.chip import Window
from csstsim.report.thumbnail import any_in_blocks, binned

if TYPE_CHECKING:
    from collections.abc import Sequence

    from PIL import ImageFont
    from PIL.ImageDraw import ImageDraw

    from csstsim.base.types import BoolArray, FloatArray, IntArray
    from csstsim.io.level0 import Level0
    from csstsim.report.pictures import Mark
    from csstsim.simulation.exposure import Exposure

NODES = 9  # positions along each side that are computed; others are interpolated, to 0.01 px
# noise of a pixel: black, and a third of white; Lupton's Q
BLACK = -1.0
STRETCH = 16.0
SOFTENING = 8.0
# A cosmic ray is so many sigma above another frame's value, which is below this fraction of it, within a pixel
RAY_SIGMA = 3.0
RAY_FRACTION = 0.3
FULL = 0.5  # of the full well: a brighter pixel counts as saturated (the ADC clips before the full well)
WHITE = 255


@dataclass(frozen=True)
class Grid:
    """A grid of picture pixels on the sky, in the plane that touches it at `centre`: north up, east to the left.

    centre: ICRS ra, dec [deg]; scale: arcsec of a pixel of the picture; shape: (ny, nx), the first row at the bottom;
    step: pixels of a chip along a pixel of the picture.
    """

    centre: tuple[float, float]
    scale: float
    shape: tuple[int, int]
    step: int = 1

    @classmethod
    def around(cls, exposure: Exposure, window: Window, step: int = 1) -> Grid:
        """Return the grid about the middle of a window of an exposure's chip, as large as the window."""
        middle = 0.5 * (window.x0 + window.x1 - 1), 0.5 * (window.y0 + window.y1 - 1)
        ra, dec = icrs(*exposure.wcs.pixel_to_world(*middle), exposure.observer)
        shape = window.ny // step, window.nx // step
        return cls((float(ra), float(dec)), exposure.telescope.pixel_scale * step, shape, step)

    def sky(self, rows: FloatArray, columns: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return ICRS ra, dec [deg] at rows and columns of the picture, which broadcast."""
        ny, nx = self.shape
        ahead, east, north = frames(*np.radians(self.centre))
        to_east = np.radians((0.5 * (nx - 1) - columns) * self.scale / 3600)
        to_north = np.radians((rows - 0.5 * (ny - 1)) * self.scale / 3600)
        return ra_dec(ahead + to_east[..., None] * east + to_north[..., None] * north)

    def on(self, exposure: Exposure) -> list[FloatArray]:
        """Return x, y (ny, nx) on an exposure's chip [px] of the centres of the picture's pixels."""
        from scipy.interpolate import RectBivariateSpline

        ny, nx = self.shape
        rows = np.linspace(0, ny - 1, NODES)
        columns = np.linspace(0, nx - 1, NODES)
        at_nodes = self.sky(*np.meshgrid(rows, columns, indexing="ij"))
        pixels = exposure.wcs.world_to_pixel(*apparent(*at_nodes, exposure.observer))
        return [RectBivariateSpline(rows, columns, values)(np.arange(ny), np.arange(nx)) for values in pixels]


def plane(grid: Grid, exposure: Exposure, file: Level0) -> FloatArray:
    """Return the picture (ny, nx) of one exposure above its median, AB flux of one second.

    It is NaN outside the exposure's window, and infinite where a pixel is saturated. file: its open io.level0.Level0.
    """
    from scipy.ndimage import map_coordinates

    x, y = grid.on(exposure)
    part = _around(x, y, exposure.window)
    step = grid.step
    if part is None:
        return np.full(grid.shape, np.nan)
    image = binned(file, part, step)
    full = any_in_blocks(binned(file, part, 1) > FULL * exposure.chip.detector.full_well, step)
    image -= np.median(image)
    at = [(v - start - (step - 1) / 2) / step for v, start in ((y, part.y0), (x, part.x0))]
    rate = map_coordinates(image, at, order=1, cval=np.nan) / exposure.exptime
    touched = map_coordinates(full.astype(float), at, order=1) > 0
    return np.where(touched, np.inf, rate * 10.0 ** (-0.4 * exposure.filter.zeropoint(exposure.telescope)))


def _around(x: FloatArray, y: FloatArray, window: Window, margin: int = 2) -> Window | None:
    """Return the Window of all pixels x, y with a margin, within `window`, or None."""
    x0 = max(math.floor(x.min()) - margin, window.x0)
    y0 = max(math.floor(y.min()) - margin, window.y0)
    x1 = min(math.ceil(x.max()) + margin + 1, window.x1)
    y1 = min(math.ceil(y.max()) + margin + 1, window.y1)
    return Window(x0, x1, y0, y1) if x0 < x1 and y0 < y1 else None


def noise_of(image: FloatArray) -> float:
    """Return the robust sigma of an image about its median (NaN allowed); 0 without a finite pixel."""
    good = image[np.isfinite(image)]
    return float(robust_sigma(good)) if good.size else 0.0


def combined(planes: Sequence[FloatArray]) -> FloatArray:
    """Return the median of planes (ny, nx) of one band; of two, the mean, or the lower at a cosmic ray.

    So most cosmic rays and hot pixels vanish where there are two planes or more. Pixels that no plane has are 0. A
    pixel is infinite if it is saturated in all planes that have it.
    """
    open_planes = [np.where(np.isinf(one), np.nan, one) for one in planes]
    low = np.fmin.reduce(open_planes)
    high = np.fmax.reduce(open_planes)
    if len(planes) > 2:
        middle = np.nanmedian(np.where(np.isnan(open_planes), low, open_planes), axis=0)
    else:
        middle = np.where(_rays(planes, low, high), low, 0.5 * (low + high))
    return np.where(np.isnan(low) & np.isinf(planes).any(axis=0), np.inf, np.nan_to_num(middle))


def _rays(planes: Sequence[FloatArray], low: FloatArray, high: FloatArray) -> BoolArray:
    """Return the mask of pixels at which the higher one of two planes has a cosmic ray.

    The lower plane is below RAY_FRACTION of it there and next to it: next to a star's peak, an undersampled image may
    differ as much between two planes.
    """
    from scipy.ndimage import maximum_filter

    sigma = max(map(noise_of, planes))
    around = [maximum_filter(np.where(np.isnan(one), -np.inf, one), 3) for one in planes]
    beside = np.where(planes[0] < planes[-1], around[0], around[-1])
    return (high - low > RAY_SIGMA * math.sqrt(2) * sigma) & (beside < RAY_FRACTION * high)


def colours(planes: Sequence[FloatArray], noise: float) -> IntArray:
    """Return (ny, nx, 3) uint8 of one plane (grey) or of three, the bluest first; noise: of a pixel of a plane.

    One stretch of the mean of the three sets the brightness, so a bright core keeps its colour. A pixel that is
    infinite (saturated) in any plane, or next to one, is white: the ratio of its fluxes is unknown.
    """
    from astropy.visualization import make_lupton_rgb
    from scipy.ndimage import maximum_filter

    saturated = np.isinf(planes).any(axis=0)
    white = maximum_filter(saturated, 3)
    blue, green, red = (np.where(saturated, 0.0, one) for one in (planes if len(planes) == 3 else [planes[0]] * 3))
    rgb = make_lupton_rgb(red, green, blue, minimum=BLACK * noise, stretch=STRETCH * noise, Q=SOFTENING)
    rgb[white] = WHITE
    return rgb


def compass(draw: ImageDraw, size: tuple[int, int]) -> None:
    """Draw arrows to north (up) and east (left) in the lower left corner."""
    font = _font(size)
    length = 0.06 * size[0]
    corner = np.array([0.1 * size[0], size[1] - 0.1 * size[0]])
    for name, direction in (("N", np.array([0.0, -1.0])), ("E", np.array([-1.0, 0.0]))):
        draw.line([*corner, *(corner + length * direction)], fill="white", width=2)
        draw.text(tuple(corner + 1.35 * length * direction), name, fill="white", font=font, anchor="mm")


def ruler(grid: Grid) -> Mark:
    """Return the mark of a scale bar of about a sixth of the picture, in the lower right corner."""
    max_length = grid.shape[1] * grid.scale / 6
    length = max((n for n in (0.5, 1, 2, 5, 10, 20, 30, 60, 120, 300) if n <= max_length), default=max_length)

    def mark(draw: ImageDraw, size: tuple[int, int]) -> None:
        x = 0.96 * size[0]
        y = 0.96 * size[1]
        draw.line([x - length / grid.scale, y, x, y], fill="white", width=3)
        text = f"{length / 60:g}'" if length >= 60 else f'{length:g}"'
        draw.text((x - length / grid.scale / 2, y - 0.012 * size[0]), text, fill="white", font=_font(size), anchor="mb")

    return mark


def _font(size: tuple[int, int]) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    from PIL import ImageFont

    return ImageFont.load_default(max(12, size[0] // 45))
