"""The report's section on zodiacal and stray light: from the headers, and only with the model."""

import io

import numpy as np
import pytest
from astropy.io import fits
from matplotlib.image import imread
from report_page import Reader, done
from support.mini_campaign import POINTINGS, write_campaign, write_scene

from csstsim.base.errors import InputError
from csstsim.base.shipped import SHIPPED
from csstsim.campaign.opened import OpenCampaign
from csstsim.io.fits_writing import card, write_hdus
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


def test_exposures_are_in_order_of_time_and_bands_in_the_cameras(tmp_path, monkeypatch):
    """Of headers in which each rate and angle has its own number: minimum, median, maximum, and the limb at the start.

    The survey table begins with the last exposure; chip 6, in y, comes before chip 8, in g.
    """
    times = "2027-11-20T01:20:00", "2027-11-20T01:08:00", "2027-11-20T01:14:00"
    rows = [f"1010000000{k + 1},SCIE,60.15,-40.0,20.0,{time},150" for k, time in enumerate(times)]
    run = OpenCampaign(write_campaign(tmp_path, rows, observations=STRAY, select={"types": ["SCIE"], "chips": [6, 8]}))
    names = {e["from"]: e["keyword"] for e in run.camera.keywords if e.get("hdu") == 0 and "from" in e}
    order = {"10100000002": 1, "10100000003": 2, "10100000001": 5}  # by time: a number that grows unevenly
    for job in run.jobs:
        factor = order[job.obsid] * (10 if job.chip.filter == "y" else 1)
        values = {names[f"sky_{name}"]: factor * 0.001 * (k + 1) for k, name in enumerate(COMPONENTS)}
        values |= {names["limb_angle_start"]: 10.0 * factor, names["limb_angle_end"]: -1.0, names["sky_rate"]: 99.0}
        path = run.paths.level0(job)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_hdus(path, [("", [card(name, value) for name, value in values.items()], None)])
    seen = []
    monkeypatch.setattr("csstsim.report.stray_panel.sky_by_exposure", lambda *given: seen.append(given) or b"png")
    monkeypatch.setattr("csstsim.report.pictures.chart", lambda png: png)
    _, _, table = sky_of_frames(run, "STYLES")
    ((levels, limbs, styles),) = seen
    bands = [name for name in run.camera.filters if name in ("g", "y")]
    assert styles == "STYLES" and list(levels) == list(limbs) == bands == [row[0] for row in table.rows]
    for band, *cells, _ in table.rows:
        scale = 10 if band == "y" else 1
        assert limbs[band].tolist() == [10.0 * scale * v for v in (1, 2, 5)]
        for k, (name, cell) in enumerate(zip(COMPONENTS, cells, strict=True)):
            rates = [scale * 0.001 * (k + 1) * v for v in (1, 2, 5)]
            assert levels[band][name] == pytest.approx(rates)
            assert cell == ", ".join(f"{rate:.2g}" for rate in rates)
