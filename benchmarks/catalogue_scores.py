"""Scores of a catalogue of one frame against the truth, for benchmarks/catalogue_codes.py.

Isolation, true S/N and matching are those of `csstsim validate` (validation.measured_frame, .trials). A catalogue is an
ObjectTable with columns x, y (whole chip, 0-based px), flux [electron] (the code's best total of each source) and snr
(the code's own flux over error).

Completeness is corrected for chance matches: with c the share found after the detections were shifted by SHIFT px, and
f that found in place, it is (f - c) / (1 - c). A detection is false if no true object, however faint, is within reach.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from csstsim.catalog.table import STAR, ObjectTable
from csstsim.measure.bricks.validation.compare import half_light, spread
from csstsim.measure.bricks.validation.measured_frame import EDGE, MeasuredFrame, truth_inside
from csstsim.measure.bricks.validation.trials import MATCH_PX, matched, trials
from csstsim.measure.source_columns import SHARP

POINTS = (5, 6, 7, 8, 12, 30, np.inf)  # edges of true S/N
GALAXIES = (5, 8, 12, 30, 500)
CLAIMED = (5, 7, 10, 30, np.inf)  # of the S/N that a code gives
BRIGHT = 20.0, 500.0  # true S/N for magnitudes and positions
BY_SNR = (8, 13, 20, 35, 60, 500)  # of galaxies' magnitudes
OF_THIRDS = (8, 20), (20, 500)  # of magnitudes of thirds by size and by the bulge's fraction
OF_POSITIONS = (8, 20), (20, 60), (60, 500)
DAZZLING = 1e6  # electrons of a star that dazzles its surroundings
AROUND = 40.0, 200.0  # px from it
MAGNITUDES = 19.0, 23.0
SHIFT = 30.0  # px


@dataclass(frozen=True)
class Judge:
    """The true objects of a frame.

    truth: io.truth.read_truth; info: the entries n_eff, rms, zeropoint, filter and window of a measured table
    (measure.catalogue); seam: first row of the chip's upper half; pixel: its side [arcsec].
    """

    truth: ObjectTable
    info: dict
    seam: int
    pixel: float

    def frame(self, table):
        """Return the MeasuredFrame of a catalogue."""
        columns = {"x": table["x"], "y": table["y"], "flux_psf": table["flux"], "flags": np.zeros(len(table), np.int32)}
        return MeasuredFrame(self.truth, ObjectTable(columns, self.info), self.seam, self.pixel)

    @cached_property
    def objects(self):
        """The true objects well inside the frame (validation.measured_frame.truth_inside)."""
        nothing = ObjectTable({name: np.zeros(0) for name in ("x", "y", "flux")})
        return truth_inside(self.frame(nothing))

    @cached_property
    def isolated(self):
        """Those without a neighbour."""
        return self.objects.take(~self.objects["blended"])

    @cached_property
    def dazzling(self):
        """Positions (n, 2) of the stars above DAZZLING."""
        some = (self.truth["obj_type"] == STAR) & (self.truth["electrons"] > DAZZLING)
        return np.column_stack([self.truth["x"][some], self.truth["y"][some]])

    def away(self, table):
        """Return the distance (n,) [px] of each row to the nearest dazzling star."""
        from scipy.spatial import cKDTree

        if len(self.dazzling) == 0:
            return np.full(len(table), np.inf)
        return cKDTree(self.dazzling).query(np.column_stack([table["x"], table["y"]]))[0]


def own_catalogue(table):
    """Return the catalogue of a measured table of csstsim (measure.catalogue), without what it calls sharp.

    The flux of a source is its total, star or galaxy.
    """
    table = table.take((table["flags"] & SHARP) == 0)
    return ObjectTable({"x": table["x"], "y": table["y"], "flux": table["flux_total"], "snr": table["snr"]})


def scores(judge, table):
    """Return {row: {"value", "text"}} of a catalogue; values are percents, counts, mag or mas, None without objects."""
    tried = trials(judge.objects, judge.frame(table))
    return _completeness(judge, table, tried) | _false(judge, table) | _accuracy(judge, tried)


def kinds(judge, tried):
    """Return {row: mask of the isolated objects}. tried: validation.trials of them, in the order of judge.isolated."""
    galaxy, snr = tried["galaxy"].astype(bool), tried["snr"]
    rows = {}
    for name, kind, edges in (("points", ~galaxy, POINTS), ("galaxies", galaxy, GALAXIES)):
        for low, high in pairwise(edges):
            rows[f"{name}, S/N {_interval(low, high)}"] = kind & (snr > low) & (snr <= high)
        rows[f"{name}, S/N > {edges[0]:g}"] = kind & (snr > edges[0])
    away = judge.away(judge.isolated)
    around = (snr > 12) & (away > AROUND[0]) & (away < AROUND[1])
    place = f"S/N > 12, {AROUND[0]:g} to {AROUND[1]:g} px from bright stars"
    rows |= {f"galaxies, {place}": galaxy & around, f"points, {place}": ~galaxy & around}
    rows["galaxies, {:g} to {:g} mag".format(*MAGNITUDES)] = (
        galaxy & (tried["mag"] > MAGNITUDES[0]) & (tried["mag"] < MAGNITUDES[1])
    )
    return rows


def _completeness(judge, table, tried):
    """Return the rows of completeness: percent found, corrected for chance, and the chance rate."""
    found, chance = tried["found"] > 0, np.zeros(len(tried))
    for x, y in ((SHIFT, 0), (-SHIFT, 0), (0, SHIFT), (0, -SHIFT)):
        shifted = ObjectTable({"x": table["x"] + x, "y": table["y"] + y})
        chance += 0.25 * (matched(judge.isolated, shifted, judge.pixel) >= 0)
    rows = {}
    for name, some in kinds(judge, tried).items():
        n = int(some.sum())
        if not n:
            rows[f"{name} (0)"] = {"value": None, "text": "-"}
            continue
        share, by_chance = found[some].mean(), chance[some].mean()
        value = 100.0 * float((share - by_chance) / max(1.0 - by_chance, 1e-9))
        rows[f"{name} ({n})"] = {"value": value, "text": f"{value:.1f} ({100 * by_chance:.1f})"}
    return rows


def _false(judge, table):
    """Return the rows of false detections, by the S/N that the code gives, in the whole frame and around stars."""
    table = well_inside(judge, table)
    false, again = false_detections(judge, table)
    snr, near = np.nan_to_num(table["snr"]), judge.away(table) < AROUND[1]
    everywhere = np.ones(len(table), bool)
    rows = {"detections": {"value": len(table), "text": f"{len(table)}"}}
    chosen = {f"> {CLAIMED[0]}": (snr > CLAIMED[0], everywhere)}
    chosen |= {_interval(*edges): ((snr > edges[0]) & (snr <= edges[1]), everywhere) for edges in pairwise(CLAIMED)}
    chosen[f"> {CLAIMED[0]}, within {AROUND[1]:g} px of bright stars"] = snr > CLAIMED[0], near
    for name, (some, place) in chosen.items():
        all_of_them, wrong = int((some & place).sum()), int((some & place & false).sum())
        share = 100.0 * wrong / max(all_of_them, 1)
        text = f"{wrong} of {all_of_them}, {share:.1f}%"
        rows[f"false, claimed S/N {name}"] = {"value": wrong, "text": text, "share": share}
    twice = int((again & (snr > CLAIMED[0])).sum())
    rows[f"second detections of an object, claimed S/N > {CLAIMED[0]}"] = {"value": twice, "text": f"{twice}"}
    return rows


def well_inside(judge: Judge, table: ObjectTable) -> ObjectTable:
    """Return the detections away from the edges of the frame."""
    x0, x1, y0, y1 = judge.info["window"]
    inside = (table["x"] > x0 + EDGE) & (table["x"] < x1 - EDGE) & (table["y"] > y0 + EDGE) & (table["y"] < y1 - EDGE)
    return table.take(inside & np.isfinite(table["x"] + table["y"]))


def false_detections(judge, table):
    """Return masks of the detections with no true object in reach, and of those whose objects have another detection.

    Reach is that of `matched`: MATCH_PX, for wide galaxies half the half-light radius.
    """
    from scipy.spatial import cKDTree

    truth = judge.truth.take(judge.truth["electrons"] > 0)
    false, again = np.ones(len(table), bool), np.ones(len(table), bool)
    if len(truth) and len(table):
        places, others = (np.column_stack([some["x"], some["y"]]) for some in (truth, table))
        reach = np.maximum(MATCH_PX, 0.5 * half_light(truth) / judge.pixel)
        near = cKDTree(others).query_ball_point(places, reach)
        false[np.concatenate([np.zeros(0, int), *filter(None, near)]).astype(int)] = False
        row = matched(truth, table, judge.pixel)
        again[row[row >= 0]] = False
    return false, again & ~false


def _accuracy(judge, tried):
    """Return the rows of magnitudes and positions of isolated objects that were found."""
    found, snr, galaxy = tried["found"] > 0, tried["snr"], tried["galaxy"].astype(bool)
    apart = np.hypot(tried["across_mas"], tried["deferred_mas"])
    with np.errstate(invalid="ignore", divide="ignore"):
        off = -2.5 * np.log10(np.where(tried["light"] > 0, tried["light"], np.nan))
    rows = {}

    def between(low, high):
        return found & (snr > low) & (snr < high)

    for name, kind in (("stars", ~galaxy), ("galaxies", galaxy)):
        some = between(*BRIGHT) & kind
        seen = spread(off[some & np.isfinite(off)])
        rows[f"{name}: magnitude bias"] = _bias(seen)
        known = seen["n"] > 1
        rows[f"{name}: magnitude scatter"] = {"value": seen["sigma"], "text": f"{seen['sigma']:.4f}" if known else "-"}
        rows[f"{name}: position error [mas]"] = _position(apart[some])
    for edges in OF_POSITIONS:
        rows[f"galaxies, S/N {_interval(*edges)}: position error [mas]"] = _position(apart[between(*edges) & galaxy])
    for edges in pairwise(BY_SNR):
        some = between(*edges) & galaxy & np.isfinite(off)
        rows[f"galaxies, S/N {_interval(*edges)}: magnitude bias"] = _bias(spread(off[some]))
    for edges in OF_THIRDS:
        some = np.flatnonzero(galaxy & (snr > edges[0]) & (snr < edges[1]))  # found or not: the same for all codes
        for quantity, column in (("half-light radius", "half_light"), ("bulge", "bulge_frac")):
            thirds = np.array_split(some[np.argsort(np.nan_to_num(judge.isolated[column][some]), kind="stable")], 3)
            for third, rows_of_third in zip(("smallest", "middle", "largest"), thirds, strict=True):
                seen = spread(off[rows_of_third][found[rows_of_third] & np.isfinite(off[rows_of_third])])
                rows[f"galaxies, S/N {_interval(*edges)}, {third} third by {quantity}: magnitude bias"] = _bias(seen)
    return rows


def _bias(seen):
    known = seen["n"] > 1
    return {"value": seen["median"], "text": "{median:+.4f} +- {error:.4f}".format(**seen) if known else "-"}


def _position(apart):
    return (
        {"value": float(np.median(apart)), "text": f"{np.median(apart):.2f}"}
        if len(apart)
        else {"value": None, "text": "-"}
    )


def _interval(low, high):
    return f"> {low:g}" if np.isinf(high) else f"{low:g} - {high:g}"
