"""The catalogue from which the light of neighbours under spectra is known, as set by a campaign's `measurement`."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from csstsim.base.errors import InputError
from csstsim.catalog.table import GALAXY, QUASAR, STAR, ObjectTable
from csstsim.measure.bricks.match import one_to_one

if TYPE_CHECKING:
    from csstsim.base.types import FloatArray, IntArray
    from csstsim.campaign.job import Job
    from csstsim.campaign.opened import OpenCampaign
    from csstsim.campaign.sections import ContaminationConfig
    from csstsim.catalog.own_table import TableCatalog
    from csstsim.measure.spectra.contamination import CataloguedLight
    from csstsim.measure.spectra.extract import Sources
    from csstsim.measure.spectra.spectral_model import SpectralModel

MATCH = 0.3  # arcsec: maximum distance between an entry of a table and an object of the truth, matched one to one


class _Catalogue(NamedTuple):
    """Table of orders of a catalogue's objects, their Sources (None without objects), and `owner`.

    owner (rows of the truth,): row in the catalogue of each object of the truth, -1 for none.
    """

    orders: ObjectTable
    sources: Sources | None
    owner: IntArray


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

    truth: its table; sources, orders, model: arguments of measure.spectra.extract.extract_spectra; settings:
    campaign.sections.ContaminationConfig. Raises InputError for a catalogue without an object near the chip.
    """
    from csstsim.measure.spectra.contamination import CataloguedLight

    if settings.table is None:
        catalogue = _of_truth(run, truth, sources, orders, settings.depth)
    else:
        catalogue = _of_table(run, job, sources, truth)
    if len(catalogue.orders) == 0:
        raise InputError(
            "the catalogue has no object whose light reaches the chip",
            file=run.file,
            key="measurement.contamination",
            value=str(settings.table or f"truth to {settings.depth:g} mag"),
            allowed="objects with a magnitude in one of the camera's bands, within the depth",
        )
    assert catalogue.sources is not None  # there are objects
    return CataloguedLight(catalogue.orders, catalogue.sources, model, catalogue.owner)


def _of_truth(run: OpenCampaign, truth: ObjectTable, sources: Sources, orders: ObjectTable, depth: float) -> _Catalogue:
    """Return the objects of the truth down to a depth [mag], with spectra from their magnitudes."""
    from csstsim.catalog.light.colours import colour_bins
    from csstsim.measure.spectra.extract import Sources

    filters = list(run.camera.bands.values())
    mags = np.stack([np.asarray(truth[f"mag_{band}"], float) for band in run.camera.bands], axis=1)
    brightest = np.where(np.isfinite(mags), mags, np.inf).min(axis=1, initial=np.inf)
    # Objects that move from one exposure to the next are in no catalogue
    known = (brightest <= depth) & np.isin(truth["obj_type"], (STAR, GALAXY, QUASAR))
    owner = np.where(known, np.arange(len(truth)), -1)
    light = Sources(sources.shapes, lambda rows, edges: colour_bins(mags[rows], filters, edges), sources.edges)
    return _Catalogue(orders.take(known[orders["row"]]), light, owner)


def check_contamination(run: OpenCampaign) -> None:
    """Open the table of measurement.contamination, if there is one. Raises InputError for a fault in it."""
    if run.config.measurement.contamination.table is not None and run.slitless_jobs:
        _own_table(run, run.slitless_jobs[0])


def _own_table(run: OpenCampaign, job: Job) -> TableCatalog:
    """Return the table of measurement.contamination."""
    from csstsim.catalog.own_table import TableCatalog

    options = {"file": str(run.contamination_table), "instrument": run.config.instrument}
    return TableCatalog({k: v for k, v in options.items() if v is not None}, run.region(job.exposure))


def _of_table(run: OpenCampaign, job: Job, sources: Sources, truth: ObjectTable) -> _Catalogue:
    """Return the objects of a table in this exposure, matched with those of the truth."""
    from csstsim.catalog.flags import NOT_RENDERED
    from csstsim.catalog.light.object_spectra import catalog_spectra
    from csstsim.measure.spectra.contamination import NOBODY, expected_orders
    from csstsim.measure.spectra.extract import Sources
    from csstsim.stages.parts.shapes import shapes_of
    from csstsim.stages.select import selected

    catalog = _own_table(run, job)
    table = selected(run, job.exposure, catalog)
    spectra = catalog_spectra(table, catalog)
    disperser = run.disperser(job)
    assert disperser is not None  # of a spectroscopic chip
    rows = np.flatnonzero((table["flags"] & NOT_RENDERED == 0) & np.isfinite(table["x"] + table["y"]))
    owner = np.full(len(truth), NOBODY)
    if len(rows) == 0:
        return _Catalogue(ObjectTable({}), None, owner)
    x, y = (np.asarray(table[axis][rows], float) for axis in "xy")
    orders = expected_orders(rows, x, y, spectra, disperser, job.pointing.exptime)
    reach = MATCH / run.camera.telescope.pixel_scale
    entry = owners(truth["x"], truth["y"], x, y, reach)
    owner[entry >= 0] = rows[entry[entry >= 0]]
    return _Catalogue(orders, Sources(shapes_of(table, job.wcs), spectra, sources.edges), owner)


def owners(x: FloatArray, y: FloatArray, known_x: FloatArray, known_y: FloatArray, reach: float) -> IntArray:
    """Return (n,) int: the catalogue entry of each object of the truth, -1 for none; an entry has one object at most.

    x, y (n,) and known_x, known_y (m,) px, NaN where the position is unknown; reach: px. The nearest pairs are matched
    first, so that an object without an entry does not get that of a neighbour.
    """
    positions = np.stack([x, y], axis=1).astype(float)
    known = np.stack([known_x, known_y], axis=1).astype(float)
    with_position = np.flatnonzero(np.isfinite(positions).all(axis=1))
    entry = np.full(len(positions), -1)
    entry[with_position] = one_to_one(positions[with_position], known, np.full(len(with_position), reach))
    return entry
