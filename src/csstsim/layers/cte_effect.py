"""Charge transfer inefficiency (paper, Appendix B item 10; section 5.5.4): traps hold back electrons on their way.

Each half of the chip is transferred along its columns to its registers (csstsim.detector.charge_transfer.cti) and, with
`serial`, each row of a channel, of its parallel overscan, too, along the register to its amplifier
(csstsim.detector.charge_transfer.serial). What trails behind the last row or column goes to state.trailed, which
prescan_overscan lays into the overscan. A window's columns and rows are transferred as whole ones: what is not
simulated of the half, or of the channel's rows after the parallel transfer, holds the median charge of what is.
Left out: the rise of trap density over the mission (`density_scale` stands for it).
"""

import numpy as np
from pydantic import Field

from csstsim.base.errors import InputError
from csstsim.detector.channels import ReadoutFrame
from csstsim.detector.charge_transfer.trails import Trails
from csstsim.layers.param import LayerParam

STAGE = "readout"
UNITS = ("electron", "electron")
FRAME = ("active", "active")
AFTER = ("poisson_and_dark",)


class Param(LayerParam):
    """obs_param of `CTE_effect`."""

    density_scale: float = Field(
        1.0, ge=0, le=1000, description="density of traps over that of cti.yaml, an irradiated device; 0: none"
    )
    serial: bool = Field(False, description="rows meet the traps of their registers, too (cti.yaml: serial)")


def check(param, camera, pointing):
    """Raise InputError if the camera has not the traps asked for."""
    traps = camera.detector.traps
    if traps is None:
        raise InputError("the instrument folder has no cti.yaml", key="density_scale")
    if param.serial and traps.serial is None:
        raise InputError("the instrument's cti.yaml has no `serial` traps", key="serial", value=True, allowed="false")


def apply(state, param, rng):
    """Move the charge of state.image, in place, and set state.trailed; electrons left in traps go to the header.

    Raises ValueError if electrons are still in state.counted, or for values that are not finite.
    """
    if state.counted is not None:
        raise ValueError("counted electrons were not merged: poisson_and_dark must come before CTE_effect")
    state.trailed, header = transfer(state.image, state.chip.detector, state.window, param, rng)
    state.header |= {"cti_density": param.density_scale} | header
    return state


def transfer(image, detector, window, param, rng):
    """Move the charge of a window's image, in place; return (Trails, header entries). rng: rng.Streams of the layer."""
    halves, trapped = _along_columns(image, detector, window, param.density_scale, rng)
    header, channels = {"cti_trapped": trapped}, {}
    if param.serial:
        channels, header["cti_serial_trapped"] = _along_rows(image, detector, window, halves, param.density_scale, rng)
    return Trails(halves, channels), header


def _along_columns(image, detector, window, scale, rng):
    """Transfer both halves to their registers; return (Trails.parallel, electrons left in traps)."""
    from csstsim.detector.charge_transfer import cti  # numba: half a second that checking a campaign need not pay

    traps, n_rows = detector.traps, detector.channel_ny
    trailed, trapped = [], 0
    for half in range(2):
        low, high = (min(max(y, half * n_rows), (half + 1) * n_rows) for y in (window.y0, window.y1))
        trail, left = cti.transfer(
            image[low - window.y0 : high - window.y0] if low < high else image[:0],
            scale * np.array(traps.density), traps.timescale, (traps.beta, traps.full_well, traps.notch),
            (rng.chip_key(f"traps {half}"), rng.exposure_key(f"release {half}")),
            flip=bool(half), lead=detector.ny - high if half else low, n_rows=n_rows,
            overscan=detector.parallel_overscan, x0=window.x0,
        )  # fmt: skip
        trailed.append(trail)
        trapped += left
    return tuple(trailed), trapped


def _along_rows(image, detector, window, halves, scale, rng):
    """Transfer each channel's rows, and those of its parallel overscan in `halves`, to its amplifier.

    Returns (Trails.serial, electrons left in traps).
    """
    from csstsim.detector.charge_transfer.serial import transfer_rows

    traps, x0, y0 = detector.traps.serial, window.x0, window.y0
    trailed, trapped = {}, 0
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
                part, scale * np.array(traps.density), traps.timescale, (traps.beta, traps.full_well, traps.notch),
                keys, prescan=detector.prescan, lead=lead, n_columns=detector.channel_nx, overscan=detector.overscan,
                row0=first,
            )  # fmt: skip
            trails.append(trail)
            trapped += left
        trailed[block.channel] = np.concatenate(trails)
    return trailed, trapped
