"""Truth of whole objects: parts (catalog.galaxy_shapes.part_rows) join the object to which they belong."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from csstsim.catalog.table import ObjectTable

ADDED = "electrons", "drawn"  # of parts, to their object; magnitudes add as fluxes


def whole_objects(truth: ObjectTable) -> ObjectTable:
    """Return a truth table (ObjectTable) without the rows of parts, whose flux is added to their objects'.

    A part whose object is not in the table stays, because its flux is on the frame. Flags are those of all parts
    together, S/N adds in squares, the predicted error as it is.
    """
    if "part_of" not in truth or not (truth["part_of"] >= 0).any():
        return truth
    order = np.argsort(truth["id"], kind="stable")
    part = np.flatnonzero(truth["part_of"] >= 0)
    parent = order[np.minimum(np.searchsorted(truth["id"][order], truth["part_of"][part]), len(truth) - 1)]
    in_table = truth["id"][parent] == truth["part_of"][part]
    part = part[in_table]
    parent = parent[in_table]
    columns = {}
    for name in ADDED:
        if name in truth:
            columns[name] = truth[name].copy()
            np.add.at(columns[name], parent, truth[name][part])
    if {"electrons", "drawn"} <= set(columns) and "fraction" in truth:
        positive = columns["electrons"] > 0
        columns["fraction"] = np.divide(
            columns["drawn"], columns["electrons"], out=np.zeros(len(truth)), where=positive
        )
    for name in ("mag", *(name for name in truth if name.startswith("mag_"))):
        if name in truth:
            flux = 10 ** (-0.4 * truth[name].astype(float))
            np.add.at(flux, parent, flux[part])  # NaN if one of them is not known
            columns[name] = (-2.5 * np.log10(flux)).astype(truth[name].dtype)
    if "snr" in truth:
        square = truth["snr"].astype(float) ** 2
        np.add.at(square, parent, square[part])
        columns["snr"] = np.sqrt(square).astype(truth["snr"].dtype)
    columns["flags"] = truth["flags"].copy()
    np.bitwise_or.at(columns["flags"], parent, truth["flags"][part])
    keep = np.ones(len(truth), bool)
    keep[part] = False
    return truth.with_columns(**columns).take(keep)
