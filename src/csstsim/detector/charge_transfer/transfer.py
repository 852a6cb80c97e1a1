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
from csstsim.detector.charge_transfer.parameters import channel_register, half_windows, register_keys, scaled_model

if TYPE_CHECKING:
    from csstsim.base.rng import Streams
    from csstsim.instrument.chip import Detector, Window


@dataclass(frozen=True)
class Trails:
    """Electrons trailed into the overscan, float32; the first row and the first column are read first."""

    parallel: tuple[FloatArray, FloatArray]  # lower and upper half: (parallel_overscan, nx of the window)
    # {channel: (rows of the window in the channel + parallel_overscan, overscan)}; none if rows were not transferred
    serial: dict[int, FloatArray] = field(default_factory=dict)

    def write_into(self, image: FloatArray, readout: ReadoutFrame) -> None:
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

    assert detector.traps is not None  # layers.cte_effect.check
    model = scaled_model(detector.traps, scale)
    lower, upper = half_windows(detector, window, rng)
    lower_trail, lower_trapped = cti.transfer(image[lower.rows], model, lower.keys, lower.columns)
    upper_trail, upper_trapped = cti.transfer(image[upper.rows], model, upper.keys, upper.columns)
    return (lower_trail, upper_trail), lower_trapped + upper_trapped


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

    assert detector.traps is not None and detector.traps.serial is not None  # layers.cte_effect.check
    model = scaled_model(detector.traps.serial, scale)
    trails = {}
    trapped = 0
    for block in ReadoutFrame.of(detector, window).blocks:
        _, columns = block.image
        _, as_read = block.as_read
        register = channel_register(block, detector, window)
        after_rows = register._replace(row0=detector.channel_ny)  # the parallel overscan is read after all rows
        keys = register_keys(block.channel, rng)
        trail, trapped_image = transfer_rows(image[block.image][block.as_read], model, keys, register)
        overscan_trail, trapped_overscan = transfer_rows(
            halves[block.half][:, columns][:, as_read], model, keys, after_rows
        )
        trails[block.channel] = np.concatenate([trail, overscan_trail])
        trapped += trapped_image + trapped_overscan
    return trails, trapped
