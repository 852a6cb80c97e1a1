"""Light of neighbours under a spectrum, as a catalogue of an imaging survey knows it.

The catalogue has places, shapes and a smooth spectrum of each object. Its orders are dispersed by the same gratings and
drawn by the same model (measure.spectra.spectral_model) as those of the truth. What an object itself has in that image
is its catalogue entry's light, not its true light: an emission line that the catalogue does not know stays in the
spectrum of its own object, and is not subtracted from that of a neighbour.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.types import FloatArray, IntArray
from csstsim.catalog.table import ObjectTable
from csstsim.instrument.chip import Window

if TYPE_CHECKING:
    from csstsim.measure.spectra.extract import Sources
    from csstsim.measure.spectra.spectral_model import BinnedSpectra, SpectralModel
    from csstsim.optics.gratings.dispersion import Disperser

CHUNK = 500  # objects whose spectra are held at a time
NOBODY = -1  # of `owner`: the catalogue lacks the object


@dataclass(frozen=True, eq=False)
class CataloguedLight:
    """What a catalogue knows: `orders` (as io.orders, sorted by row) and `sources` (extract.Sources) of its objects,
    `model` spectral_model.SpectralModel, `owner` (rows of the truth table,) row in the catalogue, or NOBODY.
    """

    orders: ObjectTable
    sources: Sources
    model: SpectralModel
    owner: IntArray

    def image(self, window: Window, faintest: float = 0.0, boxes: FloatArray | None = None) -> FloatArray:
        """Return SpectralModel.image of all objects of the catalogue."""
        sources = self.sources
        assert sources.spectra is not None  # a catalogue knows them
        return self.model.image(
            self.orders, sources.shapes, sources.spectra, sources.edges, window, faintest=faintest, boxes=boxes
        )

    def own(self, one: ObjectTable, window: Window, faintest: float = 0.0) -> FloatArray:
        """Return what the object of one row of the truth's table of orders has in `image` there, in that order."""
        row = int(self.owner[int(one["row"][0])])
        low, high = np.searchsorted(self.orders["row"], [row, row + 1])
        mine = self.orders.take(slice(low, high))
        mine = mine.take((mine["order"] == one["order"][0]) & (mine["grating"] == one["grating"][0]))
        if row == NOBODY or len(mine) == 0:
            return np.zeros(window.shape, np.float32)
        assert self.sources.spectra is not None
        spectrum = np.asarray(self.sources.spectra(np.array([row]), self.sources.edges), float)[0]
        return self.model.image_of_one(mine, self.sources.shapes, spectrum, self.sources.edges, window, faintest)

    def known(
        self, window: Window
    ) -> tuple[Callable[..., FloatArray], Callable[[ObjectTable, Window, float], FloatArray]]:
        """Return (others, own) of extract.DispersedImage, functions of this light."""
        return partial(self.image, window), self.own


def expected_orders(
    rows: IntArray, x: FloatArray, y: FloatArray, spectra: BinnedSpectra, disperser: Disperser, exptime: float
) -> ObjectTable:
    """Return the table of orders, as io.orders.read_orders gives it, that objects of a catalogue are expected to have.

    rows (n,): of the catalogue, rising; x, y (n,) px where their light would fall without the grating; spectra: of
    rows and edges, as extract.Sources; disperser: optics.gratings.dispersion.Disperser; exptime in s. An object passes
    the grating in front of its middle: a beam on the line between two is not divided.
    """
    visits = disperser.visits(x, y, np.zeros(len(x)))
    visits = visits[np.argsort(visits[:, 0], kind="stable")]
    rates = exptime * disperser.rates
    electrons = np.zeros((len(visits), len(disperser.orders)))
    for first in range(0, len(visits), CHUNK):
        some = visits[first : first + CHUNK]
        light = spectra(rows[some[:, 0]], disperser.edges)
        for piece in range(2):
            mine = some[:, 1] == piece
            electrons[first : first + CHUNK][mine] = np.einsum("nb,ob->no", light[mine], rates[piece])
    lines = disperser.lines(visits, x, y)
    parts = []
    names = np.array([grating.name for grating, _ in disperser.gratings.pieces])
    for o, number in enumerate(disperser.orders):
        has = np.array([number in grating.orders for grating, _ in disperser.gratings.pieces])
        there = np.flatnonzero(has[visits[:, 1]] & (electrons[:, o] > 0))
        at = visits[there, 0]
        p, q, r, s = lines[there, o].T
        parts.append({
            "row": rows[at].astype(np.int32), "order": np.full(len(at), number, np.int8),
            "grating": names[visits[there, 1]], "cut": np.zeros(len(at), bool), "x": x[at], "y": y[at],
            "p": p, "q": q, "r": r, "s": s, "electrons": electrons[there, o], "drawn": electrons[there, o],
        })  # fmt: skip
    table = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    return ObjectTable(table).take(np.lexsort((table["order"], table["row"])))
