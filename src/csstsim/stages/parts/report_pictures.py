"""The report's pictures from Level-0 files: the sky in colour, cutouts of objects, and the focal plane."""

from __future__ import annotations

from itertools import islice
from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.plural import number_of
from csstsim.base.process.progress import progress
from csstsim.campaign.costs import PICTURES
from csstsim.catalog.table import GALAXY
from csstsim.instrument.chip import Window
from csstsim.io.orders import read_orders
from csstsim.report.parts import Figure, Gallery
from csstsim.report.thumbnail import window_around
from csstsim.stages.level0 import truth_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from csstsim.base.types import BoolArray, FloatArray
    from csstsim.campaign.job import Job
    from csstsim.campaign.opened import OpenCampaign
    from csstsim.catalog.table import ObjectTable
    from csstsim.instrument.chip import Chip
    from csstsim.io.level0 import Level0
    from csstsim.report.mosaic import Exposure, FocalPlane
    from csstsim.report.sky_picture import Grid
    from csstsim.report.style import BandStyle

SIDE = 1200  # px: maximum side of the picture of the sky
FIELD = 2400  # px: maximum side of the part of the chip that it shows, 3 arcmin
ANCHORS = 40  # frames of a brick that are tested as the grid of the picture
FRAMES = 2  # maximum number of frames of a band: enough to leave out cosmic rays
CUTOUT = 96  # px, side
CHOSEN = {"galaxy": 6, "star": 2}  # cutouts of each
TRIED = 300  # brightest objects that a cutout may show


def sky_pictures(run: OpenCampaign) -> tuple[Figure, Gallery] | tuple[None, None]:
    """Return (Figure of the sky, Gallery of objects on it) of a campaign, or (None, None) without imaging frames."""
    from csstsim.io.level0 import read_level0
    from csstsim.report import sky_picture as sky
    from csstsim.report.pictures import photograph

    if not run.imaging_jobs:
        return None, None
    anchor, bands = colour_frames(run)
    jobs = [job for band in bands.values() for job in band]
    files = {job.key: read_level0(run.paths.level0(job)) for job in jobs}
    window = middle(anchor.window, FIELD)
    grid = sky.Grid.around(anchor.exposure, window, -(-max(window.shape) // SIDE))

    def planes(grid: Grid) -> list[FloatArray]:
        return [
            sky.combined([sky.plane(grid, job.exposure, files[job.key]) for job in jobs]) for jobs in bands.values()
        ]

    field = planes(grid)
    noise = float(np.median([sky.noise_of(plane) for plane in field]))
    marks = sky.compass, sky.ruler(grid)
    picture = Figure(photograph(sky.colours(field, noise), marks), _caption(bands, grid), "photo")
    cutouts = []
    for label, cutout in chosen(run, anchor, window, files[anchor.key]):
        cutout_grid = sky.Grid.around(anchor.exposure, cutout)
        image = sky.colours(planes(cutout_grid), noise * grid.step)  # the field's pixels are means of step x step
        cutouts.append(Figure(photograph(image), label, "photo"))
    return picture, Gallery(cutouts)


def colour_frames(run: OpenCampaign) -> tuple[Job, dict[str, list[Job]]]:
    """Return (job whose pixels are the grid, {band: its jobs there}) with three bands, the bluest first, or one.

    The position is the middle of a window that is covered by as many bands and frames as possible; of more than three
    bands, those in the middle are used.
    """
    jobs = max(run.merge_bricks.values(), key=lambda brick_jobs: (_bands(brick_jobs), len(brick_jobs)))
    candidates = jobs[:ANCHORS]
    x, y = np.transpose([_centre(job) for job in candidates])
    covering: list[list[Job]] = [[] for _ in candidates]
    for job in jobs:
        for k, inside in enumerate(_sees(job, x, y)):
            covering[k] += [job] if inside else []
    best = max(range(len(candidates)), key=lambda k: (min(_bands(covering[k]), 3), len(covering[k])))
    by_band: dict[str, list[Job]] = {}
    for job in covering[best]:
        by_band.setdefault(job.chip.filter, []).append(job)
    names = [name for name in run.camera.filters if name in by_band]
    start = (len(names) - 2) // 2
    n = 3 if len(names) > 2 else 1
    names = names[max(start, 0) :][:n] if n > 1 else [candidates[best].chip.filter]
    bands = {name: by_band[name][:FRAMES] for name in names}
    return list(bands.values())[n // 2][0], bands


def _bands(jobs: Iterable[Job]) -> int:
    return len({job.chip.filter for job in jobs})


def _centre(job: Job) -> list[float]:
    """Return the ICRS position [deg] of the middle of a job's window."""
    from csstsim.catalog.astrometry.reduction import icrs

    w = job.window
    return [float(v) for v in icrs(*job.wcs.pixel_to_world((w.x0 + w.x1) / 2, (w.y0 + w.y1) / 2), job.observer)]


def _sees(job: Job, ra: FloatArray, dec: FloatArray) -> BoolArray:
    """Return the mask of the positions [deg] on a job's window."""
    from csstsim.catalog.astrometry.reduction import apparent

    return np.asarray(job.window.contains(*job.wcs.world_to_pixel(*apparent(ra, dec, job.observer))))


def middle(window: Window, side_max: int) -> Window:
    """Return the middle of a Window, at most `side_max` px on a side."""
    nx = min(window.nx, side_max)
    ny = min(window.ny, side_max)
    x0 = window.x0 + (window.nx - nx) // 2
    y0 = window.y0 + (window.ny - ny) // 2
    return Window(x0, x0 + nx, y0, y0 + ny)


def chosen(run: OpenCampaign, job: Job, window: Window, file: Level0) -> Iterator[tuple[str, Window]]:
    """Yield (label, Window) of the galaxies and stars that the cutouts show."""
    truth = truth_of(run, job)
    for kind, count in CHOSEN.items():
        rows = (np.asarray(truth["obj_type"]) == GALAXY) == (kind == "galaxy")
        for row, cutout in islice(bright_objects(run, truth, rows, window, file), count):
            yield f"{kind}, {job.chip.filter} {truth['mag'][row]:.1f}", cutout


def bright_objects(
    run: OpenCampaign, truth: ObjectTable, rows: BoolArray, window: Window, file: Level0
) -> Iterator[tuple[int, Window]]:
    """Yield (row, Window of CUTOUT px about it) of objects of a truth table, brightest first.

    They are in `window`, and each is the brightest object of its cutout, which has no saturated pixel. rows: mask of
    the objects to consider; file: the frame's io.level0.Level0.
    """
    from csstsim.report.sky_picture import FULL
    from csstsim.report.thumbnail import binned

    x, y, light = (np.asarray(truth[name], float) for name in ("x", "y", "electrons"))
    half = CUTOUT // 2
    inside = Window(window.x0 + half, window.x1 - half, window.y0 + half, window.y1 - half).contains(x, y)
    found = np.flatnonzero(inside & rows)
    for row in found[np.argsort(-light[found])][:TRIED]:
        cutout = window_around(x[row], y[row], window, CUTOUT)
        brighter = (light > light[row]) & cutout.contains(x, y)
        if not brighter.any() and binned(file, cutout, 1).max() < FULL * run.camera.detector.full_well:
            yield row, cutout


def _caption(bands: Mapping[str, Sequence[Job]], grid: Grid) -> str:
    """Return the caption of the picture of the sky."""
    names = ", ".join(bands)
    what = f"{names} as blue, green and red" if len(bands) == 3 else f"{names} in grey"
    side = [n * grid.scale / 60 for n in grid.shape[::-1]]
    frames = number_of(sum(map(len, bands.values())), "exposure")
    alone = any(len(jobs) == 1 for jobs in bands.values())
    rays = " Cosmic rays remain in bands of one exposure." if alone else ""
    look = "North is up, east to the left; asinh stretch (Lupton et al. 2004), saturated pixels white."
    return f"{what}: {frames}, {side[0]:.1f}' x {side[1]:.1f}'. {look}{rays}"


def focal_plane(run: OpenCampaign, styles: Mapping[str, BandStyle]) -> FocalPlane | None:
    """Return the focal plane of the exposures with the most chips, science before calibration."""
    from csstsim.io.level0 import read_level0
    from csstsim.report.mosaic import mosaic, take_exposure

    picture_count = 0
    exposures: list[Exposure] = []
    first = {job.obsid for job in run.first_frames}

    def rank(jobs: Sequence[Job]) -> tuple[bool, int, bool]:
        # Among equals, the exposure of the first picture is shown first
        return jobs[0].pointing.type != "SCIE", -len(jobs), jobs[0].obsid not in first

    for jobs in sorted(by_exposure(run), key=rank):
        if exposures and picture_count + len(jobs) > PICTURES:
            break
        picture_count += len(jobs)
        pointing = jobs[0].pointing
        filters = ", ".join(dict.fromkeys(job.chip.filter for job in jobs))
        title = f"{jobs[0].obsid} ({pointing.type}, {pointing.exptime:g} s, {filters})"
        files = ((job.chip, read_level0(run.paths.level0(job))) for job in progress(jobs, "frames"))
        by_chip = {job.chip.id: job for job in jobs}

        def cutout(chip: Chip, file: Level0, side: int, by_chip: Mapping[int, Job] = by_chip) -> Window | None:
            return detail(run, by_chip[chip.id], file, side)

        exposures.append(take_exposure(title, pointing.pa, files, choose_cutout=cutout))
    return mosaic(list(run.camera.chips.values()), exposures, styles)


def detail(run: OpenCampaign, job: Job, file: Level0, side: int) -> Window | None:
    """Return the Window of a frame to show at full resolution, around a galaxy or spectrum; None: none is suitable."""
    if job.pointing.type != "SCIE":
        return None
    if run.has_orders(job):
        orders = read_orders(run.paths.level0_orders(job))
        lit = np.flatnonzero((orders["order"] == 1) & (orders["x1"] > orders["x0"]))
        if not len(lit):
            return None
        best = lit[np.argmax(orders["drawn"][lit])]
        x, y = (0.5 * (orders[f"{axis}0"][best] + orders[f"{axis}1"][best]) for axis in "xy")
        return window_around(x, y, job.window, side)
    truth = truth_of(run, job)
    brightest = next(bright_objects(run, truth, np.asarray(truth["obj_type"]) == GALAXY, job.window, file), None)
    return brightest and window_around(truth["x"][brightest[0]], truth["y"][brightest[0]], job.window, side)


def by_exposure(run: OpenCampaign) -> list[list[Job]]:
    """Return the jobs as a list of lists, one for each exposure."""
    exposures: dict[str, list[Job]] = {}
    for job in run.jobs:
        exposures.setdefault(job.obsid, []).append(job)
    return list(exposures.values())
