"""One list of sources from the isophotes and the peaks of `detect`: galaxies stay whole, close ones separate.

Off the isophotes every peak is a source. On an isophote:

- The highest peak is the isophote's own. If it looks like a point (spread) and its PSF accounts for the light of the
  isophote, it is a source as it is. Otherwise the source is extended: it has the isophote's ellipse and half-light
  radius, and its windowed position unless that lies more than APART from a peak of APART_SNR.
- Any other peak, the highest first, is a source if its flux above the *local* level (a kernel and a constant fitted
  together on a stamp) is `LOCAL_SNR` times its error. Within `CLOSE` of a source the kernel is the PSF, and the flux
  must be `LOCAL_SHARE` of that source's; further away a Gaussian of `WIDE` will do, too, for a galaxy. This rejects
  noise on a galaxy's disc, and the PSF's rings.
- An isophote without a peak is a source, too: it has low surface brightness.

What lies within `CORE` of a bright star that was taken out, and has less than `CORE_SHARE` of its light, is the rest
of the star, and no source.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

import numba
import numpy as np

from csstsim.base.types import BoolArray, FloatArray, IntArray
from csstsim.measure.detection.detect import Sources
from csstsim.measure.light.photometry import PsfFits

if TYPE_CHECKING:
    from csstsim.measure.detection.bright_stars import BrightStars
    from csstsim.measure.detection.detect import Frame

LOCAL_SNR = 4.0
# px
LOCAL_SHARE = 0.02
CLOSE = 12.0
# px: sigma of the Gaussian, half the side of its stamp
WIDE = 2.5
WIDE_HALF = 8
# px
CORE = 5.0
CORE_SHARE = 0.05
# px; S/N of a peak that is no noise on a faint galaxy
APART = 1.5
APART_SNR = 5.0
POINT_SPREAD = 0.01, 2.5  # a star's spread: constant and times its error (as in measure.catalogue)
# light of an isophote beyond its point sources that makes it extended
EXCESS_SIGMA = 3.0
EXCESS_SHARE = 0.3


@dataclass(frozen=True)
class Detections(Sources):
    """The combined sources, with `image`, `rms` and binned `segments` of `detect.Frame`.

    `extended`: with an isophote's ellipse; `snr`: of the peak, 0 without one.
    """

    extended: BoolArray
    snr: FloatArray
    image: FloatArray
    rms: FloatArray
    segments: IntArray


def combine(frame: Frame, peaks: Sources, snr: FloatArray, fit: PsfFits, kernel: FloatArray) -> Detections:
    """Return the `Detections` of a detect.Frame without its bright stars.

    `peaks` (Sources) and their S/N (n,): detect.peaks; `fit`: photometry.fit_sources of them; `kernel`: the PSF,
    normalised or not, odd side.
    """
    rest = _rest_of_stars(frame.stars, peaks.x, peaks.y, np.nan_to_num(fit.flux))
    peaks = _rows_of(peaks, ~rest)
    snr = snr[~rest]
    fit = PsfFits._make(np.nan_to_num(column[~rest]) for column in fit)
    top = _own_peaks(peaks, snr, len(frame.extended.x))
    kept = _kept(frame, peaks, snr, fit.flux, top, kernel)
    extended = _is_extended(frame, peaks, fit, top, kept)
    kept[top[extended & (top >= 0)]] = False
    return _joined(frame, peaks, snr, top, kept, extended)


def _kept(
    frame: Frame, peaks: Sources, snr: FloatArray, flux: FloatArray, top: IntArray, kernel: FloatArray
) -> BoolArray:
    """Return bool (n,): the peaks that are sources, an isophote's own among them; `top`: `_own_peaks`."""
    r2 = np.arange(-WIDE_HALF, WIDE_HALF + 1) ** 2
    wide = np.exp(-0.5 * (r2[:, None] + r2) / WIDE**2)
    n = len(peaks.x)
    on = peaks.segment > 0
    local = np.zeros(n)
    narrow = np.zeros(n, bool)
    broad = np.zeros(n, bool)
    own = np.zeros(n, bool)
    own[top[top >= 0]] = True
    for shape, above in ((wide, broad), (kernel, narrow)):
        local[on], error = local_flux(frame.image, frame.rms, peaks.x[on], peaks.y[on], shape)
        above[on] = local[on] > LOCAL_SNR * error
    order = np.argsort(-snr, kind="stable")
    return _distinct(peaks.x, peaks.y, peaks.segment, order, own, flux, local, narrow, broad)


def _is_extended(frame: Frame, peaks: Sources, fit: PsfFits, top: IntArray, kept: BoolArray) -> BoolArray:
    """Return bool (m,): the isophotes that are sources, because points do not account for their light."""
    isophotes = frame.extended
    inside = kept & (peaks.segment > 0)
    explained = np.bincount(peaks.segment[inside], fit.flux[inside], len(isophotes.x) + 1)[1:]
    noise = np.sqrt(np.maximum(isophotes.flux, 0.0) + isophotes.area * float(np.median(frame.rms[::8, ::8])) ** 2)
    excess = isophotes.flux - explained > np.maximum(EXCESS_SIGMA * noise, EXCESS_SHARE * explained)
    constant, times = POINT_SPREAD
    blurred = np.append(fit.spread > constant + times * fit.spread_error, True)[top]
    rest = _rest_of_stars(frame.stars, isophotes.x, isophotes.y, isophotes.flux)
    return ((top < 0) | excess | blurred) & ~rest


def _joined(
    frame: Frame, peaks: Sources, snr: FloatArray, top: IntArray, kept: BoolArray, extended: BoolArray
) -> Detections:
    """Return the `Detections`: the peaks that are `kept`, then the isophotes that are `extended`."""
    isophotes = frame.extended
    of_peaks = np.flatnonzero(kept)
    of_isophotes = np.flatnonzero(extended)
    columns = {
        f.name: np.concatenate([getattr(peaks, f.name)[of_peaks], getattr(isophotes, f.name)[of_isophotes]])
        for f in fields(Sources)
    }
    both = np.flatnonzero(extended & (top >= 0))
    high = top[both]
    far = np.hypot(peaks.x[high] - isophotes.x[both], peaks.y[high] - isophotes.y[both]) > APART
    far &= snr[high] > APART_SNR
    row = len(of_peaks) + np.cumsum(extended) - 1  # of each extended isophote
    for name in ("x", "y", "window", "window_failed"):
        columns[name][row[both[far]]] = getattr(peaks, name)[high[far]]
    # A source keeps its own isophote even where its position lies off it
    columns["segment"][len(of_peaks) :] = of_isophotes + 1
    return Detections(
        **columns,
        extended=np.repeat([False, True], [len(of_peaks), len(of_isophotes)]),
        snr=np.concatenate([snr[of_peaks], np.append(snr, 0.0)[top[of_isophotes]]]),
        image=frame.image,
        rms=frame.rms,
        segments=frame.segments,
    )


def _rows_of(sources: Sources, rows: BoolArray) -> Sources:
    """Return the `Sources` of some rows."""
    return Sources(*(getattr(sources, f.name)[rows] for f in fields(Sources)))


def _rest_of_stars(stars: BrightStars, x: FloatArray, y: FloatArray, flux: FloatArray) -> BoolArray:
    """Return bool (n,): what is left of a bright star (bright_stars.BrightStars) at x, y, with `flux` electrons."""
    from scipy.spatial import cKDTree

    if not len(stars) or not len(x):
        return np.zeros(len(x), bool)
    distance, star = cKDTree(np.column_stack([stars.x, stars.y])).query(np.column_stack([x, y]))
    return (distance < CORE) & (flux < CORE_SHARE * stars.flux[star])


@numba.njit(cache=True)
def _distinct(
    x: FloatArray,
    y: FloatArray,
    segment: IntArray,
    order: IntArray,
    own: BoolArray,
    flux: FloatArray,
    local: FloatArray,
    narrow: BoolArray,
    broad: BoolArray,
) -> BoolArray:
    """Return bool (n,): which peaks are sources; `order`: the highest first; the rest (n,), see the top of the file."""
    kept = segment == 0
    # chains of kept peaks
    first = np.full(segment.max() + 1 if segment.size else 1, -1)
    after = np.full(x.size, -1)
    for k in order:
        s = segment[k]
        if s == 0:
            continue
        alone = True
        bright = narrow[k]
        other = first[s]
        while other >= 0:
            if (x[k] - x[other]) ** 2 + (y[k] - y[other]) ** 2 < CLOSE**2:
                alone = False
                bright = bright and local[k] > LOCAL_SHARE * flux[other]
            other = after[other]
        if own[k] or bright or (alone and broad[k]):
            kept[k] = True
            after[k] = first[s]
            first[s] = k
    return kept


def _own_peaks(peaks: Sources, snr: FloatArray, count: int) -> IntArray:
    """Return the row of the highest peak on each of `count` isophotes, -1 for none; ties: the later row."""
    own = np.full(count + 1, -1)
    order = np.argsort(snr, kind="stable")
    own[peaks.segment[order]] = order  # the last assignment, the highest, stays
    return own[1:]


def local_flux(
    image: FloatArray, rms: FloatArray, x: FloatArray, y: FloatArray, kernel: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return (flux, error): the kernel fitted with a constant on its stamp at the nearest pixels, electron.

    The flux is the light within the kernel; pixels off the image count as zero.
    """
    half = kernel.shape[0] // 2
    p = kernel - kernel.mean()
    offset = np.arange(-half, half + 1)
    row = np.rint(y).astype(int)[:, None, None] + offset[:, None]
    column = np.rint(x).astype(int)[:, None, None] + offset
    ny, nx = image.shape
    inside = (row >= 0) & (row < ny) & (column >= 0) & (column < nx)
    row = np.clip(row, 0, ny - 1)
    column = np.clip(column, 0, nx - 1)
    data = np.where(inside, image[row, column], 0.0)
    variance = rms[row, column] ** 2 + np.maximum(data, 0.0)
    norm = np.sum(p**2)
    total = kernel.sum() / norm
    return (p * data).sum(axis=(1, 2)) * total, np.sqrt((p**2 * variance).sum(axis=(1, 2))) * total
