"""Traces: the spectra of objects and where the gratings send their light."""

from typing import NamedTuple

import numpy as np

from csstsim.optics.gratings.dispersion import Disperser
from csstsim.render.far_wings import WHOLE


class Traces(NamedTuple):
    """Spectra, visits and Disperser of n objects of a Scene.

    * spectra: (n, bins) mean densities [photon / s / m2 / angstrom] times the exposure time [s]
    * visits: (v, 3) from Disperser.visits: object, piece, whether the piece's edge cuts its light
    * disperser: optics.gratings.dispersion.Disperser
    """

    spectra: np.ndarray
    visits: np.ndarray
    disperser: Disperser

    def side(self, scene, v):
        """Return (x0, x1, y0, y1) px from a visit's object, beyond which its light is cut off before dispersion."""
        i, piece, cut = self.visits[v].tolist()
        return tuple(self.disperser.rectangles[piece] - np.repeat([scene.x[i], scene.y[i]], 2)) if cut else WHOLE

    def order(self, scene, v, o, line):
        """Return (light [electron], x, y [px]), each (bins,), of order o of visit v; line: its p, q, r, s."""
        (i, piece, _), disperser, (p, q, r, s) = self.visits[v].tolist(), self.disperser, line.tolist()
        centres = 0.5 * (disperser.edges[1:] + disperser.edges[:-1])
        light = self.spectra[i] * disperser.rates[piece, o]
        return light, scene.x[i] + p + q * centres, scene.y[i] + r + s * centres
