"""A galaxy whose bulge, disk and knots have separate spectra behind a grating: flux, positions, one row in truth."""

import numpy as np
import pytest
from support.canvases import blank
from support.dispersed_sky import EVERYWHERE, EXPTIME, NOISE, Sky

from csstsim.base.shipped import SHIPPED
from csstsim.catalog.galaxy_shapes.component_light import BULGE, KNOTS, ComponentLight
from csstsim.catalog.light.object_spectra import Spectra, catalog_spectra
from csstsim.instrument.chip import Window
from csstsim.optics.scatter.scattered_light import Scattered
from csstsim.render.drawing import Drawing
from csstsim.render.parts.trails import draw_trailed
from csstsim.render.slitless import draw_dispersed, reference_dispersed
from csstsim.universe.parameters import load_universe

X, Y = 2500.3, 4600.7
WINDOW = Window(2200, 2800, 4400, 4800)
EXACT, PIXEL, SIGMA = 1e-9, 2e-3, 5.0
STRIPS = 4300.0, 5900.0  # angstrom, of the first order
GALAXY = {
    "id": 7, "type": "galaxy", "ab": 18.0, "z": 0.1, "gal_type": 0, "size_disk": 1.2, "size_bulge": 0.15,
    "bulge_frac": 0.4, "knots": 4, "knots_frac": 0.15,
}  # fmt: skip


@pytest.fixture(scope="module")
def light():
    return ComponentLight(load_universe(SHIPPED / "universe"))


@pytest.fixture
def sky(camera, make_pointing, observe, psf):
    pointing = make_pointing()
    return Sky(camera, pointing, observe(pointing), psf, [(X, Y, GALAXY), (X + 90, Y + 60, {"id": 8, "ab": 19.0})])


def draw(sky, objects, gradients, fidelity="noise_free", tables=None, window=WINDOW):
    """Return (image, table, orders)."""
    canvas = blank(window, float)
    spectra = Spectra(objects, catalog_spectra(objects, sky.catalog)._load, gradients)
    drawing = Drawing(
        sky.wcs, sky.psf, EXPTIME, Scattered(), fidelity, NOISE.variance(EXPTIME), np.uint64(5), tables, sky.observer
    )
    function = reference_dispersed.draw_objects if fidelity == "reference" else draw_dispersed.draw_dispersed
    made = draw_trailed(function, canvas, objects, drawing, spectra, sky.disperser)
    return canvas.expected if canvas.counted is None else canvas.expected + canvas.counted, *made


@pytest.mark.thorough
def test_one_row_with_the_light_of_all_components(sky, light, tables):
    """Electrons are those of a galaxy of one spectrum; every fidelity draws the same."""
    objects = sky.select(EVERYWHERE)
    _, one, one_orders = draw(sky, objects, None)
    image, table, orders = draw(sky, objects, light)
    assert len(table) == 2 and table["id"].tolist() == one["id"].tolist()
    assert table["electrons"] == pytest.approx(one["electrons"], rel=EXACT)
    assert table["drawn"].sum() == pytest.approx(image.sum(), rel=EXACT)
    assert orders["order"].tolist() == one_orders["order"].tolist()
    assert orders["electrons"] == pytest.approx(one_orders["electrons"], rel=EXACT)
    close, *_ = draw(sky, objects, light, "reference")
    assert np.abs(image - close).max() < PIXEL * image.max()
    counted, drawn, _ = draw(sky, objects, light, "standard", tables)
    assert (drawn["method"] == "photons").all()
    filled = image > 20
    chi2 = ((counted - image)[filled] ** 2 / image[filled]).mean()
    assert chi2 == pytest.approx(1.0, abs=SIGMA * np.sqrt(2 / filled.sum()))


def test_the_truth_says_whose_electrons_they_are(sky, light):
    """Against sums over the bins of all orders; the star keeps its columns."""
    objects = sky.select(EVERYWHERE)
    _, table, _ = draw(sky, objects, light)
    row = np.flatnonzero(table["id"] == 7)
    edges = sky.disperser.edges
    visits = sky.disperser.visits(objects["x"], objects["y"], objects["reach"].astype(float))
    piece = visits[visits[:, 0] == row[0], 1][0]
    electrons = catalog_spectra(objects, sky.catalog)(row, edges)[0] * sky.disperser.rates[piece].sum(axis=0)
    fractions = electrons @ light.binned(objects.take(row), edges)[0] / electrons.sum()
    assert table["bulge_frac"][row[0]] == pytest.approx(fractions[BULGE], abs=1e-4)
    assert table["knots_frac"][row[0]] == pytest.approx(fractions[KNOTS], abs=1e-4)
    assert table["bulge_frac"][1 - row[0]] == 0 and table["knots_frac"][1 - row[0]] == 0


def test_the_spectrum_is_narrower_where_it_is_red(sky, light):
    """The compact bulge is red: the second moment across the dispersion falls with wavelength."""
    objects = sky.select(EVERYWHERE)
    alone = objects.take(np.flatnonzero(objects["id"] == 7))
    ratio = {}
    for name, gradients in (("one", None), ("three", light)):
        widths = []
        p, q, r, s = sky.disperser.gratings.left.orders[1].lines(np.array([X]), np.array([Y]))[0]
        for wave in STRIPS:
            x, y = round(X + p + q * wave), round(Y + r + s * wave)
            image, *_ = draw(sky, alone, gradients, window=Window(x - 20, x + 20, y - 60, y + 61))
            across, axis = image.sum(axis=1), np.arange(121)
            mean = (across * axis).sum() / across.sum()
            widths.append((across * (axis - mean) ** 2).sum() / across.sum())
        ratio[name] = widths[1] / widths[0]
    assert ratio["three"] < 0.9 and ratio["one"] == pytest.approx(1.0, abs=0.03)
