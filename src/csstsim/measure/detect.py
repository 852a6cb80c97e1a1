"""Find sources in a calibrated image in two passes: background, "cold" and "hot" detection.

Source Extractor's algorithms (Bertin & Arnouts 1996) through the `sep` library (Barbary 2016), run twice
("hot and cold": Rix et al. 2004, ApJS 152, 163; Barden et al. 2012, MNRAS 422, 449); `measure.combine`
makes one list of the two.

Cold: the image binned 2 x 2, smoothed with a Gaussian of FWHM 0.44 arcsec, a threshold per smoothed pixel
with a least area, and coarse deblending: a galaxy stays one source and its ellipse is that of the galaxy.

Hot: the detection kernel is the PSF itself, so the threshold is on the S/N a point source would have in
optimal photometry. On fabricated frames, 3.75 finds 98 % of the point sources of S/N 5 to 6 and 99.9 % of all
above 5, at the price of 85 false detections a megapixel of pure noise, of S/N below 5 (3.5: 99 % and 205;
4: 94 % and 37); `bricks.merge` keeps those out. sep's cleaning step is off: with a threshold on single
pixels it takes most sources of S/N 5 to 10 for wings of their neighbours.

The background is taken twice: with a fine mesh to find the sources, then with a coarse one with the cold
sources masked, because a mesh of a few arcseconds takes the outskirts of galaxies for sky. Left out:
cosmic-ray rejection (sharp sources are flagged by `measure.photometry`).
"""

from dataclasses import dataclass

import numpy as np

THRESHOLD = 3.75  # of the matched-filter S/N
BIN = 2  # px, of the cold pass
FIRST_BOX, SECOND_BOX = 64, 256  # px; 4.7 arcsec to find sources, 19 arcsec with the sources masked
GROWTH = 4  # binned px by which the cold sources' isophotes are grown to mask them
DEBLEND_LEVELS = 32
HOT_CONTRAST = 0.005
COLD_THRESHOLD, COLD_AREA, COLD_CONTRAST = 3.0, 6, 0.03  # S/N of a smoothed binned pixel; binned px
COLD_FWHM = 3.0  # binned px
FWHM_TO_SIGMA = 2.354820045  # 2 sqrt(2 ln 2)


@dataclass(frozen=True)
class Sources:
    """Detected sources, arrays (n,); positions and lengths in px of the frame.

    `x`, `y` windowed positions; `a`, `b`, `theta` (rad, from +x to +y) the isophotal ellipse; `half_light`
    radius; `sep_flag` the extraction flags of sep; `window_failed` bool: x, y are barycentres; `segment`
    the number of the cold segment in `Passes.segments` the source lies on, 0 for none; `flux` within the isophote.
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


@dataclass(frozen=True)
class Passes:
    """What `detect` found. `image`: electrons with the background taken off, `rms`: its noise map.

    `segments` int32 (ny, nx): k + 1 on the isophote of cold source k, 0 elsewhere; `cold` and `hot`: Sources.
    """

    image: np.ndarray
    rms: np.ndarray
    segments: np.ndarray
    cold: Sources
    hot: Sources


def detect(electrons, kernel, *, saturated=None, threshold=THRESHOLD):
    """Return the `Passes` of an electrons image, float32 (ny, nx); `electrons` is changed in place.

    `kernel`: small 2-d array, the point source's image (any normalisation). `saturated` pixels are kept
    out of the background, not out of the detection. `threshold`: of the hot pass.
    """
    import sep

    # Crowded 85 Mpx frames overflow sep's defaults (3e5 pixels above threshold, 1024 parts of one object).
    sep.set_extract_pixstack(max(1_000_000, electrons.size // 8))
    sep.set_sub_object_limit(8192)
    rms = _subtract_background(electrons, saturated)
    found, segments = _cold_pass(_binned(electrons), BIN * _decimated(rms))
    segments = _full_size(segments, electrons.shape)
    cold = _sources(electrons, found, segments, BIN)
    found = sep.extract(
        electrons, threshold, err=rms, minarea=1, filter_kernel=np.ascontiguousarray(kernel, np.float32),
        filter_type="matched", deblend_nthresh=DEBLEND_LEVELS, deblend_cont=HOT_CONTRAST, clean=False,
    )  # fmt: skip
    return Passes(electrons, rms, segments, cold, _sources(electrons, found, segments, 1))


def _subtract_background(electrons, saturated):
    """Take the background off in place, masking sources; return its noise map, electron (ny, nx)."""
    import sep
    from scipy.ndimage import binary_dilation

    binned = _binned(electrons)
    background = sep.Background(binned, bw=_box(FIRST_BOX // BIN, binned), bh=_box(FIRST_BOX // BIN, binned))
    noise = _floored(background.rms(dtype=np.float32))
    binned -= background.back(dtype=np.float32)
    _, segments = _cold_pass(binned, noise)
    mask = _full_size(binary_dilation(segments > 0, iterations=GROWTH), electrons.shape)
    if saturated is not None:
        mask |= saturated
    if mask.mean() > 0.8:  # so crowded that nothing is left: the clipped mode of all pixels is the better guess
        mask = saturated
    box = _box(SECOND_BOX, electrons)
    background = sep.Background(electrons, mask=mask, bw=box, bh=box)
    rms = _floored(background.rms(dtype=np.float32))
    electrons -= _unskewed(background.back(dtype=np.float32), rms)
    return rms


def _box(size, image):
    return min(size, *image.shape)


def _floored(rms):
    return np.maximum(rms, np.float32(1e-3), out=rms)  # a noise-free image has rms 0: a floor keeps S/N finite


def _cold_pass(binned, noise):
    """Return (sep's table, segmentation map) of the cold pass on a binned image."""
    import sep

    r2 = np.arange(-4, 5) ** 2
    kernel = np.exp(-0.5 * (r2[:, None] + r2) / (COLD_FWHM / FWHM_TO_SIGMA) ** 2).astype(np.float32)
    return sep.extract(
        binned, COLD_THRESHOLD, err=noise, minarea=COLD_AREA, filter_kernel=kernel, filter_type="matched",
        deblend_nthresh=DEBLEND_LEVELS, deblend_cont=COLD_CONTRAST, clean=True, clean_param=1.0, segmentation_map=True,
    )  # fmt: skip


def _sources(image, found, segments, scale):
    """Return the `Sources` of sep's table `found`, made on pixels of `scale` px."""
    import sep

    x, y = (scale * found[key] + 0.5 * (scale - 1) for key in "xy")
    # One pixel wide objects have no measurable ellipse: give them that of the pixel (variance 1/12).
    a, b = (np.maximum(scale * np.nan_to_num(found[key]), 12**-0.5) for key in "ab")
    half_light, _ = sep.flux_radius(image, x, y, 6.0 * a, 0.5, subpix=5)
    half_light = np.where(np.isfinite(half_light) & (half_light > 0.5), half_light, 0.5)
    wx, wy, flag = sep.winpos(image, x, y, 2.0 * half_light / FWHM_TO_SIGMA)
    # The window may slide to a brighter neighbour or to nowhere: a source is not further off than its own size.
    failed = ~(np.hypot(wx - x, wy - y) < 1.0 + 2.0 * a / scale) | ((flag & sep.APER_NONPOSITIVE) != 0)
    x, y = np.where(failed, x, wx), np.where(failed, y, wy)
    row, column = (np.clip(np.rint(v).astype(int), 0, n - 1) for v, n in zip((y, x), image.shape, strict=True))
    theta, flag = np.nan_to_num(found["theta"]), found["flag"]
    return Sources(x, y, a, b, theta, half_light, flag, failed, segments[row, column], found["flux"].astype(float))


def _binned(image):
    """Sums of BIN x BIN pixels; a last odd row or column is left out."""
    ny, nx = (n // BIN * BIN for n in image.shape)
    return image[:ny, :nx].reshape(ny // BIN, BIN, nx // BIN, BIN).sum(axis=(1, 3), dtype=np.float32)


def _decimated(image):
    ny, nx = (n // BIN * BIN for n in image.shape)
    return np.ascontiguousarray(image[:ny:BIN, :nx:BIN])


def _full_size(binned, shape):
    """Repeat a binned map to the frame's shape; a last odd row or column gets zero."""
    full = np.zeros(shape, binned.dtype)
    ny, nx = (BIN * n for n in binned.shape)
    full[:ny, :nx] = np.repeat(np.repeat(binned, BIN, axis=0), BIN, axis=1)
    return full


def _unskewed(level, rms):
    """Return the mean of Poisson + Gaussian noise whose mode estimate is `level`, electron; changes `level`.

    Source Extractor takes 2.5 median - 1.5 mean as the background. For slightly skewed noise the median is
    below the mean by k3 / (6 rms^2), and the third cumulant k3 of sky and dark electrons is their mean; so
    the estimate is low by 5 / 12 of mean / rms^2: 0.2-0.4 electron, 1 % of the flux of a source at S/N 10.
    """
    level += np.float32(5.0 / 12.0) * np.maximum(level, np.float32(0.0)) / rms**2
    return level
