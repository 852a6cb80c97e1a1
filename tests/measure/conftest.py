"""Fabricated frames: sources of known flux behind a Gaussian PSF, whose integral over any pixel is closed form."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.special import erf

from csstsim.base.rng import stream
from csstsim.catalog.astrometry.ephemeris import observer
from csstsim.instrument.chip import Window
from csstsim.measure.calibration.bad_pixels import BAD, FULL
from csstsim.measure.calibration.calibrate import Calibrated
from csstsim.measure.catalogue import FrameFacts, measure_frame

SIGMA = 0.95  # px: FWHM 2.2 px = 0.166 arcsec
LIGHT = 0.998  # of the star that the PSF table holds; the rest is far wings
CRAFT = observer(61577.858, (6778.0, 0.0, 0.0), (0.0, 7.0, 3.0))
SKY, READ_NOISE = 34.0, 5.0  # electron, sky with dark of 150 s in i


def integral(edges, sigma=SIGMA):
    return np.diff(0.5 * (1.0 + erf(np.asarray(edges) / (sigma * math.sqrt(2.0)))))


class GaussianPsf:
    """Stands for optics.psf.psf_file.PsfSet: the same Gaussian everywhere, 5 um cells."""

    oversampling, attributes = 2, {}

    def at(self, x, y):
        line = integral((np.arange(257) - 128) * 0.5)
        return np.repeat((LIGHT * np.outer(line, line))[None], 4, axis=0)

    def mixed(self, function):
        return lambda x, y: function(self.at(x, y))


class FlatSky:
    """Stands for optics.geometry.wcs.ChipWCS."""

    def pixel_to_world(self, x, y):
        return 150.0 + np.asarray(x) * 0.074 / 3600.0, np.asarray(y) * 0.074 / 3600.0

    def jacobian(self, ra, dec, seen):
        return np.broadcast_to(np.eye(2) / 0.074, (np.size(ra), 2, 2))


def add_stars(image, x, y, flux, half=12):
    for x0, y0, total in zip(x, y, flux, strict=True):
        i, j = round(x0), round(y0)
        line_x, line_y = (integral(np.arange(-half, half + 2) - 0.5 + n - v) for n, v in ((i, x0), (j, y0)))
        image[j - half : j + half + 1, i - half : i + half + 1] += total * LIGHT * np.outer(line_y, line_x)


def add_noise(image, seed, sky=SKY):
    rng = stream(seed, "noise")
    return (rng.poisson(image + sky) + rng.normal(0.0, READ_NOISE, image.shape)).astype(np.float32)


def measure(
    electrons, *, origin=(0, 0), saturated=None, bad=None, kind="imaging", exposure="SCIE", psf=None, response=None,
    keep=None,
):  # fmt: skip
    ny, nx = electrons.shape
    saturated, bad = (np.zeros(electrons.shape, bool) if mask is None else mask for mask in (saturated, bad))
    return measure_frame(
        Calibrated(electrons.astype(np.float32), FULL * saturated | BAD * bad, {}, {1: READ_NOISE}, None, response),
        psf or GaussianPsf(),
        FlatSky(),
        CRAFT,
        FrameFacts(
            obsid="10100000001",
            chip=SimpleNamespace(id=8, kind=kind),
            filter=SimpleNamespace(name="g", zeropoint=lambda telescope: 26.3),
            telescope=SimpleNamespace(pixel_scale=0.074),
            pointing=SimpleNamespace(type=exposure, exptime=150.0),
            window=Window(origin[0], origin[0] + nx, origin[1], origin[1] + ny),
        ),
        keep,
    )


@pytest.fixture(scope="session")
def fabricate():
    return SimpleNamespace(
        add_stars=add_stars, add_noise=add_noise, measure=measure, psf=GaussianPsf(), SIGMA=SIGMA, LIGHT=LIGHT,
        SKY=SKY, READ_NOISE=READ_NOISE, VARIANCE=SKY + READ_NOISE**2,
    )  # fmt: skip


@pytest.fixture(scope="session")
def star_field(fabricate):
    """(x, y, flux, S/N, table): 3249 stars of S/N 3 to 300 in a noisy frame, and what was measured."""
    n, step = 1200, 21
    rng = stream(20, "stars")
    line = np.arange(15, n - 15, step)
    x, y = (v.ravel() + rng.uniform(-0.5, 0.5, line.size**2) for v in np.meshgrid(line, line))
    flux = 10.0 ** rng.uniform(2.0, 4.5, x.size)
    image = np.zeros((n, n))
    fabricate.add_stars(image, x, y, flux)
    table = fabricate.measure(fabricate.add_noise(image, 21), origin=(300, 500))
    n_eff = 4.0 * math.pi * (fabricate.SIGMA**2 + 1 / 12)  # of a Gaussian, pixel included; not from the code
    snr = flux / np.sqrt(flux + n_eff * fabricate.VARIANCE)
    return x + 300, y + 500, flux, snr, table
