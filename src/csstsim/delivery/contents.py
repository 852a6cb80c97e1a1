"""What an output folder should hold: its frames and bricks, and the recipe of each.

It comes from the campaign (`of_campaign`) or, if there is only the folder, from its products (delivery.folder).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from csstsim.base.digest import digest
from csstsim.campaign.products import kinds
from csstsim.io.paths import Paths
from csstsim.io.pointing_keywords import Boresight

if TYPE_CHECKING:
    from collections.abc import Container, Iterable

    from csstsim.campaign.job import Job
    from csstsim.campaign.opened import OpenCampaign
    from csstsim.optics.geometry.wcs import ChipWCS

# a product must exist, must not, or may
YES = "yes"
NO = "no"
MAYBE = "maybe"
# Stages whose products delivery.products knows; a product of another stage need only exist
CHECKED = (
    *("truth", "psf", "render", "level0", "masters", "calibrate"),
    *("measure", "extract", "merge", "validate", "report", "variants"),
)


@dataclass(frozen=True)
class ExpectedFrame:
    """One Level-0 file that should exist: its exposure and chip, its recipe, and the files that belong to it.

    `recipe`: {name: digest}; `rays_recipe`: that of the image of cosmic rays, which the readout writes; `window`: (x0,
    x1, y0, y1); boresight, wcs (a ChipWCS): where the campaign points. None: not known. measured, extracted, cosmic:
    YES, NO or MAYBE.
    """

    obsid: str
    chip: int
    filter: str | None
    type: str
    level0: Path
    recipe: dict[str, Any] | None
    rays_recipe: dict[str, Any] | None
    window: tuple[int, int, int, int] | None
    measured: str
    extracted: str
    cosmic: str
    boresight: Boresight | None = None
    wcs: ChipWCS | None = None
    catalogue: Path | None = None  # the truth as text once more, under the name that the form of names has for it

    def companion(self, suffix: str) -> Path:
        """Return the file of the same name with TRUTH, CAT, ORDERS or COSMIC of io.paths."""
        return self.level0.with_suffix(suffix)

    @property
    def key(self) -> tuple[str, int]:
        """(obsid, chip), as of campaign.job.Job."""
        return self.obsid, self.chip


@dataclass(frozen=True)
class Contents:
    """What a folder should hold.

    bricks, truth: {brick: what its file must record, or None}; measurement: digest of the settings of `measure`, or
    None; psf: chips that see the sky; masters: {chip: what its file must record, or None}; calibrated, joint, cat: YES,
    NO or MAYBE; light: {file of render's that is kept: its recipe, or None}; report: YES or MAYBE; others: {file of a
    stage that is not in CHECKED: what it is}; faults: [(path, fault)] found meanwhile.
    """

    paths: Paths
    frames: tuple[ExpectedFrame, ...]
    bricks: dict[int, str | None]
    truth: dict[int, dict[str, Any] | None]
    masters: dict[int, dict[str, Any] | None]
    light: dict[Path, dict[str, Any] | None]
    measurement: str | None
    calibrated: str
    joint: str
    report: str
    cat: str
    others: dict[Path, str] = field(default_factory=dict)
    faults: list[tuple[Path, str]] = field(default_factory=list)

    @property
    def psf(self) -> dict[int, ExpectedFrame]:
        """{chip: a frame of it} of the chips that see the sky."""
        first = {frame.chip: frame for frame in reversed(self.frames) if frame.type == "SCIE"}
        return dict(sorted(first.items()))

    def measure_recipe(self, frame: ExpectedFrame) -> dict[str, Any] | None:
        """Return what a frame's measurements must record, or None."""
        if frame.recipe is None or self.measurement is None:
            return None
        return frame.recipe | {"measurement": self.measurement}


def of_campaign(run: OpenCampaign) -> Contents:
    """Return the Contents of campaign.opened.OpenCampaign's output folder."""
    from csstsim.catalog.truth_bricks import brick_meta
    from csstsim.stages.masters import masters_recipe

    made = kinds(run)
    light = made["render"]
    tables = [{job.key for job in made[rule].made_for} for rule in ("measure", "extract")]
    frames = tuple(_frame(run, job, tables) for job in made["level0"].made_for)
    return Contents(
        paths=run.paths,
        frames=frames,
        bricks={pix: run.brick_recipe(pix) for pix in made["merge"].made_for},
        truth={pix: brick_meta(pix=pix, **run.universe_key()) for pix in made["truth"].made_for},
        masters={chip: masters_recipe(run, chip) for chip in made["masters"].made_for},
        light={path: run.recipe(job, "render") for job in light.made_for for path in light.files_of(job)},
        measurement=digest(run.measurement),
        calibrated=YES if made["calibrate"].made_for else MAYBE,
        joint=YES if run.config.measurement.joint else MAYBE,
        report=YES if made["report"].made_for else MAYBE,
        cat=YES if "cat" in run.config.truth else NO,
        others={
            path: kind.name
            for rule, kind in made.items()
            if rule not in CHECKED
            for one in kind.made_for
            for path in kind.files_of(one)
        },
    )


def _boresight(job: Job) -> Boresight:
    pointing = job.pointing
    return Boresight(pointing.ra, pointing.dec, pointing.pa)


def _frame(run: OpenCampaign, job: Job, tables: Iterable[Container[tuple[str, int]]]) -> ExpectedFrame:
    """Return the ExpectedFrame of a job. tables: keys of the jobs that are measured, and of the extracted ones."""
    window = job.window
    rays = run.steps[job.pointing.type].step("cosmic_rays")
    measured, extracted = tables
    return ExpectedFrame(
        obsid=job.obsid,
        chip=job.chip.id,
        filter=job.chip.filter,
        type=job.pointing.type,
        level0=run.paths.level0(job),
        recipe=run.recipe(job),
        rays_recipe=run.recipe(job, "readout"),
        window=(window.x0, window.x1, window.y0, window.y1),
        measured=YES if job.key in measured else NO,
        extracted=YES if job.key in extracted else NO,
        cosmic=YES if rays is not None and rays.param.save_cosmic_image else NO,
        boresight=_boresight(job),
        wcs=job.wcs,
        catalogue=run.paths.level0_catalogue(job) if "cat" in run.config.truth else None,
    )
