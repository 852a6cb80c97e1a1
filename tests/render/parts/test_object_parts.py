"""Knots and images: photons, stamps and reference against each other, and images against the profile they are of."""

from dataclasses import replace

import galsim
import numpy as np
import pytest
from astropy.io import fits
from render.imaging.test_reference import objects
from support.canvases import blank

from csstsim.base.errors import InputError
from csstsim.catalog.galaxy_shapes.galsim_images import image_of
from csstsim.catalog.galaxy_shapes.images import read_image
from csstsim.catalog.galaxy_shapes.knots import knots_of
from csstsim.catalog.table import GALAXY, ObjectTable
from csstsim.instrument.chip import Window
from csstsim.optics.geometry.wcs import ChipWCS
from csstsim.optics.scatter.scattered_light import Scattered
from csstsim.render.drawing import Drawing
from csstsim.render.imaging import draw, reference
from csstsim.render.parts import object_parts
from csstsim.render.parts.object_parts import _cut, _reach_of, part_keys
from csstsim.render.scene import make_scene
from csstsim.simulation.frame import shown_table
from csstsim.studies.bench.imaging.measures import moments

SCALE, EXPTIME, HALF = 0.074, 100.0, 60
X, Y = 4200, 5150
FLUX, SIZE, SHAPE, CENTROID_PX, PIXEL = 1e-3, 1e-3, 1e-4, 0.001 / SCALE, 1e-3
SIGMA = 5.0
WINDOW = Window(X - HALF, X + HALF + 1, Y - HALF, Y + HALF + 1)
LENSED = {"kappa": 0.05, "gamma1": 0.03, "gamma2": -0.04}


@pytest.fixture(scope="module")
def show(camera, make_pointing, psf_r, psf_tables):
    """Return (light, table) of one galaxy drawn with a fidelity."""
    wcs = ChipWCS(camera.chips[9], make_pointing(pa=30.0))

    def made(fidelity, electrons=1e6, x=X + 0.3, y=Y - 0.2, window=WINDOW, reach=58, key=1, **columns):
        columns = {name: np.atleast_1d(value) for name, value in columns.items()}
        table = objects(wcs, x, y, GALAXY, reach, electrons / EXPTIME, **columns)
        canvas = blank(window, float)
        how = Scattered(), fidelity, 60.0, np.uint64(key), psf_tables
        drawing = Drawing(wcs, psf_r, EXPTIME, *how)
        drawn = (reference if fidelity == "reference" else draw).draw_objects(canvas, table, drawing)
        light = canvas.expected if canvas.counted is None else canvas.expected + canvas.counted
        return light / electrons, drawn

    made.scene = lambda **columns: make_scene(
        objects(wcs, X, Y, GALAXY, 58, 1.0, **{n: np.atleast_1d(v) for n, v in columns.items()}), wcs, psf_r, EXPTIME
    )
    return made


def agree(got, wanted, pixel=PIXEL, sigma=6.0):
    """Hold flux, centroid, shape and size^2 within the goals, and the worst pixel within `pixel` of the peak."""
    one, other = moments(got, sigma).value, moments(wanted, sigma).value
    assert one[0] == pytest.approx(other[0], rel=FLUX)
    assert np.abs(one[1:3] - other[1:3]).max() < CENTROID_PX
    assert one[5] == pytest.approx(other[5], rel=SIZE)
    assert np.abs(one[3:5] - other[3:5]).max() < SHAPE
    assert np.abs(got - wanted).max() < pixel * wanted.max()


def as_light(counted, wanted, electrons, sigma=6.0):
    """Hold the moments of counted electrons within SIGMA of their errors and the goals."""
    one, other = moments(counted, sigma), moments(wanted, sigma)
    goals = np.array([FLUX * other.value[0], CENTROID_PX, CENTROID_PX, SHAPE, SHAPE, SIZE * other.value[5]])
    chance = other.spread / np.sqrt(electrons)
    assert (np.abs(one.value - other.value) < SIGMA * chance + goals).all()


KNOTS = {"size_disk": 0.4, "e1": 0.3, "e2": -0.2, "bulge_frac": 0.2, "size_bulge": 0.15, "knots": 20, "knots_frac": 0.5}


@pytest.mark.parametrize("columns", [KNOTS, KNOTS | {"knots": 3, "knots_frac": 1.0, "bulge_frac": 0.0} | LENSED])
def test_knots_are_the_same_light_in_all_fidelities(show, columns):
    wanted, table = show("reference", **columns)
    assert table["method"][0] == "reference"
    stamps, table = show("noise_free", **columns)
    agree(stamps, wanted)
    assert table["method"][0] == "stamp" and len(table) == 1
    assert stamps.sum() * 1e6 == pytest.approx(table["drawn"][0], rel=1e-5)
    many_photons(show, wanted, **columns)


def many_photons(show, wanted, electrons=3e4, times=40, **columns):
    """Hold the sum of many exposures drawn as photons to the light wanted."""
    total = 0.0
    for key in range(1, times + 1):
        photons, table = show("standard", electrons, key=key, **columns)
        assert table["method"][0] == "photons"
        total = total + photons / times
    as_light(total, wanted, electrons * times)


def test_knots_are_galsims_points(show, psf_r):
    """Each knot a point of GalSim's at the position that its table says, turned by the matrix: pixel by pixel."""
    columns = KNOTS | LENSED | {"knots": 7, "knots_frac": 1.0, "bulge_frac": 0.0}
    scene = show.scene(**columns)
    stamps, _ = show("noise_free", x=X, y=Y, **columns)
    u, v, light = scene.spots.group(0)
    wanted = 0.0
    for position in (scene.matrix[0] @ np.stack([u, v])).T:
        star = reference.point(psf_r.at(X, Y).mean(axis=0), psf_r.oversampling)
        image = galsim.ImageD(2 * HALF + 1, 2 * HALF + 1)
        star.drawImage(image, scale=1.0, method="no_pixel", offset=galsim.PositionD(*position))
        wanted = wanted + image.array / len(u)
    assert light == pytest.approx(1 / 7) and len(u) == 7
    agree(stamps, wanted)


def test_knots_lie_in_the_disks_profile(show):
    """4000 of them: half within the half-light radius, none beyond 98% of the light, no direction preferred."""
    table = show.scene  # the same function of a table as the renderers use
    scene = table(size_disk=0.5, knots=4000, knots_frac=0.5, n_disk=1.5, id=7)
    u, v, _ = scene.spots.group(0)
    r = np.hypot(u, v) / 0.5
    inside = (r < 1).mean()
    assert inside == pytest.approx(0.5 / 0.98, abs=SIGMA * np.sqrt(0.25 / 4000))
    from scipy.special import gammaincinv

    last = (gammaincinv(3.0, 0.98) / gammaincinv(3.0, 0.5)) ** 1.5
    assert 0.9 * last < r.max() <= last * (1 + 1e-3)
    assert abs(u.mean()) + abs(v.mean()) < 2 * SIGMA * u.std() / np.sqrt(4000)


def test_knots_belong_to_their_galaxy(show):
    """The same in every exposure and among any others; other galaxies have others."""
    one, two = ({"size_disk": 0.5, "knots": 9, "knots_frac": 0.5, "id": i} for i in (5, 6))
    alone, other, again = (show.scene(**columns).spots for columns in (one, two, one))
    assert np.array_equal(alone.u, again.u) and not np.isclose(alone.u, other.u).any()
    both = knots_of(objects_of(show, id=[6, 5], size_disk=[0.5, 0.5], knots=[9, 9], knots_frac=[0.5, 0.2]))
    assert np.array_equal(both.u[9:], alone.u) and np.array_equal(both.u[:9], other.u)


def test_knots_of_a_frames_truth(show):
    """As the astropy Table of a Frame, and as csstsim.io.truth reads it: the ids have another name there."""
    table = objects_of(show, id=[6, 5], size_disk=[0.5, 0.5], knots=[9, 0], knots_frac=[0.5, 0.0])
    named = {"obj_ID" if name == "id" else name: table[name] for name in table}
    for truth in (shown_table(ObjectTable(named)), ObjectTable(named)):
        assert all(np.array_equal(*pair) for pair in zip(knots_of(table), knots_of(truth), strict=True))
    with pytest.raises(InputError, match="lacks a column"):
        knots_of(ObjectTable({"knots": [3], "knots_frac": [0.5]}))


def objects_of(show, **columns):
    from support.csst import BANDS

    from csstsim.catalog.table import ObjectTable

    return ObjectTable.complete({"obj_type": GALAXY} | {k: np.asarray(v) for k, v in columns.items()}, BANDS)


def sersic_file(path, n, size, scale, side, e1=0.0, e2=0.0):
    """Write an image of a Sersic profile as GalSim integrates it over pixels; return the columns that draw it."""
    profile = galsim.Sersic(n, half_light_radius=size).shear(g1=e1, g2=e2)
    image = galsim.ImageD(side, side)
    profile.drawImage(image, scale=scale, method="auto")
    fits.writeto(path, image.array, overwrite=True)
    picture = read_image(str(path))
    return {
        "image_file": str(path), "image_scale": scale, "image_radius": picture.radius * scale, "size_disk": size,
        "image_pa": 0.0,
    }  # fmt: skip


@pytest.mark.thorough
@pytest.mark.parametrize("n, size, scale, side", [(1.0, 0.25, 0.03, 241), (2.5, 0.15, 0.02, 501), (0.5, 0.3, 0.05, 60)])
@pytest.mark.parametrize("lens", [{}, LENSED])
def test_an_image_of_a_profile_is_the_profile(show, tmp_path, n, size, scale, side, lens):
    """The image has columns to the west, so e1, which is along east, keeps its sign and e2 has the other one."""
    columns = sersic_file(tmp_path / "s.fits", n, size, scale, side, 0.2, 0.1)
    wanted, _ = show("noise_free", n_disk=n, size_disk=size, e1=0.2, e2=-0.1, **lens)
    for fidelity in ("reference", "noise_free"):
        got, table = show(fidelity, **columns | lens)
        agree(got, wanted, 2e-3)
        assert got.sum() * 1e6 == pytest.approx(table["drawn"][0], rel=1e-5)
    many_photons(show, wanted, **columns | lens)


@pytest.mark.parametrize("n, size", [(1.0, 0.25), (2.5, 0.2)])
def test_a_galsim_object_has_the_axes_of_the_catalogue(show, tmp_path, n, size):
    """GalSim's g1, g2 are e1, e2: a profile that a class gives is that of a row, in every fidelity."""
    made = image_of(galsim.Sersic(n, half_light_radius=size).shear(g1=0.2, g2=0.1), tmp_path, "here")
    picture = read_image(made["image_file"])
    columns = {"image_file": made["image_file"], "image_scale": made["image_scale"], "size_disk": size,
               "image_radius": picture.radius * made["image_scale"], "image_pa": 0.0}  # fmt: skip
    wanted, _ = show("noise_free", n_disk=n, size_disk=size, e1=0.2, e2=0.1, **LENSED)
    for fidelity in ("reference", "noise_free"):
        got, _ = show(fidelity, **columns | LENSED)
        agree(got, wanted, 2e-3)


@pytest.mark.parametrize("kind", ["knots", "image"])
@pytest.mark.parametrize("axis", ["gamma1", "gamma2"])
def test_shear_moves_second_moments_as_the_formula_says(show, tmp_path, kind, axis):
    """Quadrupoles under +g and -g differ by those of the light without a PSF, which adds its own to both: within 1e-3.

    The light's own, by its spots: the matrix acts on each; pixels of an image add the extent of their splines.
    """
    columns = {"size_disk": 0.3, "knots": 40, "knots_frac": 1.0, "n_disk": 0.5}
    if kind == "image":
        columns = sersic_file(tmp_path / "s.fits", 0.5, 0.3, 0.05, 60)
    got, wanted = [], []
    pixels = np.arange(2 * HALF + 1) - HALF
    for g in (0.02, -0.02):
        image, _ = show("noise_free", x=X, y=Y, **columns | {axis: g})
        fraction = image / image.sum()
        mx, my = fraction.sum(axis=0) @ pixels, fraction.sum(axis=1) @ pixels
        got.append([fraction.sum(axis=0) @ (pixels - mx) ** 2 - fraction.sum(axis=1) @ (pixels - my) ** 2,
                    2 * ((fraction @ (pixels - mx)) @ (pixels - my))])  # fmt: skip
        scene = show.scene(**columns | {axis: g})
        u, v, light = scene.spots.group(0)
        position = scene.matrix[0] @ (np.stack([u, v]) - [[light @ u], [light @ v]])
        q = np.einsum("k,ik,jk->ij", light, position, position)
        q += 0.25 * scene.spots.blur[0] * scene.matrix[0] @ scene.matrix[0].T
        wanted.append([q[0, 0] - q[1, 1], 2 * q[0, 1]])
    difference, formula = np.subtract(*got), np.subtract(*wanted)
    assert np.abs(difference - formula).max() < 1e-3 * np.abs(formula).max()


def test_a_large_image_is_cut_in_tiles():
    """4 rows by 6 columns: by how many pixels a column and a row cover; dark tiles are left out."""
    image = np.arange(24.0).reshape(4, 6) / 276
    wide = list(_cut(image, (100.0, 50.0), 7))  # 600 x 200 px
    assert [group for group, *_ in wide] == [7, 8]
    assert [middle.tolist() for _, _, middle, _ in wide] == [[-1.5, 0.0], [1.5, 0.0]]
    assert [fraction for _, fraction, *_ in wide] == pytest.approx([120 / 276, 156 / 276])
    for (*_, tile), part in zip(wide, (image[:, :3], image[:, 3:]), strict=True):
        assert tile == pytest.approx(part / part.sum())
    tall = list(_cut(image, (50.0, 200.0), 0))  # 300 x 800 px
    assert [middle.tolist() for _, _, middle, _ in tall] == [[0.0, -1.5], [0.0, 0.0], [0.0, 1.5]]
    assert [tile.shape for *_, tile in tall] == [(1, 6), (2, 6), (1, 6)]
    image[1:3] = 0.0
    dark = list(_cut(image, (50.0, 200.0), 3))
    assert [(group, middle.tolist()) for group, _, middle, _ in dark] == [(3, [0.0, -1.5]), (4, [0.0, 1.5])]
    assert len(list(_cut(image, (64.0, 96.0), 0))) == 1  # 384 px each: just one


def test_tiles_reach_as_far_as_their_light_and_the_blur_of_the_whole():
    """Extent times the matrix' longer axis, and what the object reaches beyond its farthest tile, 16 to 64 px."""
    matrix = np.tile(np.diag([1.0, 2.0]), (4, 1, 1))
    at, extent = np.array([[3.0, 4.0]] * 4), np.array([10.0, 10.0, 10.0, 10.3])
    reach = np.array([60, 30, 200, 24], np.int32)  # the tile ends at 5 + 20 px; the last was cut off before
    got = _reach_of(reach, at, extent, matrix)
    assert got.tolist() == [20 + 35, 30, 20 + 64, 24] and got.dtype == np.int32
    assert _reach_of(np.array([500]), at[:1], np.array([100.2]), matrix[:1]).tolist() == [265]


def test_parts_of_an_object_share_out_its_light(show):
    """Half of a galaxy's light in knots, a fifth in its bulge: 0.3 disk; all knots: nothing else is left."""
    scene = show.scene(**KNOTS)
    assert scene.parent.tolist() == [0, 0] and scene.spot.tolist() == [-1, 0] and scene.objects == 1
    assert scene.fraction_of_parent == pytest.approx([0.5, 0.5])
    assert scene.component_fractions == pytest.approx(np.array([[0.6, 0.4], [1.0, 0.0]]), abs=1e-6)
    assert not scene.sersic[1, 1].any() and scene.sersic[1, 0] == pytest.approx([0, 0, 0.4])
    assert scene.electrons[1] == pytest.approx(scene.electrons[0])
    assert scene.electrons.sum() == pytest.approx(EXPTIME)
    alone = show.scene(**KNOTS | {"knots_frac": 1.0, "bulge_frac": 0.0})
    assert alone.fraction_of_parent.tolist() == [0, 1] and alone.component_fractions.tolist() == [[1, 0], [1, 0]]


def test_tiles_of_images_are_those_of_the_largest_that_is_drawn(camera, make_pointing, psf_r, tmp_path, monkeypatch):
    """An image of 40 x 20 pixels, 2 and 1 px of the chip a pixel: cut at 45 px along its 80, in both objects alike."""
    monkeypatch.setattr(object_parts, "TILE_PX", 45.0)
    y, x = np.mgrid[:20, :40]
    fits.writeto(tmp_path / "a.fits", np.exp(-0.5 * (((x - 22) / 7) ** 2 + ((y - 8) / 4) ** 2)))
    columns = {
        "image_file": np.array([str(tmp_path / "a.fits")] * 2), "image_scale": np.array([1.0, 2.0]) * SCALE,
        "image_pa": np.zeros(2),
    }  # fmt: skip
    wcs = ChipWCS(camera.chips[9], make_pointing())
    table = objects(wcs, [X - 300.0, X + 300.0], [Y, Y + 9.0], GALAXY, 200, 1.0, **columns)
    scene = make_scene(table, wcs, psf_r, EXPTIME)
    assert scene.parent.tolist() == [0, 1, 0, 1] and scene.spot.tolist() == [0, 0, 1, 1]
    for first, second in ((0, 2), (1, 3)):
        assert scene.fraction_of_parent[first] + scene.fraction_of_parent[second] == pytest.approx(1)
        light = scene.fraction_of_parent[[first, second]]
        positions = np.stack([scene.x, scene.y], axis=1)[[first, second]]
        apart = np.hypot(*(positions[1] - positions[0]))
        assert apart == pytest.approx(21 * (1.0, 2.0)[first], rel=0.02)  # half of the 42 columns of coefficients
        middle = np.array([table["x"][first], table["y"][first]])
        assert np.abs(positions.mean(axis=0) - middle).max() < 0.01 and light[1] > light[0]
    assert scene.sersic[:, 0, 2] == pytest.approx(0.35 * 21)  # of the shorter side of a tile: 22 x 21
    assert scene.electrons.sum() == pytest.approx(2 * EXPTIME)
    whole = [image.shape for image in (scene.spots.image(0), scene.spots.image(1))]
    assert whole == [(22, 21), (22, 21)]


def test_keys_of_parts_depend_on_their_object_alone(show):
    """All differ; an object's first part has the same key whatever stands before it in the table."""
    one = show.scene(**KNOTS)
    keys = np.array([5, 11], np.uint64)
    rows = np.array([0, 1, 1, 0, 1])
    both = replace(one.take(np.array([0] * 5)), parent=rows)
    made = part_keys(keys, both)
    assert made[:2].tolist() == [5, 11] and len(set(made.tolist())) == 5
    # rows 0 and 1 are the objects; of the parts, two are of object 1 and one is of object 0
    swapped = part_keys(keys[::-1].copy(), replace(both, parent=np.array([0, 1, 0, 1, 0])))
    assert swapped[2:].tolist() == made[2:].tolist()
    behind = part_keys(keys, replace(one.take(np.array([0] * 4)), parent=np.array([0, 1, 0, 1])))
    assert behind[3] == made[2]  # the first of object 1, behind one of object 0
    fewer = part_keys(keys, replace(one.take(np.array([0] * 3)), parent=np.array([0, 1, 1])))
    assert fewer[2] == made[2]
    assert part_keys(keys, one.take(np.array([0, 0]))) is keys
