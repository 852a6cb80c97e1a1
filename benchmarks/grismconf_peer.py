"""Traces, dispersion and line images by grismconf, from the files that csstsim writes of its gratings.

    python benchmarks/grismconf_peer.py [--chips 1 2 3]

Needs `pip install --no-deps grismconf`; without it the command says so and ends. Prints a row for each chip.

Traces: all orders, at 9 x 9 direct images and 25 wavelengths: where grismconf puts the light, less where csstsim does.

Line images: a star and a galaxy (0.3", sheared) with the flux of one line, 1e-16 erg / s / cm2, at three wavelengths of
the first order, 600 s. csstsim draws it as in a campaign, with a Gaussian PSF. The other frame is made as simulators on
grismconf make theirs: each cell of the direct image (a quarter pixel) goes by DISPX and DISPY to its
place for each wavelength, with the electrons of SENS, and is shared by area among pixels. Exit code 1 beyond 0.02 px or
1%.
"""

import argparse
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace

from evidence.record import Record

import galsim
import numpy as np
from support.canvases import blank
from support.grating_scene import PIXEL, disperser_of, gaussian_psf, scene_of

from csstsim.base.units import C_A_S, H_J_S
from csstsim.instrument.camera import load_camera
from csstsim.instrument.chip import Window
from csstsim.instrument.filter import GRID
from csstsim.instrument.grismconf import order_name, write_grismconf
from csstsim.render.slitless.slabs import draw_spectra
from csstsim.render.slitless.traces import Traces
from csstsim.studies.bench.slitless.cases import means

PX, FLUX_RATIO = 0.02, 0.01
FLUX, SIGMA, EXPTIME = 1e-16, 2.0, 600.0  # erg / s / cm2, angstrom, s
WIDTH, SIZE, MATRIX, HALF = 1.0, 0.3, [[1.3, 0.2], [0.2, 0.8]], 40  # of the PSF [px], the galaxy ["], its shape; px
SPLIT = 4  # cells along a pixel of the direct image
PLACES = np.array([0.25, 0.5, 0.75])  # of the first order's range


def traces(camera, chip, folder, Config):
    """Return (largest difference of x, of y [px]) of a chip's orders."""
    worst = np.zeros(2)
    for grating, piece in camera.gratings[chip].pieces:
        (path, *_), _ = write_grismconf(folder, grating, piece, camera.chips[chip], camera.telescope)
        peer = Config(str(path))
        for number, order in grating.orders.items():
            name = order_name(number)
            waves = np.linspace(*order.range, 25)
            for x in np.linspace(*piece[:2], 9):
                for y in np.linspace(*piece[2:], 9):
                    p, q, r, s = order.lines(x, y)
                    t = peer.INVDISPL(name, x, y, waves)
                    along, across = peer.DISPX(name, x, y, t) - p - q * waves, peer.DISPY(name, x, y, t) - r - s * waves
                    worst = np.maximum(worst, [np.abs(along).max(), np.abs(across).max()])
    return worst


def line_images(camera, chip, folder, Config):
    """Yield (grating, object, wavelength, electrons over the peer's, offset (2,) [px], difference of a pixel)."""
    disperser, psf = disperser_of(camera, chip), gaussian_psf(Path(folder) / f"{chip}.h5", (WIDTH,) * 4)
    for k, (grating, piece) in enumerate(camera.gratings[chip].pieces):
        peer, order = Config(str(Path(folder) / f"{grating.name}.conf")), grating.orders[1]
        x, y = 0.5 * (max(piece[0], 0) + min(piece[1], 9215)) + 0.3, 4600.4
        for kind, shape in (("star", {}), ("galaxy", {"index": (1.0, 0.0), "matrix": MATRIX})):
            scene = scene_of(psf, x, y, **shape).sized(HALF)
            direct = direct_image(kind, x, y)
            for line in order.range[0] + PLACES * np.ptp(order.range):
                profile = np.exp(-0.5 * ((GRID - line) / SIGMA) ** 2) / (SIGMA * np.sqrt(2 * np.pi))
                p, q, r, s = order.lines(x, y)
                middle, row = round(float(x + p + q * line)), round(float(y + r + s * line))
                window = Window(middle - HALF, middle + HALF + 1, row - HALF, row + HALF + 1)
                canvas = blank(window, float)
                light = means(FLUX * 1e-3 * GRID / (H_J_S * C_A_S) * profile, disperser.edges)[None] * EXPTIME
                draw_spectra(canvas, scene, Traces(light, np.array([[0, k, 0]]), disperser), psf)
                ours, theirs = canvas.expected, peer_image(peer, direct, x, y, FLUX * profile, window)
                off = centre(ours) - centre(theirs)
                yield grating.name, kind, line, ours.sum() / theirs.sum(), off, np.abs(ours - theirs).max() / ours.max()


def direct_image(kind, x, y):
    """Return (x, y [px], light) of the cells of an object's image of unit light, by GalSim."""
    profile = galsim.Gaussian(sigma=WIDTH)
    if kind == "galaxy":
        disk = galsim.Sersic(n=1, half_light_radius=SIZE)
        shape = np.array(MATRIX) / PIXEL
        profile = galsim.Convolve(galsim.Transform(disk, shape, flux_ratio=1 / np.linalg.det(shape)), profile)
    n = 2 * HALF * SPLIT + 1
    cells = galsim.ImageD(n, n)
    profile.drawImage(cells, scale=1 / SPLIT)
    at = (np.arange(n) - n // 2) / SPLIT
    dx, dy = np.meshgrid(at, at)
    keep = cells.array > 1e-8
    return x + dx[keep], y + dy[keep], cells.array[keep]


def peer_image(peer, direct, x, y, flux, window):
    """Return the electrons of a line, flux [erg / s / cm2 / A] on GRID, cell by cell and wavelength by wavelength."""
    image, (xs, ys, light) = np.zeros(window.shape), direct
    lit = np.flatnonzero(flux > 1e-6 * flux.max())
    step = GRID[1] - GRID[0]
    for wave, density in zip(GRID[lit], flux[lit], strict=True):
        electrons = density * step * float(peer.SENS["+1"](wave)) * EXPTIME
        t = peer.INVDISPL("+1", xs, ys, wave)
        u, v = xs + peer.DISPX("+1", xs, ys, t) - window.x0, ys + peer.DISPY("+1", xs, ys, t) - window.y0
        for i, share_x in overlaps(u):
            for j, share_y in overlaps(v):
                inside = (i >= 0) & (i < window.nx) & (j >= 0) & (j < window.ny)
                np.add.at(image, (j[inside], i[inside]), (electrons * light * share_x * share_y)[inside])
    return image


def overlaps(middle):
    """Return two pairs (pixel, share of a cell in it), of cells about `middle`; pixel k ends at k + 0.5."""
    first = np.floor(middle - 0.5 / SPLIT + 0.5).astype(int)
    share = np.clip((first + 0.5 - (middle - 0.5 / SPLIT)) * SPLIT, 0.0, 1.0)
    return (first, share), (first + 1, 1.0 - share)


def centre(image):
    """Return the centroid (x, y) [px]."""
    y, x = np.indices(image.shape)
    return np.array([(image * x).sum(), (image * y).sum()]) / image.sum()


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--chips", type=int, nargs="+", default=[1, 2, 3])
    with Record(parser) as record:
        peer(record)


def peer(record: Record) -> None:
    """Compare with grismconf, and record the differences."""
    options = record.options
    try:
        for name in ("jwst", "asdf"):  # which grismconf needs for JWST's own reference files only
            if find_spec(name) is None:
                sys.modules[name] = SimpleNamespace(datamodels=None)
        from grismconf import Config
    except ImportError as error:
        record.skip("grismconf", f"not installed (pip install --no-deps grismconf): {error}")
        return
    camera, rows, worst = load_camera(), [], np.zeros(3)
    with tempfile.TemporaryDirectory() as folder:
        for chip in options.chips[:1] if record.toy else options.chips:
            along, across = traces(camera, chip, folder, Config)
            found = [line[3:] for line in line_images(camera, chip, folder, Config)]
            ratio, off, most = (np.array(column) for column in zip(*found, strict=True))
            light = sorted({f"{value:.5f}" for value in (ratio.min(), ratio.max())})
            cells = f"{along:.1e}, {across:.1e}", " to ".join(light), f"{np.abs(off).max():.0e}", f"{most.max():.4f}"
            rows.append([f"{chip} ({camera.chips[chip].filter})", *cells])
            worst = np.maximum(worst, [max(along, across), np.abs(off).max(), np.abs(ratio - 1).max()])
    header = ["chip", "traces along, across [px]", "light of the line, csstsim / grismconf", "centroid [px]"]
    record.table("chips", [*header, "largest difference of a pixel, of the peak"], rows)
    record.value("traces", worst[0], "largest difference of a trace", unit="px", below=PX)
    record.value("centroid", worst[1], "largest offset of a line's image", unit="px", below=PX)
    record.value("light", worst[2], "largest difference of a line's electrons, relative", below=FLUX_RATIO)


if __name__ == "__main__":
    main()
