"""Images and knots at their limits: larger than the window, a pixel wide, a million pixels; 500 knots, any profile."""

import numpy as np
import pytest
from astropy.io import fits
from exposure import FIDELITIES, X, Y

from csstsim.catalog.flags import NEGATIVE_CLIPPED, NOT_RENDERED
from csstsim.catalog.row_files import with_images
from csstsim.catalog.table import GALAXY

pytestmark = pytest.mark.thorough

ELECTRONS = 1e5
HARMLESS = NEGATIVE_CLIPPED
LIGHT = 3e-3  # of the electrons: what a stamp may leave out


def pictured(folder, pixels, scale, **more):
    """Return the columns of a galaxy that has an image of `pixels`."""
    fits.writeto(folder / "image.fits", pixels, overwrite=True)
    columns = {"image_file": np.array([str(folder / "image.fits")]), "image_scale": np.array([scale])}
    made = with_images(columns, np.array([GALAXY]), "columns")
    return made | {"obj_type": np.array([GALAXY], np.int8)} | {name: np.array([v]) for name, v in more.items()}


def whole(got, core, electrons=ELECTRONS):
    """Hold that an exposure has all light of its one object."""
    table = got.table
    assert table["flags"][0] & ~HARMLESS == 0
    counted = table["method"][0] == "photons"
    wanted = electrons * core
    assert table["drawn"][0] == pytest.approx(wanted, abs=LIGHT * wanted + 5 * counted * np.sqrt(wanted))


@pytest.mark.parametrize("fidelity", FIDELITIES)
@pytest.mark.parametrize("shape", [(1, 1), (1, 40), (40, 1), (2, 2), (3, 500)])
def test_images_of_any_form(expose, psf_r, tmp_path, fidelity, shape):
    columns = pictured(tmp_path, np.ones(shape), 0.03, e1=0.5, kappa=0.1)
    mu = 1 / 0.9**2
    whole(expose(X, Y, fidelity, electrons=ELECTRONS / mu, **columns), psf_r.at(X, Y).sum() / 4)


@pytest.mark.parametrize("fidelity", FIDELITIES)
def test_a_million_pixels(expose, psf_r, tmp_path, fidelity):
    axis = np.linspace(-4, 4, 1000)
    pixels = np.exp(-0.5 * (axis**2 + axis[:, None] ** 2))
    whole(expose(X, Y, fidelity, electrons=ELECTRONS, **pictured(tmp_path, pixels, 0.002)), psf_r.at(X, Y).sum() / 4)


def test_an_image_larger_than_the_window_is_drawn_in_tiles(expose, psf_r, tmp_path):
    """Even light over 90": the window has its share, the same by photons and by stamps, without a seam."""
    columns = pictured(tmp_path, np.ones((300, 300)), 0.3)
    electrons = 4e7
    stamps = expose(X, Y, "noise_free", electrons=electrons, **columns)
    level = electrons * (0.074 / 90.0) ** 2 * psf_r.at(X, Y).sum() / 4
    inside = stamps.image[40:-40, 40:-40].astype(float)
    assert inside == pytest.approx(np.full(inside.shape, level), rel=0.01)
    assert inside.mean() == pytest.approx(level, rel=LIGHT)
    photons = expose(X, Y, "standard", electrons=electrons / 100, **columns)
    assert photons.light.mean() == pytest.approx(
        stamps.image.mean() / 100, rel=5 / np.sqrt(photons.light.sum()) + LIGHT
    )
    assert not stamps.table["flags"][0] & NOT_RENDERED


def test_one_bright_pixel_does_not_ring(expose, tmp_path):
    """No light comes back up around it: rows and columns through it fall to both sides."""
    pixels = np.zeros((31, 31))
    pixels[15, 15] = 1.0
    image = expose(X, Y, "noise_free", electrons=1e6, **pictured(tmp_path, pixels, 0.5)).image
    y, x = np.unravel_index(image.argmax(), image.shape)
    for line in (image[y, x - 20 : x + 21], image[y - 20 : y + 21, x]):
        smooth = np.convolve(line, np.ones(3) / 3, "valid")
        assert (np.diff(smooth[:19]) > -1e-3 * line.max()).all() and (np.diff(smooth[20:]) < 1e-3 * line.max()).all()


@pytest.mark.parametrize("fidelity", FIDELITIES)
@pytest.mark.parametrize("knots", [1, 500])
@pytest.mark.parametrize("n, e", [(0.3, 0.0), (0.3, 0.9), (6.2, 0.9)])
def test_knots_of_any_profile(expose, psf_r, fidelity, knots, n, e):
    columns = {
        "obj_type": np.array([GALAXY], np.int8), "size_disk": [0.1], "n_disk": [n], "e1": [-e], "knots": [knots],
        "knots_frac": [1.0],
    }  # fmt: skip
    got = expose(X, Y, fidelity, electrons=ELECTRONS, **columns)
    assert got.table["flags"][0] & ~HARMLESS == 0
    counted = got.table["method"][0] == "photons"
    wanted = ELECTRONS * psf_r.at(X, Y).sum() / 4
    off = 0.05 if n > 1 and e > 0 else LIGHT  # of n = 6.2 some lie beyond the window
    assert got.table["drawn"][0] == pytest.approx(wanted, abs=off * wanted + 5 * counted * np.sqrt(wanted))


@pytest.mark.parametrize("values", [{"knots": -5}, {"knots_frac": np.nan}, {"knots_frac": -0.1}, {"knots": 10**6}])
def test_knots_that_make_no_sense_are_flagged(expose, values):
    columns = {"size_disk": 0.3, "knots": 5, "knots_frac": 0.5} | values
    table = expose(X, Y, obj_type=[GALAXY], **{name: [value] for name, value in columns.items()}).table
    bad = values != {"knots": -5}
    assert (
        bool(table["flags"][0] & NOT_RENDERED) and table["drawn"][0] == 0 if bad else table["flags"][0] & NOT_RENDERED
    )
