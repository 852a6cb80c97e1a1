"""Compare a brick's measurements with its truth: the checks of the paper's section 6, as numbers and gates.

For each exposure (trials): completeness against true S/N and magnitude, flux errors in units of the stated ones
(pulls), fluxes and positions along the direction of charge transfer. For the merged catalogue (compare):
magnitudes measured minus true (PSF for stars, total for galaxies), positions, colours, number counts. Blended and
(nearly) saturated sources are left out. The folder gates has the gates.

A median over exposures would hide a single faulty one. So each exposure is tested, and register.of_exposures selects
the results that are reported.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from csstsim.base.healpix import brick_of
from csstsim.base.types import BoolArray, FloatArray, IntArray
from csstsim.catalog.table import ObjectTable
from csstsim.measure.bricks.validation import compare
from csstsim.measure.bricks.validation.density import by_density
from csstsim.measure.bricks.validation.gates.data import BrickData, FrameData
from csstsim.measure.bricks.validation.gates.register import evaluate, of_exposures
from csstsim.measure.bricks.validation.measured_frame import DISTINCT, distinct, truth_inside
from csstsim.measure.bricks.validation.trials import (
    SHAPES,
    bright_stars,
    close_pairs,
    detectable_points,
    joined,
    magnitude_at_fraction,
    trials,
)

if TYPE_CHECKING:
    from csstsim.campaign.thresholds import ValidateConfig
    from csstsim.measure.bricks.validation.gates.record import GateResult
    from csstsim.measure.bricks.validation.measured_frame import MeasuredFrame

SNR_EDGES = (1, 2, 3, 4, 5, 6, 7, 8, 10, 15, 20, 50, 100, 500)
BIAS_EDGES = (5, 10, 20, 50, 100, 200, 500)  # S/N: bins for the effects of charge transfer
MAG_EDGES = np.arange(16.0, 29.1, 0.5)
LOCUS = ("g", "r", "i")  # the public locus of stars is in bands of these names


def validate_brick(
    pix: int,
    sources: ObjectTable,
    frames: Iterable[MeasuredFrame],
    bands: Collection[str],
    thresholds: ValidateConfig,
    laws: Mapping[str, tuple[float, float]] | None = None,
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return (result, arrays) of brick `pix`.

    `sources`: merged ObjectTable (or mapping) of the brick; `frames`: iterable of MeasuredFrame; `bands`: the
    camera's (Camera.bands); `thresholds`: of the gates; `laws`: {kind: (number in the brick's truth, number
    expected from the laws of the universe)}, or None. `result` is JSON-like: per band completeness, magnitude residuals
    (mag), depth; astrometry (mas); gates. `arrays`: the data of report.figures.
    """
    by_band, truth, required, real = _measured_frames(pix, sources, frames, bands, thresholds)
    match = compare.match(truth, sources)
    statistics = {}
    curves = {}
    residuals = {}
    tables = {}
    gates = []
    observed = [band for band in bands if by_band[band].infos]
    for band in observed:
        in_band = by_band[band]
        table = tables[band] = joined(in_band.trials)
        residuals[band], magnitudes = compare.magnitudes(band, truth, sources, match, in_band.infos)
        # The frames of the band may cover a part of the brick only
        covered = np.isin(truth["id"], np.concatenate(in_band.ids or [np.zeros(0, int)]))
        points = ~table["galaxy"].astype(bool)
        curves[band] = completeness(table["snr"][points], table["found"][points] > 0, SNR_EDGES)
        statistics[band] = (
            magnitudes
            | _exposure_statistics(table, in_band.infos, thresholds)
            | {
                "counts": compare.counts(
                    band, truth.take(covered), sources, match[covered], real, MAG_EDGES, in_band.infos
                ),
                "pairs": dict(zip(("found", "n"), map(int, in_band.pairs), strict=True)),
            }
        )
        gates += of_exposures(in_band.gates) + evaluate("band", statistics[band], thresholds, band)
    galaxy_colours = compare.galaxy_colours(truth, sources, match, observed)
    for part in galaxy_colours:
        gates += evaluate("colour", part, thresholds, " - ".join(part["bands"]))
    east, north = compare.astrometry(truth, sources, match, observed)
    bright = compare.spread(np.hypot(*compare.astrometry(truth, sources, match, observed, compare.SNR_SHARP)))
    purity = float(real.mean()) if len(real) else None
    lost = compare.lost(truth, match, required)
    duplicates = compare.duplicates(truth, sources, match)
    brick = BrickData(laws or {}, bright, purity, len(sources), lost, duplicates)
    gates += evaluate("brick", brick, thresholds, "all")
    locus = LOCUS if set(LOCUS) <= set(bands) else ()
    result = {
        "brick": int(pix),
        "sources": len(sources),
        "purity": purity,
        "left_out": getattr(sources, "meta", {}).get("left_out"),
        "truth": len(truth),
        "frames": sum(len(in_band.infos) for in_band in by_band.values()),
        "bands": statistics,
        "astrometry_mas": {"east": compare.spread(east), "north": compare.spread(north)},
        "radial_mas": bright,
        "galaxy_colours": galaxy_colours,
        "laws": laws,
        "density": by_density(truth, sources, match, real, {band: by_band[band].infos for band in observed}),
        "gates": gates,
    }
    return result, {
        "completeness": curves,
        "residual": residuals,
        "trials": tables,
        "colour": compare.colours(truth, sources, match, compare.colour_bands(bands)),
        "locus": compare.colours(truth, sources, match, locus, compare.SNR_BRIGHT, "star"),
    }


@dataclass
class _BandFrames:
    """What the frames of a band give for a brick, one entry a frame; frames off the brick have no trials and ids."""

    trials: list[ObjectTable] = field(default_factory=list)
    infos: list[dict[str, Any]] = field(default_factory=list)
    gates: list[GateResult] = field(default_factory=list)
    ids: list[IntArray] = field(default_factory=list)
    pairs: IntArray = field(default_factory=lambda: np.zeros(2, int))  # close pairs: fainter objects found, all


class _MeasuredFrames(NamedTuple):
    """What all frames give for a brick.

    truth: the brick's true objects; required: ids by frame of the objects that must be in the merged catalogue; real:
    (sources,), whether a source belongs to a true object.
    """

    by_band: dict[str, _BandFrames]
    truth: ObjectTable
    required: list[IntArray]
    real: BoolArray


def _measured_frames(
    pix: int, sources: ObjectTable, frames: Iterable[MeasuredFrame], bands: Collection[str], thresholds: ValidateConfig
) -> _MeasuredFrames:
    by_band = {band: _BandFrames() for band in bands}
    magnitudes = [f"mag_{band}" for band in bands]
    truths = []
    required = []
    real = np.zeros(len(sources), bool)
    for frame in frames:  # one at a time is in memory, then only what lies on the brick
        in_band = by_band[frame.band]
        real[compare.matched_sources(frame.truth, sources)] = True
        in_band.infos.append(frame.info)
        truth = truth_inside(frame)
        truth = truth.take(brick_of(truth["ra_epoch"], truth["dec_epoch"]) == pix) if len(truth) else truth
        in_band.pairs += close_pairs(truth, frame)
        table = trials(truth, frame) if len(truth) else joined([])
        data = FrameData(frame, table, pix, thresholds)
        in_band.gates += evaluate("frame", data, thresholds, frame.band, **data.where)
        if len(truth):
            in_band.trials.append(table)
            good = (table["clean"] > 0) & (table["snr"] > compare.SNR_COUNT) & (table["snr"] < compare.SNR_MAX)
            required.append(truth["id"][~truth["blended"]][good])
            in_band.ids.append(truth["id"])
            truths.append(ObjectTable({name: truth[name] for name in (*DISTINCT, *magnitudes)}))
    return _MeasuredFrames(by_band, distinct(truths, magnitudes), required, real)


def _exposure_statistics(
    table: ObjectTable, infos: Sequence[Mapping[str, Any]], thresholds: ValidateConfig
) -> dict[str, Any]:
    """Return the statistics of a band's single exposures; table: trials of all of them."""
    galaxy = table["galaxy"].astype(bool)
    found = table["found"] > 0
    points = ~galaxy
    detectable = detectable_points(table, thresholds.snr_min)
    bright = bright_stars(table)
    n, n_found = completeness(table["snr"][points], found[points], SNR_EDGES)
    zeropoint = [info["zeropoint"] - 2.5 * np.log10(info["exptime"]) for info in infos]
    return {
        "frames": len(infos),
        "depth_5sigma": float(np.median([info["depth_5sigma"] for info in infos])),
        "completeness": float(found[detectable].mean()) if detectable.any() else None,
        "zeropoint": float(np.median(zeropoint)),
        "point_sources": int(detectable.sum()),
        "completeness_curve": {"snr": list(SNR_EDGES), "n": n.tolist(), "found": n_found.tolist()},
        "half_found": {
            "star": magnitude_at_fraction(table["mag"][points], found[points]),
            "galaxy": magnitude_at_fraction(table["mag"][galaxy], found[galaxy]),
        },
        "pull": compare.spread(table["pull"][bright]),
        "psf": _shapes(table, bright),
        "transfer": [_transfer(table, low, high) for low, high in pairwise(BIAS_EDGES)],
    }


def _shapes(table: ObjectTable, stars: BoolArray) -> dict[str, dict[str, Any]]:
    """Return {name: spread} of stars' sizes and distortions against the PSF model's, above compare.SNR_SHARP."""
    sharp = stars & (table["snr"] > compare.SNR_SHARP)
    return {name: compare.spread(table[name][sharp & np.isfinite(table[name])]) for name in SHAPES}


def _transfer(table: ObjectTable, low: float, high: float) -> dict[str, Any]:
    """Return the biases of point sources in a bin of true S/N: position along the columns, and across them; flux."""
    points = (table["snr"] >= low) & (table["snr"] < high) & (table["sound"] > 0) & ~table["galaxy"].astype(bool)
    named = {"deferred_mas": table["deferred_mas"], "across_mas": table["across_mas"], "light": table["light"] - 1}
    return {"snr": [low, high]} | {name: compare.spread(values[points]) for name, values in named.items()}


def completeness(snr: FloatArray, found: BoolArray, edges: Sequence[float]) -> tuple[IntArray, IntArray]:
    """Return (n, found) per bin of true S/N; `found` is a bool array."""
    return np.histogram(snr, edges)[0], np.histogram(snr[found], edges)[0]
