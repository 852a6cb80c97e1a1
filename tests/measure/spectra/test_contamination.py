"""Light of neighbours as a catalogue knows it, against spectra rendered one by one with numpy."""

from dataclasses import replace

import numpy as np
import pytest
from measure.slitless import EDGES, GaussianPsf, draw, frame_of, setting, sources_of, window_about

from csstsim.catalog.table import ObjectTable
from csstsim.instrument.chip import Window
from csstsim.instrument.filter import GRID
from csstsim.measure.spectra import contamination, extract, spectral_model
from csstsim.measure.spectra.chosen_orders import Choice
from csstsim.measure.spectra.contamination import NOBODY, CataloguedLight, expected_orders
from csstsim.measure.spectra.extract import extract_spectra
from csstsim.measure.spectra.spectrum_columns import DIM, IMAGED, LOST
from csstsim.optics.gratings.dispersion import Disperser
from csstsim.stages.parts.contamination import owners

PSF, EXPTIME = GaussianPsf(), 150.0
PLACES = [(2000.3, 4000.27), (2040.8, 4004.9)]  # traces 4.6 px apart: their light overlaps
WINDOW = window_about(*PLACES[0], 1, (500, 1000))


def smooth(level=0.5):
    return level * 6000.0 / GRID


@pytest.fixture(scope="module")
def pair(camera):
    """Two stars: (setting, their images one by one, sources)."""
    s, images = setting(camera, 2, WINDOW, PLACES), []
    for k, level in zip(np.flatnonzero(s.orders["order"] == 1), (0.5, 0.3), strict=True):
        images.append(np.zeros(WINDOW.shape))
        draw(images[-1], WINDOW, s.gratings, s.orders, smooth(level), k)
    return s, images, sources_of([smooth(0.5), smooth(0.3)])


@pytest.fixture(scope="module")
def disperser(camera):
    return Disperser(camera.gratings[2], camera.filters["GV"], camera.telescope)


def extracted(s, frame, sources, light=None, **options):
    if light is not None:
        others, image_of_one = light.functions(s.window)
        frame = replace(frame, others=others, image_of_one=image_of_one, **options)
    return extract_spectra(frame, s.orders, sources, s.model, PSF)


def catalogued(s, spectra, owner):
    """The CataloguedLight of the stars' positions with other spectra."""
    return CataloguedLight(s.orders, sources_of(spectra), s.model, np.array(owner))


def test_contamination_is_the_neighbour_rendered_alone(pair):
    """The light of the second star in the first one's optimal sum, measured by an extraction of its image alone."""
    s, images, sources = pair
    light = catalogued(s, [smooth(0.5), smooth(0.3)], [0, 1])
    table = extracted(s, frame_of(images[0] + images[1], WINDOW), sources, light)
    alone = extracted(s, frame_of(images[0], WINDOW), sources)
    mine, first = table["id"] == 100, alone["id"] == 100
    bright = alone["flags"][first] & DIM == 0
    box = table["electrons"][mine][bright].sum()
    assert box == pytest.approx(alone["electrons"][first][bright].sum(), rel=3e-3)
    # Both are sums with the same weights but for noise of the neighbour: 3%
    kept = extracted(s, frame_of(images[0] + images[1], WINDOW), sources, light, subtract=False)
    more = kept["box"][mine] - alone["box"][first]
    assert more[bright].sum() > 0.03 * box
    assert kept["contamination"][mine][bright].sum() == pytest.approx(
        table["contamination"][mine][bright].sum(), rel=0.2
    )


def test_what_is_not_subtracted_is_stated(pair):
    s, images, sources = pair
    frame, light = frame_of(images[0] + images[1], WINDOW), catalogued(s, [smooth(0.5), smooth(0.3)], [0, 1])
    plain, kept = extracted(s, frame, sources), extracted(s, frame, sources, light, subtract=False)
    same = np.isclose(kept["box"], plain["box"], rtol=1e-6, equal_nan=True)  # where the same pixels are rejected
    assert same.mean() > 0.95
    assert np.isnan(plain["contamination"]).all() and (kept["contamination"][kept["id"] == 100] > 0).mean() > 0.85


def test_the_objects_own_light_is_its_catalogue_entrys(pair):
    """A catalogue that is wrong by a factor about an object, and right about its neighbour, does it no harm."""
    s, images, sources = pair
    frame = frame_of(images[0] + images[1], WINDOW)
    right = extracted(s, frame, sources, catalogued(s, [smooth(0.5), smooth(0.3)], [0, 1]))
    wrong = extracted(s, frame, sources, catalogued(s, [smooth(2.0), smooth(0.3)], [0, 1]))
    first = right["id"] == 100
    scale = float(right["electrons"].max())
    assert wrong["electrons"][first] == pytest.approx(right["electrons"][first], abs=2e-3 * scale, nan_ok=True)


def test_an_object_that_the_catalogue_lacks_keeps_its_light(pair):
    s, images, sources = pair
    frame = frame_of(images[0] + images[1], WINDOW)
    light = catalogued(s, [smooth(0.0), smooth(0.3)], [NOBODY, 1])
    assert not light.image_of_one(s.orders.take(slice(0, 1)), WINDOW).any()
    table = extracted(s, frame, sources, light)
    mine = (table["id"] == 100) & (table["flags"] & DIM == 0)
    assert table["electrons"][mine].sum() == pytest.approx(table["model"][mine].sum(), rel=5e-3)


def test_alone_there_is_no_contamination(pair):
    s, images, sources = pair
    one = s.orders.take(s.orders["row"] == 0)
    light = CataloguedLight(one, sources, s.model, np.array([0, NOBODY]))
    others, image_of_one = light.functions(WINDOW)
    frame = replace(frame_of(images[0], WINDOW), others=others, image_of_one=image_of_one)
    table = extract_spectra(frame, one, sources, s.model, PSF)
    assert len(table) and not table["contamination"].any()


def test_a_catalogue_without_orders_gives_an_empty_image(pair):
    s, _, sources = pair
    light = CataloguedLight(s.orders.take(slice(0, 0)), sources, s.model, np.array([NOBODY, NOBODY]))
    assert not light.image(WINDOW).any() and not light.image_of_one(s.orders.take(slice(0, 1)), WINDOW).any()


def test_expected_orders_are_those_of_the_gratings(disperser):
    """Traces as the truth has them; electrons by the sum over 0.5 A; an object beyond the gratings' bounds has none."""
    x, y = np.array([2000.3, 6000.4, -500.0, 1e6]), np.array([4000.27, 12.5, 100.0, 0.0])
    spectra = sources_of([smooth(0.5), smooth(1.0), smooth(0.2), smooth(1.0)]).spectra
    orders = expected_orders(np.array([0, 1, 2, 3]), x, y, spectra, disperser, EXPTIME)
    assert set(orders["row"].tolist()) == {0, 1, 2} and (np.diff(orders["row"]) >= 0).all()
    gratings = {grating.name: grating for grating, _ in disperser.gratings.pieces}
    assert orders["grating"][0] != orders["grating"][orders["row"] == 1][0]
    for k in range(len(orders)):
        row = orders["row"][k]
        order = gratings[str(orders["grating"][k])].orders[int(orders["order"][k])]
        wanted = order.lines(x[row], y[row])
        assert [orders[name][k] for name in "pqrs"] == pytest.approx(wanted, rel=1e-12)
        level = (0.5, 1.0, 0.2)[row]
        electrons = np.trapezoid(order.throughput * smooth(level), GRID) * EXPTIME * disperser.area
        assert orders["electrons"][k] == pytest.approx(electrons, rel=2e-3)


def test_an_object_off_the_chip_contaminates_it(camera, disperser):
    """Its direct image is 400 px left of the chip, its first order lands on it: all of that light is in the image."""
    x, y = np.array([-400.0]), np.array([4000.3])
    spectra = sources_of([smooth(0.5)])
    orders = expected_orders(np.array([0]), x, y, spectra.spectra, disperser, EXPTIME)
    window = Window(0, 1500, 3900, 4100)
    s = setting(camera, 2, window, [(x[0], y[0])])
    light = CataloguedLight(orders, spectra, s.model, np.array([0])).image(window)
    first = np.flatnonzero(orders["order"] == 1)[0]
    assert orders["x"][first] < 0 < orders["x"][first] + orders["p"][first] + orders["q"][first] * 5000.0
    rendered = np.zeros(window.shape)
    for k in range(len(s.orders)):
        draw(rendered, window, s.gratings, s.orders, smooth(), k)
    assert light.sum() == pytest.approx(rendered.sum(), rel=5e-3) and rendered.sum() > 1e4


def test_orders_of_nothing_are_an_empty_table(disperser):
    nothing = np.zeros(0)
    orders = expected_orders(np.zeros(0, int), nothing, nothing, lambda rows, edges: None, disperser, EXPTIME)
    assert isinstance(orders, ObjectTable) and len(orders) == 0 and EDGES[0] > 0


@pytest.mark.parametrize(("image", "level", "flagged"), [(None, 0.3, ()), (1, 0.3, (100, 101)), (1, 0.003, (101,))])
def test_light_of_an_image_is_flagged(pair, image, level, flagged):
    """A spectrum of an image has IMAGED, and its neighbour if a tenth as much light of it is near."""
    s, images, _ = pair
    sources = sources_of([smooth(0.5), smooth(level)])
    if image is not None:
        sources.shapes.image[image] = True
    rendered = frame_of(images[0] + level / 0.3 * images[1], WINDOW)
    table = extract_spectra(rendered, s.orders, sources, s.model, PSF, choice=Choice(snr_min=0.0))
    for one in (100, 101):
        flags = table["flags"][(table["id"] == one) & (table["flags"] & (DIM | LOST) == 0)]
        fraction = np.mean(flags & IMAGED > 0)
        assert fraction > 0.85 if one in flagged else fraction < 0.02, (one, fraction)


def test_an_entry_is_one_object_s_at_most():
    """Two objects 2 px apart, of which the table has the second: the first has no entry; offsets of 0.1 px."""
    x, y = np.array([10.0, 12.0, np.nan, 50.0, 90.0]), np.array([5.0, 5.0, 5.0, 5.0, 5.0])
    known_x, known_y = np.array([50.0, 12.1, 10.0]), np.array([9.1, 5.0, 90.0])
    assert owners(x, y, known_x, known_y, 4.0).tolist() == [-1, 1, -1, -1, -1]
    assert owners(x, y, known_x, known_y, 4.2).tolist() == [-1, 1, -1, 0, -1]
    assert owners(x, y, np.array([11.5, 12.1]), np.array([5.0, 5.0]), 4.0).tolist() == [0, 1, -1, -1, -1]
    assert owners(x[:0], y[:0], known_x, known_y, 4.0).tolist() == []
    assert owners(x, y, known_x[:0], known_y[:0], 4.0).tolist() == [-1] * 5


@pytest.mark.parametrize("apart", [12.0, 20.0, 26.0, 34.0])
def test_light_of_others_in_the_boxes_of_the_spectra_is_that_in_the_whole_image(camera, apart):
    """A neighbour on the trace, in the strips of the sky, and beside them: the same as with all of its light."""
    places = [PLACES[0], (2040.8, 4000.27 + apart)]
    s, image = setting(camera, 2, WINDOW, places), np.zeros(WINDOW.shape)
    for k, level in zip(np.flatnonzero(s.orders["order"] == 1), (0.5, 3.0), strict=True):
        draw(image, WINDOW, s.gratings, s.orders, smooth(level), k)
    sources = sources_of([smooth(0.5), smooth(3.0)])
    light = CataloguedLight(s.orders, sources, s.model, np.array([0, 1]))
    others, image_of_one = light.functions(WINDOW)
    frame = replace(frame_of(image, WINDOW), image_of_one=image_of_one)
    choice = Choice(ids=[100])
    tables = []
    for given in (others, light.image(WINDOW, frame.faintest)):
        tables.append(extract_spectra(replace(frame, others=given), s.orders, sources, s.model, PSF, choice=choice))
    in_boxes, whole = tables
    assert len(whole) > 300
    for name in ("electrons", "box", "sky", "contamination"):
        assert in_boxes[name] == pytest.approx(whole[name], rel=1e-6, nan_ok=True), name


def test_how_many_objects_are_computed_at_a_time_changes_nothing(pair, disperser, monkeypatch):
    """One by one: spectra of each, images, and the orders that a catalogue is expected to have."""
    s, images, sources = pair
    frame = frame_of(images[0] + images[1], WINDOW)
    x, y = np.transpose(PLACES)

    def all_of_it():
        light = catalogued(s, [smooth(0.5), smooth(0.3)], [0, 1])
        table = extracted(s, frame, sources, light)
        expected = expected_orders(np.arange(2), x, y, sources.spectra, disperser, EXPTIME)
        return (
            {"image": light.image(WINDOW)}
            | {f"table {k}": table[k] for k in table}
            | {k: expected[k] for k in expected}
        )

    together = all_of_it()
    for module in (contamination, extract, spectral_model):
        monkeypatch.setattr(module, "CHUNK", 1)
    one_by_one = all_of_it()
    assert together.keys() == one_by_one.keys() and together["image"].sum() > 1e4
    for name, values in together.items():
        assert np.array_equal(values, one_by_one[name], equal_nan=values.dtype.kind == "f"), name


def test_expected_electrons_are_those_of_the_exposure(disperser):
    x, y = np.transpose(PLACES)
    spectra = sources_of([smooth(0.5), smooth(1.0)]).spectra
    short, long = (expected_orders(np.arange(2), x, y, spectra, disperser, time) for time in (100.0, 300.0))
    assert len(short) and long["electrons"] == pytest.approx(3 * short["electrons"])
