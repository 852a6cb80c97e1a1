"""A survey table's deep exposures are named so in files and headers; nothing else of any exposure changes."""

import pytest
from astropy.io import fits
from support.commands import command, done
from support.mini_campaign import HEADER, POINTINGS, write_campaign

from csstsim.base.errors import InputError
from csstsim.campaign.opened import OpenCampaign
from csstsim.campaign.survey_table import exposures_of

pytestmark = pytest.mark.thorough

DEEP = POINTINGS[1].split(",")[0]


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Return the campaigns (file, their frames by obsid) with the column `survey` and without it."""
    found = []
    for name, parts in (("with", ("", "DEEP", "WIDE")), ("without", None)):
        folder = tmp_path_factory.mktemp(name)
        star = {"kind": "support.mini_campaign:Stars", "options": {"ra": [60.15], "dec": [-40.0], "mag": [20.0]}}
        file = write_campaign(folder, select={"types": ["SCIE", "BIAS"], "chips": [9]}, catalog=star)
        if parts:
            lines = [HEADER + ",survey", *(f"{row},{part}" for row, part in zip(POINTINGS, parts, strict=True))]
            (folder / "table.csv").write_text("\n".join(lines) + "\n")
        for row in POINTINGS:
            done("chip", file, "--obsid", row.split(",")[0], "--chip", 9)
        found.append((file, {path.parent.name: path for path in (folder / "out" / "level0").glob("*/*V01.fits")}))
    return found


def test_names_and_keywords(made):
    (_, marked), (_, plain) = made
    words = {obsid: path.name.split("_")[3] for obsid, path in marked.items()}
    assert words == {"10100000001": "WIDE", DEEP: "DEEP", "10300000001": "BIAS"}
    assert marked[DEEP].name.replace("DEEP", "WIDE") == plain[DEEP].name
    header = fits.getheader(marked[DEEP])
    assert (header["FILENAME"], header["SURVEY"], header["FILETYPE"]) == (marked[DEEP].stem, "DEEP", "SCIE")
    assert "SURVEY" not in fits.getheader(plain[DEEP]) and (marked[DEEP].with_suffix(".truth.parquet")).is_file()


def test_the_wide_survey_has_the_files_it_had(made):
    """Also the digest of the exposure: a finished campaign stays finished if its table gets the column."""
    (_, marked), (_, plain) = made
    for obsid in set(plain) - {DEEP}:
        assert marked[obsid].name == plain[obsid].name
        assert command("compare", "--provenance", plain[obsid], marked[obsid]).exit_code == 0
    assert fits.getheader(marked[DEEP])["EXPHASH"] != fits.getheader(plain[DEEP])["EXPHASH"]
    with fits.open(marked[DEEP]) as deep, fits.open(plain[DEEP]) as wide:
        assert (deep[1].data == wide[1].data).all()


def test_a_delivery_is_verified_with_and_without_its_campaign(made):
    (file, marked), _ = made
    folder = marked[DEEP].parents[2]
    for of in (file, folder):
        said = command("verify", of).output
        assert "DEEP" not in said, said  # the frames are sound: what else is not made yet does not matter here
    marked[DEEP].unlink()
    assert marked[DEEP].name in command("verify", file).output
    assert OpenCampaign(file).job(DEEP, 9).pointing.survey == "DEEP"


@pytest.mark.parametrize(
    ("row", "part", "said"),
    [
        (POINTINGS[0], "deep", "line 2, column survey: unknown survey component (got 'deep'); allowed: WIDE, DEEP"),
        (POINTINGS[2], "DEEP", "line 2, column survey: allowed for science exposures only"),
    ],
)
def test_parts_of_the_survey(row, part, said):
    with pytest.raises(InputError, match="column survey") as caught:
        exposures_of(f"{HEADER},survey\n{row},{part}")
    assert said in str(caught.value)
