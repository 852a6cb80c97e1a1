"""The readout frame of an image (paper, Appendix B item 11) made in the image's own memory.

A second plane of a whole chip would cost 0.2 CPU s, most of it for the pages of new memory.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from csstsim.base.types import FloatArray
    from csstsim.detector.channels import ReadoutFrame


_ROWS = 16  # moved at a time, so that they stay in the cache


def embedded(planes: list[FloatArray], readout: ReadoutFrame) -> FloatArray:
    """Return `readout.embed(planes.pop())`, in the memory of that array if nothing else refers to it.

    planes: a list of the image (shape of the window), so that it can be taken from the caller; readout: a
    detector.channels.ReadoutFrame.
    """
    image = planes.pop()
    try:
        image.resize(readout.shape)  # numpy refuses where there is another reference, or a view
    except ValueError:
        return readout.embed(image)
    _spread(image, readout)
    return image


def _spread(frame: FloatArray, readout: ReadoutFrame) -> None:
    """Move the active pixels, one after another at the beginning of `frame`, to their places; the others become 0.

    From the last row to the first: a pixel's place never lies before its old one.
    """
    x0, x1, y0, y1 = readout.window
    old = frame.reshape(-1)[: (y1 - y0) * (x1 - x0)].reshape(y1 - y0, x1 - x0)
    columns = {block.slot: (block.active[1], block.image[1]) for block in readout.blocks}.values()
    halves = {block.half: (block.active[0], block.parallel_overscan[0], block.image[0]) for block in readout.blocks}
    for half in sorted(halves, reverse=True):
        active, overscan, rows = halves[half]
        if overscan.start > active.start:
            frame[overscan] = 0
        for end in range(rows.stop, rows.start, -_ROWS):
            start = max(end - _ROWS, rows.start)
            moved = old[start:end].copy()
            to = frame[active.start + start - rows.start : active.start + end - rows.start]
            to[:] = 0
            for there, here in columns:
                to[:, there] = moved[:, here]
        if overscan.start < active.start:
            frame[overscan] = 0
