"""Find sources in a calibrated image in two passes: background, "cold" and "hot" detection.

Source Extractor's algorithms (Bertin & Arnouts 1996) through the `sep` library (Barbary 2016), run twice
("hot and cold": Rix et al. 2004, ApJS 152, 163; Barden et al. 2012, MNRAS 422, 449); `measure.combine`
makes one list of the two.

Cold: the image binned 2 x 2, smoothed with a Gaussian of FWHM 0.44 arcsec, a threshold per smoothed pixel
with a minimum area, and coarse deblending: a galaxy stays one source and its ellipse is that of the galaxy.

Hot: the detection kernel is the PSF itself, so the threshold is on the S/N a point source would have in
optimal photometry. On fabricated frames, 3.75 finds 98 % of the point sources of S/N 5 to 6 and 99.9 % of all
above 5, at the price of 85 false detections a megapixel of pure noise, of S/N below 5 (3.5: 99 % and 205;
4: 94 % and 37); `bricks.merge` removes those. sep's cleaning step is off in both: with a threshold on single
pixels it takes most sources of S/N 5 to 10 for wings of their neighbours, and many faint galaxies.

The background is measured twice: with a fine mesh to find the sources, then with a coarse one with the cold
sources masked, because a mesh of a few arcseconds takes the outskirts of galaxies for sky.
"""

from dataclasses import dataclass

import numpy as np

from csstsim.measure.background import MASK_MAX, crude_background, masked_background
from csstsim.measure.centroid import windowed_positions
from csstsim.measure.maps import BIN, binned, full_size, grown
from csstsim.optics.psf.psf_set import WINDOW_PX

THRESHOLD = 3.75  # of the matched-filter S/N
GROWTH = 3  # binned px by which the cold sources' isophotes are grown to mask them
DEBLEND_LEVELS = 32
HOT_CONTRAST = 0.005
COLD_THRESHOLD, COLD_AREA, COLD_CONTRAST = 2.5, 8, 0.02  # S/N of a smoothed binned pixel; binned px
COLD_FWHM = 3.0  # binned px
HOT_WINDOW = 2.5  # px, largest half-light radius of a hot source's window: a galaxy would pull a wider one away
FWHM_TO_SIGMA = 2.354820045  # 2 sqrt(2 ln 2)


@dataclass(frozen=True)
class Sources:
    """Detected sources, arrays (n,); positions and lengths in px of the frame.

    `x`, `y` windowed positions; `a`, `b`, `theta` (rad, from +x to +y) the isophotal ellipse; `half_light`
    radius; `sep_flag` the extraction flags of sep; `window_failed` bool: x, y are barycentres; `segment`
    the number of the cold segment in `Passes.segments` the source lies on, 0 for none; `flux` within the isophote;
    `window` sigma of the position's window.
    """

    x: np.ndarray
    y: np.ndarray
    a: np.ndarray
    b: np.ndarray
    theta: np.ndarray
    half_light: np.ndarray
    sep_flag: np.ndarray
    window_failed: np.ndarray
    segment: np.ndarray
    flux: np.ndarray
    window: np.ndarray


@dataclass(frozen=True)
class Passes:
    """What `detect` found. `image`: electrons with the background subtracted, `rms`: its noise map.

    `segments` int32 (ny, nx): k + 1 on the isophote of cold source k, 0 elsewhere; `cold` and `hot`: Sources.
    """

    image: np.ndarray
    rms: np.ndarray
    segments: np.ndarray
    cold: Sources
    hot: Sources


def detect(electrons, kernel, *, saturated=None, threshold=THRESHOLD):
    """Return the `Passes` of an electrons image, float32 (ny, nx); `electrons` is changed in place.

    `kernel`: small 2-d array, the point source's image (any normalisation). `saturated` pixels are excluded
    from the background, but not from detection. `threshold`: of the hot pass.
    """
    import sep

    # Crowded 85 Mpx frames overflow sep's defaults (3e5 pixels above threshold, 1024 parts of one object).
    sep.set_extract_pixstack(max(1_000_000, electrons.size // 8))
    sep.set_sub_object_limit(8192)
    rms = subtract_background(electrons, saturated)
    found, segments = _cold_pass(binned(electrons), binned(rms) / np.float32(BIN))
    segments = full_size(segments, electrons.shape)
    cold = _sources(electrons, found, segments, BIN, np.inf)
    found = sep.extract(
        electrons, threshold, err=rms, minarea=1, filter_kernel=np.ascontiguousarray(kernel, np.float32),
        filter_type="matched", deblend_nthresh=DEBLEND_LEVELS, deblend_cont=HOT_CONTRAST, clean=False,
    )  # fmt: skip
    return Passes(electrons, rms, segments, cold, _sources(electrons, found, segments, 1, HOT_WINDOW))


def subtract_background(electrons, saturated):
    """Subtract the background in place, with sources masked; return its noise map, electron (ny, nx)."""
    small = binned(electrons)
    level, noise = crude_background(small)
    _, segments = _cold_pass(small - level, noise)
    mask = full_size(grown(segments > 0, GROWTH), electrons.shape)
    if saturated is not None:
        mask |= saturated
    fine = masked_background(electrons, mask) if mask.mean() <= MASK_MAX else None
    if fine is None:
        fine = (
            full_size(level, electrons.shape) / np.float32(BIN**2),
            full_size(noise, electrons.shape) / np.float32(BIN),
        )
    electrons -= fine[0]
    return fine[1]


def _cold_pass(image, noise):
    """Return (sep's table, segmentation map) of the cold pass on a binned image."""
    import sep

    r2 = np.arange(-4, 5) ** 2
    kernel = np.exp(-0.5 * (r2[:, None] + r2) / (COLD_FWHM / FWHM_TO_SIGMA) ** 2).astype(np.float32)
    return sep.extract(
        image, COLD_THRESHOLD, err=noise, minarea=COLD_AREA, filter_kernel=kernel, filter_type="matched",
        deblend_nthresh=DEBLEND_LEVELS, deblend_cont=COLD_CONTRAST, clean=False, segmentation_map=True,
    )  # fmt: skip


def _sources(image, found, segments, scale, window):
    """Return the `Sources` of sep's table `found`, made on pixels of `scale` px; `window`: its largest radius, px."""
    import sep

    x, y = (scale * found[key] + 0.5 * (scale - 1) for key in "xy")
    # One pixel wide objects have no measurable ellipse: give them that of the pixel (variance 1/12).
    a, b = (np.maximum(scale * np.nan_to_num(found[key]), 12**-0.5) for key in "ab")
    half_light, _ = sep.flux_radius(image, x, y, 6.0 * a, 0.5, subpix=5)
    half_light = np.where(np.isfinite(half_light) & (half_light > 0.5), half_light, 0.5)
    # Never narrower than the window the PSF nodes are centred in: coma would shift a star by 0.01-0.03 px otherwise.
    sigma = np.maximum(2.0 * np.minimum(half_light, window) / FWHM_TO_SIGMA, WINDOW_PX)
    wx, wy, failed = windowed_positions(image, x, y, sigma)
    # The window may drift to a brighter neighbour or away: a shift beyond the source's own size is a failure.
    failed |= ~(np.hypot(wx - x, wy - y) < 1.0 + 2.0 * a / scale)
    x, y = np.where(failed, x, wx), np.where(failed, y, wy)
    row, column = (np.clip(np.rint(v).astype(int), 0, n - 1) for v, n in zip((y, x), image.shape, strict=True))
    theta, flag = np.nan_to_num(found["theta"]), found["flag"]
    segment, flux = segments[row, column], found["flux"].astype(float)
    return Sources(x, y, a, b, theta, half_light, flag, failed, segment, flux, sigma)
