"""Galaxies longer than any transform and thinner than a pixel: light along the long axis, and photons of the same."""

from itertools import pairwise

import numpy as np
import pytest
from render.galaxies import SCALE, scene_of, shaped
from scipy.integrate import quad
from support.canvases import blank, counting

from csstsim.base.counter import object_keys
from csstsim.catalog.profiles.sersic import brightness
from csstsim.instrument.chip import Window
from csstsim.render.extended import parts_of
from csstsim.render.imaging.photons import shoot_scene
from csstsim.render.imaging.stamps import draw_scene

X, Y, HALF, LONG = 4200, 5150, 600, 300.0  # px; LONG: half-light radius along the long axis
WINDOW = Window(X - HALF, X + HALF + 1, Y - HALF, Y + HALF + 1)
ELECTRONS = 2e7
CENTRE = X + 0.2, Y - 0.3
STRIPS = (0, 60, 150, 300, 450)  # px along the long axis
SIDE = 60.0  # px: the PSF's box ends before


def thin(psf, index, q, angle):
    size = LONG * SCALE * np.sqrt(q)
    return scene_of(psf, *CENTRE, ELECTRONS, index, size, shaped(q, angle)).sized(HALF)


def distances(angle):
    """Return the distances of the window's pixels along and across a long axis at `angle` [px]."""
    axis = np.arange(-HALF, HALF + 1)
    dx, dy = axis - CENTRE[0] + X, axis[:, None] - CENTRE[1] + Y
    return np.cos(angle) * dx + np.sin(angle) * dy, np.cos(angle) * dy - np.sin(angle) * dx


def strip(index, near, far):
    """Return the light of a round profile of light 1 at |x| from `near` to `far` [r_e]: the integral over arcs."""

    def ring(r):
        return 4 * r * brightness(r, index) * (np.arcsin(min(far / r, 1.0)) - np.arcsin(min(near / r, 1.0)))

    edges = [near, far, *np.geomspace(far, 300.0, 12)[1:]]
    return sum(quad(ring, a, b, limit=200, epsabs=1e-9)[0] for a, b in pairwise(edges))


@pytest.mark.parametrize("index", [0.5, 1.0, 4.0])
@pytest.mark.parametrize("q, angle", [(1e-2, 0.0), (1e-3, 0.3), (1e-4, np.pi / 4), (1e-3, 2.5), (1e-7, np.pi / 2)])
def test_light_along_a_thin_galaxy(psf_r, mixer, index, q, angle):
    """The integral of the profile across; 0.7%, which pixels on the edges of strips may change."""
    canvas = blank(WINDOW)
    draw_scene(canvas, thin(psf_r, index, q, angle), mixer)
    image, (along, side) = canvas.expected / (ELECTRONS * psf_r.at(X, Y).sum() / 4), distances(angle)
    for near, far in pairwise(STRIPS):
        here = (abs(along) >= near) & (abs(along) < far) & (abs(side) < SIDE)
        wanted = strip(index, max(near, 1e-9) / LONG, far / LONG)
        assert image[here].sum(dtype=float) == pytest.approx(wanted, rel=7e-3), (near, far)


@pytest.mark.thorough
@pytest.mark.parametrize("index", [0.5, 1.0, 4.0])
@pytest.mark.parametrize("q, angle", [(2e-2, 0.3), (3e-3, 1.0), (1e-3, 2.5)])
def test_pixels_of_a_thin_galaxy_are_those_of_photons(psf_r, psf_tables, mixer, index, q, angle):
    """Bins of 30 px along and 1 px across: the mean of the squared difference over its variance is 1, 5 sigma."""
    scene, canvas, counted = thin(psf_r, index, q, angle), blank(WINDOW), counting(WINDOW)
    draw_scene(canvas, scene, mixer)
    shoot_scene(counted, scene, object_keys(np.uint64(1), scene.ids), psf_tables)
    along, side = distances(angle)
    bins = np.stack([np.floor(along / 30).ravel(), np.round(side).ravel()])
    bins = bins[:, (abs(side) < 8).ravel()].astype(int)
    _, which = np.unique(bins, axis=1, return_inverse=True)
    sums = [np.bincount(which.ravel(), plane[abs(side) < 8]) for plane in (canvas.expected, counted.counted)]
    bright = sums[0] > 50  # some 800 bins
    chi2 = (sums[1] - sums[0])[bright] ** 2 / sums[0][bright]
    assert abs(chi2.mean() - 1) < 5 * np.sqrt(2 / bright.sum())


def test_a_wing_keeps_the_long_axis_of_a_thin_galaxy():
    """Sizes are those of circles of the same area; also below the thinnest axis ratio of the tables."""
    for q in (0.5, 2.0**-6, 1e-3, 1e-9):
        [part] = parts_of(np.array([1.0, 0.0]), np.array([[1.0, 0, 1.0], [0, 0, 0]]), 40 * shaped(q, 0.3) * SCALE)
        assert part.size / np.sqrt(part.ratio) == pytest.approx(40 / np.sqrt(q), rel=0.15)
