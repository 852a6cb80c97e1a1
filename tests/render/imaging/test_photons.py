"""Photons against expectations: GalSim's, sums by hand, and Poisson's law. Fixed seeds; limits in sigma."""

from dataclasses import replace

import galsim
import numpy as np
import pytest
from scipy.interpolate import BSpline
from support.canvases import blank, counting
from support.csst import BANDS

from csstsim.base.counter import object_keys
from csstsim.catalog.profiles.sersic import sersic_b
from csstsim.catalog.table import STAR, ObjectTable
from csstsim.instrument.chip import Window
from csstsim.optics.geometry.wcs import ChipWCS
from csstsim.optics.psf.psf_file import PsfSet, pixel_response, write_psf
from csstsim.optics.scatter.scattered_light import read_scattered
from csstsim.render.canvas import Canvas
from csstsim.render.drawing import Drawing
from csstsim.render.imaging.photons import shoot_scene
from csstsim.render.imaging.reference import PSF_MAXK, draw_objects
from csstsim.render.parts.spots import SampledSpots, Spots
from csstsim.render.photon_positions import Profile, ProfileTables, _from_spots, profiles_of, tail_table
from csstsim.render.psf_table import make_table
from csstsim.render.scene import Scene, make_scene

SIGMA = 5.0
WINDOW = Window(4000, 4130, 5000, 5120)
CENTRE = 4065.3, 5058.8
SCALE = 0.074  # arcsec per pixel
WEIGHT_PX = 3.0  # sigma of the window of sizes


@pytest.fixture(scope="module")
def wide_and_narrow(tmp_path_factory):
    """PSF set of round Gaussians, sigma 2 cells at the left nodes, 12 (3 px) at the right."""
    path = tmp_path_factory.mktemp("gauss") / "g.h5"
    at = np.arange(256) - 127.5
    images = []
    for sigma in (2.0, 12.0, 2.0, 12.0):
        line = np.exp(-(at**2) / 2 / sigma**2)
        image = np.outer(line, line)
        images.append((np.broadcast_to(image / image.sum(), (4, 256, 256)), (0, 0)))
    about = {
        "cell_um": 2.5, "cell_arcsec": 0.0185, "oversampling": 4, "chip": 9, "filter": "r", "grid": 2,
        "camera_digest": "none",
    }  # fmt: skip
    nodes = np.array([[0.0, 0.0], [9000.0, 0.0], [0.0, 9000.0], [9000.0, 9000.0]])
    write_psf(path, nodes, np.arange(4) + 5000.0, images, cells=256, about=about, provenance={})
    return make_table(PsfSet(path))


def make(psf, x, y, electrons, index=0.0, size=0.3, matrix=None, bulge=0.0):
    """Return a Scene of objects at x, y; `electrons` in all; index and size of component 0, (4, size) of a bulge."""
    x, y = np.atleast_1d(np.asarray(x, float)), np.atleast_1d(np.asarray(y, float))
    n = len(x)
    sersic = np.zeros((n, 2, 3))
    if index:
        sersic[:, 0] = index, sersic_b(index), size
        sersic[:, 1] = 4.0, sersic_b(4.0), size
    matrix = np.eye(2) / SCALE if matrix is None else matrix
    node, weight, outside = psf.weights(x, y)
    light = np.broadcast_to(np.atleast_1d(electrons)[:, None] / 4, (n, 4)).copy()
    return Scene(
        np.arange(n), x, y, light, np.tile([1.0 - bulge, bulge], (n, 1)), sersic, np.tile(matrix, (n, 1, 1)), node,
        weight, outside,
    )  # fmt: skip


def shoot(scene, table, base=1, window=WINDOW, **losses):
    canvas = counting(window, **losses)
    result = shoot_scene(canvas, scene, object_keys(np.uint64(base), scene.ids), table)
    return canvas.counted, *result


def size(image, x, y, error=None):
    """Return <r^2>, e1, e2 weighted by a Gaussian about x, y (window pixels), and, of a count, their errors."""
    v, u = np.indices(image.shape)
    u, v = u - x, v - y
    window = np.exp(-(u**2 + v**2) / 2 / WEIGHT_PX**2)
    total = (image * window).sum()
    values, errors = [], []
    for moment in (u**2 + v**2, u**2 - v**2, 2 * u * v):
        values.append((image * window * moment).sum() / total)
        errors.append(np.sqrt((image * (window * (moment - values[-1])) ** 2).sum()) / total)
    return np.array(values), np.array(errors)


def expectation(psf, x, y, electrons, index=0.0, radius=0.3, matrix=None, window=WINDOW):
    """GalSim's own: Sersic profile under the matrix, convolved with the pixel-integrated PSF."""
    response = pixel_response(psf.at(x, y).mean(axis=0), psf.oversampling)
    step = 1 / psf.oversampling
    profile = galsim.InterpolatedImage(
        galsim.ImageD(response), scale=step, normalization="sb", x_interpolant="quintic", _force_maxk=PSF_MAXK,
        _force_stepk=2 * np.pi / (response.shape[0] * step),
    )  # fmt: skip
    if index:
        params = galsim.GSParams(folding_threshold=1e-3, maxk_threshold=1e-4, maximum_fft_size=8192)
        galaxy = galsim.Sersic(index, half_light_radius=radius, gsparams=params)
        galaxy = galaxy.transform(*(np.eye(2) / SCALE if matrix is None else matrix).ravel()).withFlux(1.0)
        profile = galsim.Convolve(galaxy, profile, gsparams=params, propagate_gsparams=False)
    image = galsim.ImageD(window.nx, window.ny, xmin=window.x0, ymin=window.y0)
    profile.drawImage(image, scale=1.0, method="no_pixel", center=galsim.PositionD(x, y))
    return image.array * electrons


def test_star_is_the_reference_pixel_by_pixel(camera, make_pointing, psf_r, psf_tables):
    wcs = ChipWCS(camera.chips[9], make_pointing())
    x, y = CENTRE
    ra, dec = wcs.pixel_to_world(np.array([x]), np.array([y]))
    columns = {
        "id": [5], "obj_type": [STAR], "ra": ra, "dec": dec, "ra_orig": ra, "dec_orig": dec, "x": [x], "y": [y],
        "reach": [50], "lost": [1e-4], "wing": [0.0],
    }  # fmt: skip
    columns |= {f"flux{i}": [f] for i, f in enumerate((4e3, 1e3, 2e3, 3e3))}
    objects = ObjectTable.complete({k: np.array(v) for k, v in columns.items()}, BANDS)
    canvas = blank(WINDOW)
    draw_objects(canvas, objects, Drawing(wcs, psf_r, 100.0))
    expected = canvas.expected
    counted, on, _, box = shoot(make_scene(objects, wcs, psf_r, 100.0), psf_tables)
    used = expected > 20
    chi2 = ((counted - expected)[used] ** 2 / expected[used]).sum()
    assert used.sum() > 400
    assert abs(chi2 - used.sum()) < SIGMA * np.sqrt(2 * used.sum())
    assert on[0] == counted.sum()
    assert abs(on[0] - 1e6 * psf_r.at(x, y)[[0, 1, 2, 3]].sum(axis=(1, 2)) @ [0.4, 0.1, 0.2, 0.3]) < SIGMA * 1e3
    rows, cols = np.nonzero(counted)
    assert box[0].tolist() == [cols.min() + 4000, cols.max() + 4001, rows.min() + 5000, rows.max() + 5001]


@pytest.mark.parametrize("index", [0.5, 1.0, 2.5, 4.0, 6.0])
def test_galaxy_has_galsims_size_shape_and_flux(psf_r, psf_tables, index):
    """Sheared, turned and mirrored by its matrix: sign and orientation are GalSim's."""
    matrix = np.array([[-1.2, 0.35], [0.15, 0.9]]) / SCALE
    radius, electrons = 0.25, 2e6
    expected = expectation(psf_r, *CENTRE, electrons, index, radius, matrix)
    counted, *_ = shoot(make(psf_r, *CENTRE, electrons, index, radius, matrix), psf_tables, base=3)
    position = CENTRE[0] - WINDOW.x0, CENTRE[1] - WINDOW.y0
    (truth, _), (found, error) = size(expected, *position), size(counted, *position)
    assert abs(truth[1]) > 100 * error[1] and abs(truth[2]) > 30 * error[2]  # the shape is seen, in both components
    assert (np.abs(found - truth) < SIGMA * error).all()
    v, u = np.indices(expected.shape)
    r = np.hypot(u - position[0], v - position[1])
    for aperture in (3, 8, 20):
        light = expected[r < aperture].sum()
        # GalSim's transform of n = 6 keeps the light to about 1e-3
        assert abs(counted[r < aperture].sum() - light) < SIGMA * np.sqrt(light) + (1e-3 * light if index > 5 else 0)


@pytest.mark.slow
@pytest.mark.parametrize("index", [0.0, 1.0, 4.0])
def test_many_electrons_find_no_bias(psf_r, psf_tables, index):
    """2e8 of them. A star against its own density, pixel by pixel; galaxies in the project's goals (1e-3 of light and
    size^2, 1e-4 of ellipticity), GalSim's transform being good to a tenth of that."""
    electrons, (x, y) = 2e8, CENTRE
    counted, *_ = shoot(make(psf_r, x, y, electrons, index, 0.3), psf_tables, base=31)
    position = x - WINDOW.x0, y - WINDOW.y0
    expected = expectation(psf_r, x, y, electrons, index, 0.3)
    if not index:
        spline = BSpline.basis_element([-1.5, -0.5, 0.5, 1.5], extrapolate=False).antiderivative()
        node, weight, _ = psf_r.weights(x, y)
        mixture = sum(w * psf_tables.node_coefficients(k).mean(axis=0) for k, w in zip(node, weight, strict=True))
        parts = []
        for at, width in zip(position, (WINDOW.nx, WINDOW.ny), strict=True):
            edges = 4 * (np.arange(width + 1) - 0.5 - at)
            inside = spline(np.clip(edges[:, None] - (np.arange(256) - 127.5), -1.5, 1.5))
            parts.append(np.diff(inside, axis=0))
        expected = electrons * np.einsum("ik,jl,kl->ij", parts[1], parts[0], mixture)
        used = expected > 100
        chi2 = ((counted - expected)[used] ** 2 / expected[used]).sum()
        assert abs(chi2 - used.sum()) < SIGMA * np.sqrt(2 * used.sum())
    (truth, _), (found, error) = size(expected, *position), size(counted, *position)
    assert abs(counted.sum() / expected.sum() - 1) < 1e-3 / 2
    assert (np.abs(found - truth) / truth[0] < SIGMA * error / truth[0] + [1e-4, 2e-5, 2e-5]).all()


def test_bulge_and_disk_share_the_light(psf_r, psf_tables):
    parts = [expectation(psf_r, *CENTRE, 1e6, n, 0.3) for n in (1.0, 4.0)]
    expected = 0.7 * parts[0] + 0.3 * parts[1]
    counted, *_ = shoot(make(psf_r, *CENTRE, 1e6, 1.0, bulge=0.3), psf_tables, base=11)
    used = expected > 20
    chi2 = ((counted - expected)[used] ** 2 / expected[used]).sum()
    assert abs(chi2 - used.sum()) < SIGMA * np.sqrt(2 * used.sum())


@pytest.mark.parametrize("electrons", [20.0, 290.0, 310.0, 3000.0])
@pytest.mark.parametrize("losses", [False, True])
def test_mean_is_variance(psf_r, psf_tables, electrons, losses):
    """400 draws of a galaxy; both ways of drawing the numbers, with and without losses above and below one."""
    repeats = 400
    response, maximum = None, 1.0
    if losses:
        response, maximum = np.full(WINDOW.shape, 0.6, np.float32), 1.05
        response[:, ::2] = 1.04
    expected = expectation(psf_r, *CENTRE, electrons, 1.0)
    kept = expected * (1.0 if response is None else response)
    scene = make(psf_r, *CENTRE, electrons, 1.0)
    draws = np.stack(
        [shoot(scene, psf_tables, base=100 + k, response=response, maximum=maximum)[0] for k in range(repeats)]
    )
    total = draws.sum(axis=(1, 2))
    mean = kept.sum()
    assert abs(total.mean() - mean) < SIGMA * np.sqrt(mean / repeats)
    assert abs(total.var(ddof=1) / mean - 1) < SIGMA * np.sqrt((2 + 1 / mean) / repeats)
    bright = kept > 0.02 * kept.max()
    ratio = draws.var(axis=0, ddof=1)[bright] / kept[bright]
    error = np.sqrt((2 + 1 / kept[bright]) / repeats)
    assert abs(ratio.mean() - 1) < SIGMA * np.sqrt((error**2).sum()) / bright.sum()
    score = (draws.mean(axis=0) - kept)[bright] / np.sqrt(kept[bright] / repeats)
    assert abs((score**2).sum() - bright.sum()) < SIGMA * np.sqrt(2 * bright.sum())


@pytest.mark.parametrize("electrons", [200.0, 1e5])
def test_mixture_of_nodes(wide_and_narrow, electrons):
    """A third of the way from the narrow nodes to the wide ones: the light in rings is the mean of the stored cells."""
    psf, repeats = wide_and_narrow.psf, int(1e6 / electrons)
    scene = make(psf, np.full(repeats, 3000.0), np.full(repeats, 4500.0), np.full(repeats, electrons))
    counted, on, outside_box, _ = shoot(scene, wide_and_narrow, window=Window(2969, 3032, 4469, 4532))
    assert abs(on.sum() + outside_box.sum() - 1e6) < SIGMA * 1e3
    mean = (2 * psf.node(0)[0] + psf.node(1)[0]).astype(float) / 3
    expected = 1e6 * mean[2:-2, 2:-2].reshape(63, 4, 63, 4).sum(axis=(1, 3))  # pixel edges are cell edges
    at = np.arange(-31, 32)
    r = np.hypot(at, at[:, None])
    for inner, outer in ((0, 1), (1, 3), (3, 6), (6, 12)):
        ring = (r >= inner) & (r < outer)
        assert abs(counted[ring].sum() - expected[ring].sum()) < SIGMA * np.sqrt(expected[ring].sum())


def test_electrons_beyond_the_box_are_counted(psf_r, psf_tables):
    for electrons, n in ((100.0, 2000), (1e5, 2)):
        scene = make(psf_r, np.full(n, CENTRE[0]), np.full(n, CENTRE[1]), np.full(n, electrons))
        _, _, outside_box, _ = shoot(scene, psf_tables)
        lost = electrons * n * (1 - psf_r.at(*CENTRE).sum() / 4)
        assert lost > 1000
        assert abs(outside_box.sum() - lost) < SIGMA * np.sqrt(lost)


def test_sub_bands_have_their_own_psf(psf_r, psf_tables):
    """All light in the bluest, then all in the reddest: the sizes differ by what the images say."""
    sizes = []
    for band in (0, 3):
        light = np.zeros((1, 4))
        light[0, band] = 4e6
        scene = replace(make(psf_r, *CENTRE, 1.0), electrons=light)
        counted, *_ = shoot(scene, psf_tables)
        flat = psf_r.at(*CENTRE)[band]
        expected = expectation(type("P", (), {"at": lambda *_, f=flat: f[None], "oversampling": 4}), *CENTRE, 4e6)
        (found, error), (truth, _) = (size(image, CENTRE[0] - 4000, CENTRE[1] - 5000) for image in (counted, expected))
        assert abs(found[0] - truth[0]) < SIGMA * error[0]
        sizes.append((truth[0], error[0]))
    assert abs(sizes[1][0] - sizes[0][0]) > 10 * sizes[0][1]


def test_order_does_not_matter(psf_r, psf_tables):
    rng = np.random.default_rng(8)
    n = 300
    scene = make(
        psf_r, rng.uniform(3980, 4150, n), rng.uniform(4980, 5140, n), 10 ** rng.uniform(0, 4, n), 1.0, bulge=0.2
    )
    forth = shoot(scene, psf_tables)
    order = rng.permutation(n)
    back = shoot(scene.take(order), psf_tables)
    assert np.array_equal(forth[0], back[0])
    for a, b in zip(forth[1:], back[1:], strict=True):
        assert np.array_equal(a[order], b)
    parts = [shoot(scene.take(order[k::3]), psf_tables)[0] for k in range(3)]
    assert np.array_equal(forth[0], sum(parts))
    assert forth[0].sum() == forth[1].sum()


def test_windows_cut_one_picture(psf_r, psf_tables):
    """An object at a corner of four windows: each counts its own electrons, none is lost, none counted twice."""
    scene = make(psf_r, [4065.0, 4064.5, 3999.5], [5060.0, 5059.5, 4999.5], [5e3, 100.0, 2e4], 4.0, 1.0)
    whole = shoot(scene, psf_tables)
    quarters = [
        Window(x, x1, y, y1) for x, x1 in ((4000, 4065), (4065, 4130)) for y, y1 in ((5000, 5060), (5060, 5120))
    ]
    on = 0
    for window in quarters:
        counted, found, outside_box, box = shoot(scene, psf_tables, window=window)
        part = whole[0][window.y0 - 5000 : window.y1 - 5000, window.x0 - 4000 : window.x1 - 4000]
        assert np.array_equal(counted, part)
        assert np.array_equal(outside_box, whole[2])
        assert (box[found > 0, 0] >= window.x0).all() and (box[found > 0, 3] <= window.y1).all()
        on = on + found
    assert np.array_equal(on, whole[1])


def test_far_objects_leave_the_window_alone(psf_r, psf_tables):
    positions = [(-3000.0, 5050.0), (4050.0, 20000.0), (4130.0 + 60, 5050.0), (1e9, -1e9)]
    scene = make(psf_r, *np.transpose(positions), np.full(4, 1e4))
    counted, on, _, box = shoot(scene, psf_tables)
    assert not counted.any() and not on.any() and not box.any()


def test_nothing_to_draw(psf_r, psf_tables):
    counted, on, outside_box, box = shoot(make(psf_r, [], [], np.zeros(0)), psf_tables)
    assert not counted.any() and on.shape == outside_box.shape == (0,) and box.shape == (0, 4)
    counted, on, outside_box, box = shoot(make(psf_r, *CENTRE, 0.0, 1.0), psf_tables)
    assert not counted.any() and on[0] == outside_box[0] == 0 and not box.any()


def test_tiny_lights_add_up(psf_r, psf_tables):
    n = 50_000
    scene = make(psf_r, np.full(n, CENTRE[0]), np.full(n, CENTRE[1]), np.full(n, 0.01), 4.0)
    _, on, outside_box, _ = shoot(scene, psf_tables)
    assert abs((on + outside_box).sum() - 500) < 5 * np.sqrt(500) + 10  # wings of n = 4 off the window


@pytest.mark.parametrize("index", [0.3, 1.0, 4.0, 6.2])
@pytest.mark.parametrize("radius", [1e-4, 60.0])
@pytest.mark.parametrize("q", [1.0, 0.02])
def test_extremes_stay_finite(psf_r, psf_tables, index, radius, q):
    """A needle, a point and a giant. The light within the window is never more than there is; a tiny one is a star."""
    matrix = np.array([[1.0, 0.3], [-0.3, 1.0]]) @ np.diag([q**-0.5, q**0.5]) / SCALE
    counted, on, outside_box, _ = shoot(make(psf_r, *CENTRE, 2e4, index, radius, matrix), psf_tables)
    assert counted.sum() == on[0] and counted.min() >= 0
    assert on[0] + outside_box[0] < 2e4 + SIGMA * np.sqrt(2e4)
    if radius < 1e-3 and index < 6:
        star = expectation(psf_r, *CENTRE, 2e4)
        assert abs(on[0] - star.sum()) < SIGMA * np.sqrt(2e4)


def test_blocked_light_is_not_counted(psf_r, psf_tables):
    response = np.zeros(WINDOW.shape, np.float32)
    response[:, 60:] = 1.0
    counted, on, _, _ = shoot(make(psf_r, *CENTRE, 1e4), psf_tables, response=response)
    assert not counted[:, :60].any() and counted[:, 60:].any() and on[0] == counted.sum()
    response[:] = np.nan
    with pytest.raises(ValueError, match="response"):
        shoot(make(psf_r, *CENTRE, 1e4), psf_tables, response=response)


@pytest.mark.parametrize(
    "change, message",
    [
        ({"x": np.array([np.nan])}, "x is not finite"),
        ({"electrons": np.full((1, 4), np.inf)}, "electrons is not finite"),
        ({"electrons": np.array([[1.0, -1, 1, 1]])}, "electrons is negative"),
        ({"electrons": np.full((1, 4), 1e9)}, "electrons or more"),
        ({"weight": np.array([[-0.1, 0.6, 0.3, 0.2]])}, "weight is negative"),
    ],
)
def test_what_cannot_be_drawn_is_refused(psf_r, psf_tables, change, message):
    with pytest.raises(ValueError, match=message):
        shoot(replace(make(psf_r, *CENTRE, 10.0), **change), psf_tables)


def test_nodes_without_tables_are_refused(psf_r):
    with pytest.raises(ValueError, match="no tables"):
        shoot(make(psf_r, *CENTRE, 10.0), make_table(psf_r, [0]))


def test_arrays_that_do_not_fit_are_refused(psf_r, psf_tables):
    scene = make(psf_r, *CENTRE, 10.0)
    keys = object_keys(np.uint64(1), scene.ids)
    with pytest.raises(ValueError, match="counted"):
        shoot_scene(Canvas(None, WINDOW, counted=np.zeros(WINDOW.shape)), scene, keys, psf_tables)
    with pytest.raises(ValueError, match="response"):
        shoot(scene, psf_tables, response=np.ones((3, 3), np.float32))
    with pytest.raises(ValueError, match="at most"):
        shoot(scene, psf_tables, response=np.full(WINDOW.shape, 1.1, np.float32))


def test_light_beyond_the_box_follows_the_wing(psf_r, psf_tables):
    """2e6 electrons of a star with its wing: outside the box, rings of the closed form; none lost; 5 sigma."""
    wing, n = read_scattered(psf_r).wing, 2e6
    window, scene = Window(0, 2001, 0, 2001), make(psf_r, 1000.0, 1000.0, n)
    canvas = counting(window)
    on_window, outside_box, box = shoot_scene(canvas, scene, np.array([3], np.uint64), psf_tables, wing)
    counted = canvas.counted
    r = np.hypot(*(np.indices(window.shape) - 1000.0))
    for inner, outer in ((50, 80), (80, 150), (150, 400), (400, 900)):
        expected = n * (wing.light_beyond(inner) - wing.light_beyond(outer)).mean()
        assert abs(counted[(r >= inner) & (r < outer)].sum() - expected) < 5 * np.sqrt(expected) + 5e-3 * expected
    left = wing.light_beyond(1000 * np.sqrt(4 / np.pi)).mean()  # beyond a circle of the window's area
    assert on_window[0] == counted.sum() == pytest.approx(n * (1 - left), abs=5 * np.sqrt(n) + 0.1 * n * left)
    assert outside_box[0] == pytest.approx(n * (1 - psf_r.flux.mean()), rel=0.02) and box[0, 1] - box[0, 0] > 1500


def test_losses_take_electrons_whatever_their_place(psf_r, psf_tables):
    """The loss has the half of a word that the position has not: half the light everywhere is the same image, thinned.

    1.2e6 electrons; chi2 of the pixels with 25 and more of them, 5 sigma.
    """
    scene = make(psf_r, *CENTRE, 1.2e6)
    whole = shoot(scene, psf_tables)[0].astype(float)
    kept = shoot(scene, psf_tables, base=2, response=np.full(WINDOW.shape, 0.5, np.float32))[0]
    seen = whole > 25
    n = seen.sum()
    chi2 = ((kept - whole / 2)[seen] ** 2 / (whole / 2 + whole / 4)[seen]).sum()
    assert n > 500 and abs(chi2 / n - 1) < 5 * np.sqrt(2 / n)


@pytest.mark.parametrize("position", [(9000.0, 5000.0), (9000.3, 4999.6)])
def test_photons_beyond_the_middle_stand_where_the_psf_has_them(wide_and_narrow, position):
    """A Gaussian of 3 px, pixels beyond the middle's 8 px alone: the shift that fits them best is 0, to 0.07 px."""
    window, (x, y) = Window(8940, 9061, 4940, 5061), position
    counted, *_ = shoot(make(wide_and_narrow.psf, x, y, 3e6), wide_and_narrow, window=window)
    dx, dy = np.arange(window.x0, window.x1) - x, np.arange(window.y0, window.y1) - y
    model = 3e6 * np.outer(np.exp(-0.5 * dy**2 / 9), np.exp(-0.5 * dx**2 / 9)) / (18 * np.pi)
    far = (np.maximum(np.abs(dx), np.abs(dy)[:, None]) > 9) & (model > 0.1)
    for slope in (np.broadcast_to(dx / 9, model.shape), np.broadcast_to(dy[:, None] / 9, model.shape)):
        weight = np.where(far, slope, 0.0)
        shift, error = (weight * (counted - model)).sum(), np.sqrt((weight**2 * model).sum())
        information = (weight**2 * model).sum()
        assert SIGMA * error / information < 0.07  # px: half a cell is 0.125
        assert abs(shift) < SIGMA * error


def test_the_table_of_the_wing_holds_the_radius_of_each_share_of_its_light(psf_r):
    """Shares from 2^-10 to 1 of the light beyond 32 px, in 128 steps to an octave; it ends where the box does."""
    wing = read_scattered(psf_r).wing
    table = tail_table(wing, 32.0)
    fraction = np.append(np.ldexp(1 + np.arange(128) / 128, np.arange(-10, 0)[:, None]).ravel(), 1.0)
    assert len(table) == 10 * 128 + 1 and table[-1] == pytest.approx(32.0)
    some = np.array([200, 500, 900, 1279])
    beyond = wing.light_beyond(table[some]).mean(axis=0) / wing.light_beyond(np.array([32.0])).mean(axis=0)
    assert beyond == pytest.approx(fraction[some], rel=1e-3)


def test_what_photons_know_of_a_profile(psf_r):
    """A point, a disk with a bulge, a bulge without light, an index between nodes, and spots in a disk's place."""
    scene = make(psf_r, [4000.0] * 5, [5000.0] * 5, 10.0, index=1.0, size=0.4, bulge=0.5)
    scene.sersic[0] = 0.0
    scene.component_fractions[2], scene.component_fractions[3] = (1.0, 0.0), (0.25, 0.75)
    scene.sersic[3, 0, 0], scene.sersic[1, 1, 2] = 2.5, 0.7
    spots = Spots(counts=[2, 3], u=np.arange(5.0), v=np.zeros(5))
    profiles = profiles_of(replace(scene, spots=spots, spot=np.array([-1, -1, -1, -1, 1])))
    assert profiles.kind[:3].tolist() == [[-1, -1], [0, 1], [0, -1]]
    assert profiles.kind[3, 1] == 1 and profiles.kind[4, 0] == -3
    assert profiles.radius[1].tolist() == [0.4, 0.7]
    assert 0 < profiles.fraction[3, 0] < 1 and profiles.kind[3, 0] >= 2
    assert not profiles.fraction[[0, 1, 2, 4]].any()
    tables = profiles.tables
    assert len(tables.rings) > 2
    assert tables.spots.start.tolist() == [0, 2, 5] and tables.spots.u.tolist() == [0, 1, 2, 3, 4]
    plain = profiles_of(scene.take(np.arange(3)))
    assert len(plain.tables.rings) == 2 and plain.tables.spots.start.tolist() == [0]
    for name in ("kind", "fraction", "radius"):
        assert np.array_equal(getattr(plain, name), getattr(profiles, name)[:3])


@pytest.mark.parametrize("side", [0.0, 0.4])
def test_spots_have_their_light_and_the_blur_of_their_pixels(side):
    """A quarter and three quarters of the light at two positions; each blurred along both axes.

    Three uniform numbers of a pixel's side have a quarter of side^2 each on an axis; both axes are independent.
    """
    count, matrix = 40_000, np.array([[2.0, 0.5], [-1.0, 3.0]])
    # of the group's three spots, the last has no light of its own
    spots = SampledSpots(
        start=np.array([0, 1, 3]),
        u=np.array([9.0, 5.0, -5.0]),
        v=np.array([9.0, 1.0, 4.0]),
        keep=np.array([1.0, 0.5, 1.0]),
        other=np.array([0, 1, 1]),
        blur=np.array([0.0, side]),
    )
    profile = Profile(matrix, -3, 0.0, 0.0, ProfileTables(np.zeros((1, 1)), spots))
    px, py = np.full(count, 100.0), np.full(count, 200.0)
    after = _from_spots(count, profile, px, py, np.uint64(7), np.uint64(11))
    assert int(after) == 11 + 2 * count
    u, v = np.linalg.solve(matrix, [px - 100.0, py - 200.0])
    first = u > 0
    assert abs(first.mean() - 0.25) < 5 * np.sqrt(0.25 * 0.75 / count)
    for mine, position in ((first, (5.0, 1.0)), (~first, (-5.0, 4.0))):
        off = np.array([u[mine] - position[0], v[mine] - position[1]])
        assert np.abs(off).max() <= 1.5 * side + 1e-12
        if side:
            n = mine.sum()
            assert np.abs(off.mean(axis=1)).max() < 5 * side / 2 / np.sqrt(n)
            spread = np.cov(off) / (side**2 / 4)
            assert np.abs(spread - np.eye(2)).max() < 5 * np.sqrt(2 / n)
