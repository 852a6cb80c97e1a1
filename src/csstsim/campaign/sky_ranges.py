"""The sky that a campaign's exposures will have, where their layers use the stray-light model (`csstsim plan`).

For each exposure and band one chip is asked, at the middle of its window. No pixel is simulated.
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

MUCH = 0.1  # of zodiacal light: the share of exposures with more earthshine is shown
FAINT = 1e-6  # e-/s/px: components below it in every exposure have no row in the table
ANGLES = {
    "limb": "boresight to the Earth's limb",
    "limb_sun": "Sun's height at that limb",
    "sun": "boresight to the Sun",
    "moon": "boresight to the Moon",
}
NAMES = {"sun": "sun_angle", "moon": "moon_angle"}  # of angles in the file: the components have these names, too
HEAD = (
    "obsid",
    "band",
    *(f"{name} [e-/s/px]" for name in COMPONENTS),
    *(f"{NAMES.get(name, name)} [deg]" for name in ANGLES),
)


def skies(run: OpenCampaign) -> tuple[Levels, Angles]:
    """Return ({band: {obsid: {component: e-/s/px}}}, {obsid: {angle: deg}}) of exposures with the stray-light model.

    run: campaign.opened.OpenCampaign. Both are empty if no layer uses the model. Levels are means over the exposure, as
    of frames; angles are those of the headers (sky.bodies.exposure_angles), at the start. Raises InputError where the
    model refuses an exposure.
    """
    exposures = with_the_model(run)
    numbers = sky_numbers(run.camera.sky) if exposures else None
    rates: dict[str, dict[str, FloatArray]] = {}
    levels: Levels = {}
    angles: Angles = {}
    for obsid, jobs in progress(exposures.items(), "sky of exposures"):
        chips = {band: job.exposure for band, job in jobs.items()}
        angles[obsid] = _angles(next(iter(chips.values())).pointing)
        assert numbers is not None  # there are exposures
        try:
            light = _light(list(chips.values()), numbers)
        except Exception as exc:
            exc.add_note(f"in obsid {obsid}")
            raise
        for k, (band, exposure) in enumerate(chips.items()):
            if band not in rates:
                detector = exposure.chip.detector
                rates[band] = band_rates(exposure.filter, exposure.telescope, detector.pixel_um, numbers)
            parts = {name: float(values[k]) for name, values in in_band(light, rates[band]).items()}
            levels.setdefault(band, {})[obsid] = parts
    return {band: levels[band] for band in run.camera.filters if band in levels}, angles


def check_file(run: OpenCampaign, path: PathLike) -> None:
    """Raise InputError if `write_skies` could not write `path`, or would have nothing to write."""
    if Path(path).exists():
        raise InputError("exists already; name another file", file=path, key="--sky")
    if not with_the_model(run):
        allowed = "a campaign whose sky_background has enable_straylight_model: true"
        raise InputError("no exposure uses the stray-light model", file=run.file, key="--sky", allowed=allowed)


def write_skies(path: PathLike, levels: Levels, angles: Angles) -> None:
    """Write `skies` as CSV, one row for each exposure and band, in the order of exposures and filters."""
    rows = [
        (obsid, band, *(f"{at[obsid][name]:.4g}" for name in COMPONENTS), *(f"{own[name]:.2f}" for name in ANGLES))
        for obsid, own in angles.items()
        for band, at in levels.items()
        if obsid in at
    ]
    with atomic_path(path) as temporary, open(temporary, "w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([HEAD, *rows])


def sky_table(levels: Levels) -> Table:
    """Return a rich table: a row for each band and component, and their sum; least, median and most of exposures."""
    from rich.table import Table

    single = all(len(at) == 1 for at in levels.values())
    table = Table(title="Sky at the middle of a chip, e-/s/px\n(means of exposures)")
    for column in ("band", "component", *(("sky",) if single else ("least", "median", "most"))):
        table.add_column(column, justify="left" if column in ("band", "component") else "right")
    for band, at in levels.items():
        shown = {name: [parts[name] for parts in at.values()] for name in COMPONENTS if name not in faint(levels)}
        shown["all"] = list(totals(at).values())
        for k, (name, values) in enumerate(shown.items()):
            cells = values if single else (min(values), np.median(values), max(values))
            row = "" if k else band, name, *(f"{value:.2g}" for value in cells)
            table.add_row(*row, end_section=name == "all")
    return table


def sky_lines(levels: Levels, angles: Angles) -> list[str]:
    """Return lines of text: what the table lacks, the exposures of least and most sky, the range of each angle."""
    few = faint(levels)
    lines: list[str] = []
    if few:
        lines.append(f"Left out, because below {FAINT:g} e-/s/px in every exposure: {', '.join(few)}.")
    single = len(angles) == 1
    if not single:
        shares = ", ".join(f"{band} {much_earthshine(_arrays(at)):.0%}" for band, at in levels.items())
        lines += [*_extremes(levels), f"Exposures with earthshine above {MUCH:.0%} of the zodiacal light: {shares}."]
    for name, label in ANGLES.items():
        values = [own[name] for own in angles.values()]
        spread = (min(values), np.median(values), max(values))
        numbers = f"{values[0]:.1f} deg" if single else "{:.1f} {:.1f} {:.1f} deg (least, median, most)".format(*spread)
        lines.append(f"{label}: {numbers}")
    return lines


def faint(levels: Levels) -> list[str]:
    """Return the components that are below FAINT in all bands and exposures."""
    every = [parts for at in levels.values() for parts in at.values()]
    return [name for name in COMPONENTS if all(parts[name] < FAINT for parts in every)]


def totals(at: Mapping[str, Mapping[str, float]]) -> dict[str, float]:
    """Return {obsid: e-/s/px} of all components of a band."""
    return {obsid: sum(parts.values()) for obsid, parts in at.items()}


def much_earthshine(parts: Mapping[str, FloatArray]) -> float:
    """Return the share of exposures whose earthshine exceeds MUCH of their zodiacal light."""
    return float(np.mean(parts["earth"] > MUCH * parts["zodiacal"]))


def _extremes(levels: Levels) -> list[str]:
    """Return a line for each pair of exposures that have the least and the most sky of some bands."""
    bands: dict[tuple[str, str], list[str]] = {}
    for band, at in levels.items():
        whole = totals(at)
        bands.setdefault((min(whole, key=whole.__getitem__), max(whole, key=whole.__getitem__)), []).append(band)
    return [
        f"Least sky: obsid {least}; most: obsid {most} ({', '.join(names)})." for (least, most), names in bands.items()
    ]


def _arrays(at: Mapping[str, Mapping[str, float]]) -> dict[str, FloatArray]:
    return {name: np.array([parts[name] for parts in at.values()]) for name in COMPONENTS}


def with_the_model(run: OpenCampaign) -> dict[str, dict[str, Job]]:
    """Return {obsid: {band: Job}} of the science exposures whose layers use the stray-light model, one chip a band."""
    found: dict[str, dict[str, Job]] = {}
    for job in run.science_jobs:
        step = run.steps["SCIE"].step("sky_background")
        if step is not None and step.param.enable_straylight_model:
            found.setdefault(job.obsid, {}).setdefault(job.chip.filter, job)
    return found


def _angles(pointing: Pointing) -> dict[str, float]:
    found = exposure_angles(pointing.ra, pointing.dec, pointing.mjd, pointing.sat_position, pointing.sat_velocity)
    return {name: found[name] for name in ANGLES}


def _light(exposures: Sequence[Exposure], numbers: SkyNumbers) -> dict[str, FloatArray]:
    """Return the `sky_light` along the middle of each Exposure's window, averaged over the exposure."""
    first = exposures[0]
    pointing = first.pointing
    axes = telescope_axes(pointing.ra, pointing.dec, pointing.pa, first.telescope.parity)
    sights = np.concatenate([_middle(exposure) for exposure in exposures])
    stars = np.array([np.logical_or(*stars_about(exposure, numbers)) for exposure in exposures])
    lights = [sky_light(axes, sights, one, numbers, stars) for one in moments(pointing, first.exptime)]
    return {name: np.tensordot(WEIGHTS, [light[name] for light in lights], 1) for name in lights[0]}


def _middle(exposure: Exposure) -> FloatArray:
    window = exposure.window
    middle = 0.5 * (window.x0 + window.x1 - 1), 0.5 * (window.y0 + window.y1 - 1)
    return unit_vectors(*exposure.wcs.pixel_to_world(*(np.array([value]) for value in middle)))
