"""A small chip with an empty sky, and tables of objects on its pixels, for tests of injection."""

import numpy as np
from astropy.table import Table
from support.mini_campaign import POINTINGS, write_campaign

import csstsim
from csstsim.catalog.astrometry.reduction import icrs
from csstsim.detector.noise import add_poisson
from csstsim.simulation.state import State

OBSID, CHIP, SIDE = "10100000001", 9, 256
GEOMETRY = {"nx": SIDE, "ny": SIDE, "channel_nx": SIDE // 8, "channel_ny": SIDE // 2}


def simulation(folder, geometry=None, **changes):
    """Return a Simulation of one exposure of a small chip, its campaign and cache in a folder."""
    return csstsim.Simulation(write_campaign(folder, POINTINGS[:1], geometry or GEOMETRY, **changes), folder / "cache")


def objects(sim, x, y, mag, kind="star", chip=CHIP, **columns):
    """Return a table of objects at pixels x, y of a chip; behind a grating, where light would fall without it."""
    job = sim._run.job(OBSID, chip)
    x, y = (np.atleast_1d(np.asarray(v, float)) for v in (x, y))
    ra, dec = icrs(*job.wcs.pixel_to_world(x, y), job.observer)
    size = np.where(np.broadcast_to(kind, x.shape) == "galaxy", 0.3, 0.0)
    given = {"id": np.arange(1, len(x) + 1), "ra": ra, "dec": dec, "mag_r": np.broadcast_to(mag, x.shape)}
    return Table(given | {"type": np.broadcast_to(kind, x.shape), "size": size} | columns)


def empty(sim):
    """Return the Simulation without objects: its catalogue has one that is too faint for any light."""
    return sim.replace(catalog=objects(sim, SIDE / 2, SIDE / 2, 60.0, id=[10**9]))


def mixed(sim, count, bright=17.5, faint=25.0, seed=1, edge=10):
    """Return a table of stars and galaxies in turn at random positions, of magnitudes from bright to faint."""
    rng, job = np.random.default_rng(seed), sim._run.job(OBSID, CHIP)
    w = job.window
    x, y = rng.uniform(w.x0 + edge, w.x1 - edge, count), rng.uniform(w.y0 + edge, w.y1 - edge, count)
    kind = np.where(np.arange(count) % 2, "galaxy", "star")
    return objects(sim, x, y, rng.uniform(bright, faint, count), kind)


def read_out_with(run, job, sky, light=None):
    """Return the DN (float32, readout frame) of one readout of expected electrons `sky` and counted ones of a Light.

    Layers as the simulator runs them, noise included, before it rounds to whole DN.
    """
    state, streams = State.blank(job.exposure), run.streams(job)
    state.image = sky.copy()
    for step in run.steps["SCIE"].stage("readout"):
        if step.name == "poisson_and_dark":
            add_poisson(
                state.image, streams.layer(step.name).exposure_key("shot"),
                dark=state.chip.detector.dark * state.exposure.exptime, counted=state.take_counted(),
            )  # fmt: skip
            if light is not None:
                state.image.reshape(-1)[light.pixel] += light.electrons
        else:
            state = step.module.apply(state, step.param, streams.layer(step.name))
    return state.image
