"""The sky background of a campaign's exposures whose layers use the stray-light model (`csstsim plan`).

For each exposure and band it is computed for one chip, at the centre of its window. No pixel is simulated.
"""

from __future__ import annotations

import csv
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.files.atomic import atomic_path
from csstsim.base.process.progress import progress
from csstsim.base.sphere import unit_vectors
from csstsim.layers.sky_background import WEIGHTS, moments
from csstsim.optics.sky.background import COMPONENTS, band_rates, in_band, sky_light
from csstsim.optics.sky.bodies import exposure_angles
from csstsim.optics.sky.directions import telescope_axes
from csstsim.optics.sky.near_stars import stars_about
from csstsim.optics.sky.parameters import sky_numbers

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from typing import TypeAlias

    from rich.table import Table

    from csstsim.base.types import FloatArray, PathLike
    from csstsim.campaign.job import Job
    from csstsim.campaign.opened import OpenCampaign
    from csstsim.instrument.pointing import Pointing
    from csstsim.optics.sky.parameters import SkyNumbers
    from csstsim.simulation.exposure import Exposure

    Levels: TypeAlias = dict[str, dict[str, dict[str, float]]]  # {band: {obsid: {component: e-/s/px}}}
    Angles: TypeAlias = dict[str, dict[str, float]]  # {obsid: {angle: deg}}

MUCH = 0.1  # of zodiacal light: the fraction of exposures with more earthshine is printed
FAINT = 1e-6  # e-/s/px: components below it in every exposure have no row in the table
ANGLES = {
    "limb": "boresight to the Earth's limb",
    "limb_sun": "Sun's height at that limb",
    "sun": "boresight to the Sun",
    "moon": "boresight to the Moon",
}
ANGLE_COLUMNS = {"sun": "sun_angle", "moon": "moon_angle"}  # columns `sun` and `moon` are components of the sky
HEADER = (
    "obsid",
    "band",
    *(f"{name} [e-/s/px]" for name in COMPONENTS),
    *(f"{ANGLE_COLUMNS.get(name, name)} [deg]" for name in ANGLES),
)


def skies(run: OpenCampaign) -> tuple[Levels, Angles]:
    """Return ({band: {obsid: {component: e-/s/px}}}, {obsid: {angle: deg}}) of exposures with the stray-light model.

    run: campaign.opened.OpenCampaign. Both are empty if no layer uses the model. Levels are means over the exposure, as
    in frames. Angles are those of the headers (sky.bodies.exposure_angles), at the start. Raises InputError if the
    model refuses an exposure.
    """
    exposures = with_straylight_model(run)
    numbers = sky_numbers(run.camera.sky) if exposures else None
    rates: dict[str, dict[str, FloatArray]] = {}
    levels: Levels = {}
    angles: Angles = {}
    for obsid, jobs in progress(exposures.items(), "sky of exposures"):
        chips = {band: job.exposure for band, job in jobs.items()}
        angles[obsid] = _angles(next(iter(chips.values())).pointing)
        assert numbers is not None  # there are exposures
        try:
            sky = _mean_sky_light(list(chips.values()), numbers)
        except Exception as exc:
            exc.add_note(f"in obsid {obsid}")
            raise
        for k, (band, exposure) in enumerate(chips.items()):
            if band not in rates:
                detector = exposure.chip.detector
                rates[band] = band_rates(exposure.filter, exposure.telescope, detector.pixel_um, numbers)
            components = {name: float(values[k]) for name, values in in_band(sky, rates[band]).items()}
            levels.setdefault(band, {})[obsid] = components
    return {band: levels[band] for band in run.camera.filters if band in levels}, angles


def check_file(run: OpenCampaign, path: PathLike) -> None:
    """Raise InputError if `write_skies` could not write `path`, or would have nothing to write."""
    if Path(path).exists():
        raise InputError("exists already; name another file", file=path, key="--sky")
    if not with_straylight_model(run):
        allowed = "a campaign whose sky_background has enable_straylight_model: true"
        raise InputError("no exposure uses the stray-light model", file=run.file, key="--sky", allowed=allowed)


def write_skies(path: PathLike, levels: Levels, angles: Angles) -> None:
    """Write `skies` as CSV, one row for each exposure and band, in the order of exposures and filters."""
    rows = [
        (obsid, band, *(f"{sky[obsid][name]:.4g}" for name in COMPONENTS), *(f"{angle[name]:.2f}" for name in ANGLES))
        for obsid, angle in angles.items()
        for band, sky in levels.items()
        if obsid in sky
    ]
    with atomic_path(path) as temporary, open(temporary, "w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([HEADER, *rows])


def sky_table(levels: Levels) -> Table:
    """Return a rich table by band of minimum, median and maximum over exposures of each component and of their sum."""
    from rich.table import Table

    single = all(len(sky) == 1 for sky in levels.values())
    table = Table(title="Sky at the centre of a chip, e-/s/px\n(means of exposures)")
    for column in ("band", "component", *(("sky",) if single else ("minimum", "median", "maximum"))):
        table.add_column(column, justify="left" if column in ("band", "component") else "right")
    for band, sky in levels.items():
        rows = {name: [parts[name] for parts in sky.values()] for name in COMPONENTS if name not in faint(levels)}
        rows["all"] = list(totals(sky).values())
        for k, (name, values) in enumerate(rows.items()):
            cells = values if single else (min(values), np.median(values), max(values))
            row = "" if k else band, name, *(f"{value:.2g}" for value in cells)
            table.add_row(*row, end_section=name == "all")
    return table


def sky_lines(levels: Levels, angles: Angles) -> list[str]:
    """Return lines of text: components left out of the table, exposures of extreme sky, the range of each angle."""
    left_out = faint(levels)
    lines: list[str] = []
    if left_out:
        lines.append(f"Left out, because below {FAINT:g} e-/s/px in every exposure: {', '.join(left_out)}.")
    single = len(angles) == 1
    if not single:
        fractions = ", ".join(f"{band} {much_earthshine(_arrays(sky)):.0%}" for band, sky in levels.items())
        lines += [*_extremes(levels), f"Exposures with earthshine above {MUCH:.0%} of the zodiacal light: {fractions}."]
    for name, label in ANGLES.items():
        values = [angle[name] for angle in angles.values()]
        extent = f"{min(values):.1f} {np.median(values):.1f} {max(values):.1f} deg (minimum, median, maximum)"
        lines.append(f"{label}: {values[0]:.1f} deg" if single else f"{label}: {extent}")
    return lines


def faint(levels: Levels) -> list[str]:
    """Return the components that are below FAINT in all bands and exposures."""
    every = [components for sky in levels.values() for components in sky.values()]
    return [name for name in COMPONENTS if all(components[name] < FAINT for components in every)]


def totals(sky: Mapping[str, Mapping[str, float]]) -> dict[str, float]:
    """Return {obsid: e-/s/px}, the sums of components. sky: {obsid: {component: e-/s/px}} of a band."""
    return {obsid: sum(components.values()) for obsid, components in sky.items()}


def much_earthshine(components: Mapping[str, FloatArray]) -> float:
    """Return the fraction of exposures whose earthshine exceeds MUCH of their zodiacal light."""
    return float(np.mean(components["earth"] > MUCH * components["zodiacal"]))


def _extremes(levels: Levels) -> list[str]:
    """Return a line for each pair of exposures that have the minimum and the maximum sky in some bands."""
    bands: dict[tuple[str, str], list[str]] = {}
    for band, sky in levels.items():
        total = totals(sky)
        bands.setdefault((min(total, key=total.__getitem__), max(total, key=total.__getitem__)), []).append(band)
    return [
        f"Minimum sky: obsid {lowest}; maximum: obsid {highest} ({', '.join(names)})."
        for (lowest, highest), names in bands.items()
    ]


def _arrays(sky: Mapping[str, Mapping[str, float]]) -> dict[str, FloatArray]:
    return {name: np.array([components[name] for components in sky.values()]) for name in COMPONENTS}


def with_straylight_model(run: OpenCampaign) -> dict[str, dict[str, Job]]:
    """Return {obsid: {band: Job}} of science exposures whose layers use the stray-light model, one chip per band."""
    jobs: dict[str, dict[str, Job]] = {}
    for job in run.science_jobs:
        step = run.steps["SCIE"].step("sky_background")
        if step is not None and step.param.enable_straylight_model:
            jobs.setdefault(job.obsid, {}).setdefault(job.chip.filter, job)
    return jobs


def _angles(pointing: Pointing) -> dict[str, float]:
    angles = exposure_angles(pointing.ra, pointing.dec, pointing.mjd, pointing.sat_position, pointing.sat_velocity)
    return {name: angles[name] for name in ANGLES}


def _mean_sky_light(exposures: Sequence[Exposure], numbers: SkyNumbers) -> dict[str, FloatArray]:
    """Return the `sky_light` along the centre of each Exposure's window, averaged over the exposure."""
    first = exposures[0]
    pointing = first.pointing
    axes = telescope_axes(pointing.ra, pointing.dec, pointing.pa, first.telescope.parity)
    directions = np.concatenate([_central_direction(exposure) for exposure in exposures])
    stars = np.array([np.logical_or(*stars_about(exposure, numbers)) for exposure in exposures])
    samples = [sky_light(axes, directions, moment, numbers, stars) for moment in moments(pointing, first.exptime)]
    return {name: np.tensordot(WEIGHTS, [sample[name] for sample in samples], 1) for name in samples[0]}


def _central_direction(exposure: Exposure) -> FloatArray:
    """Return the unit vector (1, 3) towards the centre of an Exposure's window."""
    window = exposure.window
    centre = 0.5 * (window.x0 + window.x1 - 1), 0.5 * (window.y0 + window.y1 - 1)
    return unit_vectors(*exposure.wcs.pixel_to_world(*(np.array([value]) for value in centre)))
