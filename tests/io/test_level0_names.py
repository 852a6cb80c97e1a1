"""Names of Level-0 files in each form, as the survey's early pipeline and its releases have them."""

import re
from datetime import UTC, datetime
from types import SimpleNamespace

import pytest

from csstsim.io.level0_names import FORMS, NEWEST, read_name
from csstsim.io.paths import Paths

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
