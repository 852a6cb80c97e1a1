"""How sound FITS, HDF5 and parquet files are spoiled from inside: cards, datasets, columns and what is said of them."""

import io
import json

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from fuzz.mutations import NAMES, PLACE, spoiled_bytes, spoiled_tree
from hypothesis import strategies as st

from csstsim.io.fits import BLOCK, _encode, _fold, _word_sum

CARD = 80
CARD_VALUES = (
    "0",
    "-1",
    "1",
    "3",
    "8",
    "16",
    "-64",
    "999",
    "1000000000000",
    "-9223372036854775808",
    "99999999999999999999999",
    "1.5",
    "1E400",
    "NaN",
    "T",
    "F",
    "",
    "(1.0, 2.0)",
    "''",
    "'x'",
    "'../../escaped'",
    "'RICE_1'",
    "'GZIP_1'",
    "'BINTABLE'",
    "'9216 x 9232'",
    "'1000000 x 1000000'",
    "'0 x 0'",
    "'x'*9",
    "'unclosed",
    "'caf\u00e9'",
    "[not a value]",
)
KEYWORDS = (
    "NAXIS",
    "NAXIS1",
    "NAXIS2",
    "NAXIS999",
    "BITPIX",
    "PCOUNT",
    "GCOUNT",
    "TFIELDS",
    "ZNAXIS1",
    "ZNAXIS2",
    "ZCMPTYPE",
    "ZTILE1",
    "ZIMAGE",
    "XTENSION",
    "EXTNAME",
    "BZERO",
    "BSCALE",
    "END",
    "CONTINUE",
    "SIMPLE",
    "TFORM1",
    "THEAP",
)


def spoiled_fits(sound):
    """FITS with cards that lie, are doubled, lost or damaged; half of them with checksums that are right again."""
    change = st.tuples(
        st.sampled_from(("value", "value", "value", "keyword", "drop", "double", "raw")),
        PLACE,
        st.sampled_from(CARD_VALUES),
        st.sampled_from(KEYWORDS),
    )
    cards = st.tuples(st.lists(change, min_size=1, max_size=3), st.booleans())
    return cards.map(lambda drawn: _apply_fits(sound, *drawn)) | spoiled_bytes(sound)


def _cards(data):
    """Return where cards stand: (start, keyword) of each."""
    found = []
    for start in range(0, len(data) - CARD + 1, CARD):
        keyword = bytes(data[start : start + 8])
        if data[start + 8 : start + 10] == b"= " and keyword.strip().isascii() and keyword.strip():
            found.append((start, keyword))
    return found


def _apply_fits(data, changes, sealed):
    data = bytearray(data)
    headers = _headers(data)
    for kind, place, value, keyword in changes:
        cards = _cards(data)
        named = [c for c in cards if c[1].strip() == keyword.encode()] if place % 2 else cards
        start, _ = (named or cards)[place // 2 % len(named or cards)]
        card = bytes(data[start : start + CARD])
        new = {
            "value": card[:10] + value.rjust(20).encode("utf-8"),
            "keyword": keyword.ljust(8).encode() + card[8:],
            "drop": b"",
            "double": card,
            "raw": card[:20] + bytes([place % 256]) + card[21:],
        }[kind]
        data[start : start + CARD] = new[:CARD].ljust(CARD)
        if kind == "double" and len(cards) > 1:
            other = cards[place // 7 % len(cards)][0]
            data[other : other + CARD] = card
    return bytes(_sealed(data, headers) if sealed else data)


def _headers(data):
    """Return (start, stop) of each HDU of a sound file."""
    starts = [at for at in range(0, len(data), BLOCK) if data[at : at + 8] in (b"SIMPLE  ", b"XTENSION")]
    return list(zip(starts, [*starts[1:], len(data)], strict=True))


def _sealed(data, hdus):
    """Return the data with every CHECKSUM made right; the HDUs lie as they did before."""
    for start, stop in hdus:
        at = bytes(data[:stop]).find(b"CHECKSUM= '", start)
        if at < 0:
            continue
        data[at + 11 : at + 27] = b"0" * 16
        total = _fold(_word_sum(np.frombuffer(bytes(data[start:stop]), np.uint8)))
        data[at + 11 : at + 27] = _encode(0xFFFFFFFF - total).encode()
    return data


def spoiled_hdf5(sound):
    """HDF5 with datasets of other shape, type or place, huge ones, links that lead nowhere or out, odd attributes."""
    kinds = ("shape", "huge", "type", "values", "drop", "group", "loop", "out", "external", "attribute", "no attribute")
    change = st.tuples(st.sampled_from(kinds), PLACE)
    return st.lists(change, min_size=1, max_size=2).map(lambda c: _apply_hdf5(sound, c)) | spoiled_bytes(sound)


def _apply_hdf5(data, changes):
    buffer = io.BytesIO(data)
    with h5py.File(buffer, "r+") as file:
        for kind, place in changes:
            names = []
            file.visit(names.append)
            if not names:
                break
            name = names[place % len(names)]
            holders = [file, *(file[n] for n in names if n in file)]
            holder = holders[place // 7 % len(holders)]
            if "attribute" in kind and len(holder.attrs):
                _spoil_attribute(holder.attrs, kind, place)
            else:
                _spoil_node(file, name, kind, place)
    return buffer.getvalue()


def _spoil_attribute(attrs, kind, place):
    name = list(attrs)[place // 11 % len(attrs)]
    del attrs[name]
    odd = (
        0,
        -1,
        61,
        2**40,
        np.nan,
        np.inf,
        b"\xff\xfe",
        "../../escaped",
        "\x1b[31m",
        "{}",
        "[[1]]",
        np.zeros((3, 3)),
        h5py.Empty("f"),
        np.zeros(0),
        True,
        np.array([b"a", b"b"]),
    )
    if kind == "attribute":
        attrs[name] = odd[place // 13 % len(odd)]


def _spoil_node(file, name, kind, place):
    old = file[name]
    shape = getattr(old, "shape", ()) or (1,)
    del file[name]
    if kind == "huge":
        huge = ((2**40,), (2**31, 2), (1, 2**33), (2**33, *shape[1:]), tuple(n * 2**16 for n in shape))[place // 13 % 5]
        file.create_dataset(name, huge, "f8", chunks=tuple(min(n, 64) for n in huge), fillvalue=1.0)
    elif kind == "shape":
        other = ((), (0,), (1,), (3,), (0, 2), (2, 2, 2), shape[::-1], (shape[0] + 1, *shape[1:]))
        file.create_dataset(name, other[place // 13 % len(other)], "f8")
    elif kind == "type":
        shape = tuple(min(n, 100) for n in shape)
        types = (
            "S5",
            h5py.string_dtype(),
            "i1",
            "c16",
            [("a", "f8")],
            h5py.vlen_dtype("f8"),
            h5py.ref_dtype,
            "?",
            ">f2",
        )
        file.create_dataset(name, shape, types[place // 13 % len(types)])
    elif kind == "values" and np.prod(shape) < 1e6:
        value = (np.nan, np.inf, -1, 0, 1e30, -1e30)[place // 13 % 6]
        file.create_dataset(name, data=np.full(shape, value, "f8"))
    elif kind == "group":
        file.create_group(name)
    elif kind == "loop":
        file[name] = h5py.SoftLink(f"/{name}")
    elif kind == "out":
        file[name] = h5py.ExternalLink(("/etc/passwd", "../../escaped", "/dev/zero")[place // 13 % 3], "/x")
    elif kind == "external":
        source = ("/dev/zero", "/etc/passwd", "/nowhere")[place // 13 % 3]
        shape = tuple(min(n, 100) for n in shape)
        file.create_dataset(name, shape, "f8", external=[(source, 0, h5py.h5f.UNLIMITED)])


def spoiled_parquet(sound):
    """Parquet with columns lost, doubled or of another type, nulls, no rows, another record; sealed as ours are."""
    kinds = ("drop", "rename", "double", "type", "nulls", "values", "none", "record", "many")
    change = st.tuples(st.sampled_from(kinds), PLACE, st.sampled_from(NAMES))
    table = pq.read_table(io.BytesIO(sound))
    record = st.sampled_from([{}]) | spoiled_tree({"recipe": {"camera": "a"}, "spectra": 3, "product": "truth brick"})
    drawn = st.tuples(st.lists(change, min_size=1, max_size=3), record)
    return drawn.map(lambda d: _apply_parquet(table, *d)) | spoiled_bytes(sound)


def _apply_parquet(table, changes, record):
    """Return the spoiled table as write_parquet seals it, or, where that cannot, without a seal."""
    from csstsim.catalog.table import _META_KEY, _SUMS_KEY, _checksum

    about = dict(table.schema.metadata or {})
    for kind, place, name in changes:
        table = _spoil_table(table, kind, place, name)
        if kind == "record":
            about[_META_KEY] = json.dumps(record).encode("utf-8", "surrogatepass")
    try:
        sums = {"": _checksum(about[_META_KEY])}
        sums |= {name: _checksum(table[name].to_numpy()) for name in table.column_names}
        about[_SUMS_KEY] = json.dumps(sums).encode()
    except (KeyError, ValueError, pa.ArrowException):
        pass
    buffer = io.BytesIO()
    pq.write_table(table.replace_schema_metadata(about), buffer)
    return buffer.getvalue()


def _spoil_table(table, kind, place, name):
    if not table.num_columns:
        return table
    at = place % table.num_columns
    rows, column = table.num_rows, table.column_names[at]
    if kind == "drop":
        return table.remove_column(at)
    if kind == "rename":
        return table.rename_columns([name if i == at else n for i, n in enumerate(table.column_names)])
    if kind == "double":
        return table.append_column(column, table[at])
    if kind == "none":
        return table.slice(0, place // 7 % 2)
    if kind == "many" and rows < 1000:
        return pa.concat_tables([table] * 50)
    odd = {
        "nulls": (pa.nulls(rows), pa.nulls(rows, pa.float64()), pa.nulls(rows, pa.int64())),
        "values": tuple(pa.array(np.full(rows, v)) for v in (np.nan, np.inf, -1, 1e300, 2**62, -(2**63))),
        "type": (
            pa.array(["x"] * rows),
            pa.array([[1.0]] * rows, pa.list_(pa.float64())),
            pa.array([{"a": 1}] * rows, pa.struct({"a": pa.int64()})),
            pa.array([b"\xff"] * rows, pa.binary()),
            pa.array([True] * rows),
            pa.array([0] * rows, pa.timestamp("ns")),
        ),
    }.get(kind)
    return table if odd is None else table.set_column(at, column, odd[place // 7 % len(odd)])
