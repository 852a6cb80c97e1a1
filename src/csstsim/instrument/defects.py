"""Numbers of the defective pixels and columns: config/instrument/defects.yaml."""

from dataclasses import dataclass
from typing import Annotated

from csstsim.base.model import Data, Whole, at_least, between


@dataclass(frozen=True)
class Defects(Data):
    """Numbers of defects.yaml, which explains them and gives their units."""

    defective: between(0, 0.1)
    hot_share: between(0, 1)
    dead_max: between(0, 1)
    dead_noise: between(0, 1e6)
    hot_shape: between(1e-3, 1e3)
    hot_scale: between(0, 1e6)
    hot_time: between(1e-3, 1e5)
    hot_min: between(0, 1e6)
    columns_min: between(0, 1000, Whole)
    columns_max: Annotated[between(0, 1000, Whole), at_least("columns_min")]
    columns_from: between(0, 1)
    columns_to: Annotated[between(0, 1), at_least("columns_from")]
    length_min: between(0, 1)
    length_max: Annotated[between(0, 1), at_least("length_min")]
    low_factor: between(0, 1e6)
    low_offset: between(0, 1e6)
    high_factor: Annotated[between(0, 1e6), at_least("low_factor")]
    high_offset: Annotated[between(0, 1e6), at_least("low_offset")]
    column_noise: between(1, 100)
