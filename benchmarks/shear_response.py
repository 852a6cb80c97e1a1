"""The shear test: do the renderers respond to a known shear as the reference does?

Each galaxy is drawn eight times: as it is and turned by 90 degrees (a ring of two, whose intrinsic shapes cancel),
each under a shear of +-0.02 in either component. Shapes are HSM's re-Gaussianised ones (Hirata & Seljak 2003, MNRAS
343, 459; Mandelbaum et al. 2005, MNRAS 361, 1287), made by GalSim from the image and the PSF at the galaxy's position,
and rotated from pixels to the sky. They respond as <e> = (1 + m) g + c. m of a component is the mean response to its
shear over that of the true shapes, minus 1; c is the mean shape of all eight. HSM has an m and c of its own, so the
test is how a renderer's differ from the reference's on the same galaxies: HSM's errors and shape noise cancel there.

Pixels of 0.074" sample the r-band PSF too coarsely for adaptive moments of a star: HSM fails on it. So image and PSF
are first smoothed by the same Gaussian of one pixel, which re-Gaussianisation corrects with the PSF.
"""

from dataclasses import dataclass

import galsim
import numpy as np
from scipy.ndimage import gaussian_filter

from csstsim.base.counter import object_keys
from csstsim.base.rng import stream
from csstsim.catalog.table import GALAXY, ObjectTable
from csstsim.instrument.chip import Window
from csstsim.optics.psf.psf_file import pixel_response
from csstsim.render.canvas import Canvas
from csstsim.render.drawing import Drawing
from csstsim.render.imaging.photons import shoot_scene
from csstsim.render.imaging.reference import draw_objects
from csstsim.render.imaging.stamps import draw_scene
from csstsim.render.scene import make_scene

SHEAR = 0.02
SHEARS = np.array([SHEAR, -SHEAR, 1j * SHEAR, -1j * SHEAR])
TWINS = np.array([1, -1])
VERSIONS = len(SHEARS) * len(TWINS)
SIZE = 0.2, 0.6  # arcsec, half-light radius of disks
BULGE_SIZE = 0.3, 0.7  # over that of the disk
SPREAD, ELLIPTICITY = 0.25, 0.6  # scatter of each component of (a - b) / (a + b); its largest modulus
SHARES = (0.16, 0.3, 0.34, 0.2)  # of the four sub-bands
LOST = 1e-3  # share of a component's light that GalSim may fold; 1e-6 of it falls where shapes are measured
HALF = 64  # px, half the side of a stamp: four half-light radii of the longest
EDGE = 100  # px, least distance from the chip's edge
SMOOTH = 1.0  # px, sigma of the Gaussian that smooths image and PSF
PSF_GUESS = 1.5  # px, sigma of the PSF where HSM starts
HSM = galsim.hsm.HSMParams(convergence_threshold=1e-9)


def make_galaxies(setting, count, electrons, *words, seed=1):
    """Return the ObjectTable of `count` galaxies in their VERSIONS, (count * 8) rows: twins, then shears, run fastest.

    electrons: of each row. words: they and the seed name the sample. Positions are random, also within a pixel.
    """
    rng, detector = stream(seed, "bench", "shear", *words), setting.wcs.chip.detector
    x, y = (rng.uniform(EDGE, side - EDGE, count) for side in (detector.nx, detector.ny))
    disk = np.exp(rng.uniform(*np.log(SIZE), count))
    bulge = disk * rng.uniform(*BULGE_SIZE, count)
    share = np.where(rng.random(count) < 1 / 3, 0.0, rng.random(count) ** 2)
    most = -np.expm1(-0.5 * (ELLIPTICITY / SPREAD) ** 2)
    e = SPREAD * np.sqrt(-2 * np.log1p(-most * rng.random(count))) * np.exp(2j * np.pi * rng.random(count))
    ra, dec = setting.wcs.pixel_to_world(x, y)
    same = {
        "ra": ra, "dec": dec, "ra_orig": ra, "dec_orig": dec, "x": x, "y": y, "size_disk": disk, "size_bulge": bulge,
        "bulge_frac": share,
    }  # fmt: skip
    columns = {name: np.repeat(values, VERSIONS) for name, values in same.items()}
    shapes = (e[:, None, None] * TWINS[:, None] + 0 * SHEARS).ravel()
    shears = np.tile(SHEARS, count * len(TWINS))
    rate = {f"flux{i}": np.full(len(shapes), electrons * part / setting.exptime) for i, part in enumerate(SHARES)}
    whole = ObjectTable.complete(
        columns | rate | {
            "id": np.arange(len(shapes)), "obj_type": np.full(len(shapes), GALAXY), "e1": shapes.real,
            "e2": shapes.imag, "gamma1": shears.real, "gamma2": shears.imag,
        },
        (),
    )  # fmt: skip
    return whole.with_columns(
        reach=np.full(len(shapes), HALF, np.int32), lost=np.full(len(shapes), LOST), wing=np.zeros(len(shapes))
    )


def true_shapes(table):
    """Return e1 + i e2 of the sheared galaxies, |e| = (a - b) / (a + b), on the sky (Seitz & Schneider 1997)."""
    e = table["e1"].astype(float) + 1j * table["e2"]
    g = (table["gamma1"].astype(float) + 1j * table["gamma2"]) / (1 - table["kappa"])
    return (e + g) / (1 + np.conj(g) * e)


def reference(setting, row, window):
    """Draw a row by the reference renderer."""
    canvas = Canvas(np.zeros(window.shape, np.float32), window)
    draw_objects(canvas, row, Drawing(setting.wcs, setting.psf, setting.exptime))
    return canvas.expected


def stamps(setting, row, window):
    """Draw a row as expected light."""
    canvas = Canvas(np.zeros(window.shape), window)
    draw_scene(canvas, make_scene(row, setting.wcs, setting.psf, setting.exptime), setting.mixer)
    return canvas.expected


def photons(seed, *words):
    """Return a function that draws a row electron by electron, with the random numbers of the seed and the words."""
    base = stream(seed, "bench", "shear photons", *words).integers(2**64, dtype=np.uint64)

    def draw(setting, row, window):
        canvas, scene = Canvas(None, window), make_scene(row, setting.wcs, setting.psf, setting.exptime)
        counted = canvas.count()
        shoot_scene(canvas, scene, object_keys(base, scene.ids), setting.table)
        return counted

    return draw


def measure(setting, table, draw):
    """Return e1 + i e2 (n,) on the sky, as true_shapes, by HSM on images of `draw`; NaN if HSM fails."""
    found = np.full(len(table), np.nan, complex)
    x, y = table["x"], table["y"]
    psf = None
    for i in range(len(table)):
        if psf is None or x[i] != x[i - 1] or y[i] != y[i - 1]:
            psf = _psf(setting.psf, x[i], y[i])
        column, row = round(x[i]), round(y[i])
        window = Window(column - HALF, column + HALF + 1, row - HALF, row + HALF + 1)
        image = _smooth(draw(setting, table.take([i]), window))
        shape = galsim.hsm.EstimateShear(
            image, psf, shear_est="REGAUSS", guess_sig_PSF=PSF_GUESS, hsmparams=HSM, strict=False
        )
        distortion = shape.corrected_e1 + 1j * shape.corrected_e2
        if not shape.error_message and abs(distortion) < 1:
            found[i] = distortion / (1 + np.sqrt(1 - abs(distortion) ** 2))
    jacobian = setting.wcs.jacobian(table["ra_orig"], table["dec_orig"])
    turn = np.arctan2(jacobian[:, 1, 0] - jacobian[:, 0, 1], jacobian[:, 0, 0] + jacobian[:, 1, 1])
    return found * np.exp(-2j * turn)


def _psf(psf, x, y):
    """Return the smoothed PSF at a position, integrated over pixels, as an image with a pixel centred on the star."""
    step = psf.oversampling
    response = pixel_response(np.tensordot(SHARES, psf.at(x, y), axes=1), step)
    first = response.shape[0] // 2 % step
    return _smooth(response[first::step, first::step])


def _smooth(image):
    return galsim.ImageD(gaussian_filter(image.astype(float), SMOOTH, mode="constant"))


@dataclass(frozen=True, eq=False)
class Bias:
    """m and c of both components, (2,), and their standard errors, from the scatter over galaxies."""

    m: np.ndarray
    m_error: np.ndarray
    c: np.ndarray
    c_error: np.ndarray


def bias(shapes, true, subtract=None):
    """Return the Bias of measured shapes (n,) of complete rings, or how it differs from that of `subtract` (n,).

    Galaxies with a version that is not finite are left out; raises ValueError if fewer than two remain.
    """
    true = true.reshape(-1, len(TWINS), len(SHEARS))
    shapes = (shapes - (0 if subtract is None else subtract)).reshape(true.shape)
    used = np.isfinite(shapes).all(axis=(1, 2))
    if used.sum() < 2:
        raise ValueError("fewer than two galaxies have a shape in each version")
    response, wanted = _response(shapes[used]), _response(true[used]).mean(axis=0)
    offset = shapes[used].mean(axis=(1, 2))
    offset = np.stack([offset.real, offset.imag], axis=1)
    root = np.sqrt(used.sum())
    return Bias(
        response.mean(axis=0) / wanted - (subtract is None), response.std(axis=0, ddof=1) / root / wanted,
        offset.mean(axis=0), offset.std(axis=0, ddof=1) / root,
    )  # fmt: skip


def _response(shapes):
    """Return de / dg (galaxies, 2) of shapes (galaxies, twins, shears), mean of the twins."""
    mean = shapes.mean(axis=1)
    return np.stack([(mean[:, 0] - mean[:, 1]).real, (mean[:, 2] - mean[:, 3]).imag], axis=1) / (2 * SHEAR)
