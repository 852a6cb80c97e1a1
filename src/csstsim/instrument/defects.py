"""Numbers of the defective pixels and columns: config/instrument/defects.yaml, checked."""

from dataclasses import dataclass, fields

from csstsim.base.errors import InputError
from csstsim.instrument.load import build, read_sections


@dataclass(frozen=True)
class Defects:
    """Units in config/instrument/defects.yaml."""

    defective: float
    hot_share: float
    dead_max: float
    dead_noise: float
    hot_shape: float
    hot_scale: float
    hot_time: float
    hot_min: float
    columns_min: int
    columns_max: int
    columns_from: float
    columns_to: float
    length_min: float
    length_max: float
    low_factor: float
    low_offset: float
    high_factor: float
    high_offset: float
    column_noise: float


def load_defects(path):
    """Return Defects, or None if there is no such file. Raises InputError."""
    if not path.exists():
        return None
    found = build(Defects, read_sections(path), path)
    limits = dict.fromkeys((field.name for field in fields(found)), (0, 1e6)) | {
        "defective": (0, 0.1), "hot_share": (0, 1), "dead_max": (0, 1), "hot_shape": (1e-3, 1e3),
        "hot_time": (1e-3, 1e5), "columns_to": (found.columns_from, 1), "length_max": (found.length_min, 1),
        "columns_max": (found.columns_min, 1000), "low_factor": (0, found.high_factor),
        "low_offset": (0, found.high_offset), "column_noise": (1, 100),
    }  # fmt: skip
    for name, (low, high) in limits.items():
        if not low <= (value := getattr(found, name)) <= high:
            raise InputError("out of range", file=path, key=name, value=value, allowed=f"{low:g} to {high:g}")
    return found
