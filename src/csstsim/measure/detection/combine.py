"""One list of sources from the isophotes and the peaks of `detect`: galaxies stay whole, close ones separate.

Off the isophotes every peak is a source. On an isophote:

- The highest peak is the main peak of the isophote. If it looks like a point (spread) and its PSF accounts for the flux
  of the isophote, it is a point source. Otherwise the source is extended: it has the isophote's ellipse and half-light
  radius, and its windowed position unless that is more than OFFSET_MAX from a peak of OFFSET_SNR.
- Any other peak, the highest first, is a source if its flux above the *local* level (a kernel and a constant fitted
  together on a stamp) is at least `LOCAL_SNR` times its error. Within `CLOSE_RADIUS` of a source the kernel is the PSF,
  and the flux is at least `LOCAL_FRACTION` of that source's. Further away the kernel may also be a Gaussian of
  `WIDE_SIGMA`, for galaxies. This rejects noise on the disc of a galaxy, and the PSF's rings.
- It is also a source if its flux exceeds that of the mirrored place, on the other side of each source of the isophote,
  by `MIRRORED_SNR` times the error and by `LOCAL_FRACTION` of that source's (mirrored.py): discs and rings are on both
  sides, a neighbour is not.
- An isophote without a peak is also a source: it has low surface brightness.
- The trail of a moving object is one source (trails.py).

A detection within `CORE_RADIUS` of a subtracted bright star, with less than `CORE_FRACTION` of its flux, is a residual
of the star and not a source.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, NamedTuple

import numba
import numpy as np

from csstsim.base.types import BoolArray, FloatArray, IntArray
from csstsim.measure.detection.detect import HALF_LIGHT_REACH, POINT_DRIFT, Sources
from csstsim.measure.detection.maps import BIN
from csstsim.measure.detection.mirrored import Smoothed, mirrored_excess
from csstsim.measure.detection.trails import with_trails
from csstsim.measure.light.centroid import windowed_positions
from csstsim.measure.light.half_light import half_light_radius
from csstsim.measure.light.photometry import PsfFits

if TYPE_CHECKING:
    from csstsim.measure.detection.bright_stars import BrightStars
    from csstsim.measure.detection.detect import Frame


MIRRORED_SNR = 3.0
LOCAL_SNR = 4.0
LOCAL_FRACTION = 0.02
CLOSE_RADIUS = 12.0  # px
# px: sigma of the Gaussian, half the side of its stamp
WIDE_SIGMA = 2.5
WIDE_HALF = 8
CORE_RADIUS = 5.0  # px
CORE_FRACTION = 0.05
# px; S/N of a peak that is not noise on a faint galaxy
OFFSET_MAX = 0.6
OFFSET_SNR = 5.0
POINT_SPREAD = 0.01, 2.5  # maximum spread of a star: a constant plus a multiple of its error (as in measure.catalogue)
# flux of an extended isophote above that of its point sources: sigma, and fraction of theirs
EXCESS_SIGMA = 3.0
EXCESS_FRACTION = 0.3


@dataclass(frozen=True)
class Detections(Sources):
    """The combined sources, with `image`, `rms` and binned `segments` of `detect.Frame`.

    `extended` (n,): sources with an isophote's ellipse; `snr` (n,): of the peak, 0 without one.
    """

    extended: BoolArray
    snr: FloatArray
    image: FloatArray
    rms: FloatArray
    segments: IntArray

    def rows(self, rows: IntArray) -> Detections:
        """Return some of the sources."""
        columns = {f.name: getattr(self, f.name)[rows] for f in fields(Sources)}
        return replace(self, **columns, extended=self.extended[rows], snr=self.snr[rows])

    def again(self) -> Detections:
        """Return the sources with positions and half-light radii that are measured on the image as it is now."""
        x, y, failed = windowed_positions(self.image, self.x, self.y, self.window)
        kept = failed | ~(np.hypot(x - self.x, y - self.y) < POINT_DRIFT)
        x = np.where(kept, self.x, x)
        y = np.where(kept, self.y, y)
        half_light = half_light_radius(self.image, x, y, HALF_LIGHT_REACH * self.a)
        return replace(self, x=x, y=y, half_light=half_light)


def combine(frame: Frame, peaks: Sources, snr: FloatArray, fit: PsfFits, kernel: FloatArray) -> Detections:
    """Return the `Detections` of a detect.Frame without its bright stars.

    `peaks` (Sources) and their S/N (n,): detect.peaks; `fit`: photometry.fit_sources of them; `kernel`: the PSF,
    normalised or not, odd side.
    """
    residual = _star_residuals(frame.stars, peaks.x, peaks.y, np.nan_to_num(fit.flux))
    peaks = _rows_of(peaks, ~residual)
    snr = snr[~residual]
    fit = PsfFits._make(np.nan_to_num(column[~residual]) for column in fit)
    main_peak = _main_peaks(peaks, snr, len(frame.extended.x))
    is_source = _peaks_are_sources(frame, peaks, snr, fit.flux, main_peak, kernel)
    frame, trail = with_trails(frame, kernel)
    is_source &= ~np.append(trail, False)[peaks.segment - 1]
    main_peak = np.where(trail, -1, main_peak)  # its peaks are noise on the trail
    extended = _is_extended(frame, peaks, fit, main_peak, is_source) | trail
    is_source[main_peak[extended & (main_peak >= 0)]] = False
    return _one_list(frame, peaks, snr, main_peak, is_source, extended)


def _peaks_are_sources(
    frame: Frame, peaks: Sources, snr: FloatArray, flux: FloatArray, main_peak: IntArray, kernel: FloatArray
) -> BoolArray:
    """Return bool (n,): the peaks that are sources, main peaks included; `main_peak`: of `_main_peaks`."""
    r2 = np.arange(-WIDE_HALF, WIDE_HALF + 1) ** 2
    wide = np.exp(-0.5 * (r2[:, None] + r2) / WIDE_SIGMA**2)
    n = len(peaks.x)
    on_isophote = peaks.segment > 0
    local = np.zeros(n)
    point_like = np.zeros(n, bool)
    broad = np.zeros(n, bool)
    is_main = np.zeros(n, bool)
    is_main[main_peak[main_peak >= 0]] = True
    for shape, significant in ((wide, broad), (kernel, point_like)):
        flux_on, error = local_flux(frame.image, frame.rms, peaks.x[on_isophote], peaks.y[on_isophote], shape)
        local[on_isophote] = flux_on
        significant[on_isophote] = flux_on > LOCAL_SNR * error
    brightest_first = np.argsort(-snr, kind="stable")
    smoothed = Smoothed.of(frame.image, frame.rms, kernel)
    evidence = _Evidence(is_main, snr, flux, local, point_like, broad)
    return _is_source(peaks.x, peaks.y, peaks.segment, brightest_first, evidence, smoothed)


def _is_extended(frame: Frame, peaks: Sources, fit: PsfFits, main_peak: IntArray, is_source: BoolArray) -> BoolArray:
    """Return bool (m,): the isophotes that are sources, because points do not account for their light."""
    isophotes = frame.extended
    inside = is_source & (peaks.segment > 0)
    explained = np.bincount(peaks.segment[inside], fit.flux[inside], len(isophotes.x) + 1)[1:]
    noise = np.sqrt(np.maximum(isophotes.flux, 0.0) + isophotes.area * float(np.median(frame.rms[::4, ::4])) ** 2)
    excess = isophotes.flux - explained > np.maximum(EXCESS_SIGMA * noise, EXCESS_FRACTION * explained)
    constant, times = POINT_SPREAD
    blurred = np.append(fit.spread > constant + times * fit.spread_error, True)[main_peak]
    residual = _star_residuals(frame.stars, isophotes.x, isophotes.y, isophotes.flux)
    return ((main_peak < 0) | excess | blurred) & ~residual


def _one_list(
    frame: Frame, peaks: Sources, snr: FloatArray, main_peak: IntArray, is_source: BoolArray, extended: BoolArray
) -> Detections:
    """Return the `Detections`: the peaks that are sources, then the extended isophotes."""
    isophotes = frame.extended
    of_peaks = np.flatnonzero(is_source)
    of_isophotes = np.flatnonzero(extended)
    columns = {
        f.name: np.concatenate([getattr(peaks, f.name)[of_peaks], getattr(isophotes, f.name)[of_isophotes]])
        for f in fields(Sources)
    }
    with_peak = np.flatnonzero(extended & (main_peak >= 0))
    peak = main_peak[with_peak]
    offset = np.hypot(peaks.x[peak] - isophotes.x[with_peak], peaks.y[peak] - isophotes.y[with_peak]) > OFFSET_MAX
    offset &= snr[peak] > OFFSET_SNR
    row = len(of_peaks) + np.cumsum(extended) - 1  # of each extended isophote
    for name in ("x", "y", "window", "window_failed"):
        columns[name][row[with_peak[offset]]] = getattr(peaks, name)[peak[offset]]
    # A source has the number of its isophote even if its position is not on it
    columns["segment"][len(of_peaks) :] = of_isophotes + 1
    return Detections(
        **columns,
        extended=np.repeat([False, True], [len(of_peaks), len(of_isophotes)]),
        snr=np.concatenate([snr[of_peaks], np.append(snr, 0.0)[main_peak[of_isophotes]]]),
        image=frame.image,
        rms=frame.rms,
        segments=frame.segments,
    )


def _rows_of(sources: Sources, rows: BoolArray) -> Sources:
    """Return the `Sources` of a mask of rows."""
    return Sources(*(getattr(sources, f.name)[rows] for f in fields(Sources)))


def _star_residuals(stars: BrightStars, x: FloatArray, y: FloatArray, flux: FloatArray) -> BoolArray:
    """Return bool (n,): detections at x, y, of `flux` electrons, that are residuals of subtracted bright stars."""
    from scipy.spatial import cKDTree

    if not len(stars) or not len(x):
        return np.zeros(len(x), bool)
    distance, star = cKDTree(np.column_stack([stars.x, stars.y])).query(np.column_stack([x, y]))
    return (distance < CORE_RADIUS) & (flux < CORE_FRACTION * stars.flux[star])


class _Evidence(NamedTuple):
    """Peaks (n,): main of its isophote; S/N; PSF flux; local flux, and whether it is significant with each kernel."""

    is_main: BoolArray
    snr: FloatArray
    flux: FloatArray
    local: FloatArray
    point_like: BoolArray
    broad: BoolArray


@numba.njit(cache=True)
def _is_source(
    x: FloatArray, y: FloatArray, segment: IntArray, brightest_first: IntArray, evidence: _Evidence, smoothed: Smoothed
) -> BoolArray:
    """Return bool (n,): the peaks that are sources; the rules are at the top of the file.

    Arrays (n,): position [px], number of the isophote, rows from the brightest on.
    """
    is_source = segment == 0
    # the sources of an isophote, from its last one to the first
    last_source = np.full(segment.max() + 1 if segment.size else 1, -1)
    next_source = np.full(x.size, -1)
    for k in brightest_first:
        s = segment[k]
        if s == 0:
            continue
        separate = True
        distinct = evidence.point_like[k]
        source = last_source[s]
        one_sided = source >= 0
        while source >= 0:
            allowed = LOCAL_FRACTION * evidence.flux[source]
            if (x[k] - x[source]) ** 2 + (y[k] - y[source]) ** 2 < CLOSE_RADIUS**2:
                separate = False
                distinct = distinct and evidence.local[k] > allowed
            if one_sided and not evidence.is_main[k]:
                excess, error = mirrored_excess(smoothed, x[k], y[k], x[source], y[source], evidence.snr[source])
                one_sided = excess > allowed and excess > MIRRORED_SNR * error
            source = next_source[source]
        if evidence.is_main[k] or distinct or one_sided or (separate and evidence.broad[k]):
            is_source[k] = True
            next_source[k] = last_source[s]
            last_source[s] = k
    return is_source


def _main_peaks(peaks: Sources, snr: FloatArray, count: int) -> IntArray:
    """Return the row of the highest peak on each of `count` isophotes, -1 for none; ties: the later row."""
    main_peak = np.full(count + 1, -1)
    order = np.argsort(snr, kind="stable")
    main_peak[peaks.segment[order]] = order  # the last assignment, the highest, stays
    return main_peak[1:]


@numba.njit(cache=True)
def local_flux(
    image: FloatArray, rms: FloatArray, x: FloatArray, y: FloatArray, kernel: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return (flux, error) (n,) [electron] of a kernel, fitted with a constant on its stamp at the nearest pixels.

    The flux is that within the kernel; pixels off the image count as zero. rms: noise of a pixel, on bins of BIN px.
    """
    ny, nx = image.shape
    half = kernel.shape[0] // 2
    p = kernel - kernel.mean()
    norm = np.sum(p**2)
    total = kernel.sum() / norm
    flux = np.zeros(x.size)
    error = np.zeros(x.size)
    for k in range(x.size):
        first_row = round(y[k]) - half
        first_column = round(x[k]) - half
        weighted = 0.0
        variance = 0.0
        for j in range(kernel.shape[0]):
            row = min(max(first_row + j, 0), ny - 1)
            for i in range(kernel.shape[1]):
                column = min(max(first_column + i, 0), nx - 1)
                inside = row == first_row + j and column == first_column + i
                data = float(image[row, column]) if inside else 0.0
                weighted += p[j, i] * data
                variance += p[j, i] ** 2 * (float(rms[row // BIN, column // BIN]) ** 2 + max(data, 0.0))
        flux[k] = weighted * total
        error[k] = math.sqrt(variance) * total
    return flux, error
