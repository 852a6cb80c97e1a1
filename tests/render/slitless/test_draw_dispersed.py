"""A spectroscopic chip's objects: the tables of objects and of orders agree with the pixels."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.special import erf
from support.dispersed_sky import EXPTIME, Sky
from support.grating_scene import SPLIT, gaussian_psf, scene_of

from csstsim.catalog.flags import BAD_VALUE, OFF_CHIP, TRUNCATED_STAMP
from csstsim.catalog.light.object_spectra import catalog_spectra
from csstsim.instrument.chip import Window
from csstsim.optics.scatter.scattered_light import Scattered, scattered_light
from csstsim.render.far_wings import WHOLE
from csstsim.render.psf_table import make_table
from csstsim.render.settings import load_numbers
from csstsim.render.slitless import draw_dispersed as engine
from csstsim.render.slitless.methods import photons
from csstsim.render.slitless.traces import Traces

WINDOW = Window(4000, 7000, 4700, 5000)


@pytest.fixture(scope="module")
def dim_psf(tmp_path_factory):
    """A PSF set whose boxes hold 95% of the light."""
    return gaussian_psf(tmp_path_factory.mktemp("psf") / "g.h5", light=0.95)


@pytest.fixture(scope="module")
def sky(camera, make_pointing, observe, psf):
    """16 stars and galaxies of magnitude 18 to 23 about the window, and two on the split."""
    rng = np.random.default_rng(3)
    objects = []
    for k in range(16):
        shape = (
            {"type": "galaxy", "size_disk": 0.15, "size_bulge": 0.1, "bulge_frac": 0.2, "e1": 0.2} if k % 3 == 0 else {}
        )
        objects.append((rng.uniform(3000, 8000), rng.uniform(4690, 5010), {"id": k, "ab": rng.uniform(18, 23)} | shape))
    objects += [(SPLIT - 1.0, 4800.0, {"id": 50, "ab": 18.0}), (SPLIT + 3.0, 4900.0, {"id": 51, "ab": 19.0} | shape)]
    return Sky(camera, make_pointing(), observe(make_pointing()), psf, objects)


@pytest.mark.parametrize("fidelity", ["noise_free", "standard"])
def test_tables_hold_what_was_drawn(sky, tables, fidelity):
    """Whole electrons exactly, expected ones to 1e-6; boxes contain every pixel that is not empty."""
    objects = sky.select(WINDOW)
    image, drawn, orders, counted = sky.draw(objects, WINDOW, fidelity, tables)
    total = image.sum(dtype=float) + (0 if counted is None else counted.sum())
    assert (counted is None) == (fidelity == "noise_free")
    assert drawn["drawn"].sum() == pytest.approx(total, rel=1e-6)
    if counted is not None:
        assert set(drawn["method"]) >= {"photons"}
        assert drawn["drawn"][drawn["method"] == "photons"].sum() == counted.sum()
    by_row = np.bincount(orders["row"], orders["drawn"], len(objects))
    # Orders of less than an electron, none of it drawn as a whole, have no row
    assert np.abs(by_row - drawn["drawn"]).max() < 1.0
    assert by_row[drawn["method"] == "photons"].tolist() == drawn["drawn"][drawn["method"] == "photons"].tolist()
    inside = np.zeros(WINDOW.shape, bool)
    for x0, x1, y0, y1 in zip(*(orders[name] for name in ("x0", "x1", "y0", "y1")), strict=True):
        inside[max(y0 - WINDOW.y0, 0) : y1 - WINDOW.y0, max(x0 - WINDOW.x0, 0) : x1 - WINDOW.x0] = True
    assert image[~inside].sum(dtype=float) < 1.0
    assert counted is None or counted[~inside].sum() == 0
    lit = drawn["x1"] > 0
    assert lit[orders["row"]].all() and lit.sum() > 10
    for low, high in (("x0", "x1"), ("y0", "y1")):  # an object's box holds those of its orders
        assert (drawn[low][orders["row"]] <= orders[low]).all() and (drawn[high][orders["row"]] >= orders[high]).all()
    assert (drawn["x0"][lit] >= WINDOW.x0).all() and (drawn["x1"][lit] <= WINDOW.x1).all()
    assert drawn["fraction"] == pytest.approx(drawn["drawn"] / drawn["electrons"])


def test_orders_say_where_light_lands(sky, tables, camera):
    objects = sky.select(WINDOW)
    _, _, orders, _ = sky.draw(objects, WINDOW)
    rows = list(zip(orders["row"], orders["order"], strict=True))
    assert rows == sorted(rows)
    gratings = camera.gratings[29]
    light = catalog_spectra(objects, sky.catalog)(np.arange(len(objects)), sky.disperser.edges) * EXPTIME
    for k in range(len(orders)):
        row, number = orders["row"][k], orders["order"][k]
        piece = int(orders["grating"][k] == gratings.right.name)
        assert orders["grating"][k] in (gratings.left.name, gratings.right.name)
        order = (gratings.left, gratings.right)[piece].orders[number]
        assert orders["id"][k] == objects["id"][row] and orders["x"][k] == objects["x"][row]
        p, q, r, s = (orders[name][k] for name in "pqrs")
        assert order.lines(orders["x"][k], orders["y"][k]) == pytest.approx([p, q, r, s])
        electrons = light[row] @ sky.disperser.rates[piece, sky.disperser.orders.index(number)]
        assert orders["electrons"][k] == pytest.approx(electrons, rel=1e-9)
        # aXe's form of the same trace
        wave = 5500.0
        along = (wave - orders["alpha0"][k]) / orders["alpha1"][k] / np.hypot(1, orders["a1"][k])
        assert p + q * wave == pytest.approx(orders["xoff"][k] + along, abs=1e-9)
        assert r + s * wave == pytest.approx(orders["yoff"][k] + orders["a0"][k] + orders["a1"][k] * along, abs=1e-9)
        low, high = orders["wave_min"][k], orders["wave_max"][k]
        if low < high:  # the centre of the trace lands
            assert order.range[0] - 1 <= low < high <= order.range[1] + 1
            for wave in (low, high):
                x, y = orders["x"][k] + p + q * wave, orders["y"][k] + r + s * wave
                assert WINDOW.x0 - 0.6 < x < WINDOW.x1 - 0.4 and WINDOW.y0 - 0.6 < y < WINDOW.y1 - 0.4
    two = [row for row in range(len(objects)) if len(set(orders["grating"][orders["row"] == row])) == 2]
    assert set(objects["id"][two]) >= {50, 51} and orders["cut"][np.isin(orders["row"], two)].all()
    # Of both pieces together all light of the object is drawn, once
    first = orders["row"] == np.flatnonzero(objects["id"] == 50)[0]
    first &= orders["order"] == 0
    assert orders["drawn"][first].sum() == pytest.approx(orders["electrons"][first][0], rel=2e-3)


def test_photons_and_slabs_draw_one_scene(sky, tables):
    """All by slabs against all by photons: chi^2 over squares of 10 px of the chip, and object by object."""
    objects = sky.select(WINDOW)
    image, expected, *_ = sky.draw(objects, WINDOW)
    counted, drawn = None, None
    _, drawn, _, counted = sky.draw(objects, WINDOW, "standard", tables)
    assert (drawn["method"] == "photons").all()
    squares = [a.reshape(30, 10, 300, 10).sum(axis=(1, 3)) for a in (image, counted)]
    used = squares[0] > 20
    chi2 = ((squares[1] - squares[0])[used] ** 2 / squares[0][used]).sum()
    assert used.sum() > 300 and abs(chi2 - used.sum()) < 5 * np.sqrt(2 * used.sum())
    # The light of galaxies beyond their stamps: `lost`, five in a thousand at most
    error = 5 * np.sqrt(expected["drawn"] + 1) + 0.01 * expected["drawn"]
    assert (np.abs(drawn["drawn"] - expected["drawn"]) < error).all()


def test_the_error_of_coarse_bins_is_a_closed_form():
    """A line anywhere in a bin of a pixel, drawn spread over it: rms against a Gaussian PSF of sigma 0.75 px."""
    x, sigma = np.linspace(-10, 10, 20001), 0.75
    point = np.exp(-0.5 * (x / sigma) ** 2)
    spread = sigma * np.sqrt(np.pi / 2) * (erf((x + 0.5) / sigma / np.sqrt(2)) - erf((x - 0.5) / sigma / np.sqrt(2)))
    # The mean over positions of (point - spread)^2 is point^2 - spread^2, spread being the mean of the points
    error = np.sqrt(1 - (spread**2).sum() / (point**2).sum())
    assert load_numbers().error.bins == pytest.approx(error, rel=0.01)


@pytest.mark.thorough
def test_faint_objects_in_coarse_bins(camera, make_pointing, observe, psf, tables, monkeypatch):
    """Three hundred stars of 26.6 mag, S/N 0.36 each, by photons in bins of a pixel against slabs in bins of a quarter.

    chi^2 over squares of 10 px within 5 sigma; the brighter star among them keeps its fine bins.
    """
    crowd = [(5100.0 + 0.4 * k, 4850.0, {"id": k, "ab": 26.6}) for k in range(300)]
    bright = (5500.0, 4900.0, {"id": 5000, "ab": 20.0})
    sky = Sky(camera, make_pointing(), observe(make_pointing()), psf, [*crowd, bright])
    objects, bins = sky.select(WINDOW), {}
    real = photons.shoot_spectra

    def noted(canvas, scene, traces, *rest):
        bins.update(dict.fromkeys(scene.ids.tolist(), traces.spectra.shape[1]))
        return real(canvas, scene, traces, *rest)

    monkeypatch.setattr(photons, "shoot_spectra", noted)
    image, *_ = sky.draw(objects, WINDOW)
    _, drawn, _, counted = sky.draw(objects, WINDOW, "standard", tables)
    assert (drawn["method"] == "photons").all() and drawn["snr"][:300].max() < 0.1 / load_numbers().error.bins
    fine, coarse = (len(d.edges) - 1 for d in (sky.disperser, sky.disperser.coarse))
    assert bins.pop(5000) == fine and set(bins.values()) == {coarse} and fine > 3 * coarse
    squares = [a.reshape(30, 10, 300, 10).sum(axis=(1, 3)) for a in (image, counted)]
    used = squares[0] > 20
    chi2 = ((squares[1] - squares[0])[used] ** 2 / squares[0][used]).sum()
    assert used.sum() > 100 and abs(chi2 - used.sum()) < 5 * np.sqrt(2 * used.sum())


def test_chunks_and_company_change_no_bit_of_photons(sky, tables, monkeypatch):
    objects = sky.select(WINDOW)
    _, drawn, orders, counted = sky.draw(objects, WINDOW, "standard", tables)
    few = [replace(method, chunk=5, chunk_coarse=5) for method in engine.METHODS]
    monkeypatch.setattr(engine, "METHODS", few)
    _, again, orders_again, counted_again = sky.draw(objects, WINDOW, "standard", tables)
    assert (counted == counted_again).all() and (drawn["drawn"] == again["drawn"]).all()
    assert (orders["drawn"] == orders_again["drawn"]).all()
    turned = np.random.default_rng(1).permutation(len(objects))
    _, other, _, counted_turned = sky.draw(objects.take(turned), WINDOW, "standard", tables)
    assert (counted == counted_turned).all() and (other["drawn"] == drawn["drawn"][turned]).all()
    small = Window(4300, 5000, 4750, 4850)
    _, _, _, counted_small = sky.draw(objects, small, "standard", tables)
    assert (counted_small == counted[50:150, 300:1000]).all()
    _, _, _, different = sky.draw(objects, WINDOW, "standard", tables, key=6)
    assert (different != counted).any()


def test_losses_reach_both_planes(sky, tables):
    response = np.full(WINDOW.shape, 0.8, np.float32)
    objects = sky.select(WINDOW).take(slice(0, 5))
    whole, drawn, *_ = sky.draw(objects, WINDOW)
    image, less, *_ = sky.draw(objects, WINDOW, response=response)
    assert image.sum(dtype=float) == pytest.approx(0.8 * whole.sum(dtype=float), rel=1e-5)
    assert less["drawn"] == pytest.approx(0.8 * drawn["drawn"], rel=1e-4, abs=1e-6)
    counted = sky.draw(objects, WINDOW, "standard", tables, response=response)[3]
    assert abs(counted.sum() - image.sum(dtype=float)) < 5 * np.sqrt(counted.sum()) + 2e-3 * counted.sum()


def test_bright_ones_are_slabs_with_wings(camera, make_pointing, observe, dim_psf):
    """Magnitude 10: slabs in a standard run; what it draws is in its table, wings on the mesh too."""
    tables = make_table(dim_psf)
    there = Sky(camera, make_pointing(), observe(make_pointing()), dim_psf, [(4500.0, 4850.0, {"id": 1, "ab": 10.0})])
    scattered = Scattered(scattered_light(camera, camera.filters["GV"]).wing)
    objects = there.select(WINDOW, scattered=scattered)
    image, drawn, orders, counted = there.draw(objects, WINDOW, "standard", tables, scattered=scattered)
    assert drawn["method"][0] == "slabs" and counted is None
    assert drawn["drawn"][0] == pytest.approx(image.sum(dtype=float), rel=1e-5)
    assert drawn["stamp"][0] > 2 * drawn["wing"][0] > 500
    _, bare, *_ = there.draw(objects, WINDOW, "standard", tables)
    assert bare["flags"][0] & TRUNCATED_STAMP and not drawn["flags"][0] & TRUNCATED_STAMP
    # Its wing meets the other grating, and each order has a row of each whose light may land
    assert set(zip(orders["grating"], orders["order"], strict=True)) >= {("GV6", k) for k in (-1, 0, 1, 2)}
    assert orders["drawn"][orders["grating"] == "GV5"].sum() < 0.01 * drawn["drawn"][0]


def test_nothing_to_draw(sky, tables):
    objects = sky.select(WINDOW)
    for fidelity in ("noise_free", "standard"):
        image, drawn, orders, counted = sky.draw(objects.take(np.zeros(0, int)), WINDOW, fidelity, tables)
        assert len(drawn) == 0 and len(orders) == 0 and counted is None and not image.any()
        assert {"id", "row", "order", "grating", "p", "electrons", "drawn", "wave_min"} <= set(orders.names)
    away = Window(0, 50, 0, 50)
    image, drawn, orders, counted = sky.draw(objects, away)
    assert not image.any() and (drawn["flags"] & OFF_CHIP > 0).all() and (drawn["method"] == "none").all()
    assert len(orders) == 0
    dark = objects.with_columns(**{f"flux{i}": np.zeros(len(objects)) for i in range(4)})
    image, drawn, orders, _ = sky.draw(dark, WINDOW)
    assert not image.any() and (drawn["method"] == "none").all() and len(orders) == 0


@pytest.mark.parametrize("fidelity", ["standard", "noise_free"])
def test_light_that_nobody_announced_is_flagged(sky, tables, fidelity, monkeypatch):
    """Spectra 1e18 times as bright as the fluxes that the objects were selected by: none is drawn, all are flagged."""
    objects, real = sky.select(WINDOW), catalog_spectra(sky.select(WINDOW), sky.catalog)
    monkeypatch.setattr(
        "support.dispersed_sky.catalog_spectra", lambda *_: lambda rows, edges: 1e18 * real(rows, edges)
    )
    image, drawn, _, counted = sky.draw(objects, WINDOW, fidelity, tables)
    assert not image.any() and (counted is None or not counted.any())
    assert (drawn["flags"] & BAD_VALUE > 0).all() and (drawn["method"] == "none").all()


def test_the_range_of_wavelengths_on_a_window_is_that_of_its_edges():
    """Lines with a rising, a falling and no slope in x, one that rises in y, too; limits; one that misses. By hand."""
    window, limits = Window(100, 200, 40, 60), (3000.0, 9000.0)
    x, y = np.array([90.0, 210.0, 150.0, 90.0, 90.0, 50.0]), np.array([50.0, 50.0, 50.0, 35.0, 61.0, 50.0])
    lines = np.array([  # p, q, r, s
        [0.0, 0.01, 0.0, 0.0],  # x = 90 + 0.01 w: the edges, 99.5 and 199.5, at 950 and 10,950
        [0.0, -0.01, 0.0, 0.0],  # x = 210 - 0.01 w: 1050 to 11,050
        [0.0, 0.0, -15.0, 0.002],  # y = 35 + 0.002 w: 2250 to 12,250
        [-30.0, 0.02, 0.0, 0.002],  # x = 60 + 0.02 w: 1975 to 6975; y = 35 + 0.002 w: 2250 to 12,250
        [0.0, 0.01, 0.0, 0.0],  # y = 61 is beyond the window
        [-10.0, 0.01, 4.0, 0.001],  # x = 40 + 0.01 w: 5950 to 15,950; y = 54 + 0.001 w: up to 5500
    ]).T  # fmt: skip
    low, high = engine._range(lines, x, y, window, limits)
    assert low[:4] == pytest.approx([3000.0, 3000.0, 3000.0, 3000.0]) and high[:4] == pytest.approx([9000] * 3 + [6975])
    assert np.isnan(low[4:]).all() and np.isnan(high[4:]).all()
    low, high = engine._range(lines[:, :4], x[:4], y[:4], window, (0.0, 20_000.0))
    assert low == pytest.approx([950.0, 1050.0, 2250.0, 2250.0])
    assert high == pytest.approx([10_950.0, 11_050.0, 12_250.0, 6975.0])


def test_spectra_that_are_bad_are_told_from_those_that_are_bright():
    """Eleven bins, more than are summed side by side: negative, NaN, too bright by the last bin, and sound."""
    light = np.ones((5, 11))
    light[0, 10], light[1, 3], light[2, 10], light[3, 0] = -1e-9, np.nan, 1e6, -1e-9
    rates = np.arange(1.0, 12.0)
    before = light.copy()
    assert engine._bad(light, 2.0, rates, 1e6).tolist() == [True, True, True, True, False]
    assert not light[:4].any() and (light[4] == 2.0).all()
    assert engine._bad(before[4:].copy(), 2.0, rates, 132.0).tolist() == [False]  # 2 x 66 electrons
    assert engine._bad(before[4:].copy(), 2.0, rates, 131.9).tolist() == [True]


def test_electrons_of_orders_are_sums_over_bins():
    """Six rows, more than are summed at a time, in any order."""
    rng = np.random.default_rng(6)
    light, rates, rows = rng.random((4, 9)), rng.random((3, 9)), np.array([3, 0, 0, 2, 1, 3])
    np.testing.assert_allclose(engine._sums(light, rows, rates), light[rows] @ rates.T, rtol=1e-12)


def test_visits_of_a_chunk_are_numbered_within_it():
    visits = np.array([[0, 0, 0], [2, 0, 1], [2, 1, 1], [3, 1, 0], [1, 0, 0]])
    at, some = engine._visits_of(np.array([3, 2]), visits, 4)
    assert at.tolist() == [1, 2, 3] and some.tolist() == [[1, 0, 1], [1, 1, 1], [0, 1, 0]]


def test_traces_say_where_an_order_lands_and_what_is_cut(disperser, psf):
    scene = scene_of(psf, [3000.0, 5000.0], [700.0, 800.0])
    spectra = np.random.default_rng(1).random((2, len(disperser.edges) - 1))
    traces = Traces(spectra, np.array([[1, 0, 0], [0, 1, 1]]), disperser)
    light, x, y = traces.order(scene, 1, 2, np.array([10.0, 0.02, -5.0, 0.003]))
    middle = disperser.edges[:-1] + np.diff(disperser.edges) / 2
    np.testing.assert_allclose(light, spectra[0] * disperser.rates[1, 2])
    np.testing.assert_allclose(x, 3010.0 + 0.02 * middle)
    np.testing.assert_allclose(y, 695.0 + 0.003 * middle)
    assert traces.side(scene, 0) == WHOLE
    assert np.array_equal(traces.side(scene, 1), disperser.rectangles[1] - np.array([3000.0, 3000.0, 700.0, 700.0]))


def test_what_was_drawn_of_parts_is_told_of_their_objects():
    """Electrons and times add up; a box is around those of all parts that have one. Two orders, two pieces.

    Object 0 visits both pieces, object 1 one of them; part 2 is of object 0, part 3 of object 1, which it visits on a
    piece where the object itself is not.
    """
    visits = np.array([[0, 0], [0, 1], [1, 1], [2, 0], [2, 1], [3, 0], [3, 1]])
    disperser = SimpleNamespace(orders=[0, 1])
    result = engine._Result(visits, disperser)
    result.electrons[:] = np.arange(14.0).reshape(7, 2)
    result.drawn[:] = 10.0 + np.arange(14).reshape(7, 2)
    result.ms[:] = 2.0 ** np.arange(7)
    result.box[0] = [[10, 30, 5, 9], [0, 0, 0, 0]]
    result.box[3] = [[20, 44, 2, 7], [60, 70, 1, 3]]
    result.box[2] = [[7, 8, 30, 34], [0, 0, 0, 0]]
    result.box[6] = [[3, 5, 31, 39], [0, 0, 0, 0]]
    work = SimpleNamespace(
        visits=visits, result=result, disperser=disperser, count=2, scene=SimpleNamespace(parent=np.array([0, 1, 0, 1]))
    )
    mine, merged = engine._of_objects(work)
    assert mine.tolist() == [[0, 0], [0, 1], [1, 1]]
    assert merged.electrons.tolist() == [[6.0, 8.0], [10.0, 12.0], [16.0, 18.0]]
    assert merged.drawn.tolist() == [[26.0, 28.0], [30.0, 32.0], [36.0, 38.0]]
    assert merged.ms.tolist() == [1 + 8, 2 + 16, 4 + 64]
    assert merged.box[0].tolist() == [[10, 44, 2, 9], [60, 70, 1, 3]]
    assert merged.box[1].tolist() == [[0] * 4] * 2
    assert merged.box[2].tolist() == [[3, 8, 30, 39], [0] * 4]
