"""The numbers of the embedded universe (config/universe/), read once and named by a digest.

One YAML file a subject (stars, galaxies, quasars, lensing, dust, cosmology), each number with its source, and the
fitted coefficients of the spectra beside them as FITS.
"""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from csstsim.errors import InputError
from csstsim.instrument.load import folder_digest, read_data
from csstsim.universe.galaxy_sed import GalaxySeds
from csstsim.universe.lensing_field import LensingField
from csstsim.universe.star_sed import StarSeds

PARTS = ("cosmology", "galaxies", "lensing", "stars")


@dataclass(frozen=True, eq=False)
class Universe:
    """The embedded universe's numbers: one mapping a file, as there, and the spectra they define."""

    folder: Path
    digest: str
    cosmology: dict
    galaxies: dict
    lensing: dict
    stars: dict

    @cached_property
    def galaxy_seds(self):
        return GalaxySeds(self.galaxies)

    @cached_property
    def star_seds(self):
        return StarSeds(self.stars["spectrum"])

    def lensing_field(self, seed):
        """Return the LensingField of a campaign seed, set up once. Raises InputError."""
        fields = self.__dict__.setdefault("_lensing_fields", {})
        if seed not in fields:
            try:
                fields[seed] = LensingField(seed, self.cosmology, self.lensing)
            except (KeyError, TypeError, ValueError) as exc:
                raise InputError(f"no lensing field: {type(exc).__name__} {exc}", file=self.folder) from exc
        return fields[seed]


def load_universe(folder):
    """Read a universe folder. Raises InputError for a missing or unreadable file or a number without source."""
    folder = Path(folder)
    parts = {name: read_data(folder / f"{name}.yaml") for name in PARTS}
    universe = Universe(folder, folder_digest(folder), **parts)
    try:
        universe.galaxy_seds, universe.star_seds  # noqa: B018 - a fault in the templates shows here, not in a brick
    except (KeyError, TypeError, ValueError, IndexError) as exc:
        raise InputError(f"the spectra cannot be built: {type(exc).__name__} {exc}", file=folder) from exc
    return universe
