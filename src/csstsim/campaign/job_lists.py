"""The jobs, chips and bricks of a campaign for each rule of the workflow (base.stage_records: made_for)."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

from csstsim.catalog.selection.bricks import bricks_for

if TYPE_CHECKING:
    from csstsim.campaign.config import Campaign
    from csstsim.campaign.job import Job
    from csstsim.campaign.opened import OpenCampaign
    from csstsim.instrument.camera import Camera
    from csstsim.simulation.exposure import Exposure

MERGE_MARGIN_DEG = 2.0 / 3600.0  # a merged brick uses detections up to 2" beyond its border
CALIBRATIONS = "BIAS", "DARK", "FLAT"
MIN_CALIBRATIONS = 3  # exposures of each type: cosmic rays cannot be found with two
EDGE_PX = 3.0  # field distortion moves a chip's edges by up to 2.4 px from the straight line between the corners


class JobLists:
    """The part of an OpenCampaign that selects its `jobs` for each product."""

    if TYPE_CHECKING:  # attributes of an OpenCampaign
        camera: Camera
        config: Campaign

        @property
        def variants(self) -> tuple[OpenCampaign, ...]: ...  # noqa: D102

        @property
        def jobs(self) -> tuple[Job, ...]: ...  # noqa: D102

        @property
        def embedded(self) -> bool: ...  # noqa: D102

        def has_orders(self, job: Job) -> bool: ...  # noqa: D102

        def truth_bricks(self, exposure: Exposure | Job) -> tuple[int, ...]: ...  # noqa: D102

    @cached_property
    def science_jobs(self) -> tuple[Job, ...]:
        """The jobs of science exposures."""
        return tuple(job for job in self.jobs if job.pointing.type == "SCIE")

    @cached_property
    def science_exposures(self) -> dict[str, list[Job]]:
        """{obsid: its jobs} of the science exposures."""
        exposures: dict[str, list[Job]] = {}
        for job in self.science_jobs:
            exposures.setdefault(job.obsid, []).append(job)
        return exposures

    @cached_property
    def sky_chips(self) -> list[int]:
        """The numbers of the chips with science exposures, sorted: each has a PSF set."""
        return sorted({job.chip.id for job in self.science_jobs})

    @cached_property
    def sky_bricks(self) -> list[int]:
        """The bricks of the embedded universe that the jobs need, sorted."""
        return sorted({pix for job in self.science_jobs for pix in self.truth_bricks(job)} if self.embedded else ())

    @cached_property
    def imaging_jobs(self) -> tuple[Job, ...]:
        """The jobs that are measured: science exposures of imaging chips."""
        return tuple(job for job in self.science_jobs if job.chip.kind == "imaging")

    @cached_property
    def first_frames(self) -> tuple[Job, ...]:
        """The science job whose picture is made first, in a tuple: one of the middle band; () without science jobs."""
        bands = [name for name in self.camera.filters if any(job.chip.filter == name for job in self.imaging_jobs)]
        jobs = tuple(job for job in self.imaging_jobs if job.chip.filter == bands[len(bands) // 2])
        return (jobs or self.science_jobs)[:1]

    @property
    def calibrated_jobs(self) -> tuple[Job, ...]:
        """The jobs whose calibrated images are written."""
        return self.imaging_jobs if self.config.measurement.keep_calibrated else ()

    @cached_property
    def slitless_jobs(self) -> tuple[Job, ...]:
        """The jobs whose spectra are extracted: science exposures of spectroscopic chips."""
        return tuple(job for job in self.jobs if self.has_orders(job))

    @cached_property
    def calibration_jobs(self) -> dict[int, list[Job]]:
        """{chip: its jobs} of the chips with enough bias, dark and flat exposures for master frames."""
        chips: dict[int, list[Job]] = {}
        for job in self.jobs:
            if job.pointing.type != "SCIE" and job.window == job.chip.full_window:
                chips.setdefault(job.chip.id, []).append(job)
        return {
            chip: jobs
            for chip, jobs in chips.items()
            if min(sum(job.pointing.type == kind for job in jobs) for kind in CALIBRATIONS) >= MIN_CALIBRATIONS
        }

    @cached_property
    def merge_bricks(self) -> dict[int, list[Job]]:
        """{brick: its jobs} of the bricks that a measured window touches."""
        bricks: dict[int, list[Job]] = {}
        for job in self.imaging_jobs:
            for pix in bricks_for(*job.footprint(EDGE_PX), MERGE_MARGIN_DEG):
                bricks.setdefault(int(pix), []).append(job)
        return dict(sorted(bricks.items()))

    @property
    def reports(self) -> list[None]:
        """[None] for a campaign that has a report, else []."""
        return [None] if self.science_jobs else []

    @property
    def comparisons(self) -> list[None]:
        """[None] for a campaign with a page that compares its variants, else []."""
        return self.reports if self.variants else []
