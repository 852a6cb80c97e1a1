"""Names of Level-0 files in each form, as the survey's early pipeline and its releases have them."""

import re
from datetime import UTC, datetime
from types import SimpleNamespace

import pytest

from csstsim.base.errors import InputError
from csstsim.io.level0_names import FORMS, NEWEST, read_name
from csstsim.io.paths import Paths, existing_product

# Names that stand in public files (csster/csst, data_manager.py; the W1 release), for the exposure below
NAMES = {
    "C9": ("CSST_MSC_MS_WIDE_20270810081950_20270810082220_100000100_06_L0_V01",) * 2,
    "C5.2": ("CSST_MSC_MS_SCI_20270810081950_20270810082220_100000100_06_L0_1", "MSC_100000100_chip_06_filt_y"),
    "C5.1": ("CSST_MSC_MS_SCI_20270810081950_20270810082220_100000100_06_L0_1", "MSC_10000100_chip_06_filt_y"),
    "C3": ("MSC_MS_270810081950_100000100_06_raw", "MSC_270810081950_0000100_06"),
}


def job(kind="SCIE", obsid="100000100", chip=6, band="y", survey="WIDE"):
    start, end = (datetime(2027, 8, 10, 8, minute, second, tzinfo=UTC) for minute, second in ((19, 50), (22, 20)))
    pointing = SimpleNamespace(type=kind, start=start, end=end, survey=survey)
    return SimpleNamespace(pointing=pointing, obsid=obsid, chip=SimpleNamespace(id=chip, filter=band))


@pytest.mark.parametrize("form", FORMS)
def test_names_are_the_public_ones(form, tmp_path):
    level0, catalogue = NAMES[form]
    paths = Paths(tmp_path, names=form)
    folder = tmp_path / "level0" / "100000100"
    assert paths.level0(job()) == folder / f"{level0}.fits"
    assert paths.level0_truth(job()) == folder / f"{level0}.truth.parquet"
    assert paths.level0_catalogue(job()) == folder / f"{catalogue}.cat"
    assert re.fullmatch(f"{FORMS[form].beginning}_100000100_06_{FORMS[form].ending}", level0)


def test_the_newest_is_the_default(tmp_path):
    assert Paths(tmp_path).level0(job()) == Paths(tmp_path, names=NEWEST).level0(job())


def test_filters_are_small_letters():
    stem = FORMS["C5.2"].stem(job(chip=12, band="NUV"))
    assert FORMS["C5.2"].catalogue(stem, "NUV").endswith("chip_12_filt_nuv")


@pytest.mark.parametrize(("form", "word"), [("C9", "DEEP"), ("C5.2", "SCI"), ("C3", "MS")])
def test_deep_exposures_are_named_so_where_the_form_has_a_word(form, word):
    stem = FORMS[form].stem(job(survey="DEEP"))
    assert f"_{word}_" in stem and read_name(stem) == ("SCIE", "100000100", 6)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("kind", ["SCIE", "BIAS", "DARK", "FLAT"])
@pytest.mark.parametrize("obsid", ["100000100", "10105900001", "10109200100412"])
def test_a_name_is_read_back(form, kind, obsid):
    assert read_name(FORMS[form].stem(job(kind, obsid, 30))) == (kind, obsid, 30)


@pytest.mark.parametrize(
    "name",
    ["", "CSST_MSC_MS_CRS_20270810081950_20270810082220_100000100_06_L0_1", "MSC_MS_270810081950_100000100_6_raw",
     "CSST_MSC_MS_WIDE_20270810081950_20270810082220_100000100_06_L0_1", NAMES["C9"][0] + ".truth"],
)  # fmt: skip
def test_other_names_are_not_ours(name):
    assert read_name(name) is None


def test_every_product_has_its_own_place(tmp_path):
    """By hand, with and without a scratch disk; bricks lie in folders of ten thousand."""
    paths, made = Paths(tmp_path / "out", tmp_path / "fast"), job()
    stem = f"level0/100000100/{NAMES['C9'][0]}"
    wanted = {
        "truth/dataset/Norder=8/Dir=120000/Npix=123456.parquet": paths.truth(123456), "truth": paths.truth_catalogue,
        "merge/dataset/Norder=8/Dir=0/Npix=9999.parquet": paths.merge(9999), "merge": paths.merge_catalogue,
        "merge/dataset/Norder=8/Dir=10000/Npix=10000.parquet": paths.merge(10000), "psf/chip_08.h5": paths.psf(8),
        "psf/chip_08_tables.h5": paths.psf_tables(8), f"{stem}.truth.parquet": paths.level0_truth(made),
        f"{stem}.cat": paths.level0_cat(made), f"{stem}.orders.parquet": paths.level0_orders(made),
        f"{stem}.cosmic.fits": paths.level0_cosmic(made), "masters/chip_08.fits": paths.masters(8),
        "calibrated/101_08.fits": paths.calibrated("101", 8), "measure/101_08.parquet": paths.measure("101", 8),
        "spectra/101_08.parquet": paths.spectra("101", 8), "spectra/101_08_lines.parquet": paths.lines("101", 8),
        "validate/77.json": paths.validate(77), "look/101_08.png": paths.look("101", 8),
        "report/index.html": paths.report, "report/variants.html": paths.variants_page,
    }  # fmt: skip
    assert {name: tmp_path / "out" / name for name in wanted} == wanted
    assert paths.stage("101", 8, "render.fits") == tmp_path / "fast" / "chips" / "101_08" / "render.fits"
    assert Paths(tmp_path).stage("101", 8, "readout.fits") == tmp_path / "chips" / "101_08" / "readout.fits"


def test_a_product_that_is_missing_names_its_command(tmp_path):
    (tmp_path / "a").write_text("")
    assert existing_product(tmp_path / "a", "psf") == tmp_path / "a"
    for name in (".", "b"):
        with pytest.raises(InputError, match="not made yet; `csstsim psf` makes it"):
            existing_product(tmp_path / name, "psf")


@pytest.mark.parametrize(("form", "codes"), [
    ("C9", {"BIAS": "BIAS", "DARK": "DARK", "FLAT": "FLAT"}), ("C5.1", {"BIAS": "BIAS", "FLAT": "FLAT"}),
    ("C3", {"BIAS": "CLB", "DARK": "CLD", "FLAT": "CLF"}),
])  # fmt: skip
def test_codes_of_calibrations(form, codes):
    for kind, code in codes.items():
        assert f"_{code}_" in FORMS[form].stem(job(kind)) and f"_{code}_" not in FORMS[form].stem(job())


def test_numbers_of_the_older_catalogues():
    """Seven digits and more of C3, none less than zero of C5.1; a name of another form has none."""
    stem = FORMS["C3"].stem(job(obsid="100234567"))
    assert FORMS["C3"].catalogue(stem, "r") == "MSC_270810081950_0234567_06"
    assert FORMS["C5.1"].catalogue(stem, "r") is None and FORMS["C3"].read(NAMES["C9"][0]) is None


@pytest.mark.parametrize("scratch", [True, False])
def test_patterns_of_the_workflow_are_the_paths_of_products(tmp_path, scratch):
    """With their placeholders filled in; what stages hand on may be on another disk."""
    paths, made = Paths(tmp_path / "out", tmp_path / "fast" if scratch else None), job()
    words = {"obsid": made.obsid, "chip": f"{made.chip.id:02d}", "stem": paths.stem(made)}
    for name, path in (
        ("render.fits", paths.stage(made.obsid, made.chip.id, "render.fits")), ("level0", paths.level0(made)),
        ("level0_truth", paths.level0_truth(made)), ("measure", paths.measure(made.obsid, made.chip.id)),
        ("psf", paths.psf(made.chip.id)),
    ):  # fmt: skip
        assert paths.pattern(name).format(**words) == str(path)
