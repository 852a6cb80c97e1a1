"""Campaign files as typed models.

The models, with those of `sections`, are the only source of keys, types, defaults and their description;
config/README.md and config/schema/ are generated from them. Paths are relative to the folder of the campaign file;
null for `instrument`, `universe` or an observation means the one shipped in config/.
"""

import re
from pathlib import Path
from typing import Any, Literal, cast

from pydantic import Field, field_validator

from csstsim.base.digest import digest
from csstsim.base.errors import InputError
from csstsim.base.files.relative_to_file import relative_to_file
from csstsim.base.files.yaml_file import read_yaml
from csstsim.base.help_page import explained
from csstsim.base.model import FilePath, Model, validate
from csstsim.base.shipped import SHIPPED
from csstsim.base.types import PathLike
from csstsim.campaign.sections import AstrometryConfig, CatalogConfig, MeasurementConfig, PixelWindow, PsfConfig, Select
from csstsim.campaign.thresholds import ValidateConfig
from csstsim.campaign.variants import changed, named, split
from csstsim.instrument.pointing import ExposureType
from csstsim.io.level0_names import FORMS
from csstsim.io.level0_names import NEWEST as NEWEST_NAMES

# {layout of campaign files: how to change a file of the layout before it}
LAYOUTS = {1: "give schema_version: 1, and the keys of config/README.md"}
NEWEST = max(LAYOUTS)


def check_layout(version: int) -> int:
    """Return a campaign file's schema_version. Raises ValueError, which says what to change, for another layout."""
    if 0 <= version < NEWEST:
        steps = "; ".join(LAYOUTS[number] for number in range(version + 1, NEWEST + 1))
        raise ValueError(f"an older layout than this csstsim reads, {NEWEST}; to change: {steps}")
    if version != NEWEST:
        raise ValueError(f"this csstsim reads layout {NEWEST}; a newer file needs a newer csstsim")
    return version


class Campaign(Model):
    """The campaign: everything that decides the products, and nothing about the machine."""

    schema_version: int = Field(description=f"version of this file's layout: {NEWEST}")
    name: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$", description="short name, used in headers")
    survey_table: FilePath = Field(description="pointing table (CSV, survey_tables/README.md)")
    output: FilePath = Field(description="folder that receives everything the campaign makes")
    seed: int = Field(ge=0, le=2**63 - 1, description="the only source of randomness")
    select: Select = Field(default_factory=Select)
    window: PixelWindow | Literal["region"] | None = Field(
        None,
        description="null = whole chips; 'region' = the pixels around select.region; or x0, x1, y0, y1. A window has "
        "the light and the detector of the whole chip, but noise of its own",
    )
    observations: dict[ExposureType, FilePath] = Field(
        {}, description="file of layers for each exposure type; types left out use config/observations/"
    )
    instrument: FilePath | dict[str, Any] | None = Field(
        None,
        description="folder with the camera's data files; null = config/instrument/. Or numbers of it to change, as "
        "{detector.read_noise: 20}, and `folder` if it is not that one",
    )
    universe: FilePath | None = Field(None, description="folder of the embedded universe; null = config/universe/")
    catalog: CatalogConfig = Field(default_factory=CatalogConfig)
    astrometry: AstrometryConfig = Field(default_factory=AstrometryConfig)
    psf: PsfConfig = Field(default_factory=PsfConfig)
    fidelity: Literal["preview", "standard", "noise_free", "reference"] = Field(
        "standard",
        description="accuracy of drawn objects (config/render.yaml): 'standard', errors up to a tenth of each object's "
        "own noise; 'preview', up to all of it; 'noise_free', as 'standard', but all light is expected light without "
        "photon noise; 'reference', one by one with GalSim, 0.1 CPU-seconds an object",
    )
    share: FilePath | None = Field(
        None,
        description="folder of truth bricks and PSF sets that several campaigns need: each is made once, by the first "
        "of them, and linked into the output of all; on the file system of `output`; null = each makes its own",
    )
    keep: Literal["nothing", "light"] = Field(
        "nothing",
        description="'light': keep the rendered light of each chip (0.4 GB for a whole one), so that a change of the "
        "detector reruns the readout but not render; only with --config chips=stages",
    )
    level0_names: Literal[tuple(FORMS)] = Field(  # type: ignore[valid-type]  # pydantic reads it
        NEWEST_NAMES,
        description="form of the names of Level-0 files: 'C9', that of Cycle 9 and W1; 'C5.2', 'C5.1' or 'C3', those "
        "of older mocks, for programs that look for them",
    )
    truth: tuple[Literal["parquet", "cat"], ...] = Field(
        ("parquet",),
        description="forms of the truth table beside each Level-0 file: 'parquet', which later stages need, and 'cat', "
        "text with the 33 columns of the Cycle-9 mocks (docs/recreate.md)",
    )
    measurement: MeasurementConfig = Field(default_factory=MeasurementConfig)
    validation: ValidateConfig = Field(default_factory=ValidateConfig)
    variants: dict[str, dict[str, Any]] = Field(
        {},
        description="{name: {keys that differ}}: campaigns that are made with this one, in variants/name of its output "
        "folder, and share with it what is equal; csstsim's commands know them as FILE@name (docs/variants.md)",
    )

    @field_validator("variants")
    @classmethod
    def _names_of_folders(cls, value: dict[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
        for name in value:
            if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name):
                raise ValueError(f"{name}: a name has letters, digits and _, and begins with a letter")
        return value

    @field_validator("truth")
    @classmethod
    def _parquet_is_there(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        if "parquet" not in value or len(set(value)) < len(value):
            raise ValueError("must be [parquet] or [parquet, cat]")
        return value

    _layout = field_validator("schema_version")(check_layout)

    def observation_file(self, exposure_type: str) -> Path:
        """Return the path of the layer list for 'SCIE', 'BIAS', 'DARK' or 'FLAT'."""
        names = {"SCIE": "science", "BIAS": "bias", "DARK": "dark", "FLAT": "led_flat"}
        return self.observations.get(
            cast(ExposureType, exposure_type), SHIPPED / "observations" / f"{names[exposure_type]}.yaml"
        )

    @property
    def universe_folder(self) -> Path:
        """The universe folder: the campaign's, or the shipped one."""
        return self.universe or SHIPPED / "universe"

    def digest(self) -> str:
        """Return 16 hex digits of what decides a chip's pixels: not which chips run, not folders, not thresholds."""
        return digest(self.model_dump(mode="json", include={"seed", "catalog", "astrometry", "psf", "fidelity"}))


@explained("campaign")
def load_campaign(path: PathLike) -> Campaign:
    """Read and check a campaign file; its files and folders are found beside it. Raises InputError.

    psf.library, measurement.masters and a catalogue's options stay as they are written, for they are part of recipes:
    `beside` finds them when they are used. path: FILE@NAME for a variant; its output folder is the base's here. The
    variants of a base are checked with it.
    """
    (base, variant), file = split(path), Path(path)
    if Path(base).is_dir():
        here = ", ".join(sorted(str(one) for one in Path(base).glob("*.yaml"))[:3]) or "the file of a campaign"
        raise InputError("is a folder", file=base, allowed=here)
    data = read_yaml(base)
    config = make_campaign(data if variant is None else changed(data, variant, base), path)
    _check_variants(config, data, file)
    instrument = config.instrument
    if isinstance(instrument, dict) and instrument.get("folder"):
        instrument = instrument | {"folder": relative_to_file(file, instrument["folder"])}
    elif isinstance(instrument, Path):
        instrument = relative_to_file(file, instrument)
    return config.model_copy(
        update={
            "survey_table": _there(file, config.survey_table),
            "output": relative_to_file(file, config.output),
            "observations": {kind: _there(file, path) for kind, path in config.observations.items()},
            "instrument": instrument,
            "universe": config.universe and relative_to_file(file, config.universe),
            "share": config.share and relative_to_file(file, config.share),
        }
    )


def _check_variants(config: Campaign, data: dict[str, Any], file: Path) -> None:
    """Each variant of a base is a campaign, and none is equal to another."""
    seen = {_what(config): "the base"}
    for name in config.variants:
        what = _what(make_campaign(changed(data, name, file), named(file, name)))
        if what in seen:
            raise InputError(f"equal to {seen[what]}", file=file, key=f"variants.{name}", value=config.variants[name])
        seen[what] = f"the variant {name}"


def _what(config: Campaign) -> str:
    return config.model_dump_json(exclude={"variants"})


def _there(file: Path, path: Path) -> Path:
    """Return `beside`; the error of a file that is only found from the current directory says so."""
    found = relative_to_file(file, path)
    if not found.exists() and path.exists():
        raise InputError(
            f"no file {found}, but {path} is in the current directory",
            file=file,
            key="paths",
            value=path,
            allowed="paths relative to the folder of the campaign file",
        )
    return found


def make_campaign(data: dict[Any, Any], path: PathLike) -> Campaign:
    """Return the Campaign of a mapping; errors name `path`. Raises InputError."""
    campaign = validate(Campaign, data, path)
    if campaign.window == "region" and campaign.select.region is None:
        raise InputError("'region' needs select.region", file=path, key="window", value="region")
    return campaign
