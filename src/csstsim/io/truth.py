"""The truth table that accompanies each Level-0 file (parquet).

The 33 columns of the C9 `.cat` files come first, by their names there (facts.md section 5), with NaN where
the catalogue has no such quantity; then everything the simulator adds, and the catalogue's own columns (user_*).
xImage, yImage follow the header's WCS (FITS: centre of the first active pixel at 1); x0, x1, y0, y1 are a numpy slice
of the full frame (read_level0(path).assembled(full=True)). ra, dec are the apparent direction (with the header's WCS
it gives xImage, yImage where that has the distortion, `sip: true`); ra_orig, dec_orig the catalogue's place, ICRS at
J2000; ra_epoch, dec_epoch the ICRS place at the epoch, with proper motion and parallax but without aberration and
light deflection: what a measurement of this exposure should give.

The file's metadata have the recipe, the Level-0 file's name, full_well [e-] and `electrons`, the budget of all charge
(`electron_budget`), with which `csstsim verify` compares image and table.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.types import PathLike
from csstsim.catalog.changing import columns as changing
from csstsim.catalog.table import FILE_COLUMNS, ObjectTable, check_numbers

if TYPE_CHECKING:
    from csstsim.instrument.chip import Chip

ENDS = "trail_x0", "trail_y0", "trail_x1", "trail_y1"  # columns of pixels, as x and y
# .cat name: our column
CAT_COLUMNS = {
    "obj_ID": "id", "ID_chip": "chip", "filter": "filter", "xImage": "x", "yImage": "y", "ra": "ra", "dec": "dec",
    "ra_orig": "ra_orig", "dec_orig": "dec_orig", "z": "z", "mag": "mag", "obj_type": "obj_type",
    "pm_ra": "pmra", "pm_dec": "pmdec", "RV": "rv", "parallax": "parallax", "av": "av", "stellarmass": "stellarmass",
    "dm": "dm", "teff": "teff", "logg": "logg", "feh": "feh", "bulgemass": "bulgemass", "diskmass": "diskmass",
    "detA": "detA",
    "e1": "e1", "e2": "e2", "kappa": "kappa", "g1": "g1", "g2": "g2", "size": "size", "galType": "gal_type",
    "veldisp": "veldisp",
}  # fmt: skip
# Of tables with objects that move or vary, and of those of grating chips
SOMETIMES = {
    "catalog_row": "row of the object in the catalogue that was drawn, of a grating chip",
    "dmag": "mag by which it is fainter in this exposure than mag_*: of objects that vary, if the catalogue has any",
    "trail_start": "s after the start of the exposure, from which an object that moves is drawn; NaN: it does not move",
    "trail_end": "s, until which it is drawn; its place is that of the middle",
    "trail_length": "arcsec, of the motion in that time; 0: it does not move",
    "trail_angle": "deg, north through east, of the motion",
    **dict.fromkeys(ENDS, "FITS px of the assembled frame: where it is at trail_start and at trail_end"),
}
# The other columns: they replace or add to the descriptions in catalog.table.COLUMNS
ABOUT = {
    "chip": "chip of the Level-0 file",
    "filter": "its filter or grating",
    **{name: meaning for name, (_, _, meaning) in changing.COLUMNS.items()},
    **SOMETIMES,
    "x": "FITS px of the assembled frame (centre of the first active pixel at 1)",
    "y": "the same",
    "ra": "deg, apparent direction: with the WCS of `sip: true` it gives xImage, yImage",
    "dec": "deg, the same",
    "ra_orig": "deg, the catalogue's place, ICRS at J2000",
    "dec_orig": "deg, the same",
    "ra_epoch": "deg, ICRS at the epoch, with proper motion and parallax: what a measurement should give",
    "dec_epoch": "deg, the same",
    "mag": "AB in the filter, magnified (grating: of the first order)",
    "dm": "mag, distance modulus of a star",
    "detA": "determinant of the lensing Jacobian",
    "g1": "reduced shear, axis 1 along +RA (east)",
    "g2": "the same, axis 2 at 45 deg towards north",
    "size": "arcsec, half-light radii of disk and bulge, weighted with their light",
    "mag_B": "AB, magnified",
    **{f"flux{i}": "electron / s in the filter's four sub-bands, magnified" for i in range(4)},
    "reach": "px, half the side of the stamp",
    "lost": "fraction of a galaxy's light that may lie beyond the stamp",
    "wing": "px, radius of the light beyond the PSF's box; 0: noise hides it",
    "electrons": "nominal electrons of the exposure (grating: of all orders)",
    "drawn": "electrons put into the image",
    "fraction": "drawn / electrons",
    "method": "how it was rendered: photons, stamp, unresolved, reference, track (a satellite), none",
    "snr": "predicted S/N of the object",
    "error": "sigma, bound of the detectability of the rendering error by an ideal filter on all pixels; brighter than "
    "16 mag and larger than 2.5 arcsec up to ten times as much (rendering.md)",
    "stamp": "px, side of what was rendered, wing included; 0 for photons",
    **dict.fromkeys(
        ("x0", "x1", "y0", "y1"), "px, box of what was rendered, half-open, full frame; zeros: its wing alone"
    ),
    "ms": "CPU milliseconds",
}
# Types of the columns that COLUMNS and OPTIONAL of catalog.table, or catalog.changing, do not have
TYPES = {
    **dict.fromkeys(("filter", "method"), np.str_),
    "chip": np.int16,
    "catalog_row": np.int64,
    **dict.fromkeys(("reach", "stamp", "x0", "x1", "y0", "y1"), np.int32),
    **dict.fromkeys(("x", "y", "ra_orig", "dec_orig", "ra_epoch", "dec_epoch", "detA", "g1", "g2"), np.float64),
    **dict.fromkeys((*(f"flux{i}" for i in range(4)), "electrons", "drawn", "fraction"), np.float64),
    **dict.fromkeys(("trail_start", "trail_end", "trail_length", "trail_angle", "dmag", *ENDS), np.float64),
    **dict.fromkeys(("mag", "dm", "size", "lost", "wing", "snr", "error", "ms"), np.float32),
}
# Columns made here, and .cat names that differ from ours: a catalogue's own column of that name is renamed.
TAKEN = {"chip", "filter", "detA", "dm", "g1", "g2", "size"} | (set(CAT_COLUMNS) - set(CAT_COLUMNS.values()))


def truth_table(drawn: ObjectTable, chip: Chip) -> ObjectTable:
    """Return the truth of one Level-0 file as an ObjectTable, one row per object drawn.

    drawn: ObjectTable from render, its x, y [px] from 0 become xImage, yImage from 1; chip: instrument.chip.Chip.
    """
    count = len(drawn)
    unknown = np.full(count, np.nan, np.float32)
    ours = {f"user_{name}" if name in TAKEN else name: drawn[name] for name in drawn.names}
    ours["chip"], ours["filter"] = np.full(count, chip.id, np.int16), np.full(count, chip.filter)
    ours |= {name: ours[name] + 1.0 for name in ENDS if name in ours}
    for axis in ("x", "y"):  # an exposure without objects has no positions
        ours[axis] = ours.get(axis, unknown) + 1.0
    one_kappa = 1.0 - ours["kappa"].astype(float)
    ours["detA"] = one_kappa**2 - ours["gamma1"].astype(float) ** 2 - ours["gamma2"].astype(float) ** 2
    with np.errstate(divide="ignore", invalid="ignore"):
        ours["dm"] = np.where(ours["parallax"] > 0, 10.0 - 5.0 * np.log10(ours["parallax"]), np.nan)  # distance modulus
        ours["g1"], ours["g2"] = ours["gamma1"] / one_kappa, ours["gamma2"] / one_kappa
    for name in FILE_COLUMNS:  # what a file is called, not where it lies on this machine
        if name in ours:
            ours[name] = np.array([Path(text).name for text in ours[name].tolist()], dtype=str)
    bulge = ours["bulge_frac"]
    ours["size"] = bulge * ours["size_bulge"] + (1 - bulge) * ours["size_disk"]
    columns = {name: ours.pop(our_name, unknown) for name, our_name in CAT_COLUMNS.items()}
    return ObjectTable(columns | ours)


def electron_budget(header: Mapping[str, Any], pixels: int) -> dict[str, float]:
    """Return {name: electrons} of a window of `pixels`, from the layers' entries in State.header.

    light (which includes `objects`), dark, rays and defects add charge; trapped and bloomed charge is lost on the way
    to the amplifiers.
    `bloomed` is left out where no layer limits a pixel's charge to the full well. bias_structure: the most that a
    laboratory map of the bias can add or take.
    """
    budget = {
        "objects": header.get("objects_electrons", 0.0),
        "light": header.get("light_electrons", 0.0),
        "dark": header.get("dark_electrons", 0.0) * pixels,
        "rays": float(header.get("cosmic_electrons", 0)),
        "defects": header.get("defects_electrons", 0.0),
        "trapped": float(header.get("cti_trapped", 0) + header.get("cti_serial_trapped", 0)),
    }
    if "bias_structure" in header:
        budget["bias_structure"] = header["bias_structure"]
    return budget | ({"bloomed": float(header["bloom_lost"])} if "bloom_lost" in header else {})


def read_truth(path: PathLike) -> ObjectTable:
    """Return the truth table with our column names and 0-based x, y. Raises InputError if it is not one."""
    table = ObjectTable.read(path)
    missing = [name for name in ("xImage", "yImage") if name not in table]
    if missing:
        raise InputError("not a truth table: it lacks a column", file=path, key=missing[0])
    check_numbers(path, table, set(CAT_COLUMNS) - {"filter"})
    columns = {CAT_COLUMNS.get(name, name): table[name] for name in table.names}
    return ObjectTable(
        columns | {name: columns[name] - 1.0 for name in ("x", "y", *ENDS) if name in columns}, table.meta
    )
