"""Write docs/products.md, the contents of every product, and the schema of tables: python builders/make_products.py.

--check: only look.

Each description has one source: next to the columns' types in the module that writes the table, or the comment of a
keyword in config/instrument/level0_keywords.yaml. tests/docs/test_products.py forbids drift.
"""

import sys
from itertools import groupby
from pathlib import Path
from string import Template

import numpy as np
import table_schema

from csstsim.base.files.yaml_file import read_yaml
from csstsim.catalog import flags
from csstsim.catalog.changing import columns as changing
from csstsim.catalog.table import OPTIONAL, columns_with
from csstsim.detector import mask
from csstsim.inject.recovery import recovered
from csstsim.io import calibrated, orders, truth
from csstsim.measure import catalogue, source_columns
from csstsim.measure.bricks import merge
from csstsim.measure.spectra import line_columns, spectrum_columns
from csstsim.optics.psf.psf_file import ATTRIBUTES, DATASETS

ROOT = Path(__file__).parents[1]
PAGE = """# Products: files, columns, keywords

This page lists the files that a campaign writes, with the columns of each table and the keywords of each header.

Tables are parquet files. `csstsim.read_table(path)` returns an astropy Table with units. `Table.read(path)` of astropy
works if pandas is installed. `csstsim.catalog.table.ObjectTable.read(path)` is quicker and checks the file. Images are
FITS, PSF sets HDF5. Pixels count from 0 at the middle of the first one, except where "FITS" is stated.
[tables.json](../config/schema/tables.json) has the columns of all tables for programs, with a version that rises when
they change.

## Level-0

`level0/{obsid}/CSST_MSC_MS_WIDE_{start}_{end}_{obsid}_{chip}_L0_V01.fits` (`DEEP` in a deep exposure, `BIAS`, `DARK`,
`FLAT`): HDU 0 has keywords of the exposure, IMAGE
(HDU 1) the pixels; [Reading a Level-0 file](level0.md) says where each channel lies. `nn` counts channels from 01
(`LEDSTA`, `LEDT`: lamps). A keyword whose quantity is not known in an exposure is left out.

### HDU 0

$header0
### IMAGE

It also has structural keywords and the world coordinates, which are not listed here.

$header1
### MASK

If the layer list asks for it, `quantization_and_output: {mask: true}`.

$mask
## Truth

`....truth.parquet`, next to each Level-0 file, has a row for each object whose flux reaches the window. Its position
may lie beyond the window. First come the 33 columns of the C9 `.cat` files. With `truth: [parquet, cat]` in the
campaign file these columns are also written as text, `....cat`: a line of `#` and their names, then the rows. Types are
words there. Two lines of astropy read it:

    from astropy.table import Table
    objects = Table.read(path, format="ascii")

The columns are:

$cat
The simulator adds the following. A catalogue's own columns follow as `user_...`, the embedded universe's spectra as
`sed_scale`, `coeff0` ... `coeff19`, `_healpix_29`; B stands for each band of the camera:

$truth
These columns are there only if an object of the table has a profile, parts, a motion or a change of light:

$sometimes
Bits of `flags`:

$flags
## Truth of orders

`....orders.parquet`, next to the Level-0 file of a grating chip, has a row for each object and order.

$orders
## Truth bricks

`truth/dataset/Norder=8/Dir=.../Npix=....parquet`; also what a catalogue of your own may give. `csstsim report` writes
the files that make `truth/` a HATS catalogue of all bricks (`lsdb.open_catalog("results/demo/truth")`). One brick is
read by `csstsim.catalog.table.ObjectTable.read(file)`. A brick's rows are stars, galaxies, then quasars. Bricks also
have `sed_scale`, `coeff0` ... `coeff19` (spectra) and `_healpix_29`. B stands for each band of the camera. A star with
a close companion has the companion's temperature [K] in `coeff0`, its log g in `coeff1`, and in `coeff2` the squared
ratio of the radii, the companion's over the star's. Where a column says nothing of an object, it is 0 up to `gamma2`,
NaN from `stellarmass` to `halomass`, and -1 from `satellite` to `host`.

$bricks
## Measured tables

`measure/{obsid}_{chip}.parquet` has a row for each detection; [measure.md](measure.md) describes the measurement.

$measured
Bits of `flags`; for a clean list leave out detections with 4, 8 or 64:

$measured_flags
## Spectra

`spectra/{obsid}_{chip}.parquet` has a row for each column of pixels of a spectrum;
[Spectra from a slitless frame](slitless_extract.md) describes the extraction.

$spectra
Bits of `flags`:

$spectra_flags
`spectra/{obsid}_{chip}_lines.parquet` has a row for each emission line that was looked for, detected or not.

$lines
Bits of `flags`, in addition to those of its columns:

$lines_flags
## Merged bricks

`merge/dataset/Norder=8/Dir=.../Npix=....parquet`, a HATS catalogue, has a row for each source; [merge.md](merge.md)
describes the merging. B stands for each band of the camera; the shipped one has nuv, u, g, r, i, z, y.

$merged
## Recovered objects

`csstsim recover` writes `....recovered.parquet`, a row for each injected object; [injection.md](injection.md) describes
how objects and sources are matched.

$recovered
## Frames without their sources

`measure/{obsid}_{chip}.residual.fits`, with `measurement.joint`: STEPS (uint8), 128 + 4 x what is left of a pixel over
its noise, 0 where it is not known; NOISE (float32), electrons, at every 32nd pixel. `csstsim merge` uses them
([merge.md](merge.md#all-frames-together)).

## Calibrated images

`calibrated/{obsid}_{chip}.fits`: SCI and ERR [electron / s], DQ (bits); [calibration.md](calibration.md) describes the
calibration. HDU 0 keeps these keywords of the Level-0 header: $kept.

$quality
## PSF sets

`psf/chip_{chip}.h5`; `csstsim.optics.psf.psf_file.PsfSet(path).at(x, y)` gives the PSF at a position. n = grid^2 nodes.

$datasets
$attributes
*Written by `python builders/make_products.py` from the code's own tables; edit those, not this page.*
"""


def rows(head, lines):
    """Return a Markdown table of a head and of lines, tuples of text."""
    table = [head, ("---",) * len(head), *lines]
    return "\n".join("| " + " | ".join(str(cell).replace("|", "\\|") for cell in line) + " |" for line in table) + "\n"


def columns(described):
    """Return the table of {name: (type, text)}, or of {name: text}; neighbours with the same entry share a row."""
    lines = []
    for about, names in groupby(described, key=described.get):
        kind, text = about if isinstance(about, tuple) else (None, about)
        cells = () if kind is None else (np.dtype(kind).name,)
        lines.append((", ".join(f"`{name}`" for name in names), *cells, text))
    return rows(("column", "type", "what") if len(lines[0]) == 3 else ("column", "what"), lines)


def bits(module, about):
    """Return the table of flags {bit: text}, named as the module's constants are."""
    names = {value: name for name, value in vars(module).items() if name.isupper() and isinstance(value, int)}
    return rows(("bit", "name", "what"), [(bit, f"`{names[bit]}`", text) for bit, text in about.items()])


def truth_columns():
    """Return {name: text} of the truth table's columns: of .cat files, what the simulator adds, what it may add."""
    known = {name: text for name, (_, _, text) in (columns_with("B") | OPTIONAL).items()} | truth.ABOUT
    first = {name: known[ours] for name, ours in truth.CAT_COLUMNS.items()}
    more = {name: text for name, text in known.items() if name not in truth.CAT_COLUMNS.values()}
    may = OPTIONAL.keys() | changing.COLUMNS.keys() | truth.OPTIONAL_COLUMNS.keys()
    return first, *({name: text for name, text in more.items() if (name in may) == there} for there in (False, True))


def header(hdu):
    """Return the table of one HDU's keywords, in the file's order."""
    lines = []
    for entry in read_yaml(ROOT / "config" / "instrument" / "level0_keywords.yaml")["keywords"]["values"]:
        if entry["hdu"] == hdu:
            many = "nn" if entry.get("repeat") else ""
            name = f"**{entry['block'].lower()}**" if "block" in entry else f"`{entry['keyword']}{many}`"
            always = f"`{entry['constant']}`" if "constant" in entry else ""
            lines.append((name, entry.get("comment", ""), always))
    return rows(("keyword", "what", "always"), lines)


def documents():
    """Return {path: text} of the page and of the schema."""
    cat, more, may = truth_columns()
    parts = {
        "header0": header(0), "header1": header(1), "mask": bits(mask, mask.ABOUT), "cat": columns(cat),
        "truth": columns(more), "sometimes": columns(may), "flags": bits(flags, flags.ABOUT),
        "orders": columns(orders.COLUMNS),
        "bricks": columns({name: (kind, text) for name, (kind, _, text) in columns_with("B").items()}),
        "measured": columns(source_columns.COLUMNS), "measured_flags": bits(catalogue, source_columns.FLAGS),
        "spectra": columns(spectrum_columns.COLUMNS), "spectra_flags": bits(spectrum_columns, spectrum_columns.FLAGS),
        "lines": columns(line_columns.COLUMNS), "lines_flags": bits(line_columns, line_columns.FLAGS),
        "merged": columns(merge.ABOUT | merge.ABOUT_BAND), "recovered": columns(recovered.COLUMNS),
        "kept": ", ".join(f"`{name}`" for name in calibrated.COPIED),
        "quality": rows(("bit", "what"), calibrated.DQ.items()),
        "datasets": rows(("dataset", "shape, type", "what"), [(f"`{k}`", *v) for k, v in DATASETS.items()]),
        "attributes": rows(("attribute", "what"), [(f"`{k}`", v) for k, v in ATTRIBUTES.items()]),
    }  # fmt: skip
    return {ROOT / "docs" / "products.md": Template(PAGE).substitute(parts), table_schema.FILE: table_schema.text()}


def stale():
    """Return the paths of files that are missing or differ from the code."""
    return [path for path, text in _made().items() if not path.exists() or path.read_text() != text]


def _made():
    """As documents(), but end with one line if the schema's version is too low."""
    try:
        return documents()
    except ValueError as error:
        sys.exit(str(error))


if __name__ == "__main__":
    if sys.argv[1:] == ["--check"]:
        sys.exit("\n".join(f"{path} is stale: run python builders/make_products.py" for path in stale()) or 0)
    for path, content in _made().items():
        path.write_text(content)
        print(path)
