"""Fabricated frames of stars and galaxies whose completeness, bias and scatter are known."""

import healpy
import numpy as np
from support.csst import BANDS, PIXEL

from csstsim.base.rng import stream
from csstsim.catalog.table import ObjectTable
from csstsim.measure.bricks.validation.measured_frame import MeasuredFrame

PIX = 123456
SCALE = 0.074 / 3600.0
RMS, N_EFF, ZEROPOINT = 7.7, 9.0, 31.5


def make_frame(band, seed, *, shift=0.0, keep=1.0, side=45, obsid="1", scatter=20.0, sky=None):
    """A frame of stars and galaxies on a lattice 50 px apart: magnitudes off by `shift`, `keep` of the faint found.

    Measured fluxes carry the noise of optimal photometry; sources with true S/N < 8 are kept with
    probability `keep`. Places scatter by `scatter` mas. sky: seed of the magnitudes, where it is not the noise's.
    """
    rng = stream(seed, "validate", band)
    x, y = (50.0 + 50.0 * v.ravel() for v in np.meshgrid(np.arange(side), np.arange(side)))
    n = x.size
    ra0, dec0 = healpy.pix2ang(256, PIX, nest=True, lonlat=True)
    dec = dec0 + (y - y.mean()) * SCALE
    ra = ra0 + (x - x.mean()) * SCALE / np.cos(np.radians(dec0))
    base = stream(seed if sky is None else sky, "magnitudes").uniform(20.0, 26.5, n)
    kind = np.where(np.arange(n) % 3 == 0, 0, 1)
    mags = {f"mag_{b}": (base + 0.5 * (BANDS.index("r") - k)).astype(np.float32) for k, b in enumerate(BANDS)}
    electrons = 10.0 ** (-0.4 * (mags[f"mag_{band}"].astype(float) - ZEROPOINT))
    error = np.sqrt(electrons + N_EFF * RMS**2)
    truth = ObjectTable({
        "id": np.arange(n), "obj_type": kind, "ra_epoch": ra, "dec_epoch": dec, "x": x, "y": y, "electrons": electrons,
        "flags": np.zeros(n, np.int32), **mags,
    })  # fmt: skip
    found = np.flatnonzero((electrons / error > 8) | (rng.uniform(size=n) < keep))
    flux = (electrons + error * rng.normal(size=n)) * 10.0 ** (-0.4 * shift)
    noise = scatter / 3.6e6 * rng.normal(size=(2, n))
    full = {
        "obsid": np.full(n, obsid), "chip": np.full(n, 8 + BANDS.index(band)), "filter": np.full(n, band),
        "number": np.arange(n),
        "ra": ra + noise[0] / np.cos(np.radians(dec)), "dec": dec + noise[1], "pos_err": np.full(n, 0.02),
        **{f"flux_{kind}": flux for kind in ("psf", "kron", "total", "gaap")},
        **{f"flux_{kind}_err": error for kind in ("psf", "kron", "total", "gaap")},
        "mag_psf": ZEROPOINT - 2.5 * np.log10(np.maximum(flux, 1.0)),
        "mag_psf_err": 2.5 / np.log(10.0) * error / np.maximum(flux, 1.0),
        "zeropoint": np.full(n, ZEROPOINT), "snr": flux / error, "star": kind == 0, "flags": np.zeros(n, np.int32),
        "hsm_sigma": 1.5 + 0.01 * rng.normal(size=n), "hsm_e1": 0.02 * rng.normal(size=n),
        "hsm_e2": 0.02 * rng.normal(size=n), "psf_sigma": np.full(n, 1.5), "psf_e1": np.zeros(n), "psf_e2": np.zeros(n),
        "x": x - noise[0] / SCALE, "y": y + noise[1] / SCALE,
    }  # fmt: skip
    info = {
        "obsid": obsid, "chip": 8 + BANDS.index(band), "filter": "NUV" if band == "nuv" else band, "exptime": 150.0,
        "zeropoint": ZEROPOINT, "rms": RMS,
        "n_eff": N_EFF, "depth_5sigma": 26.0,
        "window": [0, int(x.max()) + 50, 0, int(y.max()) + 50],
    }  # fmt: skip
    return MeasuredFrame(truth, ObjectTable(full, info).take(found), seam=10_000, pixel=PIXEL, depth=(25.9, 26.1))
