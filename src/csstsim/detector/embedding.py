"""The readout frame of an image (paper, Appendix B item 11) made in the image's own memory.

A second plane of a whole chip would cost 0.2 CPU s, most of it for the pages of new memory.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from csstsim.base.types import FloatArray
    from csstsim.detector.channels import ReadoutFrame


_ROWS = 16  # moved at a time: they fit in the cache


def embedded(planes: list[FloatArray], readout: ReadoutFrame) -> FloatArray:
    """Return `readout.embed(planes.pop())`, in the memory of that array if nothing else refers to it.

    planes: a list with the image (shape of the window), from which it is removed so that the caller has no reference to
    it; readout: a detector.channels.ReadoutFrame.
    """
    image = planes.pop()
    try:
        image.resize(readout.shape)  # numpy refuses where there is another reference, or a view
    except ValueError:
        return readout.embed(image)
    _move_to_frame(image, readout)
    return image


def _move_to_frame(frame: FloatArray, readout: ReadoutFrame) -> None:
    """Move the active pixels, contiguous at the beginning of `frame`, to their positions; set the others to 0.

    The last row is moved first, because a pixel never moves towards the beginning.
    """
    x0, x1, y0, y1 = readout.window
    image = frame.reshape(-1)[: (y1 - y0) * (x1 - x0)].reshape(y1 - y0, x1 - x0)
    columns = {block.slot: (block.active[1], block.image[1]) for block in readout.blocks}.values()
    halves = {block.half: (block.active[0], block.parallel_overscan[0], block.image[0]) for block in readout.blocks}
    for half in sorted(halves, reverse=True):
        active, overscan, rows = halves[half]
        if overscan.start > active.start:
            frame[overscan] = 0
        for end in range(rows.stop, rows.start, -_ROWS):
            start = max(end - _ROWS, rows.start)
            pixels = image[start:end].copy()
            target = frame[active.start + start - rows.start : active.start + end - rows.start]
            target[:] = 0
            for frame_columns, image_columns in columns:
                target[:, frame_columns] = pixels[:, image_columns]
        if overscan.start < active.start:
            frame[overscan] = 0
