"""Reads files that can be shown: Level-0 files, frames between the stages, any other FITS image."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from csstsim.base.errors import InputError, first_line
from csstsim.base.types import AnyArray, FloatArray, PathLike
from csstsim.io.fits import open_fits, read_header
from csstsim.io.frames import META, load_frame
from csstsim.io.level0 import read_level0
from csstsim.report.quicklook.sky_grid import exposure_wcs, header_wcs

if TYPE_CHECKING:
    from astropy.io.fits.hdu.base import _BaseHDU
    from astropy.wcs import WCS

    from csstsim.io.level0 import Level0

ALLOWED = "a Level-0 file, a frame of the render or readout stage, or a FITS file with a 2-d image"
Bounds: TypeAlias = tuple[int, int, int, int]  # x0, x1, y0, y1, half-open
_CHIP_FOLDER = re.compile(r"(\d+)_(\d\d)")  # chips/{obsid}_{chip}/


@dataclass(frozen=True, eq=False)
class Picture:
    """An image (2-D, any real type) and its description. `image[0, 0]` is pixel `origin` = (x, y), 0-based."""

    path: Path
    image: AnyArray
    kind: str  # the kind of file, for the title
    unit: str
    header: dict[str, Any]  # OBSID, DETECTOR or CHIPID, FILTER, EXPTIME, if the file has them
    origin: tuple[int, int] = (0, 0)
    on_chip: bool = True  # whether pixel coordinates are the chip's; False for a readout frame
    wcs: WCS | None = None  # astropy WCS of the same pixels, or None
    remark: str = ""
    bits: int | None = None  # the sum of the bits that a mask may have; None: the image is no mask

    @property
    def bounds(self) -> Bounds:
        """x0, x1, y0, y1 of the image, half-open."""
        (x0, y0), (ny, nx) = self.origin, self.image.shape
        return x0, x0 + nx, y0, y0 + ny

    def part(self, bounds: Bounds) -> AnyArray:
        """Return the pixels of `bounds` (x0, x1, y0, y1, half-open, within the image's)."""
        x0, x1, y0, y1 = bounds
        return self.image[y0 - self.origin[1] : y1 - self.origin[1], x0 - self.origin[0] : x1 - self.origin[0]]

    @property
    def title(self) -> str:
        """Two lines: exposure, chip, filter, time and kind, as far as they are known; then the file's name."""
        chip = self.header.get("CHIPID", self.header.get("DETECTOR"))
        words = [
            f"exposure {self.header['OBSID']}" if "OBSID" in self.header else None,
            f"chip {chip}" if chip is not None else None,
            self.header.get("FILTER"),
            f"{self.header['EXPTIME']:g} s" if isinstance(self.header.get("EXPTIME"), int | float) else None,
            self.kind,
        ]
        return ", ".join(str(word) for word in words if word) + f"\n{self.path.name}"


def read_picture(path: PathLike, subtract_overscan: bool = False) -> Picture:
    """Read any file that can be shown; `subtract_overscan` subtracts each channel's overscan level (Level-0 only).

    Raises InputError for a file that is missing, damaged or holds no 2-d image.
    """
    path = Path(path)
    with open_fits(path) as file:
        names = {hdu.get_extname() for hdu in file}
        level0 = "IMAGE" in names and "NCHAN" in read_header(file["IMAGE"], path)
    if subtract_overscan and not level0:
        raise InputError("has no overscan", file=path, key="--subtract-overscan", allowed="a Level-0 file")
    if META in names:
        return _frame(path)
    return _level0(path, subtract_overscan) if level0 else _other(path)


def _level0(path: Path, subtract_overscan: bool) -> Picture:
    file = read_level0(path)
    image = _levelled(file) if subtract_overscan else file.assembled()
    header = file.header0 | file.header
    wcs, remark = exposure_wcs(header)
    kind = "Level-0, overscan level subtracted" if subtract_overscan else "Level-0"
    return Picture(path, image, kind, "DN", header, (file.window.x0, file.window.y0), wcs=wcs, remark=remark)


def _levelled(file: Level0) -> FloatArray:
    """Return the active pixels of a Level0 minus the median of each channel's serial overscan, float32."""
    window = file.window
    image = np.empty(window.shape, np.float32)
    for channel in file.channels():
        active = channel.window
        scan = channel.serial_overscan
        if not scan.size:
            raise InputError("has no overscan", file=file.path, key="--subtract-overscan")
        target = image[active.y0 - window.y0 : active.y1 - window.y0, active.x0 - window.x0 : active.x1 - window.x0]
        np.subtract(channel.active, np.float32(np.median(scan)), out=target)
    return image


def _frame(path: Path) -> Picture:
    """Read a frame between the stages: its plane `image`, plus its plane `counted` if there is one."""
    planes, meta = load_frame(path)
    image = planes.get("image")
    if image is None:
        if not planes:
            raise InputError("holds no image", file=path, allowed=ALLOWED)
        image = next(iter(planes.values()))
    if "counted" in planes:
        np.add(image, planes["counted"], out=image, casting="same_kind")
    header = dict(meta.get("exposure") or {})
    if not header and (found := _CHIP_FOLDER.fullmatch(path.resolve().parent.name)):
        header = {"OBSID": found[1], "DETECTOR": found[2]}
    origin = _window_origin(header, image.shape)
    wcs, remark = exposure_wcs(header) if origin else (None, "")
    stage = f"{meta['stage']} stage" if "stage" in meta else path.stem
    return Picture(path, image, stage, str(meta.get("unit", "")), header, origin or (0, 0), bool(origin), wcs, remark)


def _window_origin(header: Mapping[str, Any], shape: tuple[int, ...]) -> tuple[int, int] | None:
    """Return the 0-based corner (x, y) of the window READX0 ... READY1 if `shape` is that window's, else None."""
    try:
        x0, x1, y0, y1 = (int(header[f"READ{axis}"]) for axis in ("X0", "X1", "Y0", "Y1"))
    except (KeyError, TypeError, ValueError):
        return None
    return (x0 - 1, y0 - 1) if shape == (y1 - y0 + 1, x1 - x0 + 1) else None


def _other(path: Path) -> Picture:
    """Read the first 2-d image of a FITS file, and its WCS."""
    from astropy.io import fits

    try:
        with fits.open(path, memmap=not _scaled(path)) as file:
            found = next((hdu for hdu in file if _is_image(hdu)), None)
            if found is None:
                raise InputError("no extension holds a 2-d image", file=path, allowed=ALLOWED)
            image = found.data
            header = dict(file[0].header) | dict(found.header)
            origin = _window_origin(header, image.shape) or (0, 0)
            wcs = header_wcs(found.header, origin)
    except (OSError, ValueError, TypeError, LookupError, AttributeError, fits.VerifyError) as exc:
        why = first_line(exc)
        raise InputError(f"not a readable FITS file: {why}", file=path, allowed=ALLOWED) from None
    name = found.name
    remark = _statistics(image) if "DATAMAX" in header else ""
    bits = None
    if _is_mask(image, name):
        bits = 2 ** max(int(image.max()), 1).bit_length() - 1
        bad = np.count_nonzero(image)
        remark = f"{bad} of {image.size} pixels are not 0 ({bad / image.size:.2g} of all)"
    kind = {"SCI": "calibrated", "PRIMARY": "image", "": "image"}.get(name, f"extension {name}")
    unit = str(header.get("BUNIT", "" if bits is None else "bits of the mask"))
    return Picture(path, image, kind, unit, header, origin, wcs=wcs, remark=remark, bits=bits)


def _scaled(path: Path) -> bool:
    """Whether an image of a FITS file has a scale, which astropy applies to what it reads, not to mapped memory."""
    from astropy.io import fits

    with fits.open(path, memmap=True, do_not_scale_image_data=True) as file:
        return any(keyword in hdu.header for hdu in file for keyword in ("BSCALE", "BZERO", "BLANK"))


def _is_mask(image: AnyArray, name: str) -> bool:
    """Whether an image is a mask of bits: a bad-pixel map (8-bit integers), or the extension DQ or MASK."""
    return image.dtype.kind in "iu" and (image.dtype.itemsize == 1 or name in ("DQ", "MASK"))


def _statistics(image: AnyArray) -> str:
    """Return what a laboratory map's contract is about (instrument.maps), as a line."""
    low = float(np.nanmin(image))
    high = float(np.nanmax(image))
    mean = float(np.nanmean(image, dtype=float))
    rms = float(np.nanstd(image, dtype=float))
    return f"mean {mean:.6g}, rms {rms:.3g}, from {low:.6g} to {high:.6g}"


def _is_image(hdu: _BaseHDU) -> bool:
    return bool(hdu.is_image) and len(getattr(hdu, "shape", ())) == 2 and 0 not in hdu.shape  # damaged: no shape
