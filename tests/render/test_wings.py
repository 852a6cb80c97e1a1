"""Bright stars on a chip: conservation of light, no edge, stars on and off its edge, ghosts."""

from dataclasses import replace

import numpy as np
import pytest
from render.imaging.test_reference import EXPTIME, objects
from support.canvases import blank

from csstsim.base.rng import Streams
from csstsim.catalog.flags import OFF_CHIP, TRUNCATED_STAMP
from csstsim.catalog.selection.reach import wing_reach
from csstsim.catalog.table import GALAXY
from csstsim.instrument.chip import Window
from csstsim.layers import scie_obs
from csstsim.optics.geometry.wcs import ChipWCS
from csstsim.optics.scatter.scattered_light import Scattered, read_scattered
from csstsim.render.drawing import Drawing
from csstsim.render.imaging.reference import draw_objects
from csstsim.render.imaging.stamps import draw_scene
from csstsim.render.scene import make_scene
from csstsim.render.wing_tables import RADII, annuli, light_of, step
from csstsim.render.wings import (
    add_ghosts,
    box_on_window,
    core_fraction,
    near_light,
    near_of,
    ring_within,
    wing_beyond,
    wing_scale,
)
from csstsim.simulation.exposure import Exposure
from csstsim.simulation.state import State

VARIANCE = 60.0  # e-^2, of a pixel in r
SKY = np.sqrt(VARIANCE)
X, Y = 4600.3, 4500.4


@pytest.fixture(scope="module")
def scene(camera, make_pointing, psf_r):
    """Draw stars of given electrons on a window of chip 9; returns the image, the table and their ScatteredLight."""
    wcs, whole = ChipWCS(camera.chips[9], make_pointing()), read_scattered(psf_r)

    def draw(electrons, window, x=X, y=Y, ghosts=False, wings=True):
        electrons = np.broadcast_to(np.asarray(electrons, float), np.shape(np.atleast_1d(x)))
        wing = wing_reach(electrons, VARIANCE, whole.wing)
        table = objects(wcs, x, y, wing=np.where(wing > 64, wing, 0.0))
        table = table.with_columns(**{f"flux{i}": electrons / EXPTIME / 4 for i in range(4)})
        scattered = Scattered(whole.wing if wings else None, whole.ghosts if ghosts else None)
        canvas = blank(window)
        return canvas.expected, draw_objects(canvas, table, Drawing(wcs, psf_r, EXPTIME, scattered)), whole

    return draw


def around(half):
    x, y = round(X), round(Y)
    return Window(x - half, x + half + 1, y - half, y + half + 1)


def distance(window):
    return np.hypot(np.arange(window.x0, window.x1) - X, np.arange(window.y0, window.y1)[:, None] - Y)


@pytest.mark.parametrize("electrons, half", [(1e3, 600), (1e5, 600), (1e6, 600), (1e8, 1000), (1e10, 1000)])
def test_the_light_is_all_there(scene, electrons, half):
    """Inside the circle: 1 less what the closed form has outside, to 1e-4 of the star."""
    image, drawn, scattered = scene(electrons, around(half))
    reach = float(half)
    inside = image[distance(around(half)) < reach].sum(dtype=float) / electrons
    assert inside == pytest.approx(1 - scattered.wing.light_beyond(reach).mean(), abs=1e-4)
    assert drawn["drawn"][0] == pytest.approx(image.sum(dtype=float), rel=1e-6)
    assert drawn["fraction"][0] == pytest.approx(drawn["drawn"][0] / electrons)


@pytest.mark.parametrize("electrons", [1e6, 1e8, 1e10, 4e10])
def test_the_rings_follow_the_profile_through_the_join(scene, electrons):
    """Mean of rings 2 px wide from 40 to 80 px: the closed form to 1%, with no step above 0.3% from ring to ring."""
    window = around(85)
    image, _, scattered = scene(electrons, window)
    r = distance(window)
    ratio = image / (electrons * scattered.wing.profile(np.maximum(r, 1)).mean(axis=0))
    rings = np.array([ratio[(r >= k) & (r < k + 2)].mean() for k in range(40, 80, 2)])
    assert rings == pytest.approx(1.0, abs=0.01)
    assert np.abs(np.diff(rings)).max() < 3e-3


@pytest.mark.parametrize("size", [0.2, 1.0])
def test_a_bright_galaxy_has_the_wing_of_its_light(camera, make_pointing, psf_r, size):
    """Half-light radius 3 and 14 px, 1e8 e-: all the light to 3e-4; far out the wings of all its points, to 1%."""
    wcs, scattered, window = (
        ChipWCS(camera.chips[9], make_pointing()),
        Scattered(read_scattered(psf_r).wing),
        around(400),
    )
    table = objects(wcs, X, Y, obj_type=GALAXY, reach=300, size_disk=size, rate=1e6, wing=np.full(1, 1500.0))
    canvas = blank(window)
    draw_objects(canvas, table, Drawing(wcs, psf_r, EXPTIME, scattered))
    image = canvas.expected
    r = distance(window)
    assert image[r < 390].sum(dtype=float) / 1e8 == pytest.approx(1 - scattered.wing.light_beyond(390).mean(), abs=3e-4)
    ring = (r > 150) & (r < 160)
    rng = np.random.default_rng(3)  # an exponential disc: radii are gamma variates of shape 2
    points = rng.gamma(2.0, size / 0.074 / 1.6783, 20_000) * np.exp(2j * np.pi * rng.random(20_000))
    expected = np.mean(
        [scattered.wing.profile(np.abs(155.0 * turn - points)).mean() for turn in np.exp(1j * np.arange(6))]
    )
    at_155 = image[ring].mean() * scattered.wing.profile(155.0) / scattered.wing.profile(r[ring]).mean()
    assert at_155 == pytest.approx(1e8 * expected, rel=0.01)


def test_no_wing_is_an_edge(scene):
    """The test above can fail: the box alone ends 1e4 times above the noise's thousandth."""
    image, drawn, _ = scene(1e8, around(85), wings=False)
    assert np.abs(np.diff(image[85, 80:170].astype(float))).max() > 10 * SKY
    assert drawn["flags"][0] & TRUNCATED_STAMP


@pytest.mark.parametrize("electrons", [1e2, 1e5, 1e7, 1e9])
def test_a_wing_has_no_end(scene, electrons):
    """9000 px away it is that of the closed form to 1e-3, bright star or faint, and it falls all the way."""
    window = Window(round(X), 9216, round(Y), round(Y) + 1)
    line, scattered = scene(electrons, window)[0][0].astype(float), scene(0.0, around(1))[2]
    r = np.hypot(np.arange(window.x0, window.x1) - X, round(Y) - Y)
    far = r > 100
    assert line[far] == pytest.approx(electrons * scattered.wing.profile(r[far]).mean(axis=0), rel=1e-3)
    assert (np.diff(line[r > 60]) < 0).all()


def test_a_star_off_the_chip_lights_its_edge(scene):
    """The same pixels as of a larger window: at an edge, over a corner, and beyond one."""
    large = Window(4000, 4800, 4000, 4800)
    for x, y in ((3999.2, 4300.0), (3999.5, 3999.5), (3800.0, 3700.0)):
        cut = Window(4000, 4400, 4000, 4400)
        whole, _, _ = scene(1e9, large, x=x, y=y)
        image, drawn, _ = scene(1e9, cut, x=x, y=y)
        assert np.abs(image - whole[:400, :400]).max() <= 1e-6 * whole.max()
        assert 0 < drawn["fraction"][0] < 0.8 and not drawn["flags"][0] & OFF_CHIP
        assert drawn["drawn"][0] == pytest.approx(image.sum(dtype=float), rel=1e-5)
        assert list(drawn[name][0] for name in ("x0", "x1", "y0", "y1")) == [4000, 4400, 4000, 4400]
    _, drawn, _ = scene(1e6, cut, x=2000.0, y=2000.0)
    assert drawn["flags"][0] & OFF_CHIP and drawn["drawn"][0] == 0


def test_no_light_and_a_great_deal(scene):
    image, drawn, _ = scene(0.0, around(50), ghosts=True)
    assert not image.any() and drawn["wing"][0] == 0 and drawn["fraction"][0] == 0
    image, drawn, _ = scene(1e14, around(50), ghosts=True)
    assert np.isfinite(image).all() and 0.9 < drawn["fraction"][0] < 1


def test_ghosts_lie_where_geometry_says_and_hold_their_light(scene, camera):
    window = around(900)
    plain, _, _ = scene(1e9, window)
    image, drawn, scattered = scene(1e9, window, ghosts=True)
    extra = (image - plain).astype(float)
    g = scattered.ghosts
    centres = g.centres(camera.chips[9], X, Y) - [window.x0, window.y0]
    light = g.light * 1e9
    assert extra.sum() == pytest.approx(light.sum(), rel=1e-3)
    rows, columns = np.indices(extra.shape)
    assert (extra * columns).sum() / extra.sum() == pytest.approx((light * centres[:, 0]).sum() / light.sum(), abs=1)
    assert (extra * rows).sum() / extra.sum() == pytest.approx((light * centres[:, 1]).sum() / light.sum(), abs=1)
    assert drawn["fraction"][0] - 1 + scattered.wing.light_beyond(1016.0).mean() == pytest.approx(
        g.light.sum(), abs=1e-4
    )
    faint, _, _ = scene(1e6, window, ghosts=True)
    assert np.array_equal(faint, scene(1e6, window)[0])


@pytest.mark.parametrize("centre", [(300.0, 300.0), (300.4, 299.7), (300.5, 300.25)])
def test_a_disc_is_uniform_and_holds_its_light(camera, scene, centre):
    scattered = scene(0.0, around(1))[2]
    one = replace(scattered.ghosts, way=np.zeros(1), radius=np.array([80.0]), light=np.array([1e-3]))
    canvas = blank(Window(0, 600, 0, 600), float)
    image = canvas.expected
    [(total, box)] = add_ghosts(canvas, camera.chips[9], centre, 1e9, one)
    assert total == pytest.approx(1e6, rel=5e-5) and image.sum() == pytest.approx(total)
    r = np.hypot(np.arange(600) - centre[0], np.arange(600)[:, None] - centre[1])
    assert image[r < 79.5] == pytest.approx(1e6 / np.pi / 80.0**2, rel=1e-4) and not image[r > 80.5].any()
    assert box[1] - box[0] in (161, 162)


@pytest.mark.parametrize("shows", [True, False])
def test_a_far_holds_the_light_it_says(scene, shows):
    """Beyond the box the profile itself; in all, what a sum over pixels and the closed form beyond have: 1e-4."""
    wing = scene(0.0, around(1))[2].wing
    far, r = wing_beyond(wing, 64.0, shows), np.hypot(np.arange(-400, 401), np.arange(-400, 401)[:, None])
    [(table, first, _)] = annuli(far, ())
    assert first == 1023 << 7 and table.shape == far.profile.shape
    radii = np.sqrt(np.ldexp(1 + np.arange(128) / 128, np.arange(32)[:, None])).ravel()
    lit = (radii > 0.95 * 64) & (radii < 2e4)
    assert table[:, :-1][:, lit] == pytest.approx(wing.profile(radii[lit]), rel=1e-12)
    values = np.interp(r, radii, table[0, :-1])
    within = values[r < 400].sum() + wing.light_beyond(400.0)[0]
    assert far.light[0] == pytest.approx(within, rel=1e-3)
    assert step(np.array([0, 45, 53.0, 61, 99]), 45, 61) == pytest.approx([1, 1, 0.5, 0, 0])
    kept = core_fraction(256, 2)
    assert kept[128, 128] == 1 and kept[0, 0] == 0


def test_annuli_add_up_and_follow_one_another(scene):
    """Of any edges, in order or not, an annulus empty or not: together the profile, each within its own radii."""
    far = wing_beyond(scene(0.0, around(1))[2].wing, 32.0)
    for edges in ((48.0, 192.0, 384.0), (0.0, 192.0), (3000.0, 192.0, 384.0), ()):
        total = np.zeros(far.profile.shape)
        for table, first, reach in annuli(far, edges):
            at = first - (1023 << 7)
            total[:, at : at + table.shape[1]] += table if reach else 0.0
        assert total == pytest.approx(far.profile, rel=1e-12)
    assert [bool(reach) for *_, reach in annuli(far, (3000.0, 192.0, 384.0))] == [True, False, False, True]


def test_a_ring_stays_within_its_box():
    ring = ring_within(32.0)
    radii = np.sqrt(np.ldexp(1 + np.arange(128) / 128, np.arange(32)[:, None])).ravel()
    profile = ring.profile[0, :-1]
    assert (profile >= 0).all() and not profile[radii > 32].any() and profile[0] < 1e-3 * profile.max()
    assert np.trapezoid(2 * np.pi * radii * profile, radii) == pytest.approx(1, rel=1e-4)


@pytest.mark.parametrize("wings", [True, False])
@pytest.mark.parametrize("reach", [16, 24, 32, 50])
@pytest.mark.parametrize("galaxy", [{}, {"obj_type": GALAXY, "size_disk": 0.3}])
def test_a_stamp_of_any_size_loses_no_light(camera, make_pointing, psf_r, wings, reach, galaxy):
    """All of the light by stamps too small to hold it, to 1e-4, at the window's edge 1e-3; what is said is drawn."""
    wcs, window = ChipWCS(camera.chips[9], make_pointing()), around(500)
    scattered = read_scattered(psf_r) if wings else Scattered()
    for position in ((X, Y), (window.x0 + 3.2, Y), (window.x0 - 5.0, Y)):
        table = objects(wcs, *position, reach=reach, rate=1e4, wing=np.zeros(1), **galaxy)
        scene = make_scene(table, wcs, psf_r, EXPTIME)
        canvas, larger = blank(window, float), blank(window, float)
        image, whole = canvas.expected, larger.expected
        drawn = draw_scene(canvas, scene.sized(reach), psf_r, Scattered(scattered.wing))
        draw_scene(larger, scene.sized(200, 300.0 * wings), psf_r, Scattered(scattered.wing))
        assert drawn.drawn[0] == pytest.approx(image.sum(), rel=1e-6)
        assert image.sum() == pytest.approx(whole.sum(), abs=(1e-4 if position == (X, Y) else 1e-3) * 1e6)


def test_the_layer_switches_wings_and_ghosts(camera, make_pointing, psf_r):
    """obs_param wings, ghosts of scie_obs: light goes with each; the core stays."""
    wcs = ChipWCS(camera.chips[9], make_pointing())
    window = around(300)
    table = objects(wcs, X, Y, wing=np.full(1, 5000.0), rate=1e8)

    def light(**param):
        pointing = make_pointing(exptime=EXPTIME)
        exposure = Exposure(pointing, camera.chips[9], window, wcs, camera, fidelity="noise_free")
        state = State.blank(exposure, table)
        state.psf = psf_r
        scie_obs.apply(state, scie_obs.Param(**param), Streams(1, "1", 9, "scie_obs"))
        return state.image.sum(dtype=float) / (1e8 * EXPTIME), state.image[300, 300]

    (both, peak), (no_ghosts, _), (no_wings, _), (neither, bare) = (
        light(wings=wings, ghosts=ghosts) for wings, ghosts in ((1, 1), (1, 0), (0, 1), (0, 0))
    )
    assert both > no_ghosts and no_wings > neither
    assert no_ghosts - neither == pytest.approx(0.034, abs=0.003)  # between the box (32 px) and 300 px
    assert both - no_ghosts == pytest.approx(no_wings - neither, rel=1e-3)
    assert peak == pytest.approx(bare, rel=1e-5)


def test_the_box_of_pixels_within_a_reach():
    """Centres at whole numbers: of 100.4 and 7 px those from 94 to 107; cut by the window, or beyond it."""
    window = Window(90, 130, 40, 50)
    assert box_on_window(window, 100.4, 45.0, 7.0) == (94, 108, 40, 50)
    assert box_on_window(window, 100.4, 43.5, 2.5) == (98, 103, 41, 47)
    assert box_on_window(window, 128.0, 45.0, 3.0) == (125, 130, 42, 49)
    for x, y in ((86.9, 45.0), (133.1, 45.0), (100.0, 36.9), (100.0, 53.1)):
        assert box_on_window(window, x, y, 3.0) is None
    assert box_on_window(window, 87.0, 45.0, 3.0) == (90, 91, 42, 49)


def test_where_meshes_take_over_and_what_a_stamp_may_leave_out():
    assert [near_of(px) for px in (-1.0, 0.0, 1.0, 191.9, 192.0, 5000.0)] == [0.0, 0.0, 48.0, 48.0, 96.0, 96.0]
    assert near_light(0.5, 100.0, None) == 0.5 and near_light(0.7, 100.0, None) == 0
    assert near_light(7.9, 100.0, "wing") == 7.9 and near_light(8.1, 100.0, "wing") == 0
    assert near_light(-0.5, 100.0, None) == -0.5 and near_light(-0.7, 100.0, None) == 0
    flux, light = np.array([10.0, 20.0, 30.0, 40.0]), np.array([0.1, 0.2, 0.05, 0.0])
    assert wing_scale(flux, 90.0, light) == pytest.approx(10 / 6.5)  # 1 + 4 + 1.5 electrons of the wing
    assert wing_scale(flux, 101.0, light) == 0


def test_a_ghost_that_misses_the_window_is_not_listed(camera, scene):
    ghosts = scene(0.0, around(1))[2].ghosts
    canvas = blank(Window(0, 20, 0, 20), float)
    assert add_ghosts(canvas, camera.chips[9], (9000.0, 9000.0), 1e9, ghosts) == []
    assert add_ghosts(canvas, camera.chips[9], (10.0, 10.0), 1.0, ghosts) == [] and not canvas.expected.any()


def test_the_light_of_a_profile_is_its_integral_over_the_plane():
    """Gaussians of 30 px and of 5 px, of different heights, the middle pixel included."""
    sigma, height = np.array([30.0, 5.0, 30.0]), np.array([1.0, 4.0, 0.25])
    profile = height[:, None] * np.exp(-0.5 * (RADII / sigma[:, None]) ** 2)
    assert light_of(profile) == pytest.approx(2 * np.pi * sigma**2 * height, rel=2e-3)
    assert RADII[0] == 1.0 and RADII[-1] == 65536.0


def test_an_annulus_reaches_to_twice_its_edge(scene):
    far = wing_beyond(scene(0.0, around(1))[2].wing, 32.0)
    reach = [reach for *_, reach in annuli(far, (48.0, 192.0, 384.0))]
    assert reach[:3] == pytest.approx([96.0, 384.0, 768.0], rel=0.01) and reach[3] == 65536.0
    assert all(smallest <= found for smallest, found in zip((96.0, 384.0, 768.0), reach, strict=False))
