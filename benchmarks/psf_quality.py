"""Image quality of the camera's PSF model against the numbers published for CSST.

    python benchmarks/psf_quality.py [--bands]

At 25 field points (5 x 5, out to the corners of the mosaic): wavefront rms, Strehl ratio and the radius that
encloses 80% of the light (EE80) at 632.8 nm, before the pixel; with --bands EE80 in each band (in the middle and at the
corners of its imaging chips) and the CPU time of one PSF.
EE80 comes from the transfer function, EE(R) = int OTF(f) J1(2 pi R f) R / f d2f, so no pixel enters it.
"""

import argparse
import time
from pathlib import Path

import numpy as np
from scipy.optimize import brentq
from scipy.special import j1

from csstsim.instrument.camera import load_camera
from csstsim.optics.psf.chip_errors import chip_coefficients
from csstsim.optics.psf.diffraction import Diffraction, blur
from csstsim.optics.psf.psf_set import centre_of, chip_optics, node_positions, node_psf
from csstsim.optics.psf.sampling import oversampling_of
from csstsim.optics.psf.wavefront import load_wavefront

SHIPPED = Path(__file__).resolve().parents[1] / "config" / "instrument"
LASER = 6328.0  # angstrom
CORNER = (29758, 24876)  # px from the boresight (half the mosaic)
SPEC = {"NUV": 0.135, "u": 0.135, "g": 0.135, "r": 0.135, "i": 0.145, "z": 0.165, "y": 0.165}  # arcsec, Gong+2019
SPEC |= {"GU": 0.17, "GV": 0.19, "GI": 0.19}


CELLS = 2  # per pixel; the results do not depend on it


def field_coefficients(camera, wavefront, *, chips):
    """Return Zernike coefficients (25, J) nm at 5 x 5 field points; with `chips`, with the nearest chip's errors."""
    x, y = (a.ravel() for a in np.meshgrid(*(np.linspace(-edge, edge, 5) for edge in CORNER)))
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

    def radius(self, transfer, share=0.8):
        """Return the radius (cells) about the windowed centroid that encloses `share` of all the light."""
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
            return transfer[0, 0].real * np.pi * radius**2 / o.period**2 + light

        return brentq(lambda radius: enclosed(radius) - share, 0.3, 12, xtol=1e-4)


def optics_at(camera, wavelength, wavefront, *, jitter=True, diffusion=True):
    """Return (Diffraction, Encircled, arcsec per cell)."""
    cell = camera.telescope.pixel_scale / CELLS
    switched = {"jitter": camera.psf["jitter"] * jitter, "diffusion": camera.psf["diffusion"] * diffusion}
    kernel = blur(switched, cell, camera.detector.pixel_um / CELLS, cell=False)
    optics = Diffraction(wavelength, camera.telescope.diameter_m, cell, wavefront)
    return optics, Encircled(optics, kernel), cell


def quality(camera, parts, *, chips=True, **switches):
    """Return (rms nm, Strehl, EE80 arcsec), each (25,), at 632.8 nm."""
    wavefront = load_wavefront(camera.psf, parts=parts)
    optics, encircled, cell = optics_at(camera, LASER, wavefront, **switches)
    rows = []
    for coefficients in field_coefficients(camera, wavefront, chips=chips):
        phase = optics.phase(coefficients)
        mean = np.average(phase, weights=optics.mask)
        rms = np.sqrt(np.average((phase - mean) ** 2, weights=optics.mask)) * LASER / 10 / (2 * np.pi)
        strehl = abs(np.average(np.exp(1j * phase), weights=optics.mask)) ** 2
        rows.append((rms, strehl, encircled.radius(optics.transfer(coefficients)) * cell))
    return np.array(rows).T


def report_budget(camera):
    every = ("design", "static", "mirror")
    cases = [
        ("no error", (), False, False, False, "Airy: EE80 0.0586"),
        ("design", ("design",), False, False, False, "goal: 19 nm, Strehl 0.964, EE80 0.067"),
        ("static", every, False, False, False, "goal: 45 nm, Strehl 0.816"),
        ("+ filters, detectors", every, True, False, False, ""),
        ("+ jitter", every, True, True, False, "goal: EE80 0.114 mean, never above 0.15"),
        ("+ diffusion", every, True, True, True, "(a detector effect, outside the budget)"),
    ]
    print(f"{LASER / 10} nm, 25 field points, before the pixel")
    print(f"{'errors':22s} {'rms nm':>7s} {'Strehl':>7s} {'EE80 arcsec: mean':>18s} {'min':>6s} {'max':>6s}")
    for name, parts, chips, jitter, diffusion, goal in cases:
        rms, strehl, ee80 = quality(camera, parts, chips=chips, jitter=jitter, diffusion=diffusion)
        low, mean, high = ee80.min(), ee80.mean(), ee80.max()
        print(f"{name:22s} {rms.mean():7.1f} {strehl.mean():7.3f} {mean:18.4f} {low:6.3f} {high:6.3f}  {goal}")


def ee80_at(camera, wavelength, places):
    """Return EE80 (arcsec) at `places` (chip, x, y), all errors but diffusion."""
    wavefront = load_wavefront(camera.psf)
    optics, encircled, cell = optics_at(camera, wavelength, wavefront, diffusion=False)
    rows = (chip_coefficients(wavefront, camera.psf, *place) for place in places)
    return np.array([encircled.radius(optics.transfer(row)) * cell for row in rows])


def report_bands(camera):
    print("\nall errors but diffusion, before the pixel, mean of the four wavelengths; at chips' middles and corners")
    print(
        f"{'band':5s} {'EE80 arcsec':>12s} {'max':>6s} {'limit':>6s} {'cells/px':>9s} {'ms / PSF':>9s} {'s / set':>8s}"
    )
    wavefront = load_wavefront(camera.psf)
    for name, band in camera.filters.items():
        chips = [chip for chip in camera.chips.values() if chip.filter == name]
        places = [(c, *xy) for c in chips for xy in node_positions(c, 3)[[0, 2, 4, 6, 8]]]
        ee80 = np.mean([ee80_at(camera, wavelength, places) for wavelength in band.psf_wavelength], axis=0)
        cells = oversampling_of(name, camera.psf)
        nodes = node_positions(chips[0], 3)
        rows = chip_coefficients(wavefront, camera.psf, chips[0], *nodes.T)
        begin = time.process_time()
        optics, kernel = chip_optics(chips[0], band, camera.psf, wavefront, cells)
        start = time.process_time()
        for row in rows:
            node_psf(optics, row, kernel, cells)
        cpu = (time.process_time() - start) / (4 * len(rows))
        limit = SPEC.get(name, np.nan)
        print(
            f"{name:5s} {ee80.mean():12.4f} {ee80.max():6.3f} {limit:6.3f} {cells:9d} {1000 * cpu:9.1f} "
            f"{cpu * 3600 + start - begin:8.0f}", flush=True,
        )  # fmt: skip


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--instrument", default=SHIPPED, help="folder of the camera's data files")
    parser.add_argument("--bands", action="store_true", help="also every band (about two minutes)")
    args = parser.parse_args()
    camera = load_camera(args.instrument)
    report_budget(camera)
    if args.bands:
        report_bands(camera)


if __name__ == "__main__":
    main()
