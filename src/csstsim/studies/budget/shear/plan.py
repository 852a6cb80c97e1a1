"""The plan of a budget of shear: samples of galaxies, the base, and the effects, each given by its changes of the base.

A Setting describes how frames are made and measured. An effect is a Setting that differs from the base in a few keys;
its bar is its bias minus that of the Setting it stands `against`. ALL is the Setting with every effect of the sum.
"""

from collections.abc import Collection, Iterable
from typing import Any, Literal, Self

from pydantic import Field, field_validator, model_validator

from csstsim.base.errors import InputError
from csstsim.base.files.yaml_file import read_yaml
from csstsim.base.model import Model, validate
from csstsim.base.shipped import SHIPPED
from csstsim.base.types import PathLike
from csstsim.catalog.object_table import BRIGHTEST, FAINTEST
from csstsim.studies.budget.shear.plan_faults import check_plan
from csstsim.studies.budget.shear.sample import EDGE

DEFAULT = SHIPPED / "budget" / "shear.yaml"
BASE = "base"
ALL = "all"
EstimatorName = Literal["hsm", "own", "fpfs", "metacal"]
Range = tuple[float, float]
OTHER_SEED = 1_000_003  # added to the seed for the arm with independent noise


def _rising(value: Range) -> Range:
    low, high = value
    if not 0 <= low <= high:
        raise ValueError("must be two numbers, low and high, 0 <= low <= high")
    return value


def _bright(value: Range) -> Range:
    _, faintest = value
    if not faintest <= FAINTEST:
        raise ValueError(f"must be at most {FAINTEST:g}")
    return value


def _positive(value: Range) -> Range:
    smallest, _ = value
    if not smallest > 0:
        raise ValueError("must be above 0")
    return value


class Sample(Model):
    """Galaxies of a sample."""

    magnitude: Range = Field(description="AB, brightest and faintest")
    slope: float = Field(0.0, ge=-2, le=2, description="of log10 of the number per magnitude")
    size: Range = Field(description="arcsec, half-light radius")
    ellipticity: float = Field(ge=0, le=0.4, description="rms of each component of (a - b) / (a + b)")

    _pairs = field_validator("magnitude", "size")(_rising)
    _magnitudes = field_validator("magnitude")(_bright)
    _sizes = field_validator("size")(_positive)


class Neighbours(Model):
    """Neighbours of each galaxy."""

    number: float = Field(ge=0, le=20, description="mean number of a galaxy")
    magnitude: Range = Field(description="AB")
    distance: Range = Field(description="arcsec, from the galaxy")
    size: Range = Field(description="arcsec, half-light radius")
    redshift: Range | None = Field(None, description="each as likely; for neighbour_shear: by_redshift")

    _pairs = field_validator("magnitude", "distance", "size")(_rising)
    _magnitudes = field_validator("magnitude")(_bright)
    _sizes = field_validator("size")(_positive)

    @field_validator("redshift")
    @classmethod
    def _redshifts(cls, value: Range | None) -> Range | None:
        return value and _rising(value)


class Lens(Model):
    """The one lens plane that shears galaxies and neighbours, for neighbour_shear: by_redshift."""

    redshift: float = Field(gt=0, le=10)
    galaxies: float = Field(gt=0, le=10, description="redshift of the galaxies; their shear is that of the arms")

    @model_validator(mode="after")
    def _behind(self) -> Self:
        if not self.galaxies > self.redshift:
            raise ValueError("galaxies must lie behind the lens")
        return self


class Stars(Model):
    """Stars from which the PSF is measured."""

    magnitude: float = Field(ge=BRIGHTEST, le=FAINTEST, description="AB")
    every: int = Field(ge=1, description="one at each such position of the grid")


class Setting(Model):
    """How frames are made and measured; the defaults are the simplest that has noise."""

    noise: bool = Field(True, description="photon noise, dark current and readout noise")
    layers: dict[str, dict[str, Any]] = Field({}, description="further layers of the detector, with parameters")
    distortion: bool = Field(False, description="field distortion")
    flat: bool = Field(False, description="vignetting, internal flat and shutter")
    straylight: bool = Field(False, description="the sky of position and time, with its gradient; false: a constant")
    profile: Literal["disk", "full"] = Field("disk", description="exponential disks; or bulges, indices and knots")
    blended: bool = Field(False, description="neighbours that are found")
    undetected: bool = Field(False, description="neighbours that are not found")
    neighbour_shear: Literal["same", "none", "by_redshift"] = Field(
        "same", description="of neighbours: that of the galaxy; none; or as a lens shears at their own redshift"
    )
    calibrated: bool = Field(False, description="what the layers did is undone, as `csstsim calibrate` does")
    masking: bool = Field(False, description="defects and found cosmic rays are filled; needs calibrated")
    background: Literal["known", "constant", "mesh"] = Field(
        "known", description="subtracted: the true level, or a constant or a mesh from the frame"
    )
    wcs: Literal["known", "linear"] = Field("known", description="the map from pixels to sky of the analysis")
    psf: Literal["truth", "middle", "stars"] = Field(
        "truth", description="at each galaxy; that of the window's middle; or a fit to stars"
    )
    detection: bool = Field(False, description="false: every galaxy counts; true: those found in their own arm")

    @model_validator(mode="after")
    def _masked_when_calibrated(self) -> Self:
        if self.masking and not self.calibrated:
            raise ValueError("masking needs calibrated: true")
        if self.background == "known" and (self.flat or self.straylight):
            raise ValueError("background: known is of a sky without losses and gradients")
        return self


class Effect(Model):
    """One bar."""

    about: str = Field(description="what it is, for readers of the figure")
    change: dict[str, Any] = Field({}, description="keys of the base's Setting")
    against: str = Field(BASE, description="the base, or another effect: the bar is the difference to it")
    sum: bool = Field(False, description="whether it is in the sum, and in the run that has all effects")
    common: bool = Field(False, description="its error is common to a window: errors are from windows, not galaxies")
    times: int = Field(1, ge=1, le=1000, description="windows of its bar, in units of the plan's fields")
    bar: bool = Field(True, description="false: it is only there for others to stand against")


class ShearPlan(Model):
    """The plan."""

    shear: float = Field(0.02, gt=0, le=0.05, description="of each component, in the arms")
    seed: int = Field(1, ge=0, le=2**63 - 1 - OTHER_SEED)
    fields: int = Field(ge=1, le=100_000, description="windows of each sample; effects may have several times as many")
    whole: int = Field(1, ge=1, le=1000, description="windows with all effects at once, in units of fields")
    chips: tuple[int, ...] = Field(min_length=1, description="imaging chips, in turn; all of one band")
    pa: float = Field(0.0, ge=-360, le=360, description="deg, position angle; 45: pixels lie askew to the sky's axes")
    size: int = Field(ge=200, le=9000, description="px, side of a window")
    spacing: int = Field(ge=20, le=1000, description="px, of the grid of galaxies")
    stamp: int = Field(48, ge=16, le=256, description="px, even: side of the stamps that estimators see")
    estimators: tuple[EstimatorName, ...] = Field(min_length=1)
    samples: dict[str, Sample] = Field(min_length=1)
    neighbours: dict[Literal["blended", "undetected"], Neighbours] = Field({})
    lens: Lens | None = None
    stars: Stars
    base: Setting = Field(default_factory=Setting)
    effects: dict[str, Effect] = Field(min_length=1)

    @property
    def cells(self) -> int:
        """The number of galaxies along a side of a window."""
        return (self.size - 2 * EDGE) // self.spacing

    def changed(self, change: dict[str, Any]) -> dict[str, Any]:
        """Return the keys of the base's Setting with a change."""
        base = self.base.model_dump()
        return base | change | {"layers": base["layers"] | (change.get("layers") or {})}

    def setting(self, name: str) -> Setting:
        """Return the Setting of an effect, of BASE, or of ALL, of a plan that plan_faults.check_plan has passed."""
        if name == BASE:
            return self.base
        return Setting(**self.changed(self.summed_change if name == ALL else self.effects[name].change))

    @property
    def summed_change(self) -> dict[str, Any]:
        """The changes of all effects of the sum together."""
        changes = [self.effects[name].change for name in self.summed]
        layers = [change.get("layers") or {} for change in changes]
        return {key: value for change in changes for key, value in change.items()} | {
            "layers": {layer: values for layers_of_effect in layers for layer, values in layers_of_effect.items()}
        }

    @property
    def summed(self) -> tuple[str, ...]:
        """The names of the effects of the sum."""
        return tuple(name for name, effect in self.effects.items() if effect.sum)

    def windows(self, name: str) -> int:
        """Return the number of windows of an effect's bar; of ALL; or of BASE, which has as many as any bar."""
        if name == BASE:
            windows_of_all = [self.windows(ALL)] if self.summed else []
            return max([self.windows(effect) for effect in self.bars] + windows_of_all)
        return self.fields * (self.whole if name == ALL else self.effects[name].times)

    @property
    def bars(self) -> tuple[str, ...]:
        """The names of the effects that are bars."""
        return tuple(name for name, effect in self.effects.items() if effect.bar)


def load_plan(
    file: PathLike | None = None,
    *,
    fields: int | None = None,
    effects: Collection[str] | None = None,
    estimators: Iterable[str] | None = None,
    samples: Iterable[str] | None = None,
) -> ShearPlan:
    """Return the ShearPlan of a YAML file [default: the shipped one], with other fields, effects or estimators.

    samples, effects: names; effects that these stand against are kept. Raises InputError.
    """
    file = file or DEFAULT
    data = read_yaml(file)
    plan = _checked(data, file)
    if fields is not None:
        data["fields"] = fields
    if estimators is not None:
        data["estimators"] = list(estimators)
    for key, names, known in (("samples", samples, plan.samples), ("effects", effects, plan.effects)):
        for name in names or ():
            if name not in known:
                raise InputError(f"no such {key[:-1]}", file=file, key=key, value=name, allowed=", ".join(known))
    if samples is not None:
        data["samples"] = {name: data["samples"][name] for name in samples}
    if effects is not None:
        known = plan.effects
        wanted = set(effects)
        for name in effects:
            while (name := known[name].against) != BASE:
                wanted.add(name)
        data["effects"] = {
            name: given if name in effects else given | {"bar": False, "sum": False}
            for name, given in data["effects"].items()
            if name in wanted
        }
    return _checked(data, file)


def _checked(data: dict[str, Any], file: PathLike) -> ShearPlan:
    plan = validate(ShearPlan, data, file)
    check_plan(plan, file, BASE, ALL)
    return plan
