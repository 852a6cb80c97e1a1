"""The sky that a campaign's exposures will have, where their layers use the stray-light model (`csstsim plan`).

For each exposure and band one chip is asked, at the middle of its window and of the exposure. No pixel is simulated.
"""

import numpy as np

from csstsim.base.process.progress import progress
from csstsim.base.sphere import unit_vectors
from csstsim.base.units import DAY_S
from csstsim.instrument.orbit import orbit_after
from csstsim.sky.background import COMPONENTS, band_rates, in_band, sky_light
from csstsim.sky.bodies import exposure_angles
from csstsim.sky.directions import telescope_axes
from csstsim.sky.near_stars import stars_about
from csstsim.sky.parameters import sky_numbers

MUCH = 0.1  # of zodiacal light: the share of exposures with more earthshine is shown
ANGLES = {
    "limb": "boresight to the Earth's limb", "limb_sun": "Sun's height at that limb", "sun": "boresight to the Sun",
    "moon": "boresight to the Moon",
}  # fmt: skip


def sky_ranges(run):
    """Return ({band: {component: e-/s/px (n,)}}, {angle: deg (n,)}) of the n exposures with a chip of the band.

    run: campaign.opened.OpenCampaign. Both are empty if the layers do not use the stray-light model. Angles are those
    of the headers (sky.bodies.exposure_angles), at the start. Raises InputError where the model refuses an exposure.
    """
    exposures = with_the_model(run)
    numbers = sky_numbers(run.camera.sky) if exposures else None
    rates, levels, angles = {}, {}, {name: [] for name in ANGLES} if exposures else {}
    for obsid, jobs in progress(exposures.items(), "sky of exposures"):
        chips = {band: job.exposure for band, job in jobs.items()}
        pointing = next(iter(chips.values())).pointing
        for name, value in _angles(pointing).items():
            angles[name].append(value)
        try:
            light = _light(chips.values(), pointing, numbers)
        except Exception as exc:
            exc.add_note(f"in obsid {obsid}")
            raise
        for k, (band, exposure) in enumerate(chips.items()):
            if band not in rates:
                detector = exposure.chip.detector
                rates[band] = band_rates(exposure.filter, exposure.telescope, detector.pixel_um, numbers)
            for name, values in in_band(light, rates[band]).items():
                levels.setdefault(band, {}).setdefault(name, []).append(values[k])
    order = [band for band in run.camera.filters if band in levels]
    return {band: {name: np.array(v) for name, v in levels[band].items()} for band in order}, {
        name: np.array(values) for name, values in angles.items()
    }


def sky_table(levels):
    """Return a rich table of the components by band: least, median, most; and the share with much earthshine."""
    from rich.table import Table

    table = Table(title="Sky at the middle of a chip, e-/s/px: least, median, most of the exposures")
    for column in ("band", *COMPONENTS, f"earth above {MUCH:.0%} of zodiacal"):
        table.add_column(column, justify="left" if column == "band" else "right")
    for band, parts in levels.items():
        table.add_row(band, *(_three(parts[name]) for name in COMPONENTS), f"{much_earthshine(parts):.0%}")
    return table


def angle_lines(angles):
    """Return lines of text: the range of each angle."""
    return [f"{label}: {_three(angles[name], '.1f')} deg (least, median, most)" for name, label in ANGLES.items()]


def much_earthshine(parts):
    """Return the share of exposures whose earthshine exceeds MUCH of their zodiacal light."""
    return float(np.mean(parts["earth"] > MUCH * parts["zodiacal"]))


def _three(values, form=".2g"):
    return " ".join(f"{value:{form}}" for value in (values.min(), np.median(values), values.max()))


def with_the_model(run):
    """Return {obsid: {band: Job}} of the science exposures whose layers use the stray-light model, one chip a band."""
    found = {}
    for job in run.science_jobs:
        step = run.steps["SCIE"].step("sky_background")
        if step is not None and step.param.enable_straylight_model:
            found.setdefault(job.obsid, {}).setdefault(job.chip.filter, job)
    return found


def _angles(pointing):
    found = exposure_angles(pointing.ra, pointing.dec, pointing.mjd, pointing.sat_position, pointing.sat_velocity)
    return {name: found[name] for name in ANGLES}


def _light(exposures, pointing, numbers):
    """Return the `sky_light` along the middle of each Exposure's window, at the middle of the exposure."""
    after = 0.5 * pointing.exptime
    moment = pointing.mjd + after / DAY_S, *orbit_after(pointing.sat_position, pointing.sat_velocity, after)
    first = next(iter(exposures))
    axes = telescope_axes(pointing.ra, pointing.dec, pointing.pa, first.telescope.parity)
    sights = np.concatenate([_middle(exposure) for exposure in exposures])
    stars = np.array([np.logical_or(*stars_about(exposure, numbers)) for exposure in exposures])
    return sky_light(axes, sights, moment, numbers, stars)


def _middle(exposure):
    window = exposure.window
    middle = 0.5 * (window.x0 + window.x1 - 1), 0.5 * (window.y0 + window.y1 - 1)
    return unit_vectors(*exposure.wcs.pixel_to_world(*(np.array([value]) for value in middle)))
