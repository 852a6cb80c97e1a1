"""PSF photometry against photutils: the same stars and PSF, another fit (flux and position together)."""

import numpy as np
import pytest

from csstsim.base.rng import stream

pytest.importorskip("photutils", reason="photutils, of the extra `bench`, is the peer of PSF photometry")

FLUX, PLACE = 1e-3, 0.01  # relative; px
SIGMAS = 3.0


def test_photutils_finds_the_same_fluxes_and_positions(fabricate):
    from astropy.table import Table
    from photutils.psf import ImagePSF, PSFPhotometry

    rng, line = stream(70, "stars"), np.arange(30, 400, 40)
    x, y = (v.ravel() + rng.uniform(-0.5, 0.5, line.size**2) for v in np.meshgrid(line, line))
    flux = 10.0 ** rng.uniform(3.5, 5.3, x.size)
    image = np.zeros((420, 420))
    fabricate.add_stars(image, x, y, flux)
    noisy = fabricate.add_noise(image, 71)
    ours = fabricate.measure(noisy.copy())
    row = np.hypot(ours["x"] - x[:, None], ours["y"] - y[:, None]).argmin(axis=1)
    # What a pixel gets of a star, on half pixels: the cells of the set, summed over 2 x 2 of them
    cells = fabricate.psf.at(0, 0).mean(axis=0)
    pixels = sum(np.roll(cells, (-i, -j), (0, 1)) for i in (0, 1) for j in (0, 1))[:-1, :-1]
    sky = np.median(noisy)
    fit = PSFPhotometry(ImagePSF(pixels[87:-87, 87:-87], oversampling=2), (13, 13), aperture_radius=4)
    start = Table({"x_init": np.rint(x), "y_init": np.rint(y)})
    theirs = fit(noisy - sky, error=np.full(noisy.shape, np.sqrt(fabricate.VARIANCE)), init_params=start)
    by = np.array(theirs["flux_fit"])
    difference = np.abs(ours["flux_psf"][row] - by)
    assert (difference < FLUX * by + SIGMAS * ours["flux_psf_err"][row]).all()
    assert np.median(difference / by) < FLUX + 0.2 * np.median(ours["flux_psf_err"][row] / by)
    for axis in "xy":
        apart = np.abs(ours[axis][row] - np.array(theirs[f"{axis}_fit"]))
        assert (apart < PLACE + SIGMAS * ours["pos_err"][row] / 0.074).all()
        assert np.median(apart) < PLACE
