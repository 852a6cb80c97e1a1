"""Figures of the PSF model: EE80 over the focal plane, and a gallery of the bands.

    python benchmarks/psf_figures.py

docs/figures/psf_ee80.png: radius of 80% of the light, before the pixel and diffusion, with filters, detectors and
jitter, at 632.8 nm on every chip and at the middle of each chip's own band.
docs/figures/psf_gallery.png: PSFs in the middle of the mosaic and at its edge, cells with diffusion, log stretch.
"""

import argparse
from pathlib import Path

from evidence.record import Record

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from PIL import Image
from psf_quality import LASER, ee80_at

from csstsim.base.shipped import SHIPPED
from csstsim.instrument.camera import Camera, load_camera
from csstsim.optics.psf.chip_errors import chip_coefficients
from csstsim.optics.psf.psf_set import chip_optics, node_positions, node_psf
from csstsim.optics.psf.wavefront import load_wavefront

NODES, TOY_NODES = 5, 2  # along each side of a chip
HALF_ARCSEC = 0.8
DECADES = 4.0


def ee80_map(camera: Camera, record: Record) -> None:
    """Draw EE80 over all chips: left at one wavelength, right each chip in its own band."""
    figure, axes = plt.subplots(1, 2, figsize=(10.5, 4.4), layout="constrained")
    own = {name: f.psf_wavelength.mean() for name, f in camera.filters.items()}
    nodes = TOY_NODES if record.toy else NODES
    views = {"laser": (lambda name: LASER, "632.8 nm"), "own": (own.get, "middle of each chip's band")}
    for ax, (key, (wavelength_of, title)) in zip(axes, views.items(), strict=True):
        maps = {}
        for name in camera.filters:
            chips = [chip for chip in camera.chips.values() if chip.filter == name][: 1 if record.toy else None]
            places = [(chip, *xy) for chip in chips for xy in node_positions(chip, nodes)]
            values = ee80_at(camera, wavelength_of(name), places).reshape(len(chips), nodes, nodes)
            maps |= {chip.id: value for chip, value in zip(chips, values, strict=True)}
        low, high = min(v.min() for v in maps.values()), max(v.max() for v in maps.values())
        for word, value in (("minimum", low), ("maximum", high)):
            what = f"EE80 over all chips, {title}, before diffusion: {word}"
            record.value(f"ee80_{key}_{word}", value, what, unit="arcsec")
        for chip in (camera.chips[number] for number in maps):
            nx, ny = chip.detector.nx, chip.detector.ny
            extent = np.array([chip.xc - nx / 2, chip.xc + nx / 2, chip.yc - ny / 2, chip.yc + ny / 2]) / 1000
            shown = ax.imshow(
                maps[chip.id], extent=extent, origin="lower", vmin=low, vmax=high, interpolation="bilinear"
            )
            ax.text(chip.xc / 1000, chip.yc / 1000, chip.filter, ha="center", va="center", color="w", fontsize=8)
        ax.set(xlim=(-31, 31), ylim=(-26, 26), aspect="equal", title=title, xlabel="x [1000 px]", ylabel="y [1000 px]")
        figure.colorbar(shown, ax=ax, shrink=0.8, label="EE80 radius [arcsec]")
    save(figure, record.figure("psf_ee80.png"))


def gallery(camera: Camera, path: Path) -> None:
    """Draw each band: the shortest wavelength in the middle of the mosaic, and the longest at its edge."""
    wavefront = load_wavefront(camera.psf)
    names = sorted(camera.filters, key=lambda n: camera.filters[n].psf_wavelength.mean())
    figure, axes = plt.subplots(2, len(names), figsize=(1.35 * len(names), 3.3), layout="constrained")
    for column, name in enumerate(names):
        chips = sorted((c for c in camera.chips.values() if c.filter == name), key=lambda c: np.hypot(c.xc, c.yc))
        filter_ = camera.filters[name]
        for row, (chip, which) in enumerate(((chips[0], 0), (chips[-1], 3))):
            optics, kernel = chip_optics(chip, filter_, camera.psf, wavefront, 4)
            corners = node_positions(chip, 2)
            outward = corners[np.argmax((corners - corners.mean(axis=0)) @ (chip.xc, chip.yc))]
            place = outward if row else corners.mean(axis=0)
            image = node_psf(optics, chip_coefficients(wavefront, camera.psf, chip, *place), kernel, 4)[0][which]
            half = round(HALF_ARCSEC / camera.telescope.pixel_scale * 4)
            middle = slice(128 - half, 128 + half)
            shown = np.log10(np.maximum(image[middle, middle] / image.max(), 10**-DECADES))
            ax = axes[row, column]
            ax.imshow(shown, origin="lower", vmin=-DECADES, vmax=0, cmap="inferno")
            ax.set(xticks=[], yticks=[], title=f"{name} {filter_.psf_wavelength[which] / 10:.0f} nm")
            ax.title.set_fontsize(8)
    for ax, label in zip(axes[:, 0], ("middle, shortest", "edge, longest"), strict=True):
        ax.set_ylabel(label, fontsize=8)
    figure.suptitle(f"{2 * HALF_ARCSEC:.1f} arcsec wide, log stretch over {DECADES:.0f} decades", fontsize=9)
    save(figure, path)


def save(figure, path):
    """Write a PNG of 256 colours, which is a third of the size."""
    figure.savefig(path, dpi=80)
    with Image.open(path) as image:
        image.convert("RGB").quantize(256).save(path, optimize=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--instrument", default=SHIPPED / "instrument", help="folder of the camera's data files")
    with Record(parser) as record:
        camera = load_camera(record.options.instrument)
        gallery(camera, record.figure("psf_gallery.png"))
        ee80_map(camera, record)
