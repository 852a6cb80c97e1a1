"""Number of cells per pixel that the stored PSF needs in each band: the set, as the renderer reads it, against optics.

    python benchmarks/psf_sampling.py [--bands NUV g]

Truth is the optics integrated over 10 um pixels with the star at 16 positions in a pixel. A set with 2 or 4 cells per
pixel is summed to pixel integrals on its lattice and interpolated to the same positions by GalSim's quintic (as
render/imaging/reference.py does) or by a cubic or quintic B-spline. Moments are weighted with a Gaussian of 3 px.
"bias" is the mean over the positions in a pixel, "worst" the largest of them, at the worse of two field points. Goals:
flux 1e-3, centroid 1 mas, size^2 1e-3, ellipticity 1e-4.
"""

import argparse

from evidence.record import Record

import galsim
import numpy as np
from scipy.ndimage import map_coordinates

from csstsim.base.shipped import SHIPPED
from csstsim.instrument.camera import Camera, load_camera
from csstsim.optics.psf.chip_errors import chip_coefficients
from csstsim.optics.psf.psf_file import pixel_response
from csstsim.optics.psf.psf_set import chip_optics
from csstsim.optics.psf.wavefront import load_wavefront
from csstsim.render.imaging.reference import GSPARAMS, PSF_MAXK
from csstsim.studies.bench.imaging.measures import moments

BOX = 64  # px, of truth and tables
HALF = 24  # px: the stamp is 49 x 49
STEPS = (np.arange(4) + 0.5) / 4 - 0.5 + 0.03  # positions in a pixel, px; not on its symmetry axes
TOY_STEPS = STEPS[:2]
PLACES = (4607.5, 4615.5), (0.0, 9231.0)  # on a chip, px
FLUX, CENTROID, E, SIZE, PIXEL = [0], [1, 2], [3, 4], [5], [6]  # of a row of `measure`
GOALS = {"flux": (FLUX, 1e-3, ""), "centroid": (CENTROID, 1.0, "mas"), "size^2": (SIZE, 1e-3, ""), "e": (E, 1e-4, "")}


def quintic(response, step, x, y):
    """Return a star's stamp as render/imaging/reference.py draws it."""
    image = galsim.ImageD(2 * HALF + 1, 2 * HALF + 1)
    profile = galsim.InterpolatedImage(
        galsim.ImageD(response), scale=step, normalization="sb", x_interpolant="quintic",
        gsparams=galsim.GSParams(**GSPARAMS),
        _force_maxk=PSF_MAXK, _force_stepk=2 * np.pi / (response.shape[0] * step),
    )  # fmt: skip
    profile.drawImage(image, scale=1.0, method="no_pixel", center=image.true_center + galsim.PositionD(x, y))
    return image.array


def spline(order):
    """Return a reader like `quintic`: the B-spline of this order through the lattice."""

    def read(response, step, x, y):
        axis, middle = np.arange(-HALF, HALF + 1), (response.shape[0] - 1) / 2
        at = np.meshgrid(middle + (axis - y) / step, middle + (axis - x) / step, indexing="ij")
        return map_coordinates(response, at, order=order, mode="constant")

    return read


READERS = {"quintic": quintic, "B-spline 3": spline(3), "B-spline 5": spline(5)}


def mean_image(optics, kernel, coefficients, centre=(0.0, 0.0)):
    """Return the image of one field point, mean of the wavelengths."""
    return np.mean([o.image(o.transfer(coefficients), kernel, centre) for o in optics], axis=0)


def power(number: float, digits: int = 0) -> str:
    """Return a small number as a page shows it: 6e-4."""
    mantissa, exponent = f"{number:.{digits}e}".split("e")
    return f"{mantissa}e{int(exponent)}"


def measure(camera, name, steps=STEPS):
    """Return {(cells per pixel, reader): (2, n, 7)}: field points, positions, errors of moments and worst pixel."""
    wavefront, filter_ = load_wavefront(camera.psf), camera.filters[name]
    chip = next(c for c in camera.chips.values() if c.filter == name)
    sets = {m: chip_optics(chip, filter_, camera.psf, wavefront, m, BOX * m) for m in (1, 2, 4)}
    cut = slice(BOX // 2 - HALF, BOX // 2 + HALF + 1)
    rows = {(m, reader): [] for m in (2, 4) for reader in READERS}
    for place in PLACES:
        coefficients = chip_coefficients(wavefront, camera.psf, chip, *place)
        response = {m: pixel_response(mean_image(*sets[m], coefficients), m) for m in (2, 4)}
        for x, y in np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2):
            # The middle of an even box is the corner of four pixels; the stamp is centred on one of them
            truth = mean_image(*sets[1], coefficients, (-0.5 - x, -0.5 - y))[cut, cut]
            wanted = moments(truth).value
            for (m, reader), into in rows.items():
                got = READERS[reader](response[m], 1 / m, x, y)
                difference = moments(got).value - wanted
                difference[[0, 5]] /= wanted[[0, 5]]
                difference[1:3] *= 1000 * camera.telescope.pixel_scale
                into.append([*difference, np.abs(got - truth).max() / truth.max()])
    return {key: np.array(value).reshape(len(PLACES), steps.size**2, 7) for key, value in rows.items()}


def report(camera: Camera, bands: list[str], record: Record) -> None:
    """Record the errors of each band, number of cells and reader."""
    readers = [(m, reader) for m in (2, 4) for reader in READERS]
    single, mean, cells = [], [], {(quantity, *reader): [] for quantity in GOALS for reader in readers}
    for name in bands:
        found = measure(camera, name, TOY_STEPS if record.toy else STEPS)
        texts: tuple[list[str], list[str]] = [], []
        for reader in readers:
            bias = np.abs(found[reader].mean(axis=1)).max(axis=0)
            worst = np.abs(found[reader]).max(axis=(0, 1))
            for text, errors in zip(texts, (worst, bias), strict=True):
                text.append(f"{power(errors[SIZE].max())}, {power(errors[E].max(), 1)}, {power(errors[PIXEL].max())}")
            for quantity, (part, _, _) in GOALS.items():
                cells[quantity, *reader].append((bias[part].max(), worst[part].max()))
        single.append([name, *texts[0]])
        mean.append([name, *(text.rsplit(",", 1)[0] for text in texts[1])])
    header = ["band", *(f"{m} cells, {reader}" for m, reader in readers)]
    record.table("single", [f"{header[0]}: size^2, e, pixel / peak", *header[1:]], single)
    record.table("bias", [f"{header[0]}: size^2, e", *header[1:]], mean)
    for quantity, (_, goal, unit) in GOALS.items():
        bias, worst = np.max([np.max(cells[quantity, *reader], axis=0) for reader in readers], axis=0)
        key = quantity.replace("^", "")
        limit = {"below": goal} if quantity in ("flux", "centroid") else {}
        record.value(f"{key}_worst", worst, f"error of {quantity} at one position, all readers", unit=unit, **limit)
        record.value(f"{key}_bias", bias, f"error of {quantity}, mean of positions, all readers", unit=unit, below=goal)
    quintics = max(bias for m in (2, 4) for reader in list(READERS)[::2] for bias, _ in cells["e", m, reader])
    record.value("e_bias_quintics", quintics, "error of e, mean of positions, both quintics")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--instrument", default=SHIPPED / "instrument", help="folder of the camera's data files")
    parser.add_argument("--bands", nargs="*", help="default: all")
    with Record(parser) as record:
        camera = load_camera(record.options.instrument)
        report(camera, record.options.bands or list(camera.filters)[: 1 if record.toy else None], record)
