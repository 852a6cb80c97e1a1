"""The choice of slitless spectra to extract: those whose mean light, or a line, stands out from the noise."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from csstsim.base.types import BoolArray, FloatArray
from csstsim.instrument.filter import GRID
from csstsim.measure.spectra.line_profile import ACROSS, ALONG

if TYPE_CHECKING:
    from csstsim.catalog.table import ObjectTable
    from csstsim.measure.spectra.extract import DispersedImage, Sources
    from csstsim.measure.spectra.line_profile import Shapes
    from csstsim.measure.spectra.spectral_model import SpectralModel

# px of a resolution element, for the choice of spectra
ELEMENT = 3.0
ELEMENT_ROWS = 6.0
LINES_FROM = 0.03  # of the least S/N: the mean S/N from which lines are looked for
LEFT_OUT = {
    "faint": "fainter than the least S/N, in the mean and in each line",
    "off": "no light of the order on the window",
    "second": "second of two gratings, with less of the light",
    "unusable": "no usable pixel",
}


class Choice(NamedTuple):
    """Which spectra are extracted: of these `orders`, of a predicted S/N per resolution element of at least `snr_min`.

    `ids`: of these objects only, or None for all.
    """

    orders: Sequence[int] = (1,)
    snr_min: float = 5.0
    ids: Sequence[int] | None = None


DEFAULT_CHOICE = Choice()


def predicted_snr(orders: ObjectTable, shapes: Shapes, noise: float) -> FloatArray:
    """Return (n,) S/N in a resolution element of each row, from its drawn electrons; noise: of a pixel of sky."""
    columns = np.maximum(np.abs(orders["q"]) * (orders["wave_max"] - orders["wave_min"]), 1.0)
    light = shapes.light[orders["row"]]
    radius = shapes.radius[orders["row"], ACROSS]
    rows = ELEMENT_ROWS + 2 * (light * radius).sum(axis=1)
    signal = ELEMENT * np.nan_to_num(orders["drawn"]) / columns
    return signal / np.sqrt(np.maximum(signal, 0.0) + ELEMENT * rows * noise**2)


def line_snr(orders: ObjectTable, sources: Sources, model: SpectralModel, noise: float) -> FloatArray:
    """Return (n,) S/N of the brightest resolution element of each row: that of an emission line, if there is one.

    The element is longer by the object's size along the trace.
    """
    snr = np.zeros(len(orders))
    passed = np.array([np.interp(sources.edges, GRID, line) for line in model.cumulative])
    passed = np.diff(passed, axis=1)
    for (k, spectrum), pair in zip(sources.each(orders["row"]), model.pairs(orders), strict=True):
        row = orders["row"][k]
        q = abs(orders["q"][k])
        electrons = np.append(0.0, np.cumsum(spectrum * passed[pair]))
        if not electrons[-1] > 0:
            continue
        light = sources.shapes.light[row]
        radius = sources.shapes.radius[row]
        along = 2 * float((light * radius[ALONG]).sum())
        across = 2 * float((light * radius[ACROSS]).sum())
        position = q * sources.edges
        length = ELEMENT + along
        seen = (sources.edges >= orders["wave_min"][k]) & (sources.edges <= orders["wave_max"][k])
        most = np.max(np.interp(position + length, position, electrons) - electrons, where=seen, initial=0.0)
        signal = orders["drawn"][k] * most / electrons[-1]
        snr[k] = signal / np.sqrt(signal + length * (ELEMENT_ROWS + across) * noise**2)
    return snr


def chosen_orders(
    frame: DispersedImage,
    orders: ObjectTable,
    sources: Sources,
    model: SpectralModel,
    choice: Choice = DEFAULT_CHOICE,
) -> tuple[BoolArray, dict[str, int]]:
    """Return (mask (n,), {reason of LEFT_OUT: count}): the rows of the orders' table whose spectra are extracted.

    Chosen are rows of the wanted orders with light on the window and enough S/N, in the mean or in a line. Near the
    line between two gratings the second gives none.
    """
    asked = np.isin(orders["order"], choice.orders)
    if choice.ids is not None:
        asked &= np.isin(orders["id"], choice.ids)
    light = (orders["drawn"] > 0) & np.isfinite(orders["wave_min"])
    largest = _largest(orders)
    snr = predicted_snr(orders, sources.shapes, frame.noise)
    if sources.spectra is not None:
        dim = np.flatnonzero(asked & light & largest & (snr < choice.snr_min) & (snr >= LINES_FROM * choice.snr_min))
        snr[dim] = np.maximum(snr[dim], line_snr(orders.take(dim), sources, model, frame.noise))
    bright = snr >= choice.snr_min
    masks = {"off": ~light, "second": light & ~largest, "faint": light & largest & ~bright}
    return asked & light & largest & bright, {name: int((asked & mask).sum()) for name, mask in masks.items()}


def shortened(orders: ObjectTable, model: SpectralModel) -> BoolArray:
    """Return (n,) bool: the rows of the orders' table that lack more than an ELEMENT of their range on the window."""
    low, high = model.limits[model.pairs(orders)].T
    return ((high - low) - (orders["wave_max"] - orders["wave_min"])) * np.abs(orders["q"]) > ELEMENT


def _largest(orders: ObjectTable) -> BoolArray:
    """Return (n,) bool: the row of each object and order with the most light."""
    order = np.lexsort((-orders["drawn"], orders["order"], orders["row"]))
    first = np.ones(len(order), bool)
    first[1:] = (np.diff(orders["row"][order]) != 0) | (np.diff(orders["order"][order]) != 0)
    largest = np.empty(len(order), bool)
    largest[order] = first
    return largest
