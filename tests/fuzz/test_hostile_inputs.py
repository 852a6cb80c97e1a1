"""Explicit examples of what fuzzing found: inputs that gave a traceback, crash, hang or exhausted memory."""

import os

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from fuzz import seeds
from fuzz.spoil import headers, seal
from fuzz.worker import Worker


@pytest.fixture(scope="module")
def worker(tmp_path_factory):
    made = Worker(tmp_path_factory.getbasetemp())
    yield made
    made.close()


@pytest.fixture
def refused(worker):
    """Return a function that gives a path to a reader and returns the line it is refused with."""

    def ask(reader, path):
        outcome, text = worker(f"fuzz.readers:{reader}", path)
        assert outcome == "refused", (outcome, text)
        return text

    return ask


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("catalog: {options: &a {again: *a}}", "alias 'a' inside its own value"),
        ("catalog: {options: " + "[" * 500 + "]" * 500 + "}", "deeper than 100"),
        ('name: !!python/object/apply:os.system ["touch escaped"]', "could not determine a constructor"),
        ("name: !!python/module:fuzz_tripwire", "could not determine a constructor"),
        ("? !!python/name:fuzz_tripwire.run\n: 1", "could not determine a constructor"),
        ("name: ../../escaped", "name"),
        ('"\\e[31mred": 1', "x1b[31mred"),
        ("? " + "x" * 100_000 + "\n: 1", "xxx ..."),
    ],
)
def test_yaml(tmp_path, refused, text, words):
    path = tmp_path / "campaign.yaml"
    name = "" if text.startswith("name") else "name: x\n"
    path.write_text(f"schema_version: 1\n{name}survey_table: a\noutput: b\nseed: 1\n{text}\n")
    line = refused("campaign", path)
    assert words in line and len(line) < 1600


@pytest.mark.parametrize("reader", ["campaign", "observation", "survey_table", "instrument"])
def test_a_pipe_or_a_device_without_end(tmp_path, refused, reader):
    """A link to /dev/zero, and a pipe that nobody writes to."""
    name = "GI1.conf" if reader == "instrument" else "x.yaml"
    folder = seeds.in_instrument("gratings")(tmp_path) if reader == "instrument" else tmp_path
    path = folder / name
    path.unlink(missing_ok=True)
    path.symlink_to("/dev/zero")
    assert "pipe or device" in refused(reader, path)
    path.unlink()
    os.mkfifo(path)
    assert "pipe or device" in refused(reader, path)


@pytest.mark.parametrize(
    "name", ["../../escaped", "/tmp/escaped", "a/b", "10100000001\\n", "..", "10100000001%00", "١٢٣٤٥٦٧٨٩"]
)
def test_an_obsid_is_no_path(tmp_path, refused, name):
    path = seeds.survey_table(tmp_path)
    lines = path.read_text().splitlines()
    path.write_text("\n".join([lines[2], ",".join([name, *lines[-1].split(",")[1:]])]))
    assert "observation id" in refused("survey_table", path)


@pytest.mark.parametrize("shape", [(2**40,), (2**31, 2), (1, 2**33)])
def test_hdf5_that_announces_more_than_there_is(tmp_path, refused, shape):
    for maker, reader, name in (
        (seeds.c9_stars, "c9_stars", "RA"),
        (seeds.psf, "psf", "nodes_xy"),
        (seeds.psf_library, "psf_library", "psfMat"),
    ):
        path = maker(tmp_path)
        with h5py.File(path, "r+") as file:
            found = []
            file.visit(lambda full, name=name, found=found: found.append(full) if full.endswith(name) else None)
            del file[found[0]]
            file.create_dataset(found[0], shape, "f8", chunks=tuple(min(n, 64) for n in shape))
        refused(reader, path)


def test_hdf5_whose_numbers_are_a_device(tmp_path, refused):
    path = seeds.c9_spectra(tmp_path)
    with h5py.File(path, "r+") as file:
        del file["wavelength"]
        file.create_dataset("wavelength", (100,), "f8", external=[("/dev/zero", 0, h5py.h5f.UNLIMITED)])
    assert "another file" in refused("c9_spectra", path)


@pytest.mark.parametrize("kind", ["dataset for a group", "group for a dataset", "link to nowhere"])
def test_hdf5_of_another_build(tmp_path, refused, kind):
    path = seeds.c9_stars(tmp_path)
    with h5py.File(path, "r+") as file:
        pixel = next(iter(file["star_catalog"]))
        name = "star_catalog" if kind == "dataset for a group" else f"star_catalog/{pixel}/RA"
        del file[name]
        if kind == "dataset for a group":
            file[name] = 1.0
        elif kind == "group for a dataset":
            file.create_group(name)
        else:
            file[name] = h5py.SoftLink("/nowhere")
    assert "stars.h5" in refused("c9_stars", path)


def _edited(path, *changes):
    """Replace cards of a FITS file and make its checksums right again."""
    data = path.read_bytes()
    hdus = headers(data)
    for old, new in changes:
        at = data.index(old.encode())
        data = data[:at] + new.ljust(len(old)).encode() + data[at + len(old) :]
    path.write_bytes(bytes(seal(bytearray(data), hdus)))


@pytest.mark.parametrize(
    "card",
    [
        "ZTILE1  =                    0",
        "ZTILE1  =                   -7",
        "ZNAXIS1 =        1000000000000",
        "ZBITPIX =                    7",
    ],
)
def test_compressed_level0_that_would_end_the_process(tmp_path, refused, card):
    path = seeds.level0(compress=True)(tmp_path)
    data = path.read_bytes()
    at = next(i for i in range(0, len(data), 80) if data[i : i + 8] == card[:8].encode())
    _edited(path, (data[at : at + 30].decode(), card))
    refused("level0", path)


def test_a_dust_map_whose_column_has_no_name(tmp_path, refused):
    path = seeds.dust(tmp_path)
    _edited(path, ("TTYPE1  = 'EBV     '", "TTYPE1  =          T"))
    assert "AssertionError" in refused("dust_map", path)


@pytest.mark.parametrize(("name", "axes"), [("star_spectra", 1), ("galaxy_spectra", 3)])
def test_spectra_of_more_axes_than_astropy_ever_ends_to_count(tmp_path, refused, name, axes):
    path = seeds.in_universe(f"{name}.fits")(tmp_path)
    _edited(path, (f"NAXIS   = {axes:20d}", "NAXIS   =        1000000000000"))
    assert "no length" in refused(name, path)


def test_a_dust_map_of_more_columns_than_memory(tmp_path, refused):
    path = seeds.dust(tmp_path)
    _edited(path, ("TFIELDS =                    1", "TFIELDS =             16777216"))
    assert "no length" in refused("dust_map", path)


def test_a_tile_axis_given_twice(tmp_path, refused):
    """The second time without length: cfitsio divides by it as soon as it opens the file."""
    path = seeds.level0(compress=True)(tmp_path)
    text = path.read_bytes().decode("latin-1")
    at = text.index("ZPCOUNT =")
    _edited(path, (text[at : at + 80], "ZNAXIS2 =              -1.8E-05"))
    assert "no length" in refused("level0", path)


@pytest.mark.parametrize("kind", ["a mask of another shape", "a table for an image"])
def test_level0_whose_parts_do_not_fit(tmp_path, refused, kind):
    import fitsio

    path = seeds.level0()(tmp_path)
    with fitsio.FITS(path) as file:
        image = file["IMAGE"].read()
        header = file["IMAGE"].read_header()
    with fitsio.FITS(path, "rw", clobber=True) as file:
        file.write(None)
        if kind == "a table for an image":
            file.write({"a": np.arange(3)}, extname="IMAGE")
        else:
            file.write(image, header=header, extname="IMAGE")
            file.write(np.zeros((3, 3), "u1"), extname="MASK")
        for hdu in file:
            hdu.write_checksum()
    refused("level0", path)


@pytest.mark.parametrize("meta", [[], 7, None, {"exposure": 7}, {"exposure": [1]}])
def test_a_frame_whose_record_is_no_record(tmp_path, refused, meta):
    path = seeds.frame(tmp_path, meta)
    assert "metadata cannot be read" in refused("frame", path)
    refused("picture", path)


def test_a_frame_whose_record_is_no_json(tmp_path, refused):
    path = seeds.frame(tmp_path)
    _edited(path, ('{"exposure"', "{{exposure'"))
    assert "metadata cannot be read" in refused("frame", path)


def test_a_frame_whose_header_holds_no_number(tmp_path, refused):
    path = seeds.frame(tmp_path)
    text = path.read_bytes()[2880:5760].decode()
    at = text.index("PCOUNT")
    _edited(path, (text[at : at + 30], "PCOUNT  =           (1.0, 2.0)"))
    refused("frame", path)


@pytest.mark.parametrize("reader", ["table", "truth", "orders", "brick", "scene"])
def test_parquet_with_a_column_twice(tmp_path, refused, reader):
    path = {"truth": seeds.truth, "orders": seeds.orders}.get(reader, seeds.objects)(tmp_path)
    table = pq.read_table(path)
    pq.write_table(table.append_column(table.column_names[0], table[0]), path)
    assert "given twice" in refused(reader, path)


def test_parquet_of_a_few_kilobytes_with_half_a_billion_values(tmp_path, refused):
    path = seeds.objects(tmp_path)
    about = pq.read_table(path).schema.metadata
    table = pa.table({name: pa.nulls(1 << 27) for name in ("id", "ra", "dec")})
    pq.write_table(table.replace_schema_metadata(about), path)
    assert path.stat().st_size < 1_000_000
    assert "too many rows" in refused("table", path)


@pytest.mark.parametrize("reader", ["truth", "orders", "brick"])
def test_words_in_a_column_of_numbers(tmp_path, refused, reader):
    from csstsim.catalog.table import ObjectTable

    path = {"truth": seeds.truth, "orders": seeds.orders}.get(reader, seeds.objects)(tmp_path)
    name = {"truth": "xImage", "orders": "p"}.get(reader, "ra")
    table = ObjectTable.read(path)
    table.with_columns(**{name: np.full(len(table), "far")}).write(path)
    assert f"{name}: must be numbers" in refused(reader, path)


@pytest.mark.parametrize(
    ("name", "old", "new", "words"),
    [
        ("chips.yaml", "filter: GI", "filter: [GI]", "chips[0].filter: input should be a valid string"),
        ("psf.yaml", "static:", "static: 7\nmore:", "psf.yaml"),
        ("scatter.yaml", "reference:", "reference: {a: 1}\nmore:", "scatter.yaml"),
        ("level0_keywords.yaml", "from: version", "from: [version]", "unknown quantity"),
        ("level0_keywords.yaml", "keyword: SIMVER", "keyword: [SIMVER]", "an entry is"),
        ("ghosts.yaml", "geometry:", "geometry: x\nmore:", "must be mappings"),
    ],
)
def test_instrument(tmp_path, refused, name, old, new, words):
    path = seeds.in_instrument(name)(tmp_path)
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    assert words in refused("instrument", path)


@pytest.mark.parametrize("name", ["a(escaped.fits)", "a[1]", "a b", "!a", "a+1", "%s\n", "x.gz"])
def test_folders_named_as_cfitsio_would_expand_them(tmp_path, worker, name):
    """cfitsio reads 'in(out)' as "copy in to out", 'a[1]' as an extension, '!a' as "overwrite"."""
    folder = tmp_path / name
    folder.mkdir()
    before = sorted(p.name for p in tmp_path.iterdir())
    outcome, text = worker("fuzz.readers:level0", seeds.level0()(folder))
    assert outcome in ("read", "refused"), text
    assert sorted(p.name for p in tmp_path.iterdir()) == before
    assert {p.name for p in folder.iterdir()} == {"instrument", "level0.fits"}
