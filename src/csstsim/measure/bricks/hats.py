"""Files that turn a folder of bricks, merged or true, into a HATS catalogue, which `hats` and `lsdb` can open.

hats.properties  partition_info.csv  dataset/_metadata _common_metadata Norder=8/Dir=D/Npix=P.parquet
"""

from collections.abc import Mapping
from pathlib import Path

from csstsim import __version__
from csstsim.base.files.atomic import atomic_path
from csstsim.base.healpix import BRICKS, HATS_ORDER, ORDER
from csstsim.catalog.table import ObjectTable

ABOUT = "hats.properties", "partition_info.csv", "dataset/_metadata", "dataset/_common_metadata"
STANDARD = {"hats_version": "v1.0", "hats_release_date": "2025-08-22"}  # of the standard that the layout follows


def write_catalogue(folder: Path, name: str, bricks: Mapping[int, Path]) -> None:
    """Write the files of the catalogue `name` in `folder`, of `bricks`: {brick: its parquet file}, at least one.

    The same bricks give the same bytes. Raises InputError for a file that is missing or damaged.
    """
    import pyarrow.parquet as pq

    bricks = dict(sorted(bricks.items()))
    rows = [len(ObjectTable.read(path, ["_healpix_29"])) for path in bricks.values()]
    properties = {
        "obs_collection": name,
        "dataproduct_type": "object",
        "hats_nrows": sum(rows),
        "hats_col_ra": "ra",
        "hats_col_dec": "dec",
        "hats_col_healpix": "_healpix_29",
        "hats_col_healpix_order": HATS_ORDER,
        "hats_npix_suffix": ".parquet",
        "hats_order": ORDER,
        "hats_max_rows": max(rows),
        "moc_sky_fraction": len(bricks) / BRICKS,
        "hats_estsize": sum(path.stat().st_size for path in bricks.values()) // 1024,
        "hats_builder": f"csstsim v{__version__}",
        **STANDARD,
    }
    parts = []
    for path in bricks.values():
        parts.append(pq.read_metadata(path))
        parts[-1].set_file_path(str(path.relative_to(folder / "dataset")))
    schema = pq.read_schema(path).remove_metadata()
    for file, known in (("_common_metadata", None), ("_metadata", parts)):
        with atomic_path(folder / "dataset" / file) as temporary:
            pq.write_metadata(schema, temporary, metadata_collector=known)
    pixels = "".join(f"{ORDER},{pix}\n" for pix in bricks)
    text = "".join(f"{key}={value}\n" for key, value in properties.items())
    for file, content in (
        ("partition_info.csv", "Norder,Npix\n" + pixels),
        ("hats.properties", "#HATS catalog\n" + text),
    ):
        with atomic_path(folder / file) as temporary:
            temporary.write_text(content, encoding="utf-8")
