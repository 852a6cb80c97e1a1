"""The catalogue from which the light of neighbours under spectra is known, as a campaign's `measurement` says."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.errors import InputError
from csstsim.catalog.table import GALAXY, QUASAR, STAR, ObjectTable
from csstsim.measure.bricks.match import one_to_one

if TYPE_CHECKING:
    from csstsim.base.types import FloatArray, IntArray
    from csstsim.campaign.job import Job
    from csstsim.campaign.opened import OpenCampaign
    from csstsim.campaign.sections import ContaminationConfig
    from csstsim.measure.spectra.contamination import CataloguedLight
    from csstsim.measure.spectra.extract import Sources
    from csstsim.measure.spectra.spectral_model import SpectralModel

MATCH = 0.3  # arcsec: an entry of a table is one object of the truth at most, within this distance; the nearest first


def catalogued_light(
    run: OpenCampaign,
    job: Job,
    truth: ObjectTable,
    sources: Sources,
    orders: ObjectTable,
    model: SpectralModel,
    settings: ContaminationConfig,
) -> CataloguedLight:
    """Return the measure.spectra.contamination.CataloguedLight of a job's catalogue.

    truth: its table; sources, orders, model: as measure.spectra.extract.extract_spectra takes them; settings:
    campaign.sections.ContaminationConfig. Raises InputError for a catalogue without an object near the chip.
    """
    from csstsim.measure.spectra.contamination import CataloguedLight

    found: tuple[ObjectTable, Sources | None, IntArray]
    if settings.table is None:
        found = _of_truth(run, truth, sources, orders, settings.depth)
    else:
        found = _of_table(run, job, sources, truth)
    if len(found[0]) == 0:
        raise InputError(
            "the catalogue has no object whose light reaches the chip",
            file=run.file,
            key="measurement.contamination",
            value=str(settings.table or f"truth to {settings.depth:g} mag"),
            allowed="objects with a magnitude in one of the camera's bands, within the depth",
        )
    some, known, owner = found
    assert known is not None  # of these objects
    return CataloguedLight(some, known, model, owner)


def _of_truth(
    run: OpenCampaign, truth: ObjectTable, sources: Sources, orders: ObjectTable, depth: float
) -> tuple[ObjectTable, Sources, IntArray]:
    """Return (orders, Sources, owner): the truth's objects to a depth, their spectra from their magnitudes."""
    from csstsim.catalog.light.colours import colour_bins
    from csstsim.measure.spectra.extract import Sources

    filters = list(run.camera.bands.values())
    mags = np.stack([np.asarray(truth[f"mag_{band}"], float) for band in run.camera.bands], axis=1)
    brightest = np.where(np.isfinite(mags), mags, np.inf).min(axis=1, initial=np.inf)
    # What moves from one exposure to the next is in no catalogue
    known = (brightest <= depth) & np.isin(truth["obj_type"], (STAR, GALAXY, QUASAR))
    owner = np.where(known, np.arange(len(truth)), -1)
    light = Sources(sources.shapes, lambda rows, edges: colour_bins(mags[rows], filters, edges), sources.edges)
    return orders.take(known[orders["row"]]), light, owner


def _of_table(
    run: OpenCampaign, job: Job, sources: Sources, truth: ObjectTable
) -> tuple[ObjectTable, Sources | None, IntArray]:
    """Return the same of a table: its objects seen by this exposure, matched with those of the truth."""
    from csstsim.catalog.flags import NOT_DRAWN
    from csstsim.catalog.light.object_spectra import catalog_spectra
    from csstsim.catalog.own_table import TableCatalog
    from csstsim.measure.spectra.contamination import NOBODY, expected_orders
    from csstsim.measure.spectra.extract import Sources
    from csstsim.stages.parts.shapes import shapes_of
    from csstsim.stages.select import selected

    options = {"file": str(run.contamination_table), "instrument": run.config.instrument}
    catalog = TableCatalog({k: v for k, v in options.items() if v is not None}, run.region(job.exposure))
    table = selected(run, job.exposure, catalog)
    spectra = catalog_spectra(table, catalog)
    disperser = run.disperser(job)
    assert disperser is not None  # of a spectroscopic chip
    rows = np.flatnonzero((table["flags"] & NOT_DRAWN == 0) & np.isfinite(table["x"] + table["y"]))
    owner = np.full(len(truth), NOBODY)
    if len(rows) == 0:
        return ObjectTable({}), None, owner
    x, y = (np.asarray(table[axis][rows], float) for axis in "xy")
    orders = expected_orders(rows, x, y, spectra, disperser, job.pointing.exptime)
    reach = MATCH / run.camera.telescope.pixel_scale
    entry = owners(truth["x"], truth["y"], x, y, reach)
    owner[entry >= 0] = rows[entry[entry >= 0]]
    return orders, Sources(shapes_of(table, job.wcs), spectra, sources.edges), owner


def owners(x: FloatArray, y: FloatArray, known_x: FloatArray, known_y: FloatArray, reach: float) -> IntArray:
    """Return for each object of the truth the entry that is its own, (n,) int: one at most, of no other; -1: none.

    x, y (n,) and known_x, known_y (m,) px, NaN where there is no place; reach: px. The nearest pairs are taken first,
    so that an object without an entry does not get a neighbour's.
    """
    at = np.stack([x, y], axis=1).astype(float)
    known = np.stack([known_x, known_y], axis=1).astype(float)
    there = np.flatnonzero(np.isfinite(at).all(axis=1))
    entry = np.full(len(at), -1)
    entry[there] = one_to_one(at[there], known, np.full(len(there), reach))
    return entry
