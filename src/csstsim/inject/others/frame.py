"""An image of any telescope and what its header states: WCS, electrons in a unit, exposure time, zero point."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.image_wcs import ImageWCS
from csstsim.base.types import AnyArray, BoolArray
from csstsim.inject.others.with_astropy import opened

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from typing import Any

    from astropy.io.fits import HDUList, Header

    from csstsim.base.types import FloatArray, PathLike

ELECTRONS = {"electron", "electrons", "e-", "e", "photoelectron"}
DN = {"adu", "dn", "count", "counts", "ct", "cts", "adus"}
GAINS = ("GAIN", "EGAIN", "CCDGAIN", "ATODGAIN")
TIMES = ("EXPTIME", "TEXPTIME", "XPOSURE", "EXPOSURE")
CONDITION_MAX = 1e6  # condition number above which the matrix of a WCS counts as singular
FILTERS = "FILTER", "FILTER1", "FILTER2", "FILTNAM1", "PUPIL", "BAND"
OPEN = "CLEAR", "OPEN", "NONE", "N/A", "EMPTY"  # beginnings of the names of empty positions in a filter wheel


@dataclass(frozen=True, eq=False)
class ForeignFrame:
    """An image of another telescope.

    number: of its HDU; image (ny, nx); error (same shape) or None, and its HDU; others: number of further images of
    that name in the file; electrons: in one unit of the image; exptime [s]; zeropoint: AB magnitude of 1 electron/s, or
    None; band: its filter, or ""; full: maximum of a pixel [unit of the image], or inf; flagged (ny, nx): whether DQ is
    not 0, or None without DQ.
    """

    path: Path
    number: int
    image: AnyArray
    wcs: ImageWCS
    electrons: float
    exptime: float
    zeropoint: float | None
    band: str
    full: float
    others: int = 0
    error: AnyArray | None = None
    error_number: int | None = None
    blank: int | None = None  # the value of pixels without one, in an image of integers
    flagged: BoolArray | None = None

    def has_value(self) -> BoolArray:
        """Return (ny, nx) bool: pixels that are finite numbers and not BLANK."""
        return np.isfinite(self.image) if self.blank is None else self.image != self.blank


def read_foreign(path: PathLike) -> ForeignFrame:
    """Return the ForeignFrame of a FITS file: of its extension SCI, or else its first 2-d image. Raises InputError."""
    path = Path(path)
    with opened(path) as file:
        number = next(
            (k for k, hdu in enumerate(file) if hdu.name == "SCI" and hdu.header.get("NAXIS") == 2),
            next((k for k, hdu in enumerate(file) if hdu.is_image and hdu.header.get("NAXIS") == 2), None),
        )
        if number is None or file[number].data is None:
            raise InputError("holds no image", file=path)
        header = {**file[0].header, **file[number].header}
        image = np.asarray(file[number].data)
        if image.dtype.kind == "f" and "ZCMPTYPE" in getattr(file[number], "_bintable", file[number]).header:
            allowed = "the image without compression, as by funpack"
            raise InputError("tiles of floats would be quantised again", file=path, key="ZCMPTYPE", allowed=allowed)
        wcs = _wcs(path, file, number)
        exptime = _number(header, TIMES)
        if exptime is None:
            raise InputError("no exposure time", file=path, key="EXPTIME", allowed=", ".join(TIMES))
        electrons, gain = _electrons(path, header, exptime)
        error_number = next((k for k, hdu in enumerate(file) if hdu.name == "ERR" and k > number), None)
        error = None if error_number is None else file[error_number].data
        quality = next((hdu.data for hdu in file[number:] if hdu.name == "DQ"), None)
        flagged = None if quality is None or quality.shape != image.shape else quality != 0
        if error is not None:
            _check_error(path, image, error, flagged)
        full = _number(header, ("SATURATE",))
        name = file[number].name
        others = sum(hdu.name == name and hdu.header.get("NAXIS") == 2 for hdu in file) - 1 if name == "SCI" else 0
        named = (str(header.get(keyword, "")).strip() for keyword in FILTERS)
        band = next((name for name in named if name and not name.upper().startswith(OPEN)), "")
        return ForeignFrame(
            path, number, image, wcs, electrons, exptime, _zeropoint(header, gain), band,
            np.inf if full is None else full, others, error, None if error is None else error_number,
            _blank(image, file[number].header), flagged,
        )  # fmt: skip


def _blank(image: AnyArray, header: Header) -> int | None:
    """Return the value of BLANK among an image's integers; BZERO makes them unsigned."""
    if image.dtype.kind not in "iu" or "BLANK" not in header:
        return None
    return int(header["BLANK"]) + int(header.get("BZERO", 0))


def _wcs(path: Path, file: HDUList, number: int) -> ImageWCS:
    header = file[number].header
    _check_matrix(path, _cd(header), "CD")  # before WCSLIB, which takes 1 for the diagonal of a row of zeros
    wcs = ImageWCS(header, path, file)
    _check_matrix(path, None if header["CD?_?"] else wcs.wcs.pixel_scale_matrix, "CDELT, PC")
    return wcs


def _cd(header: Header) -> FloatArray | None:
    """Return (2, 2) deg per pixel of CD as the header has it, or None."""
    if not header["CD?_?"]:
        return None
    return np.array([[header.get(f"CD{i}_{j}", 0.0) for j in (1, 2)] for i in (1, 2)], float)


def _check_matrix(path: Path, matrix: FloatArray | None, key: str) -> None:
    if matrix is not None and not np.linalg.cond(matrix) < CONDITION_MAX:
        raise InputError(
            "the WCS maps the image to a line",
            file=path,
            key=key,
            value=matrix.tolist(),
            allowed="a matrix from pixels to the sky that can be inverted",
        )


def _number(header: Mapping[str, Any], names: Sequence[str]) -> float | None:
    """Return the first keyword's value that is a number above 0, or None."""
    for name in names:
        try:
            value = float(header[name])
        except (KeyError, TypeError, ValueError):
            continue
        if 0 < value < np.inf:
            return value
    return None


def _electrons(path: Path, header: Mapping[str, Any], exptime: float) -> tuple[float, float | None]:
    """Return (electrons of one unit of the image, gain [e-/DN] or None where its unit is electrons)."""
    text = re.sub(r"[ .*]*s(ec|econd)?\s*(\^|\*\*)?\s*\(?-1\)?$", "/s", str(header.get("BUNIT", "")).lower())
    unit, _, per = text.replace(" ", "").partition("/")
    gain = _number(header, GAINS)
    time = {"": 1.0, "s": exptime, "sec": exptime, "second": exptime}.get(per)
    if time is not None and unit in ELECTRONS:
        return time, None
    if time is not None and (unit in DN or not unit) and gain is not None:
        return time * gain, gain
    allowed = f"BUNIT of electrons or electrons/s; or of DN, with {', '.join(GAINS)}"
    value = {name: header[name] for name in ("BUNIT", *GAINS) if name in header}
    raise InputError(
        "neither a gain nor a unit of electrons", file=path, key="BUNIT, GAIN", value=value, allowed=allowed
    )


def _zeropoint(header: Mapping[str, Any], gain: float | None) -> float | None:
    """Return the AB magnitude of 1 electron/s from PHOTFLAM and PHOTPLAM (HST data handbooks: ABMAG), or None.

    PHOTFLAM is of one unit a second: of DN where the image has a gain.
    """
    flam, plam = (_number(header, (name,)) for name in ("PHOTFLAM", "PHOTPLAM"))
    if flam is None or plam is None:
        return None
    return -2.5 * np.log10(flam / (gain or 1.0)) - 5 * np.log10(plam) - 2.408


def _check_error(path: Path, image: AnyArray, error: AnyArray, flagged: BoolArray | None) -> None:
    if error.shape != image.shape:
        raise InputError("not of the image's size", file=path, key="ERR", value=error.shape, allowed=image.shape)
    good = np.isfinite(image) if flagged is None else ~flagged
    wrong = int(np.count_nonzero(good & ~(np.isfinite(error) & (error >= 0))))
    if wrong:
        raise InputError(f"{wrong} of the errors of good pixels are below 0 or not numbers", file=path, key="ERR")
