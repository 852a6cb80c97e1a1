"""Profiles at and beyond the limits: index 0.3 to 6.2, half-light radius 1e-4" to 60", axis ratio 1 to 0.02.

Light is compared with a closed form, the share of the profile within the stamp or the window along 20,000 rays
(exposure.inside) times the light of the PSF's box. It ignores the light that the PSF moves across the stamp's edge; the
tolerances below include that.
"""

import numpy as np
import pytest
from exposure import FIDELITIES, WINDOW, X, Y, inside, stamp_bounds
from render.galaxies import scene_of, shaped
from support.canvases import blank, counting

from csstsim.base.counter import object_keys
from csstsim.catalog.flags import NEGATIVE_CLIPPED, OFF_CHIP, TRUNCATED_STAMP
from csstsim.catalog.profiles.sersic import brightness
from csstsim.catalog.table import GALAXY
from csstsim.render.imaging.photons import shoot_scene
from csstsim.render.imaging.stamps import draw_scene

pytestmark = pytest.mark.thorough

INDICES = (0.3, 0.5, 1.0, 2.0, 4.0, 6.2)
SIZES = (1e-4, 1e-2, 0.3, 3.0, 60.0)  # arcsec
RATIOS = (1.0, 0.3, 0.02)
REACH = 140
ELECTRONS = 1e5
STAMP, EDGE = 3e-3, 1e-2  # share of the light: of profiles all but within the stamp; of those cut by it


def made_of(psf, index):
    """Return a Scene of all sizes and axis ratios."""
    size, q = (v.ravel() for v in np.meshgrid(SIZES, RATIOS))
    matrix = np.stack([shaped(ratio, 0.4) for ratio in q])
    return scene_of(psf, np.full(len(q), X), Y, ELECTRONS, index, size, matrix)


def fine_sum(scene, i, bounds):
    """Return the share of galaxy i's profile within bounds by a sum over eighths of pixels: rays miss needles."""
    x0, x1, y0, y1 = bounds
    y, x = np.mgrid[y0:y1:0.125, x0:x1:0.125] - 0.5 + 0.0625
    inverse = np.linalg.inv(scene.matrix[i])
    r = np.hypot(*np.tensordot(inverse, np.stack([x - scene.x[i], y - scene.y[i]]), 1))
    area = 64 * abs(np.linalg.det(scene.matrix[i]))
    parts = zip(scene.component_fractions[i], scene.sersic[i], strict=True)
    return sum(light * brightness(r / size, n).sum() / area / size**2 for light, (n, _, size) in parts if light > 0)


@pytest.mark.parametrize("index", INDICES)
def test_stamps_of_any_profile(psf_r, index):
    scene = made_of(psf_r, index)
    core, bounds = psf_r.at(X, Y).sum() / 4, stamp_bounds(X, Y, REACH, WINDOW)
    for i in range(len(scene)):
        canvas = blank(WINDOW)
        drawn, image = draw_scene(canvas, scene.take([i]).sized(REACH), psf_r), canvas.expected
        share = inside(scene, i, bounds)
        assert np.isfinite(image).all() and image.min() >= 0
        assert image.sum(dtype=float) == pytest.approx(drawn.drawn[0], rel=1e-5)
        assert drawn.flags[0] & ~NEGATIVE_CLIPPED == 0
        got = drawn.drawn[0] / ELECTRONS / core
        assert got == pytest.approx(share, abs=STAMP if share > 0.99 else EDGE)


@pytest.mark.parametrize("index", INDICES)
def test_photons_of_any_profile(psf_r, psf_tables, index):
    """Within 5 sigma of the electrons, and the closed form's edge."""
    scene = made_of(psf_r, index)
    core, bounds = psf_r.at(X, Y).sum() / 4, (WINDOW.x0, WINDOW.x1, WINDOW.y0, WINDOW.y1)
    for i in range(len(scene)):
        canvas, keys = counting(WINDOW), object_keys(np.uint64(3), np.array([i]))
        drawn, _, box = shoot_scene(canvas, scene.take([i]), keys, psf_tables)
        counted = canvas.counted
        wanted = ELECTRONS * core * inside(scene, i, bounds)
        assert counted.min() >= 0 and counted.sum() == drawn[0]
        assert drawn[0] == pytest.approx(wanted, abs=5 * np.sqrt(wanted) + 1e-3 * ELECTRONS)
        assert box[0, 0] >= WINDOW.x0 and box[0, 1] <= WINDOW.x1 and box[0, 2] >= WINDOW.y0 and box[0, 3] <= WINDOW.y1


@pytest.mark.parametrize("fidelity", FIDELITIES)
@pytest.mark.parametrize("share", [0.0, 1.0])
def test_sizes_and_shapes_of_a_catalogue(expose, psf_r, fidelity, share):
    """As catalog.selection.select has them: stamps as large as it asks for, and a flag where that is not enough."""
    sizes = np.array([1e-6, 1e-4, 0.3, 3.0, 60.0, 3600.0])
    for e in (0.0, 0.96, 0.9999):
        n = len(sizes)
        got = expose(
            np.full(n, X), Y, fidelity, obj_type=np.full(n, GALAXY, np.int8), size_disk=sizes, size_bulge=sizes,
            bulge_frac=np.full(n, share), e1=np.full(n, -e / np.sqrt(2)), e2=np.full(n, e / np.sqrt(2)),
        )  # fmt: skip
        table = got.table
        assert (table["flags"] & ~(NEGATIVE_CLIPPED | TRUNCATED_STAMP | OFF_CHIP) == 0).all()
        assert (table["method"][sizes >= 3] != "unresolved").all()  # would be drawn together by its mesh
        assert (table["flags"][sizes >= 60] & TRUNCATED_STAMP > 0).all()
        for i in range(n):
            stamp = table["method"][i] == "stamp"
            bounds = stamp_bounds(X, Y, table["reach"][i] if stamp else 10**6, WINDOW)
            share = fine_sum(got.scene, i, bounds) if e > 0.99 and sizes[i] >= 3 else inside(got.scene, i, bounds)
            wanted = 1e4 * share * psf_r.at(X, Y).sum() / 4
            off = 6e-3 * wanted + 1e-6 if stamp else 5 * np.sqrt(wanted) + 3
            assert table["drawn"][i] == pytest.approx(wanted, abs=off)
