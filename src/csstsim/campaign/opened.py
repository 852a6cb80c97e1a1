"""An opened campaign: its files, read and checked, and its (exposure, chip) pairs.

Every fault in the input is found here, before any work starts. The commands and the workflow get jobs, bricks and paths
from the same object.
"""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from csstsim.base.digest import digest, file_digest
from csstsim.base.errors import InputError
from csstsim.base.files.relative_to_file import relative_to_file
from csstsim.base.help_page import explained
from csstsim.base.rng import Streams
from csstsim.base.stage_records import STAGES
from csstsim.campaign.checks import (
    check_braces,
    check_file,
    check_header,
    check_layers,
    check_maps,
    check_masters,
    check_photons,
    check_selection,
    check_share,
    check_shutter,
    check_universe,
)
from csstsim.campaign.config import load_campaign
from csstsim.campaign.job import Job
from csstsim.campaign.job_lists import JobLists
from csstsim.campaign.products import pairs_of_base
from csstsim.campaign.recipes import Recipes
from csstsim.campaign.selection import nothing_selected, pair_missed, selected_chips, window_of
from csstsim.campaign.survey_table import load_survey_table
from csstsim.campaign.variants import VariantPaths, same_product, split_name, variant_file
from csstsim.catalog.astrometry.ephemeris import observer
from csstsim.catalog.open import TABLE_KIND, catalog_class, importable, resolved_options
from csstsim.catalog.selection.bricks import BRICK_MARGIN_PX, bricks_for, region_for
from csstsim.instrument.camera import load_camera
from csstsim.io.output_owner import check_owner
from csstsim.io.paths import Paths
from csstsim.optics.geometry.distortion import load_distortion
from csstsim.optics.geometry.wcs import ChipWCS
from csstsim.optics.gratings.dispersion import Disperser
from csstsim.render.settings import load_numbers
from csstsim.simulation.exposure import Exposure
from csstsim.simulation.sim_steps import SimSteps

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence
    from typing import Any

    from csstsim.base.types import FloatArray, PathLike
    from csstsim.campaign.config import Campaign
    from csstsim.campaign.sections import CatalogConfig
    from csstsim.campaign.thresholds import ValidateConfig
    from csstsim.catalog.astrometry.ephemeris import Observer
    from csstsim.catalog.base import CatalogBase, Region
    from csstsim.instrument.chip import Chip
    from csstsim.instrument.pointing import Pointing
    from csstsim.optics.geometry.distortion import FieldDistortion
    from csstsim.universe.parameters import Universe


class OpenCampaign(JobLists):
    """A checked campaign. Raises InputError for any fault in its files."""

    def __init__(
        self,
        file: PathLike,
        output: PathLike | None = None,
        scratch: PathLike | None = None,
        *,
        copied: bool = False,
        config: Campaign | None = None,
        layers: Mapping[str, Sequence[Mapping[str, dict[str, Any] | None]]] | None = None,
        pointings: dict[str, Pointing] | None = None,
        only: tuple[str, Collection[int]] | None = None,
    ) -> None:
        """Open a campaign.

        file: the campaign file, or FILE@NAME for a variant; then `output` and `scratch` are the base's folders. copied:
        the output folder is only read, and may be a copy of the one named in `campaign.json`. config
        (config.Campaign), layers ({exposure type: list as config.Observation.layers}) and pointings ({obsid:
        instrument.pointing.Pointing}) replace the files. only: (obsid, chip numbers) of the jobs needed; other
        exposures and gratings are not checked.
        """
        self.file = Path(file)
        self.variant = split_name(file)[1]
        importable(self.file.parent)
        self.config = config or load_campaign(file)
        self._folders: dict[str, Any] = {"output": output or self.config.output, "scratch": scratch}
        self._opened: dict[str, Any] = {"copied": copied, "only": only}
        self._in_base: dict[tuple[str, int, str], bool] = {}
        folders = *self._folders.values(), self.config.level0_names
        self.paths: Paths = VariantPaths(self, *folders) if self.variant else Paths(*folders)
        if not copied:
            check_owner(self)
            check_share(self)
            check_braces(self, scratch)
            check_universe(self)
        self.camera = load_camera(self.config.instrument, self.file)
        self.rendering = load_numbers()
        self.table: str | Path = "the given pointings" if pointings else self.config.survey_table  # named in errors
        if not pointings:
            check_file(self, "survey_table", self.config.survey_table)
        self.pointings = pointings or load_survey_table(self.config.survey_table, self.camera.orbit)
        check_selection(self)
        select = self.config.select
        obsids = set(self.pointings if select.obsids is None else select.obsids)
        self.exposures = {
            obsid: p for obsid, p in self.pointings.items() if p.type in select.types and obsid in obsids
        }  # the selected ones, in the order of the table
        self.chips = selected_chips(select, self.camera)
        types = sorted({p.type for p in self.exposures.values()})
        layers = layers or {}
        for kind in set(types) & set(self.config.observations) - set(layers):
            check_file(self, f"observations.{kind}", self.config.observation_file(kind))
        self.steps = {kind: SimSteps(self.config.observation_file(kind), kind, layers.get(kind)) for kind in types}
        self.exposures = {obsid: self.steps[p.type].timed(p) for obsid, p in self.exposures.items()}

        check_photons(self)
        chips = [chip for chip in self.chips if only is None or chip.id in only[1]]
        check_maps(chips)
        if chips and self.pointings and not copied:
            check_header(self, chips[0])
        exposures = {obsid: p for obsid, p in self.exposures.items() if only is None or obsid == only[0]}
        if "SCIE" in self.steps and any(chip.kind == "slitless" for chip in chips):
            _ = self.camera.gratings  # reads and checks them
        check_layers(self, exposures)
        for p in {(p.type, p.exptime): p for p in exposures.values()}.values():
            check_shutter(self.steps[p.type], p.exptime, chips)

    @property
    def title(self) -> str:
        """The name of the campaign, with that of the variant."""
        return f"{self.config.name}, variant {self.variant}" if self.variant else self.config.name

    @cached_property
    def variants(self) -> tuple[OpenCampaign, ...]:
        """The opened variants of a base, in the order of its file. Raises InputError for a fault in one."""
        runs = tuple(
            OpenCampaign(variant_file(self.file, name), **self._folders, **self._opened)
            for name in self.config.variants
        )
        for run in runs:
            run.base = self
        return runs

    @cached_property
    def base(self) -> OpenCampaign | None:
        """The opened campaign of which this is a variant; None for a base."""
        return OpenCampaign(split_name(self.file)[0], **self._folders, **self._opened) if self.variant else None

    def in_base(self, obsid: str, chip_id: int, stage: str) -> bool:
        """Return whether the base of a variant makes a stage's product of a job with the same bits."""
        key = obsid, chip_id, stage
        if key not in self._in_base:
            self._in_base[key] = self.base is not None and same_product(self, *key)
        return self._in_base[key]

    def base_files(self, job: Job, rule: str) -> list[tuple[Path, Path]]:
        """Return [(file of the base, file of this variant)] of a job's products that the base made, bit by bit equal.

        rule: level0, measure or extract. [] for a base, if the products differ, and if the base has not made them.
        """
        if not self.in_base(*job.key, STAGES[rule].recipe):
            return []
        return pairs_of_base(self, job, rule)

    def masters(self, chip_id: int) -> Path:
        """Return the file of the master frames with which a chip's exposures are calibrated."""
        masters = self.config.measurement.masters
        assert masters is not None  # calibration: frames requires it
        return Paths(relative_to_file(self.file, masters)).masters(chip_id)

    @cached_property
    def jobs(self) -> tuple[Job, ...]:
        """The jobs of the campaign, in the order of the survey table and of the chip numbers."""
        pairs = ((obsid, chip) for obsid in self.exposures for chip in self.chips)
        pairs = (pair for pair in pairs if (pair[0], pair[1].id) not in self.declared_missing)
        jobs = tuple(job for pair in pairs if (job := self._job(*pair)))
        if not jobs:
            with explained("aiming"):
                raise nothing_selected(self)
        check_masters(self, {job.chip.id for job in jobs if job.pointing.type == "SCIE"})
        return jobs

    @cached_property
    def declared_missing(self) -> dict[tuple[str, int], str]:
        """{(obsid, chip number): reason} of the pairs excluded by `select.missing`."""
        pairs = {name: name.split("_") for name in self.config.select.missing}
        return {(obsid, int(chip)): self.config.select.missing[name] for name, (obsid, chip) in pairs.items()}

    def job(self, obsid: str, chip_id: int) -> Job:
        """Return one job of the campaign. Raises InputError if the campaign does not select it."""
        if obsid not in self.exposures:
            few = f"{', '.join(self.exposures)} of {self.table}"
            allowed = few if len(self.exposures) < 4 else "run `csstsim plan` with --exposures to list them"
            message = "not an exposure of this campaign"
            raise InputError(message, file=self.file, key="obsid", value=obsid, allowed=allowed)
        chips = {chip.id: chip for chip in self.chips}
        if chip_id not in chips:
            raise InputError(
                "not a chip of this campaign",
                file=self.file,
                key="chip",
                value=chip_id,
                allowed=", ".join(map(str, sorted(chips))),
            )
        if reason := self.declared_missing.get((obsid, chip_id)):
            key = f"select.missing.{obsid}_{chip_id:02d}"
            raise InputError("declared missing", file=self.file, key=key, value=reason)
        job = self._job(obsid, chips[chip_id])
        if job is None:
            with explained("aiming"):
                raise pair_missed(self, obsid, chips[chip_id])
        check_masters(self, {chip_id} if job.pointing.type == "SCIE" else ())
        return job

    def _job(self, obsid: str, chip: Chip) -> Job | None:
        pointing = self.exposures[obsid]
        steps = self.steps[pointing.type]
        wcs, craft = self.maps(pointing, chip)
        window = window_of(self, pointing, chip, wcs, craft)
        if window is None:
            return None
        exposure = Exposure(
            pointing, chip, window, wcs, self.camera, craft, steps.losses, steps.mask, fidelity=self.config.fidelity
        )
        return Job(obsid, exposure)

    def streams(self, job: Job, keyword: str = "") -> Streams:
        """Return the rng.Streams of a job for the layer named by `keyword`."""
        return Streams(self.config.seed, job.obsid, job.chip.id, keyword)

    def maps(self, pointing: Pointing, chip: Chip) -> tuple[ChipWCS, Observer]:
        """Return the ChipWCS of a chip in an exposure, and the Observer: position and velocity of the spacecraft."""
        wcs = ChipWCS(chip, pointing, self.distortion if self.steps[pointing.type].field_dist else None)
        astrometry = self.config.astrometry.model_dump()
        return wcs, observer(pointing.mjd, pointing.sat_position, pointing.sat_velocity, **astrometry)

    @cached_property
    def distortion(self) -> FieldDistortion:
        """The camera's field distortion. It applies to exposures whose layers have `field_dist`."""
        return load_distortion(self.camera.folder / "distortion.fits")

    def has_stage(self, pointing: Pointing, stage: str) -> bool:
        """Return whether exposures of this type have layers in the stage; if not, the stage is skipped."""
        return bool(self.steps[pointing.type].stage(stage))

    def has_orders(self, job: Job) -> bool:
        """Return whether a job's truth lists each diffraction order of each object: a slitless exposure of the sky."""
        return job.chip.kind == "slitless" and bool(self.steps[job.pointing.type].step("scie_obs"))

    @property
    def psf_library(self) -> Path | None:
        """The folder of the campaign's library of PSFs, or None."""
        library = self.config.psf.library
        return library and relative_to_file(self.file, library)

    def in_share(self, path: Path) -> Path | None:
        """Return the path in the shared folder of a truth brick or PSF set in the output folder; None without one."""
        share = self.config.share
        return share and share / path.relative_to(self.paths.output)

    @cached_property
    def catalog(self) -> CatalogConfig:
        """The campaign's CatalogConfig, paths in its options relative to its file, and a table's camera added."""
        given = self.config.catalog
        if self.embedded:
            return given
        options = resolved_options(given.kind, given.options, self.file)
        if given.kind == TABLE_KIND and self.config.instrument is not None:
            options.setdefault("instrument", self.config.instrument)
        return given.model_copy(update={"options": options})

    @property
    def embedded(self) -> bool:
        """Whether the objects are those of the embedded universe, not of a user's catalogue."""
        return self.config.catalog.kind == "embedded"

    def universe_key(self) -> dict[str, Any]:
        """Return the inputs of the embedded bricks: {seed, universe, camera, lensing, structure, bright_stars}."""
        config = self.config
        return {
            "seed": config.seed,
            "universe": self.universe,
            "camera": self.camera,
            "lensing": config.catalog.lensing,
            "structure": config.catalog.structure,
            "bright_stars": self.bright_stars,
        }

    @cached_property
    def bright_stars(self) -> FloatArray | None:
        """The real stars among the objects (sky.parameters.SkyNumbers.stars), or None. Raises InputError."""
        from csstsim.optics.sky.parameters import sky_numbers

        enabled = self.embedded and self.config.catalog.bright_stars is not False
        return sky_numbers(self.camera.sky).stars if enabled else None

    @cached_property
    def universe(self) -> Universe:
        """The embedded universe's numbers (universe.parameters.Universe). Raises InputError."""
        from csstsim.universe.parameters import load_universe

        return load_universe(self.config.universe_folder)

    def open_truth(self) -> Universe | type[CatalogBase]:
        """Return the embedded Universe, or the class of the user's catalogue. Raises InputError for a fault in it."""
        if not self.embedded:
            return catalog_class(self.config.catalog.kind)
        self.universe.check()
        return self.universe

    def disperser(self, exposure: Exposure | Job) -> Disperser | None:
        """Return the optics.gratings.dispersion.Disperser of an Exposure's chip, or None for an imaging chip."""
        chip = exposure.chip
        if chip.kind != "slitless":
            return None
        return Disperser(self.camera.gratings[chip.id], self.camera.filters[chip.filter], self.camera.telescope)

    def margin_deg(self, exposure: Exposure | Job) -> float:
        """Return the margin [deg] around an Exposure's window from which objects can contribute flux to it."""
        scale = self.camera.telescope.pixel_scale
        margin = BRICK_MARGIN_PX * scale / 3600.0
        if exposure.chip.kind != "slitless":
            return margin
        return margin + self.camera.gratings[exposure.chip.id].reach * scale / 3600.0

    def region(self, exposure: Exposure | Job) -> Region:
        """Return the catalog.base.Region whose objects may reach an Exposure's window."""
        return region_for(*exposure.footprint(), self.margin_deg(exposure), self.camera.bands)

    def truth_bricks(self, exposure: Exposure | Job) -> tuple[int, ...]:
        """Return the truth bricks whose objects may reach an Exposure's window, as a tuple."""
        return tuple(int(pix) for pix in bricks_for(*exposure.footprint(), self.margin_deg(exposure)))

    @cached_property
    def recipes(self) -> Recipes:
        """The recipes of the products (campaign.recipes.Recipes)."""
        return Recipes(self)

    def recipe(self, job: Job, stage: str = "level0") -> dict[str, str]:
        """Return {name: digest} of all inputs of a stage's product of a job; the product records it."""
        return self.recipes.of_exposures(job.pointing.type, stage, job.chip) | {"exposure": job.digest}

    def brick_recipe(self, pix: int) -> str:
        """Return the digest of all inputs of a merged brick: the recipes of the frames on it."""
        joint = [True] if self.config.measurement.joint else []
        return digest([self.recipe(job, "measure") for job in self.merge_bricks[pix]] + joint)

    def exposure_recipe(self, obsid: str, stage: str) -> str:
        """Return the digest of all inputs of a product of an exposure: the recipes of its chips, up to a stage."""
        return digest([self.recipe(job, stage) for job in self.science_exposures[obsid]])

    @cached_property
    def limits(self) -> ValidateConfig:
        """The thresholds of the gates that are evaluated (thresholds.ValidateConfig)."""
        return self.config.validation.for_catalogue(self.embedded)

    @property
    def measurement(self) -> dict[str, Any]:
        """The keys of `measurement` that determine measurements, JSON-like, without those that select products."""
        keys = self.config.measurement.model_dump(mode="json", exclude={"keep_calibrated", "joint"})
        if self.config.measurement.contamination.table is not None:
            keys["contamination"]["table"] = file_digest(self.contamination_table)
        return keys

    @property
    def contamination_table(self) -> Path:
        """The file of measurement.contamination.table. Raises InputError if it does not exist."""
        table = self.config.measurement.contamination.table
        assert table is not None  # tested by the callers
        path = relative_to_file(self.file, table)
        if not path.is_file():
            raise InputError("no such file", file=self.file, key="measurement.contamination.table", value=str(path))
        return path
