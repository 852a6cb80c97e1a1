"""Sources measured strip by strip: the numbers of isophotes are at full size for a strip of rows only."""

from dataclasses import replace

import numpy as np

from csstsim.measure.detection.maps import fill_rows

HEIGHT = 2048  # px
WIDTHS, MARGIN = 20.0, 140.0  # major axes and px about a source: what a measurement may touch


def strips(found):
    """Yield (rows, part, first) that cover the `combine.Detections` `found`, whose `segments` are binned.

    `rows`: of `found`; `part`: these, with image, noise and isophotes at full size from row `first` of the frame on,
    and `y` from there. A source whose reach is larger than a strip is in a strip of its own height. The isophotes of a
    part are overwritten by those of the next.
    """
    (ny, nx), room = found.image.shape, np.empty(0, found.segments.dtype)
    reach = WIDTHS * found.a + MARGIN
    group = 2 * (np.nan_to_num(found.y) // HEIGHT).astype(int) + (reach > HEIGHT // 2)
    for number in np.unique(group) if len(group) else [0]:
        rows = np.flatnonzero(group == number)
        first = int(max((found.y - reach)[rows].min(initial=ny), 0.0))
        first, last = min(first, ny - 1), int(min((found.y + reach)[rows].max(initial=0.0) + 2.0, ny))
        some = np.s_[first : max(last, first + 1)]
        size = (some.stop - first) * nx
        room = room if room.size >= size else np.empty(size, room.dtype)
        segments = room[:size].reshape(-1, nx)
        fill_rows(found.segments, first, segments)
        columns = {
            name: value[rows] for name, value in vars(found).items() if name not in ("image", "rms", "segments", "y")
        }
        yield rows, replace(
            found, **columns, y=found.y[rows] - first, image=found.image[some], rms=found.rms[some],
            segments=segments,
        ), first  # fmt: skip
