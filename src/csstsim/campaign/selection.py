"""What `select` and `window` of a campaign choose: chips and their pixels. run: opened.OpenCampaign."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

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


def selected_chips(select: Select, camera: Camera) -> list[Chip]:
    """Return the Chips of select.chips and select.filters, by number."""
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
    """Return the pixels of this pair to simulate, or None if it does not touch the region."""
    window = _window(run, chip)
    region = run.config.select.region
    if region is None or pointing.type != "SCIE":
        return window  # bias, dark and flat frames see no sky: select.region does not apply
    x, y, miss = _miss(run, wcs, craft, window)
    if not miss < 0:  # also when the region is behind the sky (NaN)
        return None
    if run.config.window != "region":
        return window
    radius = _radius(run)
    slitless = chip.kind == "slitless"
    left, right, down, up = run.camera.gratings[chip.id].span(x, y) if slitless else (0.0,) * 4
    x0, y0 = (max(math.floor(v), 0) for v in (x + left - radius, y + down - radius))
    x1, y1 = (min(math.ceil(v) + 1, n) for v, n in ((x + right + radius, window.x1), (y + up + radius, window.y1)))
    return Window(x0, x1, y0, y1) if x1 > x0 and y1 > y0 else None


def nothing_selected(run: OpenCampaign) -> InputError:
    """Return the InputError of a campaign that selects no (exposure, chip) pair: what is nearest, and what to do."""
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
    """Return the InputError of one (exposure, chip) pair that the region misses: by how much, and what to do."""
    return _missed(run, [(obsid, chip)], "the region misses")


def _missed(run: OpenCampaign, pairs: Iterable[tuple[str, Chip]], message: str) -> InputError:
    """Return the InputError of a region that misses all (obsid, chip) pairs: the nearest, and a place that works."""
    circle = run.config.select.region
    arcmin = run.camera.telescope.pixel_scale / 60.0

    assert circle is not None  # without one nothing is missed
    missed = [
        (_miss(run, *run.maps(run.exposures[obsid], chip), _window(run, chip))[-1], obsid, chip)
        for obsid, chip in pairs
    ]
    near = sorted((found for found in missed if not math.isnan(found[0])), key=lambda found: found[0])[:NEAREST]
    texts = [f"chip {chip.id} ({chip.filter}) of exposure {obsid} by {_far(px * arcmin)}" for px, obsid, chip in near]
    _, obsid, chip = (near or missed)[0]
    ra, dec = _middle(run, obsid, chip)
    return InputError(
        f"{message} {', '.join(texts)}" if near else "the region is on the sky's other side",
        file=run.file,
        key="select.region",
        value=f"{circle.radius:g}' about {circle.ra:g}, {circle.dec:g}",
        allowed=f"a circle that touches a chip, as about {ra:.4f}, {dec:.4f}, the middle of chip {chip.id} in exposure "
        f"{obsid}. A row's ra, dec is the middle of the focal plane, where no chip is: for a place of your own, "
        "`csstsim aim` writes rows",
    )


def _far(arcmin: float) -> str:
    """Return a distance in the tangent plane as text; a far one as the angle on the sky that it is."""
    angle = math.degrees(math.atan(math.radians(arcmin / 60.0)))
    return f"{arcmin:.1f}'" if arcmin < 120.0 else f"about {angle:.0f} deg"


def _middle(run: OpenCampaign, obsid: str, chip: Chip) -> tuple[FloatArray, FloatArray]:
    """Return ra, dec [deg, ICRS] of the middle of a chip, or of the window on it, in an exposure."""
    window = _window(run, chip)
    wcs, craft = run.maps(run.exposures[obsid], chip)
    return icrs(*wcs.pixel_to_world((window.x0 + window.x1 - 1) / 2, (window.y0 + window.y1 - 1) / 2), craft)


def _window(run: OpenCampaign, chip: Chip) -> Window:
    """Return the pixels that the campaign's window leaves of a chip, whatever its region."""
    wanted = run.config.window
    return Window(**wanted.model_dump()) if isinstance(wanted, PixelWindow) else chip.full_window


def _radius(run: OpenCampaign) -> float:
    region = run.config.select.region
    assert region is not None  # its callers look
    return region.radius * 60.0 / run.camera.telescope.pixel_scale


def _miss(run: OpenCampaign, wcs: ChipWCS, craft: Observer, window: Window) -> tuple[float, float, float]:
    """Return where the middle of select.region falls, x, y, and by how much its circle misses a window [px]."""
    region = run.config.select.region
    assert region is not None  # its callers look
    x, y = (float(v) for v in wcs.world_to_pixel(*apparent(region.ra, region.dec, craft)))
    near = (min(max(v, low), high) for v, low, high in ((x, window.x0, window.x1), (y, window.y0, window.y1)))
    return x, y, math.dist((x, y), tuple(near)) - _radius(run)
