"""A user's own camera, examples/my_camera: from pointing table to report with its bands, chips and grating."""

import json
import shutil
from pathlib import Path

import astropy.io.fits as fits
import numpy as np
import pytest
import yaml
from delivery.small_delivery import finish
from support.embedded_sky import universe_folder
from support.workflow_run import ROOT, planned, snakemake

from csstsim.campaign.opened import OpenCampaign
from csstsim.catalog.table import ObjectTable
from csstsim.io.level0 import read_level0

pytestmark = pytest.mark.thorough

EXAMPLE = ROOT / "examples" / "my_camera"
FIELD = {"ra": 90.0, "dec": -23.1200, "radius": 0.45}  # within one quarter of the mosaic


def campaign(folder, **changes):
    """Write the example's campaign with changes; return its file."""
    data = yaml.safe_load((EXAMPLE / "campaign.yaml").read_text())
    data |= {name: str(EXAMPLE / data[name]) for name in ("survey_table", "instrument")}
    file = Path(folder) / "campaign.yaml"
    file.write_text(yaml.safe_dump(data | {"output": str(Path(folder) / "out")} | changes))
    return file


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """One arcminute of the field through each chip, few galaxies."""
    file = campaign(
        tmp_path_factory.mktemp("my_camera"), select={"types": ["SCIE"], "chips": "all", "region": FIELD},
        window="region", universe=str(universe_folder()), catalog={"mag_limit": 23.0}, psf={"grid": 2},
    )  # fmt: skip
    return finish(file)


def test_the_workflow_knows_every_file(finished):
    """Of a finished campaign nothing is left to do but the picture that no command of the campaign makes."""
    assert planned(finished.file, "chips=whole") == {"look"}


def test_each_chip_sees_the_field_once(finished):
    assert sorted(job.chip.id for job in finished.jobs) == [1, 2, 3, 4]
    assert {job.chip.filter for job in finished.jobs} == {"Blue", "Green", "Red", "Prism"}


def test_level0_has_eight_channels_of_its_own_header(finished):
    for job in finished.jobs:
        file = read_level0(finished.paths.level0(job), verify=True)
        assert file.readout.n_channels == 8 and (file.readout.nx, file.readout.ny) == (2048, 2064)
        assert file.header0["TELESCOP"] == "MINE" and file.header0["FILTER"] == job.chip.filter
        assert sorted(file.gain) == list(range(1, 9))
        names = [hdu.name for hdu in file.extensions()][1:]
        assert names and set(names) <= {f"CHAN{n:02d}" for n in range(1, 9)}


def test_tables_have_the_cameras_magnitudes_and_no_others(finished):
    bands = ("blue", "green", "red")
    truth = ObjectTable.read(finished.paths.level0_truth(finished.jobs[0]))
    assert [name for name in truth.names if name.startswith("mag_")] == [f"mag_{band}" for band in bands]
    assert np.isfinite([truth[f"mag_{band}"] for band in bands]).all()
    [pix] = finished.merge_bricks
    merged = ObjectTable.read(finished.paths.merge(pix))
    assert [name for name in merged.names if name.startswith("mag_") and "err" not in name] == [
        f"mag_{band}" for band in bands
    ]
    seen = np.all([merged[f"n_{band}"] > 0 for band in bands], axis=0)
    assert seen.sum() >= 3
    # Blue to red, stars and galaxies lie between the colours of a hot and of a cool body
    colour = merged["mag_blue"][seen] - merged["mag_red"][seen]
    assert (np.abs(colour - 1.0) < 3.0).all() and colour.std() > 0.05


def test_spectra_are_those_put_in(finished):
    """The brightest spectrum holds the light that its object's and the grating's curve give, to 5 sigma and 2%."""
    [job] = finished.slitless_jobs
    table = ObjectTable.read(finished.paths.spectra(*job.key))
    one = table.take((table["order"] == 1) & np.isfinite(table["model"]) & (table["flags"] == 0))
    one = one.take(one["id"] == one["id"][np.argmax(one["electrons"])])
    light, error = one["electrons"].sum(), np.sqrt((one["electrons_err"].astype(float) ** 2).sum())
    assert light > 20 * error and abs(light - one["model"].sum()) < 5 * error + 0.02 * light


def test_the_report_names_its_bands_and_no_gate_fails(finished):
    verdict = json.loads(finished.paths.report.with_name("verdict.json").read_text())
    assert verdict["counts"]["fail"] == 0 and verdict["counts"]["pass"] > 10
    page = finished.paths.report.read_text()
    assert all(f">{name}<" in page for name in ("Blue", "Green", "Red")) and ">NUV<" not in page


def test_the_script_makes_the_files_that_are_kept(tmp_path):
    """Text to the letter, FITS to rounding of the fit: 1e-6 px."""
    import importlib.util

    spec = importlib.util.spec_from_file_location("make_instrument", EXAMPLE / "make_instrument.py")
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    copy = Path(shutil.copytree(EXAMPLE, tmp_path / "example"))
    script.make(copy)
    for kept in (p for p in EXAMPLE.rglob("*") if p.suffix in (".yaml", ".conf", ".csv")):
        assert (copy / kept.relative_to(EXAMPLE)).read_text() == kept.read_text(), kept
    for kept in EXAMPLE.rglob("*.fits"):
        with fits.open(kept) as a, fits.open(copy / kept.relative_to(EXAMPLE)) as b:
            for one, other in zip(a[1:], b[1:], strict=True):
                for name in one.columns.names:
                    assert np.allclose(one.data[name], other.data[name], rtol=1e-5, atol=1e-6), (kept, name)


@pytest.mark.slow
def test_all_gates_of_the_whole_example_pass(tmp_path):
    file = campaign(tmp_path)
    snakemake(file, "--cores", "2")
    verdict = json.loads(OpenCampaign(file).paths.report.with_name("verdict.json").read_text())
    assert verdict["passed"] and verdict["counts"]["fail"] == 0 and verdict["counts"]["not evaluated"] <= 8
