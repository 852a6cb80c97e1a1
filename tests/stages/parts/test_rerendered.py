"""Light of a variant with other objects, made from that of its base: the bits of a full run, and when it is not."""

import numpy as np
import pytest
import yaml
from support.commands import done
from support.mini_campaign import POINTINGS, write_campaign

from csstsim.campaign.opened import OpenCampaign
from csstsim.catalog.astrometry.reduction import icrs
from csstsim.catalog.table import ObjectTable
from csstsim.io.frames import load_frame
from csstsim.render.drawn_table import ADDED
from csstsim.stages.parts.rerendered import _same_rows

JOB = "10100000001", 9
OPTIONS = ["--obsid", JOB[0], "--chip", JOB[1]]
FAINT, BRIGHT = 25.0, 17.0
TIMES = "ms"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A campaign of forty faint objects, two bright stars and one of a few electrons, with its light."""
    folder = tmp_path_factory.mktemp("rerendered")
    plain = write_campaign(folder, [POINTINGS[0]], keep="light")
    job, rng = OpenCampaign(plain).job(*JOB), np.random.default_rng(12)
    w, count = job.window, 48
    x, y = rng.uniform(w.x0, w.x1, count), rng.uniform(w.y0, w.y1, count)
    ra, dec = icrs(*job.wcs.pixel_to_world(x, y), job.observer)
    mag = np.array([FAINT] * 40 + [BRIGHT] * 2 + [30.0] + [FAINT] * 3 + [BRIGHT, 30.5])
    kinds = np.where(np.arange(count) % 3, "star", "galaxy")
    rows = [
        f"{k + 1},{ra[k]:.8f},{dec[k]:.8f},{mag[k]},{kinds[k]},{0.2 if kinds[k] == 'galaxy' else ''}"
        for k in range(count)
    ]
    tables = {
        "base": rows[:43], "one_more": rows[:44], "one_less": rows[1:43], "many": rows[5:46],
        "moved": _moved(rows[:43]), "shuffled": [*rows[20:44], *rows[:20]], "faintest": rows[:43] + rows[47:],
        "bright": rows[:43] + rows[46:47], "less_bright": rows[:41] + rows[42:43],
    }  # fmt: skip
    for name, lines in tables.items():
        (folder / f"{name}.csv").write_text("\n".join(["id,ra,dec,mag_r,type,size", *lines]) + "\n")
    data = yaml.safe_load(plain.read_text())
    catalog = {"kind": "csstsim.catalog.own_table:TableCatalog", "options": {"file": "base.csv"}}
    variants = {name: {"catalog": {"options": {"file": f"{name}.csv"}}} for name in tables if name != "base"}
    variants["other_psf"] = {"catalog": {"options": {"file": "one_more.csv"}}, "psf": {"grid": 3}}
    plain.write_text(yaml.safe_dump(data | {"catalog": catalog, "variants": variants}))
    done("psf", plain, "--chip", JOB[1])
    for verb in ("select", "render"):
        done(verb, plain, *OPTIONS)
    return folder


def _moved(rows):
    cells = rows[7].split(",")
    cells[2] = f"{float(cells[2]) + 1e-4:.8f}"
    return [*rows[:7], ",".join(cells), *rows[8:]]


def light(folder, name, of_base=True):
    """(planes, header, table) of the light of a variant, and the log; of_base: whether that of the base may be used."""
    campaign = f"{folder / 'campaign.yaml'}@{name}"
    kept = OpenCampaign(folder / "campaign.yaml").paths.stage(*JOB, "render.fits")
    away = kept.with_suffix(".away")
    if not of_base:
        kept.rename(away)
    try:
        if name == "other_psf":
            done("psf", campaign, "--chip", JOB[1])
        done("select", campaign, *OPTIONS)
        logged = done("render", campaign, *OPTIONS)
    finally:
        if not of_base:
            away.rename(kept)
    paths = OpenCampaign(campaign).paths
    planes, meta = load_frame(paths.stage(*JOB, "render.fits"))
    return planes, meta["header"], ObjectTable.read(paths.stage(*JOB, "drawn.parquet")), logged


@pytest.mark.parametrize(("name", "logged"), [
    ("one_more", "1 object added and 0 subtracted"), ("one_less", "0 objects added and 1 subtracted"),
    ("many", "3 objects added and 5 subtracted"), ("moved", "1 object added and 1 subtracted"),
    ("shuffled", "1 object added and 0 subtracted"), ("faintest", "1 object added and 0 subtracted"),
])  # fmt: skip
def test_photons_give_the_bits_of_a_full_run(folder, name, logged):
    planes, header, table, text = light(folder, name)
    full, full_header, full_table, full_text = light(folder, name, of_base=False)
    assert logged in text and "subtracted" not in full_text
    assert planes.keys() == full.keys() and planes["counted"].any()
    assert all(planes[key].tobytes() == full[key].tobytes() for key in full)
    assert table.names == full_table.names and table.meta.keys() == full_table.meta.keys()
    for column in table.names:
        if column != TIMES:
            assert table[column].dtype == full_table[column].dtype, column
            assert np.array_equal(table[column], full_table[column], equal_nan=table[column].dtype.kind == "f"), column
    varying = {"timing", "stages", "objects_electrons"}
    assert {k: v for k, v in header.items() if k not in varying} == {
        k: v for k, v in full_header.items() if k not in varying
    }  # fmt: skip
    assert header["objects_electrons"] == pytest.approx(full_header["objects_electrons"], rel=1e-15)


@pytest.mark.parametrize("name", ["bright", "less_bright", "other_psf"])
def test_other_light_is_rendered_in_full(folder, name):
    assert "subtracted" not in light(folder, name)[3]


@pytest.mark.parametrize("other", ["objects", "drawn"])
def test_a_column_that_one_table_has_alone_makes_a_full_run(other):
    """Knots of the base alone, or of the variant alone, are light that the ids and positions do not tell."""
    same = {"id": np.array([3, 5]), "mag_r": np.array([20.0, 21.0]), "flags": np.zeros(2, np.int32)}
    tables = {"objects": dict(same), "drawn": same | {name: np.zeros(2) for name in ADDED}}
    assert _same_rows(*map(ObjectTable, tables.values())).tolist() == [0, 1]
    tables[other]["knots"] = np.array([0, 10])
    assert _same_rows(*map(ObjectTable, tables.values())) is None


def test_rows_are_the_same_by_all_their_numbers_and_those_unknown_in_both_agree():
    same = {"id": np.array([3, 5, 9]), "z": np.array([np.nan, 0.5, np.nan]), "catalog_row": np.arange(3)}
    base = same | {"id": np.array([9, 3, 5]), "z": np.array([0.25, np.nan, 0.5]), "catalog_row": np.zeros(3)}
    assert _same_rows(ObjectTable(same), drawn(base)).tolist() == [1, 2, -1]
    assert (
        _same_rows(ObjectTable(same), drawn({name: values[:0] for name, values in base.items()})).tolist() == [-1] * 3
    )


def drawn(columns):
    return ObjectTable(columns | {name: np.zeros(len(columns["id"])) for name in ADDED})


@pytest.mark.parametrize("change", [{"id": np.array([3, 3])}, {"image_file": np.array(["a.fits", "b.fits"])}])
def test_equal_ids_and_images_from_files_are_rendered_in_full(change):
    """Random numbers of equal ids go by their order; a file may have changed under its name."""
    one = {"id": np.array([3, 5]), "z": np.zeros(2)}
    for table, base in ((one | change, one), (one, one | change), (one | change, one | change)):
        if "image_file" in change and base.keys() != table.keys():
            continue  # columns of one alone: the test above
        assert _same_rows(ObjectTable(table), drawn(base)) is None


def test_methods_are_those_that_the_test_means(folder):
    rendered = ObjectTable.read(OpenCampaign(folder / "campaign.yaml").paths.stage(*JOB, "drawn.parquet"))
    methods = dict(zip(rendered["id"].tolist(), rendered["method"].tolist(), strict=True))
    assert {methods[k] for k in [*range(1, 41), 43]} == {"photons"} and methods[41] == methods[42] == "stamp"
