"""Expected images of spectra: monochromatic slabs, added up along the trace.

An object in light of one wavelength is a stamp (render.point_stamp, render.galaxy_stamp), the mixture of those at the
four wavelengths of the PSF set. Its spectrum's bins are dealt out to slabs `1 / per_px` of a pixel apart along x, each
bin to four of them by the cubic through them, so that light, centroid and width of a line stay. A slab is the stamp of
its sub-pixel phase times its light; mixture of wavelengths and height of the trace are those of the middle of 8 px.
Slabs need not be denser than the image is sharp: `per_px` falls with the object's size (SLABS of them to its half-light
radius). Light beyond the PSF's box is added every 16 px (render.wings). What falls beyond a grating's piece is cut off
the stamps, by the share of each pixel. Left out: ghosts of dispersed light.
"""

import time
from dataclasses import dataclass, replace

import numba
import numpy as np

from csstsim.catalog.flags import FFT_REDUCED, OUTSIDE_PSF_HULL
from csstsim.optics.beyond import Beyond
from csstsim.render.far_wings import FarWings
from csstsim.render.galaxy_stamp import galaxy_stamp, plan_galaxies
from csstsim.render.point_stamp import point_stamp
from csstsim.render.psf_mixture import Mixer
from csstsim.render.wings import LINE_STEP, add_spectrum

NOTHING = Beyond()
PER_PX = 4  # slabs to a pixel of a point's spectrum
SLABS = 8.0  # to the half-light radius of a galaxy
_HEIGHT = 4  # heights of the trace in a pixel between which stamps are interpolated
_BLOCK = 8  # px of the trace that share a mixture of wavelengths and a height
_SIDE = 2  # px that a slab's four neighbours may lie beyond a block


@dataclass(frozen=True)
class Drawn:
    """What was drawn of v visits, order by order; wings are in `drawn`, not in `box`."""

    drawn: np.ndarray  # (v, orders) float64, electrons put on the window
    box: np.ndarray  # (v, orders, 4) int64: x0, x1, y0, y1 of the pixels touched, half-open, on the chip; zeros: none
    flags: np.ndarray  # (v,) int32, catalog.flags
    ms: np.ndarray  # (v,) float32, CPU


def draw_spectra(
    image, window, scene, spectra, visits, reach, wing_px, disperser, psf, beyond=NOTHING, response=None, per_px=PER_PX
):
    """Draw the orders of a Scene's objects into `image` (float32 or float64, window.shape, expected e-); return Drawn.

    spectra: (n, bins) mean densities [photon / s / m2 / angstrom] times the exposure time [s]; visits: of
    Disperser.visits for these objects; reach (n,): px, half the side of each stamp; wing_px (n,): px, reach of the
    light beyond the PSF's box, 0: hidden; psf: PsfSet, or the Mixer of one; per_px: slabs to a pixel, of points.
    """
    mixer, count, orders = psf if isinstance(psf, Mixer) else Mixer(psf), len(visits), len(disperser.orders)
    out = Drawn(
        np.zeros((count, orders)), np.zeros((count, orders, 4), np.int64), np.zeros(count, np.int32),
        np.zeros(count, np.float32),
    )  # fmt: skip
    response = np.broadcast_to(np.ones((), np.float32), window.shape) if response is None else response
    reach = np.asarray(reach, int)
    half = mixer.cells / 2 / mixer.per_pixel
    far, centres = FarWings(window, response), 0.5 * (disperser.edges[1:] + disperser.edges[:-1])
    mixture = np.zeros((4, len(centres)))
    lower, upper = disperser.psf_mixture
    mixture[lower, np.arange(len(lower))], mixture[lower + 1, np.arange(len(lower))] = 1 - upper, upper
    galaxy = ((scene.sersic[:, :, 0] > 0) & (scene.light > 0)).any(axis=1)
    plan = plan_galaxies(scene, reach, half, galaxy)
    wide = np.sqrt((scene.light * scene.sersic[:, :, 2] ** 2).sum(axis=1) * np.abs(np.linalg.det(scene.matrix)))
    for v, (i, piece, cut) in enumerate(visits.tolist()):
        start = time.process_time()
        out.flags[v] = (OUTSIDE_PSF_HULL if scene.outside[i] else 0) | (FFT_REDUCED if plan.rough[i] else 0)
        density = int(np.clip(2.0 ** np.floor(np.log2(SLABS / max(wide[i], 1e-3))), 1, per_px))
        side = disperser.rectangles[piece] - scene.x[i] * _X - scene.y[i] * _Y if cut else None
        core = mixer.core if beyond.wing is not None else None
        one = scene.take(np.array([i]))
        stamps = _Stamps(mixer, one, plan.take(np.array([i])), reach[i], density, core, side)
        lines = disperser.lines(piece, scene.x[i : i + 1], scene.y[i : i + 1])[0]
        for o, (p, q, r, s) in enumerate(lines.tolist()):
            light = spectra[i] * disperser.rates[piece, o]
            if not light.sum() > 0:
                continue
            x, y = scene.x[i] + p + q * centres, scene.y[i] + r + s * centres
            parts = _add_slabs(image, response, window, x, y, light, mixture, stamps)
            if beyond.wing is not None:
                wing = wing_px[i] * np.cbrt(min(light.sum() / scene.electrons[i].sum(), 1.0)) if wing_px[i] > 0 else 0.0
                wing = wing if wing > 1.5 * half else 0.0
                seen = wing > 0 or parts
                if seen:
                    points = _points(x, y, light * mixture)
                    parts += add_spectrum(image, response, window, *points, beyond.wing, wing, half, far)
            out.drawn[v, o] = sum(electrons for electrons, _ in parts)
            boxes = [box for _, box in parts if box is not None]
            if boxes:
                x0, x1, y0, y1 = np.transpose(boxes)
                out.box[v, o] = x0.min(), x1.max(), y0.min(), y1.max()
        out.ms[v] = 1000 * (time.process_time() - start)
    far.lay(image)
    return out


_X, _Y = np.array([1.0, 1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0, 1.0])


class _Stamps:
    """Stamps of one object of light 1 at each wavelength and sub-pixel phase, made when first asked for."""

    def __init__(self, mixer, scene, plan, reach, density, core, side):
        self.mixer, self.scene, self.plan, self.reach, self.density = mixer, scene, plan, int(reach), density
        self._core, self._side, self._made = core, side, {}
        self.galaxy = bool(plan.size[0])

    def get(self, band, column, row):
        """Return (rows, columns) float32: the object `column` / density, `row` / _HEIGHT px from a pixel's centre."""
        key = band, column, row
        if key not in self._made:
            self._made[key] = self._make(band, column / self.density, row / _HEIGHT).astype(np.float32)
        return self._made[key]

    def _make(self, band, x, y):
        bounds = (-self.reach, self.reach + 1) * 2
        share = np.zeros((len(self.scene.node[0]), 4))
        share[:, band] = self.scene.weight[0]
        if self.galaxy:
            there = replace(self.scene, x=np.array([x]), y=np.array([y]))
            stamp = galaxy_stamp(self.mixer, there, self.plan, 0, share, bounds, core=self._core)
            stamp = np.maximum(stamp, 0.0) * (stamp.sum() / max(np.maximum(stamp, 0.0).sum(), 1e-300))
        else:
            stamp = point_stamp(self.mixer, self.scene.node[0], share, x, y, bounds, core=self._core)
        if self._side is not None:
            pixels = np.arange(bounds[0], bounds[1])
            x0, x1, y0, y1 = self._side
            stamp *= _inside(pixels - x, x0, x1) * _inside(pixels - y, y0, y1)[:, None]
        return stamp

    def block(self, weights, height):
        """Return (density, rows, columns) stamps in a mixture of wavelengths at a height [px] above a pixel's centre.

        Rows are one more on each side: the cubic through four heights reaches over pixels.
        """
        size = 2 * self.reach + 1
        out = np.zeros((self.density, size + 2, size), np.float32)
        place = height * _HEIGHT
        first = int(np.floor(place)) - 1
        for k, share in enumerate(_cubic(place - first - 1)):
            pixel, phase = divmod(first + k, _HEIGHT)
            for band in np.flatnonzero(weights):
                factor = np.float32(share * weights[band])
                for column in range(self.density):
                    out[column, 1 + pixel : 1 + pixel + size] += factor * self.get(int(band), column, phase)
        return out


def _inside(places, low, high):
    """Return the share of pixels about `places` that lies within low..high."""
    return np.clip(np.minimum(places + 0.5, high) - np.maximum(places - 0.5, low), 0.0, 1.0)


def _cubic(t):
    """Return the weights of four values, at -1, 0, 1, 2, of the cubic through them at t within 0..1."""
    a, b, c = t + 1, t - 1, t - 2
    return -t * b * c / 6, a * b * c / 2, -a * t * c / 2, a * t * b / 6


def _points(x, y, light):
    """Return ((m, 2) places, (m, 4) light): the spectrum as points at most LINE_STEP apart."""
    which = np.floor((x - x.min()) / LINE_STEP).astype(int)
    total = light.sum(axis=0)
    sums = np.stack([np.bincount(which, band) for band in light], axis=1)
    lit = sums.sum(axis=1)
    used = lit > 0
    places = np.stack([np.bincount(which, total * v)[used] / lit[used] for v in (x, y)], axis=1)
    return places, sums[used]


def _add_slabs(image, response, window, x, y, light, mixture, stamps):
    """Add slabs of light (bins,) at x, y [px], block by block; return [(electrons, box), ...] on the window."""
    reach, density, parts = stamps.reach, stamps.density, []
    lit = np.flatnonzero(light)
    block = np.floor_divide(np.rint(x[lit]).astype(int), _BLOCK)
    reach_x = reach + _SIDE
    for number in np.unique(block).tolist():
        left = number * _BLOCK
        if left + _BLOCK + reach_x < window.x0 or left - reach_x >= window.x1:
            continue
        mine = lit[block == number]
        flux = light[mine]
        total = flux.sum()
        height = float((flux * y[mine]).sum() / total)
        row = round(height)
        if row + reach + 1 < window.y0 or row - reach - 1 >= window.y1:
            continue
        weights = (mixture[:, mine] * flux).sum(axis=1) / total
        ready = stamps.block(weights, height - row)
        slabs = _deal((x[mine] - left) * density, flux, (_BLOCK + 2 * _SIDE) * density, _SIDE * density)
        buffer = np.zeros((2 * reach + 3, _BLOCK + 2 * _SIDE + 2 * reach + 1), np.float32)
        _stack(buffer, slabs, ready)
        box = [left - _SIDE - reach, 0, row - reach - 1, 0]
        box[1], box[3] = box[0] + buffer.shape[1], box[2] + buffer.shape[0]
        x0, x1 = max(box[0], window.x0), min(box[1], window.x1)
        y0, y1 = max(box[2], window.y0), min(box[3], window.y1)
        if x0 >= x1 or y0 >= y1:
            continue
        seen = buffer[y0 - box[2] : y1 - box[2], x0 - box[0] : x1 - box[0]]
        cut = slice(y0 - window.y0, y1 - window.y0), slice(x0 - window.x0, x1 - window.x0)
        parts.append((_put(image[cut], seen, response[cut]), (x0, x1, y0, y1)))
    return parts


@numba.njit(cache=True)
def _deal(place, flux, count, first):
    """Return (count,) slabs: light at `place` [slabs, from number `first` on] dealt out to four by the cubic."""
    slabs = np.zeros(count, np.float64)
    for k in range(len(place)):
        j = int(np.floor(place[k]))
        t = place[k] - j
        j += first
        slabs[j - 1] -= flux[k] * t * (t - 1) * (t - 2) / 6
        slabs[j] += flux[k] * (t + 1) * (t - 1) * (t - 2) / 2
        slabs[j + 1] -= flux[k] * (t + 1) * t * (t - 2) / 2
        slabs[j + 2] += flux[k] * (t + 1) * t * (t - 1) / 6
    return slabs


@numba.njit(cache=True)
def _stack(buffer, slabs, stamps):
    """Add stamps (density, rows, columns) times slabs (pixels x density) to the buffer (rows, pixels + columns - 1)."""
    density, rows, columns = stamps.shape
    for row in range(rows):
        line = buffer[row]
        for j in range(len(slabs)):
            if slabs[j] != 0.0:
                light, stamp, part = np.float32(slabs[j]), stamps[j % density, row], line[j // density :]
                for column in range(columns):
                    part[column] += light * stamp[column]


@numba.njit(cache=True)
def _put(image, stamp, response):
    """Add a stamp times the response, nothing below zero; return the sum of what was added."""
    total = 0.0
    for row in range(stamp.shape[0]):
        line = 0.0
        for column in range(stamp.shape[1]):
            value = max(stamp[row, column], np.float32(0.0)) * response[row, column]
            image[row, column] += value
            line += value
        total += line
    return total
