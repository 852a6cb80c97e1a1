"""The choice of slitless spectra to extract: those with enough S/N in the mean or in an emission line."""

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
LINE_SEARCH_FROM = 0.03  # of the minimum S/N: mean S/N from which lines are searched
LEFT_OUT = {
    "faint": "below the minimum S/N, in the mean and in each line",
    "off": "no light of the order on the window",
    "second": "the second of two gratings, with less of the light",
    "unusable": "no usable pixel",
}


class Choice(NamedTuple):
    """The spectra to extract.

    Attributes
    ----------
    orders : sequence of int
        Dispersion orders.
    snr_min : float
        Minimum predicted S/N per resolution element.
    ids : sequence of int or None
        Ids of the objects; None: all.
    """

    orders: Sequence[int] = (1,)
    snr_min: float = 5.0
    ids: Sequence[int] | None = None


DEFAULT_CHOICE = Choice()


def predicted_snr(orders: ObjectTable, shapes: Shapes, noise: float) -> FloatArray:
    """Return (n,): S/N in a resolution element of each row, from its rendered electrons.

    noise: of a pixel of sky [electron].
    """
    columns = np.maximum(np.abs(orders["q"]) * (orders["wave_max"] - orders["wave_min"]), 1.0)
    fractions = shapes.fraction[orders["row"]]
    radius = shapes.radius[orders["row"], ACROSS]
    rows = ELEMENT_ROWS + 2 * (fractions * radius).sum(axis=1)
    signal = ELEMENT * np.nan_to_num(orders["drawn"]) / columns
    return signal / np.sqrt(np.maximum(signal, 0.0) + ELEMENT * rows * noise**2)


def line_snr(orders: ObjectTable, sources: Sources, model: SpectralModel, noise: float) -> FloatArray:
    """Return (n,): S/N of the brightest resolution element of each row, that of an emission line if there is one.

    The element is longer by the object's size along the trace.
    """
    snr = np.zeros(len(orders))
    transmitted = np.array([np.interp(sources.edges, GRID, line) for line in model.cumulative])
    transmitted = np.diff(transmitted, axis=1)
    for (k, spectrum), pair in zip(sources.each_spectrum(orders["row"]), model.pairs(orders), strict=True):
        row = orders["row"][k]
        q = abs(orders["q"][k])
        electrons = np.append(0.0, np.cumsum(spectrum * transmitted[pair]))
        if not electrons[-1] > 0:
            continue
        fractions = sources.shapes.fraction[row]
        radius = sources.shapes.radius[row]
        along = 2 * float((fractions * radius[ALONG]).sum())
        across = 2 * float((fractions * radius[ACROSS]).sum())
        position = q * sources.edges
        length = ELEMENT + along
        in_range = (sources.edges >= orders["wave_min"][k]) & (sources.edges <= orders["wave_max"][k])
        brightest = np.max(np.interp(position + length, position, electrons) - electrons, where=in_range, initial=0.0)
        signal = orders["drawn"][k] * brightest / electrons[-1]
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

    These are rows of the chosen orders with light on the window and enough S/N, in the mean or in a line. Near the line
    between two gratings, only the grating with more of the light gives a spectrum.
    """
    asked = np.isin(orders["order"], choice.orders)
    if choice.ids is not None:
        asked &= np.isin(orders["id"], choice.ids)
    on_window = (orders["drawn"] > 0) & np.isfinite(orders["wave_min"])
    largest = _largest(orders)
    snr = predicted_snr(orders, sources.shapes, frame.noise)
    if sources.spectra is not None:
        may_have_line = (snr < choice.snr_min) & (snr >= LINE_SEARCH_FROM * choice.snr_min)
        faint = np.flatnonzero(asked & on_window & largest & may_have_line)
        snr[faint] = np.maximum(snr[faint], line_snr(orders.take(faint), sources, model, frame.noise))
    bright = snr >= choice.snr_min
    masks = {"off": ~on_window, "second": on_window & ~largest, "faint": on_window & largest & ~bright}
    return asked & on_window & largest & bright, {name: int((asked & mask).sum()) for name, mask in masks.items()}


def shortened(orders: ObjectTable, model: SpectralModel) -> BoolArray:
    """Return (n,) bool: the rows of the orders' table of whose range the window cuts more than an ELEMENT."""
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
