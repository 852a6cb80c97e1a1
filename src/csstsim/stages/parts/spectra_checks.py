"""Statistics for the gates of spectroscopic frames: flux of spectra, level of the sky, pointing keywords.

They are written with the spectra of a frame (`checks` of the table's metadata), so that the report reads no image.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from csstsim.catalog.table import GALAXY
from csstsim.io.level0 import read_level0
from csstsim.io.pointing_keywords import Boresight, pointing_offsets, wcs_offset
from csstsim.layers.sky_background import dispersed_sky
from csstsim.measure.bricks.validation.gates.data import clipped_mean
from csstsim.measure.spectra.spectrum_columns import CUT, DIM, LOST

if TYPE_CHECKING:
    from csstsim.base.types import BoolArray
    from csstsim.campaign.job import Job
    from csstsim.campaign.opened import OpenCampaign
    from csstsim.catalog.table import ObjectTable

SNR_BRIGHT = 50.0  # of a whole spectrum: stars above it are compared with the truth
COLUMNS = 50  # a spectrum has at least so many usable columns
FLOOR = 0.005  # added to a spectrum's stated error, so that a few do not dominate the mean


def spectra_checks(run: OpenCampaign, job: Job, truth: ObjectTable, table: ObjectTable) -> dict[str, Any]:
    """Return {"flux": {off, error, n}, "sky": {off, expected, n}, "pointing": {keyword: arcsec}} of a job's spectra.

    flux: clipped mean of the electrons of stars' spectra divided by those of the truth, minus 1; sky: median of the sky
    next to spectra divided by that of the campaign, minus 1, None if a user's layer may add light; expected: median sky
    of the campaign there [electron / px]. truth: of the frame; table: its spectra (measure.spectra.extract).
    """
    file = read_level0(run.paths.level0(job))
    pointing = job.pointing
    boresight = Boresight(pointing.ra, pointing.dec, pointing.pa)
    return {
        "flux": _flux(truth, table),
        "sky": _sky(run, job, table),
        "pointing": pointing_offsets(file.header0, boresight) | {"CRVAL1": wcs_offset(file.header, job.wcs)},
    }


def _flux(truth: ObjectTable, table: ObjectTable) -> dict[str, float | int | None]:
    good = _known(table)
    good &= truth["obj_type"][table["row"]] != GALAXY
    spectra = np.stack([table["row"][good], table["order"][good]], axis=1)
    _, spectrum = np.unique(spectra, axis=0, return_inverse=True)
    spectrum = spectrum.ravel()
    columns = np.bincount(spectrum)
    electrons, model = (np.bincount(spectrum, table[name][good].astype(float)) for name in ("electrons", "model"))
    error = np.sqrt(np.bincount(spectrum, table["electrons_err"][good].astype(float) ** 2))
    bright = (columns >= COLUMNS) & (model > SNR_BRIGHT * error)
    offset, sigma, n = clipped_mean(electrons[bright] / model[bright] - 1, error[bright] / model[bright], FLOOR)
    return {"off": offset, "error": sigma, "n": n}


def _known(table: ObjectTable) -> BoolArray:
    """Return (n,) bool: columns with a result and known expected electrons."""
    return ((table["flags"] & (DIM | LOST | CUT)) == 0) & np.isfinite(table["model"])


def _sky(run: OpenCampaign, job: Job, table: ObjectTable) -> dict[str, float | int | None]:
    steps = run.steps[job.pointing.type]
    step = steps.step("sky_background")
    dark = steps.step("poisson_and_dark")
    if not (steps.shipped and step and len(table)):
        return {"off": None, "n": 0}
    image = dispersed_sky(job.exposure, step.param)
    window = job.window
    row = np.clip(np.round(table["y"]).astype(int) - window.y0, 0, window.ny - 1)
    expected = image[row, table["column"] - window.x0]
    level = table["sky"] - (run.camera.detector.dark * job.pointing.exptime if dark else 0.0)
    good = _known(table) & np.isfinite(level) & (expected > 0)
    if not good.any():
        return {"off": None, "n": 0}
    offset = float(np.median(level[good] / expected[good]) - 1)
    return {"off": offset, "expected": float(np.median(expected[good])), "n": int(np.unique(table["row"][good]).size)}
