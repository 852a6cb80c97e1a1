"""The shapes of a table's objects for the model of dispersed light."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from csstsim.catalog.galaxy_shapes.components import components, has_image

if TYPE_CHECKING:
    from csstsim.catalog.table import ObjectTable
    from csstsim.measure.spectra.line_profile import Shapes
    from csstsim.optics.geometry.wcs import ChipWCS


def shapes_of(table: ObjectTable, wcs: ChipWCS) -> Shapes:
    """Return the measure.spectra.line_profile.Shapes of the objects of a table from `select`, or of a truth table."""
    from csstsim.measure.spectra.line_profile import Shapes
    from csstsim.render.scene import shape_matrix

    light, _, sizes = zip(*components(table), strict=True)
    return Shapes.of(shape_matrix(table, wcs), np.stack(light, axis=1), np.stack(sizes, axis=1), has_image(table))
