"""Catalogues of a calibrated image by sep and photutils, used as their own tutorials do; one process each.

    python benchmarks/catalogue_peers.py sep CALIBRATED.fits TABLE.parquet

sep: background on meshes of 64 px, 1.5 sigma on 5 px, its 3 x 3 kernel, deblending and cleaning, windowed positions,
Kron fluxes. photutils: median background on meshes of 50 px, a Gaussian kernel of 3 px, 1.5 sigma on 10 px, deblending
of 32 levels and contrast 0.001, Kron fluxes. Both leave out the pixels with a defect or a cosmic ray.
"""

import sys
from functools import partial

import numpy as np
from astromatic import THRESHOLD, UNUSABLE, gauss, planes
from astropy.io import fits

from csstsim.catalog.table import ObjectTable


def with_sep(image, bad, exptime, deep=False):
    """Return columns x, y [px of the image], flux and err [the image's unit]. image: e-/s; bad: pixels left out.

    deep: with a kernel as wide as the PSF, and `astromatic.THRESHOLD` on its pixels.
    """
    import sep

    sep.set_extract_pixstack(image.size // 8)
    sep.set_sub_object_limit(8192)
    background = sep.Background(image, mask=bad)
    rms = background.rms()
    image -= background.back()
    if deep:
        found = sep.extract(image, THRESHOLD, err=rms, mask=bad, minarea=1, filter_kernel=gauss().astype(np.float32))
    else:
        found = sep.extract(image, 1.5, err=background.globalrms, mask=bad)
    found = found[np.isfinite(found["a"] + found["b"] + found["theta"]) & (found["b"] > 0)]
    x, y, a, b = (found[name] for name in ("x", "y", "a", "b"))
    theta = np.clip(found["theta"], -0.5 * np.pi, 0.5 * np.pi)
    reach, _ = sep.kron_radius(image, x, y, a, b, theta, 6.0, mask=bad)
    light = {"err": rms, "mask": bad, "gain": exptime}
    # As its documentation gives FLUX_AUTO: small sources in a circle of 1.75 px
    small = ~(reach * np.sqrt(a * b) >= 1.75)
    flux, err, _ = sep.sum_circle(image, x, y, 1.75, **light)
    some = ~small
    flux[some], err[some], _ = sep.sum_ellipse(
        image, x[some], y[some], a[some], b[some], theta[some], 2.5 * reach[some], subpix=1, **light
    )
    radius, _ = sep.flux_radius(image, x, y, 6.0 * a, 0.5, mask=bad, normflux=flux, subpix=5)
    wx, wy, failed = sep.winpos(image, x, y, 2.0 / 2.35 * np.where(radius > 0, radius, 0.5), mask=bad)
    good = (failed == 0) & (np.hypot(wx - x, wy - y) < 2.0)
    return {"x": np.where(good, wx, x), "y": np.where(good, wy, y), "flux": flux, "err": err}


def with_photutils(image, bad, exptime):
    """Return the same by photutils."""
    from astropy.convolution import convolve
    from photutils.background import Background2D, MedianBackground
    from photutils.segmentation import SourceCatalog, deblend_sources, detect_sources, make_2dgaussian_kernel
    from photutils.utils import calc_total_error

    background = Background2D(image, (50, 50), mask=bad, filter_size=(3, 3), bkg_estimator=MedianBackground())
    image -= background.background.astype(np.float32)
    rms = background.background_rms.astype(np.float32)
    smooth = convolve(image, make_2dgaussian_kernel(3.0, size=5)).astype(np.float32)
    segments = detect_sources(smooth, 1.5 * rms, 10, mask=bad)
    segments = deblend_sources(smooth, segments, 10, n_levels=32, contrast=0.001, progress_bar=False)
    error = calc_total_error(image, rms, exptime)
    found = SourceCatalog(image, segments, convolved_data=smooth, error=error, mask=bad)
    columns = {"x": found.x_centroid, "y": found.y_centroid, "flux": found.kron_flux, "err": found.kron_flux_err}
    return {name: np.asarray(values, float) for name, values in columns.items()}


CODES = {"sep": with_sep, "sep-deep": partial(with_sep, deep=True), "photutils": with_photutils}


def main(code, calibrated, path):
    exptime = fits.getval(calibrated, "EXPTIME")
    image, rms, _, header = planes(calibrated, exptime)
    image = np.ascontiguousarray(image, np.float32)
    found = CODES[code](image, rms == UNUSABLE, exptime)
    table = ObjectTable(
        {
            "x": found["x"] + header["READX0"] - 1.0, "y": found["y"] + header["READY0"] - 1.0,
            "flux": found["flux"] * exptime, "snr": found["flux"] / np.where(found["err"] > 0, found["err"], np.inf),
        }
    )  # fmt: skip
    table.write(path)


if __name__ == "__main__":
    main(*sys.argv[1:])
