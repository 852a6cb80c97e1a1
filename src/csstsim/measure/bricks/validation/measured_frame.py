"""Measured frames and their true objects: which of them are compared, and with what magnitude (for `validate`)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from csstsim.base.sphere import ra_dec, unit_vectors
from csstsim.base.types import BoolArray, FloatArray
from csstsim.catalog.flags import BAD_VALUE, OFF_CHIP, STRONG_LENSING
from csstsim.catalog.table import ObjectTable
from csstsim.measure.bricks.validation.compare import half_light

if TYPE_CHECKING:
    from csstsim.measure.bricks.validation.facts import Facts

NEAR = 12.0  # px: closer objects are neighbours
EDGE = 12  # px; objects nearer to the frame's edge are not evaluated
# Columns of the true objects of a brick, in addition to their magnitudes
DISTINCT = ("id", "obj_type", "ra_epoch", "dec_epoch", "blended", "half_light", "half_light_px")
VARIES = 0.01  # mag; objects that vary by more are not compared with a mean magnitude
IN_FRAME = 0.9  # minimum fraction of an object's flux in the window


@dataclass(frozen=True)
class MeasuredFrame:
    """One measured Level-0 file: its truth (io.truth.read_truth) and its measured table (measure.catalogue).

    seam: first row of the chip's upper half; pixel: its side [arcsec]; depth: published (low, high) 5-sigma depths [AB
    mag], or None; facts: facts.Facts, or None: then neither pixels nor header are tested.
    """

    truth: ObjectTable
    measured: ObjectTable
    seam: int
    pixel: float
    depth: tuple[float, float] | None = None
    facts: Facts | None = None

    @property
    def info(self) -> dict[str, Any]:
        """The measured table's entries about its frame: {name: value}."""
        return self.measured.meta

    @property
    def band(self) -> str:
        """The band in lower case, as in columns' names."""
        return self.info["filter"].lower()


def truth_inside(frame: MeasuredFrame) -> ObjectTable:
    """Return the true objects well inside a frame, with columns blended, half_light, half_light_px and crowd.

    If the catalogue lacks the magnitude in the frame's band, it is computed from the electrons. Objects that move
    during the exposure are left out; those that vary have the magnitude of the exposure, and count as blended: a merged
    magnitude is a mean over exposures.
    """
    truth, (x0, x1, y0, y1) = frame.truth, frame.info["window"]
    truth = truth.take((truth["flags"] & (OFF_CHIP | STRONG_LENSING | BAD_VALUE)) == 0)
    if len(truth) == 0:
        return truth
    size = half_light(truth)
    truth = truth.with_columns(
        blended=blended(truth["x"], truth["y"], truth["electrons"]),
        half_light=size,
        half_light_px=size / frame.pixel,
        crowd=crowd(truth["x"], truth["y"], truth["electrons"]),
    )
    name = f"mag_{frame.band}"
    with np.errstate(divide="ignore"):
        magnitude = frame.info["zeropoint"] - 2.5 * np.log10(truth["electrons"])
    dmag = truth.get("dmag", np.zeros(len(truth)))
    truth = truth.with_columns(**{name: np.where(np.isnan(truth[name]), magnitude, truth[name] + dmag)})
    truth = truth.with_columns(blended=truth["blended"] | (np.abs(dmag) > VARIES))
    inside = (truth["x"] > x0 + EDGE) & (truth["x"] < x1 - EDGE) & (truth["y"] > y0 + EDGE) & (truth["y"] < y1 - EDGE)
    inside = inside & (truth["electrons"] > 0) & (truth.get("trail_length", np.zeros(len(truth))) == 0)
    if "fraction" in truth:  # for photons it is the fraction that arrived, not the expected one
        inside = inside & ((truth["fraction"] > IN_FRAME) | (truth["method"] == "photons"))
    return truth.take(inside)


def blended(x: FloatArray, y: FloatArray, electrons: FloatArray) -> BoolArray:
    """Return a mask of the blended objects.

    They have a neighbour with more than 10 % of their flux within NEAR, or with more than 100 times their flux within
    40 px (wings).
    """
    from scipy.spatial import cKDTree

    mask = np.zeros(len(x), bool)
    tree = cKDTree(np.column_stack([x, y]))
    pairs = tree.query_pairs(40.0, output_type="ndarray")
    near = np.hypot(*(v[pairs[:, 0]] - v[pairs[:, 1]] for v in (x, y))) < NEAR
    for one, other in ((0, 1), (1, 0)):
        a = pairs[:, one]
        b = pairs[:, other]
        mask[a[electrons[b] > np.where(near, 0.1, 100.0) * electrons[a]]] = True
    return mask


def crowd(x: FloatArray, y: FloatArray, electrons: FloatArray) -> FloatArray:
    """Return the electrons of all other objects within NEAR of each object."""
    from scipy.spatial import cKDTree

    out = np.zeros(len(x))
    pairs = cKDTree(np.column_stack([x, y])).query_pairs(NEAR, output_type="ndarray")
    for one, other in ((0, 1), (1, 0)):
        np.add.at(out, pairs[:, one], electrons[pairs[:, other]])
    return out


def distinct(tables: Sequence[ObjectTable], magnitudes: Iterable[str]) -> ObjectTable:
    """Return the truth of several frames with one row per object id. `ra_epoch` and `dec_epoch` are means.

    An object is blended if it is blended in any frame. A magnitude (of the columns `magnitudes`) that is missing in one
    frame's table comes from another's.
    """
    if not tables:
        return ObjectTable({n: np.zeros(0, bool if n == "blended" else float) for n in (*DISTINCT, *magnitudes)})
    columns = {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}
    _, first, which = np.unique(columns["id"], return_index=True, return_inverse=True)
    anywhere = np.bincount(which, columns["blended"]) > 0
    vectors = unit_vectors(columns["ra_epoch"], columns["dec_epoch"])
    ra, dec = ra_dec(np.stack([np.bincount(which, v) for v in vectors.T], axis=1))
    table = ObjectTable({name: values[first] for name, values in columns.items()})
    for name in magnitudes:
        np.fmax.at(table[name], which, columns[name])
    return table.with_columns(blended=anywhere, ra_epoch=ra, dec_epoch=dec)
