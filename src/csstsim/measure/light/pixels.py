"""The pixels of a frame, as arguments of compiled kernels."""

from typing import NamedTuple

from csstsim.base.types import FloatArray, IntArray


class Pixels(NamedTuple):
    """A frame without its background: `image`, float32 (ny, nx), electron.

    `unusable` uint8 (ny, nx): bits of the reasons not to use a pixel, 0 for good. On bins of BIN px: `rms` float32, the
    noise of a pixel, electron; `segments` int32, numbers of isophotes.
    """

    image: FloatArray
    rms: FloatArray
    unusable: IntArray
    segments: IntArray
