"""Pictures of the sky from Level-0 files: resampled to one grid, combined, in colour.

The stretch and the mixing of colours are those of Lupton et al. 2004 (PASP 116, 133).

The grid is that of one exposure's pixels. Other exposures are resampled bilinearly through their true geometry: field
distortion, aberration. Values are AB fluxes, so a source of equal flux per frequency in all bands is white. Flat field,
nonlinearity and defects are not corrected.
"""

from __future__ import annotations

import io
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from csstsim.base.arrays.robust_sigma import robust_sigma
from csstsim.catalog.astrometry.reduction import apparent, icrs
from csstsim.instrument.chip import Window
from csstsim.optics.geometry.wcs import chip_plane, mosaic_cd
from csstsim.report.thumbnail import binned

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from PIL import ImageFont
    from PIL.ImageDraw import ImageDraw

    from csstsim.base.types import FloatArray, IntArray
    from csstsim.io.level0 import Level0
    from csstsim.simulation.exposure import Exposure

NODES = 9  # positions along each side that are computed; others are interpolated, to 0.01 px
# noise of a pixel: black, and a third of white; Lupton's Q
BLACK = -1.0
STRETCH = 16.0
SOFTENING = 8.0
# A cosmic ray is so many sigma above another frame's value, which is below this fraction of it
RAY_SIGMA = 3.0
RAY_FRACTION = 0.3
QUALITY = 90  # of JPEG
Mark: TypeAlias = "Callable[[ImageDraw, tuple[int, int]], None]"  # draws on a picture of a size


@dataclass(frozen=True)
class Grid:
    """A grid of picture pixels on the sky: `window` of an exposure's chip in blocks of `step` x `step` pixels.

    Its columns count against those of the chip, so that the sky is as an observer sees it: north up, east to the left.
    """

    exposure: Exposure
    window: Window
    step: int = 1

    @property
    def shape(self) -> tuple[int, int]:
        """(ny, nx) of the picture."""
        return self.window.ny // self.step, self.window.nx // self.step

    def on(self, exposure: Exposure) -> list[FloatArray]:
        """Return x, y (ny, nx) on another exposure's chip [px] of the centres of the picture's pixels."""
        from scipy.interpolate import RectBivariateSpline

        ny, nx = self.shape
        rows = np.linspace(0, ny - 1, NODES)
        columns = np.linspace(0, nx - 1, NODES)
        middle = (self.step - 1) / 2
        x, y = np.meshgrid(self.window.x0 + columns * self.step + middle, self.window.y0 + rows * self.step + middle)
        sky = icrs(*self.exposure.wcs.pixel_to_world(x.ravel(), y.ravel()), self.exposure.observer)
        pixels = exposure.wcs.world_to_pixel(*apparent(*sky, exposure.observer))
        return [
            RectBivariateSpline(rows, columns, np.reshape(values, x.shape))(np.arange(ny), np.arange(nx))[:, ::-1]
            for values in pixels
        ]

    def north_east(self) -> FloatArray:
        """Return unit vectors (2, 2), rows north and east, in the picture: x right, y up."""
        turn, _ = chip_plane(self.exposure.chip)
        inverse = np.linalg.inv(mosaic_cd(self.exposure.pointing.pa, self.exposure.telescope) @ turn)
        return (inverse / np.hypot(*inverse)).T[::-1] * (-1.0, 1.0)


def plane(grid: Grid, exposure: Exposure, file: Level0) -> FloatArray:
    """Return the picture (ny, nx) of one exposure above its median, AB flux of one second; NaN outside its window.

    file: its open io.level0.Level0.
    """
    from scipy.ndimage import map_coordinates

    x, y = grid.on(exposure)
    part = _around(x, y, exposure.window)
    step = grid.step
    if part is None:
        return np.full(grid.shape, np.nan)
    image = binned(file, part, step)
    image -= np.median(image)
    at = [(v - start - (step - 1) / 2) / step for v, start in ((y, part.y0), (x, part.x0))]
    rate = map_coordinates(image, at, order=1, cval=np.nan) / exposure.exptime
    return rate * 10.0 ** (-0.4 * exposure.filter.zeropoint(exposure.telescope))


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

    So most cosmic rays and hot pixels vanish where there are two planes or more. Pixels that no plane has are 0.
    """
    low = np.fmin.reduce(planes)
    high = np.fmax.reduce(planes)
    if len(planes) > 2:
        middle = np.nanmedian(np.where(np.isnan(planes), low, planes), axis=0)
    else:
        sigma = max(map(noise_of, planes))
        ray = (high - low > RAY_SIGMA * math.sqrt(2) * sigma) & (low < RAY_FRACTION * high)
        middle = np.where(ray, low, 0.5 * (low + high))
    return np.nan_to_num(middle)


def colours(planes: Sequence[FloatArray], noise: float) -> IntArray:
    """Return (ny, nx, 3) uint8 of one plane (grey) or of three, the bluest first; noise: of a pixel of a plane."""
    from astropy.visualization import make_lupton_rgb

    blue, green, red = planes if len(planes) == 3 else [planes[0]] * 3
    return make_lupton_rgb(red, green, blue, minimum=BLACK * noise, stretch=STRETCH * noise, Q=SOFTENING)


def jpeg(rgb: IntArray, marks: Iterable[Mark] = ()) -> bytes:
    """Return the bytes of a JPEG; the first row is at the bottom. marks: functions that draw on a PIL ImageDraw."""
    from PIL import Image, ImageDraw

    stream = io.BytesIO()
    image = Image.fromarray(np.ascontiguousarray(rgb[::-1]))
    for mark in marks:
        mark(ImageDraw.Draw(image), image.size)
    image.save(stream, "jpeg", quality=QUALITY)
    return stream.getvalue()


def compass(grid: Grid) -> Mark:
    """Return the mark of arrows to north and east, in the lower left corner."""

    def mark(draw: ImageDraw, size: tuple[int, int]) -> None:
        font = _font(size)
        length = 0.06 * size[0]
        corner = np.array([0.1 * size[0], size[1] - 0.1 * size[0]])
        for name, (x, y) in zip("NE", grid.north_east(), strict=True):
            direction = np.array([x, -y])
            draw.line([*corner, *(corner + length * direction)], fill="white", width=2)
            draw.text(tuple(corner + 1.35 * length * direction), name, fill="white", font=font, anchor="mm")

    return mark


def ruler(grid: Grid) -> Mark:
    """Return the mark of a scale bar of about a sixth of the picture, in the lower right corner."""
    scale = grid.exposure.telescope.pixel_scale * grid.step  # arcsec of a pixel of the picture
    max_length = grid.shape[1] * scale / 6
    length = max((n for n in (0.5, 1, 2, 5, 10, 20, 30, 60, 120, 300) if n <= max_length), default=max_length)

    def mark(draw: ImageDraw, size: tuple[int, int]) -> None:
        x = 0.96 * size[0]
        y = 0.96 * size[1]
        draw.line([x - length / scale, y, x, y], fill="white", width=3)
        text = f"{length / 60:g}'" if length >= 60 else f'{length:g}"'
        draw.text((x - length / scale / 2, y - 0.012 * size[0]), text, fill="white", font=_font(size), anchor="mb")

    return mark


def _font(size: tuple[int, int]) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    from PIL import ImageFont

    return ImageFont.load_default(max(12, size[0] // 45))
