"""Parameters of the defective pixels and columns: config/instrument/defects.yaml."""

from dataclasses import dataclass
from typing import Annotated

from csstsim.base.model import Data, Number, Whole, at_least, between


@dataclass(frozen=True)
class Defects(Data):
    """Parameters of defects.yaml; the file explains them and gives their units."""

    defective: Annotated[Number, between(0, 0.1)]
    hot_share: Annotated[Number, between(0, 1)]
    dead_max: Annotated[Number, between(0, 1)]
    dead_noise: Annotated[Number, between(0, 1e6)]
    hot_shape: Annotated[Number, between(1e-3, 1e3)]
    hot_scale: Annotated[Number, between(0, 1e6)]
    hot_time: Annotated[Number, between(1e-3, 1e5)]
    hot_min: Annotated[Number, between(0, 1e6)]
    columns_min: Annotated[Whole, between(0, 1000)]
    columns_max: Annotated[Whole, between(0, 1000), at_least("columns_min")]
    columns_from: Annotated[Number, between(0, 1)]
    columns_to: Annotated[Number, between(0, 1), at_least("columns_from")]
    length_min: Annotated[Number, between(0, 1)]
    length_max: Annotated[Number, between(0, 1), at_least("length_min")]
    low_factor: Annotated[Number, between(0, 1e6)]
    low_offset: Annotated[Number, between(0, 1e6)]
    high_factor: Annotated[Number, between(0, 1e6), at_least("low_factor")]
    high_offset: Annotated[Number, between(0, 1e6), at_least("low_offset")]
    column_noise: Annotated[Number, between(1, 100)]
