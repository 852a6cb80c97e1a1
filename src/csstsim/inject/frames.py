"""The campaign and job of a frame of csstsim: those of a campaign file, or those that the frame's header states.

A Level-0 header states layers, seed and changed camera parameters (recreate.frame). A calibrated image does not state
the layers. Neither states the PSF. Each assumption is reported.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from astropy.io.fits import Header

from csstsim.base.errors import InputError
from csstsim.campaign.cache_paths import CachePaths, cache_folder
from csstsim.campaign.opened import OpenCampaign
from csstsim.io.fits import open_fits, read_header
from csstsim.io.keywords import RECIPE
from csstsim.io.pointing_keywords import TOLERANCE, sky_offset, wcs_offset
from csstsim.optics.geometry.icrs_header import icrs_header
from csstsim.stages.level0 import MADE_WITH
from csstsim.studies.recreate.frame import read_frame
from csstsim.studies.recreate.recreate import describe_campaign, open_described

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from typing import Any

    from csstsim.base.types import PathLike
    from csstsim.campaign.job import Job
    from csstsim.studies.recreate.frame import FrameHeader

LEVEL0 = "level0"
CALIBRATED = "calibrated"
OTHER = "other"


def kind_of(path: PathLike) -> str:
    """Return what a FITS file is: LEVEL0 or CALIBRATED of csstsim, or OTHER. Raises InputError."""
    with open_fits(path) as file:
        if "SIMVER" not in read_header(file[0], path):
            return OTHER
        names = {hdu.get_extname() for hdu in file}
    if "IMAGE" in names:
        return LEVEL0
    if {"SCI", "ERR", "DQ"} <= names:
        return CALIBRATED
    raise InputError("a file of csstsim without IMAGE, and without SCI, ERR and DQ", file=path)


def job_of(
    path: PathLike,
    campaign: PathLike | OpenCampaign | None = None,
    instrument: PathLike | None = None,
    cache: PathLike | None = None,
    log: Callable[[str], object] = print,
) -> tuple[OpenCampaign, Job]:
    """Return (OpenCampaign, job.Job) of a frame of csstsim.

    campaign: its file, or an OpenCampaign; None: as the header states. instrument, cache: the camera's folder and the
    folder of PSF sets, without a campaign. `log` is called with each assumption. Raises InputError for a frame of
    another campaign, chip, filter or window.
    """
    head = read_frame(path)
    if head.number("CRVAL1") is None or not head.get("CTYPE1"):
        raise InputError("no WCS", file=path, key="CTYPE1, CRVAL1")
    if campaign is not None:
        run = campaign if isinstance(campaign, OpenCampaign) else OpenCampaign(campaign, copied=True)
        job = run.job(head.obsid, head.chip)
        _check_recipe(head, run.recipe(job))
        _check_pointing(head, job)
    else:
        run, job = open_described(head.path, *describe_campaign(head, instrument, None))
        run.paths = CachePaths(cache_folder(cache), run)
        if head.keys.get("CAMHASH") not in (None, run.recipe(job)["camera"]):
            head.notes.append("CAMHASH: the frame was made with other camera parameters (--instrument, --campaign)")
        for note in head.notes:
            log(f"assumed  {note}")
    check_job(head, job)
    return run, job


def _check_recipe(head: FrameHeader, recipe: Mapping[str, str]) -> None:
    for name, keyword in RECIPE.items():
        if head.keys.get(keyword) != recipe[name]:
            raise InputError(
                f"the frame was made with {MADE_WITH[name]} than the campaign's",
                file=head.path,
                key=keyword,
                value=head.keys.get(keyword),
                allowed=recipe[name],
            )


def _check_pointing(head: FrameHeader, job: Job) -> None:
    """Raise InputError if a header's exposure time or WCS differs from its job's, because the header was changed."""
    time = head.number("EXPTIME")
    expected = job.pointing.exptime
    if time is None or abs(time - expected) > 1e-3:
        raise InputError(
            "not the campaign's exposure time",
            file=head.path,
            key="EXPTIME",
            value=head.get("EXPTIME"),
            allowed=f"{expected:g} s",
        )
    if (offset := _wcs_off(head.keys, job)) > TOLERANCE:
        raise InputError(
            "the WCS is not the campaign's",
            file=head.path,
            key="CRVAL, CD, ...",
            value=f"{offset:.4g} arcsec off",
            allowed=f"up to {TOLERANCE:g} arcsec",
        )


def _wcs_off(header: Mapping[str, Any], job: Job) -> float:
    """Return the arcsec by which a header's WCS is off its job's, of a raw frame or a calibrated one (in ICRS)."""
    from astropy.wcs import WCS

    if not str(header["CTYPE1"]).endswith("TPV"):
        return wcs_offset(header, job.wcs)
    cards = icrs_header(job.wcs, job.observer, job.window)
    corners = [0.0, job.window.nx - 1.0], [0.0, job.window.ny - 1.0]
    expected = WCS(Header(cards)).all_pix2world(*corners, 0)
    return sky_offset({name: header[name] for name in cards if name in header}, *corners, expected)


def check_job(head: FrameHeader, job: Job) -> None:
    """Raise InputError if a FrameHeader has another filter or window than a job: PSF or positions would be wrong."""
    stated = str(head.get("FILTER") or job.chip.filter)
    if stated.lower() != job.chip.filter.lower():
        raise InputError(
            "the PSF would be of another filter", file=head.path, key="FILTER", value=stated, allowed=job.chip.filter
        )
    full = job.chip.full_window
    window = job.window
    stated_window = head.window(job.chip.detector) or (full.x0, full.x1, full.y0, full.y1)
    if stated_window != (window.x0, window.x1, window.y0, window.y1):
        raise InputError(
            "the frame was read in another window",
            file=Path(head.path),
            key="READX0..READY1",
            value=stated_window,
            allowed=(window.x0, window.x1, window.y0, window.y1),
        )
