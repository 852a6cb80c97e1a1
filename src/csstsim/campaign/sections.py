"""The sections of a campaign file as typed models: `campaign.config` puts them together.

Keys, types, defaults and descriptions are here alone; config/README.md and config/schema/ are generated from them.
"""

import math
from typing import Any, Literal, Self

from pydantic import ConfigDict, Field, ValidationInfo, field_validator, model_validator

from csstsim.base.model import FilePath, Model
from csstsim.instrument.pointing import ExposureType
from csstsim.universe.changing.numbers import KINDS

CHIP_GROUPS = ("all", "imaging", "slitless")


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
    missing: dict[str, str] = Field(
        {},
        description="pairs that cannot be made, {OBSID_CHIP: reason}: left out; status, report and manifest name them",
    )

    @field_validator("chips")
    @classmethod
    def _known_chips(cls, value: str | tuple[int, ...]) -> str | tuple[int, ...]:
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
    def _not_empty(cls, value: int, info: ValidationInfo) -> int:
        lower = f"{str(info.field_name)[0]}0"
        low = info.data.get(lower)
        if low is not None and value <= low:
            raise ValueError(f"must exceed {lower} = {low}")
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
    def _weak_and_used(self) -> Self:
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
        description="where the embedded universe's galaxies are: 'haloes', in haloes of dark matter, which lens if "
        "lensing.field is cosmic; 'field', they follow a smooth density; 'none', anywhere, under a lensing field that "
        "knows nothing of them",
    )
    bright_stars: bool | None = Field(
        None,
        description="the real stars V < 5 (config/instrument/sky.yaml) are objects of the embedded universe; "
        "null = they are, false = no star is as bright",
    )
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
        False,
        description="true: asteroids of the main belt move over the embedded sky on orbits of their own, those "
        "brighter than V = 24.5 (config/changing/asteroids.yaml); a chip takes one to three CPU-seconds more",
    )
    satellites: bool = Field(
        False,
        description="true: satellites cross the exposures over the embedded sky, as often as those of Hubble "
        "(config/changing/satellites.yaml)",
    )
    shapes: Literal["normal", "rotated90"] = Field(
        "normal",
        description="'rotated90': select turns intrinsic ellipticities by 90 degrees and changes nothing else, nor the "
        "truth bricks: the paper's twin campaign, which cancels shape noise",
    )
    options: dict[str, Any] = Field({}, description="passed on to a catalogue of your own")

    @property
    def changing(self) -> tuple[str, ...]:
        """The names of the keys, of those for what moves and varies on the embedded sky, that are true."""
        return tuple(kind for kind in KINDS if getattr(self, kind))

    @model_validator(mode="after")
    def _lensing_has_an_object(self) -> Self:
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
    def _table_where_used(self) -> Self:
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
    def _masters_where_used(self) -> Self:
        if (self.calibration == "frames") != (self.masters is not None):
            raise ValueError("masters must be given with calibration: frames, and only there")
        return self
