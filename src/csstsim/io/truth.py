"""The truth table that accompanies each Level-0 file (parquet).

The 33 columns of the C9 `.cat` files come first, with the names that they have in these files (facts.md section 5),
and NaN if the catalogue has no such quantity. Columns that the simulator adds, and further columns of the catalogue
(user_*), follow. xImage, yImage are as in the header's WCS (FITS: centre of the first active pixel at 1); x0, x1, y0,
y1 are a numpy slice of the full frame (read_level0(path).assembled(full=True)). ra, dec are the apparent direction: the
header's WCS converts it to xImage, yImage if it has the distortion (`sip: true`). ra_orig, dec_orig are the catalogue's
position, ICRS at J2000. ra_epoch, dec_epoch are the ICRS position at the epoch, with proper motion and parallax but
without aberration and light deflection, which a measurement of this exposure should give.

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
# Name in `.cat`: name in csstsim
CAT_COLUMNS = {
    "obj_ID": "id", "ID_chip": "chip", "filter": "filter", "xImage": "x", "yImage": "y", "ra": "ra", "dec": "dec",
    "ra_orig": "ra_orig", "dec_orig": "dec_orig", "z": "z", "mag": "mag", "obj_type": "obj_type",
    "pm_ra": "pmra", "pm_dec": "pmdec", "RV": "rv", "parallax": "parallax", "av": "av", "stellarmass": "stellarmass",
    "dm": "dm", "teff": "teff", "logg": "logg", "feh": "feh", "bulgemass": "bulgemass", "diskmass": "diskmass",
    "detA": "detA",
    "e1": "e1", "e2": "e2", "kappa": "kappa", "g1": "g1", "g2": "g2", "size": "size", "galType": "gal_type",
    "veldisp": "veldisp",
}  # fmt: skip
# Columns that only tables of moving or variable objects, or of grating chips, have
OPTIONAL_COLUMNS = {
    "catalog_row": "row of the object in the catalogue (grating chips)",
    "dmag": "mag by which a variable object is fainter in this exposure than mag_*",
    "trail_start": "s after the start of the exposure at which the trail starts; NaN: the object does not move",
    "trail_end": "s, at which the trail ends; the object's position is that of the middle",
    "trail_length": "arcsec, of the motion in that time; 0: it does not move",
    "trail_angle": "deg, north through east, of the motion",
    **dict.fromkeys(ENDS, "FITS px of the assembled frame: its position at trail_start and at trail_end"),
}
# The other columns: they replace or add to the descriptions in catalog.table.COLUMNS
ABOUT = {
    "chip": "chip of the Level-0 file",
    "filter": "its filter or grating",
    **{name: meaning for name, (_, _, meaning) in changing.COLUMNS.items()},
    **OPTIONAL_COLUMNS,
    "x": "FITS px of the assembled frame (centre of the first active pixel at 1)",
    "y": "the same",
    "ra": "deg, apparent direction: with the WCS of `sip: true` it gives xImage, yImage",
    "dec": "deg, the same",
    "ra_orig": "deg, the catalogue's position, ICRS at J2000",
    "dec_orig": "deg, the same",
    "ra_epoch": "deg, ICRS at the epoch, with proper motion and parallax, which a measurement should give",
    "dec_epoch": "deg, the same",
    "mag": "AB in the filter, magnified (grating: of the first order)",
    "dm": "mag, distance modulus of a star",
    "detA": "determinant of the lensing Jacobian",
    "g1": "reduced shear, axis 1 along +RA (east)",
    "g2": "the same, axis 2 at 45 deg towards north",
    "size": "arcsec, mean of the half-light radii of disk and bulge, weighted with their flux",
    "mag_B": "AB, magnified",
    **{f"flux{i}": "electron / s in the filter's four sub-bands, magnified" for i in range(4)},
    "reach": "px, half the side of the stamp",
    "lost": "fraction of a galaxy's flux that may lie beyond the stamp",
    "wing": "px, radius of the wing beyond the PSF's box; 0: below the noise",
    "electrons": "nominal electrons of the exposure (grating: of all orders)",
    "drawn": "electrons rendered in the window, after the losses of flat field, shutter and pixel response",
    "fraction": "drawn / electrons",
    "method": "how it was rendered: photons, stamp, unresolved, reference, track (a satellite), none",
    "snr": "predicted S/N of the total flux, F / sqrt(F + n v): F electrons (grating: of the first order), v variance "
    "of a pixel without objects (nominal sky, dark current, read noise), n = 9.06 (r^2 + 1.2^2) effective pixels, r "
    "half-light radius [px]; with a grating n + length of the trace times sqrt(n); NaN: reference",
    "error": "sigma, bound of the detectability of the rendering error by an ideal filter on all pixels; brighter than "
    "16 mag and larger than 2.5 arcsec up to ten times as much (rendering.md)",
    "stamp": "px, side of the rendered pixels, wing included; 0 for photons",
    **dict.fromkeys(
        ("x0", "x1", "y0", "y1"), "px, box of the rendered pixels, half-open, full frame; zeros: only its wing"
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
# Columns made here, and `.cat` names that differ from those of csstsim: a catalogue's column of that name is renamed.
RESERVED = {"chip", "filter", "detA", "dm", "g1", "g2", "size"} | (set(CAT_COLUMNS) - set(CAT_COLUMNS.values()))


def truth_table(rendered: ObjectTable, chip: Chip) -> ObjectTable:
    """Return the truth of one Level-0 file as an ObjectTable, one row per rendered object.

    rendered: table of the render stage; its x, y [px] from 0 become xImage, yImage from 1.
    """
    count = len(rendered)
    unknown = np.full(count, np.nan, np.float32)
    columns = {f"user_{name}" if name in RESERVED else name: rendered[name] for name in rendered.names}
    columns["chip"], columns["filter"] = np.full(count, chip.id, np.int16), np.full(count, chip.filter)
    columns |= {name: columns[name] + 1.0 for name in ENDS if name in columns}
    for axis in ("x", "y"):  # an exposure without objects has no positions
        columns[axis] = columns.get(axis, unknown) + 1.0
    one_kappa = 1.0 - columns["kappa"].astype(float)
    columns["detA"] = one_kappa**2 - columns["gamma1"].astype(float) ** 2 - columns["gamma2"].astype(float) ** 2
    with np.errstate(divide="ignore", invalid="ignore"):
        parallax = columns["parallax"]
        columns["dm"] = np.where(parallax > 0, 10.0 - 5.0 * np.log10(parallax), np.nan)  # distance modulus
        columns["g1"], columns["g2"] = columns["gamma1"] / one_kappa, columns["gamma2"] / one_kappa
    for name in FILE_COLUMNS:  # the name of a file, not its path on this machine
        if name in columns:
            columns[name] = np.array([Path(text).name for text in columns[name].tolist()], dtype=str)
    bulge = columns["bulge_frac"]
    columns["size"] = bulge * columns["size_bulge"] + (1 - bulge) * columns["size_disk"]
    first_columns = {name: columns.pop(own_name, unknown) for name, own_name in CAT_COLUMNS.items()}
    return ObjectTable(first_columns | columns)


def electron_budget(header: Mapping[str, Any], pixels: int) -> dict[str, float]:
    """Return {name: electrons} of a window of `pixels`, from the layers' entries in State.header.

    light (which includes `objects`), dark, rays and defects add charge. Trapped and bloomed charge is lost before the
    amplifiers. There is no `bloomed` if no layer limits a pixel's charge to the full well. bias_structure: the maximum
    that a laboratory map of the bias can add or subtract.
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
    """Read the truth table of a Level-0 file.

    Parameters
    ----------
    path : str or Path
        The parquet file, `NAME.truth.parquet`.

    Returns
    -------
    ObjectTable
        One row per rendered object. The columns have the names of csstsim: `ra`, `mag`, `pmra` and so on; units are on
        the page of products. x and y [px] count from 0, so they are indices of the assembled frame.

    Raises
    ------
    InputError
        If the file is missing, damaged or not a truth table.

    Examples
    --------
    `truth = read_truth(path)`, then `truth["mag"]`.
    """
    table = ObjectTable.read(path)
    missing = [name for name in ("xImage", "yImage") if name not in table]
    if missing:
        raise InputError("not a truth table: it lacks a column", file=path, key=missing[0])
    check_numbers(path, table, set(CAT_COLUMNS) - {"filter"})
    columns = {CAT_COLUMNS.get(name, name): table[name] for name in table.names}
    return ObjectTable(
        columns | {name: columns[name] - 1.0 for name in ("x", "y", *ENDS) if name in columns}, table.meta
    )
