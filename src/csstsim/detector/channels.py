"""Readout geometry: the arrangement of active pixels in sixteen channels with prescan and overscan.

The detector is read through 2 x 8 amplifiers at its lower and upper edges (paper, section 2 and Appendix B,
item 11). In readout order, each channel has [prescan, active, overscan] columns, and its active rows are followed by
parallel overscan rows. Three arrangements of the same pixels are used:

mosaic    as on the detector: x = 4 x [prescan, active, overscan] then 4 x [overscan, active, prescan],
          y = [active, overscan | overscan, active]; 10000 x 9400 for the real detector
channels  the Level-0 arrangement: every channel mirrored so that its amplifier is at (0, 0), side by side in the
          order lower half left to right, then upper half right to left; 20000 x 4700
chip      the active pixels alone, as on the detector; 9216 x 9232
frame     the mosaic without the rows and columns that a windowed readout skips. A channel that the window
          touches keeps all its prescan and overscan columns and its half's overscan rows, so the frame is a
          rectangle

Arrays and integers only. Not modelled: the time order of readout, electronic crosstalk.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple, Self, cast

import numpy as np

from csstsim.base.types import AnyArray, IntArray

if TYPE_CHECKING:
    from csstsim.instrument.chip import Detector, Window

LAYOUTS = ("channels", "mosaic", "chip")
GEOMETRY = (
    "nx",
    "ny",
    "channels_x",
    "channels_y",
    "channel_nx",
    "channel_ny",
    "prescan",
    "overscan",
    "parallel_overscan",
)


class StoredAxis(NamedTuple):
    """An axis of a stored array: stored pixel X, 0-based, is chip pixel start + step X."""

    start: int
    step: int  # 1 or -1


class StoredAxes(NamedTuple):
    """The two axes of a stored array."""

    x: StoredAxis
    y: StoredAxis


class HalfRows(NamedTuple):
    """Mosaic rows of a half of the chip (0 lower, 1 upper) that a window touches."""

    half: int
    active: IntArray
    overscan: IntArray


class SlotColumns(NamedTuple):
    """Mosaic columns of a channel's position along x that a window touches, from left to right."""

    slot: int
    left: IntArray  # prescan, or overscan of a mirrored channel
    active: IntArray
    right: IntArray


@dataclass(frozen=True)
class Block:
    """One channel in a frame. A region is a pair of slices (rows, columns) of the frame, in mosaic orientation."""

    channel: int  # 1..16, Level-0 order
    half: int  # 0 lower, 1 upper
    slot: int  # 0..7, left to right
    rows: slice
    cols: slice
    active: tuple[slice, slice]
    prescan: tuple[slice, slice]  # next to the active rows
    serial_overscan: tuple[slice, slice]  # next to the active rows
    parallel_overscan: tuple[slice, slice]  # beyond the active columns
    image: tuple[slice, slice]  # position of `active` in the active image of the window
    flip_x: bool  # the stored channel is mirrored with respect to the mosaic
    flip_y: bool
    stored_x0: int  # first column in the `channels` layout

    @property
    def whole(self) -> tuple[slice, slice]:
        """Rows and columns of the whole block, prescan and overscan included."""
        return self.rows, self.cols

    @property
    def as_read(self) -> tuple[slice, slice]:
        """Slices that flip a region of the block into readout order (first row and column read first), or back."""
        y, x = (slice(None, None, -1 if flip else 1) for flip in (self.flip_y, self.flip_x))
        return y, x


@dataclass(frozen=True)
class ReadoutFrame:
    """The pixels produced by a readout of `window` = (x0, x1, y0, y1), half-open active pixels.

    Raises ValueError for a window outside the chip, or numbers that are not of a detector with 2 rows of an even number
    of channels.
    """

    window: tuple[int, int, int, int]
    nx: int
    ny: int
    channels_x: int
    channels_y: int
    channel_nx: int
    channel_ny: int
    prescan: int
    overscan: int
    parallel_overscan: int

    def __post_init__(self) -> None:
        if self.channels_y != 2 or self.channels_x % 2 or self.channels_x < 2:
            raise ValueError(f"{self.channels_y} x {self.channels_x} channels; need 2 rows of an even number")
        if self.nx != self.channels_x * self.channel_nx or self.ny != self.channels_y * self.channel_ny:
            raise ValueError(f"channels of {self.channel_nx} x {self.channel_ny} do not tile {self.nx} x {self.ny}")
        x0, x1, y0, y1 = self.window
        if not (0 <= x0 < x1 <= self.nx and 0 <= y0 < y1 <= self.ny):
            raise ValueError(f"window {self.window} is empty or outside the chip of {self.nx} x {self.ny} pixels")

    @classmethod
    def of(cls, detector: Detector | ReadoutFrame, window: Window | tuple[int, int, int, int] | None) -> Self:
        """Return the frame for a detector, any object with the attributes GEOMETRY; window None: the whole chip."""
        numbers = {name: int(getattr(detector, name)) for name in GEOMETRY}
        if window is None:
            window = (0, numbers["nx"], 0, numbers["ny"])
        elif not isinstance(window, tuple):
            window = (window.x0, window.x1, window.y0, window.y1)
        return cls(window=cast("tuple[int, int, int, int]", tuple(map(int, window))), **numbers)

    @property
    def n_channels(self) -> int:
        """Number of readout channels of the detector."""
        return self.channels_x * self.channels_y

    @property
    def block_nx(self) -> int:
        """Columns [px] of a whole channel: prescan, active, overscan."""
        return self.prescan + self.channel_nx + self.overscan

    @property
    def block_ny(self) -> int:
        """Rows [px] of a whole channel: active, parallel overscan."""
        return self.channel_ny + self.parallel_overscan

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns) of the frame."""
        return len(self.rows), len(self.cols)

    def of_file(self, layout: str) -> Self:
        """Return the frame of the pixels in a file of `layout`, of 'chip' without prescan and overscan."""
        return replace(self, prescan=0, overscan=0, parallel_overscan=0) if layout == "chip" else self

    def stored_shape(self, layout: str) -> tuple[int, int]:
        """(rows, columns) of the whole detector in one of LAYOUTS; ValueError for another."""
        if layout == "channels":
            return self.block_ny, self.block_nx * self.n_channels
        if layout == "mosaic":
            return self.block_ny * self.channels_y, self.block_nx * self.channels_x
        if layout == "chip":
            return self.ny, self.nx
        raise ValueError(f"unknown layout {layout!r}; known: {', '.join(LAYOUTS)}")

    @cached_property
    def rows(self) -> IntArray:
        """Mosaic row of each row of the frame, increasing (int array)."""
        return np.concatenate(
            [
                np.r_[active, overscan] if half == 0 else np.r_[overscan, active]
                for half, active, overscan in self._halves
            ]
        )

    @cached_property
    def cols(self) -> IntArray:
        """Mosaic column of each column of the frame, increasing (int array)."""
        return np.concatenate([np.r_[left, active, right] for _, left, active, right in self._slots])

    @cached_property
    def _halves(self) -> list[HalfRows]:
        """The rows of the halves that the window touches."""
        halves = []
        for half in range(2):
            low, high = _overlap(self.window[2:], half, self.channel_ny)
            if low < high:
                first = half * (self.block_ny + self.parallel_overscan)  # mosaic row of the half's first active row
                overscan = np.arange(self.parallel_overscan) + self.channel_ny + half * self.parallel_overscan
                halves.append(HalfRows(half, np.arange(first + low, first + high), overscan))
        return halves

    @cached_property
    def _slots(self) -> list[SlotColumns]:
        """The columns of the slots that the window touches."""
        slots = []
        for slot in range(self.channels_x):
            low, high = _overlap(self.window[:2], slot, self.channel_nx)
            if low < high:
                left = self.prescan
                right = self.overscan
                if self._mirrored(slot):
                    left, right = right, left
                x = slot * self.block_nx
                first = x + left
                end = x + left + self.channel_nx
                active = np.arange(first + low, first + high)
                slots.append(SlotColumns(slot, np.arange(x, first), active, end + np.arange(right)))
        return slots

    def _mirrored(self, slot: int) -> bool:
        return slot >= self.channels_x // 2

    @cached_property
    def blocks(self) -> list[Block]:
        """The channels that the window touches as `Block`s, in Level-0 order."""
        blocks = []
        row = 0
        for half, active, overscan in self._halves:
            spans = _spans(row, [active, overscan] if half == 0 else [overscan, active])
            y_active, y_scan = spans if half == 0 else spans[::-1]
            row = spans[-1].stop
            col = 0
            for slot, *columns in self._slots:
                x_spans = _spans(col, columns)
                col = x_spans[-1].stop
                blocks.append(self._block(half, slot, y_active, y_scan, x_spans))
        return sorted(blocks, key=lambda block: block.channel)

    def _block(self, half: int, slot: int, y_active: slice, y_scan: slice, x_spans: list[slice]) -> Block:
        """Return a Block; slices of the frame: active and overscan rows, and left, active and right columns."""
        x_left, x_active, x_right = x_spans
        mirrored = self._mirrored(slot)
        x_pre, x_over = (x_right, x_left) if mirrored else (x_left, x_right)
        number = self.channels_x * half + (self.channels_x - 1 - slot if half else slot)
        x0, _, y0, _ = self.window
        y_low, y_high = _overlap(self.window[2:], half, self.channel_ny, half * self.channel_ny - y0)
        x_low, x_high = _overlap(self.window[:2], slot, self.channel_nx, slot * self.channel_nx - x0)
        return Block(
            channel=number + 1,
            half=half,
            slot=slot,
            flip_x=mirrored,
            flip_y=half == 1,
            rows=slice(min(y_active.start, y_scan.start), max(y_active.stop, y_scan.stop)),
            cols=slice(x_left.start, x_right.stop),
            active=(y_active, x_active),
            prescan=(y_active, x_pre),
            serial_overscan=(y_active, x_over),
            parallel_overscan=(y_scan, x_active),
            image=(slice(y_low, y_high), slice(x_low, x_high)),
            stored_x0=number * self.block_nx,
        )

    def embed(self, image: AnyArray) -> AnyArray:
        """Return a frame with the active `image` (shape of the window) at its position and zeros elsewhere."""
        frame = np.zeros(self.shape, image.dtype)
        for block in self.blocks:
            frame[block.active] = image[block.image]
        return frame

    def active(self, frame: AnyArray) -> AnyArray:
        """Return the active pixels of `frame` as one image (shape of the window): the inverse of `embed`."""
        x0, x1, y0, y1 = self.window
        image = np.empty((y1 - y0, x1 - x0), frame.dtype)
        for block in self.blocks:
            image[block.image] = frame[block.active]
        return image

    def to_stored(self, frame: AnyArray, layout: str) -> AnyArray:
        """Return the array of the whole detector (`stored_shape`) in `layout`; pixels that were not read out are 0.

        'chip' has no prescan and overscan. Raises ValueError for a frame that does not have `shape`.
        """
        if frame.shape != self.shape:
            raise ValueError(f"frame of shape {frame.shape}; the readout gives {self.shape}")
        if (inner := self.of_file(layout)) != self:
            return inner.to_stored(self.active(frame), layout)
        stored = np.zeros(self.stored_shape(layout), frame.dtype)
        for in_frame, in_stored in self.pieces(layout):
            stored[in_stored] = frame[in_frame]
        return stored

    def from_stored(self, stored: AnyArray, layout: str) -> AnyArray:
        """Return the frame (of `shape`) from a stored array: the inverse of `to_stored`; absent scans are 0.

        Raises ValueError for an array that does not have `stored_shape`.
        """
        if stored.shape != self.stored_shape(layout):
            raise ValueError(f"stored array of shape {stored.shape}; expected {self.stored_shape(layout)}")
        if (inner := self.of_file(layout)) != self:
            return self.embed(inner.from_stored(stored, layout))
        frame = np.empty(self.shape, stored.dtype)
        for in_frame, in_stored in self.pieces(layout):
            frame[in_frame] = stored[in_stored]
        return frame

    def pieces(self, layout: str) -> Iterator[tuple[tuple[slice, slice], tuple[slice, slice]]]:
        """Yield (frame region, stored region), pairs of slices; a mirrored stored axis has step -1."""
        for block in self.blocks:
            y_parts = _runs(self.rows[block.rows], block.rows.start)
            x_parts = _runs(self.cols[block.cols], block.cols.start)
            for y_frame, y_mosaic in y_parts:
                for x_frame, x_mosaic in x_parts:
                    yield (y_frame, x_frame), self.stored_region(block, (y_mosaic, x_mosaic), layout)

    def stored_region(self, block: Block, mosaic_region: tuple[slice, slice], layout: str) -> tuple[slice, slice]:
        """Return the slices [px] of the stored array that hold a region of the mosaic inside `block`.

        Raises ValueError for a layout that is unknown, or 'chip' of a frame with prescan or overscan.
        """
        if self._as_on_chip(layout):
            return mosaic_region
        self.stored_shape(layout)
        y, x = mosaic_region
        y = _local(y, block.half * self.block_ny, self.block_ny, block.flip_y, 0)
        return y, _local(x, block.slot * self.block_nx, self.block_nx, block.flip_x, block.stored_x0)

    def _as_on_chip(self, layout: str) -> bool:
        """True for 'mosaic', and for 'chip', which is the mosaic of a frame without scans (`of_file`)."""
        if layout == "chip" and self.of_file(layout) != self:
            raise ValueError("a stored chip has no prescan and overscan: ask the frame of `of_file`")
        return layout in ("mosaic", "chip")

    def stored_axis(self, block: Block, layout: str) -> StoredAxes:
        """Return the StoredAxes [px] of a block in `layout`. Raises ValueError as `stored_region`."""
        first_x = block.slot * self.channel_nx
        first_y = block.half * self.channel_ny
        if self._as_on_chip(layout):
            lead_x = self.overscan if block.flip_x else self.prescan
            lead_y = 2 * self.parallel_overscan if block.flip_y else 0
            return StoredAxes(StoredAxis(first_x - block.slot * self.block_nx - lead_x, 1), StoredAxis(-lead_y, 1))
        self.stored_shape(layout)
        x = block.stored_x0 + self.prescan  # stored column of the first pixel to reach the amplifier
        return StoredAxes(
            StoredAxis(*((first_x + self.channel_nx - 1 + x, -1) if block.flip_x else (first_x - x, 1))),
            StoredAxis(*((first_y + self.channel_ny - 1, -1) if block.flip_y else (first_y, 1))),
        )


def _overlap(bounds: tuple[int, int], index: int, size: int, shift: int = 0) -> tuple[int, int]:
    """Return half-open `bounds` cut to tile `index`, relative to the tile's start, plus `shift`."""
    low = max(bounds[0] - index * size, 0)
    return low + shift, min(bounds[1] - index * size, size) + shift


def _spans(start: int, parts: Sequence[IntArray]) -> list[slice]:
    """Return the slices of arrays that follow one another from `start` on."""
    spans = []
    for part in parts:
        spans.append(slice(start, start + len(part)))
        start += len(part)
    return spans


def _runs(index: IntArray, start: int) -> list[tuple[slice, slice]]:
    """Split increasing integers into runs of neighbours: [(slice in the frame, slice of values)]."""
    cuts = np.flatnonzero(np.diff(index) != 1) + 1
    edges = [0, *cuts.tolist(), len(index)]
    return [(slice(start + a, start + b), slice(int(index[a]), int(index[b - 1]) + 1)) for a, b in pairwise(edges)]


def _local(part: slice, start: int, size: int, flip: bool, offset: int) -> slice:
    """Return a mosaic slice as a slice of the stored block that begins at `offset`, mirrored if `flip`."""
    low = part.start - start
    high = part.stop - start
    if not flip:
        return slice(offset + low, offset + high)
    stop = offset + size - 1 - high
    return slice(offset + size - 1 - low, stop if stop >= 0 else None, -1)
