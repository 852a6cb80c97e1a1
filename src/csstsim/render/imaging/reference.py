"""The reference renderer: GalSim, one object at a time, as the paper describes (sections 4.1, 5.3).

Each object is its profile (bulge n = 4 + disk n = 1, or a point) convolved with the PSF interpolated to
its position, in four sub-bands. Where the paper's letter is not followed (design):
- r_e is the half-light radius, so GalSim's own DeVaucouleurs and Exponential are used;
- both components share one SED, so the four sub-band PSFs are summed by flux weight before the one
  convolution: the same image as four draws added, by linearity;
- the stamp is bounded by the scene's noise (catalog.selection.select, `reach`), not by folding_threshold = 5e-8;
- shapes go through full 2 x 2 matrices: intrinsic shear, lensing, then d(pixel)/d(sky);
- a stored PSF sample is the integral over a cell, 2 or 4 to the side of a pixel: their sums make the exact integral
  over a pixel, so objects are drawn with GalSim's `no_pixel` on that pixel-integrated PSF.
Light that a stamp does not hold is added by render.wings: beyond the box of the stored PSF the wing, pixel by pixel as
far as it shows, and at least to NEAR px.
All light goes to the expectation plane; Poisson noise comes once, in `poisson_and_dark`.
"""

import math
import time
from functools import partial

import galsim
import numpy as np

from csstsim.base.progress import progress
from csstsim.catalog.flags import (
    BAD_VALUE,
    FFT_REDUCED,
    NEGATIVE_CLIPPED,
    OFF_CHIP,
    OUTSIDE_PSF_HULL,
    STRONG_LENSING,
    TOO_LARGE,
    TRUNCATED_STAMP,
)
from csstsim.catalog.table import GALAXY
from csstsim.optics.psf.psf_file import pixel_response
from csstsim.render.extended import parts_of_table
from csstsim.render.far_wings import FarWings
from csstsim.render.scene import shape_matrix
from csstsim.render.wings import add_far, add_ghosts, box_on_window, box_share

galsim.errors.raise_fft_size_error = True  # GalSim 2.8 only warns, then takes all memory

# Interpolation and truncation errors well below the accuracy goals (flux 1e-3, ellipticity 1e-4).
GSPARAMS = {"maxk_threshold": 1e-4, "kvalue_accuracy": 1e-6, "xvalue_accuracy": 1e-6, "maximum_fft_size": 4096}
# Light that may alias: what the stamp may lose, within these (5e-3 is GalSim's own) ...
FOLDING_MIN, FOLDING_MAX = 1e-4, 5e-3
# ... and, with a flag, for objects whose FFT would not fit, these in turn.
FOLDING_LOOSE = (5e-3, 5e-2, 0.3)
FFT_LOOSE = 8192
NEAR = 512.0  # px
REACH_FFT = 1000  # px: half the largest stamp, so that its FFT (half-pixel steps) fits the maximum
NEGATIVE_LIMIT = 1e-4  # fraction of an object's light in negative pixels above which clipping is flagged
SIZE_MIN = 1e-5  # arcsec, half-light radius: a smaller galaxy is a point, and GalSim would draw nothing
# Beyond 1 cycle a pixel, jitter, diffusion and the pixel leave under 1e-4 of any PSF, however fine its lattice.
PSF_MAXK = 2 * np.pi

_UNDRAWN = BAD_VALUE | STRONG_LENSING


def draw_objects(image, window, objects, wcs, psf, exptime, beyond=None, response=None):
    """Draw a chip's objects into `image` [expected e-] and return the table with what was drawn.

    image: float32 (window.ny, window.nx), changed in place. objects: ObjectTable from catalog.selection.select.
    wcs: optics.geometry.wcs.ChipWCS. psf: optics.psf.psf_set.PsfSet. exptime in s. beyond:
    optics.scatter.outside_box.Beyond, what is drawn outside its stamp; None: nothing. response: (ny, nx) share of the
    light that is counted, or None: all. Added columns: electrons (nominal), drawn (put on the window, float64 sum of
    the float32 pixels' increments), fraction (with ghosts, which come on top, it may exceed 1), method, snr and error
    (NaN: not asked for), stamp, x0 x1 y0 y1 (bounding box on the chip, half-open), ms (CPU).
    """
    count = len(objects)
    flux = np.stack([objects[f"flux{i}"] for i in range(4)], axis=1) * exptime
    electrons = flux.sum(axis=1)
    # Shapes refer to east and north at the catalogue's place. Aberration carries them along unturned; east at the
    # apparent place, up to 26" off, is another direction near a pole.
    jacobian = wcs.jacobian(objects["ra_orig"], objects["dec_orig"], seen=(objects["ra"], objects["dec"]))
    flags = objects["flags"].copy()
    drawable = (flags & _UNDRAWN == 0) & (electrons > 0)
    index, weight, outside = psf.weights(np.where(drawable, objects["x"], 0.0), np.where(drawable, objects["y"], 0.0))
    flags[drawable & outside] |= OUTSIDE_PSF_HULL
    cells, half = psf.image.shape[-1], psf.image.shape[-1] / 2 / psf.oversampling
    wing, ghosts = (None, None) if beyond is None else (beyond.wing, beyond.ghosts)
    wing_px = objects["wing"] if wing is not None else np.zeros(count)
    flags[drawable & (wing_px < objects["wing"])] |= TRUNCATED_STAMP
    least = 0 if beyond is None else math.ceil(half)  # a stamp holds all of the box
    core = box_share(cells, psf.oversampling) if wing is not None else 1.0
    drawn, ms, box = np.zeros(count), np.zeros(count, np.float32), np.zeros((4, count), np.int32)
    method = np.full(count, "none", dtype="U9")
    if response is None:
        response = np.broadcast_to(np.ones((), np.float32), window.shape)
    scene = galsim.ImageD(np.zeros(window.shape), xmin=window.x0, ymin=window.y0)
    far, rows = FarWings(window, response), np.flatnonzero(drawable)
    drawn_rows = objects.take(rows)
    shapes = dict(zip(rows, parts_of_table(drawn_rows, shape_matrix(drawn_rows, wcs)), strict=True))
    for i in progress(range(count), "drawing objects"):
        start = time.process_time()
        if drawable[i]:
            cells_of = sum(
                w * np.tensordot(flux[i], psf.node(n), axes=1) for n, w in zip(index[i], weight[i], strict=True)
            )
            profile = partial(_profile, objects, i, cells_of * core, psf.oversampling, jacobian[i])
            at, reach = (objects["x"][i], objects["y"][i]), min(max(int(objects["reach"][i]), least), REACH_FFT)
            stamp, flag = _draw(profile, *at, reach)
            flag |= TRUNCATED_STAMP if objects["reach"][i] > REACH_FFT else 0
            seen = galsim.BoundsI() if flag & TOO_LARGE else stamp.bounds & scene.bounds
            parts = []
            if seen.isDefined():
                x0, x1, y0, y1 = seen.xmin, seen.xmax + 1, seen.ymin, seen.ymax + 1
                counted = stamp[seen].array * response[y0 - window.y0 : y1 - window.y0, x0 - window.x0 : x1 - window.x0]
                scene[seen].array[:] += counted
                parts.append((counted.sum(), (x0, x1, y0, y1)))
            if not flag & TOO_LARGE:
                shown = box_on_window(window, *at, wing_px[i]) if wing_px[i] > 0 else None
                parts += [(0.0, shown)] if shown else []
                if ghosts is not None:
                    parts += add_ghosts(scene.array, response, window, wcs.chip, *at, electrons[i], ghosts)
                drawn[i] = sum(light for light, _ in parts)
                if parts and beyond is not None:
                    drawn[i] += add_far(
                        scene.array, response, window, *at, flux[i], (cells_of * core).sum(), stamp.array.sum(), wing,
                        wing_px[i], half, far, near=max(float(wing_px[i]), NEAR), parts=shapes[i], reach=reach,
                    )  # fmt: skip
            flags[i] |= flag | (0 if parts or flag & TOO_LARGE else OFF_CHIP)
            if parts:
                x0, x1, y0, y1 = np.transpose([bounds for _, bounds in parts])
                box[:, i] = x0.min(), x1.max(), y0.min(), y1.max()
                method[i] = "reference"
        ms[i] = 1000 * (time.process_time() - start)
    far.lay(scene.array)
    image += scene.array.astype(np.float32)
    fraction = np.divide(drawn, electrons, out=np.zeros(count), where=electrons > 0)
    return objects.with_columns(
        flags=flags, electrons=electrons, drawn=drawn, fraction=fraction, method=method,
        snr=np.full(count, np.nan, np.float32), error=np.full(count, np.nan, np.float32),
        stamp=2 * np.maximum(np.clip(objects["reach"], least, REACH_FFT), np.ceil(wing_px)).astype(np.int32) + 1,
        x0=box[0], x1=box[1], y0=box[2], y1=box[3], ms=ms,
    )  # fmt: skip


def point(mixture, oversampling):
    """Return the GSObject in pixels, pixel response included, of a point whose PSF's cells (n, n) are `mixture`."""
    # A sample is the light that falls in a pixel centred there: surface brightness per pixel, in pixel units.
    return lattice(galsim.ImageD(pixel_response(mixture, oversampling)), 1 / oversampling, "sb")


def lattice(image, step, normalization):
    """Return the GSObject of an image, pixel response included, known every `step` px."""
    return galsim.InterpolatedImage(
        image,
        scale=step,
        normalization=normalization,
        x_interpolant="quintic",
        gsparams=galsim.GSParams(**GSPARAMS),
        # Known, so that GalSim need not search
        _force_maxk=PSF_MAXK,
        _force_stepk=2 * np.pi / (image.array.shape[0] * step),
    )


def convolved(parts, folding=None):
    """Return the GSObjects convolved; `folding` not None: with a larger transform than usual."""
    limit = {"maximum_fft_size": FFT_LOOSE} if folding else {}
    return galsim.Convolve(parts, gsparams=galsim.GSParams(**(GSPARAMS | limit)), propagate_gsparams=False)


def _profile(objects, i, mixture, oversampling, jacobian, folding=None):
    """Return the GSObject of one object in pixels, pixel response included; `mixture` is its PSF in electrons.

    `folding` loosens what the galaxy's own profile asks of the FFT.
    """
    star = point(mixture, oversampling)
    if objects["obj_type"][i] != GALAXY:
        return star
    return convolved([galaxy_profile(objects, i, jacobian, folding).withFlux(1.0), star], folding)


def galaxy_profile(objects, i, jacobian, folding):
    """Return the galaxy's profile in pixels: intrinsic shape, lensing and local WCS as matrices."""
    share, e1, e2, lost = (float(objects[key][i]) for key in ("bulge_frac", "e1", "e2", "lost"))
    kappa, gamma1, gamma2 = (float(objects[key][i]) for key in ("kappa", "gamma1", "gamma2"))
    parts = []
    for kind, size, flux in ((galsim.Exponential, "size_disk", 1 - share), (galsim.DeVaucouleurs, "size_bulge", share)):
        if flux > 0:
            budget = folding or min(max(lost / flux, FOLDING_MIN), FOLDING_MAX)
            gsparams = galsim.GSParams(**GSPARAMS, folding_threshold=budget)
            parts.append(kind(half_light_radius=max(float(objects[size][i]), SIZE_MIN), flux=flux, gsparams=gsparams))
    profile = parts[0] if len(parts) == 1 else galsim.Add(parts, propagate_gsparams=False)
    mu = 1.0 / ((1 - kappa) ** 2 - gamma1**2 - gamma2**2)
    profile = profile.shear(g1=e1, g2=e2).lens(gamma1 / (1 - kappa), gamma2 / (1 - kappa), mu)
    return profile.transform(*jacobian.ravel())


def _draw(profile, x, y, reach):
    """Return the stamp of `profile(folding=...)` centred on pixel position x, y, and flags.

    The whole stamp is drawn, also where the chip ends: GalSim's FFT box is centred on the image, so light
    would wrap round if the image were the visible part only.
    """
    column, row = round(x), round(y)
    image = galsim.ImageD(galsim.BoundsI(column - reach, column + reach, row - reach, row + reach))
    return image, fill(image, profile, x, y)


def fill(image, profile, x, y):
    """Fill a GalSim image with `profile(folding=...)`, its origin at pixel position x, y; return flags."""
    for folding, flag in ((None, 0), *((f, FFT_REDUCED) for f in FOLDING_LOOSE)):
        try:
            profile(folding=folding).drawImage(image, scale=1.0, method="no_pixel", center=galsim.PositionD(x, y))
        except galsim.GalSimFFTSizeError:
            continue
        return flag | clip_negative(image)
    image.setZero()
    return TOO_LARGE


def clip_negative(image):
    """Set the ripples below zero to zero and take their sum from the rest, so that the light stays the same."""
    negative = np.minimum(image.array, 0).sum()
    if negative == 0:
        return 0
    total = image.array.sum()
    np.maximum(image.array, 0, out=image.array)
    positive = image.array.sum()
    image.array[:] *= max(total, 0.0) / positive if positive > 0 else 0.0
    return NEGATIVE_CLIPPED if -negative > NEGATIVE_LIMIT * abs(total) else 0
