"""Indices and knots of the embedded universe's galaxies (`catalog: {components: full}`), from config/components.yaml.

The columns n_disk, n_bulge, knots and knots_frac are computed when a catalogue is opened; truth bricks do not have
them. They depend on the galaxy's id and columns, so that the galaxy is the same in all exposures. The spectra of bulge,
disk and knots are those of component_light.
"""

from functools import cache
from typing import Literal

import numpy as np
from pydantic import Field

from csstsim.base.model import Model, validate
from csstsim.base.shipped import SHIPPED
from csstsim.base.types import FloatArray, Floats, PathLike
from csstsim.catalog.profiles.sersic import INDEX_MAX, INDEX_MIN
from csstsim.catalog.table import GALAXY, ObjectTable
from csstsim.instrument.load import read_data

FILE = SHIPPED / "components.yaml"
STAR_FORMING = 0  # gal_type
_STREAM = np.uint64(0x66756C6C5F303031)  # the word "full_001": of no other random number
_STEP = 1 / 32  # of indices, so that galaxies share tables of profiles


class Index(Model):
    """A distribution of Sersic indices."""

    index: float = Field(ge=INDEX_MIN, le=INDEX_MAX)
    slope: float = Field(0.0, description="per decade of the bulge's mass above 1e10 solar masses")
    scatter: float = Field(ge=0)
    least: float = Field(ge=INDEX_MIN, le=INDEX_MAX)
    most: float = Field(ge=INDEX_MIN, le=INDEX_MAX)


class Knots(Model):
    """Numbers of knots, and the maximum fraction of the disk's flux in them."""

    least: int = Field(ge=1)
    most: int = Field(ge=1, le=1000)
    share: float = Field(ge=0, le=1)


class Population(Model):
    """Stars of a component, whose spectrum is that of the universe's templates."""

    formed: list[float] = Field(description="fractions of the mass formed, by age range of star_formation.edges")
    dust: float = Field(ge=0, le=4, description="A_V, mag")
    lines: float = Field(ge=0, description="factor on emission lines")


class Equal(Model):
    """Wavelengths at which a component has the disk's spectrum and its fraction of the table [angstrom, rest frame]."""

    bulge: float = Field(ge=1000, le=10_000)
    knots: float = Field(ge=1000, le=10_000)


class Numbers(Model):
    """The contents of config/components.yaml."""

    bulge_index: Index
    disk_index: Index
    knots: Knots
    populations: dict[Literal["bulge", "disk", "knots"], Population]
    equal: Equal


@cache
def load_numbers(file: PathLike = FILE) -> Numbers:
    """Return the Numbers of config/components.yaml. Raises InputError."""
    return validate(Numbers, read_data(file), file)


def full_components(table: ObjectTable) -> ObjectTable:
    """Return an ObjectTable of the embedded universe with the columns n_disk, n_bulge, knots and knots_frac."""
    from csstsim.base.counter import object_keys

    numbers = load_numbers()
    galaxy = table["obj_type"] == GALAXY
    ids = table["id"].astype(np.int64)
    draws = [(object_keys(_STREAM + np.uint64(k), ids) >> np.uint64(11)) * 2.0**-53 for k in range(4)]
    disk = np.where(galaxy, 1.0 - table["bulge_frac"].astype(float), 0.0)
    knots = numbers.knots
    with np.errstate(divide="ignore", invalid="ignore"):
        decades = np.clip(np.nan_to_num(np.log10(table["bulgemass"].astype(float)) - 10, nan=0.0), -4.0, 3.0)
    forming = galaxy & (table["gal_type"] == STAR_FORMING) & (disk > 0)
    count = knots.least + (draws[2] * (knots.most - knots.least + 1)).astype(np.int32)
    return table.with_columns(
        n_disk=np.where(galaxy, _indices(numbers.disk_index, draws[0]), 1.0).astype(np.float32),
        n_bulge=np.where(galaxy, _indices(numbers.bulge_index, draws[1], decades), 4.0).astype(np.float32),
        knots=np.where(forming, count, 0).astype(np.int32),
        knots_frac=np.where(forming, knots.share * draws[3] * disk, 0.0).astype(np.float32),
    )


def _indices(law: Index, draws: FloatArray, decades: Floats = 0.0) -> FloatArray:
    from scipy.special import ndtri

    n = law.index + law.slope * decades + law.scatter * ndtri(np.clip(draws, 1e-9, 1 - 1e-9))
    return np.clip(np.round(n / _STEP) * _STEP, law.least, law.most)
