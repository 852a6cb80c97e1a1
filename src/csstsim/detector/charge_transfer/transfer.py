"""Transfer of a window's charge to the amplifiers (paper, Appendix B item 10), and the charge trailed into overscan.

Each half of the chip is transferred along its columns to its registers (charge_transfer.cti). Then each row of a
channel, including its parallel overscan, is transferred along the register to its amplifier (charge_transfer.serial).
Columns and rows of a window are transferred at full length: pixels outside the window get the median charge of those
inside.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.types import FloatArray
from csstsim.detector.channels import ReadoutFrame

if TYPE_CHECKING:
    from csstsim.base.rng import Streams
    from csstsim.instrument.chip import Detector, Window


@dataclass(frozen=True)
class Trails:
    """Electrons trailed into the overscan, float32; the first row and the first column are read first."""

    parallel: tuple[FloatArray, FloatArray]  # lower and upper half: (parallel_overscan, nx of the window)
    # {channel: (rows of the window in the channel + parallel_overscan, overscan)}; none if rows were not transferred
    serial: dict[int, FloatArray] = field(default_factory=dict)

    def lay(self, image: FloatArray, readout: ReadoutFrame) -> None:
        """Write the charge into the overscan of `image`, a frame of `readout` (detector.channels.ReadoutFrame)."""
        for block in readout.blocks:
            image[block.parallel_overscan] = self.parallel[block.half][:, block.image[1]][block.as_read[0]]
            if block.channel in self.serial:
                image[block.rows, block.serial_overscan[1]] = self.serial[block.channel][block.as_read]


def transfer(
    image: FloatArray, detector: Detector, window: Window, rng: Streams, *, density: float, serial: bool
) -> tuple[Trails, dict[str, int]]:
    """Transfer the charge of a window's image [e-], in place; return (Trails, header entries).

    rng: rng.Streams of the traps; density: factor on the trap densities of cti.yaml; serial: transfer along the
    registers too.
    """
    halves, trapped = _along_columns(image, detector, window, density, rng)
    header = {"cti_trapped": trapped}
    channels: dict[int, FloatArray] = {}
    if serial:
        channels, header["cti_serial_trapped"] = _along_rows(image, detector, window, halves, density, rng)
    return Trails(halves, channels), header


def _along_columns(
    image: FloatArray, detector: Detector, window: Window, scale: float, rng: Streams
) -> tuple[tuple[FloatArray, FloatArray], int]:
    """Transfer both halves to their registers; return (Trails.parallel, electrons left in traps)."""
    from csstsim.detector.charge_transfer import cti  # loads numba (0.5 s), which checking a campaign does not need

    traps = detector.traps
    n_rows = detector.channel_ny
    assert traps is not None  # layers.cte_effect.check
    trailed = []
    trapped = 0
    for half in range(2):
        low, high = (min(max(y, half * n_rows), (half + 1) * n_rows) for y in (window.y0, window.y1))
        trail, left = cti.transfer(
            image[low - window.y0 : high - window.y0] if low < high else image[:0],
            scale * np.array(traps.density),
            traps.timescale,
            (traps.beta, traps.full_well, traps.notch),
            (rng.chip_key(f"traps {half}"), rng.exposure_key(f"release {half}")),
            flip=bool(half),
            lead=detector.ny - high if half else low,
            n_rows=n_rows,
            overscan=detector.parallel_overscan,
            x0=window.x0,
        )
        trailed.append(trail)
        trapped += left
    return (trailed[0], trailed[1]), trapped


def _along_rows(
    image: FloatArray,
    detector: Detector,
    window: Window,
    halves: tuple[FloatArray, FloatArray],
    scale: float,
    rng: Streams,
) -> tuple[dict[int, FloatArray], int]:
    """Transfer each channel's rows, and those of its parallel overscan in `halves`, to its amplifier.

    Returns (Trails.serial, electrons left in traps).
    """
    from csstsim.detector.charge_transfer.serial import transfer_rows

    assert detector.traps is not None
    traps = detector.traps.serial
    x0 = window.x0
    y0 = window.y0
    assert traps is not None
    trailed = {}
    trapped = 0
    for block in ReadoutFrame.of(detector, window).blocks:
        rows, cols = block.image
        lead = (-(x0 + cols.stop) if block.flip_x else x0 + cols.start) % detector.channel_nx
        row0 = (-(y0 + rows.stop) if block.flip_y else y0 + rows.start) % detector.channel_ny
        keys = rng.chip_key(f"serial traps {block.channel}"), rng.exposure_key(f"serial release {block.channel}")
        trails = []
        for part, first in (
            (image[block.image][block.as_read], row0),
            (halves[block.half][:, cols][:, block.as_read[1]], detector.channel_ny),
        ):
            trail, left = transfer_rows(
                part,
                scale * np.array(traps.density),
                traps.timescale,
                (traps.beta, traps.full_well, traps.notch),
                keys,
                prescan=detector.prescan,
                lead=lead,
                n_columns=detector.channel_nx,
                overscan=detector.overscan,
                row0=first,
            )
            trails.append(trail)
            trapped += left
        trailed[block.channel] = np.concatenate(trails)
    return trailed, trapped
