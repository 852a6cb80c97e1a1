"""The catalogue from which the light of neighbours under spectra is known, as a campaign's `measurement` says."""

import numpy as np

from csstsim.base.errors import InputError
from csstsim.catalog.table import GALAXY, QUASAR, STAR, ObjectTable

MATCH = 0.3  # arcsec: an entry of a table is the object of the truth that is nearest, within this distance


def catalogued_light(run, job, truth, sources, orders, model, settings):
    """Return the measure.spectra.contamination.CataloguedLight of a job's catalogue.

    truth: its table; sources, orders, model: as measure.spectra.extract.extract_spectra takes them; settings:
    campaign.sections.ContaminationConfig. Raises InputError for a catalogue without an object near the chip.
    """
    from csstsim.measure.spectra.contamination import CataloguedLight

    if settings.table is None:
        found = _of_truth(run, truth, sources, orders, settings.depth)
    else:
        found = _of_table(run, job, sources, truth)
    if len(found[0]) == 0:
        raise InputError(
            "the catalogue has no object whose light reaches the chip", file=run.file, key="measurement.contamination",
            value=str(settings.table or f"truth to {settings.depth:g} mag"),
            allowed="objects with a magnitude in one of the camera's bands, within the depth",
        )  # fmt: skip
    some, known, owner = found
    return CataloguedLight(some, known, model, owner)


def _of_truth(run, truth, sources, orders, depth):
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


def _of_table(run, job, sources, truth):
    """Return the same of a table: its objects seen by this exposure, matched with those of the truth."""
    from scipy.spatial import cKDTree

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
    spectra, disperser = catalog_spectra(table, catalog), run.disperser(job)
    rows = np.flatnonzero((table["flags"] & NOT_DRAWN == 0) & np.isfinite(table["x"] + table["y"]))
    owner = np.full(len(truth), NOBODY)
    if len(rows) == 0:
        return ObjectTable({}), None, owner
    x, y = (np.asarray(table[axis][rows], float) for axis in "xy")
    orders = expected_orders(rows, x, y, spectra, disperser, job.pointing.exptime)
    at = np.stack([truth["x"], truth["y"]], axis=1).astype(float)
    there = np.flatnonzero(np.isfinite(at).all(axis=1))
    distance, nearest = cKDTree(np.stack([x, y], axis=1)).query(at[there])
    near = distance <= MATCH / run.camera.telescope.pixel_scale
    owner[there[near]] = rows[nearest[near]]
    return orders, Sources(shapes_of(table, job.wcs), spectra, sources.edges), owner
