"""Spectra whose neighbours are known by a catalogue: a scene of a table, whose spectra are those of its magnitudes."""

import json

import fitsio
import numpy as np
import pytest
import yaml
from support.commands import done, refused

from csstsim.base.shipped import SHIPPED
from csstsim.campaign.opened import OpenCampaign
from csstsim.catalog.astrometry.reduction import icrs
from csstsim.catalog.table import ObjectTable

pytestmark = pytest.mark.thorough

OBSID, KEY = "10100000001", ("--obsid", "10100000001", "--chip", 2)
WINDOW = {"x0": 3100, "x1": 4300, "y0": 4100, "y1": 4220}
PLACES = np.array([2650.3, 2690.1, 4700.6, 2000.0]), np.array([4140.2, 4145.0, 4185.7, 900.0])  # the last: far away
TABLE = "type,ra,dec,mag_g,mag_r,mag_i,size,e1,e2\n"


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    """Two objects whose spectra overlap, one of the other grating and one elsewhere; from a table."""
    folder = tmp_path_factory.mktemp("known")
    content = {
        "schema_version": 1, "name": "known", "seed": 5, "output": str(folder / "out"), "window": WINDOW,
        "survey_table": str(SHIPPED.parent / "survey_tables" / "demo.csv"), "psf": {"grid": 2},
        "select": {"types": ["SCIE"], "chips": [2], "obsids": [OBSID]},
    }  # fmt: skip
    file = folder / "campaign.yaml"
    file.write_text(yaml.safe_dump(content))
    job = OpenCampaign(file).job(OBSID, 2)
    ra, dec = icrs(*job.wcs.pixel_to_world(*PLACES), job.observer)
    rows = ["star,{},{},17.5,17.1,16.9,,,", "galaxy,{},{},17.3,16.8,16.5,0.4,0.2,0.1", "star,{},{},17,17,17,,,",
            "star,{},{},18,18,18,,,"]  # fmt: skip
    lines = [row.format(*at) for row, at in zip(rows, zip(ra, dec, strict=True), strict=True)]
    (folder / "objects.csv").write_text(TABLE + "\n".join(lines) + "\n")
    catalog = {"kind": "csstsim.catalog.own_table:TableCatalog", "options": {"file": str(folder / "objects.csv")}}
    file.write_text(yaml.safe_dump(content | {"catalog": catalog}))
    done("chip", file, *KEY)
    done("extract", file, *KEY)
    return file


def spectra(file, chosen=True):
    run = OpenCampaign(file)
    path = run.paths.spectra(OBSID, 2)
    return ObjectTable.read(run.paths.output / "chosen" / path.name if chosen else path)


@pytest.fixture
def changed(campaign):
    """A function that changes the campaign's `measurement.contamination` until the end of the test."""
    before = campaign.read_text()

    def change(**contamination):
        content = yaml.safe_load(before) | {"measurement": {"contamination": contamination}}
        campaign.write_text(yaml.safe_dump(content))

    yield change
    campaign.write_text(before)


def test_bands_of_a_smooth_spectrum_tell_all_of_it(campaign):
    """Where the true spectra are those of the magnitudes, a catalogue knows as much as the truth: 0.2%."""
    truth = spectra(campaign, chosen=False)
    said = done("extract", campaign, *KEY, "--contamination", "catalogue", "--image")
    table, mine = spectra(campaign), truth["id"] == 1
    assert "expected light of all orders" in said and truth["contamination"][mine].sum() > 1e4
    close = pytest.approx(
        truth["contamination"][mine], abs=2e-3 * float(truth["contamination"][mine].max()), nan_ok=True
    )
    assert table["contamination"][table["id"] == 1] == close
    assert spectra(campaign, chosen=False) == truth  # the workflow's is as it was
    image, header = fitsio.read(
        str(next((campaign.parent / "out" / "chosen").glob("*_contamination.fits"))), header=True
    )
    assert image.shape == (120, 1200) and header["X0"] == 3100 and header["BUNIT"] == "electron"
    run = OpenCampaign(campaign)
    orders = ObjectTable.read(run.paths.level0_orders(run.job(OBSID, 2)))
    inside = orders["drawn"].sum()
    assert image.sum() == pytest.approx(inside, rel=0.05)  # wings beyond 64 px, light below a tenth of the noise


def test_a_table_knows_as_much_as_the_truth_it_was_made_from(campaign, changed):
    table = campaign.parent / "objects.csv"
    changed(known_from="catalogue", table="objects.csv")
    truth, run = spectra(campaign, chosen=False), OpenCampaign(campaign)
    assert run.recipe(run.job(OBSID, 2), "measure") != truth.meta["recipe"]
    done("extract", campaign, *KEY, "--ids", "1,2,3")
    found = spectra(campaign)
    scale = truth["contamination"].max()
    assert found["contamination"] == pytest.approx(truth["contamination"], abs=3e-3 * float(scale), nan_ok=True)
    table.with_name("far.csv").write_text(TABLE + "star,10.0,10.0,18,18,18,,,\n")
    changed(known_from="catalogue", table="far.csv")
    assert "no object whose light reaches the chip" in refused("extract", campaign, *KEY, "--ids", "1")


def test_a_neighbour_beyond_the_depth_stays_in_the_spectrum(campaign, changed):
    truth = spectra(campaign, chosen=False)
    changed(known_from="catalogue", depth=16.7)  # the galaxy alone, 16.5 in i
    done("extract", campaign, *KEY, "--ids", "1,2")
    found, star, galaxy = spectra(campaign), truth["id"] == 1, truth["id"] == 2
    assert not found["contamination"][found["id"] == 2].any() and truth["contamination"][galaxy].sum() > 1e4
    light, true = found["box"][found["id"] == 2].sum(), truth["box"][galaxy].sum()
    assert light > 1.05 * true
    assert found["contamination"][found["id"] == 1] == pytest.approx(
        truth["contamination"][star], abs=2e-3 * float(truth["contamination"].max()), nan_ok=True
    )


def test_kept_light_is_stated(campaign):
    done("extract", campaign, *KEY, "--contamination", "kept")
    truth, found = spectra(campaign, chosen=False), spectra(campaign)
    mine = found["id"] == 1
    assert found["box"][mine].sum() > truth["box"][truth["id"] == 1].sum() + 1e4 and (found["contamination"] > 0).any()


def test_faults_are_told(campaign, changed):
    changed(known_from="catalogue", table="absent.csv")
    assert "absent.csv" in refused("extract", campaign, *KEY)
    changed(table="objects.csv")
    assert "known_from" in refused("extract", campaign, *KEY)
    changed(known_from="catalogue", depth=5.0)
    assert "no object" in refused("extract", campaign, *KEY, "--ids", "1")


def test_a_budget_of_redshifts_by_the_command(campaign, tmp_path):
    """One galaxy, of redshift 0: right, not right, not in the answer; and answers that cannot be used."""
    folder, answer = tmp_path / "budget", tmp_path / "redshifts.csv"
    said = done("budget", "redshift", campaign, "--output", folder)
    assert "1 galaxies in 1 frames" in said and not (folder / "redshift.json").exists()
    stack, objects = (ObjectTable.read(folder / name) for name in ("stack.parquet", "objects.parquet"))
    assert objects["id"].tolist() == [2] and set(stack["id"].tolist()) == {1, 2, 3}
    assert objects["magnitude"][0] == pytest.approx(16.5, abs=1e-3) and objects["contamination"][0] > 0.1
    for row, complete in (("2,0.001,1", 1.0), ("2,0.02,1", 0.0), ("2,0.001,0", 0.0), ("1,0.0,1", 0.0)):
        answer.write_text(f"id,z,good\n{row}\n")
        done("budget", "redshift", campaign, "--output", folder, "--answer", answer)
        found = json.loads((folder / "redshift.json").read_text())
        assert found["all"]["completeness"] == complete and found["all"]["objects"] == 1
    assert (folder / "redshift.png").read_bytes().startswith(b"\x89PNG")
    redshift = "a redshift, above -1"
    for text, fault in (
        ("id,z\n2,0\n", "it lacks good"), ("id,z,good\n2,0,2\n", "line 2, good: not an answer (got '2')"),
        ("id,z,good\n2,0,1\n2,0,1\n", "given twice"), ("id,z,good\n\n2,nan,0\n", "line 3, z: not an answer"),
        ("id,z,good\n2,inf,1\n", redshift), ("id,z,good\n2,-1,1\n", redshift),
        ("id,z,good\n2,0,1\n77,0,1\n78,0,1\n", "(got 77)"),
    ):  # fmt: skip
        answer.write_text(text)
        assert fault in refused("budget", "redshift", campaign, "--output", folder, "--answer", answer)
    said = refused("budget", "redshift", campaign, "--spectra", "nowhere")
    assert "no table of spectra" in said and str(campaign.parent.absolute() / "nowhere") in said
    assert "no such band" in refused("budget", "redshift", campaign, "--band", "q")
    assert "--answer" in refused("budget", "redshift", campaign, "--output", tmp_path / "new", "--answer", "nowhere")
    assert not (tmp_path / "new").exists()


def test_a_budget_of_redshifts_counts_no_noise_twice_and_takes_its_own_spectra(campaign, tmp_path):
    words = "budget", "redshift", campaign, "--output", tmp_path / "budget"
    again = campaign.with_name("again.yaml")
    again.write_text(yaml.safe_dump(yaml.safe_load(campaign.read_text()) | {"output": str(tmp_path / "out")}))
    for other in (campaign, again):
        assert f"{OBSID}, chip 2" in refused(*words, "--also", other)
    before = campaign.read_text()
    campaign.write_text(yaml.safe_dump(yaml.safe_load(before) | {"seed": 6}))
    try:
        assert "made for another campaign" in refused(*words)
    finally:
        campaign.write_text(before)
        again.unlink()
    assert not (tmp_path / "budget").exists()
