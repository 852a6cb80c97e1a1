"""Campaign files as typed models.

The models are the only source of keys, types, defaults and their description; config/README.md and
config/schema/ are generated from them. Paths in a campaign file are relative to that file's folder;
null for `instrument`, `universe` or an observation means the one shipped in config/.
"""

import math
import re
from pathlib import Path
from typing import Any, Literal

from pydantic import ConfigDict, Field, field_validator, model_validator

from csstsim.base.digest import digest
from csstsim.base.errors import InputError
from csstsim.base.files.beside import beside
from csstsim.base.files.yaml_file import read_yaml
from csstsim.base.help_page import explained
from csstsim.base.model import FilePath, Model, validate
from csstsim.base.shipped import SHIPPED
from csstsim.campaign.thresholds import ValidateConfig
from csstsim.campaign.variants import changed, named, split
from csstsim.instrument.pointing import ExposureType
from csstsim.io.level0_names import FORMS
from csstsim.io.level0_names import NEWEST as NEWEST_NAMES
from csstsim.universe.changing.numbers import KINDS

# {layout of campaign files: how to change a file of the layout before it}
LAYOUTS = {1: "give schema_version: 1, and the keys of config/README.md"}
NEWEST = max(LAYOUTS)

CHIP_GROUPS = ("all", "imaging", "slitless")


def check_layout(version):
    """Return a campaign file's schema_version. Raises ValueError, which says what to change, for another layout."""
    if 0 <= version < NEWEST:
        steps = "; ".join(LAYOUTS[number] for number in range(version + 1, NEWEST + 1))
        raise ValueError(f"an older layout than this csstsim reads, {NEWEST}; to change: {steps}")
    if version != NEWEST:
        raise ValueError(f"this csstsim reads layout {NEWEST}; a newer file needs a newer csstsim")
    return version


class Region(Model):
    """A circle on the sky."""

    ra: float = Field(ge=0, lt=360, description="centre, right ascension [deg, ICRS]")
    dec: float = Field(ge=-90, le=90, description="centre, declination [deg, ICRS]")
    radius: float = Field(gt=0, le=120, description="radius in the tangent plane [arcmin]")


class Select(Model):
    """Which (exposure, chip) pairs of the survey table to run."""

    model_config = ConfigDict(coerce_numbers_to_str=True)  # an obsid need not be quoted

    types: tuple[ExposureType, ...] = Field(("SCIE", "BIAS", "DARK", "FLAT"), description="exposure types")
    obsids: tuple[str, ...] | None = Field(None, description="only these exposures; null = all")
    chips: str | tuple[int, ...] = Field("imaging", description="all, imaging, slitless, or a list of chip numbers")
    filters: tuple[str, ...] | None = Field(None, description="only chips behind these filters; null = all")
    region: Region | None = Field(
        None, description="only pairs whose chip (or its window) touches this circle; null = all"
    )

    @field_validator("chips")
    @classmethod
    def _known_chips(cls, value):
        good = value in CHIP_GROUPS if isinstance(value, str) else value and min(value) >= 1
        if not good:
            raise ValueError(f"must be {', '.join(CHIP_GROUPS)} or a list of chip numbers")
        return value


class PixelWindow(Model):
    """A rectangle of active pixels, the same on every chip: x0 <= x < x1, y0 <= y < y1."""

    x0: int = Field(ge=0, description="first column")
    x1: int = Field(gt=0, description="one past the last column")
    y0: int = Field(ge=0, description="first row")
    y1: int = Field(gt=0, description="one past the last row")

    @field_validator("x1", "y1")
    @classmethod
    def _not_empty(cls, value, info):
        low = info.data.get(info.field_name[0] + "0")
        if low is not None and value <= low:
            raise ValueError(f"must exceed {info.field_name[0]}0 = {low}")
        return value


class Lensing(Model):
    """Weak lensing of the embedded universe's galaxies (east, north axes)."""

    field: Literal["none", "constant", "cosmic"] = Field(
        "cosmic",
        description="'none'; 'constant': kappa, gamma1 and gamma2 are those of every galaxy; 'cosmic': a random field "
        "with the power spectrum of matter (config/universe/lensing.yaml)",
    )
    kappa: float = Field(0.0, lt=1, allow_inf_nan=False, description="constant convergence, below 1")
    gamma1: float = Field(0.0, allow_inf_nan=False, description="constant shear along +RA")
    gamma2: float = Field(0.0, allow_inf_nan=False, description="constant shear at 45 deg, from +RA towards north")

    @model_validator(mode="after")
    def _weak_and_used(self):
        if self.field != "constant" and (self.kappa, self.gamma1, self.gamma2) != (0.0, 0.0, 0.0):
            raise ValueError(f"kappa, gamma1 and gamma2 need field: constant, not {self.field}")
        if math.hypot(self.gamma1, self.gamma2) >= 1 - self.kappa:
            raise ValueError("strong lensing: the reduced shear |gamma| / (1 - kappa) must be below 1")
        return self


class CatalogConfig(Model):
    """The True Universe: the embedded mock, or a user's CatalogBase by dotted path."""

    kind: str = Field("embedded", description="'embedded', or module.path:ClassName of a CatalogBase of your own")
    mag_limit: float | None = Field(
        None, gt=0, description="faintest AB magnitude drawn, in the chip's own band; null = the whole truth"
    )
    lensing: Lensing = Field(
        default_factory=Lensing,
        description="weak lensing of the embedded universe; a catalogue of your own has columns for it",
    )
    structure: Literal["haloes", "field", "none"] = Field(
        "haloes",
        description="where the embedded universe's galaxies are: 'haloes', in haloes of dark matter, which lens, too; "
        "'field', they follow a smooth density; 'none', anywhere, under a lensing field that knows nothing of them",
    )
    bright_stars: bool | None = Field(
        None, description="the real stars V < 5 (config/instrument/sky.yaml) are objects of the embedded universe; "
        "null = they are, false = no star is as bright",
    )  # fmt: skip
    components: Literal["simple", "full"] = Field(
        "simple",
        description="profiles of the embedded universe's galaxies: 'simple', disks of Sersic index 1 and bulges of 4; "
        "'full', indices that scatter and rise with a bulge's mass, knots, and spectra of each component "
        "(config/components.yaml)",
    )
    variable_stars: bool = Field(
        False, description="true: stars of the embedded universe vary (config/changing/variable_stars.yaml)"
    )
    variable_quasars: bool = Field(
        False, description="true: its quasars vary, by a damped random walk (config/changing/variable_quasars.yaml)"
    )
    asteroids: bool = Field(
        False, description="true: asteroids of the main belt move over the embedded sky on orbits of their own, those "
        "brighter than V = 24.5 (config/changing/asteroids.yaml); a chip takes one to three CPU-seconds more",
    )  # fmt: skip
    satellites: bool = Field(
        False, description="true: satellites cross the exposures over the embedded sky, as often as those of Hubble "
        "(config/changing/satellites.yaml)",
    )  # fmt: skip
    shapes: Literal["normal", "rotated90"] = Field(
        "normal",
        description="'rotated90': select turns intrinsic ellipticities by 90 degrees and changes nothing else, nor the "
        "truth bricks: the paper's twin campaign, which cancels shape noise",
    )
    options: dict[str, Any] = Field({}, description="passed on to a catalogue of your own")

    @property
    def changing(self):
        """The names of the keys, of those for what moves and varies on the embedded sky, that are true."""
        return tuple(kind for kind in KINDS if getattr(self, kind))

    @model_validator(mode="after")
    def _lensing_has_an_object(self):
        if self.kind != "embedded" and self.lensing.field == "constant":
            raise ValueError("lensing is for the embedded universe: give kappa, gamma1, gamma2 in your own catalogue")
        if self.kind != "embedded" and self.structure != "haloes":
            raise ValueError("structure is for the embedded universe: galaxies of your own catalogue are where it says")
        if self.kind != "embedded" and self.bright_stars:
            raise ValueError("bright_stars is for the embedded universe: give them in your own catalogue")
        if self.kind != "embedded" and self.components != "simple":
            raise ValueError("components is for the embedded universe: your own catalogue has columns for them")
        if self.kind != "embedded" and self.changing:
            name = self.changing[0]
            raise ValueError(
                f"{name} is for the embedded universe: a catalogue of your own has columns for what changes"
            )
        if self.kind == "embedded" and self.options:
            raise ValueError("the embedded universe takes no options: they are for a catalogue of your own")
        return self


class AstrometryConfig(Model):
    """How apparent directions at the spacecraft are computed."""

    ephemeris: Literal["builtin", "de440"] = Field(
        "builtin", description="Earth, Sun and planets: 'builtin' series, or JPL's 'de440' (csstsim[de440])"
    )
    planets: bool = Field(False, description="light deflection by Jupiter to Neptune, too, not only by the Sun")


class PsfConfig(Model):
    """The PSF set: made for the campaign, or an external one."""

    grid: int = Field(
        10,
        ge=2,
        le=60,
        description="nodes along a chip's side: 10 are enough for bilinear, idw needs the paper's 30",
    )
    oversampling: Literal["auto", 2, 4] = Field(
        "auto", description="cells along the side of a pixel; 'auto': the filter's number in psf.yaml"
    )
    library: FilePath | None = Field(
        None,
        description="folder of an external set, psfCube_{chip}.h5 (optics/psf/psf_c9.py); null = make a set",
    )
    library_sample: Literal["cell_integral", "point"] = Field(
        "cell_integral",
        description="a sample of the external set: the integral over its cell, or a point value",
    )
    interpolation: Literal["idw", "bilinear", "bicubic"] = Field(
        "bilinear", description="the PSF between nodes: from the nearest, from the cell's four, or from 4 x 4 around it"
    )
    beta: float = Field(2.0, gt=0, description="inverse-distance weighting: power of the distance")
    neighbours: int = Field(4, ge=1, description="inverse-distance weighting: number of nodes")


class ContaminationConfig(Model):
    """What is known of the light that neighbours put under a slitless spectrum."""

    known_from: Literal["truth", "catalogue"] = Field(
        "truth",
        description="'truth': true spectra of all objects; 'catalogue': what an imaging survey knows, magnitudes in "
        "the bands, between which spectra are interpolated",
    )
    table: FilePath | None = Field(
        None,
        description="with catalogue: table of the objects, as of a catalogue of your own (.csv, .ecsv, .fits, "
        ".parquet); null: places, shapes and magnitudes of the truth, of objects to `depth`",
    )
    depth: float = Field(
        26.0, description="with catalogue and no table: AB, the faintest object known, in its brightest band"
    )
    subtract: bool = Field(True, description="false: the column `contamination` is given, but not subtracted")

    @model_validator(mode="after")
    def _table_where_used(self):
        if self.table is not None and self.known_from != "catalogue":
            raise ValueError("table goes with known_from: catalogue")
        return self


class MeasurementConfig(Model):
    """How Level-0 files are calibrated before sources are measured, and how spectra are extracted."""

    calibration: Literal["truth", "frames"] = Field(
        "truth",
        description="'truth': use the simulation's own maps and traps; 'frames': masters from bias, dark and lamp "
        "exposures (csstsim masters), and other traps of the same density",
    )
    masters: FilePath | None = Field(
        None, description="output folder of the campaign that made the masters; needed for calibration: frames"
    )
    cti_passes: int = Field(3, ge=0, le=20, description="passes of the correction of charge transfer; 0: no correction")
    keep_calibrated: bool = Field(
        False, description="true: write the calibrated images (electrons/s, errors, quality) of all chips"
    )
    contamination: ContaminationConfig = Field(default_factory=ContaminationConfig)

    @model_validator(mode="after")
    def _masters_where_used(self):
        if (self.calibration == "frames") != (self.masters is not None):
            raise ValueError("masters must be given with calibration: frames, and only there")
        return self


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
    level0_names: Literal[tuple(FORMS)] = Field(
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
    def _names_of_folders(cls, value):
        for name in value:
            if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name):
                raise ValueError(f"{name}: a name has letters, digits and _, and begins with a letter")
        return value

    @field_validator("truth")
    @classmethod
    def _parquet_is_there(cls, value):
        if "parquet" not in value or len(set(value)) < len(value):
            raise ValueError("must be [parquet] or [parquet, cat]")
        return value

    _layout = field_validator("schema_version")(check_layout)

    def observation_file(self, exposure_type):
        """Return the path of the layer list for 'SCIE', 'BIAS', 'DARK' or 'FLAT'."""
        names = {"SCIE": "science", "BIAS": "bias", "DARK": "dark", "FLAT": "led_flat"}
        return self.observations.get(exposure_type, SHIPPED / "observations" / f"{names[exposure_type]}.yaml")

    @property
    def universe_folder(self):
        """The universe folder: the campaign's, or the shipped one."""
        return self.universe or SHIPPED / "universe"

    def digest(self):
        """Return 16 hex digits of what decides a chip's pixels: not which chips run, not folders, not thresholds."""
        return digest(self.model_dump(mode="json", include={"seed", "catalog", "astrometry", "psf", "fidelity"}))


@explained("campaign")
def load_campaign(path):
    """Read and check a campaign file; its files and folders are found beside it. Raises InputError.

    psf.library, measurement.masters and a catalogue's options stay as they are written, for they are part of recipes:
    `beside` finds them when they are used. path: FILE@NAME for a variant; its output folder is the base's here. The
    variants of a base are checked with it.
    """
    (base, variant), file = split(path), Path(path)
    data = read_yaml(base)
    config = make_campaign(data if variant is None else changed(data, variant, base), path)
    _check_variants(config, data, file)
    instrument = config.instrument
    if isinstance(instrument, dict) and instrument.get("folder"):
        instrument = instrument | {"folder": beside(file, instrument["folder"])}
    elif isinstance(instrument, Path):
        instrument = beside(file, instrument)
    return config.model_copy(update={
        "survey_table": _there(file, config.survey_table), "output": beside(file, config.output),
        "observations": {kind: _there(file, path) for kind, path in config.observations.items()},
        "instrument": instrument, "universe": config.universe and beside(file, config.universe),
        "share": config.share and beside(file, config.share),
    })  # fmt: skip


def _check_variants(config, data, file):
    """Each variant of a base is a campaign, and none is equal to another."""
    seen = {_what(config): "the base"}
    for name in config.variants:
        what = _what(make_campaign(changed(data, name, file), named(file, name)))
        if what in seen:
            raise InputError(f"equal to {seen[what]}", file=file, key=f"variants.{name}", value=config.variants[name])
        seen[what] = f"the variant {name}"


def _what(config):
    return config.model_dump_json(exclude={"variants"})


def _there(file, path):
    """Return `beside`; the error of a file that is only found from the current directory says so."""
    found = beside(file, path)
    if not found.exists() and path.exists():
        raise InputError(
            f"no file {found}, but {path} is in the current directory", file=file, key="paths", value=path,
            allowed="paths relative to the folder of the campaign file",
        )  # fmt: skip
    return found


def make_campaign(data, path):
    """Return the Campaign of a mapping; errors name `path`. Raises InputError."""
    campaign = validate(Campaign, data, path)
    if campaign.window == "region" and campaign.select.region is None:
        raise InputError("'region' needs select.region", file=path, key="window", value="region")
    return campaign
