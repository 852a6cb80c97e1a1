"""Parameters of a transfer of charge: the traps, the keys of their random numbers, and which part of a chip moves.

The process is that of detector.charge_transfer.cti.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from csstsim.base.types import FloatArray

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import ArrayLike

    from csstsim.base.rng import Streams
    from csstsim.detector.channels import Block
    from csstsim.instrument.chip import Detector, Window
    from csstsim.instrument.traps import Traps


class Well(NamedTuple):
    """The pixel's well: power beta of the volume that a packet fills, full well [e-], notch [e-]."""

    beta: float
    full_well: float
    notch: float


class TrapModel(NamedTuple):
    """Species of traps in a well. Use `trap_model`: compiled code needs these types."""

    density: FloatArray  # (n_species,) float64 [traps/pixel]
    timescale: FloatArray  # (n_species,) float64 [transfers]
    well: Well


def trap_model(density: ArrayLike, timescale: ArrayLike, well: Iterable[float]) -> TrapModel:
    """Return the TrapModel of density [traps/pixel] and timescale [transfers], (n_species,) each; well: as Well."""
    return TrapModel(np.array(density, np.float64), np.array(timescale, np.float64), Well(*map(float, well)))


def scaled_model(traps: Traps, scale: float) -> TrapModel:
    """Return the TrapModel of instrument.traps.Traps, with `scale` times the density of each species."""
    return trap_model(scale * np.array(traps.density), traps.timescale, (traps.beta, traps.full_well, traps.notch))


class TrapKeys(NamedTuple):
    """uint64 keys of the random numbers of the traps and of their releases."""

    traps: np.uint64
    releases: np.uint64


class Columns(NamedTuple):
    """The position of an image's columns in a half of a chip, and how they are read."""

    flip: bool = False  # the image's last row is read first
    lead: int = 0  # rows of the half between the image and the amplifier
    n_rows: int = 0  # rows of the half; 0: lead + those of the image
    overscan: int = 0  # packets read after the half
    x0: int = 0  # column of the chip in which the image begins


class Register(NamedTuple):
    """The position of an image's rows in a channel, and the register through which they are read."""

    prescan: int = 0  # elements between the amplifier and the channel
    lead: int = 0  # columns of the channel between the prescan and the image
    n_columns: int = 0  # columns of the channel; 0: lead + those of the image
    overscan: int = 0  # packets read after each row
    row0: int = 0  # row of the channel in which the image begins


class HalfWindow(NamedTuple):
    """The part of a window in one half of the chip: its rows of the window's image, keys, and Columns."""

    rows: slice
    keys: TrapKeys
    columns: Columns


def half_windows(detector: Detector, window: Window, rng: Streams) -> list[HalfWindow]:
    """Return the HalfWindow of the lower and of the upper half; its rows may be none. rng: of the traps."""
    n_rows = detector.channel_ny
    halves = []
    for half in range(2):
        low = min(max(window.y0, half * n_rows), (half + 1) * n_rows)
        high = min(max(window.y1, half * n_rows), (half + 1) * n_rows)
        columns = Columns(
            flip=bool(half),
            lead=detector.ny - high if half else low,
            n_rows=n_rows,
            overscan=detector.parallel_overscan,
            x0=window.x0,
        )
        keys = TrapKeys(rng.chip_key(f"traps {half}"), rng.exposure_key(f"release {half}"))
        rows = slice(low - window.y0, high - window.y0) if low < high else slice(0)
        halves.append(HalfWindow(rows, keys, columns))
    return halves


def channel_register(block: Block, detector: Detector, window: Window) -> Register:
    """Return the Register of a channel's block of a window's frame (detector.channels)."""
    rows, columns = block.image
    x0 = window.x0
    y0 = window.y0
    return Register(
        prescan=detector.prescan,
        lead=(-(x0 + columns.stop) if block.flip_x else x0 + columns.start) % detector.channel_nx,
        n_columns=detector.channel_nx,
        overscan=detector.overscan,
        row0=(-(y0 + rows.stop) if block.flip_y else y0 + rows.start) % detector.channel_ny,
    )


def register_keys(channel: int, rng: Streams) -> TrapKeys:
    """Return the Keys of a channel's register. rng: of the traps."""
    return TrapKeys(rng.chip_key(f"serial traps {channel}"), rng.exposure_key(f"serial release {channel}"))
