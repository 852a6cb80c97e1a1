"""The report's section on zodiacal and stray light: from the headers, and only with the model."""

import io

import numpy as np
import pytest
from astropy.io import fits
from matplotlib.image import imread
from report_page import Reader, done
from support.mini_campaign import POINTINGS, write_scene

from csstsim.base.errors import InputError
from csstsim.base.shipped import SHIPPED
from csstsim.campaign.opened import OpenCampaign
from csstsim.optics.sky.background import COMPONENTS
from csstsim.report.page import ReportContent, write_report
from csstsim.report.parts import Figure, Table
from csstsim.report.stray_panel import sky_by_exposure
from csstsim.report.style import band_styles
from csstsim.stages.parts.sky_of_frames import sky_of_frames

STRAY = {"SCIE": str(SHIPPED / "observations" / "science_straylight.yaml")}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A campaign of one chip with the model on, up to its Level-0 file."""
    file = write_scene(tmp_path_factory.mktemp("stray"), "Stars", [60], [60], 20.0, 9, POINTINGS[0], observations=STRAY)
    run = OpenCampaign(file)
    done("chip", file, "--obsid", POINTINGS[0].split(",")[0], "--chip", 9)
    return run


def test_the_section_has_what_the_headers_say(run, tmp_path):
    parts = sky_of_frames(run, band_styles(run.camera.filters))
    (table,) = [part for part in parts if isinstance(part, Table)]
    header = fits.getheader(run.paths.level0(run.jobs[0]))
    ((band, *cells, share),) = table.rows
    assert band == "r" and len(cells) == len(COMPONENTS) and share.endswith("% of exposures")
    assert cells[0] == ", ".join([f"{header['SKYZODI']:.2g}"] * 3) and header["SKYZODI"] > 0.05
    assert cells[1] == ", ".join([f"{header['SKYEARTH']:.2g}"] * 3)
    write_report(tmp_path / "index.html", {"name": "trial"}, [], ReportContent(stray_light=parts))
    text = (tmp_path / "index.html").read_text(encoding="utf-8")
    assert "Zodiacal and stray light" in Reader(text).text
    write_report(tmp_path / "index.html", {"name": "trial"}, [])
    assert "Zodiacal and stray light" not in (tmp_path / "index.html").read_text(encoding="utf-8")


def test_no_section_without_the_model_or_its_keywords(run, tmp_path, monkeypatch):
    plain = OpenCampaign(write_scene(tmp_path, "Stars", [60], [60], 20.0, 9, POINTINGS[0]))
    assert sky_of_frames(plain, band_styles(plain.camera.filters)) == []
    entries = [entry for entry in run.camera.keywords if entry.get("keyword") != "SKYEARTH"]
    monkeypatch.setattr(type(run.camera), "keywords", entries, raising=False)
    monkeypatch.delitem(run.camera.__dict__, "keywords")
    assert sky_of_frames(run, band_styles(run.camera.filters)) == []


def test_a_missing_frame_is_named(run):
    path = run.paths.level0(run.jobs[0])
    aside = path.rename(path.with_suffix(".aside"))
    try:
        with pytest.raises(InputError, match="no such file"):
            sky_of_frames(run, band_styles(run.camera.filters))
    finally:
        aside.rename(path)


def test_the_figure(run):
    """A picture for many exposures, for one, and for none with earthshine."""
    shown = band_styles(run.camera.filters)
    rng = np.random.default_rng(2)
    for count, earth in ((40, 1.0), (1, 1.0), (3, 0.0)):
        levels = {
            band: {name: rng.uniform(0.01, 0.3, count) * (earth if name == "earth" else 1.0) for name in COMPONENTS}
            for band in ("r", "GV")
        }
        limbs = dict.fromkeys(levels, rng.uniform(20, 90, count))
        picture = imread(io.BytesIO(sky_by_exposure(levels, limbs, shown)))
        assert picture.shape[:2] == (460, 1300) and np.ptp(picture[..., :3]) > 0.9
    assert isinstance(sky_of_frames(run, shown)[1], Figure)
