"""`csstsim aim` writes exposures of one place as rows of a survey table."""

from __future__ import annotations

import math
from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING

from csstsim.base.errors import InputError
from csstsim.base.files.atomic import atomic_path
from csstsim.base.plural import number_of
from csstsim.campaign.survey_table import OBSID, OBSID_ALLOWED, exposures_of
from csstsim.instrument.camera import load_camera
from csstsim.optics.geometry.pointing_for import centred_exposure

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence
    from typing import Any

    from csstsim.base.types import PathLike
    from csstsim.instrument.camera import Camera
    from csstsim.instrument.chip import Chip
    from csstsim.instrument.pointing import Pointing

CHIP = 9  # that is aimed at if none is named, in r
FARTHEST = 3600.0  # arcsec
GAP_S = 60.0  # between the end of an exposure and the start of the next
TIME = "2027-11-20T01:20:00"
HEADER = "obsid,type,ra,dec,pa,time,exptime"


def next_obsid(obsid: str) -> str:
    """Return the obsid that follows, with as many digits."""
    return str(int(obsid) + 1).zfill(len(obsid))


def next_start(pointing: Pointing) -> str:
    """Return the time at which the exposure after this one starts, ISO UTC."""
    return f"{pointing.end + timedelta(seconds=GAP_S):%Y-%m-%dT%H:%M:%S}"


def chips_for(camera: Camera, numbers: Sequence[int] = (), filters: Sequence[str] = ()) -> list[Chip]:
    """Return the chips to aim at: those numbered, and of each filter the one nearest to the boresight.

    CHIP, if nothing is named. Raises InputError for a chip or filter that the camera does not have.
    """
    numbers = numbers or (() if filters else (CHIP,))
    for number in numbers:
        if number not in camera.chips:
            raise InputError("no such chip", key="--chip", value=number, allowed=", ".join(map(str, camera.chips)))
    for name in filters:
        if name not in camera.filters:
            raise InputError("no such filter", key="--filter", value=name, allowed=", ".join(camera.filters))
    behind = [[chip for chip in camera.chips.values() if chip.filter == name] for name in filters]
    nearest = [min(chips, key=lambda chip: math.hypot(chip.xc, chip.yc)) for chips in behind]
    return [camera.chips[number] for number in numbers] + nearest


def aimed(
    camera: Camera,
    ra: float,
    dec: float,
    chips: Sequence[Chip],
    *,
    pa: float = 0.0,
    times: Sequence[str] = (TIME,),
    shifts: Sequence[tuple[float, float]] = ((0.0, 0.0),),
    exptime: float = 150.0,
    obsid: str = "10100000001",
) -> dict[str, Pointing]:
    """Return {obsid: Pointing}: at each time the place on each chip, at each shift [arcsec along the chip's x and y].

    Exposures of one time follow each other, GAP_S from the end to the next start. Raises InputError for values that
    cannot be used, and for exposures that overlap.
    """
    if not OBSID.fullmatch(obsid):
        raise InputError("not an observation id", key="--obsid", value=obsid, allowed=OBSID_ALLOWED)
    scale = camera.telescope.pixel_scale
    found: dict[str, Pointing] = {}
    for shift in shifts:
        if not all(abs(value) <= FARTHEST for value in shift):  # NaN, too
            raise InputError("too far", key="--dither", value=shift, allowed=f"up to {FARTHEST:g} arcsec")
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
            if any(other.start < pointing.end and pointing.start < other.end for other in found.values()):
                raise InputError("exposures overlap: another has not ended", key="--time", value=time)
            found[obsid] = pointing
            obsid = next_obsid(obsid)
            time = next_start(pointing)
    return found


def table_of(found: Mapping[str, Pointing], comment: Iterable[str] = ()) -> str:
    """Return the text of a survey table with the exposures that `aimed` returned."""
    rows = [
        f"{obsid},{p.type},{round(p.ra, 6) % 360.0:.6f},{p.dec:.6f},{p.pa:.4f},{p.time},{p.exptime:.10g}"
        for obsid, p in found.items()
    ]
    return "\n".join([*(f"# {line}" for line in comment), HEADER, *rows]) + "\n"


def aim(
    ra: float,
    dec: float,
    say: Callable[..., object],
    *,
    instrument: PathLike,
    chips: Sequence[int],
    filters: Sequence[str],
    output: PathLike | None = None,
    shifts: Sequence[tuple[float, float]] = (),
    times: Sequence[str] = (),
    **values: Any,
) -> None:
    """Print, or write to the new file `output`, a survey table of exposures of a place. Raises InputError."""
    camera = load_camera(instrument)
    wanted = chips_for(camera, chips, filters)
    found = aimed(camera, ra, dec, wanted, shifts=shifts or ((0.0, 0.0),), times=times or (TIME,), **values)
    comment = [f"ra {ra:g}, dec {dec:g} on " + ", ".join(f"chip {chip.id} ({chip.filter})" for chip in wanted)]
    text = table_of(found, comment)
    exposures_of(text, camera.orbit)  # what the reader of tables would refuse is refused now
    if output is None:
        say(text, nl=False)
        return
    if Path(output).exists():
        raise InputError("exists already; name another file", file=output, key="--output")
    with atomic_path(output) as temporary:
        Path(temporary).write_text(text)
    numbers = ", ".join(str(number) for number in sorted({chip.id for chip in wanted}))
    say(f"{output}: {number_of(len(found), 'exposure')}. In the campaign, in place of these keys (radius in arcmin):")
    say(f"  survey_table: {output}\n  select:\n    chips: [{numbers}]")
    say(f"    region: {{ra: {ra % 360:.10g}, dec: {dec:.10g}, radius: 1}}\n  window: region")
