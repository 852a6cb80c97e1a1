"""Variants: campaigns that differ from a base in some keys, and share with it the products that these do not change.

On the command line a variant is FILE@NAME. Its products are in `variants/NAME` of the base's output folder. Truth
bricks, PSF sets and rendered chips with the same recipe as the base's are not written: the base's files are used. Equal
Level-0 files and measurements are copied to the variant's folder (stages.parts.shared).
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, cast

from csstsim.base.errors import InputError
from csstsim.base.stage_records import STAGE_OF, STAGES
from csstsim.io.paths import Paths

if TYPE_CHECKING:
    from typing import Any

    from csstsim.base.stage_records import Stage
    from csstsim.base.types import PathLike
    from csstsim.campaign.costs import JobKey
    from csstsim.campaign.opened import OpenCampaign

MARK = "@"
FOLDER = "variants"
OF_BASE = "schema_version", "name", "output", "share", "variants"  # keys that a variant may not change


def split_name(file: PathLike) -> tuple[Path, str | None]:
    """Return the campaign file and the variant's name of FILE@NAME; the name is None for a base."""
    path = Path(file)
    before, mark, name = path.name.rpartition(MARK)
    return (path.with_name(before), name) if before and mark and name and not path.exists() else (path, None)


def variant_file(file: PathLike, name: str) -> Path:
    """Return FILE@NAME as a path."""
    path = Path(file)
    return path.with_name(f"{path.name}{MARK}{name}")


def variant_data(data: dict[str, Any], name: str, file: PathLike) -> dict[str, Any]:
    """Return the content of a variant's campaign file. Raises InputError.

    data: the content of the base's file. The variant's keys replace those of the base, nested mappings key by key.
    """
    variants = data.get("variants") or {}
    if not isinstance(variants, dict) or name not in variants:
        known = ", ".join(map(str, variants)) or "none in this campaign"
        raise InputError("no such variant", file=file, key="variants", value=name, allowed=known)
    keys = variants[name] or {}
    for key in OF_BASE:
        if key in keys:
            raise InputError("cannot differ from the base", file=file, key=f"variants.{name}.{key}", value=keys[key])
    return _merged({key: value for key, value in data.items() if key != "variants"}, keys)


def _merged(base: dict[str, Any], keys: dict[str, Any]) -> dict[str, Any]:
    nested = {key for key in keys if isinstance(keys[key], dict) and isinstance(base.get(key), dict)}
    return base | keys | {key: _merged(base[key], keys[key]) for key in nested}


def same_product(run: OpenCampaign, obsid: str, chip_id: int, stage: str) -> bool:
    """Return whether the base of a variant `run` makes a stage's product of a job with the same bits."""
    assert run.base is not None  # it is a variant
    keys = ("level0_names", "truth") if stage in ("level0", "measure") else ()  # not part of recipes
    if any(getattr(run.config, key) != getattr(run.base.config, key) for key in keys):
        return False
    if stage == "measure" and run.config.measurement.joint != run.base.config.measurement.joint:
        return False  # one of them has another file
    try:
        base_job = run.base.job(obsid, chip_id)
    except InputError:  # not one of its jobs
        return False
    return run.base.recipe(base_job, stage) == run.recipe(run.job(obsid, chip_id), stage)


def made_by_base(run: OpenCampaign, rule: str, key: JobKey) -> bool:
    """Return whether the base makes the product of a rule's job, so that the variant at most copies it.

    key: (obsid, chip), a brick or a chip, as in campaign.costs. False if `run` is a base.
    """
    if run.base is None:
        return False
    stage = STAGES["level0" if rule == "readout" else rule]  # an equal Level-0 file needs no readout
    if not stage.of_base:
        return False
    if stage.unit != "job":
        path = run.paths.of(stage.products[0].name, cast("int", key))
        return not path.is_relative_to(run.paths.output)
    return run.in_base(*cast("tuple[str, int]", key), stage.recipe)


class VariantPaths(Paths):
    """Paths of a variant: those of the base for equal truth bricks, PSF sets and rendered chips.

    run: the campaign.opened.OpenCampaign of the variant; output, scratch: the base's folders.
    """

    def __init__(self, run: OpenCampaign, output: PathLike, scratch: PathLike | None = None, *names: str) -> None:
        assert run.variant is not None
        below = Path(FOLDER, run.variant)
        super().__init__(Path(output) / below, scratch and Path(scratch) / below, *names)
        self._run = run

    def _shared(self, stage: Stage, number: int) -> bool:
        """Return whether the base makes the product of a brick or chip with this number."""
        run = self._run
        base = self._run.base
        assert base is not None  # it is a variant
        if getattr(base.recipes, stage.name) != getattr(run.recipes, stage.name):
            return False
        same_jobs = all(
            getattr(run.config, key) == getattr(base.config, key) for key in ("survey_table", "select", "window")
        ) and run.camera.digest_for("select") == base.camera.digest_for("select")
        return same_jobs or number in getattr(base, stage.made_for)  # the latter opens all jobs: slow

    def find(self, name: str, **words: object) -> Path:
        """As Paths.find, but the base's path if the product is equal and not copied."""
        stage = STAGE_OF[name]
        if stage.of_base != "file":
            return super().find(name, **words)
        chip = int(str(words["chip"])) if "chip" in words else 0
        if stage.unit == "job":
            equal = self._run.in_base(str(words["obsid"]), chip, stage.name)
        else:
            equal = self._shared(stage, chip if stage.unit == "chip" else cast("int", words["pix"]))
        if not equal:
            return super().find(name, **words)
        assert self._run.base is not None  # it is a variant
        return self._run.base.paths.find(name, **words)
