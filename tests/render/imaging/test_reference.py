"""The reference renderer against exact sums, an independent convolution, and astropy's sky coordinates."""

import galsim
import numpy as np
import pytest
from astropy.wcs import WCS
from support.canvases import blank
from support.csst import BANDS

from csstsim.catalog.flags import BAD_VALUE, FFT_REDUCED, NEGATIVE_CLIPPED, OFF_CHIP
from csstsim.catalog.table import GALAXY, STAR, ObjectTable
from csstsim.instrument.chip import Window
from csstsim.optics.geometry.wcs import ChipWCS
from csstsim.optics.psf.diffraction import windowed_centroid
from csstsim.optics.psf.psf_file import pixel_response
from csstsim.render.drawing import Drawing
from csstsim.render.imaging.reference import clip_negative, draw_objects

EXPTIME = 100.0
WINDOW = Window(4000, 4400, 5000, 5300)
SIGMA_PX = 1.5  # window of the centroid
CENTROID_PX = 0.005  # what rendering may move a star's light
FLUX = 1e-3  # relative, the project's goal
PIXEL = 3e-4  # of the peak: what GalSim's transform of the lattice costs


def objects(wcs, x, y, obj_type=STAR, reach=64, rate=100.0, **columns):
    """A table as catalog.selection.select leaves it."""
    x, y = np.atleast_1d(np.asarray(x, float)), np.atleast_1d(np.asarray(y, float))
    ra, dec = wcs.pixel_to_world(x, y)
    base = {
        "id": np.arange(len(x)), "obj_type": np.full(len(x), obj_type), "ra": ra, "dec": dec,
        "ra_orig": ra, "dec_orig": dec, "x": x, "y": y,
        "reach": np.full(len(x), reach), "lost": np.full(len(x), 1e-4),
        "wing": np.zeros(len(x)),
    }  # fmt: skip
    base |= {f"flux{i}": np.full(len(x), rate / 4) for i in range(4)}
    return ObjectTable.complete(base | columns, BANDS)


@pytest.fixture(scope="module")
def scene(camera, make_pointing, psf_r):
    wcs = ChipWCS(camera.chips[9], make_pointing())

    def draw(window=WINDOW, **columns):
        canvas = blank(window)
        return canvas.expected, draw_objects(canvas, objects(wcs, **columns), Drawing(wcs, psf_r, EXPTIME))

    return draw


def centroid(image, x, y):
    """Windowed centroid of the light around integer pixel (x, y), in pixels of the window."""
    half = 12
    cut = image[y - half : y + half + 1, x - half : x + half + 1].astype(float)
    dx, dy = windowed_centroid(cut, SIGMA_PX)
    return x + dx, y + dy


@pytest.mark.parametrize("phase", [(0, 0), (0.5, 0.5), (0.25, -0.37), (-0.49, 0.13)])
def test_star_has_its_light_where_it_stands(scene, psf_r, phase):
    x, y = 4200 + phase[0], 5150 + phase[1]
    image, drawn = scene(x=x, y=y)
    enclosed = psf_r.at(x, y).sum() / 4
    assert drawn["drawn"][0] == pytest.approx(100 * EXPTIME * enclosed, rel=FLUX)
    assert image.sum(dtype=float) == pytest.approx(drawn["drawn"][0], rel=1e-6)
    assert np.array(centroid(image, 200, 150)) == pytest.approx([x - 4000, y - 5000], abs=CENTROID_PX)


def test_star_is_the_psf_integrated_over_pixels(scene, psf_r):
    """At phase 0 the pixels are sums of whole cells: no interpolation, so equal to rounding."""
    image, _ = scene(x=4200, y=5150)
    step = psf_r.oversampling
    response = pixel_response(psf_r.at(4200, 5150).mean(axis=0), step)
    on_star = response.shape[0] // 2 % step
    table = response[on_star::step, on_star::step] * 100 * EXPTIME
    half = table.shape[0] // 2
    cut = image[150 - half : 150 + half + 1, 200 - half : 200 + half + 1]
    assert np.abs(cut - table).max() < 2e-6 * table.max()


def test_galaxy_matches_its_transform_by_hand(scene, psf_r):
    """Exponential disk: (1 + (k r_d)^2)^-1.5 times the PSF's transform, by numpy alone."""
    size = 0.5  # arcsec, half-light
    image, _ = scene(x=4200, y=5150, obj_type=GALAXY, reach=100, size_disk=size, rate=1000.0)
    step, wide = psf_r.oversampling, 512 * psf_r.oversampling
    response = np.zeros((wide, wide))
    table = pixel_response(psf_r.at(4200, 5150).mean(axis=0), step)
    response[: len(table), : len(table)] = table
    response = np.roll(response, (-(len(table) // 2),) * 2, axis=(0, 1))
    k = 2 * np.pi * np.fft.fftfreq(wide, d=1 / step)  # rad / px
    disk = size / 1.6783469900166605 / 0.074  # px
    transform = (1 + (k[:, None] ** 2 + k**2) * disk**2) ** -1.5
    hand = np.fft.ifft2(np.fft.fft2(response) * transform).real * 1000 * EXPTIME
    half = 60
    cells = slice(None, 2 * step * half + 1, step)
    hand = np.roll(hand, (step * half, step * half), axis=(0, 1))[cells, cells]
    cut = image[150 - half : 150 + half + 1, 200 - half : 200 + half + 1]
    assert np.abs(cut - hand).max() < PIXEL * hand.max()
    assert cut.sum(dtype=float) == pytest.approx(hand.sum(), rel=FLUX)


@pytest.mark.parametrize("pa", [0.0, 45.0, 133.0])
@pytest.mark.parametrize("dec", [-40.0, 80.0])
@pytest.mark.parametrize("parity", [1, -1])
def test_tangential_shear_stays_tangential(camera, make_pointing, psf_r, pa, dec, parity):
    """Eight galaxies on a ring, sheared tangentially on the sky; astropy takes the measured shapes back to the sky."""
    from dataclasses import replace

    chip = replace(camera.chips[9], telescope=replace(camera.telescope, parity=parity))
    wcs = ChipWCS(chip, make_pointing(pa=pa, dec=dec))
    sky = WCS(wcs.header())
    g = 0.05
    angle = np.arange(8) * np.pi / 4 + 0.2
    x, y = 4200 + 100 * np.cos(angle), 5150 + 100 * np.sin(angle)
    ra, dec_ = wcs.pixel_to_world(x, y)
    centre = wcs.pixel_to_world(4200.0, 5150.0)
    east, north = (ra - centre[0]) * np.cos(np.radians(dec_)), dec_ - centre[1]
    phi = np.arctan2(north, east)
    table = objects(
        wcs,
        x,
        y,
        GALAXY,
        reach=40,
        rate=1000.0,
        size_disk=0.4,
        gamma1=-g * np.cos(2 * phi),
        gamma2=-g * np.sin(2 * phi),
    )
    canvas = blank(WINDOW)
    draw_objects(canvas, table, Drawing(wcs, psf_r, EXPTIME))
    image = canvas.expected
    tangential, cross = [], []
    for xi, yi, ra_i, dec_i in zip(x, y, ra, dec_, strict=True):
        e1, e2 = _sky_shape(image, xi, yi, sky, ra_i, dec_i)
        dphi = np.arctan2(dec_i - centre[1], (ra_i - centre[0]) * np.cos(np.radians(dec_i)))
        tangential.append(-(e1 * np.cos(2 * dphi) + e2 * np.sin(2 * dphi)))
        cross.append(e1 * np.sin(2 * dphi) - e2 * np.cos(2 * dphi))
    # windowed moments dilute the shear, by the same factor all around the ring; a wrong sign makes it negative or cross
    assert min(tangential) > 0.3 * g
    assert np.mean(tangential) > 0.4 * g
    assert np.abs(cross).max() < 0.15 * g


def _sky_shape(image, x, y, sky, ra, dec):
    """Weighted ellipticity on the sky (east, north) of the light around chip pixel (x, y)."""
    step = 1e-4
    px = sky.all_world2pix([[ra, dec], [ra + step / np.cos(np.radians(dec)), dec], [ra, dec + step]], 0)
    to_pixel = np.stack([px[1] - px[0], px[2] - px[0]], axis=1) / (step * 3600)
    to_sky = np.linalg.inv(to_pixel)
    cx, cy, half = x - 4000, y - 5000, 20
    cols, rows = np.arange(round(cx) - half, round(cx) + half + 1), np.arange(round(cy) - half, round(cy) + half + 1)
    grid_x, grid_y = np.meshgrid(cols - cx, rows - cy)
    e, n = np.einsum("ij,jkl->ikl", to_sky, np.stack([grid_x, grid_y]))
    weight = image[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1] * np.exp(-0.5 * (e**2 + n**2) / 0.5**2)
    qee, qnn, qen = (np.sum(weight * q) for q in (e * e, n * n, e * n))
    return (qee - qnn) / (qee + qnn), 2 * qen / (qee + qnn)


def test_window_shows_what_the_whole_chip_would(scene):
    """A window is a crop: the same object through another window gives the same pixels."""
    columns = {"x": [4005.3, 4100.0], "y": [5100.2, 5003.0]}
    image, drawn = scene(**columns)
    wide = Window(3900, 4500, 4900, 5400)
    whole, _ = scene(window=wide, **columns)
    assert np.abs(whole[100:400, 100:500] - image).max() < 1e-5 * image.max()
    assert drawn["fraction"][0] < 0.99 and drawn["x0"][0] == 4000  # cut by the window's edge, and said so


def test_what_cannot_be_drawn_is_flagged_not_dropped(scene):
    image, drawn = scene(x=[4100, 9000, 4200], y=[5100, 5100, 5200], flags=np.array([BAD_VALUE, 0, 0], np.int32))
    assert drawn["drawn"][0] == 0 and drawn["method"][0] == "none"
    assert drawn["flags"][1] & OFF_CHIP and drawn["drawn"][1] == 0
    assert drawn["drawn"][2] > 0
    assert image.sum(dtype=float) == pytest.approx(drawn["drawn"].sum(), rel=1e-6)


def test_empty_catalogue_and_zero_flux(scene):
    image, drawn = scene(x=[], y=[])
    assert len(drawn) == 0 and not image.any()
    image, drawn = scene(x=4200, y=5150, rate=0.0)
    assert not image.any() and drawn["fraction"][0] == 0 and np.isfinite(drawn["fraction"]).all()


@pytest.mark.parametrize("size", [1e-4, 3.0, 60.0])
def test_extreme_sizes_are_drawn_or_flagged(scene, size):
    """n = 4 from a point to a minute of arc: finite, never more light than there is, in the memory of the FFT limit."""
    fraction = np.ones(1)
    shape = {"bulge_frac": fraction, "size_bulge": size * fraction, "lost": 5e-3 * fraction}
    image, drawn = scene(x=4200, y=5150, obj_type=GALAXY, reach=900, **shape)
    assert np.isfinite(image).all() and (image >= 0).all()
    assert 0 < drawn["fraction"][0] < 1.001
    assert bool(drawn["flags"][0] & FFT_REDUCED) == (size > 10)
    assert drawn["fraction"][0] > {1e-4: 0.95, 3.0: 0.5, 60.0: 0.0}[size]  # the box holds 0.958


def test_the_response_is_that_of_each_pixel(scene, camera, make_pointing, psf_r):
    response = np.random.default_rng(3).uniform(0.5, 1.0, WINDOW.shape).astype(np.float32)
    wcs, table = ChipWCS(camera.chips[9], make_pointing()), {"x": [4100.0, 4390.0], "y": [5080.0, 5290.0], "rate": 1e4}
    canvas = blank(WINDOW, response=response)
    drawn = draw_objects(canvas, objects(wcs, **table), Drawing(wcs, psf_r, EXPTIME))
    plain, whole = scene(**table)
    np.testing.assert_allclose(canvas.expected, plain * response, rtol=1e-5, atol=1e-6 * plain.max())
    assert drawn["drawn"].sum() == pytest.approx(canvas.expected.sum(dtype=float), rel=1e-6)
    assert drawn["electrons"] == pytest.approx([1e6, 1e6]) and (drawn["drawn"] < 0.9 * whole["drawn"]).all()
    boxes = np.transpose([drawn[name] for name in ("x0", "x1", "y0", "y1")]).tolist()
    assert boxes == [[4036, 4165, 5016, 5145], [4326, 4400, 5226, 5300]]  # 64 px either side, cut by the window
    assert drawn["stamp"].tolist() == [129, 129] and (drawn["method"] == "reference").all()
    assert np.isnan(drawn["snr"]).all() and np.isnan(drawn["error"]).all()


def test_light_that_is_there_already_stays(camera, make_pointing, psf_r, scene):
    wcs, table = ChipWCS(camera.chips[9], make_pointing()), {"x": [4100.0], "y": [5080.0]}
    canvas = blank(WINDOW)
    canvas.expected += 7.0
    draw_objects(canvas, objects(wcs, **table), Drawing(wcs, psf_r, EXPTIME))
    np.testing.assert_allclose(canvas.expected, scene(**table)[0] + 7.0, rtol=1e-5)


@pytest.mark.parametrize(
    ("negative", "flag"), [(0.0, 0), (-0.9e-4, 0), (-1.2e-4, NEGATIVE_CLIPPED), (-5.0, NEGATIVE_CLIPPED)]
)
def test_negative_pixels_are_clipped_and_flagged_where_they_count(negative, flag):
    image = galsim.ImageD(np.array([[0.25, 0.75, negative], [0.0, -negative, 0.0]]))
    assert clip_negative(image) == flag
    assert image.array.sum() == pytest.approx(1.0) and image.array.min() >= 0
    assert image.array[0, 1] == pytest.approx(3 * image.array[0, 0]) and image.array[0, 2] == 0
