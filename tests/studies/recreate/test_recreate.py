"""A frame simulated again from its header and its catalogue: by the commands, in every form of header and file."""

import csv
import shlex
import shutil
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from astropy.io import fits
from astropy.table import Table
from click.testing import CliRunner
from support.lab_maps import map_path, name_maps, response, write_map
from support.mini_campaign import POINTINGS, write_campaign
from support.recreated_headers import PLACES, header, pieces

from csstsim.base.errors import InputError
from csstsim.base.shipped import ROOT, SHIPPED
from csstsim.campaign.opened import OpenCampaign
from csstsim.catalog.astrometry.reduction import icrs
from csstsim.command_line.main import main
from csstsim.io.level0 import read_level0
from csstsim.io.truth import read_truth
from csstsim.studies.recreate.recreate import _object_mask, _write, describe_campaign
from csstsim.studies.recreate.side_by_side import compare_frames

OBSID, CHIP = "10100000001", 9
SIZE = {"nx": 256, "ny": 256, "channel_nx": 32, "channel_ny": 128}
OWN = {"SIMVER", "SIMSEED", "HISTORY", "LAYOUT", "SKYRATE", "EPHEM", "READX0", "READX1", "READY0", "READY1", "DETSIZE"}


def run(*arguments, code=0):
    result = CliRunner().invoke(main, [str(a) for a in arguments], catch_exceptions=False)
    assert result.exit_code == code, result.output
    return result.output


def frame_of(folder, layout="channels", window=None, mag=18.5, side=5):
    """Make a chip with side^2 stars, galaxies and quasars, bright but not saturated, near the middle of a lens.

    Returns its Level-0 file and the camera's folder.
    """
    folder.mkdir(exist_ok=True)
    layers = yaml.safe_load((ROOT / "config/observations/science.yaml").read_text())["layers"]
    layers[-1] = {"quantization_and_output": {"layout": layout}}
    (folder / "science.yaml").write_text(yaml.safe_dump({"layers": layers}))
    more = {"observations": {"SCIE": str(folder / "science.yaml")}, "select": {"types": ["SCIE"], "chips": [CHIP]}}
    more |= {"truth": ["parquet", "cat"]} | ({"window": window} if window else {})
    bare = OpenCampaign(write_campaign(folder, POINTINGS[:1], SIZE, **more))
    job, count = bare.job(OBSID, CHIP), side**2
    positions = np.meshgrid(np.linspace(25, 230, side), np.linspace(25, 230, side))
    x, y = (v.ravel() + np.linspace(-2, 2, count) for v in positions)
    ra, dec = icrs(*job.wcs.pixel_to_world(x, y), job.observer)
    kind = np.arange(count) % 3
    table = Table({
        "id": 100 + np.arange(count), "ra": ra, "dec": dec, "obj_type": kind, "mag_r": mag + 0.04 * np.arange(count),
        "mag_g": mag + 1 + 0.04 * np.arange(count), "size": np.where(kind == 1, 0.3, 0.0),
        "pmra": np.where(kind == 0, 20.0, 0.0),
        "e1": np.where(kind == 1, 0.3, 0), "e2": np.where(kind == 1, -0.1, 0), "kappa": np.where(kind == 1, 0.2, 0),
        "gamma1": np.where(kind == 1, 0.1, 0), "z": 0.5 * (kind > 0), "bulgemass": 1e9 * (kind == 1),
        "diskmass": 3e9 * (kind == 1), "bulge_frac": 0.25 * (kind == 1),
    })  # fmt: skip
    table.write(folder / "mine.csv", overwrite=True)
    own = {"kind": "csstsim.catalog.own_table:TableCatalog", "options": {"file": str(folder / "mine.csv")}}
    campaign = write_campaign(folder, POINTINGS[:1], SIZE, catalog=own, **more)
    run("chip", campaign, "--obsid", OBSID, "--chip", CHIP)
    opened = OpenCampaign(campaign)
    return opened.paths.level0(opened.job(OBSID, CHIP)), folder / "instrument"


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """frame_of as it is by default; nothing is to be changed in it."""
    return frame_of(tmp_path_factory.mktemp("plain") / "a")


def again(frame, truth, folder, instrument, *options):
    """Recreate a frame and make its chip; return (what was printed, the new frame)."""
    said = run("recreate", frame, truth, "--output", folder, "--instrument", instrument, *options)
    data = yaml.safe_load((folder / "campaign.yaml").read_text()) | {"psf": {"grid": 2}}  # as the first, and quick
    (folder / "campaign.yaml").write_text(yaml.safe_dump(data))
    (job,) = OpenCampaign(folder / "campaign.yaml").jobs
    run("chip", folder / "campaign.yaml", "--obsid", job.obsid, "--chip", job.chip.id)
    return said, OpenCampaign(folder / "campaign.yaml").paths.level0(job)


WINDOW = {"x0": 20, "x1": 240, "y0": 10, "y1": 250}


@pytest.mark.parametrize("layout, window, suffix", [
    ("channels", None, ".cat"), ("mosaic", WINDOW, ".truth.parquet"),
    pytest.param("channels", None, ".truth.parquet", marks=pytest.mark.slow),
    pytest.param("mosaic", WINDOW, ".cat", marks=pytest.mark.slow),
])  # fmt: skip
def test_a_frame_of_csstsim_is_drawn_again(plain, tmp_path, layout, window, suffix):
    """Places to 0.02 px, light to 0.5%, background and noise to 1%: by csstsim compare, and by the truth."""
    frame, camera = frame_of(tmp_path / "a", layout, window) if window else plain
    truth = frame.with_suffix(suffix)
    said, other = again(frame, truth, tmp_path / "b", camera)
    assert ("size:" in said) is (suffix == ".cat") and "SIMSEED" not in said and "CAMHASH" not in said
    assert other.name == frame.name
    printed = run("compare", frame, other, "--truth", truth, "--instrument", camera)
    assert printed.count("same") == len(printed.splitlines()) >= 7
    one, two = (read_level0(path) for path in (frame, other))
    assert one.layout == two.layout == layout and one.window == two.window
    assert [one.header0[key] for key in ("LAYHASH", "CAMHASH", "SIMSEED", "DATE-OBS", "EXPSTART", "POSI0_X")] == [
        two.header0[key] for key in ("LAYHASH", "CAMHASH", "SIMSEED", "DATE-OBS", "EXPSTART", "POSI0_X")
    ]
    first, second = (read_truth(path.with_suffix(".truth.parquet")) for path in (frame, other))
    assert (first["id"] == second["id"]).all() and (first["obj_type"] == second["obj_type"]).all()
    for axis in ("x", "y"):
        np.testing.assert_allclose(first[axis], second[axis], atol=2e-4)  # px
    np.testing.assert_allclose(first["mag"], second["mag"], atol=2e-5)
    np.testing.assert_allclose(first["electrons"], second["electrons"], rtol=2e-4)
    for name in ("e1", "kappa", "g1", "g2", "size", "z", "bulgemass"):
        np.testing.assert_allclose(first[name], second[name], rtol=1e-5, atol=1e-7, err_msg=name)


def assembled(frame, path):
    """Write a frame as a plain image of the active pixels with one level and one gain, as early cycles have them."""
    file = read_level0(frame)
    pixels = np.zeros((file.readout.ny, file.readout.nx))
    for channel in file.channels():
        w = channel.window
        pixels[w.y0 : w.y1, w.x0 : w.x1] = (channel.active - channel.bias) * channel.gain / 1.1 + 500.0 / 1.1
    head = {
        key: file.header0[key] for key in ("DATE-OBS", "EXPTIME", "RA_OBJ", "DEC_OBJ", "POS_ANG0", "FILTER", "OBSID")
    }
    image = fits.ImageHDU(np.round(pixels).astype(np.uint16), name="IMAGE")
    image.header["CCDLABEL"], image.header["GAIN1"], image.header["RDNOISE1"] = "ccd 09", 1.1, 5.0
    primary = fits.PrimaryHDU()
    primary.header.update(head)
    fits.HDUList([primary, image]).writeto(path)


def stripped(frame, path):
    """Write a frame without the keywords that are csstsim's own."""
    with fits.open(frame) as file:
        for hdu in file:
            for name in OWN:
                hdu.header.remove(name, ignore_missing=True, remove_all=True)
        file.writeto(path)


@pytest.mark.parametrize("form, missing", [
    (stripped, ("HISTORY", "SKYRATE")), (assembled, ("HISTORY", "SKYRATE", "DETBIA01", "POSI0_*")),
])  # fmt: skip
def test_missing_keywords_are_assumed_and_reported(tmp_path, form, missing):
    """Frames like the mission's: the same light on the same pixels, the background that of the pixels.

    Objects are faint enough that their wings, part of that background, are less than 1% of it.
    """
    frame, camera = frame_of(tmp_path / "a", mag=20.8, side=3)
    form(frame, tmp_path / frame.name)
    said, other = again(tmp_path / frame.name, frame.with_suffix(".cat"), tmp_path / "b", camera, "--seed", 3)
    for name in missing:
        assert f"assumed  {name}" in said
    for line in compare_frames(frame, other, frame.with_suffix(".cat"), camera):
        assert line.verdict == "same", line
    data = yaml.safe_load((tmp_path / "b" / "campaign.yaml").read_text())
    assert data["instrument"]["filters.r.sky"] == pytest.approx(0.207, rel=0.01)
    assert data["instrument"]["detector.read_noise"] == pytest.approx(5.0)


def test_injected_objects_are_said_not_to_be_in_the_truth(plain, tmp_path):
    """The truth of the original lacks them; that of the copy has nothing else."""
    frame, camera = plain
    campaign = frame.parent
    while not (campaign / "campaign.yaml").is_file():
        campaign = campaign.parent
    run("inject", frame, "--catalogue", campaign / "mine.csv", "--output", tmp_path, "--campaign",
        campaign / "campaign.yaml")  # fmt: skip
    copy = tmp_path / frame.name
    for number, (image, truth, note) in enumerate((
        (copy, frame, "the frame has 25 injected objects, which TRUTH does not contain"),
        (copy, copy, "TRUTH contains injected objects only, not the frame's own"), (frame, frame, ""),
    )):  # fmt: skip
        given = image, truth.with_suffix(".truth.parquet"), "--output", tmp_path / f"out{number}"
        said = " ".join(run("recreate", *given, "--instrument", camera).split())
        assert f"assumed HISTORY: {note}" in said if note else "HISTORY" not in said


def test_objects_that_cannot_be_rendered_are_named_and_the_others_rendered(plain, tmp_path):
    frame, camera = plain
    lines = frame.with_suffix(".cat").read_text().splitlines()
    names = lines[0][2:].split()
    cells = [line.split() for line in lines[1:]]
    row = {int(words[0]): words for words in cells}  # 100 a star, 101 a galaxy, 102 a quasar
    row[100][names.index("mag")] = "nan"
    row[101][names.index("size")] = "-99"
    row[102][names.index("xImage")] = "nan"
    spoiled = tmp_path / "spoiled.cat"
    spoiled.write_text("\n".join([lines[0], *(" ".join(row) for row in cells)]))
    said = run("recreate", frame, spoiled, "--output", tmp_path / "b", "--instrument", camera)
    assert "1 object: no magnitude (100)" in said and "without size_disk (or size) (101)" in said
    assert "not a position on the sky (102)" in said and "22 objects" in said
    assert len(Table.read(tmp_path / "b" / "objects.fits")) == 22


def test_a_frame_made_with_laboratory_maps(tmp_path):
    """The maps of the given camera are used and reported: the same ones, or none."""
    frame, camera = frame_of(tmp_path / "a", side=2)
    name_maps(camera, "prnu", prnu={"chips": [CHIP]})
    write_map(map_path(camera, "prnu", CHIP), response((256, 256)))
    shutil.rmtree(tmp_path / "a" / "out")
    run("chip", tmp_path / "a" / "campaign.yaml", "--obsid", OBSID, "--chip", CHIP)
    truth = frame.with_suffix(".cat")
    said = run("recreate", frame, truth, "--output", tmp_path / "b", "--instrument", camera)
    assert "assumed  maps.prnu: " in said and "as in the frame" in said and "CAMHASH" not in said
    (camera / "maps.yaml").unlink()
    said = run("recreate", frame, truth, "--output", tmp_path / "c", "--instrument", camera)
    assert "maps.prnu: none, for the camera taken here has no such map" in said and "CAMHASH" in said


def test_a_deep_frame_without_photon_noise_in_a_folder_with_blanks(plain, tmp_path):
    """HISTORY without poisson_and_dark: the campaign is noise_free, or its layers could not have the photons."""
    frame, camera = plain
    with fits.open(frame) as file:
        header = file[0].header
        kept = [
            card for card in header["HISTORY"] if not card.startswith((" layer poisson_and_dark", " layer cosmic_rays"))
        ]
        header.remove("HISTORY", remove_all=True)
        for card in kept:
            header.add_history(card)
        header["SURVEY"] = "DEEP"
        file.writeto(tmp_path / "my frame.fits")
    out = tmp_path / "made again"
    said = run(
        "recreate", tmp_path / "my frame.fits", frame.with_suffix(".cat"), "--output", out, "--instrument", camera
    )
    assert "assumed  fidelity: noise_free" in said
    assert yaml.safe_load((out / "campaign.yaml").read_text())["fidelity"] == "noise_free"
    (job,) = OpenCampaign(out / "campaign.yaml").jobs
    assert job.pointing.survey == "DEEP"
    chip, compare = (shlex.split(line.removeprefix("Next:")) for line in said.splitlines()[-2:])
    assert chip[2] == str(out / "campaign.yaml") and compare[2] == str(tmp_path / "my frame.fits")
    assert compare[3] == str(OpenCampaign(out / "campaign.yaml").paths.level0(job))
    assert compare[4:] == ["--truth", str(frame.with_suffix(".cat"))]


FAULTS = {
    "no chip": (dict(DETECTOR=None, CHIPLAB=None), "DETECTOR: no chip number"),
    "chip": (dict(DETECTOR="77"), "DETECTOR: no such chip of the camera"),
    "filter": (dict(FILTER="i"), "FILTER: the camera's chip has another filter"),
    "bias": (dict(FILETYPE="BIAS"), "FILETYPE: not an exposure of the sky"),
    "exposure time": (dict(EXPTIME=1e9), "frame.fits: exptime: the header's value cannot be used: out of range (got"),
    "seed": (dict(SIMSEED=-4), "frame.fits: SIMSEED: not a seed (got -4"),
    "half a seed": (dict(SIMSEED=7.5), "frame.fits: SIMSEED: not a seed (got 7.5"),
    "layer": (dict(HISTORY=" layer nosuch {}"), "frame.fits: layers: the header's value cannot be used: unknown layer"),
    "place": (dict(RA_OBJ=None), "no position of the boresight"),
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_of_a_frame_are_one_line_and_nothing_is_written(tmp_path, fault):
    changes, words = FAULTS[fault]
    hdus = [fits.PrimaryHDU(), fits.ImageHDU(np.zeros((9232, 4), np.int16), name="IMAGE")]
    head = {"DETECTOR": "09", "RA_OBJ": 60.0, "DEC_OBJ": -40.0, "FILTER": "r", "EXPTIME": 150.0} | changes
    hdus[0].header.update({key: value for key, value in head.items() if value is not None})
    fits.HDUList(hdus).writeto(tmp_path / "frame.fits")
    (tmp_path / "a.cat").write_text("# xImage yImage mag obj_type\n10 20 20.0 star\n")
    result = CliRunner().invoke(main, ["recreate", *(str(tmp_path / n) for n in ("frame.fits", "a.cat")), "--output",
                                       str(tmp_path / "b")])  # fmt: skip
    assert result.exit_code == 2 and words in result.output and "Traceback" not in result.output
    assert not (tmp_path / "b").exists()


def bare_frame(path):
    """Write a whole frame of zeros whose header has only the required keywords."""
    fits.HDUList([fits.PrimaryHDU(), fits.ImageHDU(np.zeros((9232, 9216), np.int16), name="IMAGE")]).writeto(path)
    for key, value in {"DETECTOR": "09", "RA_OBJ": 60.0, "DEC_OBJ": -40.0}.items():
        fits.setval(path, key, value=value)


def test_faults_of_catalogue_and_folder(tmp_path):
    bare_frame(tmp_path / "f.fits")
    cat, out = tmp_path / "a.cat", tmp_path / "b"
    for text, words in (
        ("# xImage yImage obj_type\n1 2 star\n", "mag: the catalogue lacks a column"),
        ("# xImage mag obj_type\n1 2 star\n", "lacks a position"),
        ("# xImage yImage mag obj_type\n1 2 nan star\n", "none of its objects can be rendered"),
        ("# xImage yImage mag obj_type\n", "the catalogue has no rows"),
        (
            "# xImage yImage mag obj_type ID_chip\n1 2 20 star 09\n1 2 20 star 8\n",
            "ID_chip: not of this frame (got '8'); allowed: 9",
        ),
        ("# xImage yImage mag obj_type filter\n1 2 20 star i\n", "filter: not of this frame (got 'i'); allowed: r"),
        ("# xImage yImage mag obj_type\n90000 2 20 star\n", "xImage, yImage: no object lies near the frame"),
    ):
        cat.write_text(text)
        assert words in run("recreate", tmp_path / "f.fits", cat, "--output", out, code=2)
        assert not out.exists()
    shutil.copy(tmp_path / "f.fits", tmp_path / "turned.fits")
    fits.setval(tmp_path / "turned.fits", "POS_ANG0", value=20.0)  # or ra, dec cannot tell
    cat.write_text("# xImage yImage ra dec mag obj_type\n1 2 240 40 20 star\n")
    said = run("recreate", tmp_path / "turned.fits", cat, "--output", out, code=2)
    assert "ra, dec: no object lies near the frame" in said
    cat.write_text("# xImage yImage mag obj_type\n100 200 20.5 star\n")
    for name in ("campaign.yaml", "objects.fits", "Snakefile"):
        out.mkdir()
        (out / name).write_text("mine")
        assert "exists already" in run("recreate", tmp_path / "f.fits", cat, "--output", out, code=2)
        assert (out / name).read_text() == "mine" and len(list(out.iterdir())) == 1
        shutil.rmtree(out)


@pytest.mark.slow
def test_what_a_bare_header_does_not_say_is_assumed(tmp_path):
    bare_frame(tmp_path / "f.fits")
    cat = tmp_path / "a.cat"
    cat.write_text("# xImage yImage mag obj_type\n100 200 20.5 star\n")
    said = run("recreate", tmp_path / "f.fits", cat, "--output", tmp_path / "c")
    for name in ("OBSID", "POS_ANG0", "DATE-OBS", "EXPTIME", "POSI0_*", "GAIN01", "SIMSEED", "HISTORY", "SKYRATE"):
        assert f"assumed  {name}" in said
    (row,) = csv.DictReader((tmp_path / "c" / "survey_table.csv").read_text().splitlines())
    assert row["exptime"] == "150.0" and row["obsid"] == OBSID and row["ra"] == "60.0"


@pytest.mark.slow
def test_a_window_of_2000_px_at_full_depth(tmp_path):
    """The embedded sky through the shipped camera, from header and `.cat` alone (a minute)."""
    table = ROOT / "survey_tables" / "demo.csv"
    data = {
        "schema_version": 1, "name": "deep", "survey_table": str(table), "output": "out", "seed": 5,
        "select": {"obsids": ["10100000004"], "chips": [9]}, "truth": ["parquet", "cat"], "share": "share",
        "window": {"x0": 3000, "x1": 5000, "y0": 3700, "y1": 5700},
    }  # fmt: skip
    (tmp_path / "campaign.yaml").write_text(yaml.safe_dump(data))
    frames = []
    for folder in (tmp_path, tmp_path / "b"):
        file = folder / "campaign.yaml"
        run("chip", file, "--obsid", "10100000004", "--chip", 9)
        opened = OpenCampaign(file)
        frames.append(opened.paths.level0(opened.jobs[0]))
        if folder == tmp_path:
            run("recreate", frames[0], frames[0].with_suffix(".cat"), "--output", tmp_path / "b")
            with (tmp_path / "b" / "campaign.yaml").open("a") as other:
                other.write("share: ../share\n")
    lines = compare_frames(*frames, frames[0].with_suffix(".cat"))
    assert len(lines) == 7 and all(line.verdict == "same" for line in lines), lines


def test_a_header_of_others_describes_a_campaign():
    """Means of the channels that say something; the bias in electrons; the window; a seed of the caller's."""
    state = {"READX0": 101, "READX1": 300, "READY0": 51, "READY1": 90}
    gains = {"GAIN01": 1.0, "GAIN03": 0.0, "GAIN16": 2.0}
    head = header(
        DETECTOR="09", **PLACES, **state, **gains, RDNOIS01=4.0, RDNOIS02=8.0, DETBIA01=500.0, DETBIA02=520.0,
        SIMSEED=4, EXPTIME=200.0, POS_ANG0=10.0, FILTER="R",
    )  # fmt: skip
    data, layers, table = describe_campaign(head, None, 11)
    assert data["instrument"] == {
        "detector.gain": 1.5,
        "detector.read_noise": 6.0,
        "detector.bias": pytest.approx(510 * 1.5),
    }
    assert data["window"] == {"x0": 100, "x1": 300, "y0": 50, "y1": 90} and data["seed"] == 11
    assert data["select"] == {"types": ["SCIE"], "obsids": ["10100000001"], "chips": [9]}
    assert "fidelity" not in data and any("poisson_and_dark" in layer for layer in layers)
    heads, row = table.splitlines()
    assert dict(zip(heads.split(","), row.split(","), strict=True)) == {
        "obsid": "10100000001", "type": "SCIE", "ra": "11.0", "dec": "21.0", "pa": "10.0",
        "time": "2027-11-20T01:08:00", "exptime": "200.0",
    }  # fmt: skip
    assert "SIMSEED" not in " ".join(head.notes)
    assert describe_campaign(head, None, 0).data["seed"] == 0 and describe_campaign(head, None, None).data["seed"] == 4


def test_the_cameras_folder_is_that_of_where_the_command_runs(monkeypatch):
    """A campaign file's own relative paths start at its folder."""
    monkeypatch.chdir(SHIPPED)
    data, _, _ = describe_campaign(header(DETECTOR="09", **PLACES), "instrument", None)
    assert data["instrument"]["folder"] == str((SHIPPED / "instrument").resolve())


@pytest.mark.parametrize(("keys", "planets"), [({}, False), ({"LDPLANET": False}, False), ({"LDPLANET": True}, True)])
def test_planets_deflect_light_if_the_header_says_so(keys, planets):
    head = header(pieces("layer bias {}"), SIMVER="1", CHIPLAB="9", **PLACES, SIMSEED=4, EPHEM="builtin", **keys)
    assert describe_campaign(head, None, None).data["astrometry"] == {"ephemeris": "builtin", "planets": planets}


def test_a_table_that_cannot_be_written_is_not_there(tmp_path, monkeypatch):
    """Half of one is no catalogue."""

    def full(table, path, **how):
        with open(path, "wb") as file:
            file.write(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Table, "write", full)
    with pytest.raises(InputError, match=r"objects\.fits: cannot be written: No space"):
        _write(tmp_path / "out", {"name": "x"}, [], "obsid\n", {"id": np.arange(3)})
    assert (tmp_path / "out" / "survey_table.csv").is_file() and not (tmp_path / "out" / "objects.fits").exists()


def test_a_header_of_ours_describes_a_campaign():
    head = header(
        pieces("layer bias {}", "camera detector.gain = 1.25"), SIMVER="1", CHIPLAB="9", **PLACES, SIMSEED=4,
        EPHEM="builtin", LDPLANET=True,
    )  # fmt: skip
    data, layers, _ = describe_campaign(head, None, None)
    assert data["instrument"] == {"detector.gain": 1.25} and layers == [{"bias": {}}] and data["seed"] == 4
    assert data["astrometry"] == {"ephemeris": "builtin", "planets": True} and "window" not in data
    assert data["fidelity"] == "noise_free" and any(note.startswith("fidelity: noise_free") for note in head.notes)


def test_pixels_about_bright_objects_are_no_background(monkeypatch):
    """A circle of 10 px times the cube root of the light over that of the faintest, at most 300 px.

    It lies where the observer sees the object.
    """
    monkeypatch.setattr(
        "csstsim.studies.recreate.recreate.apparent", lambda ra, dec, observer: (ra + observer[0], dec + observer[1])
    )
    window = SimpleNamespace(x0=1000, x1=1400, y0=50, y1=350, shape=(300, 400))
    job = SimpleNamespace(
        wcs=SimpleNamespace(world_to_pixel=lambda x, y: (x, y)), observer=(40.0, -30.0), window=window
    )
    columns = {"ra": np.array([1060.0, 1260.0, 1160.0]), "dec": np.array([180.0, 280.0, 90.0])}
    mask = _object_mask(job, columns, np.array([8.0, 27.0, 1.0]))
    y, x = np.mgrid[:300, :400]
    wanted = (np.hypot(x - 100, y - 100) < 19.5) | (np.hypot(x - 300, y - 200) < 29.5)
    outside = (np.hypot(x - 100, y - 100) > 20.5) & (np.hypot(x - 300, y - 200) > 30.5)
    assert mask[wanted].all() and not mask[outside].any()
    far = _object_mask(job, {name: values[:1] for name, values in columns.items()}, np.array([1e9]))
    assert not far[-1, -1] and far[100, 399]
