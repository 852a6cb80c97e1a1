"""Image quality of the camera's PSF model beside the figures published for CSST.

    python benchmarks/psf_quality.py

At 25 field points (5 x 5, out to the corners of the mosaic): wavefront rms, Strehl ratio and the radius that
encloses 80% of the light (EE80) at 632.8 nm, before the pixel; then EE80 in each band, and the CPU time of one PSF.
EE80 comes from the transfer function, EE(R) = int OTF(f) J1(2 pi R f) R / f d2f, so no pixel enters it.
"""

import argparse
import time
from pathlib import Path

import numpy as np
from scipy.optimize import brentq
from scipy.special import j1

from csstsim.instrument.camera import load_camera
from csstsim.optics.psf import CELLS_PER_PIXEL, Diffraction, blur, node_psf, pixel_response, windowed_centroid
from csstsim.optics.wavefront import load_wavefront

SHIPPED = Path(__file__).resolve().parents[1] / "config" / "instrument"
LASER = 6328.0  # angstrom
CORNER = (29758, 24876)  # px from the boresight (half the mosaic)
SPEC = {"NUV": 0.135, "u": 0.135, "g": 0.135, "r": 0.135, "i": 0.145, "z": 0.165, "y": 0.165}  # arcsec, Gong+2019
SPEC |= {"GU": 0.17, "GV": 0.19, "GI": 0.19}


def field_points():
    """Return x, y (25,) in mosaic pixels."""
    return (a.ravel() for a in np.meshgrid(*(np.linspace(-edge, edge, 5) for edge in CORNER)))


def enclosed_radius(optics, transfer, kernel, share=0.8):
    """Return the radius (cells) about the windowed centroid that encloses `share` of all the light."""
    centre = windowed_centroid(pixel_response(optics.image(transfer, blur_cell(kernel))), 1.5 * CELLS_PER_PIXEL)
    half = optics.size // 2 + 1
    turn = [np.exp(2j * np.pi * optics.frequency * c) * kernel(optics.frequency) for c in centre]
    power = (transfer * turn[0][:half] * turn[1][:, None]).real
    power[:, 1:-1] *= 2  # the half of the plane that a real transform leaves out
    k = np.rint(optics.frequency * optics.period).astype(int)
    ring = k[:half] ** 2 + k[:, None] ** 2
    rings, where = np.unique(ring, return_inverse=True)
    total = np.bincount(where.ravel(), power.ravel())[1:] / optics.period**2
    f = np.sqrt(rings[1:]) / optics.period

    def enclosed(radius):
        return transfer[0, 0].real * np.pi * radius**2 / optics.period**2 + np.sum(
            total * j1(2 * np.pi * radius * f) * radius / f
        )

    return brentq(lambda radius: enclosed(radius) - share, 0.3, 12, xtol=1e-4)


def blur_cell(kernel):
    return lambda f: kernel(f) * np.sinc(f)


def quality(camera, wavelength, parts, *, jitter=True, diffusion=True):
    """Return (rms nm, Strehl, EE80 arcsec), each (25,)."""
    wavefront = load_wavefront(camera.psf, parts=parts)
    cell = camera.telescope.pixel_scale / CELLS_PER_PIXEL
    optics = Diffraction(wavelength, camera.telescope.diameter_m, cell, wavefront)
    switched = {"jitter": camera.psf["jitter"] * jitter, "diffusion": camera.psf["diffusion"] * diffusion}
    kernel = blur(switched, cell, camera.detector.pixel_um / CELLS_PER_PIXEL, cell=False)
    rows = []
    for coefficients in wavefront.coefficients(*field_points()):
        phase = optics.phase(coefficients)
        mean = np.average(phase, weights=optics.mask)
        rms = np.sqrt(np.average((phase - mean) ** 2, weights=optics.mask)) * wavelength / 10 / (2 * np.pi)
        strehl = abs(np.average(np.exp(1j * phase), weights=optics.mask)) ** 2
        rows.append((rms, strehl, enclosed_radius(optics, optics.transfer(coefficients), kernel) * cell))
    return np.array(rows).T


def report_budget(camera):
    every = ("design", "static", "mirror")
    cases = [
        ("no error", (), False, False, "Airy: EE80 0.0586"),
        ("design", ("design",), False, False, "goal: 19 nm, Strehl 0.964, EE80 0.067"),
        ("static", every, False, False, "goal: 45 nm, Strehl 0.816"),
        ("+ jitter", every, True, False, ""),
        ("+ jitter + diffusion", every, True, True, "goal: EE80 0.114 mean, never above 0.15"),
    ]
    print(f"{LASER / 10} nm, 25 field points, before the pixel")
    print(f"{'errors':22s} {'rms nm':>7s} {'Strehl':>7s} {'EE80 arcsec: mean':>18s} {'min':>6s} {'max':>6s}")
    for name, parts, jitter, diffusion, goal in cases:
        rms, strehl, ee80 = quality(camera, LASER, parts, jitter=jitter, diffusion=diffusion)
        low, mean, high = ee80.min(), ee80.mean(), ee80.max()
        print(f"{name:22s} {rms.mean():7.1f} {strehl.mean():7.3f} {mean:18.4f} {low:6.3f} {high:6.3f}  {goal}")


def report_bands(camera):
    print("\nall errors, before the pixel, mean over 25 field points (the four wavelengths averaged)")
    print(f"{'band':5s} {'EE80 arcsec':>12s} {'spec':>6s} {'CPU s per PSF':>14s}")
    cell = camera.telescope.pixel_scale / CELLS_PER_PIXEL
    wavefront = load_wavefront(camera.psf)
    kernel = blur(camera.psf, cell, camera.detector.pixel_um / CELLS_PER_PIXEL)
    for name, band in camera.filters.items():
        ee80 = [quality(camera, w, ("design", "static", "mirror"))[2].mean() for w in band.psf_wavelength]
        optics = [Diffraction(w, camera.telescope.diameter_m, cell, wavefront) for w in band.psf_wavelength]
        start = time.process_time()
        for x in (0, 10000, 20000):
            node_psf(optics, wavefront.coefficients(x, -x), kernel)
        cpu = (time.process_time() - start) / 12
        print(f"{name:5s} {np.mean(ee80):12.4f} {SPEC.get(name, np.nan):6.3f} {cpu:14.3f}")


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
