"""Truth of whole objects: parts (catalog.galaxy_shapes.part_rows) join the object that they are a part of."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from csstsim.catalog.table import ObjectTable

ADDED = "electrons", "drawn"  # of parts, to their object; magnitudes add as light does


def whole_objects(truth: ObjectTable) -> ObjectTable:
    """Return a truth table (ObjectTable) without the rows of parts, whose light is added to their objects'.

    A part whose object is not in the table stays: its light is on the frame. Flags are those of all parts together, S/N
    adds in squares, the predicted error as it is.
    """
    if "part_of" not in truth or not (truth["part_of"] >= 0).any():
        return truth
    order = np.argsort(truth["id"], kind="stable")
    part = np.flatnonzero(truth["part_of"] >= 0)
    at = order[np.minimum(np.searchsorted(truth["id"][order], truth["part_of"][part]), len(truth) - 1)]
    there = truth["id"][at] == truth["part_of"][part]
    part = part[there]
    at = at[there]
    columns = {}
    for name in ADDED:
        if name in truth:
            columns[name] = truth[name].copy()
            np.add.at(columns[name], at, truth[name][part])
    if {"electrons", "drawn"} <= set(columns) and "fraction" in truth:
        lit = columns["electrons"] > 0
        columns["fraction"] = np.divide(columns["drawn"], columns["electrons"], out=np.zeros(len(truth)), where=lit)
    for name in ("mag", *(name for name in truth if name.startswith("mag_"))):
        if name in truth:
            light = 10 ** (-0.4 * truth[name].astype(float))
            np.add.at(light, at, light[part])  # NaN if the light of one is not known
            columns[name] = (-2.5 * np.log10(light)).astype(truth[name].dtype)
    if "snr" in truth:
        square = truth["snr"].astype(float) ** 2
        np.add.at(square, at, square[part])
        columns["snr"] = np.sqrt(square).astype(truth["snr"].dtype)
    columns["flags"] = truth["flags"].copy()
    np.bitwise_or.at(columns["flags"], at, truth["flags"][part])
    keep = np.ones(len(truth), bool)
    keep[part] = False
    return truth.with_columns(**columns).take(keep)
