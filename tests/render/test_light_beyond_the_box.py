"""Light of photons and ghosts beyond the stamps against conservation of light; limits in sigma, fixed seeds."""

import numpy as np
import pytest
from galaxies import scene_of, shaped
from scipy.stats import chi2_contingency
from support.canvases import blank, counting

from csstsim.base.counter import object_keys
from csstsim.catalog.profiles.sersic_photons import rings_for
from csstsim.instrument.chip import Window
from csstsim.optics.scatter.scattered_light import Scattered, read_scattered
from csstsim.render.imaging.galaxy_stamp import plan_galaxies
from csstsim.render.imaging.photons import shoot_scene
from csstsim.render.imaging.stamps import draw_scene
from csstsim.render.parts.spots import Spots
from csstsim.render.photon_positions import Profile, ProfileTables, from_profile
from csstsim.render.slitless.line_wings import order_wing

SIGMA = 5.0
WINDOW = Window(3700, 4301, 4700, 5301)
X, Y = 4000.3, 5000.4
BOX_PX = 32.0  # half the side of the stored PSF


def counts(psf, table, electrons, maximum, copies=1, base=3):
    """Return (counted plane, electrons that fell beyond the box) of stars at one position, all light counted."""
    scene = scene_of(psf, np.full(copies, X), np.full(copies, Y), electrons, index=0.0)
    canvas = counting(WINDOW, response=np.ones(WINDOW.shape, np.float32), maximum=maximum)
    keys = object_keys(np.uint64(base), scene.ids)
    _, outside_box, _ = shoot_scene(canvas, scene, keys, table, read_scattered(psf).wing)
    return canvas.counted, outside_box.sum()


@pytest.mark.parametrize(("electrons", "copies"), [(2e6, 1), (200.0, 10_000)], ids=["many", "few"])
@pytest.mark.parametrize("maximum", [1.0, 1.3])
def test_a_response_of_one_counts_all_light_wherever_it_falls(psf_r, psf_tables, electrons, copies, maximum):
    """Core, box and wing: each holds its fraction, whatever the losses' maximum that the numbers are drawn for."""
    counted, outside_box = counts(psf_r, psf_tables, electrons, maximum, copies)
    light = electrons * copies
    stored = psf_r.at(X, Y).sum(axis=(1, 2)).mean()
    out = light * (1 - stored) * maximum
    assert outside_box == pytest.approx(out, abs=SIGMA * np.sqrt(out))
    x, y = np.abs(np.arange(WINDOW.x0, WINDOW.x1) - X), np.abs(np.arange(WINDOW.y0, WINDOW.y1) - Y)
    inside = (x < BOX_PX - 2) & (y < BOX_PX - 2)[:, None]
    ring = ~((x < BOX_PX + 2) & (y < BOX_PX + 2)[:, None])
    wing = read_scattered(psf_r).wing
    corner = min(WINDOW.x1 - X, X - WINDOW.x0, WINDOW.y1 - Y, Y - WINDOW.y0)
    circle = ring & (np.hypot(x, y[:, None]) < corner)
    # Of what lies beyond the box's square, the fraction within the circle that fits the window, by the profile itself
    grid = np.arange(-corner, corner + 1)
    radius = np.hypot(grid, grid[:, None])
    there = (radius < corner) & ((np.abs(grid) > BOX_PX + 2) | (np.abs(grid) > BOX_PX + 2)[:, None])
    profile = wing.profile(np.maximum(radius, 1.0)).mean(axis=0)
    wanted = light * profile[there].sum()
    assert counted[circle].sum() == pytest.approx(wanted, abs=SIGMA * np.sqrt(wanted) + 0.04 * wanted)
    core = light * stored
    assert counted[inside].sum() == pytest.approx(core, abs=SIGMA * np.sqrt(core) + 0.004 * core)


def test_radius_and_angle_of_a_profiles_photons_have_nothing_to_do_with_each_other():
    """Radii and angles of 200,000 electrons of a disc: independent by chi2 of 8 x 8 classes."""
    count = 200_000
    px, py = np.zeros(count), np.zeros(count)
    for index in (1.0, 4.0, 2.5):
        px[:] = py[:] = 0.0
        rings, which, fraction = rings_for(index)
        profile = Profile(np.eye(2), int(which), float(fraction), 1.0, ProfileTables(rings, Spots().sampled))
        from_profile(count, profile, px, py, np.uint64(77), np.uint64(0))
        radius, angle = np.hypot(px, py), np.arctan2(py, px)
        rank = np.argsort(np.argsort(radius)) * 8 // count
        table = np.histogram2d(rank, angle, (np.arange(9) - 0.5, np.linspace(-np.pi, np.pi, 9)))[0]
        assert chi2_contingency(table).pvalue > 1e-6  # 5 sigma
        assert abs(np.mean(px)) < SIGMA * px.std() / np.sqrt(count)
        assert np.median(radius) == pytest.approx(1.0, abs=0.02)  # the half-light radius, for each index


def test_a_galaxy_too_long_for_a_transform_is_planned_so(psf_r):
    """A needle 40 arcsec long has a blurred outer part; a round galaxy of its size has not."""
    positions, reach = np.array([4000.0, 4000.0]), np.array([900, 900])
    scene = scene_of(psf_r, positions, positions + 1000, 1e8, index=1.0, size=20.0, matrix=np.stack([
        shaped(0.01, 0.3), shaped(1.0, 0.0),
    ]))  # fmt: skip
    assert plan_galaxies(scene, reach, BOX_PX, np.ones(2, bool)).thin.tolist() == [True, False]


@pytest.mark.parametrize("electrons", [1e8, 1e9])
def test_ghosts_hold_their_share_of_the_light(camera, psf_r, electrons):
    """The sum of all that ghosts add is the sum of their fractions, in the image and in what is said to be drawn."""
    scattered = Scattered(None, read_scattered(psf_r).ghosts)
    window, chip = Window(2500, 5500, 3500, 6500), camera.chips[9]
    scene = scene_of(psf_r, X, Y, electrons, index=0.0)
    haunted, plain, scene = blank(window, float), blank(window, float), scene.sized(64)
    drawn = draw_scene(haunted, scene, psf_r, scattered, chip)
    without = draw_scene(plain, scene, psf_r, chip=chip)
    image, alone = haunted.expected, plain.expected
    fraction = scattered.ghosts.light.sum()
    assert scattered.ghosts.visible(electrons)
    assert (image - alone).sum() / electrons == pytest.approx(fraction, rel=1e-3)
    assert (drawn.drawn[0] - without.drawn[0]) / electrons == pytest.approx(fraction, rel=1e-3)


def test_losses_take_the_same_share_near_and_far(psf_r, psf_tables):
    """Of faint stars whose wings have an electron each at most: half is kept within 60 px and beyond, to SIGMA."""
    scene = scene_of(psf_r, np.full(40_000, X), np.full(40_000, Y), 20.0, index=0.0)
    radius = np.hypot(np.arange(WINDOW.x0, WINDOW.x1) - X, np.arange(WINDOW.y0, WINDOW.y1)[:, None] - Y)
    rings = [(radius > low) & (radius < high) for low, high in ((50.0, 80.0), (80.0, 150.0), (150.0, 290.0))]
    counted = []
    for base, fraction in ((11, 1.0), (12, 0.5)):
        canvas = counting(WINDOW, response=np.full(WINDOW.shape, fraction, np.float32))
        keys = object_keys(np.uint64(base), scene.ids)
        shoot_scene(canvas, scene, keys, psf_tables, read_scattered(psf_r).wing)
        counted.append([canvas.counted[ring].sum() for ring in rings])
    for whole, half in np.transpose(counted):
        assert whole > 500
        assert half == pytest.approx(0.5 * whole, abs=SIGMA * np.sqrt(0.5 * whole + 0.25 * whole))


@pytest.mark.parametrize("fraction", [1.0, 0.5, 0.1])
def test_an_orders_wing_hides_where_its_light_does(fraction):
    """A profile of r^-3 falls to one level at the cube root of the light; so do an order's wings, or they hide."""
    assert order_wing(4000.0, fraction, BOX_PX) == pytest.approx(4000.0 * fraction ** (1 / 3))
    assert order_wing(0.0, fraction, BOX_PX) == 0.0 and order_wing(0.9 * BOX_PX, fraction, BOX_PX) == 0.0


def test_where_in_a_pixel_of_an_image_a_photon_falls_has_nothing_to_do_with_the_pixel():
    """A quadratic B-spline about each of eight pixels, four apart: mean 0 and variance 1/4 along both axes."""
    count, image = 200_000, np.zeros((1, 29))
    image[0, ::4] = 1.0 + np.arange(8)
    px, py, spots = np.zeros(count), np.zeros(count), Spots(images=[image])
    profile = Profile(np.eye(2), -2, 0.0, 0.0, ProfileTables(rings_for(1.0).rings, spots.sampled))
    from_profile(count, profile, px, py, np.uint64(78), np.uint64(0))
    position = np.sort(spots.u[spots.u % 4 == spots.u.min() % 4])
    pixel = np.abs(px[:, None] - position).argmin(axis=1)
    fraction = np.bincount(pixel) / count
    assert np.allclose(fraction, image[0, ::4] / image.sum(), atol=SIGMA * 0.5 / np.sqrt(count))
    for k in range(8):
        x, y = px[pixel == k] - position[k], py[pixel == k] - spots.v[0]
        for offset in (x, y):
            assert abs(offset.mean()) < SIGMA * 0.5 / np.sqrt(len(offset)) and np.abs(offset).max() < 1.5
            assert offset.var() == pytest.approx(0.25, rel=SIGMA * np.sqrt(2 / len(offset)))
        assert abs(np.corrcoef(x, y)[0, 1]) < SIGMA / np.sqrt(len(x))
