"""Charge that is read after the pixels it belongs to (paper, Appendix B items 10 and 11): CTE_effect finds it, the
overscan holds it.
"""

from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True)
class Trails:
    """Electrons in the overscan, float32; the first row and the first column are those read first."""

    parallel: tuple[np.ndarray, np.ndarray]  # lower and upper half: (parallel_overscan, nx of the window)
    # {channel: (rows of the window in the channel + parallel_overscan, overscan)}; none if rows were not transferred
    serial: dict[int, np.ndarray] = field(default_factory=dict)

    def lay(self, image, readout):
        """Put the charge into `image`, a frame of `readout` (detector.channels.ReadoutFrame)."""
        for block in readout.blocks:
            image[block.parallel_overscan] = self.parallel[block.half][:, block.image[1]][block.as_read[0]]
            if block.channel in self.serial:
                image[block.rows, block.serial_overscan[1]] = self.serial[block.channel][block.as_read]
