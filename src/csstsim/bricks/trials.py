"""What one frame's measurement did with each isolated true object: found or not, and how far off (bricks.validate).

The S/N is that of the truth in optimal photometry, F / sqrt(F + n_eff rms^2), with F the electrons and the frame's own
noise; a galaxy covers more pixels (bricks.compare). `deferred_mas` is the residual along the columns, positive away
from the amplifier: the way in which charge transfer displaces; `transfers` the rows to the amplifier.
"""

import numpy as np

from csstsim.bricks.compare import PIXEL, SATURATED, half_light, wider
from csstsim.bricks.match import one_to_one
from csstsim.catalog.table import GALAXY, ObjectTable

MATCH_PX = 2.5  # truth and detection in one frame
SHAPES = "psf_size", "psf_e1", "psf_e2"
COLUMNS = (
    "galaxy", "snr", "mag", "found", "sound", "x", "y", "across_mas", "deferred_mas", "transfers", "light", "pull",
    "lonely", *SHAPES,
)  # fmt: skip
LONELY = 0.3  # of an object's noise: the light of all its neighbours, with less they do not widen its pull


def trials(truth, frame):
    """Return an ObjectTable of COLUMNS, a row an isolated object of `truth` (bricks.validate.usable rows of `frame`).

    sound: found and not saturated; light: measured electrons (PSF) over true ones, pull: their difference over the
    stated error; NaN where not found. lonely: neighbours' light does not matter to the pull. psf_size, psf_e1, psf_e2:
    a star's size over that of the PSF model there, less 1, and its distortion less the model's (measure.moments).
    """
    truth = truth.take(~truth["blended"])
    electrons, galaxy = truth["electrons"].astype(float), truth["obj_type"] == GALAXY
    area = frame.info["n_eff"] * wider(truth, frame.info["n_eff"])
    row = matched(truth, frame.measured)
    found = row >= 0
    out = {
        "galaxy": galaxy, "snr": electrons / np.sqrt(electrons + area * frame.info["rms"] ** 2),
        "mag": truth[f"mag_{frame.band}"].astype(float), "found": found, "sound": found.copy(),
    }  # fmt: skip
    upper = truth["y"] > frame.seam - 0.5
    out["x"], out["y"] = truth["x"], truth["y"]
    out["lonely"] = truth["crowd"] < LONELY * electrons / out["snr"]
    out["transfers"] = np.where(upper, 2 * frame.seam - 1 - truth["y"], truth["y"])
    for name in ("across_mas", "deferred_mas", "light", "pull", *SHAPES):
        out[name] = np.full(len(truth), np.nan)
    at, measured = row[found], frame.measured
    if found.any():
        out["sound"][found] = (measured["flags"][at] & SATURATED) == 0
        scale = 1000 * PIXEL
        out["across_mas"][found] = scale * (measured["x"][at] - truth["x"][found])
        away = np.where(upper[found], -1.0, 1.0)
        out["deferred_mas"][found] = scale * away * (measured["y"][at] - truth["y"][found])
        out["light"][found] = measured["flux_psf"][at] / electrons[found]
        if "hsm_sigma" in measured:  # another code's table has light and places alone
            out["pull"][found] = (measured["flux_psf"][at] - electrons[found]) / measured["flux_psf_err"][at]
            out["psf_size"][found] = measured["hsm_sigma"][at] / measured["psf_sigma"][at] - 1
            for axis in ("e1", "e2"):
                out[f"psf_{axis}"][found] = measured[f"hsm_{axis}"][at] - measured[f"psf_{axis}"][at]
    return ObjectTable(out)


def matched(truth, measured):
    """Return the row of the detection that is each object's (bricks.match), -1 without one within reach."""
    places, others = (np.column_stack([table["x"], table["y"]]) for table in (truth, measured))
    return one_to_one(places, others, np.maximum(MATCH_PX, 0.5 * half_light(truth) / PIXEL))


def joined(tables):
    """Return one table of several frames' trials."""
    return ObjectTable({name: np.concatenate([table[name] for table in tables] or [np.zeros(0)]) for name in COLUMNS})


def limit(mag, found, share=0.5, step=0.25, fewest=10):
    """Return the magnitude at which `share` are found; None if the bins of `fewest` and more do not cross it."""
    known = np.isfinite(mag)
    if not known.any():
        return None
    mag, found = mag[known], found[known]
    edges = np.arange(np.floor(mag.min()), mag.max() + step, step)
    n, seen = (np.histogram(some, edges)[0] for some in (mag, mag[found]))
    good = n >= fewest
    middle, fraction = 0.5 * (edges[1:] + edges[:-1])[good], seen[good] / n[good]
    cross = np.flatnonzero((fraction[:-1] >= share) & (fraction[1:] < share))
    if not len(cross):
        return None
    k = cross[-1]
    return float(middle[k] + (middle[k + 1] - middle[k]) * (fraction[k] - share) / (fraction[k] - fraction[k + 1]))
