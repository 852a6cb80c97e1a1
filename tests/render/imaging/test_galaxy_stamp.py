"""Galaxy stamps against GalSim pixel by pixel, conservation of light, and extreme shapes."""

import numpy as np
import pytest
from render.galaxies import SCALE, galsim_image, scene_of, shaped
from scipy.special import gammainc
from support.canvases import blank

from csstsim.catalog.flags import NEGATIVE_CLIPPED
from csstsim.catalog.profiles.sersic import sersic_b
from csstsim.instrument.chip import Window
from csstsim.render.imaging import galaxy_stamp
from csstsim.render.imaging.stamps import draw_scene
from csstsim.render.imaging.thin_galaxy import Components
from csstsim.render.psf_mixture import BINS
from csstsim.studies.bench.imaging.measures import moments

X, Y = 4200, 5150
FLUX, SIZE, SHAPE, PIXEL = 1e-3, 1e-3, 1e-4, 1e-3  # relative, relative, absolute, of the peak
CENTROID_PX = 0.001 / SCALE  # 1 mas


def around(half, x=X, y=Y):
    return Window(x - half, x + half + 1, y - half, y + half + 1)


def draw(mixer, scene, half, window=None):
    canvas = blank(window or around(half))
    return canvas.expected, draw_scene(canvas, scene.sized(half), mixer)


@pytest.mark.parametrize("index", [0.5, 1.0, 2.5, 4.0, 6.0])
@pytest.mark.parametrize(
    "size, q, phase", [(0.08, 0.6, (0.21, -0.33)), (0.3, 0.15, (0.5, 0.5)), (0.3, 0.7, (0, 0)), (0.8, 0.4, (-0.4, 0.1))]
)
def test_a_galaxy_is_galsims(psf_r, mixer, index, size, q, phase):
    x, y, half, matrix = X + phase[0], Y + phase[1], 50, shaped(q, 10 * size + index)
    theirs = galsim_image(psf_r, x, y, half, index, size, matrix)
    scene = scene_of(psf_r, x, y, 1e5, index, size, matrix)
    # GalSim rounds half a pixel up or down as Python's round does; the stamp has its centre there
    image, drawn = draw(mixer, scene, half, around(half, round(x), round(y)))
    image = image / 1e5
    got, wanted = moments(image).value, moments(theirs).value
    assert np.abs(image - theirs).max() < PIXEL * theirs.max()
    assert got[0] == pytest.approx(wanted[0], rel=FLUX)
    assert np.abs(got[1:3] - wanted[1:3]).max() < CENTROID_PX
    assert got[5] == pytest.approx(wanted[5], rel=SIZE)
    assert np.abs(got[3:5] - wanted[3:5]).max() < SHAPE
    assert not drawn.flags[0] and drawn.drawn[0] == pytest.approx(1e5 * image.sum(dtype=float), rel=1e-6)


@pytest.mark.parametrize("size, half, worst", [(3.0, 300, 5e-4), (1.0, 150, 5e-4)])
def test_a_large_disk_with_a_bulge(psf_r, mixer, size, half, worst):
    """Small transforms and outer parts in real space: the same pixels as GalSim's one large transform."""
    matrix = shaped(0.5, 0.7)
    scene = scene_of(psf_r, X + 0.2, Y - 0.3, 1e6, 1.0, size, matrix, bulge=0.4, bulge_size=0.5 * size)
    image, _ = draw(mixer, scene, half)
    theirs = 0.6 * galsim_image(psf_r, X + 0.2, Y - 0.3, half, 1.0, size, matrix)
    theirs += 0.4 * galsim_image(psf_r, X + 0.2, Y - 0.3, half, 4.0, 0.5 * size, matrix, 2e-2)
    assert np.abs(image / 1e6 - theirs).max() < worst * theirs.max()
    assert image.sum(dtype=float) / 1e6 == pytest.approx(theirs.sum(), rel=FLUX)


@pytest.mark.parametrize("index", [0.3, 0.5, 1.0, 4.0])
@pytest.mark.parametrize("q", [1.0, 0.3])
def test_light_is_conserved(psf_r, mixer, index, q):
    """On a stamp that holds all of the profile but under 1e-4: the electrons times the light in the PSF's box."""
    half = {0.3: 60, 0.5: 60, 1.0: 90, 4.0: 1500}[index]
    image, drawn = draw(mixer, scene_of(psf_r, X + 0.1, Y + 0.4, 1e6, index, 0.25, shaped(q, 1.0)), half)
    enclosed = psf_r.at(X, Y).sum() / 4
    assert drawn.drawn[0] == pytest.approx(1e6 * enclosed, rel=1e-4)
    assert (image >= 0).all()


def test_the_matrix_points_where_it_says(psf_r, mixer):
    """A long axis at 30 degrees from x towards y, a shear, and a mirror: the second moments' axis is there."""
    for angle in (0.0, np.pi / 6, 2.0):
        image, _ = draw(mixer, scene_of(psf_r, X, Y, 1e6, 1.0, 0.5, shaped(0.3, angle)), 60)
        e1, e2 = moments(image.astype(float)).value[3:5]
        assert 0.5 * np.arctan2(e2, e1) % np.pi == pytest.approx(angle % np.pi, abs=0.02) or angle == 0.0
        assert np.hypot(e1, e2) > 0.2
    mirrored = np.diag([1.0, -1.0]) @ shaped(0.3, np.pi / 6)
    image, _ = draw(mixer, scene_of(psf_r, X, Y, 1e6, 1.0, 0.5, mirrored), 60)
    assert moments(image.astype(float)).value[4] < -0.1


@pytest.mark.parametrize("index", [0.3, 1.0, 4.0, 6.2])
def test_a_tiny_galaxy_is_a_point(psf_r, mixer, index):
    """Half-light radius 1e-4 arcsec, to 2e-3 of the peak (the n = 6.2 wing is wider than that)."""
    image, _ = draw(mixer, scene_of(psf_r, X + 0.3, Y + 0.2, 1e6, index, 1e-4), 40)
    point, _ = draw(mixer, scene_of(psf_r, X + 0.3, Y + 0.2, 1e6, 0.0), 40)
    assert np.abs(image - point).max() < 2e-3 * point.max()
    assert image.sum(dtype=float) == pytest.approx(point.sum(dtype=float), rel=FLUX)


@pytest.mark.parametrize("index", [0.3, 1.0, 4.0, 6.2])
@pytest.mark.parametrize("size, q", [(1e-4, 0.02), (0.3, 0.02), (60.0, 1.0), (60.0, 0.02)])
def test_extremes_are_finite_positive_and_not_too_bright(psf_r, mixer, index, size, q):
    half = 400 if size > 1 else 60
    image, drawn = draw(mixer, scene_of(psf_r, X, Y, 1e6, index, size, shaped(q, 0.4)), half)
    assert np.isfinite(image).all() and (image >= 0).all()
    assert 0 < drawn.drawn[0] < 1.0001e6
    assert not drawn.flags[0] & ~NEGATIVE_CLIPPED
    assert image.max() <= (1 + PIXEL) * image[half - 1 : half + 2, half - 1 : half + 2].max()


@pytest.mark.parametrize("index, size", [(1.0, 60.0), (4.0, 20.0)])
def test_a_huge_galaxy_holds_the_light_of_its_formula(psf_r, mixer, index, size):
    """Within a circle of r_e / 2, beyond the PSF's reach: the incomplete gamma function times the box's light."""
    half = round(0.5 * size / SCALE) + 5
    image, _ = draw(mixer, scene_of(psf_r, X, Y, 1e8, index, size), half)
    axis = np.arange(-half, half + 1)
    inside = image[np.hypot(axis, axis[:, None]) < 0.5 * size / SCALE].sum(dtype=float)
    part = gammainc(2 * index, sersic_b(index) * 0.5 ** (1 / index))
    assert inside == pytest.approx(1e8 * part * psf_r.at(X, Y).sum() / 4, rel=2e-3)


@pytest.mark.parametrize("turn", [15.0, 45.0, 90.0, 130.0])
def test_the_last_frequency_is_that_of_the_shape_not_of_its_direction(turn):
    """Turned and mirrored, a long Gaussian has the same, to a bin; a rounder one a lower one."""
    inner, outer = galaxy_stamp._component_tables(0.5, 6.0, 0.0, 0.0)
    sersic, light = np.array([[0.5, 0.0, 1.0], [0.0, 0.0, 0.0]]), np.array([1.0, 0.0])
    cut = np.array([6.0, np.inf])
    envelope = np.exp(-((BINS / 0.3) ** 2))

    def last(matrix):
        components = Components(sersic, light, np.array(matrix, float), inner, outer, cut)
        found = galaxy_stamp._cutoff(components, envelope)
        return int(np.flatnonzero(found == BINS)[0])

    c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    for long in (np.diag([12.0, 2.0]), np.diag([6.0, 12.0])):
        for turned in (long @ [[c, -s], [s, c]], [[c, s], [-s, c]] @ long, long @ [[c, s], [s, -c]]):
            assert abs(last(turned) - last(long)) <= 1
    assert last(np.diag([12.0, 12.0])) < last(np.diag([12.0, 6.0])) - 2 < last(np.diag([12.0, 2.0])) - 4
