"""Laboratory maps: what maps.yaml may say, what a file must be, and that faults are met before any work."""

import shutil

import numpy as np
import pytest
import yaml
from astropy.io import fits
from click.testing import CliRunner
from support.lab_maps import SOURCE, map_path, name_maps, response, write_map
from support.mini import mini_camera
from support.mini_campaign import write_campaign

from csstsim.base.errors import InputError
from csstsim.campaign.checks import check_maps
from csstsim.campaign.opened import OpenCampaign
from csstsim.command_line.main import main
from csstsim.detector import mask
from csstsim.detector.channels import ReadoutFrame
from csstsim.instrument.camera import load_camera
from csstsim.instrument.maps.chip_maps import MapEntry, map_files, needed
from csstsim.instrument.maps.kinds import DEFECTS, KINDS
from csstsim.optics.throughput.flat import FlatField

CHIP = 9  # r
SHAPE = 64, 256
BIAS = "BIAS,0,0,0,2027-11-20T02:00:00,0"


@pytest.fixture
def folder(tmp_path):
    """A small camera whose chip 9 has a map of its pixels' response."""
    instrument = mini_camera(tmp_path)
    name_maps(instrument, "prnu", prnu={"chips": [CHIP]})
    write_map(map_path(instrument, "prnu", CHIP), response(SHAPE))
    return instrument


def opened(folder):
    """Return the camera after the check that opening a campaign makes, and that of all pixels."""
    camera = load_camera(folder)
    check_maps(camera.chips.values())
    check_maps(camera.chips.values(), read=True)
    return camera


def test_bits_and_shapes_are_those_of_the_detector(camera):
    """The camera may not know the detector's kernels, so that these facts have two places."""
    assert {name: mask.BITS[name] for name in DEFECTS} == DEFECTS
    frame = ReadoutFrame.of(camera.detector, None)
    assert KINDS["bias"].shapes(camera.detector) == {
        frame.stored_shape(layout): layout for layout in ("channels", "mosaic")
    }


def test_a_map_is_read_and_belongs_to_its_chip(folder):
    camera = opened(folder)
    own = camera.chips[CHIP].maps.prnu
    assert np.array_equal(own.part(slice(3, 9), slice(250, 256)), response(SHAPE)[3:9, 250:])
    assert np.array_equal(own.at(np.array([0, 63]), np.array([255, 0])), response(SHAPE)[[0, 63], [255, 0]])
    assert own.maximum == float(response(SHAPE).max())
    assert camera.chips[8].maps.prnu is None and not camera.chips[8].maps and not camera.chips[CHIP].maps.bias


def test_a_fault_is_named_by_its_place_on_the_chip(folder):
    """Also where a part is read, forwards or backwards, or single pixels."""
    write_map(map_path(folder, "prnu", CHIP), changed(5, 7, 0.0))
    own = load_camera(folder).chips[CHIP].maps.prnu
    for read in (
        lambda: own.part(slice(3, 9), slice(6, 20)), lambda: own.part(slice(8, 2, -1), slice(20, None, -1)),
        lambda: own.at(np.array([0, 5]), np.array([3, 7])),
    ):  # fmt: skip
        with pytest.raises(InputError, match=r"1 pixel .* x 7, y 5 \(from 0\) \(got 0.0\)") as caught:
            read()
        assert caught.value.page == "docs/lab_maps.md"


def test_without_maps_nothing_changes(tmp_path):
    plain = load_camera(mini_camera(tmp_path))
    assert not any(chip.maps for chip in plain.chips.values())
    assert plain.digest_for("level0", chip=plain.chips[CHIP]) == plain.digest_for("level0")


def test_an_extension_in_place_of_the_primary_hdu(folder):
    path = map_path(folder, "prnu", CHIP)
    hdu = fits.ImageHDU(response(SHAPE), name="PRNU")
    hdu.header["DATAMAX"] = 1.2
    fits.HDUList([fits.PrimaryHDU(), hdu]).writeto(path, overwrite=True, checksum=True)
    assert opened(folder).chips[CHIP].maps.prnu.maximum == 1.2


def changed(y, x, value):
    values = response(SHAPE)
    values[y, x] = value
    return values


FAULTS = {  # (what is written, keywords, words of the error)
    "shape": (response((64, 255)), {}, "wrong shape.*64, 255.*64 rows of 256"),
    "cube": (response((2, 64, 256)), {}, "wrong shape"),
    "type": (response(SHAPE).astype(np.float64), {}, "wrong type.*-64.*float32"),
    "whole numbers": (np.ones(SHAPE, np.int16), {}, "wrong type.*BITPIX -32"),
    "NaN": (
        changed(5, 7, np.nan),
        {},
        r"1 pixel out of range or not finite, the first at x 7, y 5 .* \(got nan\)",
    ),
    "infinite": (changed(5, 7, np.inf), {"DATAMAX": 1.9}, "not finite.*inf"),
    "zero": (changed(63, 255, 0.0), {}, "1 pixel out of range.*x 255, y 63 .*got 0.0.*0.1 to"),
    "above DATAMAX": (response(SHAPE), {"DATAMAX": 1.01}, r"out of range.*0.1 to 1.01 \(DATAMAX\)"),
    "no DATAMAX": (response(SHAPE), {"DATAMAX": None}, "DATAMAX: missing"),
    "huge DATAMAX": (response(SHAPE), {"DATAMAX": 7.0}, "DATAMAX: out of range.*7.0"),
    "DATAMAX in words": (response(SHAPE), {"DATAMAX": "one"}, "DATAMAX: out of range.*one"),
    "mean": (response(SHAPE) * np.float32(1.2), {}, "mean.*out of range.*1.[12].*0.95 to 1.05"),
    "low mean": (response(SHAPE) * np.float32(0.9), {}, r"mean.*out of range.*0\.89.*0\.95 to 1\.05"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_faulty_file_gives_one_line(folder, fault):
    values, keywords, words = FAULTS[fault]
    path = map_path(folder, "prnu", CHIP)
    write_map(path, values, **keywords)
    with pytest.raises(InputError, match=words) as caught:
        opened(folder)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(("name", "value"), [("BSCALE", 2.0), ("BZERO", 0.5)])
def test_scaled_pixels_are_refused(folder, name, value):
    """They are read as they are stored. A scale of 1 and a zero of 0 change nothing."""
    path = map_path(folder, "prnu", CHIP)
    for number in ({"BSCALE": 1.0, "BZERO": 0.0}[name], value):
        write_map(path, response(SHAPE), PLACE=number)
        path.write_bytes(path.read_bytes().replace(b"PLACE   =", f"{name:8}=".encode(), 1))
        if number != value:
            opened(folder)
    with pytest.raises(InputError, match=r"BITPIX: wrong type \(got 'scaled"):
        opened(folder)


def test_faults_of_files_as_such(folder):
    path = map_path(folder, "prnu", CHIP)
    good = path.read_bytes()
    fits.PrimaryHDU(response(SHAPE), fits.Header({"DATAMAX": 1.2})).writeto(path, overwrite=True)
    with pytest.raises(InputError, match=r"DATASUM: missing.*checksum=True"):
        opened(folder)
    hdu = fits.CompImageHDU(response(SHAPE), fits.Header({"DATAMAX": 1.2}))
    fits.HDUList([fits.PrimaryHDU(), hdu]).writeto(path, overwrite=True, checksum=True)
    with pytest.raises(InputError, match="must have one image"):
        opened(folder)
    fits.HDUList([fits.PrimaryHDU(response(SHAPE)), fits.ImageHDU(response(SHAPE))]).writeto(path, overwrite=True)
    with pytest.raises(InputError, match="must have one image"):
        opened(folder)
    path.write_bytes(good[:6000])
    with pytest.raises(InputError, match=r"prnu_09.fits: .*(cut short|readable)"):
        opened(folder)
    path.write_bytes(b"no FITS")
    with pytest.raises(InputError, match=r"prnu_09.fits: not a readable FITS file"):
        opened(folder)
    path.unlink()
    with pytest.raises(InputError, match=r"prnu_09.fits: no such map \(prnu\)"):
        opened(folder)


def test_changed_pixels_under_an_old_header_are_seen(folder):
    path = map_path(folder, "prnu", CHIP)
    with open(path, "r+b") as file:
        file.seek(2880 + 4 * 300)
        file.write(np.array([1.001], ">f4").tobytes())
    check_maps(load_camera(folder).chips.values())
    with pytest.raises(InputError, match=r"changed after the header.*checksum=True"):
        opened(folder)


def test_bad_pixels_and_bias_have_their_own_contracts(folder):
    name_maps(folder, "bad_pixels", "bias", bad_pixels={"chips": [CHIP]}, bias={"chips": [CHIP]})
    bits, path = np.zeros(SHAPE, np.uint8), map_path(folder, "bad_pixels", CHIP)
    bits[1, :40], bits[2, 3], bits[3, 4] = mask.BAD_COLUMN, mask.HOT | mask.BAD_COLUMN, mask.DEAD
    frame = ReadoutFrame.of(load_camera(folder).detector, None)
    write_map(path, bits)
    write_map(map_path(folder, "bias", CHIP), np.zeros(frame.stored_shape("mosaic"), np.float32))
    maps = opened(folder).chips[CHIP].maps
    assert maps.bad_pixels.part(slice(None), slice(None)).dtype == np.uint8 and maps.bias.layout == "mosaic"
    for values, words in (
        (np.full(SHAPE, 8, np.uint8), "fraction of bad pixels is out of range.*1.0.*0 to 0.1"),
        (np.where(bits == 0, 0, 64).astype(np.uint8), "42 pixels .* x 0, y 1 .*got 64.*8 HOT, 16 DEAD, 32 BAD_COLUMN"),
        (bits.astype(np.int16), "wrong type.*uint8"),
    ):
        write_map(path, values)
        with pytest.raises(InputError, match=words):
            opened(folder)
    write_map(path, bits)
    for values, words in (
        (np.full(frame.stored_shape("channels"), 500.0, np.float32), "mean.*500.0.*-1 to 1"),
        (np.zeros(SHAPE, np.float32), r"wrong shape.*\(channels\) or .*\(mosaic\)"),
    ):
        write_map(map_path(folder, "bias", CHIP), values)
        with pytest.raises(InputError, match=words):
            opened(folder)


def test_flats_are_asked_for_where_the_filter_looks(folder, camera):
    """Those that have a weight in the band, an independent calculation, and no others."""
    field = FlatField(camera.leds, None)
    for filter_ in camera.filters.values():
        weights = field.weights(filter_.wavelength, filter_.throughput)
        wanted = needed(camera.leds["flat"]["wavelengths"], filter_)
        assert set(field.wavelengths[weights > 0]) <= set(wanted) and len(wanted) <= (weights > 0).sum() + 2
    name_maps(folder, "led_flats", led_flats={"chips": [CHIP]})
    with pytest.raises(InputError, match=r"led_525_09.fits: no such map \(led_flats\)"):
        opened(folder)
    for led in needed(camera.leds["flat"]["wavelengths"], camera.filters["r"]):
        write_map(map_path(folder, "led_flats", CHIP, led), response(SHAPE, int(led)))
    assert list(opened(folder).chips[CHIP].maps.led_flats) == [525, 590, 670, 760]
    leds = yaml.safe_load((folder / "leds.yaml").read_text())
    for wrong in ([525], [590, 525], [525, 525, 590], ["525", 590], 525, None):
        leds["flat"]["wavelengths"]["value"] = wrong
        (folder / "leds.yaml").write_text(yaml.safe_dump(leds))
        with pytest.raises(InputError, match=r"leds.yaml: flat.wavelengths: .*two numbers or more, rising"):
            load_camera(folder)
    (folder / "leds.yaml").unlink()
    with pytest.raises(InputError, match=r"leds.yaml: flat.wavelengths: .*maps.yaml has led_flats"):
        load_camera(folder)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ({"flat": {"files": "a_{chip}.fits"} | SOURCE}, "flat: unknown map.*led_flats, prnu, bad_pixels, bias"),
        ({"prnu": {"files": "a_{chip}.fits"}}, "prnu: source and confidence are missing"),
        ({"prnu": {"files": "a_{chip}.fits", "source": "x"}}, "confidence is missing"),
        ({"prnu": "a_{chip}.fits"}, "prnu: source and confidence are missing"),
        ({"prnu": {"files": "a.fits"} | SOURCE}, "prnu.files: cannot be the files' name.*{chip}"),
        ({"prnu": {"files": "a_{chip}_{led}.fits"} | SOURCE}, "cannot be the files' name"),
        ({"prnu": {"files": "*_{chip}.fits"} | SOURCE}, "cannot be the files' name"),
        ({"led_flats": {"files": "a_{chip}.fits"} | SOURCE}, "{chip} and {led}"),
        ({"prnu": {"files": "a_{chip}.fits", "chips": [77]} | SOURCE}, "prnu.chips: no such chip.*77.*1, 2"),
        (
            {"prnu": {"files": "a_{chip}.fits", "chip": [9]} | SOURCE},
            "prnu.chip: unknown.*allowed: chips, confidence, files, source",
        ),
        ({"prnu": {"files": "a_{chip}.fits", "source": ""}}, "source and confidence are missing"),
        ({"prnu": {"chips": [9]} | SOURCE}, "prnu.files: required key is missing"),
    ],
)
def test_faults_of_maps_yaml(folder, text, words):
    (folder / "maps.yaml").write_text(yaml.safe_dump(text))
    with pytest.raises(InputError, match=rf"maps.yaml: .*{words}") as caught:
        load_camera(folder)
    assert caught.value.page == "docs/lab_maps.md"


def recipes(run, chip):
    job = run.job("10300000001", chip)
    return {stage: run.recipe(job, stage)["camera"] for stage in ("select", "render", "readout", "level0", "measure")}


def campaign(tmp_path):
    """A campaign of a bias exposure of three chips whose camera lies beside it."""
    shape = {"nx": 128, "ny": 128, "channel_nx": 16, "channel_ny": 64}
    file = write_campaign(tmp_path, [f"10300000001,{BIAS}"], shape, select={"types": ["BIAS"], "chips": [7, 8, 9]})
    return file, tmp_path / "instrument"


@pytest.mark.parametrize(("kind", "first"), [("prnu", "render"), ("bad_pixels", "readout"), ("bias", "readout")])
def test_a_changed_map_makes_its_own_chip_again_from_its_stage_on(tmp_path, kind, first):
    """Named only, moved or commented, nothing is made again; a pixel of chip 9 leaves chip 8 alone."""
    file, instrument = campaign(tmp_path)
    frame = ReadoutFrame.of(load_camera(instrument).detector, None)
    values = {
        "prnu": response((128, 128)), "bad_pixels": np.zeros((128, 128), np.uint8),
        "bias": np.zeros(frame.stored_shape("channels"), np.float32),
    }[kind]  # fmt: skip
    before = {chip: recipes(OpenCampaign(file), chip) for chip in (7, 8, 9)}
    name_maps(instrument, kind, **{kind: {"chips": [8, 9]}})
    for chip in (8, 9):
        write_map(map_path(instrument, kind, chip), values)
    named = {chip: recipes(OpenCampaign(file), chip) for chip in (7, 8, 9)}
    stages = list(before[9])
    seen = set(stages[stages.index(first) :])
    assert named[7] == before[7]
    assert {stage for stage in stages if named[9][stage] != before[9][stage]} == seen
    values[5, 6] = {"prnu": 1.01, "bad_pixels": 16, "bias": 0.5}[kind]
    write_map(map_path(instrument, kind, 9), values)
    after = {chip: recipes(OpenCampaign(file), chip) for chip in (7, 8, 9)}
    assert after[8] == named[8] and {stage for stage in stages if after[9][stage] != named[9][stage]} == seen
    digest = load_camera(instrument).digest
    shutil.move(instrument / "maps", instrument / "lab")
    text = (instrument / "maps.yaml").read_text().replace("maps/", "lab/")
    (instrument / "maps.yaml").write_text(f"# moved\n{text}")
    assert {chip: recipes(OpenCampaign(file), chip) for chip in (7, 8, 9)} == after
    assert load_camera(instrument).digest == digest, "large files are not read for the digest of a camera"


def test_a_campaign_is_refused_before_its_first_stage(tmp_path):
    """Headers when it is opened, all pixels by `check` and `chip`; chips that are not selected may lack their maps."""
    file, instrument = campaign(tmp_path)
    name_maps(instrument, "prnu", prnu={"chips": [9, 10]})
    with pytest.raises(InputError, match=r"prnu_09.fits: no such map"):
        OpenCampaign(file)
    write_map(map_path(instrument, "prnu", 9), np.where(np.arange(128) == 127, np.nan, response((128, 128))))
    OpenCampaign(file)
    for command in (["check", file], ["chip", file, "--obsid", "10300000001", "--chip", 9]):
        result = CliRunner().invoke(main, list(map(str, command)))
        assert result.exit_code == 2 and "prnu_09.fits: 128 pixels out of range" in result.stderr
        assert "x 127, y 0 " in result.stderr and result.stderr.rstrip().endswith("docs/lab_maps.md")
    write_map(map_path(instrument, "prnu", 9), response((128, 128)))
    result = CliRunner().invoke(main, ["check", str(file)])
    assert result.exit_code == 0, result.output


def test_which_files_of_the_folder_are_maps():
    entries = {"prnu": MapEntry("maps/prnu_{chip}.fits"), "led_flats": MapEntry("./maps/led_{led}_{chip}.fits")}
    maps = {"maps.yaml", "maps/prnu_09.fits", "maps/led_430_30.fits"}
    others = {"detector.yaml", "maps/prnu_9.fits", "maps/led_{led}_30.fits.txt", "prnu_09.fits", "maps/bias_09.fits"}
    assert map_files(entries, maps | others) == maps
    assert map_files({}, maps | others) == {"maps.yaml"}


@pytest.mark.parametrize("more", [fits.ImageHDU(np.zeros((2, 2))), fits.BinTableHDU.from_columns([]), fits.ImageHDU()])
def test_a_map_is_alone_in_its_file(folder, more):
    """Behind the image of an extension comes nothing: what it would mean, no one says."""
    path = map_path(folder, "prnu", CHIP)
    with fits.open(path) as file:
        image = fits.ImageHDU(file[0].data, file[0].header)
    for beside, words in ((), None), ((more,), "must have one image"):
        fits.HDUList([fits.PrimaryHDU(), image.copy(), *beside]).writeto(path, overwrite=True)
        if words:
            with pytest.raises(InputError, match=words):
                opened(folder)
        else:
            opened(folder)


def test_a_chips_maps_are_told_by_file_and_sum_and_by_stage(folder):
    """The header's words; which stage reads a kind first; a digest of shape, sum and largest value, not of names."""
    maps = load_camera(folder).chips[CHIP].maps
    path = map_path(folder, "prnu", CHIP)
    assert maps.record == {"maps.prnu": f"prnu_09.fits, DATASUM {fits.getheader(path)['DATASUM']}"}
    assert list(maps.of({"render", "level0"})) == ["prnu"] and maps.of({"readout"}) == {}
    assert maps.digest({"readout"}) is None and len(maps.digest({"render"})) == 16
    name_maps(folder, "bad_pixels", "led_flats", bad_pixels={"chips": [CHIP]}, led_flats={"chips": [CHIP]})
    write_map(map_path(folder, "bad_pixels", CHIP), np.zeros(SHAPE, np.uint8))
    for led in (525, 590, 670, 760):
        write_map(map_path(folder, "led_flats", CHIP, led), response(SHAPE, led))
    more = load_camera(folder).chips[CHIP].maps
    flats = [f"led_flats.{led}" for led in (525, 590, 670, 760)]
    assert list(more.of({"render"})) == flats and list(more.of({"readout"})) == ["bad_pixels"]
    assert set(more.record) == {f"maps.{name}" for name in (*flats, "bad_pixels")}
    before = maps.digest({"render"})
    write_map(path, response(SHAPE), DATAMAX=1.9)
    name_maps(folder, "prnu", prnu={"chips": [CHIP]})
    chips = load_camera(folder).chips
    assert chips[CHIP].maps.prnu.maximum == 1.9 and chips[CHIP].maps.digest({"render"}) != before
    assert chips[8].maps.record == {} and chips[8].maps.digest({"render"}) is None
