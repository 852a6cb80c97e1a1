"""Correction of moved charge, in the reverse order of the detector: charge transfer, then the brighter-fatter effect.

Both iterate the forward model (detector.charge_transfer.restored, detector.brighter_fatter.move_back). Read noise is
treated as charge, though it arises after the transfer: so the correction of charge transfer slightly raises a pixel's
noise (docs/calibration.md). Electrons that a trap releases after the last row was read are restored, too.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from csstsim.detector.bfe_kernel import detector_kernel
from csstsim.detector.brighter_fatter import move_back
from csstsim.detector.charge_transfer.restored import restore

if TYPE_CHECKING:
    from csstsim.base.rng import Streams
    from csstsim.base.types import FloatArray
    from csstsim.instrument.chip import Detector, Window
    from csstsim.layers import cte_effect


def put_back(
    electrons: FloatArray,
    detector: Detector,
    window: Window,
    rng: Streams,
    *,
    traps: cte_effect.Param | None,
    passes: int,
    spread: bool,
) -> None:
    """Move charge back to where light created it, in place.

    electrons: float32 (ny, nx) of a window; rng: rng.Streams of the traps; traps: parameters of layer CTE_effect, or
    None; passes: iterations of the correction of charge transfer, 0: not corrected; spread: whether the brighter-fatter
    effect is corrected.
    """
    if traps and traps.density_scale > 0:
        restore(electrons, detector, window, rng, density=traps.density_scale, serial=traps.serial, passes=passes)
    if spread:
        move_back(electrons, *detector_kernel(detector), detector.full_well)
