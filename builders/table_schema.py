"""The machine-readable schema of every table: config/schema/tables.json, written by builders/make_products.py.

Each table's `schema` is a Table Schema (Frictionless Data, https://specs.frictionlessdata.io/table-schema), to which
`dtype`, `unit`, `bits` (of flags) and `optional` (a column that not all such tables have) are added. Names, types and
meanings come from the modules that write the tables. Columns of bands are those of the shipped camera.

VERSION rises with the columns: the first number if one goes, or changes its type, unit or bits; the second if one is
added; the third if only words change. `check_raised` refuses anything less.
"""

import json

import numpy as np

from csstsim.base.shipped import SHIPPED
from csstsim.catalog import flags
from csstsim.catalog.changing import columns as changing
from csstsim.catalog.table import OPTIONAL, columns_with
from csstsim.inject.recovery import recovered
from csstsim.instrument.camera import load_camera
from csstsim.io import orders, truth
from csstsim.measure import source_columns
from csstsim.measure.bricks import merge
from csstsim.measure.bricks.validation.gates import record
from csstsim.measure.spectra import line_columns, spectrum_columns
from csstsim.studies.compare.tables import units_of
from csstsim.studies.release import pack_truth

VERSION = "2.3.0"
FILE = SHIPPED / "schema" / "tables.json"
_EMBEDDED = {
    "sed_scale": (np.float32, "factor of the spectrum that coeff0 to coeff19 give"),
    **{f"coeff{k}": (np.float32, "coefficient of the spectrum (catalog.embedded)") for k in range(20)},
    "_healpix_29": (np.int64, "HEALPix index of order 29, nested"),
}
_LISTS = {"detection_obsid", "detection_chip", "detection_filter", "detection_number"}
_KINDS = {"i": "integer", "u": "integer", "f": "number", "b": "boolean", "U": "string"}


def tables():
    """Return {table: (title, path below an output folder, columns, bits, optional ones)}.

    columns: {name: (type, text)}; bits: {column: {bit: text}}; optional: columns that not all such tables have.
    """
    bands = load_camera(SHIPPED / "instrument").bands
    bricks = {name: (kind, text) for name, (kind, _, text) in columns_with(bands).items()} | _EMBEDDED
    merged = {name: (merge.TYPES.get(name, np.float64), text) for name, text in merge.ABOUT.items()}
    merged |= {
        name.replace("_B", f"_{band}"): (merge.TYPES.get(name, np.float64), text)
        for band in bands for name, text in merge.ABOUT_BAND.items()
    }  # fmt: skip
    dispersed = {name: (orders.TYPES.get(name, np.float64), text) for name, text in orders.COLUMNS.items()}
    lines = spectrum_columns.FLAGS | line_columns.FLAGS
    known, sometimes = _truth(bands)
    stem = "level0/{obsid}/{name}"
    return {
        "truth": ("drawn objects of a Level-0 file", f"{stem}.truth.parquet", known, {"flags": flags.ABOUT}, sometimes),
        "orders": ("their orders, of a grating chip", f"{stem}.orders.parquet", dispersed, {}, ()),
        "bricks": (
            "the true sky", "truth/dataset/Norder=8/Dir={dir}/Npix={brick}.parquet", bricks, {"flags": flags.ABOUT},
            _EMBEDDED,
        ),
        "measured": (
            "detections of a Level-0 file", "measure/{obsid}_{chip}.parquet", source_columns.COLUMNS,
            {"flags": source_columns.FLAGS}, (),
        ),
        "extracted": (
            "spectra of a Level-0 file, by columns of pixels", "spectra/{obsid}_{chip}.parquet",
            spectrum_columns.COLUMNS, {"flags": spectrum_columns.FLAGS}, (),
        ),
        "lines": (
            "emission lines in them", "spectra/{obsid}_{chip}_lines.parquet", line_columns.COLUMNS, {"flags": lines}, ()
        ),
        "merged": (
            "sources of all exposures and bands", "merge/dataset/Norder=8/Dir={dir}/Npix={brick}.parquet", merged,
            {"flags": source_columns.FLAGS}, (),
        ),
        "recovered": (
            "injected objects, from csstsim recover", "{output}.recovered.parquet", recovered.COLUMNS,
            {"flags": source_columns.FLAGS}, (),
        ),
        "pack": ("true objects of a benchmark pack", "truth/objects.parquet", _of_pack(bands), {}, ()),
        "validation": (
            "gates, in the list `gates` of JSON", "report/verdict.json", record.ABOUT, {},
            ("exposure", "chip", "channel"),
        ),
    }  # fmt: skip


def _of_pack(bands):
    """Return {column: (type, text)} of the objects of a pack with all bands."""
    return {
        name.replace("_B", f"_{band}"): (pack_truth.TYPES.get(name, np.float64), text)
        for name, text in pack_truth.COLUMNS.items() for band in (bands if name.endswith("_B") else ("",))
    }  # fmt: skip


def _truth(bands):
    """Return ({column: (type, text)} of truth tables, the columns that not all of them have)."""
    described = columns_with(bands) | OPTIONAL | changing.COLUMNS
    types = {name: kind for name, (kind, _, _) in described.items()} | truth.TYPES
    texts = {name: text for name, (_, _, text) in described.items()} | truth.ABOUT
    texts |= {name: truth.ABOUT["mag_B"] for name in texts if name.startswith("mag_")}
    del texts["mag_B"]
    texts |= {name: text for name, (_, text) in _EMBEDDED.items()}
    types |= {name: kind for name, (kind, _) in _EMBEDDED.items()}
    order = {ours: name for name, ours in truth.CAT_COLUMNS.items()} | {
        name: name for name in texts if name not in truth.CAT_COLUMNS.values()
    }
    optional = {*truth.OPTIONAL_COLUMNS, *OPTIONAL, *changing.COLUMNS, *_EMBEDDED}
    return {name: (types[ours], texts[ours]) for ours, name in order.items()}, optional


def schema():
    """Return the schema, JSON-like."""
    made = {}
    for table, (title, path, columns, bits, optional) in tables().items():
        fields, units = [], units_of(columns)
        for name, (kind, text) in columns.items():
            dtype, unit = np.dtype(kind), units.get(name)
            field = {"name": name, "type": "array" if name in _LISTS else _KINDS[dtype.kind], "dtype": _word(dtype)}
            field |= ({"unit": unit} if unit and dtype.kind == "f" else {}) | {"description": text}
            field |= {"bits": {str(bit): words for bit, words in bits[name].items()}} if name in bits else {}
            fields.append(field | ({"optional": True} if name in optional else {}))
        made[table] = {"title": title, "path": path, "schema": {"fields": fields}}
    return {"version": VERSION, "written_by": "builders/make_products.py", "tables": made}


def _word(dtype):
    return "string" if dtype.kind == "U" else dtype.name


def text():
    """Return the text of FILE. Raises ValueError if its columns changed and VERSION did not rise enough."""
    new = schema()
    if FILE.exists():
        check_raised(json.loads(FILE.read_text()), new)
    return json.dumps(new, indent=1) + "\n"


def check_raised(old, new):
    """Raise ValueError if the version of a `new` schema is too low for what differs from the `old` one."""
    place, what = change(old, new)
    before, after = (tuple(map(int, one["version"].split("."))) for one in (old, new))
    least = before if place is None else (*before[:place], before[place] + 1, 0, 0)[:3]
    if after < least:
        least = ".".join(map(str, least))
        raise ValueError(f"{what}: raise VERSION in builders/table_schema.py to {least} or more (now {new['version']})")


def change(old, new):
    """Return (0, 1 or 2: which number of the version must rise, why); (None, "") if nothing differs."""
    had, has = _columns(old), _columns(new)
    for column in had:
        if column not in has:
            return 0, f"{column} is gone"
        for key in ("type", "dtype", "unit", "bits", "optional"):
            if _meaning(had[column], key) != _meaning(has[column], key):
                return 0, f"{column}: another {key}"
    added = [column for column in has if column not in had]
    if added:
        return 1, f"{added[0]} is new"
    return (None, "") if old["tables"] == new["tables"] else (2, "descriptions changed")


def _meaning(field, key):
    """Return what a reader's program relies on: of bits, which there are."""
    value = field.get(key)
    return sorted(value) if isinstance(value, dict) else value


def _columns(schema):
    return {
        f"{table}.{field['name']}": field
        for table, about in schema["tables"].items() for field in about["schema"]["fields"]
    }  # fmt: skip
