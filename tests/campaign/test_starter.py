"""`csstsim init`: the folder works unchanged, with the shipped sky and with a user's own objects."""

import math
import os
import re
import runpy
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits
from click.testing import CliRunner

from csstsim.base.errors import InputError
from csstsim.base.shipped import ROOT
from csstsim.campaign.opened import OpenCampaign
from csstsim.campaign.starter import EXAMPLES, FILES, _circle
from csstsim.catalog.astrometry.reduction import apparent
from csstsim.command_line.main import main

OBJECTS = "ra,dec,mag_r,type,size\n359.999,2.2,20,star,\n0.001,2.201,21,galaxy,0.5\n"


@pytest.fixture
def init(tmp_path, monkeypatch):
    """Run `csstsim init mysky` with more arguments in an empty folder, and go there."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "objects.csv").write_text(OBJECTS)

    def run(*arguments):
        result = CliRunner().invoke(main, ["init", "mysky", *arguments])
        if result.exit_code == 0:
            monkeypatch.chdir(tmp_path / "mysky")
        return result

    return run


def test_the_folder_runs_as_it_is(init):
    result = init()
    assert result.exit_code == 0 and all(name in result.output for name in FILES)
    run = OpenCampaign("campaign.yaml")
    assert len(run.jobs) == 6 and {job.chip.filter for job in run.jobs} == {"g", "r", "i"}
    assert run.steps["SCIE"].file == Path("science.yaml")
    line = [sys.executable, "-m", "snakemake", "--cores", "2", "--dry-run", "--quiet", "rules"]
    environment = os.environ | {"PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}
    done = subprocess.run(line, capture_output=True, text=True, env=environment, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    assert "report" in done.stdout + done.stderr and "level0" not in os.listdir()


def test_objects_of_ones_own_are_pointed_at(init):
    """Across RA 0: each of the three chips has both objects in its window."""
    assert init("--catalogue", "objects.csv").exit_code == 0
    run = OpenCampaign("campaign.yaml")
    assert [job.chip.filter for job in run.jobs] == ["g", "r", "i"]
    heading = Path("campaign.yaml").read_text().splitlines()[1]
    assert "your objects, observed once in each of g, r and i" in heading and "twice" not in heading
    for job in run.jobs:
        middle = job.wcs.pixel_to_world(4607.5, 4615.5)
        assert abs((middle[0] + 180) % 360 - 180) < 0.02 and abs(middle[1] - 2.2005) < 0.02  # deg: aberration is in it
        assert 430 < job.window.nx < 450  # 0.2 arcmin and half the 0.14 between them, both ways
    result = CliRunner().invoke(main, ["check", "campaign.yaml"])
    assert result.exit_code == 0 and "2 objects" in result.output and "2 of them are near" in result.output


def test_one_object_is_told_in_the_singular(init, tmp_path):
    (tmp_path / "objects.csv").write_text(OBJECTS.rpartition("0.001")[0])
    assert init("--catalogue", "objects.csv").exit_code == 0
    said = CliRunner().invoke(main, ["check", "campaign.yaml"]).output
    assert "1 object: 1 of type star" in said and "1 of them is near" in said


def test_nothing_is_written_over(init, tmp_path):
    assert init().exit_code == 0
    os.chdir(tmp_path)
    (tmp_path / "mysky/campaign.yaml").write_text("mine")
    result = init()
    assert result.exit_code == 2 and "exists already, and nothing was written" in result.output
    assert (tmp_path / "mysky/campaign.yaml").read_text() == "mine"


@pytest.mark.parametrize("name", ["a: b.csv", "#x.csv", "x{}, y.csv", '"q".csv', "back\\1.csv", "été *&!.csv"])
def test_any_name_of_a_table(init, tmp_path, name):
    (tmp_path / name).write_text(OBJECTS)
    assert init("--catalogue", name).exit_code == 0
    assert OpenCampaign("campaign.yaml").config.catalog.options == {"file": name}


def with_image(name, folder):
    """A table of a star and a galaxy whose image has this name; the image is written below the folder."""
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    x = np.arange(21) - 10.0
    fits.writeto(path, np.exp(-0.1 * np.add.outer(x**2, x**2)), overwrite=True)
    header, star, galaxy = OBJECTS.split()
    return f"{header},image_file,image_scale\n{star},,\n{galaxy},{name},0.05\n"


def test_files_that_a_table_names_come_along(init, tmp_path):
    (tmp_path / "objects.csv").write_text(with_image("pictures/a.fits", tmp_path))
    result = init("--catalogue", "objects.csv")
    assert result.exit_code == 0 and "pictures/a.fits  named in your table" in result.output
    copied = Path("pictures/a.fits")
    assert copied.read_bytes() == (tmp_path / "pictures/a.fits").read_bytes()
    (tmp_path / "pictures/a.fits").unlink()
    assert OpenCampaign("campaign.yaml").jobs and CliRunner().invoke(main, ["check", "campaign.yaml"]).exit_code == 0


def test_spectra_and_parts_of_images_come_along(init, tmp_path):
    """`a.fits[1]` is an extension of the file a.fits; a spectrum is a file, too."""
    text = with_image("pictures/a.fits", tmp_path).replace("a.fits", "a.fits[0]").splitlines()
    (tmp_path / "spectrum.csv").write_text("WAVELENGTH,FLUX\n2000,1\n12000,1\n")
    lines = [f"{line},{name}" for line, name in zip(text, ("spectrum_file", "spectrum.csv", ""), strict=True)]
    (tmp_path / "objects.csv").write_text("\n".join(lines) + "\n")
    assert init("--catalogue", "objects.csv").exit_code == 0
    for name in ("pictures/a.fits", "spectrum.csv"):
        assert Path(name).read_bytes() == (tmp_path / name).read_bytes()


def test_objects_of_the_south_lie_in_the_windows(init, tmp_path):
    """Each at least 0.2 arcmin, 162 px, from the edges, by its apparent place."""
    (tmp_path / "objects.csv").write_text("ra,dec,mag_r\n210.0,-61.5,20\n210.05,-61.48,21\n")
    assert init("--catalogue", "objects.csv").exit_code == 0
    jobs = OpenCampaign("campaign.yaml").jobs
    for job in jobs:
        places = apparent(np.array([210.0, 210.05]), np.array([-61.5, -61.48]), job.observer)
        x, y = job.wcs.world_to_pixel(*places)
        for at, low, high in ((x, job.window.x0, job.window.x1), (y, job.window.y0, job.window.y1)):
            assert (at > low + 160).all() and (at < high - 160).all()
    assert len(jobs) == 3


def test_files_named_by_whole_paths_stay(init, tmp_path):
    (tmp_path / "objects.csv").write_text(with_image(str(tmp_path / "far" / "a.fits"), tmp_path))
    assert init("--catalogue", "objects.csv").exit_code == 0 and not list(Path().rglob("*.fits"))


@pytest.mark.parametrize("name", ["../a.fits", "science.yaml"])
def test_files_that_would_be_lost_are_refused(init, tmp_path, name):
    text = with_image(name, tmp_path / "below")
    (tmp_path / "below" / "objects.csv").write_text(text)
    result = init("--catalogue", "below/objects.csv")
    assert result.exit_code == 2 and name in result.output and not (tmp_path / "mysky").exists()


def test_another_table_is_another_recipe(init):
    """A changed cell of the user's table, or a changed line of a layer, makes the chips again."""
    assert init("--catalogue", "objects.csv").exit_code == 0
    recipes = []
    for text in (OBJECTS, OBJECTS.replace("20,star", "21,star")):
        Path("objects.csv").write_text(text)
        run = OpenCampaign("campaign.yaml")
        recipes.append(run.recipe(run.jobs[0]))
    assert recipes[0]["campaign"] != recipes[1]["campaign"] and recipes[0]["layers"] == recipes[1]["layers"]


def test_a_folder_half_made_is_taken_away(init, tmp_path):
    (tmp_path / "mysky").mkdir()
    (tmp_path / "mysky/profiles").write_text("a file where a folder is wanted")
    result = init()
    assert result.exit_code == 2 and [path.name for path in (tmp_path / "mysky").iterdir()] == ["profiles"]


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ("ra,dec\n1,2\n", "a column is missing"),
        ("ra,dec,mag_r\n", "no objects"),
        ("ra,dec,mag_r\n10,0,20\n10,1,20\n", "too far from each other"),
        ("ra,dec,mag_r\n10,,20\n", "row 1 cannot be rendered: ra, dec is not a position"),
        ("", "the table is empty"),
    ],
)
def test_a_table_that_cannot_be_used_leaves_no_folder(init, tmp_path, table, message):
    (tmp_path / "objects.csv").write_text(table)
    result = init("--catalogue", "objects.csv")
    assert result.exit_code == 2 and message in result.output, result.output
    assert not (tmp_path / "mysky").exists()


@pytest.mark.parametrize("example", EXAMPLES)
def test_an_example_is_a_folder_that_runs_from_anywhere(tmp_path, monkeypatch, example):
    """What its campaigns share with others is in the folder, and modules beside a campaign are found."""
    folder = tmp_path / "mine"
    made = CliRunner().invoke(main, ["init", str(folder), "--example", example])
    assert made.exit_code == 0 and "README.md" in made.output
    listed = made.output.split("\n\nNext:")[0].splitlines()
    assert listed and all(line.partition("  ")[2].strip() for line in listed), listed
    if (folder / "make_data.py").exists():
        runpy.run_path(str(folder / "make_data.py"))["main"](folder / "data")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    campaigns = [path for path in folder.glob("*.yaml") if "schema_version" in path.read_text()]
    assert campaigns
    for campaign in campaigns:
        checked = CliRunner().invoke(main, ["check", str(campaign)])
        assert checked.exit_code == 0 and ": good; " in checked.output, checked.output
        assert OpenCampaign(campaign).paths.output.is_relative_to(folder)
    links = re.findall(r"\]\(([^)#]+)", (folder / "README.md").read_text())
    assert all((folder / link).exists() for link in links), links
    for name in [name for name, module in sys.modules.items() if str(folder) in str(getattr(module, "__file__", ""))]:
        del sys.modules[name]


@pytest.mark.slow
def test_the_camera_of_an_installed_csstsim_is_made_again_by_its_script(tmp_path):
    """With what pyproject.toml puts into the wheel, and nothing of a clone."""
    build = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["hatch"]["build"]["targets"]["wheel"]
    for source, target in ({"src/csstsim": "csstsim"} | build["sources"] | build["force-include"]).items():
        (tmp_path / "site" / target).parent.mkdir(parents=True, exist_ok=True)
        if (ROOT / source).is_file():
            shutil.copy(ROOT / source, tmp_path / "site" / target)
        elif source != "src":
            shutil.copytree(ROOT / source, tmp_path / "site" / target)
    here = os.environ | {"PYTHONPATH": str(tmp_path / "site"), "CSSTSIM_CACHE": str(tmp_path)}
    for line in (
        ["-c", "from csstsim.command_line.main import main; main()", "init", "camera", "--example", "camera"],
        ["camera/make_instrument.py"],
    ):
        done = subprocess.run(
            [sys.executable, *line], capture_output=True, text=True, env=here, cwd=tmp_path, timeout=300, check=False
        )
        assert done.returncode == 0, done.stderr
    made = tmp_path / "camera" / "instrument" / "filters.yaml"
    assert made.read_text() == (ROOT / "examples/my_camera/instrument/filters.yaml").read_text()


def test_the_circle_about_objects_reaches_the_outermost():
    """At the meridian 0 and dec 60: 0.04 deg of ra are 0.02 deg."""
    table = {"ra": np.array([359.98, 0.02, 0.0]), "dec": np.array([60.0, 60.0, 60.0])}
    ra, dec, radius = _circle("a.csv", table)
    assert (min(ra, 360 - ra), dec) == pytest.approx((0, 60.0), abs=1e-5)
    assert radius == pytest.approx(60 * 0.02 * math.cos(math.radians(60)) + 0.2, abs=1e-3)
    for distance, good in ((4.79, True), (4.81, False)):
        wide = {"ra": np.array([10.0, 10.0]), "dec": np.array([0.0, 2 * distance / 60])}
        if good:
            assert _circle("a.csv", wide)[1:] == pytest.approx((distance / 60, distance + 0.2), abs=1e-5)
            continue
        with pytest.raises(InputError, match=r"got '4\.8 arcmin from their centre'\); allowed: 4\.8 arcmin"):
            _circle("a.csv", wide)
