"""Parameters of the cosmic rays: config/instrument/cosmic_rays.yaml."""

from dataclasses import dataclass
from typing import Annotated

from csstsim.base.model import Data, Number, Whole, at_least, between


@dataclass(frozen=True)
class CosmicRays(Data):
    """Parameters of cosmic_rays.yaml; the file explains them and gives their units."""

    rate: Annotated[Number, between(0, 1e-3)]
    short_max: Annotated[Number, between(0, 1e4)]
    long_share: Annotated[Number, between(0, 1)]
    long_max: Annotated[Number, between(0, 1e4), at_least("short_max")]
    log_energy: Annotated[Number, between(0, 7)]
    log_energy_fwhm: Annotated[Number, between(0, 3)]
    diffusion: Annotated[Number, between(0, 10)]
    marked_from: Annotated[Whole, between(1, 1e6)]
