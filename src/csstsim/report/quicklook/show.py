"""`csstsim show`: check the options, draw the picture, write the PNG."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from csstsim.base.errors import InputError
from csstsim.base.files.atomic import atomic_path
from csstsim.io.fits import open_fits, read_header, verify_hdu
from csstsim.report.quicklook.figure import DPI, SIDE, draw
from csstsim.report.quicklook.marks import brightest, load_marks
from csstsim.report.quicklook.picture import read_picture

if TYPE_CHECKING:
    from csstsim.base.types import PathLike
    from csstsim.catalog.table import ObjectTable
    from csstsim.report.quicklook.picture import Bounds, Picture

PNG = b"\x89PNG\r\n\x1a\n"


@dataclass(frozen=True, kw_only=True)
class ShowOptions:
    """What of an image is shown, and how: the options of `csstsim show`. Pixels count from 0."""

    stretch: str | None = None  # one of stretch.STRETCHES; None: asinh, of a mask log
    limits: tuple[float, float] | None = None  # (low, high) in the file's unit
    region: Bounds | None = None  # x0, x1, y0, y1, half-open; None: the whole image
    inset: tuple[int, int, int] | None = None  # x, y of its centre, size
    truth: bool = False  # mark objects of the truth table that belongs to the file
    truth_table: PathLike | None = None  # mark objects of this one
    limit: int = 100  # brightest objects that are marked
    size: int = SIDE  # pixels of the picture along the longer side
    subtract_overscan: bool = False


def show(path: PathLike, output: PathLike | None = None, options: ShowOptions | None = None) -> Path:
    """Write a PNG of the file `path` to `output` (default: next to it, .png) and return its path.

    Raises InputError for a file that cannot be shown, an option that does not fit it, or an output that is not a PNG.
    """
    options = options or ShowOptions()
    path = Path(path)
    if not path.is_file():
        raise InputError("no such file", file=path)
    target = _target(path, output)
    picture = read_picture(path, options.subtract_overscan)
    if damage := wrong_checksum(path):
        logging.getLogger("csstsim").warning("%s: %s; the picture may be wrong", path, damage)
        picture = replace(picture, remark=" ".join(filter(None, (picture.remark, f"({damage})"))))
    bounds = _region(picture, options.region) if options.region else picture.bounds
    inset = _inset(path, bounds, options.inset) if options.inset else None
    marked = options.truth or options.truth_table
    marks = _marks(picture, bounds, options.truth_table, options.limit) if marked else None
    figure = draw(picture, bounds, options.stretch, options.limits, marks, inset, options.size)
    with atomic_path(target) as temporary:
        figure.savefig(temporary, dpi=DPI)
    return target


def wrong_checksum(path: PathLike) -> str | None:
    """Return what is wrong with the checksums of a FITS file that has some, or None."""
    with open_fits(path) as file:
        for hdu in file:
            if "CHECKSUM" in read_header(hdu, path):
                try:
                    verify_hdu(hdu, path)
                except InputError:
                    return f"wrong CHECKSUM of HDU {hdu.get_extname() or 'primary'}: the file was changed or is damaged"
    return None


def _target(path: Path, output: PathLike | None) -> Path:
    """Return the path of the PNG; an existing file that is not a PNG is not overwritten."""
    target = Path(output) if output is not None else path.with_suffix(".png")
    if target.suffix.lower() != ".png":
        raise InputError("not the name of a PNG", file=target, key="--output", allowed="a name that ends with .png")
    if target.exists():
        with open(target, "rb") as file:
            if file.read(len(PNG)) != PNG:
                raise InputError("already exists and is not a PNG", file=target, key="--output", allowed="another name")
    return target


def _region(picture: Picture, region: Bounds) -> Bounds:
    x0, x1, y0, y1 = region
    left, right, low, high = picture.bounds
    if not (left <= x0 < x1 <= right and low <= y0 < y1 <= high):
        allowed = f"X0 < X1 within {left} to {right}, Y0 < Y1 within {low} to {high}"
        raise InputError("not a part of the image", file=picture.path, key="--region", value=region, allowed=allowed)
    return region


def _inset(path: Path, bounds: Bounds, inset: tuple[int, int, int]) -> Bounds:
    """Return the bounds of an inset, clipped to `bounds`."""
    x, y, size = inset
    x0, x1, y0, y1 = bounds
    if size < 1 or not (x0 <= x < x1 and y0 <= y < y1):
        allowed = f"X from {x0} to {x1 - 1}, Y from {y0} to {y1 - 1}, SIZE from 1"
        raise InputError("not in the part that is shown", file=path, key="--inset", value=inset, allowed=allowed)
    left = x - size // 2
    low = y - size // 2
    return max(left, x0), min(left + size, x1), max(low, y0), min(low + size, y1)


def _marks(picture: Picture, bounds: Bounds, table: PathLike | None, limit: int) -> ObjectTable:
    if not picture.on_chip:
        raise InputError(
            "the frame's pixels are not the chip's, so the truth cannot be marked on it",
            file=picture.path,
            key="--truth",
            allowed="a Level-0, render-stage or calibrated file",
        )
    truth = load_marks(picture.path, None if table is None else Path(table))
    chip = str(picture.header.get("DETECTOR", ""))
    if "chip" in truth and len(truth) and chip.isdigit() and int(chip) != truth["chip"][0]:
        raise InputError(
            "the truth of another chip", file=table, key="--truth-table", value=int(truth["chip"][0]), allowed=int(chip)
        )
    return brightest(truth, bounds, limit)
