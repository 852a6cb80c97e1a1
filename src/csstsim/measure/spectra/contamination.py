"""Light of neighbours under a spectrum, as known from a catalogue of an imaging survey.

The catalogue has the position, shape and smooth spectrum of each object. Its orders are dispersed by the same gratings
and rendered by the same model (measure.spectra.spectral_model) as those of the truth. The light of an object itself in
that image is that of its catalogue entry, not its true light: an emission line that is not in the catalogue stays in
the spectrum of its object, and is not subtracted from that of a neighbour.
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

CHUNK = 500  # objects whose spectra are in memory at a time
NOBODY = -1  # in `owner`: the object is not in the catalogue


@dataclass(frozen=True, eq=False)
class CataloguedLight:
    """The expected light of a catalogue.

    `orders` (as io.orders, sorted by row) and `sources` (extract.Sources) of its objects; `model`: a
    spectral_model.SpectralModel; `owner` (rows of the truth table,): row in the catalogue, or NOBODY.
    """

    orders: ObjectTable
    sources: Sources
    model: SpectralModel
    owner: IntArray

    def image(self, window: Window, faintest: float = 0.0, boxes: FloatArray | None = None) -> FloatArray:
        """Return SpectralModel.image of all objects of the catalogue."""
        sources = self.sources
        assert sources.spectra is not None  # a catalogue has them
        return self.model.image(
            self.orders, sources.shapes, sources.spectra, sources.edges, window, faintest=faintest, boxes=boxes
        )

    def image_of_one(self, one: ObjectTable, window: Window, faintest: float = 0.0) -> FloatArray:
        """Return the part of `image` of the object and order of one row of the truth's table of orders."""
        row = int(self.owner[int(one["row"][0])])
        low, high = np.searchsorted(self.orders["row"], [row, row + 1])
        orders = self.orders.take(slice(low, high))
        orders = orders.take((orders["order"] == one["order"][0]) & (orders["grating"] == one["grating"][0]))
        if row == NOBODY or len(orders) == 0:
            return np.zeros(window.shape, np.float32)
        assert self.sources.spectra is not None
        spectrum = np.asarray(self.sources.spectra(np.array([row]), self.sources.edges), float)[0]
        return self.model.image_of_one(orders, self.sources.shapes, spectrum, self.sources.edges, window, faintest)

    def functions(
        self, window: Window
    ) -> tuple[Callable[..., FloatArray], Callable[[ObjectTable, Window, float], FloatArray]]:
        """Return the fields (others, image_of_one) of extract.DispersedImage for this light."""
        return partial(self.image, window), self.image_of_one


def expected_orders(
    rows: IntArray, x: FloatArray, y: FloatArray, spectra: BinnedSpectra, disperser: Disperser, exptime: float
) -> ObjectTable:
    """Return the table of orders, as io.orders.read_orders gives it, that objects of a catalogue are expected to have.

    rows (n,): of the catalogue, rising; x, y (n,) px: positions without the grating; spectra: of rows and edges, as
    extract.Sources; disperser: optics.gratings.dispersion.Disperser; exptime in s. The light of an object passes the
    grating in front of its centre: a beam on the line between two gratings is not divided.
    """
    visits = disperser.visits(x, y, np.zeros(len(x)))
    visits = visits[np.argsort(visits[:, 0], kind="stable")]
    rates = exptime * disperser.rates
    electrons = np.zeros((len(visits), len(disperser.orders)))
    for first in range(0, len(visits), CHUNK):
        chunk = visits[first : first + CHUNK]
        chunk_spectra = spectra(rows[chunk[:, 0]], disperser.edges)
        for piece in range(2):
            of_piece = chunk[:, 1] == piece
            electrons[first : first + CHUNK][of_piece] = np.einsum("nb,ob->no", chunk_spectra[of_piece], rates[piece])
    lines = disperser.lines(visits, x, y)
    parts = []
    names = np.array([grating.name for grating, _ in disperser.gratings.pieces])
    for o, number in enumerate(disperser.orders):
        has = np.array([number in grating.orders for grating, _ in disperser.gratings.pieces])
        lit = np.flatnonzero(has[visits[:, 1]] & (electrons[:, o] > 0))
        object_row = visits[lit, 0]
        p, q, r, s = lines[lit, o].T
        parts.append({
            "row": rows[object_row].astype(np.int32), "order": np.full(len(object_row), number, np.int8),
            "grating": names[visits[lit, 1]], "cut": np.zeros(len(object_row), bool),
            "x": x[object_row], "y": y[object_row],
            "p": p, "q": q, "r": r, "s": s, "electrons": electrons[lit, o], "drawn": electrons[lit, o],
        })  # fmt: skip
    table = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    return ObjectTable(table).take(np.lexsort((table["order"], table["row"])))
