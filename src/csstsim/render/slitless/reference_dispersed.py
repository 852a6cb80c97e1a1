"""The reference renderer for dispersed light: GalSim, one object and order at a time (paper, section 4.2).

A spectrum is the sum of monochromatic images of the object (profile convolved with the PSF at its position), each at
the exact position of its bin,

    sum over bins of  light  x  ((1 - u) O_k + u O_k+1)(x - p - q lambda, y - r - s lambda),

with O_k the image at the k-th wavelength of the PSF set and u from optics.gratings.dispersion. For GalSim this is one
convolution of O_k with a sum of shifted delta functions and with a box as long as a bin, over which the bin's light is
uniform. There are no sub-pixel phases and no slabs. The only interpolation is GalSim's, of the PSF or of O_k on a
lattice of a quarter of a pixel: galaxies of up to LATTICE px are rendered on the lattice first, because otherwise each
transform would be as large as that of the galaxy alone. The trace is rendered in blocks of _BLOCK px. Profiles,
accuracy and pixel response are those of render.imaging.reference. At the edge of a grating's piece O_k is cut, by the
fraction of each pixel. Wings: render.slitless.line_wings. Left out: ghosts of dispersed light.
"""

from __future__ import annotations

import time
from dataclasses import replace
from functools import cache, partial
from typing import TYPE_CHECKING

import galsim
import numpy as np

from csstsim.base.process.progress import progress
from csstsim.catalog.flags import TOO_LARGE, TRUNCATED_STAMP
from csstsim.render.canvas import Canvas, around
from csstsim.render.far_wings import WHOLE, Side
from csstsim.render.imaging.reference import REACH_FFT, Galaxies, convolved, fill, lattice, point
from csstsim.render.imaging.stamper import Stamper
from csstsim.render.policy import Choice
from csstsim.render.slitless.draw_dispersed import DispersedJob, tables_of
from csstsim.render.slitless.line_wings import add_line, order_wing, points_of
from csstsim.render.slitless.methods.slabs import SLABS
from csstsim.render.slitless.slabs import meets
from csstsim.render.slitless.subpixel_stamps import inside, light_inside
from csstsim.render.slitless.traces import Traces
from csstsim.render.wings import Wings

if TYPE_CHECKING:
    from collections.abc import Callable

    from csstsim.base.types import FloatArray, IntArray
    from csstsim.catalog.table import ObjectTable
    from csstsim.optics.gratings.dispersion import Disperser
    from csstsim.render.canvas import Box
    from csstsim.render.drawing import Drawing
    from csstsim.render.scene import Scene

_REFERENCE = replace(SLABS, name="reference")  # the truth table gives what it gives of slabs
_BLOCK = 32  # px of the trace rendered together
LATTICE = 128  # px: half the side of the largest uncut image that is rendered on the lattice first
_FINE = 4  # points of the lattice to a pixel
_THIN = 1e-3  # px: width of the box across the trace


def draw_objects(
    canvas: Canvas,
    objects: ObjectTable,
    spectra: Callable[[IntArray, FloatArray], FloatArray],
    disperser: Disperser,
    drawing: Drawing,
) -> tuple[ObjectTable, ObjectTable]:
    """Draw the objects of a spectroscopic chip on a Canvas; return (table of objects, table of orders).

    Arguments and tables are those of render.slitless.draw_dispersed. snr and error of the table are NaN: the reference
    renderer does not compute them.
    """
    job = DispersedJob(objects, disperser, drawing)
    scene = job.scene
    result = job.result
    wing = drawing.wing
    psf = drawing.psf
    assert scene.reach is not None and scene.wing is not None  # select gives them
    part = objects.take(job.rows[: job.count])
    job.out.flags[job.rows[scene.reach > REACH_FFT]] |= TRUNCATED_STAMP
    stamper = Stamper.of(drawing.mixer, replace(scene, reach=np.minimum(scene.reach, REACH_FFT)), drawing.scattered)
    galaxies = Galaxies(part, drawing.wcs, scene)
    reach = stamper.reach
    half = drawing.mixer.half
    assert canvas.expected is not None
    expected = np.zeros(canvas.window.shape)
    plane = Canvas(expected, canvas.window, canvas.response)
    wings = Wings(plane, wing, half)
    lines = disperser.lines(job.visits, scene.x, scene.y)
    for v in progress(range(len(job.visits)), "drawing objects"):
        start = time.process_time()
        i, piece, cut = job.visits[v].tolist()
        light = spectra(job.rows[i : i + 1], disperser.edges) * drawing.exptime
        light = light if scene.fraction_of_parent is None else light * scene.fraction_of_parent[i]
        traces = Traces(light, np.array([[0, piece, cut]]), disperser)
        result.nominal(np.array([v]), traces.visits, light, disperser.rates)
        nodes = sum(w * psf.node(n) for n, w in zip(scene.node[i], scene.weight[i], strict=True))
        nodes = nodes if stamper.core is None else nodes * stamper.core
        inside_stamp = light_inside(stamper, i)
        one = scene.take(np.array([i]))
        side = traces.side(one, 0)
        profiles = _profiles(partial(galaxies.profile, i), nodes, psf.oversampling, reach[i], side)
        for o, line in enumerate(lines[v]):
            trace = _Trace(traces, one, o, line)
            fraction = trace.light.sum() / scene.electrons[i].sum() if wing is not None else 0.0
            shown = order_wing(scene.wing[i], fraction, half)
            parts, flag = _draw_order(plane, profiles, trace, reach[i])
            if drawing.scattered is not None and trace.light.sum() > 0 and (parts or shown > 0):
                points = points_of(trace.x, trace.y, trace.light * disperser.psf_weights)
                parts.append(add_line(wings, points, inside_stamp, shown, stamper.parts(i), side))
            job.out.flags[job.rows[i]] |= flag
            result.drawn[v, o] = sum(electrons for electrons, _ in parts)
            result.box[v, o] = around([box for _, box in parts if box is not None])
        result.ms[v] = 1000 * (time.process_time() - start)
    wings.add_to_canvas()
    canvas.expected += expected.astype(np.float32)
    unknown = np.full(len(scene), np.nan, np.float32)
    choice = Choice(np.full(len(scene), _REFERENCE.code, np.int8), unknown, unknown)
    return tables_of(job, choice, canvas.window, [_REFERENCE])


class _Trace:
    """The bins of an order: positions x, y (bins,) [px], light [electron] and length along x [px]."""

    def __init__(self, traces: Traces, scene: Scene, o: int, line: FloatArray) -> None:
        disperser = traces.disperser
        bins = traces.order(scene, 0, o, line)
        self.light = bins.electrons
        self.x = bins.x
        self.y = bins.y
        self.length = abs(line[1]) * (disperser.edges[1] - disperser.edges[0])
        self.weights = disperser.psf_weights * self.light

    def around(self, rows: IntArray, band: int, column: int, row: int) -> galsim.GSObject | None:
        """Return bins `rows` at one wavelength of the PSF set, as delta functions relative to a pixel's centre."""
        lit = rows[self.weights[band, rows] > 0]
        flux = self.weights[band, lit]
        x = self.x[lit] - column
        y = self.y[lit] - row
        points = [galsim.DeltaFunction(flux=f).shift(dx, dy) for f, dx, dy in zip(flux, x, y, strict=True)]
        return galsim.Sum(points) if points else None


def _profiles(
    galaxy: Callable[[float | None], galsim.GSObject | None],
    cells: FloatArray,
    oversampling: int,
    reach: int,
    side: Side,
) -> Callable[[int, float | None], list[galsim.GSObject]]:
    """Return a function of (band, folding): the GSObjects to convolve for the object at one wavelength, of unit flux.

    galaxy: function of folding that returns the profile without the PSF, or None; cells: (4, n, n) of the PSF; side:
    Side of the object, beyond which its light is cut off.
    """

    @cache
    def profile(band: int, folding: float | None) -> list[galsim.GSObject]:
        parts = [point(cells[band], oversampling)]
        shape = galaxy(folding)
        if shape is not None:
            parts.append(shape.withFlux(1.0))
        if side == WHOLE and (len(parts) == 1 or reach > LATTICE):
            return parts
        axis = np.arange(-reach * _FINE, reach * _FINE + 1) / _FINE
        whole = galsim.ImageD(len(axis), len(axis))
        convolved(parts, folding).drawImage(whole, scale=1 / _FINE, method="no_pixel")
        if side != WHOLE:
            whole.array[:] *= inside(axis, side.y0, side.y1)[:, None] * inside(axis, side.x0, side.x1)
        return [lattice(whole, 1 / _FINE, "flux")]

    return profile


def _draw_order(
    plane: Canvas, profiles: Callable[[int, float | None], list[galsim.GSObject]], trace: _Trace, reach: int
) -> tuple[list[tuple[float, Box | None]], int]:
    """Add an order to a Canvas; return ([(electrons, box on the chip)], flags)."""
    assert plane.expected is not None
    parts: list[tuple[float, Box | None]] = []
    flags = 0
    window = plane.window
    bins = np.flatnonzero(trace.light > 0)
    block = np.floor(trace.x[bins] / _BLOCK).astype(int)
    for b in np.unique(block):
        rows = bins[block == b]
        x = trace.x[rows]
        y = trace.y[rows]
        if not meets(x, y, reach + 1, window):
            continue
        first = round(x.min()) - reach
        last = round(x.max()) + reach
        bottom = round(y.min()) - reach
        top = round(y.max()) + reach
        stamp = galsim.ImageD(galsim.BoundsI(first, last, bottom, top))
        column = (first + last) // 2
        row = (bottom + top) // 2
        spots = [trace.around(rows, band, column, row) for band in range(4)]
        flags |= fill(stamp, partial(_spread, profiles, spots, trace.length), column, row)
        if flags & TOO_LARGE:
            break
        x0 = max(first, window.x0)
        x1 = min(last + 1, window.x1)
        y0 = max(bottom, window.y0)
        y1 = min(top + 1, window.y1)
        if x0 < x1 and y0 < y1:
            at = plane.cut((x0, x1, y0, y1))
            counted = stamp.array[y0 - bottom : y1 - bottom, x0 - first : x1 - first] * plane.response_array[at]
            plane.expected[at] += counted
            parts.append((counted.sum(), (x0, x1, y0, y1)))
    return parts, flags


def _spread(
    profiles: Callable[[int, float | None], list[galsim.GSObject]],
    spots: list[galsim.GSObject | None],
    length: float,
    folding: float | None = None,
) -> galsim.GSObject:
    """Return the GSObject of part of a spectrum, summed over PSF wavelengths, each bin uniform over its length."""
    even = galsim.Box(length, _THIN)
    lit = [band for band in range(4) if spots[band] is not None]
    return galsim.Sum([convolved([*profiles(band, folding), spots[band], even], folding) for band in lit])
