"""MANIFEST.content: hashes of what products hold without dates and timings, the same in two runs of one campaign.

Of FITS files the headers count, with the checksums of the data; of tables the values; of other products what `compare`
compares (compare.varying).
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
    """Write MANIFEST.content of the products that MANIFEST.sha256 lists, a hash and a path a line; return its path.

    MANIFEST.sha256 then lists it, too.
    """
    folder = Path(folder)
    names = sorted(set(read_manifest(folder / HASHES)) - set(FILES))
    lines = [f"{content_hash(folder / name)}  {name}" for name in progress(names, "content", len(names))]
    with atomic_path(folder / CONTENT) as temporary:
        Path(temporary).write_text("\n".join(lines) + "\n", encoding="ascii")
    list_content(folder)
    return folder / CONTENT


def content_hash(path: Path) -> str:
    """Return 64 hex digits of what a product holds. Raises OSError or InputError for a file that cannot be read."""
    kinds = {".fits": _of_fits, ".parquet": _of_table, ".json": _of_json, ".html": _of_page, ".h5": _of_hdf5}
    total = hashlib.sha256()
    for part in kinds.get(path.suffix, _of_bytes)(path):
        total.update(part if isinstance(part, bytes) else str(part).encode())
    return total.hexdigest()


def _of_fits(path: Path) -> Iterator[str]:
    from csstsim.io.fits import open_fits

    with open_fits(path) as file:
        for number, hdu in enumerate(file):
            for card in hdu.read_header_list():
                name = card["name"] or ""
                if name != "CHECKSUM" and (number or not KEYWORDS.fullmatch(name)):
                    yield f"{name}={card['value']!r}\n"


def _of_table(path: Path) -> Iterator[str | bytes]:
    import pyarrow.parquet as pq

    with pq.ParquetFile(path) as file:
        about = {key.decode(): value for key, value in (file.schema_arrow.metadata or {}).items()}
        for name in file.schema_arrow.names:
            if not varies(name):
                stored = file.read(columns=[name])[name]
                column = stored.to_numpy()
                yield f"{name} {column.dtype}\n"
                # As Python's own lists: the text of a long numpy array leaves out its middle
                yield column.tobytes() if column.dtype != object else repr(stored.to_pylist())
    yield _steady(json.loads(about.get("csstsim", b"{}")))


def _of_json(path: Path) -> Iterator[str]:
    yield _steady(json.loads(path.read_text()))


def _of_page(path: Path) -> Iterator[str]:
    yield steady_page(path.read_text())[0]


def _of_hdf5(path: Path) -> Iterator[str | bytes]:
    import h5py

    with h5py.File(path, "r") as file:
        attributes = {name: np.asarray(value).tolist() for name, value in file.attrs.items()}
        yield _steady(attributes)
        found = []
        file.visititems(lambda name, item: found.append(name) if isinstance(item, h5py.Dataset) else None)
        for name in sorted(found):
            values = np.ascontiguousarray(file[name][()])
            yield f"{name} {values.dtype} {file[name].shape}\n"
            yield values.tobytes() if values.dtype != object else repr(values.tolist())


def _of_bytes(path: Path) -> Iterator[bytes]:
    with path.open("rb") as file:
        while part := file.read(1 << 20):
            yield part


def _steady(record: object) -> str:
    """Return the JSON of a record without what varies between runs."""

    def kept(value: object) -> object:
        if isinstance(value, dict):
            return {key: kept(inner) for key, inner in value.items() if not varies(key)}
        return [kept(inner) for inner in value] if isinstance(value, list) else value

    return json.dumps(kept(record), sort_keys=True, default=str)
