"""Image quality of the camera's PSF model against the numbers published for CSST.

    python benchmarks/psf_quality.py              the budget at 632.8 nm
    python benchmarks/psf_quality.py --bands      each band, and the CPU time of one PSF and of a set

At 25 field points (5 x 5, out to the corners of the mosaic): wavefront rms, Strehl ratio and the radius that
encloses 80% of the light (EE80) at 632.8 nm, before the pixel; also with the halo of scattered light. With --bands EE80
in each band, in the middle and at the corners of its chips.
EE80 comes from the transfer function, EE(R) = int OTF(f) J1(2 pi R f) R / f d2f, so no pixel enters it.
"""

import argparse
import time
from dataclasses import replace

from evidence.record import Record

import numpy as np
from scipy.optimize import brentq
from scipy.special import j1

from csstsim.base.shipped import SHIPPED
from csstsim.instrument.camera import Camera, load_camera
from csstsim.optics.psf.chip_errors import chip_coefficients
from csstsim.optics.psf.diffraction import Diffraction, blur
from csstsim.optics.psf.psf_set import centre_of, chip_optics, node_positions, node_psf
from csstsim.optics.psf.sampling import oversampling_of
from csstsim.optics.psf.wavefront import load_wavefront
from csstsim.optics.scatter.scattered_light import scattered_light

LASER = 6328.0  # angstrom
FIELD_POINTS, TOY_FIELD_POINTS = 5, 2  # along each side
CORNER = (29758, 24876)  # px from the boresight (half the mosaic)
SPEC = {"NUV": 0.135, "u": 0.135, "g": 0.135, "r": 0.135, "i": 0.145, "z": 0.165, "y": 0.165}  # arcsec, Gong+2019
SPEC |= {"GU": 0.17, "GV": 0.19, "GI": 0.19}
BUDGET = 0.114  # arcsec, Ban+2025: EE80 of all errors at 632.8 nm, mean of the field
GRIDS = (10, 30)  # nodes along each side of a chip: the default's and the paper's
CELLS = 2  # per pixel; the results do not depend on it


def field_coefficients(camera, wavefront, *, chips, points=FIELD_POINTS):
    """Return Zernike coefficients (n, J) nm at `points`**2 positions; with `chips`, with the nearest chip's errors."""
    x, y = (a.ravel() for a in np.meshgrid(*(np.linspace(-edge, edge, points) for edge in CORNER)))
    if not chips:
        return wavefront.coefficients(x, y)
    rows = []
    for place in zip(x, y, strict=True):
        chip = min(camera.chips.values(), key=lambda c: (c.xc - place[0]) ** 2 + (c.yc - place[1]) ** 2)
        middle = np.array([chip.detector.nx - 1, chip.detector.ny - 1]) / 2
        on_chip = np.clip(np.array(place) - (chip.xc, chip.yc), -middle, middle) + middle
        rows.append(chip_coefficients(wavefront, camera.psf, chip, *on_chip))
    return np.array(rows)


class Encircled:
    """Radii that enclose a share of the light, from transfer functions of one `Diffraction` (see above)."""

    def __init__(self, optics, kernel):
        self.optics, self.kernel = optics, kernel
        k = np.rint(optics.frequency * optics.period).astype(int)
        rings, self.where = np.unique(k[: optics.size // 2 + 1] ** 2 + k[:, None] ** 2, return_inverse=True)
        self.frequency = np.sqrt(rings[1:]) / optics.period

    def radius(self, transfer, share=0.8, wing=None):
        """Return the radius (cells) about the windowed centroid that encloses `share` of all the light.

        With `wing`, a halo takes its part of the light.
        """
        o = self.optics
        centre = centre_of([o], [transfer], lambda f: self.kernel(f) * np.sinc(f), CELLS)
        turn_x, turn_y = (np.exp(2j * np.pi * o.frequency * c) * self.kernel(o.frequency) for c in centre)
        power = (transfer * turn_x[: o.size // 2 + 1] * turn_y[:, None]).real
        power[:, 1:-1] *= 2  # stands for the half-plane that a real transform omits
        ring = np.bincount(self.where.ravel(), power.ravel())[1:] / o.period**2
        keep = np.abs(ring) > 1e-9
        ring, f = ring[keep], self.frequency[keep]

        def enclosed(radius):
            light = np.sum(ring * j1(2 * np.pi * radius * f) * radius / f)
            light += transfer[0, 0].real * np.pi * radius**2 / o.period**2
            return light if wing is None else wing.core_light(light, radius / CELLS)

        return brentq(lambda radius: enclosed(radius) - share, 0.3, 12, xtol=1e-4)


def optics_at(camera, wavelength, wavefront, *, jitter=True, diffusion=True):
    """Return (Diffraction, Encircled, arcsec per cell)."""
    cell = camera.telescope.pixel_scale / CELLS
    switched = {"jitter": camera.psf["jitter"] * jitter, "diffusion": camera.psf["diffusion"] * diffusion}
    kernel = blur(switched, cell, camera.detector.pixel_um / CELLS, cell=False)
    optics = Diffraction(wavelength, camera.telescope.diameter_m, cell, wavefront)
    return optics, Encircled(optics, kernel), cell


def quality(camera, parts, *, chips=True, points=FIELD_POINTS, wing=None, **switches):
    """Return (rms nm, Strehl, EE80 arcsec), each (n,), at 632.8 nm."""
    wavefront = load_wavefront(camera.psf, parts=parts)
    optics, encircled, cell = optics_at(camera, LASER, wavefront, **switches)
    rows = []
    for coefficients in field_coefficients(camera, wavefront, chips=chips, points=points):
        phase = optics.phase(coefficients)
        mean = np.average(phase, weights=optics.mask)
        rms = np.sqrt(np.average((phase - mean) ** 2, weights=optics.mask)) * LASER / 10 / (2 * np.pi)
        strehl = abs(np.average(np.exp(1j * phase), weights=optics.mask)) ** 2
        rows.append((rms, strehl, encircled.radius(optics.transfer(coefficients), wing=wing) * cell))
    return np.array(rows).T


class Halo:
    """The halo of scattered light, as `Encircled.radius` asks for it."""

    def __init__(self, wing):
        self.wing = replace(wing, airy=0 * wing.airy)

    def core_light(self, direct: float, radius: float) -> float:
        """Return the light within `radius` [px] of which `direct` is the part in it of the image without a halo."""
        scattered = self.wing.scattered.mean()
        return (1 - scattered) * direct + scattered - self.wing.light_beyond(radius).mean()


def report_budget(camera: Camera, record: Record) -> None:
    """Record the budget of errors at 632.8 nm."""
    every, halo = ("design", "static", "mirror"), Halo(scattered_light(camera, camera.filters["r"]).wing)
    cases = {
        "none": ("no error", (), False, False, False, None, 'Airy: 0.0586"'),
        "design": ("design residual", ("design",), False, False, False, None, '19 nm, 0.964, 0.067"'),
        "static": (
            "+ alignment, gravity release, thermal, mirror figure", every, False, False, False, None, "45 nm, 0.816",
        ),
        "chips": ("+ filter pieces, heights and tilts of the chips", every, True, False, False, None, ""),
        "jitter": ("+ jitter", every, True, True, False, None, '0.114" mean, never above 0.15"'),
        "halo": ("+ halo of scattered light (outside the budget)", every, True, True, False, halo, ""),
        "diffusion": ("without halo, + charge diffusion (outside the budget)", every, True, True, True, None, ""),
    }  # fmt: skip
    points, rows, ee80 = TOY_FIELD_POINTS if record.toy else FIELD_POINTS, [], {}
    for name, (label, parts, chips, jitter, diffusion, wing, published) in cases.items():
        switches = {"chips": chips, "jitter": jitter, "diffusion": diffusion}
        rms, strehl, ee80[name] = quality(camera, parts, points=points, wing=wing, **switches)
        mean, most = ee80[name].mean(), ee80[name].max()
        rows.append([label, f"{rms.mean():.1f}", f"{strehl.mean():.3f}", f"{mean:.4f} ({most:.3f})", published])
    header = ["errors", "rms [nm]", "Strehl", "EE80 [arcsec]: mean (largest)", "published"]
    record.table("budget", header, rows)
    low, high = BUDGET - 0.0005, BUDGET + 0.0005
    mean = ee80["jitter"].mean()
    record.value("ee80", mean, "EE80 with all errors, mean of field points", unit="arcsec", below=high, above=low)
    largest = ee80["jitter"].max()
    record.value("ee80_largest", largest, "EE80 with all errors, largest of field points", unit="arcsec", below=0.15)
    for name, what in (("diffusion", "charge diffusion"), ("halo", "the halo of scattered light")):
        record.value(f"ee80_{name}", ee80[name].mean(), f"EE80 with {what}, mean of field points", unit="arcsec")
    record.value("ee80_halo_largest", ee80["halo"].max(), "EE80 with the halo, largest of field points", unit="arcsec")
    change = ee80["chips"].mean() / ee80["static"].mean() - 1
    record.value("chips_change", change, "change of the mean EE80 by filter pieces, heights and tilts of chips")


def ee80_at(camera, wavelength, places):
    """Return EE80 (arcsec) at `places` (chip, x, y), all errors but diffusion."""
    wavefront = load_wavefront(camera.psf)
    optics, encircled, cell = optics_at(camera, wavelength, wavefront, diffusion=False)
    rows = (chip_coefficients(wavefront, camera.psf, *place) for place in places)
    return np.array([encircled.radius(optics.transfer(row)) * cell for row in rows])


def report_bands(camera: Camera, record: Record) -> None:
    """Record EE80 and the cost of a PSF in each band."""
    wavefront, rows, sets, ratio = load_wavefront(camera.psf), [], {}, {}
    for name in list(camera.filters)[: 2 if record.toy else None]:
        band = camera.filters[name]
        chips = [chip for chip in camera.chips.values() if chip.filter == name][: 1 if record.toy else None]
        places = [(c, *xy) for c in chips for xy in node_positions(c, 3)[[0, 2, 4, 6, 8]]]
        ee80 = np.mean([ee80_at(camera, wavelength, places) for wavelength in band.psf_wavelength], axis=0)
        cells = oversampling_of(name, camera.psf)
        nodes = node_positions(chips[0], 3)
        coefficients = chip_coefficients(wavefront, camera.psf, chips[0], *nodes.T)
        begin = time.process_time()
        optics, kernel = chip_optics(chips[0], band, camera.psf, wavefront, cells)
        start = time.process_time()
        for row in coefficients:
            node_psf(optics, row, kernel, cells)
        cpu = (time.process_time() - start) / (4 * len(coefficients))
        sets[name] = [4 * cpu * grid**2 + start - begin for grid in GRIDS]
        ratio[name] = ee80.max() / SPEC[name]
        numbers = f"{ee80.mean():.4f}", f"{ee80.max():.3f}", f"{SPEC[name]:.3f}", f"{cells}", f"{1000 * cpu:.0f}"
        rows.append([name, *numbers, *(f"{seconds:.1f}" for seconds in sets[name])])
    header = ["band", "EE80 [arcsec]: mean", "largest", "limit", "cells per pixel", "CPU-ms per PSF"]
    record.table("bands", [*header, *(f"CPU-s per set of {grid} x {grid} nodes" for grid in GRIDS)], rows)
    worst = max(ratio, key=ratio.__getitem__)
    what = f"largest EE80 over its limit, all errors, chips' middles and corners (here {worst})"
    record.value("ee80_over_limit", ratio[worst], what, below=1)
    for grid, each in zip(GRIDS, np.transpose(list(sets.values())), strict=True):
        for word, seconds in (("minimum", each.min()), ("maximum", each.max())):
            what = f"a chip's set of {grid} x {grid} nodes, {word} over bands"
            record.value(f"set_{grid}_{word}", seconds, what, unit="CPU-s")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--instrument", default=SHIPPED / "instrument", help="folder of the camera's data files")
    parser.add_argument("--bands", action="store_true", help="each band, instead of the budget at 632.8 nm")
    with Record(parser) as record:
        report = report_bands if record.options.bands else report_budget
        report(load_camera(record.options.instrument), record)
