"""The report's section on the sky of exposures with the stray-light model, from the headers of Level-0 files."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.process.progress import progress
from csstsim.campaign.sky_ranges import MUCH, much_earthshine, with_straylight_model
from csstsim.io.fits import open_fits, read_header
from csstsim.optics.sky.background import COMPONENTS
from csstsim.report.parts import Figure, Paragraph, Table

if TYPE_CHECKING:
    from collections.abc import Mapping

    from csstsim.base.types import FloatArray
    from csstsim.campaign.opened import OpenCampaign
    from csstsim.report.style import BandStyle


def sky_of_frames(run: OpenCampaign, styles: Mapping[str, BandStyle]) -> list[Paragraph | Figure | Table]:
    """Return the parts of the section: a figure and a table by band; [] without the model, or without its keywords.

    One chip per band is read in each exposure. styles: report.style.band_styles. Raises InputError for an unreadable
    file.
    """
    from csstsim.report.pictures import chart
    from csstsim.report.stray_panel import sky_by_exposure

    cards = [entry for entry in run.camera.keywords if entry.get("hdu") == 0]
    entries = {entry["from"]: entry["keyword"] for entry in cards if "from" in entry}
    wanted = {name: entries.get(f"sky_{name}") for name in COMPONENTS} | {"limb": entries.get("limb_angle_start")}
    jobs = [job for chips in with_straylight_model(run).values() for job in chips.values()]
    if None in wanted.values() or not jobs:
        return []
    found: dict[str, dict[str, list[float]]] = {}
    for job in progress(sorted(jobs, key=lambda job: job.pointing.mjd), "sky of frames"):
        path = run.paths.level0(job)
        with open_fits(path) as file:
            header = read_header(file[0], path)
        rows = found.setdefault(job.chip.filter, {name: [] for name in wanted})
        for name, keyword in wanted.items():
            rows[name].append(float(header[str(keyword)]))
    bands = [band for band in run.camera.filters if band in found]
    levels = {band: {name: np.array(values) for name, values in found[band].items()} for band in bands}
    limbs = {band: rows.pop("limb") for band, rows in levels.items()}
    text = (
        "The stray-light model is on. Rates are means over one chip per band, from the headers: "
        "minimum, median, maximum."
    )
    head = "band", *(f"{name} [e-/s/px]" for name in COMPONENTS), f"earthshine above {MUCH:.0%} of zodiacal light"
    lines = [
        (band, *(_three(parts[name]) for name in COMPONENTS), f"{much_earthshine(parts):.0%} of exposures")
        for band, parts in levels.items()
    ]
    figure = Figure(chart(sky_by_exposure(levels, limbs, styles)), "The sky by exposure, and earthshine by limb angle")
    return [Paragraph(text), figure, Table(head, lines, "bands")]


def _three(values: FloatArray) -> str:
    return ", ".join(f"{value:.2g}" for value in (values.min(), np.median(values), values.max()))
