"""One list of sources from the hot and the cold pass of `measure.detect`: galaxies stay whole, close sources separate.

The cold segments divide the frame. Outside them, every hot source is kept. On a segment:

- The hot source nearest to the cold one's windowed position is the segment's own peak. If it looks like a
  point source (spread) and its PSF accounts for the light of the segment, it is kept as it is. Otherwise it is an
  extended source, with the ellipse, half-light radius and windowed position of the cold pass.
- Any other hot source is kept only if it is a distinct peak: its PSF flux above the *local* level
  (PSF and a constant fitted together on the kernel's stamp) is `LOCAL_SNR` times its error, and it is
  `LOCAL_SHARE` of the own peak's or its brightest pixel `LOCAL_CONTRAST` times that level. This rejects noise peaks
  on a galaxy's disc and the spikes of a star.
- An own peak of `APART_SNR` that is `APART` from the position of its extended source is kept, too.
- A cold source without a hot one is kept: it has low surface brightness.
"""

from dataclasses import dataclass, fields

import numpy as np

from csstsim.measure.detect import Sources

LOCAL_SNR = 5.0
LOCAL_SHARE = 0.02
LOCAL_CONTRAST = 8.0
APART, APART_SNR = 1.5, 10.0  # px; local flux over its error
POINT_SPREAD = 0.01, 2.5  # a star's spread: constant and times its error (as in measure.catalogue)
EXCESS_SIGMA, EXCESS_SHARE = 3.0, 0.3  # light of a segment beyond its point sources that makes it extended


@dataclass(frozen=True)
class Detections(Sources):
    """The combined sources, with `image`, `rms`, `segments` of `detect.Passes`; `extended`: of the cold pass."""

    extended: np.ndarray
    image: np.ndarray
    rms: np.ndarray
    segments: np.ndarray


def combine(passes, fit, kernel):
    """Return the `Detections` of `passes` (detect.Passes).

    `fit` (n, 6): photometry.fit_sources of `passes.hot`; `kernel`: the PSF, normalised or not, odd side.
    """
    hot, cold = passes.hot, passes.cold
    flux, spread, spread_error = (np.nan_to_num(fit[:, k]) for k in (0, 3, 4))
    peak = _own_peaks(hot, cold)  # of each cold source; -1 without
    local, local_error, level = local_flux(passes.image, passes.rms, hot.x, hot.y, kernel)
    owner = np.where(hot.segment > 0, peak[np.maximum(hot.segment, 1) - 1] if len(peak) else -1, -1)
    main = owner == np.arange(len(hot.x))
    outstanding = (local > LOCAL_SHARE * flux[owner]) | (local * kernel.max() > LOCAL_CONTRAST * level * kernel.sum())
    distinct = (local > LOCAL_SNR * local_error) & outstanding
    kept = (hot.segment == 0) | main | distinct
    # Light of the segment that its point sources do not explain.
    inside = kept & (hot.segment > 0)
    explained = np.bincount(hot.segment[inside], flux[inside], len(cold.x) + 1)[1:]
    area = np.bincount(passes.segments.ravel(), minlength=len(cold.x) + 1)[1:]
    noise = np.sqrt(np.maximum(cold.flux, 0.0) + area * float(np.median(passes.rms)) ** 2)
    excess = cold.flux - explained > np.maximum(EXCESS_SIGMA * noise, EXCESS_SHARE * explained)
    constant, times = POINT_SPREAD
    blurred = spread > constant + times * spread_error
    extended = (peak < 0) | excess | blurred[peak] if len(hot.x) else np.ones(len(cold.x), bool)
    beneath = np.flatnonzero(extended & (peak >= 0))
    top = peak[beneath]
    apart = np.hypot(hot.x[top] - cold.x[beneath], hot.y[top] - cold.y[beneath]) > APART
    kept[top[~((local[top] > APART_SNR * local_error[top]) & apart)]] = False
    rows = np.flatnonzero(kept), np.flatnonzero(extended)
    columns = {
        f.name: np.concatenate([getattr(part, f.name)[row] for part, row in zip((hot, cold), rows, strict=True)])
        for f in fields(Sources)
    }
    # A cold source keeps its own segment even where the windowed position lies off the isophote.
    columns["segment"][len(rows[0]) :] = rows[1] + 1
    which = np.repeat([False, True], [len(row) for row in rows])
    return Detections(**columns, extended=which, image=passes.image, rms=passes.rms, segments=passes.segments)


def _own_peaks(hot, cold):
    """Return the row of the hot source nearest to each cold one on its segment, -1 for none; ties: the later row."""
    count = len(cold.x)
    peak = np.full(count + 1, -1)
    if count:
        owner = np.maximum(hot.segment, 1) - 1
        order = np.argsort(-np.hypot(hot.x - cold.x[owner], hot.y - cold.y[owner]), kind="stable")
        peak[hot.segment[order]] = order  # the last assignment, the nearest, stays
    return peak[1:]


def local_flux(image, rms, x, y, kernel):
    """Return (flux, error, level): the kernel fitted with a constant on its stamp at the nearest pixels, electron.

    The flux is the light within the kernel, the level is per pixel; pixels off the image count as zero.
    """
    half = kernel.shape[0] // 2
    p = kernel - kernel.mean()
    offset = np.arange(-half, half + 1)
    row = np.rint(y).astype(int)[:, None, None] + offset[:, None]
    column = np.rint(x).astype(int)[:, None, None] + offset
    ny, nx = image.shape
    inside = (row >= 0) & (row < ny) & (column >= 0) & (column < nx)
    row, column = np.clip(row, 0, ny - 1), np.clip(column, 0, nx - 1)
    data = np.where(inside, image[row, column], 0.0)
    variance = rms[row, column] ** 2 + np.maximum(data, 0.0)
    norm = np.sum(p**2)
    total = kernel.sum() / norm
    flux, error = (p * data).sum(axis=(1, 2)) * total, np.sqrt((p**2 * variance).sum(axis=(1, 2))) * total
    return flux, error, data.mean(axis=(1, 2)) - flux * kernel.mean() / kernel.sum()
