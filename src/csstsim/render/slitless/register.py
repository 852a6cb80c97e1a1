"""The drawing methods of spectroscopic chips, in the order in which they render; of equal cost, the last is chosen."""

from csstsim.render.method import SpectraMethod
from csstsim.render.slitless.methods import photons, slabs

METHODS: tuple[SpectraMethod, ...] = (
    slabs.SLABS,
    photons.PHOTONS,
)
