"""Select: the objects that reach a chip's window, with their light."""

from __future__ import annotations

from typing import TYPE_CHECKING

from csstsim.base.errors import InputError
from csstsim.base.help_page import explained
from csstsim.base.plural import number_of
from csstsim.base.process.one_thread import one_thread
from csstsim.stages.parts.stage_frames import Timer
from csstsim.stages.psf import psf_box

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

    from csstsim.campaign.job import Job
    from csstsim.campaign.opened import OpenCampaign
    from csstsim.catalog.base import CatalogBase
    from csstsim.catalog.table import ObjectTable
    from csstsim.simulation.exposure import Exposure

TRIED = 30  # maximum number of chips that `check` tests for objects


@one_thread
def select(run: OpenCampaign, job: Job) -> None:
    """Find the objects that reach a job's window."""
    timer = Timer("select")
    table = selected(run, job.exposure)
    table.write(
        run.paths.stage(*job.key, "select.parquet"),
        table.meta | {"recipe": run.recipe(job, "select"), "stages": [timer.entry()]},
    )
    log_selected(table, print)


def selected(run: OpenCampaign, exposure: Exposure, catalog: CatalogBase | None = None) -> ObjectTable:
    """Return the ObjectTable of what reaches an Exposure's window (catalog.selection.select).

    catalog: a CatalogBase instead of the campaign's; all its objects are used, without limit and rotation.
    """
    from csstsim.catalog.open import open_catalog
    from csstsim.catalog.selection.select import ChipView, Noise, select_objects
    from csstsim.optics.scatter.scattered_light import scattered_light

    config = run.catalog
    camera = run.camera
    filter_ = exposure.filter
    detector = run.camera.detector
    mag_limit, rotated = (config.mag_limit, config.shapes == "rotated90") if catalog is None else (None, False)
    if catalog is None:
        key = run.universe_key() | _changing(run, exposure) if run.embedded else {}
        catalog = open_catalog(config, run.region(exposure), run.paths.truth, key)
    noise = Noise(filter_.sky, detector.dark, detector.read_noise)
    view = ChipView(
        exposure.wcs,
        exposure.observer,
        exposure.window,
        filter_,
        camera.telescope,
        exposure.exptime,
        noise,
        scattered=scattered_light(camera, filter_),
        box=psf_box(run, exposure.chip),
        disperser=run.disperser(exposure),
        interval=exposure.interval,
    )
    return select_objects(catalog, view, mag_limit, rotated)


def _changing(run: OpenCampaign, exposure: Exposure) -> dict[str, Any]:
    """Return the options of the embedded catalogue for moving and variable objects, as set in the campaign."""
    kinds = run.config.catalog.changing
    key: dict[str, Any] = {"varying": kinds}
    if {"asteroids", "satellites"} & set(kinds):
        from csstsim.catalog.changing.visitors import visitors

        key["visitors"] = visitors(
            kinds, run.config.seed, run.universe, run.camera, exposure.pointing, exposure.observer, exposure.interval
        )
    return key


def log_selected(table: ObjectTable, log: Callable[[str], object]) -> None:
    """Log how many objects reach the window, how many of them will not be rendered, and why."""
    from csstsim.catalog.flags import NOT_RENDERED
    from csstsim.catalog.selection.renderable import why_not_rendered

    verb = "reaches" if len(table) == 1 else "reach"
    dropped = table.meta["dropped"]
    out = f"{dropped['outside']} outside it, {dropped['faint']} fainter than mag_limit"
    log(f"{number_of(len(table), 'object')} {verb} the window; left out: {out}")
    for reason, count in why_not_rendered(table, (table["flags"] & NOT_RENDERED) != 0).items():
        log(f"{count} not rendered: {reason}")


def check_catalog(run: OpenCampaign, log: Callable[[str], object]) -> None:
    """Open the campaign's catalogue; test a user's catalogue on the first science jobs (catalog.contract)."""
    from csstsim.catalog.open import TABLE_KIND

    with explained("table of objects" if run.config.catalog.kind == TABLE_KIND else "catalogue"):
        _check_catalog(run, log)


def _check_catalog(run: OpenCampaign, log: Callable[[str], object]) -> None:
    from csstsim.catalog.contract import check
    from csstsim.catalog.selection.positions import objects_near

    source = run.open_truth()
    jobs = run.imaging_jobs or run.slitless_jobs
    if run.embedded or not jobs:
        return
    assert isinstance(source, type)  # the user's catalogue
    for job in jobs[:TRIED]:  # up to the first with objects
        report = check(source, run.catalog.options, run.region(job), run.camera)
        parts = (part for _, part in report.table.parts())
        reach = sum(
            len(objects_near(part, job.wcs, job.observer, job.window, interval=job.exposure.interval).rows)
            for part in parts
        )
        if reach or report.faults:
            break
    log(f"{run.config.catalog.kind}: {report}")
    unused = [name.removeprefix("user_") for name in report.table.names if name.startswith("user_")]
    if unused:
        log(f"columns that are not used, but kept in the truth as user_*: {', '.join(unused)}")
    verb = "is" if reach == 1 else "are"
    log(f"{reach} of them {verb} near what chip {job.chip.id} sees in exposure {job.obsid}")
    if report.faults:
        raise InputError(
            f"the catalogue has {number_of(len(report.faults), 'fault')}, the first: {report.faults[0]}",
            file=run.file,
            key="catalog.kind",
            value=run.config.catalog.kind,
        )
    if not reach:
        tried = "any chip" if len(jobs) <= TRIED else f"the first {TRIED} chips"
        raise InputError(
            f"no object of the catalogue reaches {tried}: the images would have no objects",
            file=run.file,
            key="catalog",
            value=run.config.catalog.kind,
            allowed="objects where the chips look; `csstsim aim` writes exposures of a position",
        )
