"""One laboratory map: a FITS image, of which only the pixels of a window are read.

The header has what is needed before pixels are read: shape and type; DATASUM, which represents the content in recipes;
and DATAMAX, the upper limit with which photons are sampled before single ones are removed. Pixels are checked when they
are read; `check` reads all of them before any work.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.files.file_log import logged
from csstsim.base.files.fits_headers import check_headers
from csstsim.base.help_page import explained
from csstsim.base.plural import number_of
from csstsim.base.types import AnyArray, IntArray, PathLike
from csstsim.instrument.maps.kinds import DEFECTS, MapKind

if TYPE_CHECKING:
    from csstsim.detector.channels import ReadoutFrame
    from csstsim.instrument.chip import Detector

_TYPES = {">f4": "BITPIX -32 (float32)", "u1": "BITPIX 8 (uint8)"}
_BITPIX = {">f4": -32, "u1": 8}
_CHUNK = 1 << 22  # words summed at a time


@dataclass(frozen=True, eq=False)
class LabMap:
    """A map on disk with a checked header.

    layout: active (rows and columns of the chip's active pixels), or one of detector.channels.LAYOUTS. maximum: DATAMAX
    of a map that multiplies flux, else the kind's upper limit; datasum: the header's DATASUM, as text.
    """

    path: Path
    kind: MapKind
    shape: tuple[int, int]
    layout: str
    maximum: float
    datasum: str
    _data: tuple[int, int]  # offsets in the file of the first byte, and of the first byte after the data

    @explained("laboratory map")
    def part(self, rows: slice, columns: slice) -> AnyArray:
        """Return the values of slices of rows and columns (ny, nx), float32 or uint8; steps may be negative.

        Raises InputError for a value that is not allowed.
        """
        ny, nx = self.shape
        indices = np.ix_(np.arange(ny)[rows], np.arange(nx)[columns])
        return self._checked(np.ascontiguousarray(self._pixels()[rows, columns]), indices)

    @explained("laboratory map")
    def at(self, row: IntArray, column: IntArray) -> AnyArray:
        """Return the values (n,) of single pixels, row and column int (n,). Raises InputError as `part`."""
        return self._checked(self._pixels()[row, column], (row, column))

    @explained("laboratory map")
    def check(self) -> None:
        """Read all pixels. Raises InputError for a value that is not allowed, a wrong mean or another DATASUM."""
        mean = self.kind.mean(self.part(slice(None), slice(None)))
        low = self.kind.mean_low
        high = self.kind.mean_high
        if not low <= mean <= high:
            name = "fraction of bad pixels" if self.kind.name == "bad_pixels" else f"mean [{self.kind.unit}]"
            raise InputError(f"the {name} is out of range", file=self.path, value=mean, allowed=f"{low:g} to {high:g}")
        if self.datasum != str(self._sum()):
            raise InputError(
                "the pixels were changed after the header",
                file=self.path,
                key="DATASUM",
                value=self.datasum,
                allowed=f"{self._sum()}; write the file with checksum=True",
            )

    def _pixels(self) -> AnyArray:
        with logged("opened", self.path):
            return np.memmap(self.path, self.kind.stored, "r", self._data[0], self.shape)

    def _checked(self, values: AnyArray, indices: Sequence[IntArray]) -> AnyArray:
        """Return values in native byte order. indices: their rows and columns, arrays that broadcast to values."""
        values = values.astype(values.dtype.newbyteorder("="), copy=False)
        if self.kind.name == "bad_pixels":
            wrong = (values & ~np.uint8(self.kind.high)) != 0
        elif values.size and self.kind.low <= values.min() and values.max() <= np.float32(self.maximum):
            return values  # NaN fails the comparison
        else:
            wrong = ~((values >= self.kind.low) & (values <= np.float32(self.maximum)))
        if wrong.any():
            first = np.unravel_index(wrong.argmax(), wrong.shape)
            y, x = (int(np.broadcast_to(axis, wrong.shape)[first]) for axis in indices)
            count = number_of(int(np.count_nonzero(wrong)), "pixel")
            raise InputError(
                f"{count} out of range or not finite, the first at x {x}, y {y} (from 0)",
                file=self.path,
                value=values[first].item(),
                allowed=self._allowed(),
            )
        return values

    def _allowed(self) -> str:
        if self.kind.name == "bad_pixels":
            return f"0, or a sum of {', '.join(f'{bit} {name}' for name, bit in DEFECTS.items())}"
        declared = " (DATAMAX)" if self.kind.loss else ""
        return f"{self.kind.low:g} to {self.maximum:g}{declared} {self.kind.unit}"

    def _sum(self) -> int:
        """Return the ones' complement sum of the data's 32-bit words (FITS standard 4.0, appendix J)."""
        start, stop = self._data
        words = np.memmap(self.path, ">u4", "r", start, ((stop - start) // 4,))
        total = sum(int(words[at : at + _CHUNK].sum(dtype=np.uint64)) for at in range(0, words.size, _CHUNK))
        while total >> 32:
            total = (total & 0xFFFFFFFF) + (total >> 32)
        return total


def frame_of(lab_map: LabMap, frame: "ReadoutFrame") -> AnyArray:
    """Return the values (frame.shape) of a map of the readout in a detector.channels.ReadoutFrame, as on the chip.

    Raises InputError for a value that is not allowed.
    """
    values = np.empty(frame.shape, np.dtype(lab_map.kind.stored).newbyteorder("="))
    for in_frame, in_map in frame.pieces(lab_map.layout):
        values[in_frame] = lab_map.part(*in_map)
    return values


@explained("laboratory map")
def open_map(path: PathLike, kind: MapKind, detector: "Detector") -> LabMap:
    """Return the LabMap of a file, of which only headers are read.

    Raises InputError for a file that is missing or not FITS, for none or several images, for another shape or type, and
    for a header without DATASUM or, if the map multiplies flux, without an allowed DATAMAX.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"no such map ({kind.name})", file=path)
    check_headers(path)
    header, data = _only_image(path)
    shape = (header.get("NAXIS2"), header.get("NAXIS1")) if header.get("NAXIS") == 2 else (header.get("NAXIS"),)
    shapes = kind.shapes(detector)
    if shape not in shapes:
        allowed = " or ".join(f"{ny} rows of {nx} ({layout})" for (ny, nx), layout in shapes.items())
        raise InputError("wrong shape", file=path, key="NAXIS", value=shape, allowed=allowed)
    scaled = header.get("BSCALE", 1) != 1 or header.get("BZERO", 0) != 0
    if header.get("BITPIX") != _BITPIX[kind.stored] or scaled:
        value = "scaled (BSCALE, BZERO)" if scaled else header.get("BITPIX")
        raise InputError("wrong type", file=path, key="BITPIX", value=value, allowed=_TYPES[kind.stored])
    datasum = str(header.get("DATASUM", "")).strip()
    if not datasum.isdigit():
        raise InputError("missing", file=path, key="DATASUM", allowed="a file written with checksum=True")
    return LabMap(path, kind, shape, shapes[shape], _maximum(header, kind, path), datasum, data)


def _maximum(header: Mapping[str, Any], kind: MapKind, path: Path) -> float:
    """Return DATAMAX of a map that multiplies flux, else the upper limit of its kind."""
    if not kind.loss:
        return kind.high
    value = header.get("DATAMAX")
    allowed = f"{kind.low:g} to {kind.high:g}, the largest value of the map"
    if value is None:
        raise InputError("missing: required if the map multiplies flux", file=path, key="DATAMAX", allowed=allowed)
    if isinstance(value, bool) or not isinstance(value, int | float) or not kind.low <= value <= kind.high:
        raise InputError("out of range", file=path, key="DATAMAX", value=value, allowed=allowed)
    return float(value)


def _only_image(path: Path) -> tuple[Mapping[str, Any], tuple[int, int]]:
    """Return (header, (offset of the data, offset of the first byte after them)) of a file's only image."""
    import fitsio

    try:
        with fitsio.FITS(path) as file:
            images = [hdu for hdu in file if hdu.get_exttype() == "IMAGE_HDU" and hdu.get_info()["ndims"]]
            if len(images) != 1 or len(file) > 2 or images[0].is_compressed():
                names = ", ".join(hdu.get_extname() or "primary" for hdu in images) or "none"
                allowed = "one image, in the primary HDU or the first extension, not compressed"
                raise InputError("must have one image", file=path, key="HDU", value=names, allowed=allowed)
            header = images[0].read_header()
            offsets = images[0].get_offsets()
    except (OSError, ValueError) as exc:
        reason = str(exc).strip().splitlines()[0] if str(exc).strip() else "a header is damaged"
        raise InputError(f"not a readable FITS file: {reason}", file=path) from None
    if offsets["data_end"] > path.stat().st_size:
        raise InputError("the FITS file is cut short", file=path)
    return header, (offsets["data_start"], offsets["data_end"])
