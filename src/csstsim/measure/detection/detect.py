"""Find sources in a calibrated image: bright stars are subtracted, then peaks of S/N and isophotes are found.

1. The light of bright stars is fitted and subtracted (bright_stars), and its noise is added to the noise map.
2. Isophotes of extended sources ("cold" pass; Source Extractor's algorithm, Bertin & Arnouts 1996, through `sep`,
   Barbary 2016): the image binned 2 x 2, smoothed with a Gaussian of FWHM 0.44 arcsec, a threshold on a smoothed pixel
   with a minimum area, and coarse deblending. A galaxy stays one source, and its ellipse is that of the galaxy.
3. The background is measured on a coarse mesh, with bright pixels masked: a mesh of a few arcseconds would include the
   outskirts of galaxies in the sky.
4. Peaks of the S/N that a point would have (peaks). The threshold of 3.75 finds all isolated points above S/N 6 and 98%
   of those of S/N 5 to 6, and about 130 noise peaks per megapixel, of S/N below 5. `bricks.merge` removes these.

`combine` makes one list of isophotes and peaks ("hot and cold": Rix et al. 2004, ApJS 152, 163).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from csstsim.base.types import AnyArray, BoolArray, FloatArray, IntArray
from csstsim.measure.detection.background import MASK_MAX, crude_background, masked_background
from csstsim.measure.detection.bright_stars import BrightStars
from csstsim.measure.detection.maps import BIN, binned, flux_within, full_size, grown, solid
from csstsim.measure.detection.peaks import find_peaks, smoothed_snr, smoothing
from csstsim.measure.light.centroid import windowed_positions
from csstsim.measure.light.half_light import half_light_radius
from csstsim.optics.psf.sampling import WINDOW_PX

THRESHOLD = 3.75  # S/N of a peak
GROWTH = 3  # binned px by which the mask of bright pixels is grown
DEBLEND_LEVELS = 32
# S/N of a smoothed binned pixel; binned px
COLD_THRESHOLD = 2.5
COLD_AREA = 8
NOISE_MAX = 0.005  # of the frame; noise takes 0.0012. More below the background is the sky between crowded sources
COLD_CONTRAST = 0.02
COLD_FWHM = 3.0  # binned px
POINT_DRIFT = 1.5  # px, maximum distance of a point's position from its peak
# FWHM of the window of a position over the half-light radius, 2 in Source Extractor. Galaxies have cusps: from 0.6 to
# 1.2 the scatter is the same, at 2 it is a third more (S/N 20 to 500)
POSITION_WINDOW = 1.0
HALF_LIGHT_REACH = 6.0  # of the major axis: radius of the circle with the light of the half-light radius
FWHM_TO_SIGMA = 2.354820045  # 2 sqrt(2 ln 2)


@dataclass(frozen=True)
class Sources:
    """Detected sources, arrays (n,); positions and lengths in px of the frame.

    `x`, `y` windowed positions; `a`, `b`, `theta` (rad, from +x to +y) the isophotal ellipse; `half_light`
    radius; `area` of the isophote, px; `sep_flag` the extraction flags of sep; `window_failed` bool: x, y are
    barycentres; `segment` the number of the isophote in `Frame.segments` the source lies on, 0 for none; `flux` within
    the isophote; `window` sigma of the position's window.
    """

    x: FloatArray
    y: FloatArray
    a: FloatArray
    b: FloatArray
    theta: FloatArray
    half_light: FloatArray
    area: AnyArray
    sep_flag: IntArray
    window_failed: BoolArray
    segment: IntArray
    flux: FloatArray
    window: FloatArray


@dataclass(frozen=True)
class Frame:
    """A calibrated image whose background and isophotes are known.

    `image`: electrons with background and bright stars subtracted. On bins of BIN px, a last one for an odd row or
    column: `rms`, the noise of a pixel [electron], and `segments` int32, k + 1 on the isophote of extended source k of
    `extended` (Sources), 0 elsewhere. `stars`: bright_stars.BrightStars.
    """

    image: FloatArray
    rms: FloatArray
    segments: IntArray
    extended: Sources
    stars: BrightStars


def isophotes(electrons: FloatArray, stars: BrightStars, unusable: IntArray) -> Frame:
    """Return the `Frame` of an electrons image, float32 (ny, nx), which is changed in place.

    `stars`: its bright_stars.BrightStars, not yet subtracted; `unusable` (ny, nx): pixels left out of the background,
    but not of detection, where it is not 0. The noise map does not include the noise of the stars.
    """
    stars.subtract_from(electrons)
    noise = subtract_background(electrons, unusable)
    small = binned(electrons)
    found, segments = _cold_pass(small, noise)
    del small
    noise /= np.float32(BIN)
    segments = _with_last(segments, electrons.shape)
    sources = _sources(electrons, found, segments, BIN, None)
    return Frame(electrons, _with_last(noise, electrons.shape), segments, sources, stars)


def _with_last(binned: AnyArray, shape: tuple[int, ...]) -> AnyArray:
    """Return a binned map of a frame of `shape` with bins for a last odd row and column, equal to their neighbours."""
    padding = [(0, -(-n // BIN) - m) for n, m in zip(shape, binned.shape, strict=True)]
    return np.pad(binned, padding, mode="edge") if np.any(padding) else binned


def peaks(
    frame: Frame, kernel: FloatArray, unusable: IntArray, threshold: float = THRESHOLD
) -> tuple[Sources, FloatArray]:
    """Return (Sources, S/N (n,)) of the peaks of a `Frame`; `kernel`: the PSF on pixels, (n, n), n odd.

    A peak has no isophote: its ellipse is that of the kernel's Gaussian.
    """
    weight = smoothing(kernel)
    x, y, snr = find_peaks(frame.image, frame.rms, unusable, weight, threshold)
    points = _points(x, y, kernel)
    return _sources(frame.image, points, frame.segments, 1, point_window(kernel)), snr


def star_sources(frame: Frame, kernel: FloatArray) -> Sources:
    """Return the `Sources` of the bright stars of a `Frame`, to whose image their light was added again.

    Windowed positions fail on saturated stars: their positions are those of the fit.
    """
    stars = frame.stars
    sources = _sources(frame.image, _points(stars.x, stars.y, kernel), frame.segments, 1, point_window(kernel))
    fitted = stars.saturated | sources.window_failed
    return replace(
        sources,
        x=np.where(fitted, stars.x, sources.x),
        y=np.where(fitted, stars.y, sources.y),
        window_failed=np.zeros(len(stars), bool),
        flux=stars.flux,
    )


def point_window(kernel: FloatArray) -> float:
    """Return the sigma [px] of the window of points, that of the kernel: a wider window would drift to neighbours."""
    half = len(kernel) // 2
    x, y = np.full((2, 1), float(half))
    # float32, as images: one compiled version
    return _window(2.0 * half_light_radius(kernel.astype(np.float32), x, y, np.array([half + 0.5]))).item()


def _window(fwhm: FloatArray) -> FloatArray:
    """Return sigma [px] of windows of FWHM (n,) px."""
    # Not narrower than the window of the centres of PSF nodes: coma would otherwise shift a star by 0.01-0.03 px
    return np.maximum(fwhm / FWHM_TO_SIGMA, WINDOW_PX)


def _points(x: FloatArray, y: FloatArray, kernel: FloatArray) -> dict[str, AnyArray]:
    """Return a table like that of sep, of points at x, y: round, as wide as the kernel, without flags."""
    n = len(x)
    r2 = (np.arange(len(kernel)) - len(kernel) // 2) ** 2
    width = math.sqrt(float((kernel * r2).sum() / kernel.sum()))
    table = {"x": x, "y": y, "a": np.full(n, width), "b": np.full(n, width), "flag": np.zeros(n, int)}
    return table | dict.fromkeys(("theta", "npix", "flux"), np.zeros(n))


def subtract_background(electrons: FloatArray, unusable: IntArray) -> FloatArray:
    """Subtract the background in place, measured without bright pixels and those where `unusable` (ny, nx) is not 0.

    Returns the noise [electron] of the sums of BIN x BIN pixels (maps.binned).
    """
    small = binned(electrons)
    level, noise = crude_background(small)
    small -= level
    del level  # maps are a quarter of the frame: few at a time
    snr = smoothed_snr(small, noise, _weight())
    bright = solid(snr, COLD_THRESHOLD, 1.0)
    dark = solid(snr, COLD_THRESHOLD, -1.0)
    del snr
    # Noise as far below the background is left out, too: otherwise, the background would be 0.05 electron low
    mask = grown(bright | dark if dark.mean() < NOISE_MAX else bright, GROWTH)
    mesh = masked_background(electrons, mask, unusable) if mask.mean() <= MASK_MAX else None
    if mesh is not None:
        mesh.subtract_from(electrons)
        return mesh.noise(small.shape)
    level, _ = crude_background(binned(electrons))  # again: such frames are few
    electrons -= full_size(level, electrons.shape) / np.float32(BIN**2)
    return noise


def _weight() -> FloatArray:
    """Return the Gaussian (9,) with which the binned image is smoothed along both axes."""
    return np.exp(-0.5 * (np.arange(-4, 5) / (COLD_FWHM / FWHM_TO_SIGMA)) ** 2).astype(np.float32)


def _cold_pass(image: FloatArray, noise: FloatArray) -> tuple[NDArray[np.void], IntArray]:
    """Return (table of sep, segmentation map) of the isophotes of a binned image; its `flux` is that within each."""
    import sep

    # Crowded frames overflow sep's defaults: 3e5 pixels above the threshold, 1024 parts of one object
    sep.set_extract_pixstack(max(1_000_000, image.size // 8))
    sep.set_sub_object_limit(8192)
    found, segments = sep.extract(
        smoothed_snr(image, noise, _weight()),
        COLD_THRESHOLD,
        minarea=COLD_AREA,
        filter_kernel=None,
        deblend_nthresh=DEBLEND_LEVELS,
        deblend_cont=COLD_CONTRAST,
        clean=False,
        segmentation_map=True,
    )
    found["flux"] = flux_within(image, segments, len(found))
    return found, segments


def _sources(
    image: FloatArray,
    found: NDArray[np.void] | Mapping[str, AnyArray],
    segments: IntArray,
    scale: int,
    window: float | None,
) -> Sources:
    """Return the `Sources` of a table `found` of sep, on pixels of `scale` px.

    `window`: sigma of the window of all positions [px]; None: of POSITION_WINDOW times each half-light radius.
    """
    x = scale * found["x"] + 0.5 * (scale - 1)
    y = scale * found["y"] + 0.5 * (scale - 1)
    # The ellipse of an object one pixel wide is not measurable: it gets that of the pixel (variance 1/12).
    a = np.maximum(scale * np.nan_to_num(found["a"]), 12**-0.5)
    b = np.maximum(scale * np.nan_to_num(found["b"]), 12**-0.5)
    half_light = half_light_radius(image, x, y, HALF_LIGHT_REACH * a)
    sigma = _window(POSITION_WINDOW * half_light) if window is None else np.full(len(x), window)
    wx, wy, failed = windowed_positions(image, x, y, sigma)
    # The window may drift to a brighter neighbour or away: a shift beyond the size of the source is a failure.
    failed |= ~(np.hypot(wx - x, wy - y) < (1.0 + 2.0 * a / scale if window is None else POINT_DRIFT))
    x = np.where(failed, x, wx)
    y = np.where(failed, y, wy)
    ny, nx = image.shape
    row = np.clip(np.rint(y).astype(int), 0, ny - 1)
    column = np.clip(np.rint(x).astype(int), 0, nx - 1)
    theta = np.nan_to_num(found["theta"])
    flag = found["flag"]
    segment = segments[row // BIN, column // BIN]
    flux = found["flux"].astype(float)
    area = scale**2 * found["npix"]
    return Sources(x, y, a, b, theta, half_light, area, flag, failed, segment, flux, sigma)
