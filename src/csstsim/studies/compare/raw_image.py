"""The stored pixels of a Level-0 file by readout channel, independent of layout and compression."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from csstsim.base.errors import InputError
from csstsim.detector.channels import ReadoutFrame
from csstsim.io.fits import image_header, read_header, read_pixels
from csstsim.io.level0 import read_level0

if TYPE_CHECKING:
    from fitsio import FITS

    from csstsim.base.types import AnyArray
    from csstsim.detector.channels import Block

PLANES = ("IMAGE", "MASK")


@dataclass(frozen=True)
class RawImage:
    """A Level-0 file's pixels.

    readout: ReadoutFrame of the whole chip; layout: of detector.channels; planes: {name: stored array}; channels:
    numbers of those that were read.
    """

    readout: ReadoutFrame
    layout: str
    planes: dict[str, AnyArray]
    channels: tuple[int, ...]

    def pixels(self, plane: str, block: Block) -> AnyArray:
        """Return a channel's pixels (block_ny, block_nx) in the order in which they are read; block: of `readout`."""
        stored = self.planes[plane]
        if self.layout != "channels":
            return stored[block.whole][block.as_read]
        return stored[:, block.stored_x0 : block.stored_x0 + self.readout.block_nx]


def raw_image(file: FITS, path: Path) -> RawImage | None:
    """Return the RawImage of an open FITS file, or None if it is not Level-0. Raises InputError if it is damaged."""
    if "IMAGE" not in file or not {"LAYOUT", "NCHAN"} <= read_header(file["IMAGE"], path).keys():
        return None
    header = image_header(file["IMAGE"], path)
    if header.get("BITPIX") != 16 or header.get("BZERO") != 32768:
        return None
    level0 = read_level0(path)
    readout = replace(level0.readout, window=(0, level0.readout.nx, 0, level0.readout.ny))
    planes = {name: read_pixels(file[name], path) for name in PLANES if name in file}
    for name, plane in planes.items():
        if plane.shape != readout.stored_shape(level0.layout):
            raise InputError("not of the image's shape", file=path, key=name, value=plane.shape)
    return RawImage(readout, level0.layout, planes, tuple(block.channel for block in level0.readout.blocks))
