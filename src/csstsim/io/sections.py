"""Positions of a channel's pixels in the form of IRAF, ds9 and ccdproc: `[x0:x1,y0:y1]`, from 1, both ends included.

DATASEC  the active pixels that were read, in the stored array; TRIMSEC is the same
BIASSEC  the serial overscan next to them
CCDSEC   position of the active pixels on the chip
DETSEC   the same, from high to low along an axis in which the stored pixels are mirrored
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from csstsim.detector.channels import Block, ReadoutFrame


def sections(readout: ReadoutFrame, block: Block, layout: str, first: int = 0) -> dict[str, str]:
    """Return {keyword: section} of a channel (detector.channels.Block of ReadoutFrame `readout`) in a stored layout.

    first: the stored column that counts as the first. Without overscan there is no BIASSEC.
    """
    data = stored_slices(readout, block, block.active, layout)
    bias = stored_slices(readout, block, block.serial_overscan, layout) if readout.overscan else None
    x0, _, y0, _ = readout.window
    chip = [slice(part.start + start, part.stop + start) for part, start in zip(block.image, (y0, x0), strict=True)]
    result = {"DATASEC": _section(data, first), "TRIMSEC": _section(data, first)}
    result |= {"BIASSEC": _section(bias, first)} if bias else {}
    return result | {"CCDSEC": _section(chip), "DETSEC": _section(chip, mirrored=[part.step == -1 for part in data])}


def section_lists(readout: ReadoutFrame, layout: str) -> dict[str, list[str | None]]:
    """Return {keyword: [section of channel 1, 2, ...]}; None for a channel that was not read."""
    by_channel = {block.channel: sections(readout, block, layout) for block in readout.blocks}
    names = "DATASEC", "TRIMSEC", "BIASSEC", "CCDSEC", "DETSEC"
    return {name: [by_channel.get(n, {}).get(name) for n in range(1, readout.n_channels + 1)] for name in names}


def stored_slices(readout: ReadoutFrame, block: Block, region: tuple[slice, slice], layout: str) -> tuple[slice, slice]:
    """Return the slices of the stored array that hold a region of a block, contiguous on the chip and not empty."""
    rows = readout.rows[region[0]]
    cols = readout.cols[region[1]]
    y = slice(int(rows[0]), int(rows[-1]) + 1)
    x = slice(int(cols[0]), int(cols[-1]) + 1)
    return readout.stored_region(block, (y, x), layout)


def _section(slices: Sequence[slice], first: int = 0, mirrored: Sequence[bool] = (False, False)) -> str:
    spans = []
    for part, reverse, skipped in zip(slices, mirrored, (0, first), strict=True):
        start, end, step = part.indices(2**31)
        low, high = sorted((start + 1 - skipped, end - step + 1 - skipped))
        spans.append(f"{high}:{low}" if reverse else f"{low}:{high}")
    return f"[{spans[1]},{spans[0]}]"
