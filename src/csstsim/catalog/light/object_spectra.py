"""Observed spectra of a chip's objects, for dispersed light."""

from __future__ import annotations

from copy import copy
from typing import TYPE_CHECKING, Self

import numpy as np

from csstsim.base.errors import InputError
from csstsim.catalog.base import CatalogBase, name_of, users_code
from csstsim.catalog.galaxy_shapes.component_light import ComponentLight
from csstsim.catalog.table import ObjectTable, lensed
from csstsim.universe.lensing.lensing import magnification

if TYPE_CHECKING:
    from collections.abc import Callable

    from csstsim.base.types import FloatArray, IntArray
    from csstsim.universe.parameters import Universe

ROW = "catalog_row"  # column that `select` adds on slitless chips: the object's row in the catalogue


class Spectra:
    """Spectra of the rows of a table from catalog.selection.select: magnification included."""

    def __init__(
        self,
        objects: ObjectTable,
        load: Callable[[IntArray, FloatArray], FloatArray],
        gradients: ComponentLight | None = None,
    ) -> None:
        """load: (rows of the table, edges) -> (n, bins), before magnification.

        gradients: galaxy_shapes.component_light.ComponentLight if galaxies' components have spectra of their own.
        """
        mu, _ = magnification(*(objects[name] for name in ("kappa", "gamma1", "gamma2")))
        self._mu = np.where(lensed(objects["obj_type"]), mu, 1.0)
        self._load = load
        self.gradients = gradients
        self._objects = objects
        if "dmag" in objects:  # variable flux
            self._mu = self._mu * 10 ** (-0.4 * objects["dmag"].astype(float))

    def __call__(self, rows: IntArray, edges: FloatArray) -> FloatArray:
        """Return (len(rows), len(edges) - 1) photon / s / m2 / angstrom: means over bins of `edges` [angstrom]."""
        return self._load(rows, edges) * self._mu[rows, None]

    def times(self, factor: FloatArray) -> Self:
        """Return the Spectra with the flux of each row times `factor` (n,)."""
        made = copy(self)
        made._mu = self._mu * factor
        return made

    def take(self, order: IntArray) -> Self:
        """Return the Spectra of the table's rows in another order, an index array."""
        made = copy(self)
        made._mu = self._mu[order]
        made._objects = self._objects.take(order)
        made._load = lambda rows, edges: self._load(order[rows], edges)
        return made

    def of_components(self, owner: IntArray, kind: IntArray) -> Self:
        """Return the Spectra of components of the rows `owner` (m,).

        kind (m,): galaxy_shapes.component_light.BULGE, DISK or KNOTS; -1: the whole spectrum of the row.
        """
        made = self.take(owner)

        def load(rows: IntArray, edges: FloatArray) -> FloatArray:
            spectra = self._load(owner[rows], edges)
            parts = np.flatnonzero(kind[rows] >= 0)
            assert self.gradients is not None  # given with components
            fractions = self.gradients.binned(made._objects.take(rows[parts]), edges)
            spectra[parts] *= fractions[np.arange(len(parts)), :, kind[rows[parts]]]
            return spectra

        made._load = load
        return made


def embedded_spectra(objects: ObjectTable, universe: Universe, full: bool = False) -> Spectra:
    """Return the Spectra of objects of the embedded universe, from the table's columns; no brick is read.

    full: bulge, disk and knots have spectra of their own (`components: full`).
    """
    from csstsim.catalog.light.binned_spectra import binned
    from csstsim.catalog.light.embedded_spectra import spectrum_parameters

    parameters = spectrum_parameters(objects)
    load = lambda rows, edges: binned(universe, parameters.take(rows), edges)  # noqa: E731
    return Spectra(objects, load, ComponentLight(universe) if full else None)


def catalog_spectra(objects: ObjectTable, catalog: CatalogBase) -> Spectra:
    """Return the Spectra of objects of a CatalogBase, opened again.

    Raises InputError if it has other objects than those that were selected from it.
    """
    if catalog.truth_hash != objects.meta["truth_hash"]:
        raise InputError("gives other objects each time it is opened", key=name_of(catalog))

    def load(rows: IntArray, edges: FloatArray) -> FloatArray:
        with users_code(f"{name_of(catalog)}.load_binned"):
            return catalog.load_binned(objects[ROW][rows], edges)

    return Spectra(objects, load)
