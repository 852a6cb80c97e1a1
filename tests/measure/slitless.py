"""Spectra rendered with numpy alone: monochromatic slabs of a Gaussian star, 0.05 px apart."""

import math
from types import SimpleNamespace

import numpy as np
from scipy.special import erf

from csstsim.base.rng import stream
from csstsim.catalog.table import ObjectTable
from csstsim.instrument.chip import Window
from csstsim.instrument.filter import GRID
from csstsim.measure.spectra.extract import DispersedImage, Sources
from csstsim.measure.spectra.line_profile import Shapes
from csstsim.measure.spectra.spectral_model import make_model

SIGMA = 1.0  # px, FWHM 2.4: of cells, pixel not included
LIGHT = 0.97  # of a star within the PSF's box
STEP = 0.05  # px
PHOTONS = math.pi * 150.0  # m2 s
SKY, READ_NOISE = 20.0, 5.0  # electron
EDGES = np.arange(2400.0, 10800.0, 1.5)  # of spectra


def below(edges, sigma):
    return 0.5 * (1.0 + erf(np.asarray(edges) / (sigma * math.sqrt(2.0))))


class GaussianPsf:
    """Stands for optics.psf.psf_file.PsfSet."""

    oversampling = 2

    def at(self, x, y):
        line = np.diff(below((np.arange(257) - 128) * 0.5, SIGMA))
        return np.repeat((LIGHT * np.outer(line, line))[None], 4, axis=0)

    def mixed(self, function):
        return lambda x, y: function(self.at(x, y))


def orders_of(gratings, x, y, window, rows=None):
    """Return the orders' truth table of objects at x, y that reach the window."""
    found = []
    for i, (x0, y0) in enumerate(zip(x, y, strict=True)):
        for grating, (left, right, low, high) in gratings.pieces:
            if not (left <= x0 < right and low <= y0 < high):
                continue
            for number, order in grating.orders.items():
                p, q, r, s = order.lines(np.array([x0]), np.array([y0]))[0]
                ends, wave = np.sort(x0 + p + q * np.array(order.range)), order.range
                if ends[1] < window.x0 - 5 or ends[0] > window.x1 + 5:
                    continue
                found.append((100 + i, i, number, grating.name, x0, y0, p, q, r, s, 1e6, 1e6, *wave, False))
    names = (
        "id",
        "row",
        "order",
        "grating",
        "x",
        "y",
        "p",
        "q",
        "r",
        "s",
        "electrons",
        "drawn",
        "wave_min",
        "wave_max",
        "cut",
    )
    types = (np.int64, np.int32, np.int8, str, *[float] * 10, bool)
    columns = list(zip(*found, strict=True)) or [()] * len(names)
    return ObjectTable({n: np.array(c, t) for n, c, t in zip(names, columns, types, strict=True)})


def draw(image, window, gratings, orders, spectrum, k, sigma=SIGMA, numbers=None):
    """Add row k of the orders' table; spectrum: of GRID, photon / s / m2 / angstrom."""
    x, y, p, q, r, s = (orders[name][k] for name in "xypqrs")
    grating = next(g for g, _ in gratings.pieces if g.name == orders["grating"][k])
    order = grating.orders[int(orders["order"][k])]
    wave = np.arange(order.range[0], order.range[1], STEP * abs(1 / q) if order.number else 5.0)
    step = wave[1] - wave[0]
    light = PHOTONS * LIGHT * step * np.interp(wave, GRID, order.throughput) * np.interp(wave, GRID, spectrum)
    half = math.ceil(7 * sigma)
    for e, X, Y in zip(light, x + p + q * wave, y + r + s * wave, strict=True):
        i, j = round(X), round(Y)
        across = e * np.diff(below(np.arange(-half, half + 2) - 0.5 + j - Y, sigma))
        along = np.diff(below(np.arange(-half, half + 2) - 0.5 + i - X, sigma))
        a, b = max(j - half, window.y0), min(j + half + 1, window.y1)
        c, d = max(i - half, window.x0), min(i + half + 1, window.x1)
        if a < b and c < d:
            part = np.outer(across[a - j + half : b - j + half], along[c - i + half : d - i + half])
            image[a - window.y0 : b - window.y0, c - window.x0 : d - window.x0] += part


def binned(spectrum, edges):
    """Return a spectrum of GRID in bins of `edges`."""
    total = np.concatenate([[0.0], np.cumsum(0.5 * (spectrum[1:] + spectrum[:-1]) * np.diff(GRID))])
    return np.diff(np.interp(edges, GRID, total)) / np.diff(edges)


def sources_of(spectra, radius=0.0):
    shapes = Shapes.points(len(spectra))
    shapes.radius[...] = radius
    return Sources(shapes, lambda rows, edges: np.array([binned(spectra[k], edges) for k in rows]), EDGES)


def setting(camera, chip, window, positions):
    """Return (gratings, model, orders) of stars at `positions` (n, 2) px."""
    gratings = camera.gratings[chip]
    bands = camera.filters[camera.chips[chip].filter].psf_wavelength
    model = make_model(gratings, PHOTONS, GaussianPsf().at(0, 0), 2, bands)
    return SimpleNamespace(
        gratings=gratings, model=model, orders=orders_of(gratings, *np.transpose(positions), window), window=window
    )


class Even:
    """Stands for optics.throughput.response.Response: the same for all pixels."""

    def __init__(self, value):
        self.value = value

    def part(self, rows, columns):
        return np.full((rows.stop - rows.start, columns.stop - columns.start), self.value, np.float32)


def frame_of(image, window, seed=None, others=None, sky=SKY, response=None, marks=None):
    """Return the DispersedImage of an expected image; sky added, and noise with a seed."""
    image = image + sky
    if seed is not None:
        rng = stream(seed, "slitless")
        image = rng.poisson(image) + rng.normal(0.0, READ_NOISE, image.shape)
    marks = np.zeros(image.shape, np.uint8) if marks is None else marks
    return DispersedImage(window, image.astype(np.float32), marks, response and Even(response), READ_NOISE, others)


def window_about(x, y, grating_side, reach=(0, 1300), half=45):
    """Return a Window that holds the first order of a star at x, y; grating_side +1: towards +x."""
    ends = sorted(x + grating_side * v for v in reach)
    return Window(int(ends[0]), int(ends[1]), int(y) - half, int(y) + half)
