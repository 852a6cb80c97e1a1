"""Traces: the spectra of objects and where the gratings send their light."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from csstsim.base.types import FloatArray, IntArray
from csstsim.optics.gratings.dispersion import Disperser
from csstsim.render.far_wings import WHOLE, Side

if TYPE_CHECKING:
    from csstsim.render.scene import Scene


class OrderBins(NamedTuple):
    """The bins of an order on the chip, each array (bins,): electrons, x, y [px]."""

    electrons: FloatArray
    x: FloatArray
    y: FloatArray


class Traces(NamedTuple):
    """Spectra, visits and Disperser of n objects of a Scene.

    * spectra: (n, bins) mean densities [photon / s / m2 / angstrom] times the exposure time [s]
    * visits: (v, 3) from Disperser.visits: object, piece, whether the piece's edge cuts its light
    * disperser: optics.gratings.dispersion.Disperser
    """

    spectra: FloatArray
    visits: IntArray
    disperser: Disperser

    def side(self, scene: Scene, v: int) -> Side:
        """Return the Side of a visit's object, beyond which its light is cut off before dispersion."""
        i, piece, cut = self.visits[v].tolist()
        if not cut:
            return WHOLE
        x0, x1, y0, y1 = self.disperser.rectangles[piece] - np.repeat([scene.x[i], scene.y[i]], 2)
        return Side(x0, x1, y0, y1)

    def order(self, scene: Scene, v: int, o: int, line: FloatArray) -> OrderBins:
        """Return the OrderBins of order o of visit v; line: its p, q, r, s."""
        i, piece, _ = self.visits[v].tolist()
        p, q, r, s = line.tolist()
        edges = self.disperser.edges
        centres = 0.5 * (edges[1:] + edges[:-1])
        light = self.spectra[i] * self.disperser.rates[piece, o]
        return OrderBins(light, scene.x[i] + p + q * centres, scene.y[i] + r + s * centres)
