"""What makes the folder of merged bricks a HATS catalogue, which `hats` and `lsdb` open: the files about all of them.

hats.properties  partition_info.csv  dataset/_common_metadata  dataset/Norder=8/Dir=D/Npix=P.parquet
"""

import csv
import io

from csstsim import __version__
from csstsim.atomic import atomic_path
from csstsim.bricks.healpix import HATS_ORDER, NSIDE
from csstsim.catalog.table import ObjectTable

ORDER = 8
STANDARD = {"hats_version": "v1.0", "hats_release_date": "2025-08-22"}  # of the layout's description


def write_catalogue(folder, name, bricks):
    """Write the files of a catalogue `name` in `folder` about `bricks`: {brick: its parquet file}, one at least.

    Bricks without a source are not listed. The same bricks give the same bytes. Raises InputError for a file that is
    missing or damaged.
    """
    import pyarrow.parquet as pq

    rows = {pix: len(ObjectTable.read(path, ["_healpix_29"])) for pix, path in sorted(bricks.items())}
    listed = [pix for pix, count in rows.items() if count]
    properties = {
        "obs_collection": name, "dataproduct_type": "object", "hats_nrows": sum(rows.values()),
        "hats_col_ra": "ra", "hats_col_dec": "dec", "hats_col_healpix": "_healpix_29",
        "hats_col_healpix_order": HATS_ORDER, "hats_npix_suffix": ".parquet", "hats_order": ORDER,
        "hats_max_rows": max(rows.values()), "moc_sky_fraction": len(listed) / (12 * NSIDE**2),
        "hats_estsize": sum(bricks[pix].stat().st_size for pix in listed) // 1024,
        "hats_builder": f"csstsim v{__version__}", **STANDARD,
    }  # fmt: skip
    text = "".join(f"{key}={value}\n" for key, value in properties.items())
    table = io.StringIO()
    csv.writer(table, lineterminator="\n").writerows([("Norder", "Npix"), *((ORDER, pix) for pix in listed)])
    schema = pq.read_schema(next(iter(bricks.values()))).remove_metadata()
    with atomic_path(folder / "dataset" / "_common_metadata") as temporary:
        pq.write_metadata(schema, temporary)
    for file, content in (("partition_info.csv", table.getvalue()), ("hats.properties", "#HATS catalog\n" + text)):
        with atomic_path(folder / file) as temporary:
            temporary.write_text(content, encoding="utf-8")
