"""`csstsim aim`: a survey table of exposures of one position."""

from __future__ import annotations

import logging
import math
from datetime import timedelta
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from csstsim.base.errors import InputError
from csstsim.base.files.atomic import atomic_path
from csstsim.base.plural import number_of
from csstsim.campaign.notes import pointing_note
from csstsim.campaign.survey_table import OBSID, OBSID_ALLOWED, exposures_of
from csstsim.instrument.camera import load_camera
from csstsim.instrument.pointing import parse_utc
from csstsim.optics.geometry.pointing_for import centred_exposure

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence
    from typing import Any

    from csstsim.base.types import PathLike
    from csstsim.instrument.camera import Camera
    from csstsim.instrument.chip import Chip
    from csstsim.instrument.pointing import Pointing
    from csstsim.instrument.telescope import Telescope

DEFAULT_CHIP = 9  # r band
MAX_DITHER = 3600.0  # arcsec
GAP_S = 60.0  # s from the end of an exposure to the start of the next
DELAYS = [timedelta(minutes=5 * k) for k in range(1, 37)]  # after which exposures may be clear: two orbits
DEFAULT_TIME = "2027-11-20T01:20:00"
HEADER = "obsid,type,ra,dec,pa,time,exptime"


def next_obsid(obsid: str) -> str:
    """Return the next obsid, with the same number of digits."""
    return str(int(obsid) + 1).zfill(len(obsid))


def next_start(pointing: Pointing) -> str:
    """Return the start of the exposure that follows this one, ISO UTC."""
    return f"{pointing.end + timedelta(seconds=GAP_S):%Y-%m-%dT%H:%M:%S}"


def chips_for(
    camera: Camera, numbers: Sequence[int] = (), filters: Sequence[str] = (), *, prefix: str = "--"
) -> list[Chip]:
    """Return the chips with these numbers, and for each filter its chip nearest to the boresight.

    Without numbers and filters: DEFAULT_CHIP. prefix: of the options that errors name. Raises InputError for a chip or
    filter that the camera does not have, and for a filter of no chip.
    """
    numbers = numbers or (() if filters else (DEFAULT_CHIP,))
    for number in numbers:
        if number not in camera.chips:
            allowed = ", ".join(map(str, camera.chips))
            raise InputError("no such chip", key=f"{prefix}chip", value=number, allowed=allowed)
    used = {chip.filter for chip in camera.chips.values()}
    for name in filters:
        if name not in used:
            allowed = ", ".join(one for one in camera.filters if one in used)
            raise InputError("no such filter", key=f"{prefix}filter", value=name, allowed=allowed)
    by_filter = [[chip for chip in camera.chips.values() if chip.filter == name] for name in filters]
    nearest = [min(chips, key=lambda chip: math.hypot(chip.xc, chip.yc)) for chips in by_filter]
    return [camera.chips[number] for number in numbers] + nearest


def aimed_exposures(
    camera: Camera,
    ra: float,
    dec: float,
    chips: Sequence[Chip],
    *,
    pa: float = 0.0,
    times: Sequence[str] = (DEFAULT_TIME,),
    shifts: Sequence[tuple[float, float]] = ((0.0, 0.0),),
    exptime: float = 150.0,
    obsid: str = "10100000001",
) -> dict[str, Pointing]:
    """Return {obsid: Pointing} of exposures of a position ra, dec [deg, ICRS].

    For each of the times (ISO UTC) there is one exposure for each chip and each shift of the position on the chip
    [arcsec along the chip's x and y]. These start GAP_S after the end of the previous one. Raises InputError for
    values that cannot be used, and for exposures that overlap.
    """
    if not OBSID.fullmatch(obsid):
        raise InputError("not an observation id", key="--obsid", value=obsid, allowed=OBSID_ALLOWED)
    scale = camera.telescope.pixel_scale
    exposures: dict[str, Pointing] = {}
    for shift in shifts:
        if not all(abs(value) <= MAX_DITHER for value in shift):  # also refuses NaN
            raise InputError("out of range", key="--dither", value=shift, allowed=f"up to {MAX_DITHER:g} arcsec")
    for time in times:
        for chip, shift in ((chip, shift) for chip in chips for shift in shifts):
            pointing = centred_exposure(
                camera,
                chip,
                ra,
                dec,
                pa=pa,
                time=time,
                exptime=exptime,
                shift=(shift[0] / scale, shift[1] / scale),
            )
            if any(other.start < pointing.end and pointing.start < other.end for other in exposures.values()):
                raise InputError("exposures overlap: another has not ended", key="--time", value=time)
            exposures[obsid] = pointing
            obsid = next_obsid(obsid)
            time = next_start(pointing)
    return exposures


def survey_table_text(exposures: Mapping[str, Pointing], comment: Iterable[str] = ()) -> str:
    """Return the text of a survey table of exposures {obsid: Pointing}, with lines of comment."""
    rows = [
        f"{obsid},{p.type},{round(p.ra, 6) % 360.0:.6f},{p.dec:.6f},{p.pa:.4f},{p.time},{p.exptime:.10g}"
        for obsid, p in exposures.items()
    ]
    return "\n".join([*(f"# {line}" for line in comment), HEADER, *rows]) + "\n"


def aim(
    ra: float,
    dec: float,
    log: Callable[..., object],
    *,
    instrument: PathLike,
    chips: Sequence[int],
    filters: Sequence[str],
    output: PathLike | None = None,
    shifts: Sequence[tuple[float, float]] = (),
    times: Sequence[str] = (),
    **values: Any,
) -> None:
    """Print a survey table of exposures of a position, or write it to the new file `output`.

    Logs a warning if the Sun is too near or the Earth in the way. Raises InputError.
    """
    camera = load_camera(instrument)
    targets = chips_for(camera, chips, filters)
    times = times or (DEFAULT_TIME,)
    values |= {"shifts": shifts or ((0.0, 0.0),)}
    exposures = aimed_exposures(camera, ra, dec, targets, times=times, **values)
    comment = [f"ra {ra:g}, dec {dec:g} on " + ", ".join(f"chip {chip.id} ({chip.filter})" for chip in targets)]
    text = survey_table_text(exposures, comment)
    exposures_of(text, camera.orbit)  # checks the table as its reader does
    if output is not None and Path(output).exists():
        raise InputError("exists already; name another file", file=output, key="--output")
    if note := pointing_note(exposures, camera.telescope):
        clear = _clear_times(times, partial(aimed_exposures, camera, ra, dec, targets, **values), camera.telescope)
        logging.getLogger("csstsim").warning("%s; %s", note, clear)
    if output is None:
        log(text, nl=False)
        return
    with atomic_path(output) as temporary:
        Path(temporary).write_text(text)
    numbers = ", ".join(str(number) for number in sorted({chip.id for chip in targets}))
    count = number_of(len(exposures), "exposure")
    log(f"{output}: {count}. Use these keys in the campaign file (radius in arcmin):")
    log(f"  survey_table: {output}\n  select:  # without filters\n    chips: [{numbers}]")
    log(f"    region: {{ra: {ra % 360:.10g}, dec: {dec:.10g}, radius: 1}}\n  window: region")


def _clear_times(times: Sequence[str], exposures: Callable[..., dict[str, Pointing]], telescope: Telescope) -> str:
    """Return which --time to try: the given ones, delayed until no exposure is near the Sun or towards the Earth.

    exposures: returns {obsid: Pointing} of `times`.
    """
    for delay in DELAYS:
        later = [f"{parse_utc(time) + delay:%Y-%m-%dT%H:%M:%S}" for time in times]
        try:
            note = pointing_note(exposures(times=later), telescope)
        except InputError:  # beyond the years of the ephemeris
            break
        if not note:
            return "try " + " ".join(f"--time {time}" for time in later)
    return f"none of the next {DELAYS[-1] // timedelta(hours=1)} hours is better: try another --time"
