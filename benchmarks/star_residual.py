"""Residuals of a star, by stamps, photons' density and reference, against pixel-integrated direct optics; every band.

    python benchmarks/star_residual.py [--bands NUV g]

Truth: optics (mean of the band's four wavelengths) integrated over 10 um pixels, with the star at 16 positions in a
pixel, at three field points. Table: the same optics in cells, as a PSF set stores it, 2 or 4 per pixel; "used" marks
psf.yaml's number for the band. Stamps: sums of the spline coefficients, which are also the density that photons are
drawn from (render.psf_table); "below 0" is the light of the coefficients that were clipped. Reference: GalSim's quintic
through the pixel sums. "rms": of the difference, over the rms of the truth (a fit's residual), and over the truth's
peak; "worst": the worst pixel over the peak; each is the largest of the 48. 49 x 49 pixels. Goal: rms below 1e-3 of the
peak.

"The two" compares them with each other, as tests without direct optics do.
"""

import argparse

from evidence.record import Record

import numpy as np
from psf_sampling import BOX, HALF, STEPS, TOY_STEPS, mean_image, power, quintic

from csstsim.base.shipped import SHIPPED
from csstsim.instrument.camera import Camera, load_camera
from csstsim.optics.psf.chip_errors import chip_coefficients
from csstsim.optics.psf.psf_file import pixel_response
from csstsim.optics.psf.psf_set import chip_optics
from csstsim.optics.psf.sampling import oversampling_of
from csstsim.optics.psf.wavefront import load_wavefront
from csstsim.render.pixel_sums import pixel_sums
from csstsim.render.psf_table import spline_coefficients

PLACES = (4607.5, 4615.5), (0.0, 9231.0), (9215.0, 2000.0)


def stamp(coefficients, m, x, y):
    """Return the sums of coefficients over the pixels of a star at x, y from the middle pixel's centre."""
    first = (len(coefficients) / 2 - (HALF + 0.5 + c) * m for c in (y, x))
    return pixel_sums(coefficients, *first, m, m, np.empty((2 * HALF + 1,) * 2))


def differences(got, wanted):
    """Return rms over rms, rms over peak, worst over peak."""
    off = got - wanted
    rms = np.sqrt(np.mean(off**2))
    return rms / np.sqrt(np.mean(wanted**2)), rms / wanted.max(), np.abs(off).max() / wanted.max()


def measure(camera, name, cells, places=PLACES, steps=STEPS):
    """Return ({reader: (3,)}, light below zero) for a band: the largest differences over positions."""
    wavefront, filter_ = load_wavefront(camera.psf), camera.filters[name]
    chip = next(c for c in camera.chips.values() if c.filter == name)
    direct, stored = (chip_optics(chip, filter_, camera.psf, wavefront, m, BOX * m) for m in (1, cells))
    cut = slice(BOX // 2 - HALF, BOX // 2 + HALF + 1)
    rows, below = {"stamps, photons": [], "reference": [], "the two": []}, 0.0
    for place in places:
        zernikes = chip_coefficients(wavefront, camera.psf, chip, *place)
        image = mean_image(*stored, zernikes)
        coefficients, negative = spline_coefficients(image)
        below, response = max(below, negative), pixel_response(image, cells)
        for x, y in np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2):
            truth = mean_image(*direct, zernikes, (-0.5 - x, -0.5 - y))[cut, cut]
            ours, theirs = stamp(coefficients.astype(np.float32), cells, x, y), quintic(response, 1 / cells, x, y)
            rows["stamps, photons"].append(differences(ours, truth))
            rows["reference"].append(differences(theirs, truth))
            rows["the two"].append(differences(ours, theirs))
    return {key: np.max(value, axis=0) for key, value in rows.items()}, below


def report(camera: Camera, bands: list[str], record: Record) -> None:
    """Record the differences of each band with 2 and 4 cells to a pixel."""
    size = {"places": PLACES[:1], "steps": TOY_STEPS} if record.toy else {}
    rows, used = [], {"stamps, photons": [], "reference": [], "the two": []}
    for name in bands:
        for cells in (2, 4):
            found, below = measure(camera, name, cells, **size)
            is_used = cells == oversampling_of(name, camera.psf)
            for reader, numbers in found.items():
                if is_used:
                    used[reader].append(numbers)
            ours, theirs, two = (found[reader] for reader in used)
            pairs = (f"{power(rms)}, {power(worst)}" for _, rms, worst in (ours, theirs))
            rows.append([name, f"{cells} (used)" if is_used else cells, *pairs, power(two[0]), power(below)])
    header = ["band", "cells to a pixel", "stamps and photons: rms, worst", "reference: rms, worst"]
    record.table("residuals", [*header, "the two: rms over the star's rms", "light below 0"], rows)
    for key, reader, goal in (("ours", "stamps, photons", 1e-3), ("reference", "reference", None)):
        _, rms, worst = np.max(used[reader], axis=0)
        record.value(f"{key}_rms", rms, f"rms of {reader} over the peak, cells as used", below=goal)
        record.value(f"{key}_worst", worst, f"worst pixel of {reader} over the peak, cells as used")
    record.value("between", np.max(used["the two"], axis=0)[0], "rms of the two over the star's rms, cells as used")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--instrument", default=SHIPPED / "instrument", help="folder of the camera's data files")
    parser.add_argument("--bands", nargs="*", help="default: the seven imaging bands")
    with Record(parser) as record:
        camera = load_camera(record.options.instrument)
        imaging = [name for name, filter_ in camera.filters.items() if filter_.kind == "imaging"]
        report(camera, record.options.bands or imaging[: 1 if record.toy else None], record)
