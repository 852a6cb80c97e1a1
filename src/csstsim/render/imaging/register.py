"""The drawing methods of imaging chips, in the order in which they render; of equal cost, the last is chosen."""

from csstsim.render.imaging.methods import photons, stamps, unresolved
from csstsim.render.method import ImagingMethod

METHODS: tuple[ImagingMethod, ...] = (
    unresolved.UNRESOLVED,
    stamps.STAMPS,
    photons.PHOTONS,
)
