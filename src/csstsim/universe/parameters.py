"""The parameters of the embedded universe (config/universe/), read once and identified by a digest.

There is one YAML file per subject, with a source for each number. FITS files have the fitted coefficients of the
spectra. Models are imported where they are built: most stages need only the digest, and the models import numba and
scipy.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, cached_property, partial, reduce
from operator import getitem
from pathlib import Path
from typing import TYPE_CHECKING, Any

from csstsim.base.digest import digest
from csstsim.base.errors import InputError
from csstsim.base.shipped import SHIPPED
from csstsim.instrument.filter import GRID
from csstsim.instrument.load import folder_digest, read_data
from csstsim.universe.dust.dust_map import DustMap

if TYPE_CHECKING:
    from csstsim.base.types import FloatArray, PathLike
    from csstsim.universe.galaxies.galaxy_sed import GalaxySeds
    from csstsim.universe.lensing.cosmology import Cosmology
    from csstsim.universe.lensing.lensing_field import LensingField
    from csstsim.universe.quasars.quasar_sed import QuasarSeds
    from csstsim.universe.stars.star_sed import StarSeds
    from csstsim.universe.structure.matter_field import MatterField

Z_MAX = 20.0  # largest redshift allowed for galaxies
_POSITIVE = (
    "cosmology.h0", "dust.r_v", "dust.sfd_scale", "dust.height", "dust.reach", "dust.optical_depth.per_tau",
    "stars.sun.r0", "galaxies.density", "galaxies.virial", "galaxies.dust.max",
    "galaxies.mass_function.z_max", "lensing.shells", "lensing.stretch_max", "occupation.stellar_to_halo.scatter",
    "occupation.satellites.concentration", "occupation.satellites.dispersion",
)  # fmt: skip
_FRACTIONS = (
    "cosmology.omega_m", "occupation.satellites.axis_ratio", "occupation.surviving.most", "occupation.quenching.most",
)  # fmt: skip
_RISING = ("stars.limits", "quasars.redshift", "quasars.m1450")
PARTS = ("cosmology", "dust", "galaxies", "lensing", "occupation", "quasars", "stars", "structure")


@dataclass(frozen=True, eq=False)
class Universe:
    """The embedded universe: `numbers`, one mapping per file, and the models that they define, built on first use."""

    folder: Path
    numbers: dict[str, Any]

    @cached_property
    def digest(self) -> str:
        """16 hex digits of the folder and of the dust map, which may be stored elsewhere."""
        return digest([folder_digest(self.folder), self.dust.digest])

    @contextmanager
    def faults_of(self, part: str) -> Iterator[None]:
        """Add the file of a part's numbers to an InputError of a model, which does not know the folder."""
        try:
            yield
        except InputError as exc:
            details = {"key": exc.key, "value": exc.value, "allowed": exc.allowed}
            raise InputError(exc.message, file=self.folder / f"{part}.yaml", **details) from None

    @cached_property
    def cosmology(self) -> Cosmology:
        """The universe.lensing.cosmology.Cosmology of cosmology.yaml."""
        from csstsim.universe.lensing.cosmology import Cosmology

        return Cosmology(self.numbers["cosmology"])

    @cached_property
    def dust(self) -> DustMap:
        """The universe.dust.dust_map.DustMap of dust.yaml."""
        return DustMap(self.numbers["dust"], self.folder)

    @property
    def r_v(self) -> float:
        """A(V) / E(B - V) of the Milky Way's dust."""
        return self.numbers["dust"]["r_v"]

    @cached_property
    def extinction(self) -> FloatArray:
        """A(lambda) / A(V) on the paper's grid."""
        return self.dust.curve(GRID)

    @cached_property
    def star_seds(self) -> StarSeds:
        """Spectra of stars (universe.stars.star_sed.StarSeds)."""
        from csstsim.universe.stars.star_sed import StarSeds

        return StarSeds(self.folder / "star_spectra.fits", self.extinction)

    @cached_property
    def galaxy_seds(self) -> GalaxySeds:
        """Spectra of galaxies (universe.galaxies.galaxy_sed.GalaxySeds)."""
        from csstsim.universe.galaxies.galaxy_sed import GalaxySeds

        return GalaxySeds(self.folder / "galaxy_spectra.fits", self.numbers["galaxies"]["igm"], self.extinction)

    @cached_property
    def quasar_seds(self) -> QuasarSeds:
        """Spectra of quasars (universe.quasars.quasar_sed.QuasarSeds)."""
        from csstsim.universe.quasars.quasar_sed import QuasarSeds

        return QuasarSeds(self.numbers["quasars"], self.numbers["galaxies"]["igm"], self.extinction)

    @cache  # noqa: B019 - a universe lives as long as its process
    def lensing_field(self, seed: int) -> LensingField:
        """Return the LensingField of a campaign's seed. Raises InputError."""
        from csstsim.universe.lensing.lensing_field import LensingField

        try:
            return LensingField(seed, self.numbers["cosmology"], self.numbers["lensing"])
        except (KeyError, TypeError, ValueError) as exc:
            raise InputError(
                f"no lensing field: {type(exc).__name__} {exc}", file=self.folder / "lensing.yaml"
            ) from exc

    @cache  # noqa: B019 - as above
    def matter_field(self, seed: int, haloes: bool = True) -> MatterField:
        """Return the structure.matter_field.MatterField of a campaign's seed. Raises InputError."""
        from csstsim.universe.structure.matter_field import MatterField

        try:
            numbers = self.numbers
            return MatterField(seed, numbers["cosmology"], numbers["lensing"], numbers["structure"], haloes)
        except (KeyError, TypeError, ValueError) as exc:
            raise InputError(f"no structure: {type(exc).__name__} {exc}", file=self.folder / "structure.yaml") from exc

    def check(self) -> None:
        """Build the models that the numbers define, without objects. Raises InputError for a bad number."""
        from csstsim.universe.galaxies.galaxies import cumulative_counts, try_laws
        from csstsim.universe.lensing.cosmology import FLATNESS
        from csstsim.universe.stars.stars import galaxy
        from csstsim.universe.structure.matter_field import check_numbers

        for part in PARTS:
            _check_like(self.numbers[part], _shipped(part), self.folder / f"{part}.yaml")
        try:
            check_numbers(self.numbers["lensing"], self.numbers["structure"])
        except ValueError as exc:
            raise InputError(f"no structure: {exc}", file=self.folder / "structure.yaml") from exc
        try:
            for key in _POSITIVE:
                self._refuse_unless(lambda value: 0 < value < math.inf, key, "above 0")
            for key in _RISING:
                self._refuse_unless(lambda value: -math.inf < value[0] < value[1] < math.inf, key, "two rising numbers")
            for key in _FRACTIONS:
                self._refuse_unless(lambda value: 0 < value <= 1, key, "above 0, up to 1")
            flat = 1 - self.numbers["cosmology"]["omega_m"]
            self._refuse_unless(
                lambda value: abs(value - flat) < FLATNESS, "cosmology.omega_lambda", f"1 - omega_m = {flat:g}"
            )
            self._refuse_unless(lambda value: value <= 10, "dust.sfd_scale", "up to 10")
            self._check_laws()
            self._refuse_unless(lambda value: value <= Z_MAX, "galaxies.mass_function.z_max", f"up to {Z_MAX:g}")
            with self.faults_of("stars"):
                galaxy(self.numbers["stars"])
            cumulative_counts(self.numbers["galaxies"])
            try_laws(self.numbers["galaxies"], self.cosmology)
            self.cosmology, self.dust.nside, self.extinction, self.star_seds, self.galaxy_seds, self.quasar_seds  # noqa: B018
        except (KeyError, TypeError, ValueError, IndexError) as exc:
            raise InputError(f"a number is missing or wrong: {type(exc).__name__} {exc}", file=self.folder) from exc
        self._check_lines()

    def _check_laws(self) -> None:
        """Raise InputError for density laws of stars that are not possible."""
        from csstsim.universe.stars.milky_way import LAWS, components

        for component in components(self.numbers["stars"]):
            if component.law not in LAWS:
                raise InputError(
                    f"{component.name} has no such law",
                    file=self.folder / "stars.yaml",
                    key="components",
                    value=component.law,
                    allowed=", ".join(LAWS),
                )
        laws = _shipped("stars")["laws"]
        r0 = self.numbers["stars"]["sun"]["r0"]
        for name, law in laws.items():
            if isinstance(law, list):
                self._refuse_unless(partial(_has_length, len(law)), f"stars.laws.{name}", f"{len(law)} numbers")
        for name in ("young", "disc", "thick"):
            self._refuse_unless(lambda value: min(value) > 0, f"stars.laws.{name}", "lengths above 0 kpc")
        self._refuse_unless(  # densities are normalised at the Sun
            lambda value: value[0] >= r0 and 0 <= value[1] <= 10,
            "stars.laws.flare",
            f"a radius from {r0:g} kpc on, and a growth from 0 to 10 per kpc",
        )

    def _check_lines(self) -> None:
        """Raise InputError if the emission lines of galaxy_spectra.fits are not those of galaxies.yaml."""
        from astropy.io import fits

        header = fits.getheader(self.folder / "galaxy_spectra.fits")
        for name, card in (("dust", "LINEDUST"), ("strength", "LINES")):
            value = self.numbers["galaxies"]["lines"][name]
            built = header.get(card)
            if built is not None and value != built:
                raise InputError(
                    "galaxy_spectra.fits has other lines; build it again (builders/build_galaxy_spectra.py)",
                    file=self.folder / "galaxies.yaml",
                    key=f"lines.{name}",
                    value=value,
                    allowed=f"{built}",
                )

    def _refuse_unless(self, accepts: Callable[[Any], bool], key: str, allowed: str) -> None:
        part, _, path = key.partition(".")
        value = reduce(getitem, path.split("."), self.numbers[part])
        if not accepts(value):
            raise InputError("impossible", file=self.folder / f"{part}.yaml", key=path, value=value, allowed=allowed)


@cache
def _shipped(part: str) -> dict[str, Any]:
    return read_data(SHIPPED / "universe" / f"{part}.yaml")


def _check_like(numbers: Any, shipped: Any, file: Path, key: str = "") -> None:
    """Raise InputError if `numbers` lacks a key of the shipped ones, or a finite number where they have one."""
    if isinstance(shipped, dict):
        if not isinstance(numbers, dict):
            raise InputError("must be a mapping", file=file, key=key, value=numbers, allowed=", ".join(shipped))
        for name, value in shipped.items():
            inner = f"{key}.{name}" if key else name
            if name not in numbers:
                raise InputError("missing", file=file, key=inner)
            _check_like(numbers[name], value, file, inner)
    elif isinstance(shipped, list) and isinstance(
        numbers, list
    ):  # further items are compared with the last shipped one
        for k, value in enumerate(numbers if shipped else []):
            _check_like(value, shipped[min(k, len(shipped) - 1)], file, f"{key}[{k}]")
    elif isinstance(shipped, list):
        raise InputError("must be a list", file=file, key=key, value=numbers, allowed=f"such as {shipped}")
    elif _number(shipped) and not _number(numbers):
        raise InputError("must be a number", file=file, key=key, value=numbers, allowed=f"such as {shipped}")


def _has_length(count: int, value: object) -> bool:
    return isinstance(value, list) and len(value) == count


def _number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def load_universe(folder: PathLike = SHIPPED / "universe") -> Universe:
    """Read the parameters of a universe.

    Parameters
    ----------
    folder : str or Path
        A folder with the files of config/universe/, by default those of csstsim.

    Returns
    -------
    Universe
        The parameters, and the models that they define, such as `dust` and `cosmology`.

    Raises
    ------
    InputError
        If a file is missing or unreadable, or a number has no source.
    """
    folder = Path(folder)
    return Universe(folder, {name: read_data(folder / f"{name}.yaml") for name in PARTS})
