"""The halo and the wing: the published anchors, quadrature, totals, direct optics in a larger box."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import dblquad, quad

from csstsim.base.errors import InputError
from csstsim.optics.psf.diffraction import Diffraction, blur
from csstsim.optics.psf.psf_file import pixel_response
from csstsim.optics.psf.wavefront import load_wavefront
from csstsim.optics.scatter.halo import make_wing
from csstsim.optics.scatter.scattered_light import Scattered, read_scattered, scattered_light

WAVES = np.array([5500.0, 6000.0, 6328.0, 6900.0])
DARK = {"terms": [], "reference": 6328.0}


@pytest.fixture(scope="module")
def wing(camera):
    return make_wing(camera.scatter, WAVES, camera.telescope)


@pytest.fixture(scope="module")
def optics_image(camera):
    """The diffraction image at 632.8 nm in a box of 512 cells, on the boresight."""
    wavefront = load_wavefront(camera.psf)
    optics = Diffraction(6328.0, camera.telescope.diameter_m, 0.037, wavefront, 512)
    image = optics.image(optics.transfer(wavefront.coefficients(0, 0)), blur(camera.psf, 0.037, 5.0))
    return np.stack([image] * 4)


def test_halo_is_1e_4_of_the_peak_at_10_px_and_1e_6_at_100(wing, optics_image):
    """The paper's two figures, to 5%, relative to the peak of the pixel-integrated image of everything."""
    peak = pixel_response(wing.add_to(optics_image, 2), 2)[2].max()
    assert wing.halo(10.0)[2] == pytest.approx(1e-4 * peak, rel=0.05)
    assert wing.halo(100.0)[2] == pytest.approx(1e-6 * peak, rel=0.05)
    assert wing.scattered == pytest.approx(0.075, abs=0.002)
    assert 0.04 < quad(lambda r: 2 * np.pi * r * wing.halo(r)[2], 0.75 / 0.074, np.inf)[0] < 0.06


def test_closed_forms_of_the_light_beyond(wing):
    for radius in (1.0, 30.0, 400.0):
        for band in range(4):
            got = quad(lambda r: 2 * np.pi * r * wing.profile(r)[band], radius, np.inf, limit=200)[0]  # noqa: B023
            assert wing.light_beyond(radius)[band] == pytest.approx(got, rel=1e-6)
    assert quad(lambda r: 2 * np.pi * r * wing.halo(r)[0], 0, np.inf)[0] == pytest.approx(wing.scattered[0], rel=1e-6)


def test_cells_are_the_integral_over_each_cell(wing):
    cells = wing.cells(40, 2)
    for row, column in ((20, 20), (20, 21), (14, 31), (0, 39)):
        x, y = (column - 20) / 2, (row - 20) / 2
        got = dblquad(lambda v, u: wing.halo(np.hypot(u, v))[1], x, x + 0.5, y, y + 0.5)[0]
        assert cells[1, row, column] == pytest.approx(got, rel=2e-5)
    assert cells == pytest.approx(cells[:, ::-1, ::-1]) and cells == pytest.approx(cells.transpose(0, 2, 1))


def test_halo_takes_its_light_from_the_optics(wing, optics_image):
    """Everything in the box and what the closed form has outside it sum to 1, to 1e-4 of the light."""
    both = wing.add_to(optics_image, 2)
    half = 128.0

    def outside(angle):  # beyond the square's side at this angle
        return wing.light_beyond(half / np.cos(angle))

    angles = (np.arange(200) + 0.5) / 200 * np.pi / 4
    left = np.mean([outside(a) for a in angles], axis=0)[2]
    assert both[2].sum() + left == pytest.approx(1.0, abs=1e-4)


def test_direct_optics_follows_the_mean_wing(camera, optics_image):
    """Ring means from 45 px, beyond all figure errors, to the edge: L / (pi^3 r^3) within 1%."""
    model = make_wing(DARK, np.full(4, 6328.0), camera.telescope)
    image = pixel_response(optics_image[2], 2)
    axis = (np.arange(511) - 255) / 2
    r = np.hypot(axis, axis[:, None])
    for radius in (45, 60, 80, 110):
        ring = np.abs(r / radius - 1) < 0.05
        assert image[ring].mean() == pytest.approx(model.profile(r[ring])[0].mean(), rel=0.01)


def test_radius_is_the_inverse_of_the_profile(wing):
    radii = np.array([20.0, 64.0, 900.0, 2e4])
    assert wing.radius(wing.profile(radii).mean(axis=0)) == pytest.approx(radii, rel=1e-3)
    assert wing.radius(np.array([np.inf, 0.0])) == pytest.approx([1.0, 1e5])


def test_wavelength_power(camera):
    """Smooth surfaces scatter as wavelength^-2; diffraction widens with the wavelength."""
    wing = make_wing({"terms": [[0.04, 0.5, 2.5, 2.0]], "reference": 6000.0}, WAVES, camera.telescope)
    assert wing.scattered == pytest.approx(0.04 * (WAVES / 6000.0) ** -2)
    assert wing.airy == pytest.approx(np.degrees(WAVES * 1e-10 / 2.0) * 3600 / 0.074)


def test_no_scatter_is_no_halo(camera, optics_image):
    wing = make_wing({}, WAVES, camera.telescope)
    assert (wing.scattered == 0).all() and (wing.halo(5.0) == 0).all() and not wing.cells(8, 2).any()
    assert np.array_equal(wing.add_to(optics_image, 2), optics_image)


@pytest.mark.parametrize("row", [[0.1, 0.5, 2.0, 0], [0.1, 0, 3, 0], [-0.1, 1, 3, 0], [1.2, 1, 3, 0], [0.1, 1, 3], "x"])
def test_impossible_terms_are_refused(camera, row):
    with pytest.raises(InputError, match=r"scatter\.yaml"):
        make_wing({"terms": [row], "reference": 6328.0}, WAVES, camera.telescope)


def test_psf_file_brings_its_wing_and_ghosts(camera, psf_r):
    """Attributes and back, exactly; a file without them has none, a damaged one is refused."""
    made, read = scattered_light(camera, camera.filters["r"]), read_scattered(psf_r)
    assert np.array_equal(made.wing.profile(77.0), read.wing.profile(77.0))
    assert made.ghosts.as_dict() == read.ghosts.as_dict()
    # The stored images hold their part of the halo: what is missing is what the wing has beyond the box, here a circle
    # of the box's area, which has 2% less beyond it
    side = psf_r.image.shape[-1] / psf_r.oversampling
    assert 1 - psf_r.flux.mean() == pytest.approx(read.wing.light_beyond(side / np.sqrt(np.pi)).mean(), rel=0.03)

    class Foreign:
        path, attributes = "foreign.h5", {}

    assert vars(read_scattered(Foreign())) == vars(Scattered())
    Foreign.attributes = {"wing": '{"share": 3}'}
    with pytest.raises(InputError, match="damaged"):
        read_scattered(Foreign())


def test_the_wing_of_another_telescope_is_that_of_its_diameter_and_scale(camera, wing):
    """Radii in arcsec are the same for any scale; lambda / D on a 4 m telescope is half as large."""
    coarse = make_wing(camera.scatter, WAVES, replace(camera.telescope, pixel_scale=0.148))
    assert coarse.knee == pytest.approx(wing.knee / 2) and coarse.airy == pytest.approx(wing.airy / 2)
    assert coarse.light_beyond(50.0) == pytest.approx(wing.light_beyond(100.0), rel=1e-12)
    large = make_wing(camera.scatter, WAVES, replace(camera.telescope, diameter_m=4.0))
    assert large.airy == pytest.approx(wing.airy / 2) and large.knee == pytest.approx(wing.knee)
    assert large.airy == pytest.approx(np.degrees(WAVES * 1e-10 / 4.0) * 3600 / 0.074)
