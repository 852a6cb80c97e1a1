"""Galaxies with a colour gradient behind gratings: bulge, disk and knots are dispersed with the spectrum of each.

A galaxy whose components have spectra of their own (catalog.galaxy_shapes.component_light) is rendered as up to three
objects, and is one row in the tables. There its bulge_frac and knots_frac are those of the electrons.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from csstsim.catalog.galaxy_shapes.component_light import BULGE, KNOTS
from csstsim.render.parts.piece_tables import SHARE, gathered, orders_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from csstsim.catalog.light.object_spectra import Spectra
    from csstsim.catalog.table import ObjectTable
    from csstsim.optics.gratings.dispersion import Disperser
    from csstsim.render.canvas import Canvas
    from csstsim.render.drawing import Drawing

    DrawDispersed = Callable[
        [Canvas, ObjectTable, Spectra, Disperser, Drawing], tuple[ObjectTable, ObjectTable]
    ]  # of objects, of their orders

_WHOLE = -1


def draw_components(
    draw: DrawDispersed, canvas: Canvas, objects: ObjectTable, spectra: Spectra, disperser: Disperser, drawing: Drawing
) -> tuple[ObjectTable, ObjectTable]:
    """Draw objects with a function of render.slitless; return its tables, with one row for each object.

    The arguments are those of the function. Without colour gradients this is a call of `draw`.
    """
    if spectra.gradients is None:
        return draw(canvas, objects, spectra, disperser, drawing)
    fractions = spectra.gradients.through(disperser.filter, objects)
    split = spectra.gradients.has_gradient(objects)
    fractions[~split] = 1.0, 0.0, 0.0
    owner, kind = np.nonzero(fractions)
    fraction = fractions[owner, kind]
    kind = np.where(split[owner], kind, _WHOLE)
    pieces = objects.take(owner)
    for name, component in (("bulge_frac", BULGE), ("knots_frac", KNOTS)):
        values = np.where(kind == _WHOLE, pieces[name], kind == component)
        pieces = pieces.with_columns(**{name: values.astype(np.float32)})
    flux = {f"flux{i}": pieces[f"flux{i}"] * fraction for i in range(4)}
    pieces = pieces.with_columns(**flux, **{SHARE: pieces.get(SHARE, np.ones(len(owner))) * fraction})
    table, orders = draw(canvas, pieces, spectra.of_components(owner, kind), disperser, drawing)
    whole = gathered(objects, owner, table)
    changed = {}
    for name, component in (("bulge_frac", BULGE), ("knots_frac", KNOTS)):
        part = np.bincount(owner, np.where(kind == component, table["electrons"], 0.0), len(objects))
        lit = split & (whole["electrons"] > 0)
        changed[name] = np.where(lit, part / np.where(lit, whole["electrons"], 1.0), objects[name]).astype(np.float32)
    return whole.with_columns(**changed), orders_of(orders, owner, fraction)
