"""The light of neighbours under a spectrum: the frame of all objects less that of the object alone, without noise."""

from functools import partial

import numpy as np
import pytest
from astropy.table import Table

import csstsim
from csstsim.catalog.astrometry.reduction import icrs
from csstsim.measure.spectra.chosen_orders import Choice
from csstsim.measure.spectra.extract import DispersedImage, Sources, extract_spectra
from csstsim.measure.spectra.spectral_model import make_model
from csstsim.optics.scatter.scattered_light import read_scattered
from csstsim.stages.chip import light
from csstsim.stages.parts.shapes import shapes_of
from csstsim.stages.psf import open_psf
from csstsim.stages.render import object_spectra

pytestmark = pytest.mark.thorough

CHIP, WINDOW = 2, (3000, 4100, 4620, 4880)
SKY, READ_NOISE = 40.0, 5.0  # electron
MODEL = 0.005  # of the neighbours' light in the pixels of the aperture
LEFT = 0.01  # of the contamination: left in, or taken from, a spectrum from which it was subtracted
EXACT = 1e-3  # of the spectrum, where the drawn light itself is subtracted: a pixel more or less is taken for a ray
# x, y [px] without the grating, mag in i, half-light radius [arcsec], 0: a star. The first is the one that is measured.
OBJECTS = (
    (3100.3, 4750.2, 20.5, 0.30), (3150.0, 4752.6, 19.0, 0.0), (3040.7, 4747.1, 19.5, 0.45),
    (2900.2, 4756.5, 19.5, 0.21), (3350.9, 4743.3, 20.0, 0.0), (3220.4, 4761.0, 20.0, 0.6),
    (2700.0, 4739.0, 18.5, 0.12), (3600.5, 4750.0, 20.0, 0.35),
)  # fmt: skip


@pytest.fixture(scope="module")
def pair(tmp_path_factory):
    """(state of all objects, electrons of all and of the first alone, run, job)."""
    sim = csstsim.Simulation(cache=tmp_path_factory.mktemp("cache")).replace(
        fidelity="noise_free", window=WINDOW, psf={"grid": 2}, select={"types": ["SCIE"], "chips": [CHIP]},
        layers={"scie_obs": {"flat_fielding": False, "shutter_effect": False}, "sky_background": None},
    )  # fmt: skip
    obsid = sim.exposures["obsid"][0]
    x, y, mag, size = np.array(OBJECTS).T
    job = sim._run.job(obsid, CHIP)
    ra, dec = icrs(*job.wcs.pixel_to_world(x, y), job.observer)
    table = Table({
        "id": np.arange(1, len(x) + 1), "type": np.where(size > 0, "galaxy", "star"), "ra": ra, "dec": dec,
        "mag_g": mag + 0.6, "mag_r": mag + 0.3, "mag_i": mag, "size": size,
        "e1": 0.2 * (size > 0), "e2": -0.1 * (size > 0),
    })  # fmt: skip
    sims = [sim.replace(catalog=part) for part in (table, table[:1])]
    run = sims[0]._run
    job = run.job(obsid, CHIP)
    both, alone = light(run, job, log=lambda text: None), sims[1].light(obsid, CHIP)
    return both, both.image, alone.image, run, job


@pytest.fixture(scope="module")
def modelled(pair):
    """(orders, Sources, SpectralModel, PSF set, wing), as `csstsim extract` makes them."""
    both, _, _, run, job = pair
    psf = open_psf(run, job.chip)
    wing, photons = read_scattered(psf).wing, run.camera.telescope.area_m2 * job.pointing.exptime
    middle = 0.5 * (WINDOW[0] + WINDOW[1]), 0.5 * (WINDOW[2] + WINDOW[3])
    model = make_model(
        run.camera.gratings[CHIP], photons, psf.at(*middle), psf.oversampling, psf.wavelength, wing
    )  # fmt: skip
    spectra = object_spectra(run, job, both.truth)
    return both.orders, Sources(shapes_of(both.truth, job.wcs), spectra, run.disperser(job).edges), model, psf, wing


def image(modelled, window, mine=None, **given):
    orders, sources, model, *_ = modelled
    some = orders if mine is None else orders.take(orders["id"] == mine)
    return model.image(some, sources.shapes, sources.spectra, sources.edges, window, **given)


@pytest.mark.parametrize("half", [2, 4, 8])  # px
def test_the_model_has_the_light_of_the_drawn_pair(pair, modelled, half):
    """About the trace of the first order: to 0.5% in all columns together, to 2% in each twentieth of them."""
    _, both, alone, _, job = pair
    expected = image(modelled, job.window) - image(modelled, job.window, 1)
    orders = modelled[0]
    one = orders.take((orders["id"] == 1) & (orders["order"] == 1))
    x, y, p, q, r, s = (float(one[name][0]) for name in "xypqrs")
    columns = np.arange(int(x + p + q * 4100.0), int(x + p + q * 6200.0))
    rows = np.arange(job.window.y0, job.window.y1)[:, None]
    near = np.abs(rows - (y + r + s * (columns - x - p) / q)) < half
    drawn, model = ((plane[:, columns - job.window.x0] * near).sum(axis=0) for plane in (both - alone, expected))
    assert drawn.sum() > 5 * (alone[:, columns - job.window.x0] * near).sum()  # the neighbours are most of the light
    assert model.sum() == pytest.approx(drawn.sum(), rel=MODEL)
    parts = [np.array_split(plane, 20) for plane in (model, drawn)]
    ratios = [a.sum() / b.sum() for a, b in zip(*parts, strict=True)]
    assert ratios == pytest.approx(np.ones(20), abs=4 * MODEL)


def test_subtracted_light_is_gone_from_the_spectrum(pair, modelled):
    """The spectrum of the frame of all, neighbours subtracted, is that of the object alone."""
    _, both, alone, _, job = pair
    orders, sources, model, psf, wing = modelled
    marks = np.zeros(both.shape, np.uint8)
    others = partial(model.image, orders, sources.shapes, sources.spectra, sources.edges, job.window)

    def extracted(plane, *known):
        frame = DispersedImage(job.window, (plane + SKY).astype(np.float32), marks, None, READ_NOISE, *known)
        table = extract_spectra(frame, orders, sources, model, psf, wing, Choice(snr_min=0.0, ids=[1]))
        return {name: float(np.nansum(table[name])) for name in ("electrons", "box", "contamination")}

    lonely, found = extracted(alone), extracted(both, others)
    exact = extracted(both, both - alone, lambda one, here, faintest: np.zeros(here.shape, np.float32))
    for name in ("electrons", "box"):
        assert found["contamination"] > 5 * lonely[name]
        assert exact[name] == pytest.approx(lonely[name], rel=EXACT)
        assert found[name] == pytest.approx(lonely[name], abs=LEFT * found["contamination"])
