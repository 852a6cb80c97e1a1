"""Parts of a pack and of a crate, of a campaign made by hand: each cell, header card, file and entity."""

import csv
import importlib
import io
import json
from datetime import UTC, datetime, timedelta
from types import SimpleNamespace

import numpy as np
import pytest
from astropy.io import fits

from csstsim import __version__
from csstsim.base.errors import InputError
from csstsim.catalog.table import ObjectTable
from csstsim.instrument.chip import Window
from csstsim.studies.release import made_with, pack, pack_frames, pack_truth
from csstsim.studies.release.campaign_crate import campaign_crate
from csstsim.studies.release.crate import Crate, CrateFile, licence_of, metadata
from csstsim.studies.release.pack_readme import readme, score_command, truth_readme
from csstsim.studies.release.run_record import RunRecord, run_record
from csstsim.studies.release.star_psf import STARS_MAX, StarPsf, _lanczos, select_stars, star_psf, write_psfex

WINDOW = Window(100, 104, 40, 43)  # 4 columns, 3 rows
SHA = "ab" * 32


def job(kind="imaging", filter_="r", chip=9, **pointing):
    pointing = {"type": "SCIE", "exptime": 150.0, "time": "2027-01-01T10:00:00Z", "pa": 33.0} | pointing
    return SimpleNamespace(
        chip=SimpleNamespace(filter=filter_, kind=kind, id=chip), obsid=f"1010000{chip:02d}", window=WINDOW,
        pointing=SimpleNamespace(**pointing), wcs="wcs", key=("obsid", chip),
    )  # fmt: skip


# --- frames


def run_of(tmp_path):
    """A campaign whose Level-0 file of the job is a small one with a seed."""
    level0 = tmp_path / "level0.fits"
    primary = fits.PrimaryHDU()
    primary.header.update({"SIMSEED": 7, "CAMPHASH": "c", "TRUTHASH": "t", "OBSID": "101"})
    fits.HDUList([primary, fits.ImageHDU(np.arange(12, dtype=np.uint16).reshape(3, 4), name="IMAGE")]).writeto(level0)
    camera = SimpleNamespace(
        telescope=SimpleNamespace(pixel_scale=0.074), filters={"r": SimpleNamespace(zeropoint=lambda _: 25.123456789)}
        | {"GV": SimpleNamespace(zeropoint=lambda _: 1.0)},
    )  # fmt: skip
    return SimpleNamespace(camera=camera, paths=SimpleNamespace(level0=lambda job: level0))


@pytest.fixture
def level0(monkeypatch):
    """Frames of 4 x 3 pixels whose calibrated planes are given, whose read noise is 4 and 6 in two channels."""
    importlib.import_module("csstsim.stages.measure")  # not while the name that it imports is another's
    electrons = np.arange(12, dtype=np.float32).reshape(3, 4) * 300
    frame = SimpleNamespace(
        electrons=electrons, read_noise={1: 4.0, 2: 6.0}, marks=np.eye(3, 4, dtype=np.uint8),
        sigma=lambda: np.full((3, 4), 30.0, np.float32),
    )  # fmt: skip
    header0 = {"SIMSEED": 7, "CAMPHASH": "c", "OBSID": "101", "FILTER": "r", "EXPTIME": 150.0, "OTHER": 1}
    file = SimpleNamespace(header0=header0, observer="observer")
    monkeypatch.setattr("csstsim.stages.calibrate.calibrated_frame", lambda run, job: (file, frame))
    monkeypatch.setattr(pack_frames, "icrs_header", lambda *given: {"CRVAL1": 10.12345678, "CRVAL2": -5.98765432})
    monkeypatch.setattr(pack_frames, "corners", lambda *given: [given[0], given[1], given[2].x0])
    return frame


def test_a_frame_of_spectra_has_its_row_and_header(tmp_path, level0):
    made = pack_frames.write_frame(run_of(tmp_path), job("slitless", "GV", 4), tmp_path)
    name = "101000004_04_GV"
    assert made.row == {
        "name": name, "filter": "GV", "kind": "slitless", "chip": 4, "obsid": "101000004",
        "start_utc": "2027-01-01T10:00:00Z", "exptime_s": 150.0, "pa_deg": 33.0, "ra_deg": 10.123457,
        "dec_deg": -5.987654, "width_px": 4, "height_px": 3, "zero_point_mag": None, "psf_fwhm_px": None,
        "psf_stars": None, "raw": f"raw/{name}.fits", "calibrated": f"calibrated/{name}.fits", "psf": None,
    }  # fmt: skip
    assert made.corners == ["wcs", "observer", 100]
    with fits.open(tmp_path / "calibrated" / f"{name}.fits") as file:
        assert [hdu.name for hdu in file] == ["PRIMARY", "SCI", "ERR", "DQ"]
        np.testing.assert_allclose(file["SCI"].data, level0.electrons / 150)
        np.testing.assert_allclose(file["ERR"].data, 0.2)
        np.testing.assert_array_equal(file["DQ"].data, level0.marks)
        head = file["SCI"].header
        assert (head["READX0"], head["READY0"], head["RDNOISE"], head["PIXSCALE"]) == (101, 41, 5.0, 0.074)
        assert head["BACKMED"] == 0.0 and "MAGZERO" not in head and head["BUNIT"] == file["ERR"].header["BUNIT"]
        assert head["CRVAL1"] == file["DQ"].header["CRVAL1"] == 10.12345678 and head["BUNIT"] == "electron/s"
        assert [file["DQ"].header[f"BIT{k}"] for k in range(3)] == [
            "saturated", "defect, known from calibration", "cosmic ray",
        ]  # fmt: skip
        first = file[0].header
        assert first["POSKIND"] == "ICRS" and first["OBSID"] == "101" and first["EXPTIME"] == 150.0
        assert not {"SIMSEED", "CAMPHASH", "OTHER"} & set(first)
    with fits.open(tmp_path / "raw" / f"{name}.fits") as file:
        assert not {"SIMSEED", "CAMPHASH", "TRUTHASH"} & set(file[0].header) and file[0].header["OBSID"] == "101"
        assert np.array_equal(file["IMAGE"].data, np.arange(12).reshape(3, 4))


@pytest.mark.parametrize("model", [StarPsf(np.zeros((1, 45, 45)), (2.5, 2), (2, 1.5), 17, 2.34567, 1.0), None])
def test_a_frame_of_an_image_has_its_zero_point_background_and_psf(tmp_path, monkeypatch, level0, model):
    image, error = np.full((3, 4), 2, np.float32), np.full((3, 4), 3, np.float32)
    planes = pack_frames.Planes(image, error, np.zeros((3, 4), np.uint8), 0.375)
    monkeypatch.setattr(pack_frames, "_image", lambda *given: planes)
    monkeypatch.setattr("csstsim.stages.measure.measured_table", lambda run, job: "table")
    monkeypatch.setattr(pack_frames, "_psf", lambda table, *given: model if table == "table" else None)
    made = pack_frames.write_frame(run_of(tmp_path), job(), tmp_path).row
    with fits.open(tmp_path / made["calibrated"]) as file:
        assert file["SCI"].header["MAGZERO"] == 25.123456789 and file["SCI"].header["BACKMED"] == 0.375
        assert file["SCI"].data[0, 0] == 2 and file["ERR"].data[0, 0] == 3
    psf = f"psf/{made['name']}.psf"
    assert made["zero_point_mag"] == 25.12346 and (tmp_path / psf).is_file() == bool(model)
    assert [made[name] for name in ("psf_fwhm_px", "psf_stars", "psf")] == ([2.346, 17, psf] if model else [None] * 3)


def test_the_background_of_an_image_is_what_was_taken_off(monkeypatch, level0):
    """1000 electrons are taken off; image and errors are of a second; the quality is that of mended pixels.

    Errors are those of all electrons, the sky's too.
    """
    asked = {}
    level0.sigma = lambda: np.sqrt(level0.electrons + np.float32(900))
    quality = np.full((3, 4), 4, np.uint8)
    monkeypatch.setattr("csstsim.measure.calibration.bad_pixels.fill_bad_pixels", lambda frame, model: quality)
    monkeypatch.setattr("csstsim.stages.psf.open_psf", lambda run, chip: "psf")
    monkeypatch.setattr(
        "csstsim.measure.light.photometry.psf_model", lambda psf, at, shape: asked.update(at=at, shape=shape)
    )

    def off(electrons, unusable):
        assert unusable is quality
        electrons -= 1000

    monkeypatch.setattr("csstsim.measure.detection.detect.subtract_background", off)
    before = level0.electrons.copy()
    image, error, marks, level = pack_frames._image(None, job(), level0)
    assert asked == {"at": (100, 40), "shape": (3, 4)} and marks is quality
    np.testing.assert_allclose(image, (before - 1000) / 150, rtol=1e-6)
    np.testing.assert_allclose(error, np.sqrt(before + 900) / 150, rtol=1e-6)
    assert level == pytest.approx(1000 / 150)


def test_stars_of_a_psf_lie_in_the_window(monkeypatch):
    """Positions on the chip become positions in the window, fluxes electrons per second; the width is their median."""
    asked = []
    monkeypatch.setattr(pack_frames, "star_psf", lambda *given: asked.append(given) or "model")
    n = 4
    table = ObjectTable({
        "star": np.ones(n, bool), "flags": np.array([0, 0, 4, 0]), "snr": np.array([50.0, 90, 99, 60]),
        "flux_psf": np.array([150.0, 300, 450, 600]), "x": np.array([120.0, 150, 180, 210]),
        "y": np.array([41.0, 45, 50, 60]), "fwhm": np.array([2.0, 2.2, 9.0, 3.0]),
    })  # fmt: skip
    assert pack_frames._psf(table, pack_frames.Planes("i", "e", "q", 0.0), job()) == "model"
    [(*planes, x, y, flux, fwhm)] = asked
    assert planes == ["i", "e", "q"] and fwhm == 2.2
    assert (x.tolist(), y.tolist(), flux.tolist()) == ([50, 110, 20], [5, 20, 1], [2, 4, 1])
    assert pack_frames._psf(table.take([2]), pack_frames.Planes("i", "e", "q", 0.0), job()) is None


# --- stars for a PSF


def stars_at(x, **columns):
    n = len(x)
    given = {"star": np.ones(n, bool), "flags": np.zeros(n, int), "snr": np.full(n, 100.0), "y": np.zeros(n)}
    given |= {"flux_psf": np.full(n, 100.0), "x": np.asarray(x, float)}
    return ObjectTable(given | {name: np.asarray(values) for name, values in columns.items()})


@pytest.mark.parametrize(
    ("change", "taken"),
    [({}, True), ({"flags": [1]}, False), ({"flags": [2]}, False), ({"flags": [4]}, False), ({"flags": [64]}, False),
     ({"flags": [128]}, False), ({"flags": [8 | 16 | 32]}, True), ({"snr": [30.0]}, False), ({"snr": [30.1]}, True),
     ({"flux_psf": [0.0]}, False), ({"flux_psf": [np.nan]}, False), ({"star": [False]}, False)],
    ids=str,
)  # fmt: skip
def test_a_star_that_is_good_for_a_model(change, taken):
    assert len(select_stars(stars_at([50.0], **change))) == taken


@pytest.mark.parametrize(("apart", "light", "taken"), [(13.9, 2.1, False), (14.1, 99.0, True), (13.9, 1.9, True)])
def test_a_neighbour_of_a_fiftieth_spoils_a_star(apart, light, taken):
    """Whatever the neighbour is: here no star."""
    table = stars_at([50.0, 50.0 + apart], flux_psf=[100.0, light], star=[True, False])
    assert select_stars(table).tolist() == [0] * taken


def test_at_most_so_many_stars_the_brightest():
    n = STARS_MAX + 3
    assert select_stars(stars_at(100.0 * np.arange(n), snr=50.0 + np.arange(n))).tolist() == list(range(n - 1, 2, -1))


def test_interpolation_is_lanczos_of_three_lobes():
    """At whole samples one weight is 1; between, as sinc(x) sinc(x / 3) says, in all normalised."""
    near, weight = _lanczos(np.array([0.0, -2.0, 0.25]))
    for k, sample in ((0, 22), (1, 20)):
        assert near[k][np.argmax(weight[k])] == sample and np.allclose(np.sort(weight[k])[:5], 0, atol=1e-12)
    away = 22.25 - np.arange(20, 26)
    exact = np.sin(np.pi * away) / (np.pi * away) * np.sin(np.pi * away / 3) / (np.pi * away / 3)
    assert near[2].tolist() == list(range(20, 26)) and np.allclose(weight[2], exact / exact.sum())


def test_stars_near_an_edge_are_no_part():
    """An image that is not square; the outermost columns and rows of a star, 10 px to each side and a margin."""
    image = np.zeros((60, 100), np.float32)
    error, good = np.ones(image.shape, np.float32), np.zeros(image.shape, np.uint8)
    x, y = np.array([11.1, 87.9, 50, 50, 50, 50.0]), np.array([30, 30, 11.1, 47.9, 30, 30.0])
    model = star_psf(image, error, good, x, y, np.full(6, 100.0), 2.0)
    assert model.stars == 6 and model.zero == (50.5, 30.5) and model.scale == (50.0, 30.0)
    for k, far in ((0, 11.0), (1, 88.0)):
        assert star_psf(image, error, good, np.where(np.arange(6) == k, far, x), y, np.full(6, 100.0), 2.0).stars == 5
    for k, far in ((2, 11.0), (3, 48.0)):
        assert star_psf(image, error, good, x, np.where(np.arange(6) == k, far, y), np.full(6, 100.0), 2.0).stars == 5


def test_the_model_changes_along_both_axes_from_the_middle_to_the_edge(monkeypatch):
    """Of 30 stars, in an image of 100 x 60 px: 0 in the middle, 1 at the right and the upper edge."""
    seen = []
    monkeypatch.setattr(
        "scipy.sparse.linalg.lsqr", lambda a, *_, **__: seen.append(a.tocsr()) or [np.zeros(a.shape[1])]
    )
    x, y = np.linspace(20.0, 79.0, 30), np.linspace(46.0, 14.0, 30)
    image, good = np.zeros((60, 100)), np.zeros((60, 100), np.uint8)
    model = star_psf(image, np.ones(image.shape), good, x, y, np.full(30, 100.0), 2.0)
    assert model.planes.shape == (3, 45, 45) and not model.planes[1:].any()
    [matrix] = seen
    pixels = 21**2  # of a star
    for k in (0, 11):
        still, along, across = (abs(matrix[k * pixels, term * 45**2 : (term + 1) * 45**2]).sum() for term in range(3))
        assert along / still == pytest.approx(0.3 * abs(x[k] + 1 - 50.5) / 50, rel=1e-9)
        assert across / still == pytest.approx(0.3 * abs(y[k] + 1 - 30.5) / 30, rel=1e-9)


def test_the_file_of_a_psf_has_the_change_over_the_image(tmp_path):
    planes = np.arange(3 * 45 * 45, dtype=float).reshape(3, 45, 45)
    write_psfex(tmp_path / "a.psf", StarPsf(planes, (50.5, 30.5), (50.0, 30.0), 40, 2.5, 1.25))
    with fits.open(tmp_path / "a.psf") as file:
        hdu = file["PSF_DATA"]
        assert np.array_equal(hdu.data["PSF_MASK"][0], planes)
        wanted = {
            "LOADED": 40, "ACCEPTED": 40, "CHI2": 1.25, "POLNAXIS": 2, "POLGRP1": 1, "POLNAME1": "X_IMAGE",
            "POLZERO1": 50.5, "POLSCAL1": 50.0, "POLGRP2": 1, "POLNAME2": "Y_IMAGE", "POLZERO2": 30.5,
            "POLSCAL2": 30.0, "POLNGRP": 1, "POLDEG1": 1, "PSF_FWHM": 2.5, "PSF_SAMP": 0.5, "PSFNAXIS": 3,
            "PSFAXIS1": 45, "PSFAXIS2": 45, "PSFAXIS3": 3,
        }  # fmt: skip
        assert {name: hdu.header[name] for name in wanted} == wanted
    write_psfex(tmp_path / "b.psf", StarPsf(planes[:1], (1, 1), (1, 1), 5, 2.5, 1.0))
    assert fits.getheader(tmp_path / "b.psf", 1)["POLDEG1"] == 0


# --- files of a pack


def test_curves_of_a_pack_are_on_one_grid():
    """Each filter once, from the bluest to the reddest; 0 where a curve has ended, no row where all have."""
    curve = lambda wave, through: SimpleNamespace(wavelength=np.array(wave), throughput=np.array(through))  # noqa: E731
    filters = {"r": curve([5e3, 5010, 5030], [0, 0.4, 0]), "g": curve([4980.0, 4990, 5e3], [0, 0.3, 0])}
    jobs = [job(filter_=name) for name in ("r", "g", "r")]
    rows = pack._curves(SimpleNamespace(camera=SimpleNamespace(filters=filters)), jobs)
    assert rows == [
        {"wavelength_angstrom": w, "r": r, "g": g} for w, r, g in (
            ("4990", "0", "0.3"), ("5010", "0.4", "0"), ("5020", "0.2", "0"),
        )
    ]  # fmt: skip
    read = list(csv.reader(io.StringIO(pack._csv(rows))))
    assert read[0] == ["wavelength_angstrom", "r", "g"] and read[-1] == ["5020", "0.2", "0"]


def test_gratings_of_a_pack_are_those_of_its_chips(tmp_path):
    source = tmp_path / "camera" / "gratings"
    source.mkdir(parents=True)
    for name in ("GV1.conf", "GV2.conf", "GI1.conf", "GV_p1.fits", "GV_m1.fits", "GI_p1.fits", "GI2.conf"):
        (source / name).write_text(name)
    pair = lambda band, split: SimpleNamespace(  # noqa: E731
        left=SimpleNamespace(name=f"{band}1"), right=SimpleNamespace(name=f"{band}2"), split=split
    )
    camera = SimpleNamespace(folder=tmp_path / "camera", gratings={3: pair("GV", 4600), 5: pair("GI", 4700)})
    run = SimpleNamespace(camera=camera)
    pack._gratings(run, [job()], tmp_path / "none")
    assert not (tmp_path / "none").exists()
    (tmp_path / "made").mkdir()
    pack._gratings(run, [job("slitless", "GV", 3), job(), job("slitless", "GV", 3)], tmp_path / "made")
    assert {path.name for path in (tmp_path / "made").iterdir()} == {
        "GV1.conf", "GV2.conf", "GV_p1.fits", "GV_m1.fits", "chips.csv",
    }  # fmt: skip
    assert (tmp_path / "made" / "GV2.conf").read_text() == "GV2.conf"
    assert (tmp_path / "made" / "chips.csv").read_text() == "chip,filter,left,right,split\n3,GV,GV1,GV2,4600\n"


@pytest.mark.parametrize(("filters", "band"), [(("g", "r"), "r"), (("r", "i"), "r"), (("i", "g"), "i")])
def test_a_pack_says_who_made_it_and_how(tmp_path, monkeypatch, filters, band):
    """Both crates have the authors and the licence; that of the truth also the run, the inputs and the tables' version.

    The README of the truth scores a catalogue in r, or else in the first band.
    """
    public, truth = tmp_path / "public", tmp_path / "truth"
    (tmp_path / "out" / "logs" / "chip").mkdir(parents=True)
    (tmp_path / "out" / "logs" / "chip" / "a.log").write_text(
        "csstsim 1.0 chip: campaign m 0123abcd, chip 9, host pid 7, 2027-01-01T10:00:00Z\n"
        "chip done: 60.0 s, CPU 50.0 s, memory 100 MB\n"
    )

    def made_with_of(run, folder):
        (folder / "workflow").mkdir()
        (folder / "workflow" / "Snakefile").write_text("rules")
        return {"workflow/Snakefile": "the workflow"}

    crates = {}
    row = {"kind": "imaging", "psf": "psf/x.psf", "name": "x"}
    monkeypatch.setattr(pack, "write_made_with", made_with_of)
    monkeypatch.setattr(pack, "inputs", lambda run: {"campaign.yaml": tmp_path, "t.csv": tmp_path})
    monkeypatch.setattr(pack, "write_frame", lambda run, job, folder: pack_frames.PackFrame(row, []))
    monkeypatch.setattr(pack, "write_truth", lambda *given: ObjectTable({"id": np.arange(3)}))
    monkeypatch.setattr(pack, "_curves", lambda run, jobs: [{"wavelength_angstrom": "5000"}])
    monkeypatch.setattr(pack, "readme", lambda name, rows, licence: f"{name} {len(rows)} {licence}")
    monkeypatch.setattr(pack, "_write_metadata", lambda folder, one: crates.update({folder.name: one}))
    run = SimpleNamespace(config=SimpleNamespace(name="mine"), paths=SimpleNamespace(output=tmp_path / "out"))
    jobs = [job(filter_=name, chip=k) for k, name in enumerate(filters)]
    for folder in (public, truth):
        folder.mkdir()
    credit = {"authors": ("A B",), "licence": "CC0-1.0"}
    rows, table = pack._write_pack(run, jobs, public, truth, print, credit)
    assert rows == [row, row] and len(table) == 3
    assert {(one.authors, one.licence) for one in crates.values()} == {(("A B",), "CC0-1.0")}
    assert (public / "README.md").read_text() == "mine 2 CC0-1.0"
    assert score_command(band) in (truth / "README.md").read_text()
    assert crates["public"].run is None and not crates["public"].inputs
    known = crates["truth"]
    assert (known.run.jobs, known.run.cpu_s, known.run.versions) == ({"chip": 1}, 50.0, ("1.0",))
    assert known.inputs == ("campaign.yaml", "t.csv") and known.version == made_with.tables_version()
    assert known.files["workflow/Snakefile"].kind == "the workflow" and known.files["README.md"].kind == "README.md"
    assert set(crates["public"].files) == {"CITATION.cff", "filters.csv", "frames.csv", "README.md"}
    assert set(known.files) == {"workflow/Snakefile", "README.md"}


def test_a_pack_is_of_science_exposures(tmp_path, monkeypatch):
    asked = []
    monkeypatch.setattr(pack, "_check_finished", lambda run, jobs: asked.append(jobs))
    monkeypatch.setattr(pack, "_write_pack", lambda run, jobs, *rest: asked.append(jobs) or ([], []))
    jobs = [job(type="BIAS"), job(), job("slitless", "GV", 3), job(type="FLAT")]
    pack.pack(SimpleNamespace(jobs=jobs), tmp_path / "out", lambda line: None)
    assert asked == [jobs[1:3]] * 2


def test_words_and_kinds_of_files_of_a_pack(tmp_path):
    rows = [{"kind": kind} for kind in ("imaging", "slitless", "slitless")]
    assert (
        pack._number_of_frames(rows) == "1 image and 2 spectroscopic frames"
        and pack._number_of_frames(rows[:1] * 2) == "2 images"
    )
    for name in ("raw/b.fits", "raw/a.fits", "psf/x.psf", "README.md"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(name)
    found = pack._files(tmp_path)
    assert list(found) == ["README.md", "psf/x.psf", "raw/a.fits", "raw/b.fits"]
    assert found["raw/a.fits"][:2] == ("a frame as read", 10) and found["README.md"][0] == "README.md"
    assert found["psf/x.psf"][0] == "the PSF of an image, of its stars"


@pytest.mark.parametrize("missing", ["level0", "truth", "psf", "measure"])
def test_products_that_a_pack_needs(tmp_path, missing):
    """Of spectra nothing is measured."""
    for name in ("level0", "truth", "psf", "measure"):
        if name != missing:
            (tmp_path / name).write_text("x")
    paths = SimpleNamespace(
        level0=lambda job: tmp_path / "level0", level0_truth=lambda job: tmp_path / "truth",
        psf=lambda chip: tmp_path / "psf", measure=lambda *key: tmp_path / ("measure" if key[1] == 9 else "other"),
    )  # fmt: skip
    run = SimpleNamespace(paths=paths, file="campaign.yaml")
    with pytest.raises(InputError, match="not made yet") as error:
        pack._check_finished(run, [job(), job("slitless", "GV", 3)])
    assert missing in str(error.value)
    (tmp_path / missing).write_text("x")
    pack._check_finished(run, [job(), job("slitless", "GV", 3)])
    with pytest.raises(InputError, match="nothing to find"):
        pack._check_finished(run, [job("slitless", "GV", 3)])


def test_the_truth_of_a_pack_has_frames_and_tables_of_all(tmp_path, monkeypatch):
    """Objects of images alone; corners and files of each frame; orders only where there are some."""
    for name in ("t9", "t3", "o3"):
        (tmp_path / name).write_text(name)
    folder = tmp_path / "truth"
    folder.mkdir()
    asked = []
    monkeypatch.setattr(
        pack_truth, "true_objects", lambda run, jobs: asked.extend(jobs) or ObjectTable({"id": np.arange(2)})
    )
    paths = SimpleNamespace(
        level0_truth=lambda job: tmp_path / f"t{job.chip.id}", level0_orders=lambda job: tmp_path / f"o{job.chip.id}"
    )
    run = SimpleNamespace(config=SimpleNamespace(name="mine"), paths=paths, has_orders=lambda job: job.chip.id == 3)
    jobs = [job(), job("slitless", "GV", 3)]
    frames = [pack_frames.PackFrame({"calibrated": f"calibrated/{k}.fits"}, [[k, 0]]) for k in range(2)]
    table = pack_truth.write_truth(run, jobs, frames, folder)
    assert len(table) == 2 and asked == jobs[:1]
    assert json.loads((folder / "frames.json").read_text()) == {"name": "mine", "frames": [
        {"file": "calibrated/0.fits", "filter": "r", "kind": "imaging", "corners": [[0, 0]]},
        {"file": "calibrated/1.fits", "filter": "GV", "kind": "slitless", "corners": [[1, 0]]},
    ]}  # fmt: skip
    kept = {path.name: path.read_text() for path in (folder / "frames").iterdir()}
    assert kept == {
        "101000009_09_r.truth.parquet": "t9", "101000003_03_GV.truth.parquet": "t3",
        "101000003_03_GV.orders.parquet": "o3",
    }  # fmt: skip
    assert ObjectTable.read(folder / "objects.parquet")["id"].tolist() == [0, 1]


# --- README


def test_the_readme_has_the_command_of_an_image_in_r():
    image = {"kind": "imaging", "psf": None, "psf_fwhm_px": None, "zero_point_mag": 25.0}
    frames = [
        image | {"name": "a_06_g", "filter": "g"},
        image | {"name": "b_09_r", "filter": "r", "psf": "psf/b.psf", "psf_fwhm_px": 2.5, "zero_point_mag": 25.6},
    ]
    text = readme("field", frames, "CC0-1.0")
    for words in (
        "'calibrated/b_09_r.fits[1]'", "'calibrated/b_09_r.fits[2]'", "-MAG_ZEROPOINT 25.6 ", "-PIXEL_SCALE 0.074 ",
        "-SEEING_FWHM 0.18", "-PSF_NAME psf/b.psf", "images in g (1), r (1)", "B is g or r", "--map mag_r=MAG_AUTO",
        "Creative Commons Zero 1.0 (https://creativecommons.org/publicdomain/zero/1.0/)", __version__,
    ):  # fmt: skip
        assert words in text, words
    first = readme("field", frames[:1], "CC0-1.0")
    assert "'calibrated/a_06_g.fits[1]'" in first and "--map mag_g=MAG_AUTO" in first
    assert score_command("i").endswith(
        "--map mag_i=MAG_AUTO --map a=A_WORLD --map b=B_WORLD --map pa=THETA_J2000"
    ) and "--map ra=ALPHA_J2000 --map dec=DELTA_J2000" in score_command("i")
    text = truth_readme("field", {"id": "the object", "z": "redshift"}, "i")
    assert "# The truth of field" in text and "| `id` | the object |\n| `z` | redshift |" in text
    assert score_command("i") in text


# --- crates

START = datetime(2027, 1, 1, 10, 0, 5, tzinfo=UTC)
FILES = {
    "README.md": CrateFile("README.md", 5, SHA),
    "workflow/Snakefile": CrateFile("the workflow", 1, SHA),
    "workflow/tables.json": CrateFile("columns", 2, SHA),
    "workflow/recipes.json": CrateFile("digests", 3, SHA),
    "workflow/inputs/ab.yaml": CrateFile("the campaign file", 4, SHA),
    "workflow/inputs/list.csv": CrateFile("named", 6, SHA),
    "level0/x/1.fits": CrateFile("Level-0", 7, SHA),
    "level0/2.fits": CrateFile("Level-0", 8, SHA),
    "measure/m.parquet": CrateFile("m", 9, SHA),
    "notes.weird": CrateFile("notes", 0, SHA),
}


def crate(**changes):
    run = RunRecord(START, START + timedelta(hours=2), {"chip": 2, "measure": 3}, 10.0, ("1.0", "1.1"))
    given = {
        "name": "mine", "description": "what", "files": FILES, "folders": {"level0": "the frames"}, "run": run,
        "inputs": ("ab.yaml", "list.csv"), "version": "7", "authors": ("A B", "C", "A B"),
    }  # fmt: skip
    return {one["@id"]: one for one in metadata(Crate(**given | changes), START)["@graph"]}


def ids(value):
    return [one["@id"] for one in (value if isinstance(value, list) else [value])]


def test_a_crate_says_what_its_files_are():
    found = crate()
    root = found["./"]
    assert (root["name"], root["description"], root["datePublished"]) == ("mine", "what", "2027-01-01T10:00:05+00:00")
    assert ids(root["hasPart"]) == ["level0/", "measure/", "workflow/", "README.md", "notes.weird"]
    assert ids(root["author"]) == ["#A%20B", "#C"] and ids(root["publisher"]) == ["#A%20B"]
    assert found["#C"] == {"@id": "#C", "@type": "Person", "name": "C"}
    assert ids(root["license"]) == ["https://creativecommons.org/licenses/by/4.0/"]
    assert found["level0/"]["description"] == "the frames" and found["measure/"]["description"] == "measure"
    assert ids(found["level0/"]["hasPart"]) == ["level0/2.fits", "level0/x/1.fits"]
    assert found["level0/x/1.fits"] == {
        "@id": "level0/x/1.fits", "@type": "File", "name": "1.fits", "description": "Level-0",
        "encodingFormat": "application/fits", "contentSize": "7", "sha256": SHA,
    }  # fmt: skip
    assert ids(found["README.md"]["about"]) == ["./"] and found["notes.weird"]["encodingFormat"] == "text/plain"
    assert ids(found["ro-crate-metadata.json"]["conformsTo"])[0] == "https://w3id.org/ro/crate/1.1"


def test_a_crate_says_how_its_files_were_made():
    found = crate()
    run, root = found["#run"], found["./"]
    assert (run["startTime"], run["endTime"]) == ("2027-01-01T10:00:05+00:00", "2027-01-01T12:00:05+00:00")
    assert run["description"] == "5 jobs: 2 chip, 3 measure" and run["name"] == "Snakemake's run of mine"
    inputs = ["workflow/inputs/ab.yaml", "workflow/inputs/list.csv"]
    assert ids(run["object"]) == [*inputs, "workflow/recipes.json"]
    assert ids(run["result"]) == ["level0/", "measure/"] and ids(run["agent"]) == ["#A%20B"]
    assert ids(root["mainEntity"]) == ids(run["instrument"]) == ["workflow/Snakefile"]
    for name, profile in (("workflow/Snakefile", "ComputationalWorkflow"), ("#campaign", "FormalParameter")):
        assert ids(found[name]["conformsTo"]) == [f"https://bioschemas.org/profiles/{profile}/1.0-RELEASE"]
    assert ids(root["mentions"]) == ["#run"] and len(ids(root["conformsTo"])) == 3
    assert found["workflow/Snakefile"]["version"] == "1.0, 1.1" and found["workflow/tables.json"]["version"] == "7"
    assert ids(found["level0/"]["exampleOfWork"]) == ["#products"] and "exampleOfWork" not in found["workflow/"]


def test_names_with_a_blank_are_quoted_wherever_they_are_named():
    files = {name.replace("ab.yaml", "a b.yaml"): about for name, about in FILES.items()}
    found = crate(files=files, inputs=("a b.yaml", "list.csv"))
    quoted = "workflow/inputs/a%20b.yaml"
    assert found[quoted]["name"] == "a b.yaml" and ids(found[quoted]["exampleOfWork"]) == ["#campaign"]
    assert ids(found["#run"]["object"])[0] == quoted in ids(found["workflow/"]["hasPart"])


def test_a_crate_without_a_run_or_authors():
    files = {"only/a.csv": CrateFile("a table", 1, SHA)}
    found = crate(run=None, authors=(), files=files, inputs=(), licence="https://my.licence/")
    assert "#run" not in found and found["./"]["author"] == {"@id": "#contributors"}
    assert found["#contributors"]["name"] == "the csstsim contributors"
    assert found["./"]["hasPart"] == {"@id": "only/"} and found["only/a.csv"]["encodingFormat"] == "text/csv"
    assert found["https://my.licence/"]["name"] == "https://my.licence/"
    assert found["ro-crate-metadata.json"]["conformsTo"] == {"@id": "https://w3id.org/ro/crate/1.1"}
    assert licence_of("CC-BY-4.0")[1] == "Creative Commons Attribution 4.0"
    with pytest.raises(InputError, match=r"CC-BY-4.0, CC0-1.0, an address"):
        licence_of("ftp://x")


def test_inputs_are_named_once_and_apart(tmp_path):
    """Two kinds may have one list; two lists of one name have their folders' names before it."""
    lists = {
        "SCIE": tmp_path / "a" / "list.csv",
        "BIAS": tmp_path / "b" / "list.csv",
        "DARK": tmp_path / "a" / "list.csv",
    }
    config = SimpleNamespace(survey_table=str(tmp_path / "t.csv"), observation_file=lambda kind: str(lists[kind]))
    run = SimpleNamespace(file=tmp_path / "campaign.yaml", config=config, steps=list(lists))
    assert list(made_with.inputs(run).items()) == [
        ("campaign.yaml", tmp_path / "campaign.yaml"), ("t.csv", tmp_path / "t.csv"),
        ("list.csv", tmp_path / "a" / "list.csv"), ("b_list.csv", tmp_path / "b" / "list.csv"),
    ]  # fmt: skip


def test_files_that_made_a_release_say_what_they_are(tmp_path, monkeypatch):
    """The campaign, the files that it names, and those of csstsim; copied byte by byte."""
    for name in ("campaign.yaml", "t.csv"):
        (tmp_path / name).write_text(f"of {name}\n")
    config = SimpleNamespace(survey_table=str(tmp_path / "t.csv"), observation_file=None)
    run = SimpleNamespace(file=tmp_path / "campaign.yaml", config=config, steps=[])
    monkeypatch.setattr(made_with, "recipes", lambda run: {"seed": 4})
    kinds = made_with.write_made_with(run, tmp_path / "made")
    below = "workflow/inputs"
    assert kinds[f"{below}/campaign.yaml"] == "the campaign file"
    assert kinds[f"{below}/t.csv"] == "a file that the campaign names"
    assert kinds["workflow/Snakefile"] == "the workflow"
    there = {
        path.relative_to(tmp_path / "made").as_posix() for path in (tmp_path / "made").rglob("*") if path.is_file()
    }
    assert there == set(kinds) and (tmp_path / "made" / below / "t.csv").read_text() == "of t.csv\n"
    assert json.loads((tmp_path / "made" / "workflow" / "recipes.json").read_text()) == {"seed": 4}


def test_recipes_are_of_each_job_and_stage():
    jobs = [job(), job(chip=3, type="BIAS")]
    run = SimpleNamespace(
        config=SimpleNamespace(name="mine", seed=41, digest=lambda: "dig"), jobs=jobs,
        recipes=SimpleNamespace(truth="t", psf="p", validation="v"), recipe=lambda job, stage: f"{stage}{job.chip.id}",
    )  # fmt: skip
    assert made_with.recipes(run) == {
        "csstsim": __version__, "campaign": "mine", "seed": 41, "digest": "dig", "truth": "t", "psf": "p",
        "validation": "v",
        "jobs": {"101000009_09": {"level0": "level09", "measure": "measure9"}, "101000003_03": {"level0": "level03"}},
    }  # fmt: skip


def test_a_run_is_of_all_logs_of_jobs_that_ended(tmp_path):
    """The longest does not end last; a job that has not ended, and what is no log, are no part."""
    for rule, name, clock, version, took in (
        ("chip", "a", "10:00:00", "1.0", "600.4 s, CPU 500.2 s"),
        ("chip", "b", "10:20:00", "1.1", "10.6 s, CPU 1.5 s"),
        ("measure", "c", "09:59:00", "1.0", "1.0 s, CPU 0.5 s"),
        ("measure", "d", "23:00:00", "2.0", None),
    ):  # fmt: skip
        (tmp_path / "logs" / rule).mkdir(parents=True, exist_ok=True)
        last = f"{rule} done: {took}, memory 100 MB\n" if took else ""
        first = f"csstsim {version} {rule}: campaign m 0123abcd, chip 9, host pid 7, 2027-01-01T{clock}Z\n"
        (tmp_path / "logs" / rule / f"{name}.log").write_text(first + last)
    (tmp_path / "logs" / "chip" / "x.log").write_text("nothing\n")
    at = lambda *clock: datetime(2027, 1, 1, *clock, tzinfo=UTC)  # noqa: E731
    assert run_record(tmp_path) == RunRecord(
        at(9, 59, 0), at(10, 20, 11), {"chip": 2, "measure": 1}, 502.2, ("1.0", "1.1")
    )


@pytest.mark.parametrize("fault", [None, "size", "gone", "unlisted"])
def test_a_crate_of_a_campaign_is_of_the_manifests_files(tmp_path, monkeypatch, fault):
    name = "level0/a.fits"
    (tmp_path / "level0").mkdir()
    (tmp_path / name).write_text("12345")
    (tmp_path / "MANIFEST.sha256").write_text(f"{SHA}  {'level0/b.fits' if fault == 'unlisted' else name}\n")
    (tmp_path / "MANIFEST.tsv").write_text(f"path\tbytes\tproduct\n{name}\t{6 if fault == 'size' else 5}\timage\n")
    if fault == "gone":
        (tmp_path / name).unlink()
    (tmp_path / "w").write_text("abc")
    written, said = [], []
    monkeypatch.setattr("csstsim.studies.release.campaign_crate.write_made_with", lambda run, root: {"w": "made with"})
    monkeypatch.setattr("csstsim.studies.release.campaign_crate.inputs", lambda run: {"campaign.yaml": 1})
    monkeypatch.setattr(
        "csstsim.studies.release.campaign_crate.write_crate", lambda root, one: written.append(one) or "FILE"
    )
    run = SimpleNamespace(
        paths=SimpleNamespace(output=tmp_path), file="c.yaml", config=SimpleNamespace(name="mine"), jobs=[1]
    )
    if fault:
        with pytest.raises(InputError, match=r"not as listed in MANIFEST\.tsv"):
            campaign_crate(run, said.append)
        return
    campaign_crate(run, said.append, ["Me"], "CC0-1.0")
    [made] = written
    kind, size, digest = made.files[name]
    assert (kind, int(size), digest) == ("image", 5, SHA) and made.files["w"][:2] == ("made with", 3)
    assert list(made.files) == [name, "w", "MANIFEST.sha256", "MANIFEST.tsv"] and made.run is None
    assert (made.name, made.authors, made.licence, made.inputs) == ("mine", ("Me",), "CC0-1.0", ("campaign.yaml",))
    assert made.version == made_with.tables_version()
    assert made.description.startswith("1 Level-0 file of") and said == ["FILE: 4 files"]
