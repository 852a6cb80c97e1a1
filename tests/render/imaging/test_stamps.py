"""Points on their pixels, and a scene of points and galaxies: windows, losses, order, wings, refusals."""

import numpy as np
import pytest
from render.galaxies import scene_of, shaped
from support.canvases import blank

from csstsim.catalog.flags import OFF_CHIP, OUTSIDE_PSF_HULL
from csstsim.instrument.chip import Window
from csstsim.optics.psf.psf_file import pixel_response
from csstsim.optics.scatter.scattered_light import Scattered, read_scattered
from csstsim.render.imaging import stamps
from csstsim.render.imaging.stamper import Stamper
from csstsim.render.imaging.stamps import draw_scene

WINDOW = Window(4000, 4400, 5000, 5300)
ALL = 1e5  # electrons


def draw(psf, scene, reach=32, window=WINDOW, wing=0.0, dtype=np.float32, **more):
    canvas = blank(window, dtype, response=more.pop("response", None))
    return canvas.expected, draw_scene(canvas, scene.sized(reach, wing), psf, **more)


def mixed(psf, count, rng):
    """Half points, half galaxies of two sizes, also over the window's edges."""
    x, y = rng.uniform(3980, 4420, count), rng.uniform(4980, 5320, count)
    index = np.where(np.arange(count) % 2, 1.0, 0.0)
    return scene_of(psf, x, y, 1e4 * rng.uniform(1, 9, count), index, rng.choice([0.2, 0.4], count), shaped(0.5, 1.0))


def test_a_point_in_the_middle_of_a_pixel_is_sums_of_cells(psf_r, mixer):
    """No interpolation there: equal to the sums but for what is below zero in the coefficients."""
    image, drawn = draw(mixer, scene_of(psf_r, 4200, 5150, ALL, 0.0), reach=31)
    step = psf_r.oversampling
    response = pixel_response(psf_r.at(4200, 5150).mean(axis=0), step)
    table = ALL * response[response.shape[0] // 2 % step :: step, response.shape[0] // 2 % step :: step]
    middle = len(table) // 2
    table = table[middle - 31 : middle + 32, middle - 31 : middle + 32]
    assert np.abs(image[119:182, 169:232] - table).max() < 2e-5 * table.max()
    assert drawn.drawn[0] == pytest.approx(image.sum(dtype=float), rel=1e-6)
    assert drawn.box[0].tolist() == [4169, 4232, 5119, 5182]


@pytest.mark.parametrize("phase", [(0, 0), (0.5, 0.5), (0.25, -0.37), (-0.4999, 0.13)])
def test_a_point_keeps_its_light_and_place(psf_r, mixer, phase):
    """All of the box on the stamp: the light to 1e-6. First moments, whole box, to 3e-4 px (0.02 mas)."""
    x, y = 4200 + phase[0], 5150 + phase[1]
    image, _ = draw(mixer, scene_of(psf_r, x, y, ALL, 0.0), reach=34, dtype=np.float64)
    enclosed = psf_r.at(x, y).mean(axis=0)
    assert image.sum() == pytest.approx(ALL * enclosed.sum(), rel=1e-6)
    axis = (np.arange(256) - 127.5) / psf_r.oversampling
    rows, columns = np.indices(image.shape)
    for positions, at, along in ((columns, x - 4000, enclosed.sum(axis=0)), (rows, y - 5000, enclosed.sum(axis=1))):
        assert (positions * image).sum() / image.sum() - at == pytest.approx(along @ axis / along.sum(), abs=3e-4)


def test_a_window_is_a_crop(psf_r, mixer):
    """Of the whole scene; what was drawn adds up to the pixels, the boxes lie on the window."""
    scene = mixed(psf_r, 40, np.random.default_rng(1))
    image, drawn = draw(mixer, scene, reach=60)
    wide, _ = draw(mixer, scene, reach=60, window=Window(3800, 4600, 4800, 5500))
    assert np.abs(wide[200:500, 200:600] - image).max() < 2e-6 * image.max()
    assert drawn.drawn.sum() == pytest.approx(image.sum(dtype=float), rel=1e-6)
    assert (drawn.box[:, 0] >= 4000).all() and (drawn.box[:, 3] <= 5300).all()


def test_far_off_the_window_nothing_is_drawn(psf_r, mixer):
    scene = scene_of(psf_r, [7000, 4200, 3999.5], [5150, 9000, 4999.5], ALL, [0.0, 1.0, 0.0])
    image, drawn = draw(mixer, scene)
    assert list(drawn.flags & OFF_CHIP > 0) == [True, True, False]
    assert drawn.drawn[0] == drawn.drawn[1] == 0 and not drawn.box[:2].any()
    assert 0.15 * ALL < drawn.drawn[2] < 0.35 * ALL and image[32, 32] > 0 and not image[33:, 33:].any()


def test_no_object_and_no_light(psf_r, mixer):
    image, drawn = draw(mixer, scene_of(psf_r, [], [], np.zeros(0), np.zeros(0), np.zeros(0)))
    assert len(drawn.drawn) == 0 and drawn.box.shape == (0, 4) and not image.any()
    image, drawn = draw(mixer, scene_of(psf_r, [4200, 4250], 5150, 0.0, [0.0, 1.0]))
    assert not image.any() and not drawn.drawn.any() and not drawn.flags.any()


def test_kept_transforms_give_the_same_image(psf_r, monkeypatch):
    """Many galaxies in one cell of nodes or each by itself: the same to single precision; twice: the same bits."""
    scene = mixed(psf_r, 60, np.random.default_rng(2))
    many, one = draw(psf_r, scene)
    again, two = draw(psf_r, scene)
    assert np.array_equal(many, again) and np.array_equal(one.drawn, two.drawn)
    monkeypatch.setattr(stamps, "_MANY", 10**9)
    single, other = draw(psf_r, scene)
    assert np.abs(many - single).max() < 2e-6 * many.max() and other.drawn == pytest.approx(one.drawn, rel=1e-5)


def test_losses_and_precision(psf_r, mixer):
    """Half the response, half the light; a float64 plane has the same; sub-bands without light are left out."""
    scene = mixed(psf_r, 12, np.random.default_rng(3))
    image, drawn = draw(mixer, scene)
    half, less = draw(mixer, scene, response=np.full(WINDOW.shape, 0.5, np.float32))
    assert less.drawn == pytest.approx(0.5 * drawn.drawn) and half == pytest.approx(0.5 * image, abs=1e-3)
    double, _ = draw(mixer, scene, dtype=np.float64)
    assert np.abs(double - image).max() < 1e-6 * image.max()


def test_outside_the_nodes_is_said(psf_r, mixer):
    edge = Window(-50, 50, -50, 50)
    _, drawn = draw(mixer, scene_of(psf_r, [-20.0, 20.0], 20.0, ALL, 0.0), window=edge)
    assert list(drawn.flags & OUTSIDE_PSF_HULL > 0) == [True, False]


@pytest.mark.parametrize("index", [0.0, 1.0])
def test_a_bright_object_has_its_wing(psf_r, mixer, index):
    """Box faded out, wing faded in: all the light to 3e-4 within 280 px, no step at the edge of the box."""
    scattered, window = Scattered(read_scattered(psf_r).wing), Window(3900, 4501, 4850, 5451)
    scene = scene_of(psf_r, 4200.2, 5150.3, 1e8, index, 0.3)
    image, drawn = draw(mixer, scene, reach=60, window=window, wing=2000.0, scattered=scattered)
    r = np.hypot(np.arange(3900, 4501) - 4200.2, np.arange(4850, 5451)[:, None] - 5150.3)
    inside = image[r < 280].sum(dtype=float) / 1e8
    assert inside == pytest.approx(1 - scattered.wing.light_beyond(280.0).mean(), abs=3e-4)
    rings = np.array([image[(r >= k) & (r < k + 2)].mean() for k in range(40, 120, 2)])
    model = 1e8 * scattered.wing.profile(np.arange(41.0, 121, 2)).mean(axis=0)
    assert rings / model == pytest.approx(1.0, abs=0.02 if index == 0 else 0.1)
    assert drawn.drawn[0] == pytest.approx(image.sum(dtype=float), rel=1e-6)


def test_the_light_in_the_box_is_that_of_the_nodes_by_band(psf_r, mixer):
    """Two nodes of four, bands of different light; with a wing only what lies where the box is not faded out."""
    node, fraction = np.array([2, 0, 3, 1]), np.zeros((4, 4))
    fraction[0], fraction[3] = [1.0, 20.0, 300.0, 4000.0], [7.0, 0.0, 0.0, 500.0]
    wanted = fraction[0] @ psf_r.flux[2] + fraction[3] @ psf_r.flux[1]
    assert mixer.light(node, fraction, False) == pytest.approx(wanted, rel=1e-6)
    cells, per_pixel = psf_r.image.shape[-1], psf_r.oversampling
    assert mixer.half == cells / 2 / per_pixel
    r = np.hypot(*np.meshgrid(*[(np.arange(cells) - (cells - 1) / 2) / per_pixel] * 2))
    t = np.clip((r / mixer.half - 0.7) / 0.25, 0, 1)
    kept = 1 - t**3 * (10 - 15 * t + 6 * t**2)
    wanted = sum((fraction[k, :, None, None] * psf_r.node(n) * kept).sum() for k, n in ((0, 2), (3, 1)))
    assert mixer.light(node, fraction, True) == pytest.approx(wanted, rel=1e-5)


def test_stamps_are_as_large_as_the_box_where_there_is_no_wing(psf_r, mixer):
    """Of 9 px and 50 px half a side, without wings, with them, and for stamps alone."""
    scene = scene_of(psf_r, [4200.0, 4210.0], [5150.0, 5150.0], ALL, 0.0).sized(np.array([9, 50]))
    wing = read_scattered(psf_r).wing
    assert Stamper.of(mixer, scene, Scattered()).reach.tolist() == [32, 50]
    assert Stamper.of(mixer, scene, Scattered(wing)).reach.tolist() == [9, 50]
    alone = Stamper.of(mixer, scene, None)
    assert alone.reach.tolist() == [9, 50] and alone.core is None and not alone.plan.size.any()
    assert (
        Stamper.of(mixer, scene, Scattered()).core is None
        and Stamper.of(mixer, scene, Scattered(wing)).core is mixer.core
    )
