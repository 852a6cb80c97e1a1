"""Campaign files as typed models.

These models and those of `sections` are the only source of keys, types, defaults and descriptions: config/README.md and
config/schema/ are generated from them. Paths are relative to the folder of the campaign file. null for `instrument`,
`universe` or an observation is the one shipped in config/.
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
from csstsim.campaign.variants import split_name, variant_data, variant_file
from csstsim.instrument.pointing import ExposureType
from csstsim.io.level0_names import FORMS
from csstsim.io.level0_names import NEWEST as NEWEST_NAMES

# {version of the layout of campaign files: how to change a file of the previous version}
LAYOUTS = {1: "give schema_version: 1, and the keys of config/README.md"}
NEWEST = max(LAYOUTS)


def check_layout(version: int) -> int:
    """Return a campaign file's schema_version. Raises ValueError, with what to change, for another layout."""
    if 0 <= version < NEWEST:
        steps = "; ".join(LAYOUTS[number] for number in range(version + 1, NEWEST + 1))
        raise ValueError(f"an older layout than this csstsim reads, {NEWEST}; to change: {steps}")
    if version != NEWEST:
        raise ValueError(f"this csstsim reads layout {NEWEST}; a newer file needs a newer csstsim")
    return version


class Campaign(Model):
    """A campaign: everything that determines the products, and nothing about the machine."""

    schema_version: int = Field(description=f"{NEWEST}. Version of the layout of this file.")
    name: str = Field(
        pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$",
        description="Letters, digits, `_`, `.` and `-`. Short name of the campaign, written to headers.",
    )
    survey_table: FilePath = Field(
        description="CSV file. Survey table: one pointing of the telescope per row (survey_tables/README.md)."
    )
    output: FilePath = Field(description="Folder. All products of the campaign are written to it.")
    seed: int = Field(
        ge=0,
        le=2**63 - 1,
        description="0 to 2^63 - 1. Random seed of sky, detector and noise. Equal seeds give equal products.",
    )
    select: Select = Field(default_factory=Select)
    window: PixelWindow | Literal["region"] | None = Field(
        None,
        description="null, 'region', or {x0, x1, y0, y1}. Pixels to simulate: full chips; the pixels around "
        "select.region; or the same rectangle on every chip. A window has the objects and the detector of the full "
        "chip, but different noise.",
    )
    observations: dict[ExposureType, FilePath] = Field(
        {},
        description="Mapping {SCIE, BIAS, DARK or FLAT: file}. Observation file, the list of layers, of each exposure "
        "type. Types that are not given use the files in config/observations/.",
    )
    instrument: FilePath | dict[str, Any] | None = Field(
        None,
        description="Folder, mapping, or null. Data files of the camera; null: config/instrument/. A mapping changes "
        "single camera parameters, such as {detector.read_noise: 20}; its key `folder` names the data files, if they "
        "are not the shipped ones.",
    )
    universe: FilePath | None = Field(
        None, description="Folder, or null. Data files of the embedded universe; null: config/universe/."
    )
    catalog: CatalogConfig = Field(default_factory=CatalogConfig)
    astrometry: AstrometryConfig = Field(default_factory=AstrometryConfig)
    psf: PsfConfig = Field(default_factory=PsfConfig)
    fidelity: Literal["preview", "standard", "noise_free", "reference"] = Field(
        "standard",
        description="preview, standard, noise_free or reference. Accuracy of rendered objects (config/render.yaml). "
        "'standard': errors up to a tenth of each object's own noise. 'preview': errors up to that noise. "
        "'noise_free': as standard, but the image has expected electrons without photon noise. 'reference': GalSim "
        "renders each object, which takes 0.1 CPU-seconds per object.",
    )
    share: FilePath | None = Field(
        None,
        description="Folder on the file system of `output`, or null. Truth bricks and PSF sets that several campaigns "
        "use. The first campaign makes each of them; all campaigns link them into their output. null: nothing is "
        "shared.",
    )
    keep: Literal["nothing", "light"] = Field(
        "nothing",
        description="nothing or light. Intermediate products to keep. 'light': the rendered electrons of each chip "
        "(0.4 GB for a full chip), so that a change of the detector repeats the readout but not the rendering. It "
        "needs --config chips=stages, the default.",
    )
    level0_names: Literal[tuple(FORMS)] = Field(  # type: ignore[valid-type]  # pydantic reads it
        NEWEST_NAMES,
        description="C9, C5.2, C5.1 or C3. Naming scheme of Level-0 files: that of Cycle 9 and W1, or those of earlier "
        "mock data, for programs that expect them.",
    )
    truth: tuple[Literal["parquet", "cat"], ...] = Field(
        ("parquet",),
        description="[parquet] or [parquet, cat]. Formats of the truth table that accompanies each Level-0 file. "
        "'parquet' is needed by later stages. 'cat' is text with the 33 columns of the Cycle-9 mock data "
        "(docs/recreate.md).",
    )
    measurement: MeasurementConfig = Field(default_factory=MeasurementConfig)
    validation: ValidateConfig = Field(default_factory=ValidateConfig)
    variants: dict[str, dict[str, Any]] = Field(
        {},
        description="Mapping {name: {keys that differ}}. Variants of this campaign, simulated together with it. Their "
        "products are in variants/NAME of the output folder; equal products are shared. On the command line a variant "
        "is FILE@NAME (docs/variants.md).",
    )

    @field_validator("variants")
    @classmethod
    def _names_are_valid(cls, value: dict[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
        for name in value:
            if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name):
                raise ValueError(f"{name}: a name has letters, digits and _, and begins with a letter")
        return value

    @field_validator("truth")
    @classmethod
    def _has_parquet(cls, value: tuple[str, ...]) -> tuple[str, ...]:
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
        """Return 16 hex digits of the keys that determine pixels: without selection, folders and thresholds."""
        return digest(self.model_dump(mode="json", include={"seed", "catalog", "astrometry", "psf", "fidelity"}))


@explained("campaign")
def load_campaign(path: PathLike) -> Campaign:
    """Read and check a campaign file; make its paths relative to its folder. Raises InputError.

    psf.library, measurement.masters and a catalogue's options stay as they are written, because they are part of
    recipes: relative_to_file is applied when they are used. path: FILE@NAME for a variant, with the output folder of
    its base. The variants of a base are checked with it.
    """
    base, variant = split_name(path)
    file = Path(path)
    if base.is_dir():
        campaigns = sorted(str(one) for one in base.glob("*.yaml"))[:3]
        raise InputError("is a folder", file=base, allowed=", ".join(campaigns) or "the file of a campaign")
    data = read_yaml(base)
    config = make_campaign(data if variant is None else variant_data(data, variant, base), path)
    _check_variants(config, data, file)
    instrument = config.instrument
    if isinstance(instrument, dict) and instrument.get("folder"):
        instrument = instrument | {"folder": relative_to_file(file, instrument["folder"])}
    elif isinstance(instrument, Path):
        instrument = relative_to_file(file, instrument)
    return config.model_copy(
        update={
            "survey_table": _input_file(file, config.survey_table),
            "output": relative_to_file(file, config.output),
            "observations": {kind: _input_file(file, path) for kind, path in config.observations.items()},
            "instrument": instrument,
            "universe": config.universe and relative_to_file(file, config.universe),
            "share": config.share and relative_to_file(file, config.share),
        }
    )


def _check_variants(config: Campaign, data: dict[str, Any], file: Path) -> None:
    """Raise InputError unless each variant of a base is a valid campaign that differs from the base and the others."""
    names = {_content(config): "the base"}
    for name in config.variants:
        content = _content(make_campaign(variant_data(data, name, file), variant_file(file, name)))
        if content in names:
            message = f"equal to {names[content]}"
            raise InputError(message, file=file, key=f"variants.{name}", value=config.variants[name])
        names[content] = f"the variant {name}"


def _content(config: Campaign) -> str:
    return config.model_dump_json(exclude={"variants"})


def _input_file(file: Path, path: Path) -> Path:
    """Return relative_to_file. Raises InputError for a file that exists only relative to the current directory."""
    relative = relative_to_file(file, path)
    if not relative.exists() and path.exists():
        raise InputError(
            f"no file {relative}, but {path} is in the current directory",
            file=file,
            key="paths",
            value=path,
            allowed="paths relative to the folder of the campaign file",
        )
    return relative


def make_campaign(data: dict[Any, Any], path: PathLike) -> Campaign:
    """Return the Campaign of a mapping; errors name `path`. Raises InputError."""
    campaign = validate(Campaign, data, path)
    if campaign.window == "region" and campaign.select.region is None:
        raise InputError("'region' needs select.region", file=path, key="window", value="region")
    return campaign
