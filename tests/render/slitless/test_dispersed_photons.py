"""Photons through a grating: electrons, positions and colours against sums by hand; fixed seeds, limits in sigma."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import ndtr
from support.canvases import counting
from support.grating_scene import GV, SIGMA_PX, SPLIT, by_hand, scene_of, spectrum_of

from csstsim.instrument.chip import Window
from csstsim.optics.gratings.dispersion import Disperser
from csstsim.optics.scatter.scattered_light import scattered_light
from csstsim.render.slitless import dispersed_photons
from csstsim.render.slitless.dispersed_photons import shoot_spectra
from csstsim.render.slitless.traces import Traces

SIGMA = 5.0
WINDOW = Window(1500, 6200, 4780, 4920)
X, Y = 3800.3, 4850.37


def shoot(scene, spectra, disperser, tables, key=1, window=WINDOW, reach=20.0, wing=None, **losses):
    """Return (counted, drawn, box) of objects, keys of their visits from `key` on."""
    canvas = counting(window, **losses)
    visits = disperser.visits(scene.x, scene.y, np.full(len(scene), reach))
    keys = np.uint64(key) + 2 * visits[:, 0].astype(np.uint64) + visits[:, 1].astype(np.uint64)
    spectra = np.broadcast_to(spectra, (len(scene), len(disperser.edges) - 1))
    return canvas.counted, *shoot_spectra(canvas, scene, Traces(spectra, visits, disperser), keys, tables, wing)


def chi(counted, expected, least=20):
    used = expected > least
    return (((counted - expected)[used] ** 2 / expected[used]).sum() - used.sum()) / np.sqrt(2 * used.sum())


def test_electrons_of_each_order_are_spectrum_times_throughput(psf, tables, disperser):
    """5 sigma at 2e6 electrons in the first order, and none is lost or counted twice."""
    spectrum = spectrum_of(disperser, 2e6)
    counted, drawn, box = shoot(scene_of(psf, X, Y), spectrum, disperser, tables)
    wanted = disperser.rates[0] @ spectrum
    assert (np.abs(drawn[0] - wanted) < SIGMA * np.sqrt(wanted)).all()
    assert counted.sum() == drawn.sum()
    rows, columns = np.nonzero(counted)
    x0, x1, y0, y1 = np.transpose(box[0])
    assert (x0.min(), x1.max()) == (columns.min() + WINDOW.x0, columns.max() + 1 + WINDOW.x0)
    assert (y0.min(), y1.max()) == (rows.min() + WINDOW.y0, rows.max() + 1 + WINDOW.y0)


@pytest.mark.parametrize("electrons", [1500.0, 2e6])
def test_every_pixel_of_all_orders(psf, tables, disperser, electrons):
    """Few electrons draw their bins one by one, many by bins' numbers: chi^2 of all pixels, mixed PSFs included."""
    spectrum = spectrum_of(disperser, electrons)
    expected = sum(by_hand(disperser, WINDOW, X, Y, spectrum * disperser.rates[0, o], o, 0) for o in range(5))
    repeats = int(2e6 / electrons)
    scene = scene_of(psf, np.full(repeats, X), np.full(repeats, Y))
    counted, *_ = shoot(scene, spectrum, disperser, tables, key=100)
    assert abs(chi(counted, repeats * expected)) < SIGMA
    assert (electrons < len(spectrum)) == (repeats > 1)


def test_both_ways_of_drawing_have_one_distribution(psf, tables, disperser):
    """400 spectra just below and just above the change, in 50 px of the trace: means and variances are the light's."""
    repeats, limit = 400, dispersed_photons._DENSE * (len(disperser.edges) - 1)
    window = Window(4300, 4800, 4840, 4860)  # the first order, most of its rows
    unit = spectrum_of(disperser, 1.0)
    total, scene = disperser.rates[0].sum(axis=0) @ unit, scene_of(psf, X, Y)
    for factor in (0.98, 1.02):
        spectrum = unit * (factor * limit / total)
        expected = by_hand(disperser, window, X, Y, spectrum * disperser.rates[0, 3], 3, 0)
        expected = expected.sum(axis=0).reshape(-1, 50).sum(axis=1)
        draws = np.array(
            [shoot(scene, spectrum, disperser, tables, key=9000 + 10 * k, window=window)[0] for k in range(repeats)]
        )
        draws = draws.sum(axis=1).reshape(repeats, -1, 50).sum(axis=2)
        lit = expected > 0.5
        mean, variance = draws.mean(axis=0)[lit], draws.var(axis=0, ddof=1)[lit]
        assert (np.abs(mean - expected[lit]) < SIGMA * np.sqrt(expected[lit] / repeats)).all()
        error = np.sqrt((2 * expected[lit] ** 2 + expected[lit]) / repeats)
        assert (np.abs(variance - expected[lit]) < SIGMA * error).all()


@pytest.mark.parametrize("electrons", [30.0, 20000.0])
def test_losses_thin_the_numbers_and_leave_them_poisson(psf, tables, disperser, electrons):
    repeats, window = 300, Window(4300, 4800, 4840, 4860)
    response = np.full(window.shape, 0.6, np.float32)
    response[:, ::2] = 1.04
    spectrum = spectrum_of(disperser, electrons)
    expected = by_hand(disperser, window, X, Y, spectrum * disperser.rates[0, 3], 3, 0)
    mean = (expected * response).sum()
    losses = {"response": response, "maximum": 1.05, "window": window}
    scene = scene_of(psf, X, Y)
    sums = np.array(
        [shoot(scene, spectrum, disperser, tables, 7000 + 10 * k, **losses)[1].sum() for k in range(repeats)]
    )
    assert abs(sums.mean() - mean) < SIGMA * np.sqrt(mean / repeats)
    assert abs(sums.var(ddof=1) - mean) < SIGMA * np.sqrt((2 * mean**2 + mean) / repeats)


def test_a_narrow_line_stands_on_the_trace_of_every_order_with_its_own_psf(psf, tables, disperser):
    """Centroid to 5 sigma, that is 0.01 px in the first order; width that of the mixture at the wavelength."""
    spectrum = spectrum_of(disperser, 2e6, 5500, 5501)
    bin = np.flatnonzero(spectrum)
    assert len(bin) == 1
    wave = 0.5 * (disperser.edges[bin[0]] + disperser.edges[bin[0] + 1])
    counted, drawn, box = shoot(scene_of(psf, X, Y), spectrum, disperser, tables)
    fraction = np.interp(wave, disperser.wavelengths, [0, 1, 2, 3])
    variance = np.interp(fraction, range(4), np.square(SIGMA_PX))
    for number, (x0, x1, y0, y1), electrons in zip(disperser.orders, box[0], drawn[0], strict=True):
        p, q, r, s = disperser.gratings.left.orders[number].lines(X, Y)
        image = counted[y0 - WINDOW.y0 : y1 - WINDOW.y0, x0 - WINDOW.x0 : x1 - WINDOW.x0]
        across, along = (np.indices(image.shape).reshape(2, -1) * image.ravel()).sum(axis=1) / image.sum()
        error = SIGMA * np.sqrt(variance / electrons)
        assert abs(along + x0 - (X + p + q * wave)) < error
        assert abs(across + y0 - (Y + r + s * wave)) < error
        spread = (image.sum(axis=1) * (np.arange(len(image)) - across) ** 2).sum() / image.sum() - 1 / 12
        assert abs(spread / variance - 1) < SIGMA * np.sqrt(2.5 / electrons)  # kurtosis of the mixture: below 3.5
    assert SIGMA * np.sqrt(variance / drawn[0, 3]) < 0.01


def test_a_galaxy_keeps_its_shape_along_and_across(psf, tables, disperser):
    """A line of an exponential disk under a matrix: second moments of the disk (<r^2> = 6 r_s^2) and the PSF."""
    matrix = np.array([[1.3, 0.4], [0.3, 0.7]])
    scene = scene_of(psf, X, Y, index=(1, 0), size=(0.25, 0), matrix=matrix)
    spectrum = spectrum_of(disperser, 1e6, 4972, 4973)
    counted, _, box = shoot(scene, spectrum, disperser, tables, reach=100.0)
    x0, x1, y0, y1 = box[0, 3]
    image = counted[y0 - WINDOW.y0 : y1 - WINDOW.y0, x0 - WINDOW.x0 : x1 - WINDOW.x0]
    v, u = (index - (index * image).sum() / image.sum() for index in np.indices(image.shape))
    b = 1.6783469900166612  # r_s = r_e / b
    shape = 3 * (0.25 / b) ** 2 * matrix @ matrix.T / 0.074**2
    # The nearer of two wavelengths is 4972 A: sigma 1.0 px; pixel 1/12
    wanted = shape + np.eye(2) * (1.0 + 1 / 12)
    for moment, value in ((u * u, wanted[0, 0]), (v * v, wanted[1, 1]), (u * v, wanted[0, 1])):
        found = (image * moment).sum() / image.sum()
        error = np.sqrt((image * (moment - found) ** 2).sum()) / image.sum()
        assert abs(found - value) < SIGMA * error
        assert abs(value) > 20 * error


def test_bits_do_not_depend_on_order_company_or_window(psf, tables, disperser):
    rng = np.random.default_rng(4)
    x, y = rng.uniform(2500, 5560, 30), rng.uniform(4800, 4900, 30)
    scene = scene_of(psf, x, y, index=(1, 4), bulge=0.3)
    spectra = np.outer(10 ** rng.uniform(0, 4, 30), spectrum_of(disperser, 1.0))
    visits = disperser.visits(x, y, np.full(30, 40.0))
    assert len(visits) > 30  # some meet both gratings
    keys = np.arange(len(visits), dtype=np.uint64) + np.uint64(77)

    def draw(rows, window=WINDOW):
        canvas = counting(window)
        objects, own = np.unique(visits[rows, 0], return_inverse=True)
        some = np.column_stack([own, visits[rows, 1:]])
        traces = Traces(spectra[objects], some, disperser)
        return canvas.counted, *shoot_spectra(canvas, scene.take(objects), traces, keys[rows], tables)

    whole, drawn, box = draw(np.arange(len(visits)))
    turned = rng.permutation(len(visits))
    again, drawn_again, box_again = draw(turned)
    assert (whole == again).all() and (drawn[turned] == drawn_again).all() and (box[turned] == box_again).all()
    parts = np.zeros_like(whole)
    for rows in np.array_split(np.arange(len(visits)), 7):
        parts += draw(rows)[0]
    assert (parts == whole).all()
    small = Window(3000, 3600, 4800, 4870)
    assert (draw(turned, small)[0] == whole[20:90, 1500:2100]).all()


@pytest.mark.parametrize("sersic", [(0, 0), (1, 0)])
def test_light_on_the_split_is_divided_as_the_direct_image_is(psf, tables, disperser, sersic):
    """A star and a wide disk 0.7 px left of the line: each grating gets the light of its side, and all is there."""
    x = SPLIT - 0.7
    scene = scene_of(psf, x, Y, index=sersic, size=(0.5, 0.3))
    spectrum = spectrum_of(disperser, 1e6, 5544, 5545)  # sigma 1.2 px
    window = Window(4000, 7200, 4600, 5100)
    _, drawn, _ = shoot(scene, spectrum, disperser, tables, window=window, reach=100.0)
    if not sersic[0]:
        left = ndtr(0.7 / 1.2)
    else:  # the marginal of an exponential disk, by its radii: P(u < a) for the angle's uniform
        radii = np.random.default_rng(1).gamma(2.0, 0.5 / 1.6783469900166612 / 0.074, 400000)
        angles = np.linspace(0, 2 * np.pi, 400000, endpoint=False)
        left = ndtr((0.7 - radii * np.cos(angles)) / 1.2).mean()
    for o, number in enumerate(disperser.orders):
        total = disperser.rates[0, o] @ spectrum
        if number not in (0, 1):
            continue
        sides = np.array([left, 1 - left]) * total
        assert (np.abs(drawn[:, o] - sides) < SIGMA * np.sqrt(sides) + 1e-3 * total).all()


def test_the_frame_takes_what_falls_in_it_exactly(camera, psf, tables, disperser):
    """Stars about each edge of the frame: the fraction of the star inside, and nothing from one far beyond."""
    (x0, _, y0, _), (_, x1, _, y1) = disperser.rectangles
    spectrum = spectrum_of(disperser, 1e5, 5544, 5545)
    window = Window(-3000, 12500, -700, 9900)  # all of it lands
    cases = [(x0 + 1, 4000, ndtr(1 / 1.2)), (x1 + 1, 4000, ndtr(-1 / 1.2)), (3000, y0 - 1, ndtr(-1 / 1.2)),
             (3000, y1 - 1, ndtr(1 / 1.2)), (x0 + 20, 3000, 1.0), (x1 + 20, 3000, 0.0)]  # fmt: skip
    for x, y, fraction in cases:
        drawn = shoot(scene_of(psf, x, y), spectrum, disperser, tables, window=window)[1]
        wanted = fraction * 1e5
        first = drawn[:, disperser.orders.index(1)].sum()
        assert abs(first - wanted) <= SIGMA * np.sqrt(wanted)


def test_a_star_1500_px_off_the_chip_sends_its_second_order(camera, psf, tables, disperser):
    """On the open side, x = -1500: second order where the trace says, with its electrons; no other order lands."""
    window = Window(0, 9216, 4700, 5000)
    spectrum = spectrum_of(disperser, 1e6)
    x, y = -1500.0, 4850.4
    counted, drawn, box = shoot(scene_of(psf, x, y), spectrum, disperser, tables, window=window)
    light = spectrum * disperser.rates[0, 4]
    expected = by_hand(disperser, window, x, y, light, 4, 0)
    assert 3000 < expected.sum() < light.sum()  # part of it falls next to the chip
    assert (drawn[0, :4] == 0).all()
    assert abs(drawn[0, 4] - expected.sum()) < SIGMA * np.sqrt(expected.sum())
    p, q, r, s = disperser.gratings.left.orders[2].lines(x, y)
    assert abs(box[0, 4, 1] - (x + p + q * disperser.gratings.left.orders[2].range[1])) < 40  # the last ones are few
    assert np.abs(0.5 * (box[0, 4, 2] + box[0, 4, 3] - 1) - (y + r + s * 6000)) < 2
    mean = (counted.sum(axis=0) * np.arange(9216)).sum() / counted.sum()
    spread = expected.sum(axis=0) @ (np.arange(9216) - mean) ** 2 / expected.sum()
    wanted = expected.sum(axis=0) @ np.arange(9216) / expected.sum()
    assert abs(mean - wanted) < SIGMA * np.sqrt(spread / expected.sum())
    # The other side's frame ends 654 px beyond the chip
    assert len(disperser.visits(np.array([9215 + 1500.0]), np.array([y]), np.array([64.0]))) == 0


def test_an_order_that_one_grating_lacks_is_dark(camera, psf, tables):
    gratings = camera.gratings[GV]
    for lacking in (-2, 2):
        fewer = replace(gratings.left, orders={k: v for k, v in gratings.left.orders.items() if k != lacking})
        disperser = Disperser(replace(gratings, left=fewer), camera.filters["GV"], camera.telescope)
        _, drawn, box = shoot(scene_of(psf, X, Y), spectrum_of(disperser, 1e6), disperser, tables)
        o = disperser.orders.index(lacking)
        assert drawn[0, o] == 0 and not box[0, o].any() and (np.delete(drawn[0], o) > 0).all()


@pytest.mark.thorough
def test_the_wing_adds_the_light_beyond_the_box(camera, psf, tables, disperser, tmp_path):
    """A PSF of 0.9 of the light: with a wing the rest is drawn outside the box, without it is lost."""
    wing = scattered_light(camera, camera.filters["GV"]).wing
    short = replace(tables, share=0.9 * tables.share)
    window = Window(0, 9216, 3000, 6700)
    spectrum = spectrum_of(disperser, 1e6, 5500, 5510)
    scene = scene_of(psf, X, Y)
    none, drawn, _ = shoot(scene, spectrum, disperser, short, window=window)
    some, more, _ = shoot(scene, spectrum, disperser, short, window=window, wing=wing)
    light = disperser.rates[0, 3] @ spectrum
    assert abs(drawn[0, 3] - 0.9 * light) < SIGMA * np.sqrt(light)
    inside = 1 - wing.light_beyond(1800.0).mean() / wing.light_beyond(16.0).mean()
    assert abs(more[0, 3] - light * (0.9 + 0.1 * inside)) < SIGMA * np.sqrt(light) + 0.005 * light
    rows = np.abs(np.arange(window.y0, window.y1) - Y) > 20
    assert none[rows].sum() == 0 and some[rows].sum() > 0.05 * light


def test_little_and_bad_light(psf, tables, disperser):
    scene, flat = scene_of(psf, X, Y), spectrum_of(disperser, 1.0)
    counted, drawn, box = shoot(scene, 0 * flat, disperser, tables)
    assert not counted.any() and not drawn.any() and not box.any()
    ones = sum(shoot(scene, flat, disperser, tables, key=50 + 3 * k)[1].sum() for k in range(1000))
    total = (disperser.rates[0] @ flat).sum() * 1000
    assert abs(ones - total) < SIGMA * np.sqrt(total)
    for value in (np.nan, np.inf, -1e-9):
        bad = flat.copy()
        bad[7] = value
        with pytest.raises(ValueError, match="negative or not finite"):
            shoot(scene, bad, disperser, tables)
    with pytest.raises(ValueError, match="x is not finite"):
        traces = Traces(flat[None], np.zeros((0, 3), np.int64), disperser)
        shoot_spectra(counting(WINDOW), replace(scene, x=np.array([np.nan])), traces, np.zeros(0, np.uint64), tables)
    none = scene.take(np.zeros(0, int))
    counted, drawn, box = shoot(none, np.zeros((0, len(flat))), disperser, tables)
    assert drawn.shape == (0, 5) and box.shape == (0, 5, 4) and not counted.any()


@pytest.mark.slow
def test_a_hundred_million_electrons(psf, tables, disperser):
    """1.2e8 in all, pixel by pixel; 30 ns each."""
    spectrum = spectrum_of(disperser, 1e8)
    expected = sum(by_hand(disperser, WINDOW, X, Y, spectrum * disperser.rates[0, o], o, 0) for o in range(5))
    counted, *_ = shoot(scene_of(psf, X, Y), spectrum, disperser, tables, key=5)
    assert abs(chi(counted, expected)) < SIGMA
    assert abs(counted.sum() - expected.sum()) < SIGMA * np.sqrt(expected.sum())


def test_the_guide_never_skips_a_bin():
    """Against numpy's search, spectra with gaps and single lines included."""
    rng = np.random.default_rng(2)
    for light in (
        rng.exponential(1, 1900),
        np.r_[np.zeros(500), 3.0, np.zeros(1000)],
        np.repeat([0.0, 1e-9, 5.0], 600),
    ):
        running = np.concatenate([[0.0], np.cumsum(light)])
        guide = np.empty(8193, np.uint16)
        entries = dispersed_photons._fill(guide, running, 1e6)
        at = rng.uniform(0, 1, 20000)
        wanted = np.searchsorted(running, at * running[-1], side="right") - 1
        started = guide[(at * entries).astype(int)]
        assert (started <= wanted).all() and (light[wanted] > 0).all()
        assert (light[guide[:entries]] > 0).all()


def test_few_electrons_stand_on_the_trace_as_many_do(psf, tables, disperser):
    """4000 objects of 500 electrons in one bin of the first order: centroid to 0.01 px, width that of PSF and bin."""
    spectrum = spectrum_of(disperser, 500.0, 5500, 5501)
    bin = np.flatnonzero(spectrum)[0]
    wave, width = disperser.edges[bin : bin + 2].mean(), np.diff(disperser.edges)[bin]
    scene = scene_of(psf, np.full(4000, X), np.full(4000, Y))
    counted, drawn, box = shoot(scene, spectrum, disperser, tables)
    p, q, r, s = disperser.gratings.left.orders[1].lines(X, Y)
    o = disperser.orders.index(1)
    x0, x1, y0, y1 = box[:, o, 0].min(), box[:, o, 1].max(), box[:, o, 2].min(), box[:, o, 3].max()
    image = counted[y0 - WINDOW.y0 : y1 - WINDOW.y0, x0 - WINDOW.x0 : x1 - WINDOW.x0].astype(float)
    rows, columns = np.indices(image.shape)
    along, across = ((image * at).sum() / image.sum() for at in (columns, rows))
    fraction = np.interp(wave, disperser.wavelengths, [0, 1, 2, 3])
    variance, electrons = np.interp(fraction, range(4), np.square(SIGMA_PX)), drawn[:, o].sum()
    error = SIGMA * np.sqrt(variance / electrons)
    assert error < 0.01 and electrons == image.sum()
    assert abs(along + x0 - (X + p + q * wave)) < error
    assert abs(across + y0 - (Y + r + s * wave)) < error
    wide = variance + (q * width) ** 2 / 12
    spread = (image * (columns - along) ** 2).sum() / image.sum() - 1 / 12
    assert abs(spread / wide - 1) < SIGMA * np.sqrt(2.5 / electrons)
