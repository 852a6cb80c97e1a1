"""Measured tables fabricated for tests of merging."""

import numpy as np

from csstsim.catalog.table import ObjectTable
from csstsim.measure.bricks.merge import DETECTION_COLUMNS

ARCSEC = 1.0 / 3600.0  # deg


def table(ra, dec, *, obsid="1", chip=8, band="g", flux=1000.0, snr=20.0, pos_err=0.01, zeropoint=30.0):
    n = len(ra)
    columns = {
        "obsid": np.full(n, obsid), "chip": np.full(n, chip, np.int16), "filter": np.full(n, band),
        "number": np.arange(n, dtype=np.int32), "ra": np.asarray(ra, float), "dec": np.asarray(dec, float),
        "pos_err": np.full(n, pos_err), "flux_psf": np.broadcast_to(flux, n).astype(float),
        "flux_psf_err": np.full(n, 50.0), "flux_kron": np.broadcast_to(flux, n) * 0.95,
        "flux_kron_err": np.full(n, 60.0), "flux_total": np.broadcast_to(flux, n) * 1.1,
        "flux_total_err": np.full(n, 70.0), "flux_gaap": np.broadcast_to(flux, n) * 0.8,
        "flux_gaap_err": np.full(n, 40.0), "zeropoint": np.full(n, zeropoint),
        "snr": np.broadcast_to(snr, n).astype(float),
        "star": np.ones(n, bool), "flags": np.full(n, 1 if obsid == "1" else 2, np.int32),
    }  # fmt: skip
    return ObjectTable({name: columns[name] for name in DETECTION_COLUMNS})
