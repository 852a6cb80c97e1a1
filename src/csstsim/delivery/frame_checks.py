"""Checks of the products of one chip in one exposure. Each check yields faults as text.

An unreadable file raises csstsim.base.errors.InputError or OSError; delivery.verify reports it as a fault.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.files.text_file import read_text
from csstsim.base.plural import number_of
from csstsim.catalog.table import ObjectTable
from csstsim.delivery.charge_budget import charge_faults
from csstsim.detector.adc import clipping_fault
from csstsim.io.cat import MAX_BYTES, cat_lines, read_cat
from csstsim.io.fits import open_fits, verify_hdu
from csstsim.io.frames import load_frame
from csstsim.io.keywords import recorded_recipe
from csstsim.io.level0 import read_level0
from csstsim.io.orders import read_orders
from csstsim.io.paths import TRUTH
from csstsim.io.pointing_keywords import TOLERANCE, boresight_of, pointing_offsets, wcs_offset
from csstsim.io.truth import CAT_COLUMNS, read_truth

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from pathlib import Path
    from typing import Any

    from csstsim.delivery.checked_files import CheckedFiles
    from csstsim.delivery.contents import ExpectedFrame
    from csstsim.io.level0 import Level0

# Columns of a truth table with objects, in addition to CAT_COLUMNS
RENDERED = ("electrons", "drawn", "flags", "x0", "x1", "y0", "y1")


def other_recipe(found: object, expected: dict[str, Any] | str | None) -> Iterator[str]:
    """Yield differences of a recorded recipe, a dict or one digest, from the expected one (None: any is right)."""
    if expected is None or found == expected:
        return
    if not (isinstance(expected, dict) and isinstance(found, dict)):
        yield f"made for another campaign: recipe {found!r:.80}, not {expected!r:.200}"
        return
    for name in sorted(expected.keys() | found.keys()):
        if found.get(name) != expected.get(name):
            yield f"made for another campaign: {name} {found.get(name)!r:.80}, not {expected.get(name)!r:.80}"


def level0(frame: ExpectedFrame, checked: CheckedFiles) -> Iterator[str]:
    """Check a Level-0 file: checksums, extensions, exposure, chip, recipe and window; note it in `checked`."""
    path = frame.level0
    checked.opened.clear()
    file = checked.opened[path] = read_level0(path, verify=True)
    checked.psf_hash[path] = file.header0.get("PSFHASH")
    yield from _complete(path, int(file.header0.get("NEXTEND", 1)))
    header = file.header0
    expected = {"OBSID": frame.obsid, "DETECTOR": f"{frame.chip:02d}", "FILETYPE": frame.type, "FILENAME": path.stem}
    if frame.filter is not None:
        expected["FILTER"] = frame.filter
    for name, value in expected.items():
        if str(header.get(name)) != value:
            yield f"{name} is {header.get(name)!r:.80}, not {value!r}"
    if frame.recipe is not None:
        yield from other_recipe(recorded_recipe(header), frame.recipe)
    yield from _pointing(frame, file)
    if fault := clipping_fault(int(file.header.get("CLIPLOW", 0)), file.readout.nx * file.readout.ny):
        yield fault
    if frame.window is not None and file.readout.window != frame.window:
        yield f"its window is {file.readout.window}, not {frame.window}"


def _pointing(frame: ExpectedFrame, file: Level0) -> Iterator[str]:
    """Yield the pointing keywords that differ from the campaign's pointing, or without it from the file's WCS."""
    boresight = frame.boresight or boresight_of(file.header)
    off = pointing_offsets(file.header0, boresight) if boresight else {}
    if frame.wcs is not None:
        off["CRVAL1"] = wcs_offset(file.header, frame.wcs)
    expected = "the campaign's" if frame.boresight else "that of its WCS"
    for keyword, arcsec in off.items():
        if arcsec > TOLERANCE:
            yield f"the pointing by {keyword} is {arcsec:.4g} arcsec off {expected}"


def _complete(path: Path, extensions: int) -> Iterator[str]:
    """Yield what is too much or too little in a FITS file of this many extensions."""
    with open_fits(path) as file:
        if len(file) != 1 + extensions:
            yield f"has {len(file) - 1} extensions, not the {extensions} of its header"
        rest = path.stat().st_size - file[len(file) - 1].get_offsets()["data_end"]
    if rest:
        yield f"{rest} bytes follow the end of its last extension"


def truth(frame: ExpectedFrame, checked: CheckedFiles) -> Iterator[str]:
    """Check a truth table: columns, recipe, rows within the window; then the image. Note it in `checked` if sound."""
    path = frame.companion(TRUTH)
    opened = checked.opened.pop(frame.level0, None)
    faults = list(_truth(path, frame, opened))
    yield from faults
    if not faults:
        checked.truths.add(path)


def _truth(path: Path, frame: ExpectedFrame, opened: Level0 | None) -> Iterator[str]:
    table = read_truth(path)
    yield from other_recipe(table.meta.get("recipe"), frame.recipe)
    if table.meta.get("level0") != frame.level0.name:
        yield f"is of {table.meta.get('level0')!r:.120}, not of {frame.level0.name}"
    names = [*CAT_COLUMNS.values(), *(RENDERED if len(table) else ())]
    missing = [name for name in names if name not in table]
    if missing:
        yield f"the table lacks the column {missing[0]}"
        return
    yield from _of_frame(table, frame)
    if len(table):
        yield from _rendered(table, frame)
    yield from _image_charge(frame, table, opened)


def cat(path: Path, frame: ExpectedFrame, checked: CheckedFiles) -> Iterator[str]:
    """Check the truth as text: it is a table, and equals the parquet file next to it, if that is sound."""
    read_cat(path)
    if frame.companion(TRUTH) in checked.truths:
        made = cat_lines(ObjectTable.read(frame.companion(TRUTH), CAT_COLUMNS))
        if read_text(path, max_bytes=MAX_BYTES) != "".join(made):
            yield f"is not the text of {frame.companion(TRUTH).name}"


def _of_frame(table: ObjectTable, frame: ExpectedFrame) -> Iterator[str]:
    """Yield what is wrong with columns that name the frame of a table's rows."""
    expected = {"chip": frame.chip, "filter": frame.filter, "obsid": frame.obsid}
    for name, value in expected.items():
        if name in table and value is not None and (np.asarray(table[name]) != value).any():
            yield f"has rows with another {name} than {value}"


def _rendered(table: ObjectTable, frame: ExpectedFrame) -> Iterator[str]:
    drawn = table["drawn"]
    if not (np.isfinite(drawn) & (drawn >= 0)).all():
        yield "column drawn has values that are negative or not finite"
    rendered = drawn > 0
    if not (np.isfinite(table["x"]) & np.isfinite(table["y"]))[rendered].all():
        yield "objects were rendered whose position is not finite"
    if frame.window is not None:
        x0, x1, y0, y1 = frame.window
        left, right, low, high = box = np.stack([table[name][rendered] for name in ("x0", "x1", "y0", "y1")])
        inside = (left >= x0) & (left < right) & (right <= x1) & (low >= y0) & (low < high) & (high <= y1)
        wrong = ~inside & box.any(axis=0)  # zeros: only the object's wing reaches the window
        if wrong.any():
            yield f"{number_of(int(wrong.sum()), 'object')} rendered in boxes beyond the window"


def _image_charge(frame: ExpectedFrame, table: ObjectTable, file: Level0 | None) -> Iterator[str]:
    """Compare the charge of the image (file, if opened) with the truth, if the budget is known and it can be read."""
    if "electrons" not in table.meta:
        return  # layers of the user's own
    try:
        file = file or read_level0(frame.level0)
    except (InputError, OSError):
        return  # a fault of the image, not of the truth
    yield from charge_faults(file, table)


def orders(path: Path, frame: ExpectedFrame) -> Iterator[str]:
    """Check the truth of dispersed light: recipe, rows that exist, electrons drawn that add up to the objects'."""
    table = read_orders(path)
    yield from other_recipe(table.meta.get("recipe"), frame.recipe)
    try:
        objects = read_truth(frame.companion(TRUTH))
    except InputError:
        return
    row = table["row"]
    if ((row < 0) | (row >= len(objects))).any():
        yield f"has orders of objects that are not among the {len(objects)} of the truth"
    elif (objects["id"][row] != table["id"]).any():
        yield "has orders whose object is another one in the truth"
    else:
        off = np.abs(np.bincount(row, table["drawn"], len(objects)) - objects["drawn"]) > 1 + 1e-6 * objects["drawn"]
        off &= objects["method"] != "track"  # satellites have no orders
        if off.any():
            yield f"the orders of {number_of(int(off.sum()), 'object')} do not add up to their light"


def cosmic(path: Path, frame: ExpectedFrame) -> Iterator[str]:
    """Check the image of cosmic rays alone."""
    planes, meta = load_frame(path)
    yield from other_recipe(meta.get("recipe"), frame.rays_recipe)
    if list(planes) != ["cosmic"]:
        yield f"holds {', '.join(planes) or 'nothing'}, not the plane cosmic"


def residual(path: Path, recipe: dict[str, Any] | None) -> Iterator[str]:
    """Check what is left of a frame without its sources."""
    planes, meta = load_frame(path)
    yield from other_recipe(meta.get("recipe"), recipe)
    if list(planes) != ["steps", "noise"]:
        yield f"holds {', '.join(planes) or 'nothing'}, not the planes steps and noise"


def light(path: Path, recipe: dict[str, Any] | None) -> Iterator[str]:
    """Check what render made of a chip, a frame or a table."""
    if path.suffix == ".fits":
        _, meta = load_frame(path)
    else:
        meta = ObjectTable.read(path).meta
    yield from other_recipe(meta.get("recipe"), recipe)


def measured(path: Path, frame: ExpectedFrame, recipe: dict[str, Any] | None, checked: CheckedFiles) -> Iterator[str]:
    """Check a measured table: columns, recipe, rows of this frame and within its window; note its rows in `checked`."""
    from csstsim.measure.source_columns import COLUMNS

    table = ObjectTable.read(path)
    yield from other_recipe(table.meta.get("recipe"), recipe)
    missing = [name for name in COLUMNS if name not in table]
    if missing:
        yield f"the table lacks the column {missing[0]}"
        return
    checked.measured[frame.key] = len(table)
    yield from _of_frame(table, frame)
    if table.meta.get("sources") != len(table):
        yield f"has {len(table)} rows; its record says {table.meta.get('sources')!r:.40}"
    if (table["number"] != np.arange(len(table))).any():
        yield "column number does not count the rows"
    if frame.window is not None:
        x0, x1, y0, y1 = frame.window  # a windowed position may lie a little beyond the pixels
        inside = (np.abs(table["x"] - (x0 + x1 - 1) / 2) <= (x1 - x0) / 2 + 5) & (
            np.abs(table["y"] - (y0 + y1 - 1) / 2) <= (y1 - y0) / 2 + 5
        )
        if not inside.all():
            yield f"{number_of(int((~inside).sum()), 'source')} beyond the window"
    if not ((table["ra"] >= 0) & (table["ra"] < 360) & (np.abs(table["dec"]) <= 90)).all():
        yield "has sources whose ra, dec are out of range"


def spectra(path: Path, recipe: dict[str, Any] | None) -> Iterator[str]:
    """Check a table of extracted spectra."""
    from csstsim.measure.spectra.spectrum_columns import COLUMNS

    yield from _with_columns(path, recipe, COLUMNS)


def lines(path: Path, recipe: dict[str, Any] | None) -> Iterator[str]:
    """Check a table of line fluxes."""
    from csstsim.measure.spectra.line_columns import COLUMNS

    yield from _with_columns(path, recipe, COLUMNS)


def _with_columns(path: Path, recipe: dict[str, Any] | None, columns: Iterable[str]) -> Iterator[str]:
    table = ObjectTable.read(path)
    yield from other_recipe(table.meta.get("recipe"), recipe)
    missing = [name for name in columns if name not in table]
    if missing:
        yield f"the table lacks the column {missing[0]}"


def calibrated(path: Path, frame: ExpectedFrame) -> Iterator[str]:
    """Check a calibrated image: checksums, planes, recipe."""
    with open_fits(path) as file:
        for hdu in file:
            verify_hdu(hdu, path)
        planes = [hdu.get_extname() for hdu in file][1:]
        header = file[0].read_header()
        yield from _complete(path, 3)
    if planes != ["SCI", "ERR", "DQ"]:
        yield f"has the extensions {', '.join(planes)}, not SCI, ERR, DQ"
    yield from other_recipe(recorded_recipe(header), frame.recipe)
