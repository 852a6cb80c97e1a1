"""The reference renderer: GalSim, one object at a time, as the paper describes (sections 4.1, 5.3).

Each object is its profile (disk and bulge, or a point) convolved with the PSF interpolated to its position, in four
sub-bands. Differences from the paper (by design):
- r_e is the half-light radius, so GalSim's own DeVaucouleurs and Exponential are used;
- both components share one SED, so the four sub-band PSFs are summed by flux weight before the one
  convolution: the same image as four draws added, by linearity;
- the stamp is bounded by the scene's noise (catalog.selection.select, `reach`), not by folding_threshold = 5e-8;
- shapes go through full 2 x 2 matrices: intrinsic shear, lensing, then d(pixel)/d(sky);
- a stored PSF sample is the integral over a cell, 2 or 4 to the side of a pixel. Sums of cells are exact integrals over
  a pixel, so objects are rendered with GalSim's `no_pixel` on that pixel-integrated PSF.
render.wings adds the light that a stamp does not hold: beyond the box of the stored PSF the wing, rendered pixel by
pixel as far as it exceeds the noise, and at least to NEAR px.
All light goes to the plane of expected electrons; Poisson noise is added once, in `poisson_and_dark`.
"""

from __future__ import annotations

import math
import time
from functools import partial
from typing import TYPE_CHECKING

import galsim
import numpy as np

from csstsim.base.process.progress import progress
from csstsim.catalog.flags import FFT_REDUCED, NEGATIVE_CLIPPED, OFF_CHIP, TOO_LARGE, TRUNCATED_STAMP
from csstsim.catalog.galaxy_shapes.components import components
from csstsim.catalog.profiles.sersic import BULGE, DISK
from csstsim.catalog.table import GALAXY
from csstsim.optics.psf.psf_file import pixel_response
from csstsim.render.canvas import Canvas, around
from csstsim.render.drawn_table import DrawnTable
from csstsim.render.extended import parts_at
from csstsim.render.scene import make_scene
from csstsim.render.wings import StampLight, Wings, add_ghosts, box_on_window, core_fraction

if TYPE_CHECKING:
    from collections.abc import Callable

    from csstsim.base.types import FloatArray, IntArray
    from csstsim.catalog.table import ObjectTable
    from csstsim.optics.geometry.wcs import ChipWCS
    from csstsim.optics.psf.psf_file import PsfSet
    from csstsim.render.drawing import Drawing
    from csstsim.render.scene import Scene

galsim.errors.raise_fft_size_error = True  # otherwise GalSim 2.8 only warns and then uses all memory

# Interpolation and truncation errors well below the accuracy goals (flux 1e-3, ellipticity 1e-4).
GSPARAMS = {"maxk_threshold": 1e-4, "kvalue_accuracy": 1e-6, "xvalue_accuracy": 1e-6, "maximum_fft_size": 4096}
# Fraction of light that may alias: the fraction the stamp may lose, within these limits (GalSim's default is 5e-3) ...
FOLDING_MIN = 1e-4
FOLDING_MAX = 5e-3
# ... and, for objects whose FFT would be too large, these in turn, with a flag.
FOLDING_LOOSE = (5e-3, 5e-2, 0.3)
FFT_LOOSE = 8192
NEAR = 512.0  # px
REACH_FFT = 1000  # px: half the largest stamp, so that its FFT (half-pixel steps) fits the maximum
NEGATIVE_LIMIT = 1e-4  # fraction of an object's light in negative pixels above which clipping is flagged
SIZE_MIN = 1e-5  # arcsec, half-light radius: a smaller galaxy is a point, and GalSim would render nothing
# Above 1 cycle per pixel, jitter, diffusion and the pixel leave less than 1e-4 of any PSF, for any lattice.
PSF_MAXK = 2 * np.pi


def draw_objects(canvas: Canvas, objects: ObjectTable, drawing: Drawing) -> ObjectTable:
    """Draw the objects of an imaging chip on a Canvas; return the table with what was rendered (render.drawn_table).

    objects: ObjectTable from catalog.selection.select; drawing: render.drawing.Drawing. snr and error of the table are
    NaN: the reference renderer does not compute them.
    """
    psf = drawing.psf
    window = canvas.window
    wing = drawing.wing
    ghosts = drawing.ghosts
    flux = np.stack([objects[f"flux{i}"] for i in range(4)], axis=1) * drawing.exptime
    out = DrawnTable(objects, flux.sum(axis=1))
    scene = make_scene(objects.take(out.rows), drawing.wcs, psf, drawing.exptime)
    galaxies = Galaxies(objects.take(out.rows), drawing.wcs, scene)
    out.flag_optics(scene.outside[: len(out.rows)], wing)
    of_row = out.rows if scene.parent is None else out.rows[scene.parent]
    out.snr[:] = out.error[:] = np.nan
    half = psf.image.shape[-1] / 2 / psf.oversampling
    smallest = 0 if drawing.scattered is None else math.ceil(half)  # a stamp holds all of the box
    wing_px = objects["wing"] if wing is not None else np.zeros(len(objects))
    out.note_sides(slice(None), np.clip(objects["reach"], smallest, REACH_FFT), wing_px)
    core = core_fraction(psf.image.shape[-1], psf.oversampling) if wing is not None else 1.0
    image = galsim.ImageD(np.zeros(window.shape), xmin=window.x0, ymin=window.y0)
    plane = Canvas(image.array, window, canvas.response)
    wings = Wings(plane, wing, half)
    assert canvas.expected is not None
    for k, i in enumerate(progress(of_row, "drawing objects")):
        start = time.process_time()
        light = scene.electrons[k]
        if not light.any():
            continue
        cells = _cells(psf, scene.node[k], scene.weight[k], light) * core
        at = (scene.x[k], scene.y[k])
        reach = min(max(int(objects["reach"][i]), smallest), REACH_FFT)
        stamp, flag = _draw(partial(galaxies.seen, k, cells, psf.oversampling), *at, reach)
        flag |= TRUNCATED_STAMP if objects["reach"][i] > REACH_FFT else 0
        seen = galsim.BoundsI() if flag & TOO_LARGE else stamp.bounds & image.bounds
        parts = []
        if seen.isDefined():
            box = seen.xmin, seen.xmax + 1, seen.ymin, seen.ymax + 1
            counted = stamp[seen].array * plane.response_array[plane.cut(box)]
            image[seen].array[:] += counted
            parts.append((counted.sum(), box))
        if not flag & TOO_LARGE:
            shown = box_on_window(window, *at, wing_px[i]) if wing_px[i] > 0 else None
            parts += [(0.0, shown)] if shown else []
            if ghosts is not None:
                parts += add_ghosts(plane, drawing.wcs.chip, at, light.sum(), ghosts)
            out.drawn[i] += sum(electrons for electrons, _ in parts)
            if parts and drawing.scattered is not None:
                inside = StampLight(cells.sum(), stamp.array.sum(), reach)
                near = max(float(wing_px[i]), NEAR)
                out.drawn[i] += wings.add(at, light, inside, wing_px[i], parts_at(scene, k), near)
        missed = not (parts or flag & TOO_LARGE) and k < len(out.rows)
        out.flags[i] |= flag | (OFF_CHIP if missed else 0)
        if parts:
            before = [tuple(out.box[i])] if out.box[i, 1] > 0 else []
            out.box[i] = around([*before, *(bounds for _, bounds in parts)])
            out.method[i] = "reference"
        out.ms[i] += 1000 * (time.process_time() - start)
    wings.add_to_canvas()
    canvas.expected += image.array.astype(np.float32)
    return out.table()


def _cells(psf: PsfSet, nodes: IntArray, weights: FloatArray, flux: FloatArray) -> FloatArray:
    """Return the PSF's cells in electrons: the sum over nodes and sub-bands."""
    return sum(w * np.tensordot(flux, psf.node(n), axes=1) for n, w in zip(nodes, weights, strict=True))


def point(mixture: FloatArray, oversampling: int) -> galsim.GSObject:
    """Return the GSObject in pixels, pixel response included, of a point with PSF cells `mixture` (n, n)."""
    # A sample is the light that falls in a pixel centred there: a surface brightness per pixel area.
    return lattice(galsim.ImageD(pixel_response(mixture, oversampling)), 1 / oversampling, "sb")


def lattice(image: galsim.Image, step: float, normalization: str) -> galsim.GSObject:
    """Return the GSObject of an image sampled every `step` px, pixel response included."""
    return galsim.InterpolatedImage(
        image,
        scale=step,
        normalization=normalization,
        x_interpolant="quintic",
        gsparams=galsim.GSParams(**GSPARAMS),
        # Known values, which GalSim would otherwise search for
        _force_maxk=PSF_MAXK,
        _force_stepk=2 * np.pi / (image.array.shape[0] * step),
    )


def convolved(parts: list[galsim.GSObject], folding: float | None = None) -> galsim.GSObject:
    """Return the convolution of GSObjects; a `folding` that is not None allows a larger transform than usual."""
    limit = {"maximum_fft_size": FFT_LOOSE} if folding else {}
    return galsim.Convolve(parts, gsparams=galsim.GSParams(**(GSPARAMS | limit)), propagate_gsparams=False)


class Galaxies:
    """Profiles of the rows of a Scene in pixels: intrinsic shape, lensing and local WCS as matrices."""

    def __init__(self, objects: ObjectTable, wcs: ChipWCS, scene: Scene) -> None:
        """objects: the ObjectTable of which the Scene was made; disks and bulges are made of its columns."""
        # Shapes refer to east and north at the catalogue position. Aberration does not rotate them, but near a pole
        # east at the apparent position, up to 26" away, is another direction.
        self._jacobian = wcs.jacobian(objects["ra_orig"], objects["dec_orig"], seen=(objects["ra"], objects["dec"]))
        self._objects = objects
        self._parts = components(objects)
        self._scene = scene
        self._extended = (objects["obj_type"] == GALAXY)[slice(None) if scene.parent is None else scene.parent]

    def seen(self, i: int, cells: FloatArray, oversampling: int, folding: float | None = None) -> galsim.GSObject:
        """Return the GSObject of object i, pixel response included; `cells` (n, n) is its PSF in electrons.

        `folding`: larger folding_threshold for the galaxy's profile, which makes the FFT smaller.
        """
        star = point(cells, oversampling)
        profile = self.profile(i, folding)
        return star if profile is None else convolved([profile.withFlux(1.0), star], folding)

    def profile(self, i: int, folding: float | None) -> galsim.GSObject | None:
        """Return the GSObject of galaxy i without the PSF, of light 1; None for a point."""
        if not self._extended[i]:
            return None
        if self._scene.spot is not None and self._scene.spot[i] >= 0:
            return _spots(self._scene, i)
        names = "e1", "e2", "lost", "kappa", "gamma1", "gamma2"
        row = {name: float(self._objects[name][i]) for name in names}
        kappa = row["kappa"]
        gamma1 = row["gamma1"]
        gamma2 = row["gamma2"]
        parts = []
        for light, (_, index, size) in zip(self._scene.component_fractions.T, self._parts, strict=True):
            if light[i] > 0:
                budget = folding or min(max(row["lost"] / light[i], FOLDING_MIN), FOLDING_MAX)
                gsparams = galsim.GSParams(**GSPARAMS, folding_threshold=budget)
                how = {"half_light_radius": max(size[i], SIZE_MIN), "flux": light[i], "gsparams": gsparams}
                n = float(index[i]) if isinstance(index, np.ndarray) else index
                kind = {DISK: galsim.Exponential, BULGE: galsim.DeVaucouleurs}.get(n)
                parts.append(kind(**how) if kind else galsim.Sersic(n, **how))
        profile = parts[0] if len(parts) == 1 else galsim.Add(parts, propagate_gsparams=False)
        mu = 1.0 / ((1 - kappa) ** 2 - gamma1**2 - gamma2**2)
        profile = profile.shear(g1=row["e1"], g2=row["e2"]).lens(gamma1 / (1 - kappa), gamma2 / (1 - kappa), mu)
        return profile.transform(*self._jacobian[i].ravel())


def _spots(scene: Scene, i: int) -> galsim.GSObject:
    """Return the GSObject, light 1, of knots or an image: points, or a lattice of boxes convolved with two more."""
    assert scene.spots is not None and scene.spot is not None
    image = scene.spots.image(scene.spot[i])
    gsparams = galsim.GSParams(**GSPARAMS)
    if image is None:
        points = zip(*scene.spots.group(scene.spot[i]), strict=True)
        profile = galsim.Sum([galsim.DeltaFunction(flux=light).shift(u, v) for u, v, light in points])
    else:
        boxes = galsim.InterpolatedImage(
            galsim.ImageD(np.ascontiguousarray(image)),
            scale=1.0,
            x_interpolant="nearest",
            normalization="flux",
            gsparams=gsparams,
        )
        pixel = galsim.Pixel(1.0, gsparams=gsparams)
        profile = galsim.Convolve([boxes, pixel, pixel], gsparams=gsparams, propagate_gsparams=False)
    return profile.transform(*scene.matrix[i].ravel())


def _draw(profile: Callable[..., galsim.GSObject], x: float, y: float, reach: int) -> tuple[galsim.Image, int]:
    """Return the stamp of `profile(folding=...)` centred on pixel position x, y, and flags.

    The whole stamp is rendered, also the part beyond the chip: GalSim's FFT box is centred on the image, so light
    would wrap round if the image were only the visible part.
    """
    column = round(x)
    row = round(y)
    image = galsim.ImageD(galsim.BoundsI(column - reach, column + reach, row - reach, row + reach))
    return image, fill(image, profile, x, y)


def fill(image: galsim.Image, profile: Callable[..., galsim.GSObject], x: float, y: float) -> int:
    """Fill a GalSim image with `profile(folding=...)`, its origin at pixel position x, y; return flags."""
    for folding, flag in ((None, 0), *((f, FFT_REDUCED) for f in FOLDING_LOOSE)):
        try:
            profile(folding=folding).drawImage(image, scale=1.0, method="no_pixel", center=galsim.PositionD(x, y))
        except galsim.GalSimFFTSizeError:
            continue
        return flag | clip_negative(image)
    image.setZero()
    return TOO_LARGE


def clip_negative(image: galsim.Image) -> int:
    """Set negative pixels to zero and scale the others to keep the total light; return NEGATIVE_CLIPPED or 0."""
    negative = np.minimum(image.array, 0).sum()
    if negative == 0:
        return 0
    total = image.array.sum()
    np.maximum(image.array, 0, out=image.array)
    positive = image.array.sum()
    image.array[:] *= max(total, 0.0) / positive if positive > 0 else 0.0
    return NEGATIVE_CLIPPED if -negative > NEGATIVE_LIMIT * abs(total) else 0
