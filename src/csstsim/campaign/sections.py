"""The sections of a campaign file as typed models; `campaign.config` combines them.

They are the only source of keys, types, defaults and descriptions: config/README.md and config/schema/ are generated
from them. A description begins with the unit and the allowed range.
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

    ra: float = Field(ge=0, lt=360, description="deg, 0 to 360 (excluded). Right ascension of the centre, ICRS.")
    dec: float = Field(ge=-90, le=90, description="deg, -90 to 90. Declination of the centre, ICRS.")
    radius: float = Field(gt=0, le=120, description="arcmin, above 0, up to 120. Radius in the tangent plane.")


class Select(Model):
    """The selected (exposure, chip) pairs of the survey table."""

    model_config = ConfigDict(coerce_numbers_to_str=True)  # an obsid may be given without quotes

    types: tuple[ExposureType, ...] = Field(
        ("SCIE", "BIAS", "DARK", "FLAT"),
        description="List of SCIE, BIAS, DARK and FLAT. Types of the exposures to simulate.",
    )
    obsids: tuple[str, ...] | None = Field(
        None, description="List of obsids in the survey table, or null. Exposures to simulate; null: all."
    )
    chips: str | tuple[int, ...] = Field(
        "imaging",
        description="all, imaging, slitless, or a list of chip numbers. Chips to simulate in each exposure.",
    )
    filters: tuple[str, ...] | None = Field(
        None, description="List of filter names, or null. Only chips with these filters are simulated; null: all."
    )
    region: Region | None = Field(
        None,
        description="Circle {ra, dec, radius}, or null. Only chips that touch the circle are simulated; null: all. "
        "With `window`, the window on the chip must touch it.",
    )
    missing: dict[str, str] = Field(
        {},
        description="Mapping {OBSID_CHIP: reason}. (Exposure, chip) pairs that cannot be simulated and are left out. "
        "Status, report and manifest list them with the reason.",
    )

    @field_validator("types", "obsids", "filters")
    @classmethod
    def _not_empty(cls, value: tuple[str, ...] | None) -> tuple[str, ...] | None:
        if value == ():
            raise ValueError("an empty list selects nothing; leave the key out for all")
        return value

    @field_validator("chips")
    @classmethod
    def _known_chips(cls, value: str | tuple[int, ...]) -> str | tuple[int, ...]:
        known = value in CHIP_GROUPS if isinstance(value, str) else value and min(value) >= 1
        if not known:
            raise ValueError(f"must be {', '.join(CHIP_GROUPS)} or a list of chip numbers")
        return value


class PixelWindow(Model):
    """A rectangle of active pixels, the same on every chip: x0 <= x < x1, y0 <= y < y1."""

    x0: int = Field(ge=0, description="px, from 0. First column.")
    x1: int = Field(gt=0, description="px, above x0, up to the number of columns. Last column plus 1.")
    y0: int = Field(ge=0, description="px, from 0. First row.")
    y1: int = Field(gt=0, description="px, above y0, up to the number of rows. Last row plus 1.")

    @field_validator("x1", "y1")
    @classmethod
    def _not_empty(cls, value: int, info: ValidationInfo) -> int:
        lower = f"{str(info.field_name)[0]}0"
        low = info.data.get(lower)
        if low is not None and value <= low:
            raise ValueError(f"must exceed {lower} = {low}")
        return value


class Lensing(Model):
    """Weak lensing of the embedded universe's galaxies (axes: east, north)."""

    field: Literal["none", "constant", "cosmic"] = Field(
        "cosmic",
        description="none, constant or cosmic. Lensing field of the galaxies. 'constant': kappa, gamma1 and gamma2 for "
        "all galaxies. 'cosmic': a random field with the power spectrum of matter (config/universe/lensing.yaml).",
    )
    kappa: float = Field(
        0.0, lt=1, allow_inf_nan=False, description="Below 1. Convergence of the constant lensing field."
    )
    gamma1: float = Field(
        0.0,
        allow_inf_nan=False,
        description="|gamma| below 1 - kappa. Shear component along east (+RA) of the constant lensing field.",
    )
    gamma2: float = Field(
        0.0,
        allow_inf_nan=False,
        description="|gamma| below 1 - kappa. Shear component at 45 deg from east towards north, of the constant "
        "lensing field.",
    )

    @model_validator(mode="after")
    def _weak_and_with_constant_field(self) -> Self:
        if self.field != "constant" and (self.kappa, self.gamma1, self.gamma2) != (0.0, 0.0, 0.0):
            raise ValueError(f"kappa, gamma1 and gamma2 need field: constant, not {self.field}")
        if math.hypot(self.gamma1, self.gamma2) >= 1 - self.kappa:
            raise ValueError("strong lensing: the reduced shear |gamma| / (1 - kappa) must be below 1")
        return self


class CatalogConfig(Model):
    """The catalogue of true objects: the embedded mock universe, or a user's CatalogBase."""

    kind: str = Field(
        "embedded",
        description="'embedded', or module.path:ClassName. Source of the true objects: the simulated universe that "
        "comes with csstsim, or a CatalogBase class of your own.",
    )
    mag_limit: float | None = Field(
        None,
        gt=0,
        description="AB mag, above 0, or null. Faintest magnitude that is rendered, in the band of the chip; null: no "
        "limit.",
    )
    lensing: Lensing = Field(
        default_factory=Lensing,
        description="Weak lensing of the embedded universe's galaxies. A catalogue of your own has columns for it.",
    )
    structure: Literal["haloes", "field", "none"] = Field(
        "haloes",
        description="haloes, field or none. Spatial distribution of the embedded universe's galaxies. 'haloes': in "
        "dark-matter haloes, which also act as lenses if lensing.field is cosmic. 'field': following a smooth density "
        "field. 'none': uniformly random, not correlated with the lensing field.",
    )
    bright_stars: bool | None = Field(
        None,
        description="true, false or null. Add the real stars with V < 5 (config/instrument/sky.yaml) to the embedded "
        "universe; null: true. With false there are no stars this bright.",
    )
    components: Literal["simple", "full"] = Field(
        "simple",
        description="simple or full. Light profiles of the embedded universe's galaxies. 'simple': a disk of Sersic "
        "index 1 and a bulge of index 4. 'full': indices with scatter that depend on the bulge mass, star-forming "
        "knots, and a spectrum for each component (config/components.yaml).",
    )
    variable_stars: bool = Field(
        False,
        description="true or false. Variable stars in the embedded universe (config/changing/variable_stars.yaml).",
    )
    variable_quasars: bool = Field(
        False,
        description="true or false. Quasars of the embedded universe vary as a damped random walk "
        "(config/changing/variable_quasars.yaml).",
    )
    asteroids: bool = Field(
        False,
        description="true or false. Moving main-belt asteroids brighter than V = 24.5 in the embedded universe "
        "(config/changing/asteroids.yaml). They add 1 to 3 CPU-seconds per chip.",
    )
    satellites: bool = Field(
        False,
        description="true or false. Satellite trails in exposures of the embedded universe, at the rate observed by "
        "Hubble (config/changing/satellites.yaml).",
    )
    shapes: Literal["normal", "rotated90"] = Field(
        "normal",
        description="normal or rotated90. 'rotated90' rotates the intrinsic ellipticities of galaxies by 90 deg and "
        "changes nothing else. Two such twin campaigns together cancel shape noise.",
    )
    options: dict[str, Any] = Field({}, description="Mapping. Options passed to a catalogue class of your own.")

    @property
    def changing(self) -> tuple[str, ...]:
        """Those of the keys for moving and variable objects (KINDS) that are true."""
        return tuple(kind for kind in KINDS if getattr(self, kind))

    @model_validator(mode="after")
    def _keys_fit_the_kind(self) -> Self:
        if self.kind == "embedded":
            if self.options:
                raise ValueError("the embedded universe takes no options: they are for a catalogue of your own")
            return self
        columns = "your own catalogue has columns for"
        for name, given, instead in (
            ("lensing", self.lensing.field == "constant", "give kappa, gamma1, gamma2 in your own catalogue"),
            ("structure", self.structure != "haloes", "your own catalogue gives the positions of its galaxies"),
            ("bright_stars", self.bright_stars, "give bright stars in your own catalogue"),
            ("components", self.components != "simple", f"{columns} components"),
            *((kind, True, f"{columns} moving and variable objects") for kind in self.changing),
        ):
            if given:
                raise ValueError(f"{name} is for the embedded universe: {instead}")
        return self


class AstrometryConfig(Model):
    """Computation of apparent directions at the spacecraft."""

    ephemeris: Literal["builtin", "de440"] = Field(
        "builtin",
        description="builtin or de440. Ephemeris of Earth, Sun and planets: built-in series, or JPL DE440 (install "
        "csstsim[de440]).",
    )
    planets: bool = Field(
        False,
        description="true or false. Light deflection by Jupiter, Saturn, Uranus and Neptune in addition to the Sun's.",
    )


class PsfConfig(Model):
    """The PSF set: computed for the campaign, or an external one."""

    grid: int = Field(
        10,
        ge=2,
        le=60,
        description="2 to 60. Number of PSF nodes along each side of a chip. 10 are enough for bilinear interpolation; "
        "idw needs the paper's 30.",
    )
    oversampling: Literal["auto", 2, 4] = Field(
        "auto",
        description="2, 4 or auto. PSF samples per pixel along each axis. 'auto': the filter's value in "
        "config/instrument/psf.yaml.",
    )
    library: FilePath | None = Field(
        None,
        description="Folder, or null. External PSF set, files psfCube_{chip}.h5 (optics/psf/psf_c9.py); null: compute "
        "the PSF set.",
    )
    library_sample: Literal["cell_integral", "point"] = Field(
        "cell_integral",
        description="cell_integral or point. Meaning of a sample of the external PSF set: the integral over its cell, "
        "or the value at its centre.",
    )
    interpolation: Literal["idw", "bilinear", "bicubic"] = Field(
        "bilinear",
        description="idw, bilinear or bicubic. Interpolation of the PSF between nodes: inverse-distance weighting of "
        "the nearest nodes, bilinear from 2 x 2 nodes, or bicubic from 4 x 4 nodes.",
    )
    beta: float = Field(2.0, gt=0, description="Above 0. Exponent of the distance in inverse-distance weighting.")
    neighbours: int = Field(4, ge=1, description="From 1. Number of nodes in inverse-distance weighting.")


class ContaminationConfig(Model):
    """Model of the flux of neighbours that overlaps a slitless spectrum."""

    known_from: Literal["truth", "catalogue"] = Field(
        "truth",
        description="truth or catalogue. Spectra of the neighbours. 'truth': true spectra. 'catalogue': spectra "
        "interpolated between broad-band magnitudes, as known from an imaging survey.",
    )
    table: FilePath | None = Field(
        None,
        description="File (.csv, .ecsv, .fits, .parquet), or null. Imaging catalogue of known_from: catalogue, with "
        "the columns of a catalogue of your own; null: true positions, shapes and magnitudes of objects down to "
        "`depth`.",
    )
    depth: float = Field(
        26.0,
        description="AB mag. Magnitude limit, in its brightest band, of an object of known_from: catalogue without a "
        "table.",
    )
    subtract: bool = Field(
        True,
        description="true or false. Subtract the modelled flux of neighbours. With false it is only written to the "
        "column `contamination`.",
    )

    @model_validator(mode="after")
    def _table_where_used(self) -> Self:
        if self.table is not None and self.known_from != "catalogue":
            raise ValueError("table goes with known_from: catalogue")
        return self


class MeasurementConfig(Model):
    """Calibration of Level-0 files before the measurement of sources, and extraction of spectra."""

    calibration: Literal["truth", "frames"] = Field(
        "truth",
        description="truth or frames. Source of the calibration. 'truth': the simulation's own maps and traps. "
        "'frames': master frames from simulated bias, dark and flat exposures (csstsim masters), and other traps of "
        "the same density.",
    )
    masters: FilePath | None = Field(
        None,
        description="Folder, or null. Output folder of the campaign that made the master frames; required for "
        "calibration: frames.",
    )
    cti_passes: int = Field(
        3,
        ge=0,
        le=20,
        description="0 to 20. Number of iterations that correct charge transfer inefficiency; 0: no correction.",
    )
    keep_calibrated: bool = Field(
        False,
        description="true or false. Write the calibrated images (flux in electrons/s, errors, data quality) of all "
        "imaging chips.",
    )
    joint: bool = Field(
        False,
        description="true or false. Find the sources of merged bricks in all bands and visits together, too, and "
        "measure each source in the frames that did not detect it. It needs an image of each measured frame without "
        "its sources (85 MB of a full chip).",
    )
    contamination: ContaminationConfig = Field(default_factory=ContaminationConfig)

    @model_validator(mode="after")
    def _masters_where_used(self) -> Self:
        if (self.calibration == "frames") != (self.masters is not None):
            raise ValueError("masters must be given with calibration: frames, and only then")
        return self
