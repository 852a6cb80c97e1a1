"""Pictures as the bytes of small WebP files: photographs with losses, charts in fewer colours."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from PIL.Image import Image
    from PIL.ImageDraw import ImageDraw

    from csstsim.base.types import IntArray

QUALITY = 75  # of a photograph, in percent
LEVELS = 64  # of each colour of a chart: no line or letter changes visibly
Mark: TypeAlias = "Callable[[ImageDraw, tuple[int, int]], None]"  # draws on a picture of a size


def photograph(pixels: IntArray, marks: Iterable[Mark] = ()) -> bytes:
    """Return the bytes of a WebP; the first row is at the bottom.

    pixels: uint8, greys (ny, nx) or colours (ny, nx, 3); marks: functions that draw on a PIL ImageDraw.
    """
    from PIL import Image, ImageDraw

    image = Image.fromarray(np.ascontiguousarray(pixels[::-1]))
    for mark in marks:
        mark(ImageDraw.Draw(image), image.size)
    return _webp(image, quality=QUALITY)


def chart(png: bytes) -> bytes:
    """Return a PNG of lines and letters as a WebP of LEVELS levels a colour, without other losses."""
    from PIL import Image

    pixels = np.asarray(Image.open(io.BytesIO(png)).convert("RGB"))
    step = 255 / (LEVELS - 1)
    return _webp(Image.fromarray(np.rint(np.rint(pixels / step) * step).astype(np.uint8)), lossless=True)


def _webp(image: Image, **options: int) -> bytes:
    stream = io.BytesIO()
    image.save(stream, "webp", **options)
    return stream.getvalue()
