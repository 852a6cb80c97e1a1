"""The pointing that puts a position on the sky on a pixel of a chip, and the pixel that suits the chip."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

from csstsim.base.errors import InputError
from csstsim.catalog.astrometry.ephemeris import observer
from csstsim.catalog.astrometry.reduction import apparent
from csstsim.instrument.pointing import EXPTIME_MAX, YEARS, Pointing, parse_utc
from csstsim.optics.geometry.distortion import FieldDistortion, load_distortion
from csstsim.optics.geometry.wcs import ChipWCS, gnomonic

if TYPE_CHECKING:
    from csstsim.base.types import FloatArray
    from csstsim.instrument.camera import Camera
    from csstsim.instrument.chip import Chip


def pointing_for(
    pointing: Pointing,
    chip: Chip,
    target: tuple[float, float],
    pixel: tuple[float, float],
    distortion: FieldDistortion | None = None,
) -> Pointing:
    """Return the Pointing with ra, dec changed so that an apparent direction falls on a 0-based pixel of a chip.

    target: (ra, dec) [deg]; pixel: (x, y). Position angle and time are kept. In the triangle of pole, boresight and
    target, the distance d from boresight to target, its position angle phi and the target's declination are known:

        sin dec_t = sin dec_b cos d + cos dec_b sin d cos phi.

    Raises ValueError if there is no solution: for a target closer to a pole than d, most position angles have none.
    """
    ra, dec = map(float, target)
    xi, eta = gnomonic((0.0, 0.0), *_seen(pointing, 0.0, chip, pixel, distortion))
    distance = math.atan(math.hypot(xi, eta))
    phi = math.atan2(xi, eta)
    a = math.cos(distance)
    b = math.sin(distance) * math.cos(phi)
    height = math.sin(math.radians(dec)) / math.hypot(a, b)
    middle = math.atan2(a, b)
    half = math.acos(min(height, 1.0)) if abs(height) < 1.0 + 1e-15 else math.nan
    found = [math.degrees(angle) for angle in (middle - half, middle + half) if abs(angle) <= math.pi / 2]
    if not found:
        where = f"{ra:.4f}, {dec:.4f} on chip {chip.id}"
        good = (pointing.pa - math.degrees(phi) + (180.0 if dec < 0 else 0.0)) % 360.0  # the pole behind the pixel
        raise ValueError(f"no boresight at position angle {pointing.pa:g} puts {where}, near a pole: take {good:.4f}")
    dec_b = min(found, key=lambda angle: abs(angle - dec))
    return replace(pointing, ra=(ra - float(_seen(pointing, dec_b, chip, pixel, distortion)[0])) % 360.0, dec=dec_b)


class AimPoint(NamedTuple):
    """Pixels (x, y) of a chip [0-based px]: the position of a target, and the middle of its image."""

    target: tuple[float, float]
    middle: tuple[float, float]


def aim_point(camera: Camera, chip: Chip) -> AimPoint:
    """Return the AimPoint that centres a target's image on a chip.

    On an imaging chip both pixels are the chip's middle. Behind gratings the image is the zeroth and the first order,
    and its middle is that of the wider grating's part of the chip.
    """
    nx = chip.detector.nx
    ny = chip.detector.ny
    middle = (nx - 1) / 2, (ny - 1) / 2
    if chip.kind == "imaging":
        return AimPoint(middle, middle)
    gratings = camera.gratings[chip.id]
    line = gratings.split - 0.5
    middle = max((-0.5, line), (line, nx - 0.5), key=lambda part: part[1] - part[0])
    middle = sum(middle) / 2, (ny - 1) / 2
    left, right, down, up = gratings.span(*middle)
    return AimPoint((middle[0] - (left + right) / 2, middle[1] - (down + up) / 2), middle)


def centred_exposure(
    camera: Camera,
    chip: Chip,
    ra: float,
    dec: float,
    *,
    pa: float,
    time: str,
    exptime: float,
    shift: tuple[float, float] = (0.0, 0.0),
    distorted: bool = True,
    **astrometry: Any,
) -> Pointing:
    """Return the Pointing of a science exposure with ra, dec (ICRS, deg) at the target of `aim_point`.

    camera: instrument.camera.Camera; pa [deg], time (ISO UTC), exptime [s] as in a survey table; shift: how far along
    the chip's x and y the target lies from there [px]; distorted: light meets the field distortion; astrometry: as
    config.AstrometryConfig. Raises InputError for values that cannot be used.
    """
    try:
        ra, dec, pa, exptime = (float(value) for value in (ra, dec, pa, exptime))
    except (TypeError, ValueError):
        raise InputError("must be numbers", key="ra, dec, pa, exptime", value=(ra, dec, pa, exptime)) from None
    in_range = 0 <= ra <= 360 and -90 <= dec <= 90 and -360 <= pa <= 360 and 0 < exptime <= EXPTIME_MAX
    if not in_range:
        allowed = f"ra 0..360, dec -90..90, pa -360..360 [deg], exptime above 0, to {EXPTIME_MAX:g} [s]"
        raise InputError("out of range", key="ra, dec, pa, exptime", value=(ra, dec, pa, exptime), allowed=allowed)
    x, y = aim_point(camera, chip).target
    try:
        if not YEARS[0] <= parse_utc(time).year <= YEARS[1]:
            raise ValueError(f"{time} is out of range: years {YEARS[0]} to {YEARS[1]}")
        state = camera.orbit.state(time)
        pointing = Pointing("SCIE", ra, dec, pa, time, exptime, *state)
        seen_ra, seen_dec = map(float, apparent(ra, dec, observer(pointing.mjd, *state, **astrometry)))
        return pointing_for(
            pointing,
            chip,
            (seen_ra, seen_dec),
            (x + shift[0], y + shift[1]),
            load_distortion(camera.folder / "distortion.fits") if distorted else None,
        )
    except (ValueError, OverflowError) as exc:
        raise InputError(str(exc), key="ra, dec, time") from None


def _seen(
    pointing: Pointing, dec: float, chip: Chip, pixel: tuple[float, float], distortion: FieldDistortion | None
) -> tuple[FloatArray, FloatArray]:
    """Return the direction of the pixel with the boresight at right ascension 0."""
    here = replace(pointing, ra=0.0, dec=dec)
    return ChipWCS(chip, here, distortion).pixel_to_world(*map(float, pixel))
