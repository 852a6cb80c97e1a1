"""Ways to damage a product: by accident, and so that its checksums still hold."""

import json

import numpy as np
import pyarrow.parquet as pq
from astropy.io import fits

from csstsim.catalog.table import ObjectTable, write_parquet


def flip(path, place=0.5):
    """Flip one bit at this share of the file."""
    content = bytearray(path.read_bytes())
    content[int(place * len(content))] ^= 1
    path.write_bytes(content)


def scratch(path):
    """Turn 300 bytes over: of a parquet file single bits also lie where nothing is read, as in a page's statistics."""
    content = bytearray(path.read_bytes())
    middle = len(content) // 2
    content[middle : middle + 300] = bytes(255 - b for b in content[middle : middle + 300])
    path.write_bytes(content)


def cut(path):
    path.write_bytes(path.read_bytes()[:-3000])


def append(path):
    path.write_bytes(path.read_bytes() + b"tail")


def remove(path):
    path.unlink()


def column(name, change):
    """Return a spoiler that replaces a column of a table by change(column), checksums made anew."""

    def spoil(path):
        table = ObjectTable.read(path)
        table.with_columns(**{name: change(table[name])}).write(path)

    return spoil


def rows(part):
    """Return a spoiler that keeps a slice of the rows."""

    def spoil(path):
        table = ObjectTable.read(path)
        table.take(part).write(path, table.meta)

    return spoil


def record(change):
    """Return a spoiler of a table's metadata: change(meta) in place."""

    def spoil(path):
        table = ObjectTable.read(path)
        change(table.meta)
        table.write(path)

    return spoil


def lists(name, value):
    """Return a spoiler that puts `value` into the first list of a merged brick's column."""

    def spoil(path):
        import pyarrow as pa

        table, meta = pq.ParquetFile(path).read(), ObjectTable.read(path).meta
        values = table[name].to_pylist()
        values[0][0] = value
        place = table.schema.get_field_index(name)
        write_parquet(path, table.set_column(place, name, pa.array(values, table.schema.field(name).type)), meta)

    return spoil


def header(hdu, key, change):
    """Return a spoiler that replaces a FITS keyword by change(value), checksums made anew."""

    def spoil(path):
        with fits.open(path, mode="update", checksum=True) as file:
            file[hdu].header[key] = change(file[hdu].header[key])

    return spoil


def pixels(change):
    """Return a spoiler that replaces the pixels by change(pixels), checksums made anew."""

    def spoil(path):
        with fits.open(path, mode="update", checksum=True, uint=True) as file:
            file["IMAGE"].data = change(file["IMAGE"].data).astype(np.uint16)

    return spoil


def entry(change):
    """Return a spoiler of a JSON file: change(content) in place."""

    def spoil(path):
        content = json.loads(path.read_text())
        change(content)
        path.write_text(json.dumps(content))

    return spoil


def text(old, new):
    """Return a spoiler of a text file."""

    def spoil(path):
        content = path.read_text()
        assert old in content
        path.write_text(content.replace(old, new, 1))

    return spoil
