"""Recipes: digests of everything that a stage and the stages before it read, that is of all inputs of its product.

Each product records its recipe. A stage refuses an input with another recipe, and Snakemake repeats a job if its recipe
has changed. So a key or a number belongs to the recipe of the stage that reads it first, and not to an earlier one.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

from csstsim.base.digest import digest, large_file_digest
from csstsim.base.release import release
from csstsim.base.stages import flatten, read_by, with_dependencies
from csstsim.catalog.galaxy_shapes.full_components import load_numbers as components_numbers
from csstsim.catalog.open import catalogue_digests
from csstsim.optics.psf.sampling import psf_cube
from csstsim.universe.changing.numbers import digest_of

if TYPE_CHECKING:
    from typing import Any

    from csstsim.campaign.opened import OpenCampaign
    from csstsim.instrument.chip import Chip
    from csstsim.instrument.maps.chip_maps import ChipMaps

# {key of the campaign file: the stages that read it first} (base.stages.read_by). The content of files and folders is
# part of recipes under other names: exposures, layers, camera, `sky`
READERS = {
    "schema_version": (),
    "name": (),
    "output": (),
    "survey_table": (),
    "observations*": (),
    "instrument*": (),
    "universe": (),
    "select.*": (),
    "window*": (),  # the job's, in `exposure`
    "keep": (),
    "level0_names": (),
    "share": (),
    "variants*": (),
    "truth": (),
    "seed": ("truth", "select"),
    "catalog.lensing.*": ("truth",),
    "catalog.bright_stars": ("truth",),
    "catalog.structure": ("truth",),
    "catalog.*": ("select",),
    "components.*": ("select", "render"),
    "astrometry.*": ("select",),
    "psf.oversampling": ("psf", "select"),
    "psf.library": ("psf", "select"),
    "psf.interpolation": ("render",),
    "psf.beta": ("render",),
    "psf.neighbours": ("render",),
    "psf.*": ("psf",),
    "fidelity": ("render",),
    "rendering.*": ("render",),
    "measurement.*": (),  # separately, in `measurement`
    "validation.*": ("validate",),
    "sky": ("truth", "select"),
    "changing.*": ("select",),
    "library*": ("psf", "select"),
}


OBJECTS = "catalog.", "components.", "changing.", "sky"  # prefixes of the keys that determine the set of objects


class Recipes:
    """The recipes of a campaign.opened.OpenCampaign."""

    def __init__(self, run: OpenCampaign) -> None:
        self._run = run
        self._known: dict[tuple[str, str, ChipMaps | int], dict[str, str]] = {}

    def of_exposures(self, kind: str, stage: str, chip: Chip) -> dict[str, str]:
        """Return {name: digest} of the inputs of a stage's product in exposures of a kind, without the job itself.

        stage: select, render, readout, level0 or measure; chip: the Chip, which may have laboratory maps.
        """
        key = kind, stage, chip.maps and chip.id
        if key not in self._known:
            self._known[key] = self._of_kind(kind, stage, chip)
        return self._known[key] | {"csstsim": release()}

    def _of_kind(self, kind: str, stage: str, chip: Chip) -> dict[str, str]:
        steps = self._run.steps[kind]
        later = ("readout", "level0") if steps.has_own(stage) else ()  # a user's layer may read the whole camera
        measurement = {"measurement": digest(self._run.measurement)} if stage == "measure" else {}
        return {
            "campaign": self._campaign(stage),
            "camera": self._run.camera.digest_for(stage, *later, chip=chip),
            "layers": steps.digest(stage),
        } | measurement

    def without_objects(self, kind: str, chip: Chip) -> dict[str, str]:
        """Return {name: digest}, as of_exposures, of the inputs of a rendered chip except the set of objects."""
        keys = {name: value for name, value in self._keys.items() if not name.startswith(OBJECTS)}
        campaign = digest(read_by(with_dependencies("render"), keys, READERS))
        return self.of_exposures(kind, "render", chip) | {"campaign": campaign}

    def _campaign(self, stage: str) -> str:
        return digest(read_by(with_dependencies(stage), self._keys, READERS))

    @cached_property
    def _keys(self) -> dict[str, Any]:
        """{dotted key: value} of the campaign file, config/render.yaml and components.yaml, and digests of the sky."""
        config = self._run.config
        sky: str | list[Any] = self._run.universe.digest if self._run.embedded else catalogue_digests(self._run.catalog)
        if (stars := self._run.bright_stars) is not None:
            sky = [sky, digest(stars.tolist())]
        read: dict[str, Any] = {
            "rendering": self._run.rendering.model_dump(),
            "validation": self._run.limits.model_dump(mode="json"),
        }
        if library := self._run.psf_library:
            files = {chip: psf_cube(library, chip) for chip in self._run.sky_chips}
            read["library"] = {str(chip): large_file_digest(file) for chip, file in files.items() if file.is_file()}
        if config.catalog.components == "full":
            read["components"] = components_numbers().model_dump()
        if changing := config.catalog.changing:
            read["changing"] = digest_of(self._run.universe.folder, changing)
        return flatten(config.model_dump(mode="json") | read | {"sky": sky})

    @property
    def truth(self) -> dict[str, str] | None:
        """The recipe of the embedded bricks; None for a user's catalogue."""
        return self._of_stage("truth") if self._run.embedded else None

    @property
    def psf(self) -> dict[str, str]:
        """The recipe of the PSF sets."""
        return self._of_stage("psf")

    @property
    def validation(self) -> dict[str, str]:
        """The inputs of a verdict other than the merged brick and the truth: thresholds, limits of the camera."""
        return self._of_stage("validate")

    def _of_stage(self, stage: str) -> dict[str, str]:
        return {"csstsim": release(), "campaign": self._campaign(stage), "camera": self._run.camera.digest_for(stage)}
