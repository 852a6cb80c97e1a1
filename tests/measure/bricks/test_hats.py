"""The catalogue of all merged bricks, read as the HATS layout requires: from its own files alone."""

import csv

import healpy
import numpy as np
import pyarrow.dataset as ds
import pyarrow.parquet as pq
import pytest
from support.csst import BANDS
from support.measured_table import table
from support.mini_campaign import POINTINGS, write_campaign

from csstsim.base.errors import InputError
from csstsim.base.rng import stream
from csstsim.campaign.opened import OpenCampaign
from csstsim.catalog.truth_bricks import read_brick, write_brick
from csstsim.io.paths import Paths
from csstsim.measure.bricks.hats import write_catalogue
from csstsim.measure.bricks.merge import merge_brick, write_merged


@pytest.fixture
def catalogue(tmp_path):
    """(paths, bricks): two bricks with 30 and 50 sources far from each other, and one without."""
    paths, bricks, rng = Paths(tmp_path), {}, stream(1, "hats")
    for pix, count in ((550615, 30), (0, 50), (786431, 0)):
        ra, dec = healpy.pix2ang(256, pix, nest=True, lonlat=True)
        found = table(ra + rng.uniform(-0.05, 0.05, count), dec + rng.uniform(-0.05, 0.05, count))
        write_merged(paths.merge(pix), *merge_brick(pix, [found], BANDS), {"brick": pix})
        bricks[pix] = paths.merge(pix)
    write_catalogue(paths.merge_catalogue, "demo", bricks)
    return paths, bricks


def properties(paths):
    lines = (paths.merge_catalogue / "hats.properties").read_text().splitlines()
    return dict(line.split("=", 1) for line in lines if not line.startswith("#"))


def test_partitions_properties_and_rows_agree(catalogue):
    paths, _ = catalogue
    about = properties(paths)
    with (paths.merge_catalogue / "partition_info.csv").open() as file:
        listed = [(int(row["Norder"]), int(row["Npix"])) for row in csv.DictReader(file)]
    assert listed == [(8, 0), (8, 550615), (8, 786431)]
    schema = pq.read_schema(paths.merge_catalogue / "dataset" / "_common_metadata")
    total, index = 0, about["hats_col_healpix"]
    for order, pix in listed:
        folder = paths.merge_catalogue / "dataset" / f"Norder={order}" / f"Dir={pix // 10_000 * 10_000}"
        part = pq.read_table(folder / f"Npix={pix}{about['hats_npix_suffix']}", partitioning=None)
        assert part.schema.remove_metadata().equals(schema)
        number = part[index].to_numpy()
        ra, dec = (part[about[f"hats_col_{axis}"]].to_numpy() for axis in ("ra", "dec"))
        assert (np.diff(number) >= 0).all() and (number >> 2 * (29 - order) == pix).all()
        deep = 2 ** int(about["hats_col_healpix_order"])
        assert (healpy.ang2pix(deep, ra, dec, nest=True, lonlat=True) == number).all()
        total += part.num_rows
    assert total == int(about["hats_nrows"]) == 80 and int(about["hats_max_rows"]) == 50
    assert about["obs_collection"] == "demo" and about["dataproduct_type"] == "object"
    assert float(about["moc_sky_fraction"]) == pytest.approx(3 / 786432)


def test_the_whole_folder_reads_as_one_dataset(catalogue):
    paths, _ = catalogue
    whole = ds.dataset(paths.merge_catalogue / "dataset", partitioning="hive").to_table()
    known = pq.read_metadata(paths.merge_catalogue / "dataset" / "_metadata")
    assert whole.num_rows == known.num_rows == 80 and set(whole["source_id"].to_numpy() >> 20) == {0, 550615}


def test_written_again_it_is_the_same(catalogue):
    paths, bricks = catalogue
    files = [paths.merge_catalogue / name for name in ("hats.properties", "partition_info.csv")]
    before = [file.read_bytes() for file in files]
    write_catalogue(paths.merge_catalogue, "demo", dict(reversed(bricks.items())))
    assert [file.read_bytes() for file in files] == before


def test_a_missing_or_damaged_brick_is_one_clear_line(catalogue):
    paths, bricks = catalogue
    bricks[0].write_bytes(bricks[0].read_bytes()[:1000])
    for path in (bricks[0], paths.merge(1)):
        with pytest.raises(InputError, match=path.name):
            write_catalogue(paths.merge_catalogue, "demo", {0: path})


def test_truth_bricks_are_a_catalogue_too(tmp_path):
    """Bricks as the universe writes them, and the table `hats` and the report's files need: every row, one schema."""
    run = OpenCampaign(write_campaign(tmp_path, POINTINGS[:1]))
    paths = Paths(tmp_path / "sky")
    bricks = {pix: paths.truth(pix) for pix in (550615, 7)}
    for pix, path in bricks.items():
        write_brick(path, pix, **run.universe_key())
    write_catalogue(paths.truth_catalogue, "sky truth", bricks)
    whole = ds.dataset(paths.truth_catalogue / "dataset", partitioning="hive").to_table()
    about = dict(
        line.split("=", 1) for line in (paths.truth_catalogue / "hats.properties").read_text().splitlines()[1:]
    )
    assert whole.num_rows == int(about["hats_nrows"]) == sum(len(read_brick(path)) for path in bricks.values())
    assert set(whole["_healpix_29"].to_numpy() >> 42) == {7, 550615}
    assert (paths.truth_catalogue / "partition_info.csv").read_text().split() == ["Norder,Npix", "8,7", "8,550615"]
    try:
        from hats import read_hats
        from hats.io.validation import is_valid_catalog
    except ImportError:
        return  # a peer reader, not a dependency
    assert is_valid_catalog(paths.truth_catalogue, strict=True)
    assert len(read_hats(paths.truth_catalogue).get_healpix_pixels()) == 2


def test_properties_name_the_columns_the_size_and_the_standard(catalogue):
    from csstsim import __version__

    paths, bricks = catalogue
    about = properties(paths)
    columns = [about[f"hats_col_{name}"] for name in ("ra", "dec", "healpix")]
    assert columns == ["ra", "dec", "_healpix_29"] and about["hats_col_healpix_order"] == "29"
    assert (about["hats_order"], about["hats_version"]) == ("8", "v1.0")
    assert int(about["hats_estsize"]) == sum(path.stat().st_size for path in bricks.values()) // 1024 > 0
    assert about["hats_builder"] == f"csstsim v{__version__}" and "hats_release_date" in about
    known = pq.read_metadata(paths.merge_catalogue / "dataset" / "_metadata")
    files = [known.row_group(k).column(0).file_path for k in range(known.num_row_groups)]
    assert sorted(set(files)) == sorted(f"Norder=8/Dir={pix // 10_000 * 10_000}/Npix={pix}.parquet" for pix in bricks)
