"""The chips and pixels that `select` and `window` of a campaign select. run: opened.OpenCampaign."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from csstsim.base.errors import InputError
from csstsim.campaign.sections import PixelWindow
from csstsim.catalog.astrometry.reduction import apparent, icrs
from csstsim.instrument.chip import Window

if TYPE_CHECKING:
    from collections.abc import Iterable

    from csstsim.base.types import FloatArray
    from csstsim.campaign.opened import OpenCampaign
    from csstsim.campaign.sections import Select
    from csstsim.catalog.astrometry.ephemeris import Observer
    from csstsim.instrument.camera import Camera
    from csstsim.instrument.chip import Chip
    from csstsim.instrument.pointing import Pointing
    from csstsim.optics.geometry.wcs import ChipWCS

NEAREST = 3  # chips that an error names


class Miss(NamedTuple):
    """Position x, y [px] of the centre of select.region, and the distance [px] of its circle from a window.

    distance: negative if the circle touches the window; NaN if the region is on the opposite side of the sky.
    """

    x: float
    y: float
    distance: float


def selected_chips(select: Select, camera: Camera) -> list[Chip]:
    """Return the Chips selected by select.chips and select.filters, by number."""
    groups: dict[str, Iterable[Chip]] = {
        "all": camera.chips.values(),
        "imaging": camera.imaging_chips,
        "slitless": camera.slitless_chips,
    }
    if isinstance(select.chips, str):
        chips: Iterable[Chip] = groups[select.chips]
    else:
        chips = [camera.chips[i] for i in sorted(set(select.chips))]
    return [chip for chip in chips if select.filters is None or chip.filter in select.filters]


def window_of(run: OpenCampaign, pointing: Pointing, chip: Chip, wcs: ChipWCS, craft: Observer) -> Window | None:
    """Return the pixels of a chip in an exposure to simulate, or None if the chip does not touch the region."""
    window = _window(run, chip)
    region = run.config.select.region
    if region is None or pointing.type != "SCIE":
        return window  # select.region does not apply to bias, dark and flat frames
    x, y, distance = _miss(run, wcs, craft, window)
    if not distance < 0:  # also for NaN
        return None
    if run.config.window != "region":
        return window
    radius = _radius(run)
    slitless = chip.kind == "slitless"
    # extent of a spectrum from the direct image, px
    left, right, down, up = run.camera.gratings[chip.id].span(x, y) if slitless else (0.0,) * 4
    x0, y0 = (max(math.floor(v), 0) for v in (x + left - radius, y + down - radius))
    x1, y1 = (min(math.ceil(v) + 1, n) for v, n in ((x + right + radius, window.x1), (y + up + radius, window.y1)))
    return Window(x0, x1, y0, y1) if x1 > x0 and y1 > y0 else None


def nothing_selected(run: OpenCampaign) -> InputError:
    """Return the InputError for a campaign that selects no (exposure, chip) pair, with the nearest chips."""
    select = run.config.select
    if not run.exposures:
        types = ", ".join(sorted({p.type for p in run.pointings.values()}))
        return InputError(
            "no exposure has one of these types",
            file=run.file,
            key="select.types",
            value=select.types,
            allowed=f"those in {run.table}: {types}",
        )
    if not run.chips:
        return InputError(
            "none of the chips is behind one of the filters",
            file=run.file,
            key="select.filters",
            value=select.filters,
            allowed="filters of the chips that select.chips names",
        )
    if select.region is None:
        return InputError("no pixels are selected", file=run.file, key="window")
    science = [obsid for obsid, pointing in run.exposures.items() if pointing.type == "SCIE"]
    pairs = [(obsid, chip) for obsid in science for chip in run.chips]
    return _missed(run, pairs, "the region touches no chip; it misses")


def pair_missed(run: OpenCampaign, obsid: str, chip: Chip) -> InputError:
    """Return the InputError for an (exposure, chip) pair that the region misses, with the distance."""
    return _missed(run, [(obsid, chip)], "the region misses")


def _missed(run: OpenCampaign, pairs: Iterable[tuple[str, Chip]], message: str) -> InputError:
    """Return the InputError for a region that misses all (obsid, chip) pairs, with a position that is allowed.

    If the region touches a chip, but not the given window on it, the error is of the window.
    """
    pairs = list(pairs)
    window = run.config.window
    if isinstance(window, PixelWindow) and (error := _window_missed(run, window, pairs)):
        return error
    circle = run.config.select.region
    arcmin = run.camera.telescope.pixel_scale / 60.0

    assert circle is not None  # without one nothing is missed
    missed = [
        (_miss(run, *run.maps(run.exposures[obsid], chip), _window(run, chip)).distance, obsid, chip)
        for obsid, chip in pairs
    ]
    near = sorted((one for one in missed if not math.isnan(one[0])), key=lambda one: one[0])[:NEAREST]
    texts = [f"chip {chip.id} ({chip.filter}) of exposure {obsid} by {_angle(px * arcmin)}" for px, obsid, chip in near]
    _, obsid, chip = (near or missed)[0]
    ra, dec = _centre(run, obsid, chip)
    return InputError(
        f"{message} {', '.join(texts)}" if near else "the region is far from every pointing",
        file=run.file,
        key="select.region",
        value=f"{circle.radius:g}' about {circle.ra:g}, {circle.dec:g}",
        allowed=f"a circle that touches a chip, as about {ra:.4f}, {dec:.4f}, the centre of chip {chip.id} in exposure "
        f"{obsid}. The ra, dec of a row is the centre of the focal plane, where no chip is. For a position of your "
        "own, `csstsim aim` writes rows",
    )


def _window_missed(run: OpenCampaign, window: PixelWindow, pairs: Iterable[tuple[str, Chip]]) -> InputError | None:
    """Return the InputError for a window on the first chip that the region touches, or None if it touches none."""
    for obsid, chip in pairs:
        x, y, distance = _miss(run, *run.maps(run.exposures[obsid], chip), chip.full_window)
        if distance < 0:
            ra, dec = _centre(run, obsid, chip)
            return InputError(
                f"the region touches chip {chip.id} ({chip.filter}) of exposure {obsid}, but not this window of it",
                file=run.file,
                key="window",
                value=window.model_dump(),
                allowed=f"region, or a window near x {x:.0f}, y {y:.0f}, the centre of the region; or a region "
                f"about {ra:.4f}, {dec:.4f}, the centre of this window",
            )
    return None


def _angle(arcmin: float) -> str:
    """Return a distance in the tangent plane as text: from 120 arcmin on as an angle on the sky."""
    angle = math.degrees(math.atan(math.radians(arcmin / 60.0)))
    return f"{arcmin:.1f}'" if arcmin < 120.0 else f"about {angle:.0f} deg"


def _centre(run: OpenCampaign, obsid: str, chip: Chip) -> tuple[FloatArray, FloatArray]:
    """Return ra, dec [deg, ICRS] of the centre of a chip, or of the window on it, in an exposure."""
    window = _window(run, chip)
    wcs, craft = run.maps(run.exposures[obsid], chip)
    return icrs(*wcs.pixel_to_world((window.x0 + window.x1 - 1) / 2, (window.y0 + window.y1 - 1) / 2), craft)


def _window(run: OpenCampaign, chip: Chip) -> Window:
    """Return the campaign's window on a chip, or all its pixels; select.region does not matter."""
    window = run.config.window
    return Window(**window.model_dump()) if isinstance(window, PixelWindow) else chip.full_window


def _radius(run: OpenCampaign) -> float:
    region = run.config.select.region
    assert region is not None  # tested by the callers
    return region.radius * 60.0 / run.camera.telescope.pixel_scale


def _miss(run: OpenCampaign, wcs: ChipWCS, craft: Observer, window: Window) -> Miss:
    """Return the Miss of select.region and a window."""
    region = run.config.select.region
    assert region is not None  # tested by the callers
    x, y = (float(v) for v in wcs.world_to_pixel(*apparent(region.ra, region.dec, craft)))
    nearest = (min(max(v, low), high) for v, low, high in ((x, window.x0, window.x1), (y, window.y0, window.y1)))
    return Miss(x, y, math.dist((x, y), tuple(nearest)) - _radius(run))
