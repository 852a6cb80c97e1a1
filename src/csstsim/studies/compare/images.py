"""FITS files compared: headers, planes of pixels, records; Level-0 files in any layout."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from csstsim.base.errors import InputError
from csstsim.io.fits import open_fits, read_header, read_pixels, verify_hdu
from csstsim.io.frames import META
from csstsim.studies.compare.facts import Difference, Fact, array_facts, only_in_one
from csstsim.studies.compare.raw_image import raw_image
from csstsim.studies.compare.records import record_facts
from csstsim.studies.compare.varying import is_provenance, varies

if TYPE_CHECKING:
    from fitsio import FITS
    from fitsio.hdu.base import HDUBase

    from csstsim.detector.channels import Block, ReadoutFrame
    from csstsim.studies.compare.raw_image import RawImage

# Keywords of how the pixels are stored: shape and type are compared as such
_STRUCTURE = re.compile(
    r"SIMPLE|XTENSION|EXTEND|EXTNAME|NEXTEND|BITPIX|NAXIS\d?|[PG]COUNT|BSCALE|BZERO|TFIELDS|T(TYPE|FORM)1|LONGSTRN|CONTINUE|"
    r"Z(IMAGE|SIMPLE|TENSION|EXTEND|BITPIX|NAXIS\d?|[PG]COUNT|CMPTYPE|QUANTIZ|DITHER0|(TILE|NAME|VAL)\d|HECKSUM|DATASUM)"
)
# Keywords of a Level-0 file's layout: position of the channels, and the WCS of each, in stored pixels
_LAYOUT = re.compile(
    r"LAYOUT|[DTBC]SEC\d\d|(WCSAXES|WCSNAME|(CTYPE|CUNIT|CRVAL|CRPIX)[12]|CD[12]_[12]|LONPOLE|LATPOLE|RADESYS)[A-P]"
)
_UNITS = {"ADU": "DN"}


def fits_facts(a: Path, b: Path) -> Iterator[Fact]:
    """Yield Facts about two FITS files. Raises InputError for one that is damaged."""
    with open_fits(a) as first, open_fits(b) as second:
        files = (first, a), (second, b)
        for file, path in files:
            for hdu in file:
                if "CHECKSUM" in read_header(hdu, path):
                    verify_hdu(hdu, path)
        raw = [image for image in [raw_image(*file) for file in files] if image is not None]
        if len(raw) == 2:
            yield from _raw_facts(files, raw)
        else:
            yield from _plane_facts(files)


def _plane_facts(files: Sequence[tuple[FITS, Path]]) -> Iterator[Fact]:
    """Yield Facts about headers, planes and the record of two files, plane by plane."""
    planes_of_files = [{hdu.get_extname() or f"HDU {i}": hdu for i, hdu in enumerate(file)} for file, _ in files]
    yield from only_in_one("planes", *planes_of_files)
    paths = [path for _, path in files]
    records = [_record(planes, path) for planes, path in zip(planes_of_files, paths, strict=True)]
    for name in (name for name in planes_of_files[0] if name in planes_of_files[1]):
        pair = [(planes[name], path) for planes, path in zip(planes_of_files, paths, strict=True)]
        if name == META:
            yield from record_facts("record: ", *records)
            continue
        headers = [_cards(*hdu) for hdu in pair]
        yield from record_facts(f"{name}: ", *headers)
        pixels_a, pixels_b = (read_pixels(*hdu) if read_header(*hdu).get("NAXIS") else None for hdu in pair)
        if pixels_a is None or pixels_b is None:
            if pixels_a is not pixels_b:
                yield Fact(f"{name}: pixels in one file only")
            continue
        is_mask = pixels_a.dtype.itemsize == 1
        unit = "" if is_mask else headers[0].get("BUNIT", records[0].get("unit", ""))
        unit = _UNITS.get(unit, unit)
        yield from array_facts(name, pixels_a, pixels_b, noun="pixels", unit=unit, position=_pixel_position)


def _pixel_position(*index: int) -> str:
    return f"at {', '.join(f'{axis} {i}' for axis, i in zip('xyz', index[::-1], strict=False))}"


def _record(planes: Mapping[str, HDUBase], path: Path) -> dict[str, Any]:
    """Return the record in META, or {}."""
    if META not in planes:
        return {}
    try:
        record = json.loads(read_pixels(planes[META], path).tobytes())
    except (ValueError, RecursionError):
        record = None
    if not isinstance(record, dict):
        raise InputError("damaged: its record cannot be read", file=path, key=META)
    return record


def _raw_facts(files: Sequence[tuple[FITS, Path]], raw: Sequence[RawImage]) -> Iterator[Fact]:
    """Yield Facts about two Level-0 files: headers, between two layouts without _LAYOUT; pixels channel by channel."""
    layouts = {image.layout for image in raw}
    for name, hdu in (("HDU 0", 0), ("IMAGE", "IMAGE")):
        headers = [_cards(file[hdu], path) for file, path in files]
        if len(layouts) > 1:
            headers = [{key: header[key] for key in header if not _LAYOUT.fullmatch(key)} for header in headers]
        yield from record_facts(f"{name}: ", *headers)
    if raw[0].readout != raw[1].readout:
        shapes = [image.readout.stored_shape("mosaic") for image in raw]
        yield Fact(f"IMAGE: detectors of another geometry, {shapes[0]} and {shapes[1]} with overscan")
        return
    yield from only_in_one("planes", *(image.planes for image in raw))
    yield from only_in_one("channels", *(image.channels for image in raw))
    for plane in raw[0].planes:
        if plane in raw[1].planes:
            yield from _channel_facts(plane, raw)


def _channel_facts(plane: str, raw: Sequence[RawImage]) -> Iterator[Fact]:
    readout = raw[0].readout
    difference = Difference("pixels", "DN" if plane == "IMAGE" else "")
    types = []
    for block in readout.blocks:
        if all(block.channel in image.channels for image in raw):
            pixels_a, pixels_b = (image.pixels(plane, block) for image in raw)
            types = [pixels_a.dtype, pixels_b.dtype]
            if types[0] == types[1]:

                def position(i: int, block: Block = block) -> str:
                    return _pixel_in_channel(readout, block, *divmod(i, readout.block_nx))

                difference.add(pixels_a, pixels_b, position)
    if types and types[0] != types[1]:
        yield Fact(f"{plane}: {types[0]} and {types[1]}")
    if difference.count:
        yield Fact(f"{plane}: {difference.text()}")


def _pixel_in_channel(readout: ReadoutFrame, block: Block, row: int, column: int) -> str:
    """Return the position of a channel's pixel in words: in reading order, and on the chip if it is an active pixel."""
    (x0, step_x), (y0, step_y) = readout.stored_axis(block, "channels")
    x = x0 + step_x * (column + block.stored_x0)
    y = y0 + step_y * row
    inside = 0 <= column - readout.prescan < readout.channel_nx and row < readout.channel_ny
    return f"in channel {block.channel}, column {column}, row {row} ({f'chip x {x}, y {y}' if inside else 'overscan'})"


def _cards(hdu: HDUBase, path: Path) -> dict[str, Any]:
    """Return {keyword: value} and {"comment of KEYWORD": comment} of an HDU, without _STRUCTURE."""
    try:
        records = hdu.read_header().records()
    except (OSError, ValueError) as exc:  # also bytes that are no text
        raise InputError(f"a header is damaged: {type(exc).__name__}", file=path) from exc
    values: dict[str, Any] = {}
    for card in records:
        name = card["name"] or ""
        if name in ("COMMENT", "HISTORY", ""):
            values.setdefault(name or "blank", []).append(str(card["value"]))
        elif not _STRUCTURE.fullmatch(name):
            values[name] = card["value"]
            if not (varies(name) or is_provenance(name)):
                values[f"comment of {name}"] = card.get("comment", "")
    return values
