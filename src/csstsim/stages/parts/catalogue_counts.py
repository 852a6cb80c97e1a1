"""Numbers of stars and galaxies of the embedded catalogue on a brick and on a frame, for the gates of validate.

They are counted in the truth brick by position and magnitude, without the selection of the select stage.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.healpix import brick_centre
from csstsim.catalog.astrometry.reduction import apparent, at_epoch
from csstsim.catalog.table import ObjectTable
from csstsim.catalog.truth_bricks import AREA_DEG2
from csstsim.measure.bricks.validation.gates.counts import KINDS
from csstsim.universe.lensing.lensing import magnification

if TYPE_CHECKING:
    from csstsim.campaign.job import Job
    from csstsim.campaign.opened import OpenCampaign

LENSING = "kappa", "gamma1", "gamma2"
COLUMNS = ("ra", "dec", "obj_type", *LENSING)


class BrickObjects:
    """The objects of a truth brick of the embedded sky, read once for all frames on it.

    run: campaign.opened.OpenCampaign; pix: the brick. Raises InputError if its file is damaged.
    """

    def __init__(self, run: OpenCampaign, pix: int) -> None:
        self._run = run
        self._pix = pix
        bands = [f"mag_{band}" for band in run.camera.bands]
        self._table = ObjectTable.read(run.paths.truth(pix), (*COLUMNS, *bands))

    def on_frame(self, job: Job) -> dict[str, int]:
        """Return {kind: number} on a job's window and brighter than the campaign's limit; empty without magnitudes.

        Proper motion and parallax are left out: they move a few stars across the border of the window.
        """
        table = self._table
        band = f"mag_{job.chip.filter.lower()}"
        if band not in table:
            return {}
        direction = apparent(*at_epoch(table["ra"], table["dec"], job.observer), job.observer)
        x, y = job.wcs.world_to_pixel(*direction)
        window = job.window
        limit = self._run.catalog.mag_limit
        on_window = (x > window.x0 - 0.5) & (x < window.x1 - 0.5) & (y > window.y0 - 0.5) & (y < window.y1 - 0.5)
        if limit is not None:
            mu, _ = magnification(*(table[name] for name in LENSING))  # 1 for stars, whose columns are 0
            on_window &= table[band] - 2.5 * np.log10(mu) <= limit
        return {name: int((on_window & (table["obj_type"] == kind)).sum()) for name, kind in KINDS.items()}

    def laws(self) -> dict[str, tuple[int, float]]:
        """Return {kind: (number in the brick, number expected from the laws of the universe)}."""
        from csstsim.universe.galaxies.galaxies import cumulative_counts
        from csstsim.universe.stars.stars import expected_counts

        numbers = self._run.universe.numbers
        with self._run.universe.faults_of("stars"):
            stars = expected_counts(*brick_centre(self._pix), numbers["stars"], numbers["stars"]["limits"][1])
        expected = {"galaxies": cumulative_counts(numbers["galaxies"])[1][-1], "stars": float(stars)}
        kinds = self._table["obj_type"]
        return {name: (int((kinds == KINDS[name]).sum()), AREA_DEG2 * density) for name, density in expected.items()}


def brick_objects(run: OpenCampaign, pix: int) -> BrickObjects | None:
    """Return the BrickObjects of a brick; None for a user's catalogue, or if the brick's file is gone."""
    return BrickObjects(run, pix) if run.embedded and run.paths.truth(pix).exists() else None
