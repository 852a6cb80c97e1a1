"""What a notebook shows of a Frame: a thumbnail, and a line for each fact."""

from __future__ import annotations

import base64
import io
from html import escape
from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.plural import number_of
from csstsim.catalog.table import TYPES

if TYPE_CHECKING:
    from csstsim.base.types import AnyArray
    from csstsim.simulation.frame import Frame

SIDE = 240  # px of the thumbnail's longer side
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

    from csstsim.report.quicklook.stretch import make_norm

    step = max(1, -(-max(image.shape) // SIDE))
    down, along = (min(step, n) for n in image.shape)
    ny = image.shape[0] // down
    nx = image.shape[1] // along
    blocks = image[: ny * down, : nx * along].reshape(ny, down, nx, along)
    small = np.asarray(blocks.mean(axis=(1, 3), dtype=np.float64))
    scaled = make_norm(small, None)(small) if np.isfinite(small).any() else np.zeros_like(small)
    grey = (255 * np.clip(np.nan_to_num(np.ma.filled(scaled, 0.0)), 0.0, 1.0)).astype(np.uint8)[::-1]
    buffer = io.BytesIO()
    Image.fromarray(grey).save(buffer, "PNG")
    return buffer.getvalue()
