"""Objects behind a grating with PSFs of known width, for tests of dispersed light."""

import numpy as np
from scipy.special import ndtr

from csstsim.catalog.profiles.sersic import sersic_b
from csstsim.optics.gratings.dispersion import Disperser
from csstsim.optics.psf.psf_file import PsfSet, write_psf
from csstsim.render.scene import Scene

GV, SPLIT = 29, 5530.5  # a chip, and the x of the line between its two gratings
SIGMA_PX = 0.8, 1.0, 1.2, 1.5  # of the PSF at its four wavelengths
CELLS, PER_PX = 128, 4  # a box of 32 px
PIXEL = 0.074  # arcsec


def disperser_of(camera, chip):
    filter = camera.filters[camera.chips[chip].filter]
    return Disperser(camera.gratings[chip], filter, camera.telescope)


def gaussian_psf(path, sigma=SIGMA_PX, about=(), light=1.0):
    """Write and return a PsfSet of round Gaussians of so much light, the same at all four nodes."""
    edges = (np.arange(CELLS + 1) - CELLS / 2) / PER_PX
    image = light * np.stack([np.outer(line, line) for line in (np.diff(ndtr(edges / s)) for s in sigma)])
    header = {
        "cell_um": 10 / PER_PX, "cell_arcsec": PIXEL / PER_PX, "oversampling": PER_PX, "chip": 29, "filter": "GU",
        "grid": 2, "camera_digest": "none",
    }  # fmt: skip
    nodes = np.array([[-0.5, -0.5], [9215.5, -0.5], [-0.5, 9231.5], [9215.5, 9231.5]])
    wavelengths = np.linspace(1000.0, 4000.0, 4)  # not used: the disperser's are the filter's
    write_psf(path, nodes, wavelengths, [(image, (0, 0))] * 4, cells=CELLS, about=header | dict(about), provenance={})
    return PsfSet(path)


def scene_of(psf, x, y, index=(0.0, 0.0), size=(0.3, 0.3), bulge=0.0, matrix=None, electrons=1.0):
    """Return a Scene of points, or galaxies of two Sersic components (index, size in arcsec), at x, y."""
    x, y = np.atleast_1d(np.asarray(x, float)), np.atleast_1d(np.asarray(y, float))
    sersic = np.zeros((len(x), 2, 3))
    for c in range(2):
        if index[c]:
            sersic[:, c] = index[c], sersic_b(index[c]), size[c]
    matrix = np.eye(2) / PIXEL if matrix is None else np.asarray(matrix) / PIXEL
    node, weight, outside = psf.weights(x, y)
    return Scene(
        np.arange(len(x)), x, y, np.full((len(x), 4), electrons / 4), np.tile([1.0 - bulge, bulge], (len(x), 1)),
        sersic, np.tile(matrix, (len(x), 1, 1)), node.astype(np.int64), weight, outside,
    )  # fmt: skip


def spectrum_of(disperser, electrons, first=None, last=None, order=1, piece=0):
    """Return (bins,) of a flat spectrum between two wavelengths [angstrom] with so many electrons in an order."""
    centres = 0.5 * (disperser.edges[1:] + disperser.edges[:-1])
    flat = np.ones(len(centres))
    if first is not None:
        flat[(centres < first) | (centres > last)] = 0.0
    return flat * (electrons / (flat @ disperser.rates[piece, disperser.orders.index(order)]))


def by_hand(disperser, window, x, y, light, order, piece, sigma=SIGMA_PX):
    """Return the expected image of a star behind one order, sum of error functions bin by bin; light: (bins,) e-."""
    number = disperser.orders[order]
    grating = disperser.gratings.pieces[piece][0]
    p, q, r, s = grating.orders[number].lines(np.array([x]), np.array([y]))[0]
    waves, place = 0.5 * (disperser.edges[1:] + disperser.edges[:-1]), disperser.wavelengths
    share = np.array([np.interp(waves, place, row) for row in np.eye(4)])
    out = np.zeros(window.shape)
    for f in range(4):
        used = np.flatnonzero(light * share[f] > 0)
        for some in np.array_split(used, len(used) // 200 + 1) if len(used) else ():
            u, v = x + p + q * waves[some], y + r + s * waves[some]
            parts, cut = [], []
            for at, low, high in ((v, window.y0, window.y1), (u, window.x0, window.x1)):
                first, last = np.clip([np.floor(at.min()) - 15, np.ceil(at.max()) + 16], low, high).astype(int)
                edges = np.arange(first, last + 1) - 0.5
                parts.append(np.diff(ndtr((edges[:, None] - at) / sigma[f]), axis=0))
                cut.append(slice(first - low, last - low))
            out[tuple(cut)] += (parts[0] * (light * share[f])[some]) @ parts[1].T
    return out
