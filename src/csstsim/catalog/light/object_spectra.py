"""Observed spectra of a chip's objects, for dispersed light."""

import numpy as np

from csstsim.base.errors import InputError
from csstsim.catalog.base import name_of, users_code
from csstsim.catalog.table import STAR
from csstsim.universe.lensing.lensing import magnification

ROW = "catalog_row"  # column that `select` leaves on spectroscopic chips: the object's row in the catalogue


class Spectra:
    """Spectra of the rows of a table from catalog.selection.select: magnification included."""

    def __init__(self, objects, load):
        """load: (rows of the table, edges) -> (n, bins), before magnification."""
        mu, _ = magnification(*(objects[name] for name in ("kappa", "gamma1", "gamma2")))
        self._mu, self._load = np.where(objects["obj_type"] == STAR, 1.0, mu), load
        if "dmag" in objects:  # light that varies
            self._mu = self._mu * 10 ** (-0.4 * objects["dmag"].astype(float))

    def __call__(self, rows, edges):
        """Return (len(rows), len(edges) - 1) photon / s / m2 / angstrom: means over bins of `edges` [angstrom]."""
        return self._load(rows, edges) * self._mu[rows, None]

    def times(self, factor):
        """Return the Spectra with the light of each row times `factor` (n,)."""
        made = object.__new__(Spectra)
        made._mu, made._load = self._mu * factor, self._load
        return made

    def take(self, order):
        """Return the Spectra of the table's rows in another order, an index array."""
        made = object.__new__(Spectra)
        made._mu, made._load = self._mu[order], lambda rows, edges: self._load(order[rows], edges)
        return made


def embedded_spectra(objects, universe):
    """Return the Spectra of objects of the embedded universe, made from the table's columns; no brick is read."""
    from csstsim.catalog.light.binned_spectra import binned
    from csstsim.catalog.light.embedded_spectra import light_columns

    light = light_columns(objects)
    return Spectra(objects, lambda rows, edges: binned(universe, light.take(rows), edges))


def catalog_spectra(objects, catalog):
    """Return the Spectra of objects of a CatalogBase, opened again.

    Raises InputError if it holds other objects than those that were selected from it.
    """
    if catalog.truth_hash != objects.meta["truth_hash"]:
        raise InputError("gives other objects each time it is opened", key=name_of(catalog))

    def load(rows, edges):
        with users_code(f"{name_of(catalog)}.load_binned"):
            return catalog.load_binned(objects[ROW][rows], edges)

    return Spectra(objects, load)
