"""The pixels of a frame, as arguments of compiled kernels."""

from typing import NamedTuple

from csstsim.base.types import FloatArray, IntArray


class Pixels(NamedTuple):
    """A frame without its background: `image` and its noise `rms`, float32 (ny, nx), electron.

    `unusable` uint8 (ny, nx): bits of the reasons not to use a pixel, 0 for good; `segments` int32: numbers of
    isophotes, on bins of BIN px.
    """

    image: FloatArray
    rms: FloatArray
    unusable: IntArray
    segments: IntArray
