"""Error of slabs against their number, of a star and a galaxy behind a grating of chip 29, and photons against them.

    python benchmarks/slitless_slabs.py [--figure docs/figures/slitless_slabs.png]

The reference has 16 slabs and 16 heights to a pixel. `rms`: of the difference over that of the image; `sigma`: root of
the sum of difference^2 / (image + 60 e-), that is what an ideal filter sees, of 1e7 electrons in the first order.
"""

import argparse
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from csstsim.config import SHIPPED
from csstsim.instrument.camera import load_camera
from csstsim.instrument.chip import Window
from csstsim.optics.dispersion import Disperser
from csstsim.optics.psf import PsfSet, make_psf
from csstsim.render import phases, slabs
from csstsim.render.dispersed_photons import shoot_spectra
from csstsim.render.psf_table import make_table
from csstsim.render.scene import Scene, sersic_b

CHIP, WINDOW, ELECTRONS, VARIANCE = 29, Window(1600, 6100, 4740, 4960), 1e7, 60.0
PLACES = [(3800.0 + a, 4850.0 + b) for a, b in ((0.0, 0.0), (0.13, 0.13), (0.29, 0.44), (0.37, 0.21))]
COUNTS = 1, 2, 4, 8


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--figure", type=Path)
    figure = parser.parse_args().figure
    camera = load_camera(SHIPPED / "instrument")
    filter = camera.filters["GV"]
    disperser = Disperser(camera.gratings[CHIP], filter, camera.telescope)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "chip_29.h5"
        make_psf(path, camera.chips[CHIP], filter, camera.telescope, camera.psf, 2, camera_digest=camera.digest)
        psf = PsfSet(path)
        rows = measure(disperser, psf)
        agree(disperser, psf)
    if figure:
        draw(rows, figure)


def measure(disperser, psf):
    mean, rows = slabs.densities, {}
    print("object  spectrum   slabs/px   rms, mean and worst    sigma, worst   CPU ms")
    for name, galaxy in (("star", False), ("galaxy", True)):
        for kind, spectrum in spectra(disperser).items():
            for count in COUNTS:
                slabs.densities = lambda scene, per_px: np.array([per_px])
                errors = [compare(disperser, psf, place, galaxy, spectrum, count) for place in PLACES]
                rms, sigma, ms = np.transpose(errors)
                rows[name, kind, count] = rms.max()
                print(
                    f"{name:7s} {kind:9s} {count:6d}     {rms.mean():9.1e} {rms.max():9.1e} {sigma.max():13.2f}"
                    f" {np.median(ms):12.0f}"
                )
    slabs.densities = mean
    return rows


def spectra(disperser):
    """Return {kind: (bins,)} of ELECTRONS electrons in the first order of the left grating."""
    centres, rate = 0.5 * (disperser.edges[1:] + disperser.edges[:-1]), disperser.rates[0, disperser.orders.index(1)]
    shapes = {"flat": np.ones(len(centres)), "line": 1.0 * (np.abs(centres - 5500) < 0.8)}
    return {kind: ELECTRONS * shape / (shape @ rate) for kind, shape in shapes.items()}


def scene_of(psf, place, galaxy):
    sersic = np.zeros((1, 2, 3))
    if galaxy:
        sersic[0] = (1.0, sersic_b(1.0), 0.3), (4.0, sersic_b(4.0), 0.15)
    x, y = np.array([place[0]]), np.array([place[1]])
    node, weight, outside = psf.weights(x, y)
    light = np.array([[0.8, 0.2]]) if galaxy else np.array([[1.0, 0.0]])
    electrons = np.full((1, 4), ELECTRONS / 4)
    return Scene(np.array([1]), x, y, electrons, light, sersic, np.eye(2)[None] / 0.074, node, weight, outside)


def image_of(disperser, psf, scene, spectrum, count, heights=None, reach=None):
    reach, usual = np.array([reach or (31 if scene.sersic[0, 0, 0] == 0 else 60)]), phases.HEIGHTS
    visits, phases.HEIGHTS = disperser.visits(scene.x, scene.y, reach.astype(float)), heights or usual
    image, start = np.zeros(WINDOW.shape), time.process_time()
    slabs.draw_spectra(image, WINDOW, scene, spectrum[None], visits, reach, np.zeros(1), disperser, psf, per_px=count)
    phases.HEIGHTS = usual
    return image, 1e3 * (time.process_time() - start)


def compare(disperser, psf, place, galaxy, spectrum, count):
    scene = scene_of(psf, place, galaxy)
    reference, _ = image_of(disperser, psf, scene, spectrum, 16, heights=(16, 16))
    image, ms = image_of(disperser, psf, scene, spectrum, count)
    difference = image - reference
    rms = np.sqrt((difference**2).sum() / (reference**2).sum())
    return rms, np.sqrt((difference**2 / (reference + VARIANCE)).sum()), ms


def agree(disperser, psf):
    """Print chi^2 of photons against slabs as they are used."""
    table = make_table(psf)
    print("\nphotons against slabs: chi^2 - n, in sigma; n pixels of 20 e- and more, and squares of 10 px; CPU s")
    for name, galaxy in (("star", False), ("galaxy", True)):
        for kind, spectrum in spectra(disperser).items():
            scene = scene_of(psf, PLACES[2], galaxy)
            image, _ = image_of(disperser, psf, scene, spectrum, slabs.PER_PX, reach=100 if galaxy else 33)
            visits, counted = disperser.visits(scene.x, scene.y, np.array([60.0])), np.zeros(WINDOW.shape, np.int32)
            keys, start = np.array([11], np.uint64), time.process_time()
            shoot_spectra(counted, WINDOW, scene, spectrum[None], visits, disperser, keys, table)
            spent, chi = time.process_time() - start, []
            for expected, found in ((image, counted), tuple(squares(v) for v in (image, counted))):
                used = expected > 20
                chi2 = ((found - expected)[used] ** 2 / expected[used]).sum()
                chi.append(f"{(chi2 - used.sum()) / np.sqrt(2 * used.sum()):6.2f} ({used.sum()})")
            print(f"{name:7s} {kind:5s} {'  '.join(chi)}  {spent:.2f} for {counted.sum():.2e} e-")


def squares(image):
    return image.reshape(image.shape[0] // 10, 10, -1, 10).sum(axis=(1, 3))


def draw(rows, path):
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    fig, axes = plt.subplots(figsize=(5, 3.6), layout="constrained")
    for (name, kind), style in zip([(n, k) for n in ("star", "galaxy") for k in ("flat", "line")],
                                   ("C0o-", "C0o--", "C1s-", "C1s--"), strict=True):  # fmt: skip
        axes.loglog(COUNTS, [rows[name, kind, c] for c in COUNTS], style, label=f"{name}, {kind} spectrum", base=2)
    axes.set(xlabel="slabs to a pixel of the trace", ylabel="rms of the error / of the image")
    axes.set_yscale("log", base=10)
    axes.set_xticks(COUNTS, COUNTS)
    axes.axvline(slabs.PER_PX, color="0.7", lw=1, zorder=0)
    axes.legend(frameon=False, fontsize=8)
    fig.savefig(path, dpi=110)


if __name__ == "__main__":
    main()
