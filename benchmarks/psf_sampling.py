"""How many cells a pixel the stored PSF needs, per band: its file read as the renderer reads it, against direct optics.

    python benchmarks/psf_sampling.py [--bands NUV g]

Truth is the optics integrated over 10 um pixels at the star's own place in a pixel. The table (2 or 4 cells to a pixel)
is summed to pixel integrals on its lattice and interpolated to the same place by GalSim's quintic (as
render/reference.py does) or by a cubic or quintic B-spline. Moments weighted with a Gaussian of 3 px; the mean over
random phases is the bias, the largest single one stands beside it. Goals: flux 1e-3, centroid 1 mas, size^2 1e-3,
ellipticity 1e-4.
"""

import argparse
from pathlib import Path

import galsim
import numpy as np
from scipy.ndimage import map_coordinates

from csstsim.instrument.camera import load_camera
from csstsim.optics.diffraction import Diffraction, blur
from csstsim.optics.psf_file import pixel_response
from csstsim.optics.wavefront import load_wavefront
from csstsim.render.reference import GSPARAMS
from csstsim.rng import stream

SHIPPED = Path(__file__).resolve().parents[1] / "config" / "instrument"
FIELD = ((2000.0, 1000.0), (25000.0, -20000.0))  # px of the mosaic: middle and edge
HALF = 24  # px: the stamp is 49 x 49
WINDOW_PX = 3.0
PHASES = 12
GALSIM = galsim.GSParams(**GSPARAMS)


def moments(image):
    """Return flux, x, y (px), size^2 (px^2), e1, e2, all but the flux weighted with the Gaussian about the centroid."""
    axis = np.arange(image.shape[0]) - (image.shape[0] - 1) / 2
    x = y = 0.0
    for _ in range(60):
        weight = np.exp(-0.5 * ((axis - x) ** 2 + (axis[:, None] - y) ** 2) / WINDOW_PX**2) * image
        x, y = (x + 2 * np.sum(weight * (axis - x)) / weight.sum(),
                y + 2 * np.sum(weight * (axis[:, None] - y)) / weight.sum())  # fmt: skip
    xx, yy, xy = (
        np.sum(weight * a * b) / weight.sum()
        for a, b in ((axis - x, axis - x), (axis[:, None] - y,) * 2, (axis - x, axis[:, None] - y))
    )
    return np.array([image.sum(), x, y, xx + yy, (xx - yy) / (xx + yy), 2 * xy / (xx + yy)])


def quintic(response, step, x, y):
    """Return the stamp as render/reference.py draws a star."""
    image = galsim.ImageD(2 * HALF + 1, 2 * HALF + 1)
    profile = galsim.InterpolatedImage(
        galsim.ImageD(response), scale=step, normalization="sb", x_interpolant="quintic", gsparams=GALSIM,
        _force_maxk=np.pi / step, _force_stepk=2 * np.pi / (response.shape[0] * step),
    )  # fmt: skip
    profile.drawImage(image, scale=1.0, method="no_pixel", center=image.true_center + galsim.PositionD(x, y))
    return image.array


def spline(order):
    def read(response, step, x, y):
        axis = np.arange(-HALF, HALF + 1)
        middle = (response.shape[0] - 1) / 2
        at = np.meshgrid(middle + (axis - y) / step, middle + (axis - x) / step, indexing="ij")
        return map_coordinates(response, at, order=order, mode="constant")

    return read


READERS = {"quintic": quintic, "B-spline 3": spline(3), "B-spline 5": spline(5)}


def optics_of(camera, wavefront, filter_, oversampling, box_px):
    cell = camera.telescope.pixel_scale / oversampling
    made = [
        Diffraction(w, camera.telescope.diameter_m, cell, wavefront, box_px * oversampling)
        for w in filter_.psf_wavelength
    ]
    return made, blur(camera.psf, cell, camera.detector.pixel_um / oversampling)


def mean_image(optics, kernel, transfers, centre):
    return np.mean([o.image(t, kernel, centre) for o, t in zip(optics, transfers, strict=True)], axis=0)


def measure(camera, name):
    """Return {(oversampling, reader): (phases, 6) differences to the truth} of a band, all field points."""
    wavefront, filter_ = load_wavefront(camera.psf), camera.filters[name]
    box = 128
    direct = optics_of(camera, wavefront, filter_, 1, box)
    tables = {m: optics_of(camera, wavefront, filter_, m, box) for m in (2, 4)}
    phases = stream(4, "phases").uniform(-0.5, 0.5, (PHASES, 2))
    rows = {(m, reader): [] for m in tables for reader in READERS}
    peak = {key: [] for key in rows}
    for place in FIELD:
        coefficients = wavefront.coefficients(*place)
        transfers = [o.transfer(coefficients) for o in direct[0]]
        responses = {
            m: pixel_response(mean_image(*table, [o.transfer(coefficients) for o in table[0]], (0.0, 0.0)), m)
            for m, table in tables.items()
        }
        for x, y in phases:
            # A box of an even number of pixels: the star is half a pixel up and right of a pixel's centre
            truth = mean_image(*direct, transfers, (-0.5 - x, -0.5 - y))
            middle = box // 2
            cut = slice(middle - HALF, middle + HALF + 1)
            truth = truth[cut, cut]
            wanted = moments(truth)
            for (m, reader), into in rows.items():
                got = READERS[reader](responses[m], 1 / m, x, y)
                difference = moments(got) - wanted
                difference[[0, 3]] /= wanted[[0, 3]]
                difference[1:3] *= 1000 * camera.telescope.pixel_scale
                into.append(difference)
                peak[m, reader].append(np.abs(got - truth).max() / truth.max())
    return {key: (np.array(value), max(peak[key])) for key, value in rows.items()}


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--instrument", default=SHIPPED, help="folder of the camera's data files")
    parser.add_argument("--bands", nargs="*", help="default: all")
    args = parser.parse_args()
    camera = load_camera(args.instrument)
    print(
        "band cells reader      | flux: bias max | centroid mas: bias max | size^2: bias max | e: bias max | pixel/peak"
    )
    for name in args.bands or camera.filters:
        for (m, reader), (rows, peak) in measure(camera, name).items():
            bias, most = np.abs(rows.mean(axis=0)), np.abs(rows).max(axis=0)
            pairs = [
                f(v)
                for v in ((0,), (1, 2), (3,), (4, 5))
                for f in (lambda v: bias[list(v)].max(), lambda v: most[list(v)].max())
            ]
            print(
                f"{name:4s} {m:4d}  {reader:11s} |"
                + " |".join(f" {a:8.1e} {b:8.1e}" for a, b in zip(pairs[::2], pairs[1::2]))
                + f" | {peak:8.1e}",
                flush=True,
            )


if __name__ == "__main__":
    main()
