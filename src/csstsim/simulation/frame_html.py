"""What a notebook shows of a Frame: a thumbnail, and a line for each fact."""

from __future__ import annotations

import base64
import io
from html import escape
from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.arrays.robust_sigma import robust_sigma
from csstsim.base.plural import number_of
from csstsim.catalog.table import TYPES

if TYPE_CHECKING:
    from csstsim.base.types import AnyArray, FloatArray
    from csstsim.simulation.frame import Frame

SIDE = 240  # px of the thumbnail's longer side
# sigma of the background: the black level below it, the lowest white level above it
BELOW = 2.0
WHITE = 30.0
NAMES = [(name, "galaxies" if name == "galaxy" else None) for name in TYPES]  # one, several; by obj_type


def frame_html(frame: Frame) -> str:
    """Return a Frame as HTML: thumbnail, exposure, chip, filter, window and counts of objects."""
    kinds, counts = np.unique(np.asarray(frame.truth["obj_type"], int), return_counts=True)
    objects = ", ".join(number_of(n, *NAMES[kind]) for kind, n in zip(kinds, counts, strict=True))
    obsid, chip = frame.key or ("-", "-")
    w = frame.window
    facts = {
        "exposure": obsid,
        "chip": chip,
        "filter": frame.filter,
        "window": f"x {w.x0} to {w.x1}, y {w.y0} to {w.y1}",
        "image": f"{frame.image.dtype} [{frame.unit}]",
        "truth": objects or "no objects",
    }
    rows = "".join(f"<tr><th>{name}</th><td>{escape(str(value))}</td></tr>" for name, value in facts.items())
    source = base64.b64encode(_png(frame.image)).decode()
    picture = f'<img alt="thumbnail" src="data:image/png;base64,{source}">'
    return f'<div style="display: flex; gap: 1em; align-items: center">{picture}<table>{rows}</table></div>'


def _png(image: AnyArray) -> bytes:
    """Return a thumbnail of an image (ny, nx), row 0 at the bottom, as PNG; pixels without a value are black."""
    from PIL import Image

    step = max(1, -(-max(image.shape) // SIDE))
    down, along = (min(step, n) for n in image.shape)
    ny = image.shape[0] // down
    nx = image.shape[1] // along
    blocks = image[: ny * down, : nx * along].reshape(ny, down, nx, along)
    small = np.asarray(blocks.mean(axis=(1, 3), dtype=np.float64))
    grey = (255 * _stretched(small)).astype(np.uint8)[::-1]
    buffer = io.BytesIO()
    Image.fromarray(grey).save(buffer, "PNG")
    return buffer.getvalue()


def _stretched(image: FloatArray) -> FloatArray:
    """Return an image as grey levels 0 to 1: asinh from BELOW the median, to WHITE or the brightest pixels."""
    values = image[np.isfinite(image)]
    if not values.size or not np.ptp(values):
        return np.zeros_like(image)
    level = float(np.median(values))
    sigma = robust_sigma(values, level) or float(np.ptp(values)) / WHITE
    above = max(WHITE, (float(np.percentile(values, 99.9)) - level) / sigma)
    scaled = np.arcsinh((np.nan_to_num(image, nan=-np.inf) - level) / sigma + BELOW) / np.arcsinh(above + BELOW)
    return np.asarray(np.clip(scaled, 0.0, 1.0))
