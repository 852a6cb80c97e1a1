"""Checks of products that frames share: truth bricks, PSF sets, masters, merged bricks, validation, report."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.digest import digest
from csstsim.base.errors import InputError
from csstsim.base.files.text_file import read_json, read_text
from csstsim.base.healpix import brick_of, hats_index
from csstsim.catalog.table import ObjectTable, footer
from csstsim.delivery.checked_files import MergedBrick
from csstsim.delivery.frame_checks import other_recipe
from csstsim.io.frames import load_frame
from csstsim.io.level0 import read_level0

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping
    from pathlib import Path
    from typing import Any

    from csstsim.base.types import IntArray
    from csstsim.delivery.checked_files import CheckedFiles
    from csstsim.delivery.contents import ExpectedFrame
    from csstsim.optics.psf.psf_file import PsfSet


def truth_brick(path: Path, record: dict[str, Any] | None) -> Iterator[str]:
    """Check a brick of the embedded Universe; `record`: what it must be made for, or None."""
    from csstsim.catalog.truth_bricks import read_brick

    table = read_brick(path, record)
    pix = int(path.stem.removeprefix("Npix="))
    if (table["_healpix_29"] >> 42 != pix).any():
        yield "has objects of another brick"


def psf(path: Path, frame: ExpectedFrame, checked: CheckedFiles) -> Iterator[str]:
    """Check a chip's PSF set, every node of it, and that a frame of the chip was rendered with it."""
    for node in np.flatnonzero(~(made := _psf(path, frame)).dead):
        made.node(int(node))
    try:
        used = (
            checked.psf_hash[frame.level0]
            if frame.level0 in checked.psf_hash
            else read_level0(frame.level0).header0.get("PSFHASH")
        )
    except (InputError, OSError):
        return  # a fault of that file
    if used not in (None, digest(made.attributes)):
        yield f"is not the set that {frame.level0.name} was rendered with"


def psf_tables(path: Path, psf_path: Path, frame: ExpectedFrame) -> Iterator[str]:
    """Check the tables photons are drawn from, every node of them."""
    from csstsim.render.psf_table import read_tables

    try:
        made = _psf(psf_path, frame)
    except (InputError, OSError):
        return  # a fault of that file
    read_tables(path, made).verify(np.flatnonzero(~made.dead))
    yield from ()


def _psf(path: Path, frame: ExpectedFrame) -> PsfSet:
    from csstsim.optics.psf.psf_file import PsfSet

    return PsfSet(path, chip=frame.chip, filter=frame.filter)


def masters(path: Path, record: dict[str, Any] | None) -> Iterator[str]:
    """Check a chip's master calibration frames."""
    planes, _ = load_frame(path, record)
    if set(planes) != {"flat", "bad"}:
        yield f"holds {', '.join(planes) or 'nothing'}, not the planes flat and bad"


def merged(
    path: Path, pix: int, recipe: str | None, frames: Mapping[tuple[str, int], ExpectedFrame], checked: CheckedFiles
) -> Iterator[str]:
    """Check a merged brick: its recipe, that its rows lie in it, and that every link leads to a measured row.

    frames: {(obsid, chip): ExpectedFrame}; `checked` has the rows of measured tables, and gets the brick's.
    """
    table = ObjectTable.read(path)
    yield from other_recipe(table.meta.get("recipe"), recipe)
    checked.merged[pix] = MergedBrick(len(table), table.meta.get("recipe"))
    if table.meta.get("brick") != pix:
        yield f"is of brick {table.meta.get('brick')!r:.40}"
    missing = [name for name in ("_healpix_29", "ra", "dec", "n_detections", *LINKS) if name not in table]
    if missing:
        yield f"the table lacks the column {missing[0]}"
        return
    ra = table["ra"]
    dec = table["dec"]
    index = table["_healpix_29"]
    if not (np.isfinite(ra) & np.isfinite(dec)).all():
        yield "has positions that are not finite"
    elif (brick_of(ra, dec) != pix).any() or (hats_index(ra, dec) != index).any():
        yield "has sources that belong to another brick"
    if (np.diff(index) < 0).any():
        yield "its rows are not in the order of _healpix_29"
    yield from _links(table, frames, checked)


LINKS = ("detection_obsid", "detection_chip", "detection_filter", "detection_number")


def _links(table: ObjectTable, frames: Mapping[tuple[str, int], ExpectedFrame], checked: CheckedFiles) -> Iterator[str]:
    """Yield links of merged rows that lead nowhere, twice to one row, or are too many or too few."""
    lists = [table[name] for name in LINKS]
    counts = table["n_detections"]
    if any((np.array([len(v) for v in column], int) != counts).any() for column in lists):
        yield "its lists of detections are not as long as n_detections"
        return
    if not counts.any():
        return
    obsid, chip, band, number = (np.concatenate(list(column)) for column in lists)  # in the order of LINKS
    key = np.array([f"{o}_{c:02d}" for o, c in zip(obsid, chip, strict=True)])
    for name in np.unique(key):
        here = key == name
        known = frames.get((str(name)[:-3], int(name[-2:])))
        if known is None:
            yield f"{here.sum()} detections are of {name}, which is not among the frames"
        elif known.filter is not None and (np.char.lower(band[here].astype(str)) != known.filter.lower()).any():
            yield f"detections of {name} are not in {known.filter}"
        elif (rows := checked.measured.get(known.key)) is not None and not _within(number[here], rows):
            yield f"detections of {name} lead beyond the {rows} rows measured there"
        elif len(np.unique(number[here])) != here.sum():
            yield f"a detection of {name} belongs to two sources"


def _within(numbers: IntArray, rows: int) -> bool:
    return bool(((numbers >= 0) & (numbers < rows)).all())


def partition(path: Path, bricks: Iterable[int]) -> Iterator[str]:
    """Check the list of bricks in a HATS catalogue."""
    if read_text(path).split() != ["Norder,Npix", *(f"8,{pix}" for pix in sorted(bricks))]:
        yield "does not list the bricks"


def catalogue(folder: Path, bricks: Iterable[int], checked: CheckedFiles) -> Iterator[str]:
    """Check the files about all merged bricks (bricks.hats): they must count as many rows as the bricks have."""
    lines = read_text(folder / "hats.properties").splitlines()
    properties = dict(line.split("=", 1) for line in lines if "=" in line)
    total = sum(brick.rows for brick in checked.merged.values())
    footer(folder / "dataset" / "_common_metadata")
    noted = footer(folder / "dataset" / "_metadata").num_rows
    if set(checked.merged) == set(bricks):
        for name, value in (("hats.properties", properties.get("hats_nrows")), ("dataset/_metadata", noted)):
            if str(value) != str(total):
                yield f"{name} counts {value} rows; the bricks have {total}"


def validation(path: Path, pix: int, recipe: str | None, checked: CheckedFiles) -> Iterator[str]:
    """Check a brick's validation: readable, of this brick and of what was merged; note its gates in `checked`."""
    result = read_json(path)
    if not isinstance(result, dict) or result.get("brick") != pix or not isinstance(result.get("gates"), list):
        yield f"is no validation of brick {pix}"
        return
    checked.gates[pix] = len(result["gates"])
    if recipe is None and pix in checked.merged:
        recipe = checked.merged[pix].recipe
    yield from other_recipe(result.get("recipe"), recipe)


def verdict(path: Path, bricks: Iterable[int], checked: CheckedFiles) -> Iterator[str]:
    """Check the verdict: as many gates of bricks as the validations of all bricks have."""
    result = read_json(path)
    gates = result.get("gates") if isinstance(result, dict) else None
    if not isinstance(gates, list) or not all(isinstance(gate, dict) for gate in gates):
        yield "is no verdict of a report"
        return
    count = sum(gate.get("brick") is not None for gate in gates)  # the others are of spectra
    stated = result.get("counts")
    if not isinstance(stated, dict) or sum(stated.values()) != len(gates):
        yield f"has {len(gates)} gates; it counts {stated!r:.80}: make the report again"
    elif set(checked.gates) == set(bricks) and count != sum(checked.gates.values()):
        yield f"evaluates {count} gates; the validations have {sum(checked.gates.values())}: make the report again"


def page(path: Path) -> Iterator[str]:
    """Check that a web page is complete."""
    with path.open("rb") as file:
        file.seek(max(path.stat().st_size - 64, 0))
        if not file.read().rstrip().endswith(b"</html>"):
            yield "the page is cut short"


def picture(path: Path) -> Iterator[str]:
    """Check the checksums of a PNG."""
    from PIL import Image

    try:
        with Image.open(path, formats=["PNG"]) as image:
            image.verify()
    except (SyntaxError, ValueError) as exc:  # what Pillow makes of broken chunks
        raise InputError(f"not a readable PNG: {exc}", file=path) from None
    yield from ()
