"""A coarse field of matter with few haloes, for tests: thick shells, heavy haloes, wide kernels."""

from functools import cache

from csstsim.base.shipped import SHIPPED
from csstsim.instrument.load import read_data
from csstsim.universe.structure.matter_field import MatterField

COSMOLOGY, LENSING, NUMBERS = (
    read_data(SHIPPED / "universe" / f"{name}.yaml") for name in ("cosmology", "lensing", "structure")
)
COARSE = LENSING | {"l_max": 3000}
FEW = NUMBERS | {
    "shells": {"thickness": 600, "z_end": 4.0}, "galaxy_scale": 4.0,
    "haloes": NUMBERS["haloes"] | {"tiers": [1e13, 1e14, 5e15], "lens_mass": 1e13, "z_min": 0.1, "z_max": 2.0,
                                   "placement": [0.7, 0.7], "compensation": {"mass": [1e13], "ratio": [2.0]}},
}  # fmt: skip


@cache
def coarse(seed=5, haloes=True):
    """Return the coarse MatterField of a seed, made once."""
    return MatterField(seed, COSMOLOGY, COARSE, FEW, haloes)


@cache
def shipped(haloes=True):
    """Return the MatterField of the shipped numbers, made once."""
    return MatterField(5, COSMOLOGY, LENSING, NUMBERS, haloes)
