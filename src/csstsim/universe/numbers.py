"""The numbers of the embedded universe (config/universe.yaml), read once and named by a digest."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from csstsim.config import digest
from csstsim.errors import InputError
from csstsim.instrument.load import read_data
from csstsim.universe.galaxy_sed import GalaxySeds
from csstsim.universe.star_sed import StarSeds


@dataclass(frozen=True, eq=False)
class Universe:
    """The numbers of the embedded universe: two mappings, as in the file, and the spectra they define."""

    galaxies: dict
    stars: dict
    file: Path
    digest: str

    @cached_property
    def galaxy_seds(self):
        return GalaxySeds(self.galaxies)

    @cached_property
    def star_seds(self):
        return StarSeds(self.stars["spectrum"])


def load_universe(path):
    """Read a universe file. Raises InputError for an unreadable file, a missing section or a number without source."""
    data = read_data(path)
    for name in ("galaxies", "stars"):
        if not isinstance(data.get(name), dict):
            raise InputError("required section is missing", file=path, key=name)
    universe = Universe(data["galaxies"], data["stars"], Path(path), digest(data))
    try:
        universe.galaxy_seds, universe.star_seds  # noqa: B018 - a fault in the templates shows here, not in a brick
    except (KeyError, TypeError, ValueError, IndexError) as exc:
        raise InputError(f"the spectra cannot be built: {type(exc).__name__} {exc}", file=path) from exc
    return universe
