"""arcticpy (Massey et al. 2014), if it is installed: charge transfer along columns, in the mean of many electrons.

arcticpy 2.6 needs GSL and a compiler: apt-get install libgsl-dev g++ make; pip install cython numpy;
pip install --no-build-isolation --no-deps arcticpy. docs/detector_cti.md describes how its default differs from the
paper's process.
"""

import importlib.util
from collections.abc import Iterable
from typing import Any

import numpy as np

from csstsim.base.types import FloatArray

INSTALLED = importlib.util.find_spec("arcticpy") is not None


def arctic(
    columns: FloatArray,
    density: Iterable[float],
    timescale: Iterable[float],
    well: tuple[float, float, float],
    express: int = 5,
    **roe: Any,
) -> FloatArray:
    """Return `columns`, (ny,) or (ny, nx), as float64 after arcticpy's parallel transfer; roe: keywords of its ROE."""
    import arcticpy as ac

    beta, full_well, notch = well
    species = [ac.TrapInstantCapture(density=d, release_timescale=t) for d, t in zip(density, timescale, strict=True)]
    return np.asarray(
        ac.add_cti(
            columns.reshape(len(columns), -1).astype(float),
            parallel_roe=ac.ROE([1.0], **roe),
            parallel_express=express,
            verbosity=0,
            parallel_ccd=ac.CCD(full_well_depth=full_well, well_fill_power=beta, well_notch_depth=notch),
            parallel_traps=species,
        )
    ).reshape(columns.shape)
