"""Calibrated images: SCI and ERR [e-/s, float32] and DQ (bits, uint8) of a Level-0 file's window, one FITS file.

SCI is corrected for bias, background, flat field, shutter and moved charge; BACKMED is the median of the subtracted
background. ERR is the noise of each pixel: shot noise of all its electrons and read noise. The world coordinates are
ICRS at the epoch of the exposure (optics.geometry.icrs_header). Those of Level-0 are apparent.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

from csstsim.base.files.atomic import atomic_path
from csstsim.io.fits_writing import card, remark, write_hdus
from csstsim.optics.geometry.icrs_header import icrs_header

if TYPE_CHECKING:
    from csstsim.base.types import FloatArray, IntArray, PathLike
    from csstsim.io.level0 import Level0
    from csstsim.optics.geometry.wcs import ChipWCS

# Copied from the Level-0 file's primary header: the exposure, and the state of the spacecraft
COPIED = (
    "TELESCOP", "INSTRUME", "DETECTOR", "FILTER", "OBJECT", "OBSID", "EPHEM", "LDPLANET", "DATE-OBS", "DATE-END",
    "EXPSTART", "EXPEND", "EXPTIME", "RA_PNT0", "DEC_PNT0", "POS_ANG0", "POSI0_X", "POSI0_Y",
    "POSI0_Z", "VELO0_X", "VELO0_Y", "VELO0_Z", "SIMVER", "SIMSEED", "CAMPHASH", "CAMHASH", "LAYHASH", "EXPHASH",
)  # fmt: skip
DQ = {1: "saturated", 2: "defect, known from calibration", 4: "cosmic ray"}


class CalibratedPlanes(NamedTuple):
    """The planes of a window (ny, nx): SCI and ERR [e-/s], DQ (bits, uint8)."""

    science: FloatArray
    error: FloatArray
    quality: IntArray


def write_calibrated(
    path: PathLike,
    file: Level0,
    wcs: ChipWCS,
    planes: CalibratedPlanes,
    *,
    background: float,
    zeropoint: float,
    read_noise: float,
    settings: Mapping[str, Any],
) -> None:
    """Write a calibrated image.

    file: io.level0.Level0; wcs: its ChipWCS; planes: of its window; background [e-/s]; zeropoint: AB magnitude of
    1 e-/s; read_noise [e-]; settings: {name: value} of the campaign's `measurement`, for HISTORY.
    """
    primary = [card(name, file.header0[name]) for name in COPIED if name in file.header0]
    primary += [remark("HISTORY", f" calibrated from {file.path.name}"), remark("HISTORY", f" {settings}")]
    window = file.window
    window_cards = [card(key, value) for key, value in icrs_header(wcs, file.observer, window).items()]
    window_cards += [
        card("READX0", window.x0 + 1, "first column, on the chip, counted from 1"),
        card("READX1", window.x1, "last column"),
        card("READY0", window.y0 + 1, "first row"),
        card("READY1", window.y1, "last row"),
    ]
    unit_card = card("BUNIT", "electron/s")
    science = [
        unit_card,
        *window_cards,
        card("BACKMED", background, "[electron/s] median background taken off"),
        card("MAGZERO", zeropoint, "AB magnitude of 1 electron/s"),
        card("RDNOISE", read_noise, "[electron] rms"),
    ]
    bits = [card(f"BIT{bit.bit_length() - 1}", name, f"value {bit}") for bit, name in DQ.items()]
    with atomic_path(path) as temporary:
        write_hdus(
            temporary,
            [
                ("", primary, None),
                ("SCI", science, planes.science),
                ("ERR", [unit_card, *window_cards], planes.error),
                ("DQ", [*window_cards, *bits], planes.quality),
            ],
        )
