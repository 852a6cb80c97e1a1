"""Galaxies rendered by GalSim behind the fabricated frames' Gaussian PSF, and sources for measure.light.total_light."""

from types import SimpleNamespace

import numpy as np
import pytest

from csstsim.measure.detection.maps import BIN

galsim = pytest.importorskip("galsim")

PIXEL = 0.074  # arcsec
SIDE = 161
MIDDLE = (SIDE - 1) / 2
RMS = 7.7  # electron, of a full-depth r chip


def rendered(fabricate, index, size, ratio=0.8, *, dx=0.2, dy=-0.3, angle=25.0, bulge=0.0):
    """Return the image of a galaxy of flux 1; size: half-light radius, px, 0: a point; bulge: its fraction, n = 4."""
    galsim.errors.raise_fft_size_error = True
    psf = galsim.Gaussian(sigma=fabricate.SIGMA, flux=fabricate.LIGHT)
    shape = psf
    if size:
        galaxy = galsim.Sersic(index, half_light_radius=size)
        if bulge:
            galaxy = (1.0 - bulge) * galaxy + bulge * galsim.Sersic(4.0, half_light_radius=0.6 * size)
        params = galsim.GSParams(maximum_fft_size=16384, folding_threshold=2e-3)
        shape = galsim.Convolve(galaxy.shear(q=ratio, beta=angle * galsim.degrees), psf, gsparams=params)
    return shape.drawImage(nx=SIDE, ny=SIDE, scale=1.0, offset=(dx, dy)).array.astype(float)


def sources_of_rows(image, rows, rms, origin=(0, 0)):
    """Return the arguments of `total_light` but the last.

    rows: x, y, axis ratio, counted, half-light radius of the sources of an image, from `origin` on.
    """
    x, y, ratio, counted, half_light = np.transpose(rows).astype(float)
    found = SimpleNamespace(
        image=image.astype(np.float32), rms=rms.astype(np.float32),
        segments=np.zeros([-(-n // BIN) for n in image.shape], np.int32), segment=np.zeros(len(x), np.int64),
        x=x, y=y, half_light=half_light,
    )  # fmt: skip
    table = {"x": x + origin[0], "y": y + origin[1], "g_err": np.zeros(len(x)), "flux_psf_err": np.full(len(x), 30.0)}
    table |= {"flux_psf": np.full(len(x), np.nan), "e": (1 - ratio**2) / (1 + ratio**2) + 0j}
    return found, table, np.zeros(image.shape, np.uint8), counted
