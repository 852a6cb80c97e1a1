"""The reference renderer for dispersed light: GalSim, one object and order at a time (paper, section 4.2).

Monochromatic images of the object, its profile convolved with the PSF at its place, stand at the exact place of each
bin of its spectrum,

    sum over bins of  light  x  ((1 - u) O_k + u O_k+1)(x - p - q lambda, y - r - s lambda),

O_k in light of the k-th wavelength of the PSF set and u of optics.gratings.dispersion. To GalSim it is one convolution:
O_k with a sum of shifted delta functions, and with a box as long as a bin, in which its light is even. So there is no
grid of sub-pixel phases, no slab, and the only interpolation is GalSim's of the PSF, or of O_k, on a lattice of a
quarter of a pixel: galaxies of up to LATTICE px are drawn on it first, for their folding would make each transform as
large as that of a galaxy alone. Drawn some pixels of the trace at a time; profiles, accuracy and the pixel are those of
render.imaging.reference. At the edge of a grating's piece O_k is cut, by the share of each pixel. Wings are
render.slitless.line_wings'. Left out: ghosts of dispersed light.
"""

import math
import time
from functools import cache, partial

import galsim
import numpy as np

from csstsim.base.progress import progress
from csstsim.catalog.flags import TOO_LARGE, TRUNCATED_STAMP
from csstsim.catalog.table import GALAXY
from csstsim.render import policy
from csstsim.render.extended import parts_of
from csstsim.render.far_wings import WHOLE, FarWings
from csstsim.render.imaging.galaxy_stamp import plan_galaxies
from csstsim.render.imaging.reference import REACH_FFT, convolved, fill, galaxy_profile, lattice, point
from csstsim.render.psf_mixture import Mixer
from csstsim.render.slitless.draw_dispersed import Work, tables_of
from csstsim.render.slitless.line_wings import add_line, order_wing, points_of
from csstsim.render.slitless.phases import inside, light_inside
from csstsim.render.slitless.slabs import meets

_BLOCK = 32  # px of the trace drawn together
LATTICE = 128  # px: half the side of the largest image that is drawn on the lattice first, if it need not be cut
_FINE = 4  # points of the lattice to a pixel
_THIN = 1e-3  # of a pixel: the width of a spectrum's light across


def draw_objects(image, window, objects, spectra, disperser, wcs, psf, exptime, beyond=None, response=None):
    """Draw a spectroscopic chip's objects into `image` [expected e-]; return (table of objects, table of orders).

    image: float32 (window.ny, window.nx), changed in place; the rest and the tables are
    render.slitless.draw_dispersed's. snr and error of the table are NaN, for they are not asked for.
    """
    if response is None:
        response = np.broadcast_to(np.ones((), np.float32), window.shape)
    work = Work(objects, wcs, psf, exptime, disperser, beyond, window)
    part, scene, result = work.part, work.scene, work.result
    jacobian = wcs.jacobian(part["ra_orig"], part["dec_orig"], seen=(part["ra"], part["dec"]))
    reach = np.minimum(part["reach"].astype(int), REACH_FFT)
    work.flags[work.rows[part["reach"] > REACH_FFT]] |= TRUNCATED_STAMP
    half, mixer = psf.image.shape[-1] / 2 / psf.oversampling, Mixer(psf)
    wing = None if beyond is None else beyond.wing
    core = mixer.core if wing is not None else None
    if beyond is not None and wing is None:  # then a stamp holds all there is of a point
        reach = np.maximum(reach, math.ceil(half))
    plan = plan_galaxies(scene, reach, half, part["obj_type"] == GALAXY)
    plane, far = np.zeros(window.shape), FarWings(window, response)
    lines = disperser.lines(work.visits, scene.x, scene.y)
    for v in progress(range(len(work.visits)), "drawing objects"):
        start = time.process_time()
        i, piece, cut = work.visits[v].tolist()
        light = spectra(work.rows[i : i + 1], disperser.edges) * exptime
        result.nominal(np.array([v]), np.array([[0, piece, cut]]), light, disperser.rates)
        nodes = sum(w * psf.node(n) for n, w in zip(scene.node[i], scene.weight[i], strict=True))
        nodes = nodes if core is None else nodes * core
        held = light_inside(mixer, scene, plan, i, reach[i], core)
        side = disperser.rectangles[piece] - np.repeat([scene.x[i], scene.y[i]], 2) if cut else None
        profiles = _profiles(part, i, jacobian[i], nodes, psf.oversampling, reach[i], side)
        for o, line in enumerate(lines[v]):
            of_order = light[0] * disperser.rates[piece, o]
            share = of_order.sum() / scene.electrons[i].sum() if wing is not None else 0.0
            shown = order_wing(work.wing[i], share, half)
            trace = _Trace(scene.x[i], scene.y[i], line, of_order, disperser)
            parts, flag = _draw_order(plane, response, window, profiles, trace, reach[i])
            if beyond is not None and of_order.sum() > 0 and (parts or shown > 0):
                points = *points_of(trace.x, trace.y, of_order * disperser.psf_weights), *held
                shape = parts_of(scene.light[i], scene.sersic[i], scene.matrix[i])
                more = wing, shown, half, far, WHOLE if side is None else tuple(side), shape, reach[i]
                parts.append(add_line(plane, response, window, *points, *more))
            work.flags[work.rows[i]] |= flag
            result.drawn[v, o] = sum(electrons for electrons, _ in parts)
            boxes = [box for _, box in parts if box is not None]
            if boxes:
                x0, x1, y0, y1 = np.transpose(boxes)
                result.box[v, o] = x0.min(), x1.max(), y0.min(), y1.max()
        result.ms[v] = 1000 * (time.process_time() - start)
    far.lay(plane)
    image += plane.astype(np.float32)
    unknown = np.full(len(part), np.nan, np.float32)
    choice = policy.Choice(np.full(len(part), policy.STAMP, np.int8), unknown, unknown)
    return tables_of(work, choice, "reference")


class _Trace:
    """Where the bins of an order fall: x, y (bins,) [px], their light [electron] and length along x [px]."""

    def __init__(self, x, y, line, light, disperser):
        p, q, r, s = line
        centres = 0.5 * (disperser.edges[1:] + disperser.edges[:-1])
        self.x, self.y, self.light = x + p + q * centres, y + r + s * centres, light
        self.length = abs(q) * (disperser.edges[1] - disperser.edges[0])
        self.weights = disperser.psf_weights * light

    def around(self, rows, band, column, row):
        """Return bins `rows` in light of one wavelength of the PSF set, as a GSObject about a pixel's centre."""
        lit = rows[self.weights[band, rows] > 0]
        flux, x, y = self.weights[band, lit], self.x[lit] - column, self.y[lit] - row
        points = [galsim.DeltaFunction(flux=f).shift(dx, dy) for f, dx, dy in zip(flux, x, y, strict=True)]
        return galsim.Sum(points) if points else None


def _profiles(objects, i, jacobian, cells, oversampling, reach, side):
    """Return a function of (band, folding): object i in light of a wavelength of the PSF set, of unit flux.

    cells: (4, n, n) of its PSF; side: (x0, x1, y0, y1) px from the object beyond which its light is cut off, or None.
    """

    @cache
    def profile(band, folding):
        parts = [point(cells[band], oversampling)]
        if objects["obj_type"][i] == GALAXY:
            parts.append(galaxy_profile(objects, i, jacobian, folding).withFlux(1.0))
        if side is None and (len(parts) == 1 or reach > LATTICE):
            return parts
        axis = np.arange(-reach * _FINE, reach * _FINE + 1) / _FINE
        whole = galsim.ImageD(len(axis), len(axis))
        convolved(parts, folding).drawImage(whole, scale=1 / _FINE, method="no_pixel")
        if side is not None:
            x0, x1, y0, y1 = side
            whole.array[:] *= inside(axis, y0, y1)[:, None] * inside(axis, x0, x1)
        return [lattice(whole, 1 / _FINE, "flux")]

    return profile


def _draw_order(plane, response, window, profiles, trace, reach):
    """Add an order to `plane`; return ([(electrons, box on the chip)], flags)."""
    parts, flags = [], 0
    bins = np.flatnonzero(trace.light > 0)
    block = np.floor(trace.x[bins] / _BLOCK).astype(int)
    for b in np.unique(block):
        rows = bins[block == b]
        x, y = trace.x[rows], trace.y[rows]
        if not meets(x, y, reach + 1, window):
            continue
        first, last = round(x.min()) - reach, round(x.max()) + reach
        bottom, top = round(y.min()) - reach, round(y.max()) + reach
        stamp = galsim.ImageD(galsim.BoundsI(first, last, bottom, top))
        column, row = (first + last) // 2, (bottom + top) // 2
        spots = [trace.around(rows, band, column, row) for band in range(4)]
        flags |= fill(stamp, partial(_spread, profiles, spots, trace.length), column, row)
        if flags & TOO_LARGE:
            break
        x0, x1 = max(first, window.x0), min(last + 1, window.x1)
        y0, y1 = max(bottom, window.y0), min(top + 1, window.y1)
        if x0 < x1 and y0 < y1:
            at = slice(y0 - window.y0, y1 - window.y0), slice(x0 - window.x0, x1 - window.x0)
            counted = stamp.array[y0 - bottom : y1 - bottom, x0 - first : x1 - first] * response[at]
            plane[at] += counted
            parts.append((counted.sum(), (x0, x1, y0, y1)))
    return parts, flags


def _spread(profiles, spots, length, folding=None):
    """Return the GSObject of part of a spectrum: its places in light of each wavelength, even over a bin's length."""
    even = galsim.Box(length, _THIN)
    lit = [band for band in range(4) if spots[band] is not None]
    return galsim.Sum([convolved([*profiles(band, folding), spots[band], even], folding) for band in lit])
