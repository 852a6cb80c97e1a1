"""MANIFEST.content: hashes of products without dates and timings, the same in two runs of one campaign.

The hash of a FITS file is of its headers, which have checksums of the data; that of a table is of its values; that of
another product is of what `compare` compares (compare.varying).
"""

import hashlib
import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from csstsim.base.files.atomic import atomic_path
from csstsim.base.process.progress import progress
from csstsim.base.types import PathLike
from csstsim.delivery.manifest import CONTENT, FILES, HASHES, list_content, read_manifest
from csstsim.studies.compare.varying import KEYWORDS, steady_page, varies


def write_contents(folder: PathLike) -> Path:
    """Write MANIFEST.content of the products in MANIFEST.sha256, a hash and a path per line; return its path.

    MANIFEST.sha256 then lists this file, too.
    """
    folder = Path(folder)
    names = sorted(set(read_manifest(folder / HASHES)) - set(FILES))
    lines = [f"{content_hash(folder / name)}  {name}" for name in progress(names, "content", len(names))]
    with atomic_path(folder / CONTENT) as temporary:
        Path(temporary).write_text("\n".join(lines) + "\n", encoding="ascii")
    list_content(folder)
    return folder / CONTENT


def content_hash(path: Path) -> str:
    """Return the hash of a product's content, 64 hex digits. Raises OSError or InputError if it cannot be read."""
    readers = {
        ".fits": _fits_content,
        ".parquet": _table_content,
        ".json": _json_content,
        ".html": _page_content,
        ".h5": _hdf5_content,
    }
    sha256 = hashlib.sha256()
    for part in readers.get(path.suffix, _raw_content)(path):
        sha256.update(part if isinstance(part, bytes) else str(part).encode())
    return sha256.hexdigest()


def _fits_content(path: Path) -> Iterator[str]:
    from csstsim.io.fits import open_fits

    with open_fits(path) as file:
        for number, hdu in enumerate(file):
            for card in hdu.read_header_list():
                name = card["name"] or ""
                if name != "CHECKSUM" and (number or not KEYWORDS.fullmatch(name)):
                    yield f"{name}={card['value']!r}\n"


def _table_content(path: Path) -> Iterator[str | bytes]:
    import pyarrow.parquet as pq

    with pq.ParquetFile(path) as file:
        metadata = {key.decode(): value for key, value in (file.schema_arrow.metadata or {}).items()}
        for name in file.schema_arrow.names:
            if not varies(name):
                stored = file.read(columns=[name])[name]
                column = stored.to_numpy()
                yield f"{name} {column.dtype}\n"
                # As lists of Python: the text of a long numpy array omits its middle
                yield column.tobytes() if column.dtype != object else repr(stored.to_pylist())
    yield _steady_json(json.loads(metadata.get("csstsim", b"{}")))


def _json_content(path: Path) -> Iterator[str]:
    yield _steady_json(json.loads(path.read_text()))


def _page_content(path: Path) -> Iterator[str]:
    yield steady_page(path.read_text())[0]


def _hdf5_content(path: Path) -> Iterator[str | bytes]:
    import h5py

    with h5py.File(path, "r") as file:
        attributes = {name: np.asarray(value).tolist() for name, value in file.attrs.items()}
        yield _steady_json(attributes)
        names = []
        file.visititems(lambda name, item: names.append(name) if isinstance(item, h5py.Dataset) else None)
        for name in sorted(names):
            values = np.ascontiguousarray(file[name][()])
            yield f"{name} {values.dtype} {file[name].shape}\n"
            yield values.tobytes() if values.dtype != object else repr(values.tolist())


def _raw_content(path: Path) -> Iterator[bytes]:
    with path.open("rb") as file:
        while part := file.read(1 << 20):
            yield part


def _steady_json(record: object) -> str:
    """Return the JSON of a record without the keys that vary between runs."""

    def steady(value: object) -> object:
        if isinstance(value, dict):
            return {key: steady(inner) for key, inner in value.items() if not varies(key)}
        return [steady(inner) for inner in value] if isinstance(value, list) else value

    return json.dumps(steady(record), sort_keys=True, default=str)
