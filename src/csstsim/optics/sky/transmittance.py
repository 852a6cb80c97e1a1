"""The point-source transmittance (PST): the focal plane's irradiance over a beam's normal irradiance (paper, 5.5.1).

A matrix over zenith angle and azimuth; log PST is interpolated bilinearly in log zenith angle and azimuth. The zenith
angle is measured from the pixel's line of sight, so stray light varies over a chip. Light from behind the aperture's
plane enters only off the door. `total` adds the direct light and the light off the door.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.sphere import angle
from csstsim.optics.sky.aperture_door import scattered, shade, zenith_angle

if TYPE_CHECKING:
    from csstsim.base.types import FloatArray, Floats, IntArray
    from csstsim.optics.sky.parameters import SkyNumbers


def transmittance(zenith: FloatArray, azimuth: FloatArray, numbers: SkyNumbers) -> FloatArray:
    """Return PST at zenith, azimuth [deg], of one shape; constant below the first zenith angle, 0 beyond the last."""
    table = numbers.transmittance
    first = table.azimuth[0]
    log = np.log(table.matrix)
    log = np.column_stack([log, log[:, 0]])
    i, u = _cell(np.log(table.zenith), np.log(np.maximum(zenith, table.zenith[0])))
    j, v = _cell(np.append(table.azimuth, first + 360.0), (np.asarray(azimuth) - first) % 360.0 + first)
    near = (1 - v) * log[i, j] + v * log[i, j + 1]
    far = (1 - v) * log[i + 1, j] + v * log[i + 1, j + 1]
    return np.where(np.asarray(zenith) > table.zenith[-1], 0.0, np.exp((1 - u) * near + u * far))


def _cell(nodes: FloatArray, x: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return the cell of rising `nodes` that holds x, and the position (0..1) in it; x is clipped to their range."""
    i = np.clip(np.searchsorted(nodes, x, side="right") - 1, 0, len(nodes) - 2)
    return i, np.clip((x - nodes[i]) / (nodes[i + 1] - nodes[i]), 0.0, 1.0)


def total(sources: FloatArray, sights: FloatArray, door_azimuth: Floats, numbers: SkyNumbers) -> FloatArray:
    """Return (m, n): the transmittance from sources (n, 3) to lines of sight (m, 3), direct plus off the door.

    Unit vectors in the telescope's frame (csstsim.optics.sky.directions); door_azimuth [deg].
    """
    zenith, azimuth = angles(sources)
    door = numbers.door
    front = zenith < 90.0
    open_ = 1.0 - shade(zenith[front], azimuth[front], door_azimuth, door)
    ahead = sources[front]
    direct = np.zeros((len(sights), len(sources)))
    slant = angle(sights[:, None, :], ahead[None, :, :])
    direct[:, front] = open_ * transmittance(slant, azimuth_from(sights, ahead), numbers)
    slant = np.radians(zenith_angle(door))
    turn = np.radians(door_azimuth)
    middle = np.array([[np.sin(slant) * np.sin(turn), np.sin(slant) * np.cos(turn), np.cos(slant)]])
    off_door = transmittance(angle(sights, middle), azimuth_from(sights, middle)[:, 0], numbers)
    return direct + off_door[:, None] * scattered(zenith, azimuth, door_azimuth, door)


def angles(v: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return zenith angle and azimuth [deg] of vectors (..., 3) in the telescope's frame."""
    return angle(v, np.array([0.0, 0.0, 1.0])), np.degrees(np.arctan2(v[..., 0], v[..., 1]))


def azimuth_from(sights: FloatArray, sources: FloatArray) -> FloatArray:
    """Return (m, n) [deg]: azimuths of sources (n, 3) as seen from lines of sight (m, 3) near the boresight."""
    step = sources[None, :, :2] - sights[:, None, :2]
    return np.degrees(np.arctan2(step[..., 0], step[..., 1]))
