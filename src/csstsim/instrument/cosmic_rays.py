"""Numbers of the cosmic rays: config/instrument/cosmic_rays.yaml, checked."""

from dataclasses import dataclass, fields

from csstsim.base.errors import InputError
from csstsim.instrument.load import build, read_sections


@dataclass(frozen=True)
class CosmicRays:
    """Units in config/instrument/cosmic_rays.yaml."""

    rate: float
    short_max: float
    long_share: float
    long_max: float
    log_energy: float
    log_energy_fwhm: float
    diffusion: float
    marked_from: int


def load_cosmic_rays(path):
    """Return CosmicRays, or None if there is no such file. Raises InputError."""
    if not path.exists():
        return None
    rays = build(CosmicRays, read_sections(path), path)
    limits = dict.fromkeys((field.name for field in fields(rays)), (0, 1e4)) | {
        "rate": (0, 1e-3), "long_share": (0, 1), "log_energy": (0, 7), "log_energy_fwhm": (0, 3), "diffusion": (0, 10),
        "marked_from": (1, 1e6), "long_max": (rays.short_max, 1e4),
    }  # fmt: skip
    for name, (low, high) in limits.items():
        if not low <= (value := getattr(rays, name)) <= high:
            raise InputError("out of range", file=path, key=name, value=value, allowed=f"{low:g} to {high:g}")
    return rays
