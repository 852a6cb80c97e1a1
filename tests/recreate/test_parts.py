"""What headers say, pixels of every form, objects as a table, and two frames side by side: against closed forms."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from astropy.io import fits
from csst import BANDS

from csstsim.base.errors import InputError
from csstsim.catalog.table import ObjectTable
from csstsim.detector.channels import ReadoutFrame
from csstsim.io.fits_writing import remark
from csstsim.recreate import side_by_side
from csstsim.recreate.frame import FrameHeader, read_frame
from csstsim.recreate.objects import check_frame, own_table
from csstsim.recreate.pixels import clipped, read_electrons
from csstsim.recreate.recreate import _of_maps

DETECTOR = SimpleNamespace(
    nx=64, ny=16, channels_x=8, channels_y=2, channel_nx=8, channel_ny=8, prescan=3, overscan=12, parallel_overscan=4,
    gain=1.1, bias=550.0, adc_max=65535,
)  # fmt: skip
NAME = "CSST_MSC_MS_WIDE_20270810081950_20270810082220_10160000004_09_L0_V01.fits"


def header(history=(), name="x.fits", **keys):
    return FrameHeader(Path(name), keys, list(history), (16, 64))


def pieces(*lines):
    """The HISTORY of a file: texts on cards of 72 characters."""
    cards = "".join(remark("HISTORY", f" {line}") for line in lines)
    return [cards[i + 8 : i + 80] for i in range(0, len(cards), 80)]


@pytest.mark.parametrize("pad", range(60, 75))
def test_entries_that_go_on_in_the_next_card(pad):
    """A blank at the end of a card is part of the entry."""
    text = "a" * (pad - 30) + " b " + "c" * 80
    found = header(pieces(f'layer mylab.glint {{"note": "{text}"}}', "camera detector.gain = 1.25", 'value own = "x"',
                          "layer bias {}"))  # fmt: skip
    assert found.layers() == [{"mylab.glint": {"note": text}}, {"bias": {}}]
    assert found.camera_changes() == {"detector.gain": 1.25} and not found.notes


def test_the_part_of_the_survey():
    for keys, part in (({"SURVEY": "DEEP"}, "DEEP"), ({"SURVEY": "WIDE"}, None), ({}, None), ({"SURVEY": "x"}, None)):
        head = header(CRVAL1=1.0, CRVAL2=2.0, **keys)
        assert head.exposure.get("survey") == part
        assert any(note.startswith("SURVEY") for note in head.notes) is (keys == {"SURVEY": "x"})


def test_laboratory_maps_are_no_numbers_of_the_camera():
    head = header(pieces("camera detector.gain = 1.25", "camera maps.prnu = prnu_01.fits, DATASUM 1754568332",
                         "camera maps.bias = bias_01.fits, DATASUM 7"))  # fmt: skip
    maps = {"prnu": "prnu_01.fits, DATASUM 1754568332", "bias": "bias_01.fits, DATASUM 7"}
    assert head.camera_changes() == {"detector.gain": 1.25} and head.camera_maps() == maps
    same, other, none = _of_maps({"bias": "b", **maps, "dark": "d"}, {"maps.prnu": "new", "maps.bias": maps["bias"]})
    assert "as in the frame" in same and "new; the frame's was prnu_01" in other and "no such map" in none
    with pytest.raises(InputError, match="not a number of the camera"):
        header(pieces("camera detector.gain = many")).camera_changes()


@pytest.mark.parametrize("angle", [-113.4333, 0.0, 170.0, -1.0])
def test_the_angle_of_a_matrix(angle):
    """facts of the mission's headers: CD1_1 = s cos pa, CD1_2 = s sin pa."""
    a = np.radians(angle)
    head = header(CD1_1=2e-5 * np.cos(a), CD1_2=2e-5 * np.sin(a), CRVAL1=-1.0, CRVAL2=3.0)
    assert head.exposure["pa"] == pytest.approx(angle) and head.exposure["ra"] == 359.0
    assert header(POS_ANG0=angle, CD1_1=1.0, CD1_2=1.0, CRVAL1=1, CRVAL2=3).exposure["pa"] == angle


@pytest.mark.parametrize(
    "keys, name, time",
    [
        ({"DATE-OBS": "2027-01-02T03:04:05.678"}, "x.fits", "2027-01-02T03:04:05.678"),
        ({"DATE-OBS": "", "EXPSTART": 61407.25}, "x.fits", "2027-01-02T06:00:00.000000"),
        ({"DATE-OBS": "yesterday"}, NAME, "2027-08-10T08:19:50"), ({}, "x.fits", "2027-11-20T01:08:00"),
    ],
)  # fmt: skip
def test_the_time_comes_from_keyword_or_name(keys, name, time):
    assert header(name=name, CRVAL1=1.0, CRVAL2=3.0, **keys).exposure["time"] == time


def test_chip_and_exposure_come_from_keyword_or_name():
    assert header(name=NAME).chip == 9 and header(name=NAME).obsid == "10160000004"
    assert header(CHIPLAB="chip 21").chip == 21 and header(OBSID=10160000007).obsid == "10160000007"
    with pytest.raises(InputError, match="no chip number"):
        _ = header().chip


def test_the_state_of_a_spacecraft_is_one_of_an_orbit():
    good = {f"POSI0_{a}": v for a, v in zip("XYZ", (6778.0, 0.0, 0.0), strict=True)}
    good |= {f"VELO0_{a}": v for a, v in zip("XYZ", (0.0, 7.6, 0.0), strict=True)}
    assert header(CRVAL1=1.0, CRVAL2=2.0, **good).exposure["sat_vy"] == 7.6
    for bad in ({"POSI0_X": 0.0}, {"POSI0_X": None}, {"VELO0_Y": 0.0}):
        head = header(CRVAL1=1.0, CRVAL2=2.0, **(good | bad))
        assert "sat_x" not in head.exposure and any("POSI0" in note for note in head.notes)


def write(path, array, **keys):
    image = fits.ImageHDU(array, name="IMAGE")
    image.header.update(keys)
    fits.HDUList([fits.PrimaryHDU(), image]).writeto(path)
    return read_frame(path)


@pytest.mark.parametrize("layout", ["channels", "mosaic", "chip"])
@pytest.mark.parametrize("window", [None, (5, 61, 2, 15)])
def test_electrons_of_every_form(tmp_path, layout, window):
    """DN of known levels and gains, another for each channel; deferred charge beside the active pixels is left out."""
    readout = ReadoutFrame.of(DETECTOR, window)
    rng = np.random.default_rng(2)
    wanted = rng.integers(0, 5000, (readout.window[3] - readout.window[2], readout.window[1] - readout.window[0]))
    frame = np.zeros(readout.shape, np.uint16)
    gains, levels = {}, {}
    for block in readout.blocks:
        n = block.channel
        gains[f"GAIN{n:02d}"], levels[f"DETBIA{n:02d}"] = 1.0 + n / 100, 400.0 + n
        frame[block.whole] = 400 + n
        scan = frame[block.serial_overscan]
        scan[:, -1 if block.flip_x else 0] += 1000
        frame[block.active] += wanted[block.image].astype(np.uint16)
    stored, keys = None, gains
    if layout == "chip":
        stored, keys = np.zeros((16, 64), np.uint16), gains | levels
        x0, x1, y0, y1 = readout.window
        stored[y0:y1, x0:x1] = readout.active(frame)
    else:
        stored = readout.to_stored(frame, layout)
    if window:
        keys = keys | dict(zip(("READX0", "READX1", "READY0", "READY1"), (6, 61, 3, 15), strict=True))
    found = read_electrons(write(tmp_path / "a.fits", stored, **keys), DETECTOR)
    gain = np.zeros(wanted.shape)
    for block in readout.blocks:
        gain[block.image] = gains[f"GAIN{block.channel:02d}"]
    np.testing.assert_allclose(found.electrons, wanted * gain, rtol=1e-5, atol=1e-2)
    assert found.window == readout.window and not found.saturated.any()


def test_pixels_of_another_camera_are_refused(tmp_path):
    with pytest.raises(InputError, match="not the pixels of this camera"):
        read_electrons(write(tmp_path / "a.fits", np.zeros((10, 10), np.int16)), DETECTOR)


@pytest.mark.parametrize("gain", [0.0, -1.1])
def test_a_gain_that_turns_charge_into_nothing_is_refused(tmp_path, gain):
    frame = write(tmp_path / "a.fits", np.zeros((16, 64), np.uint16), GAIN03=gain)
    with pytest.raises(InputError, match="GAIN03: impossible"):
        read_electrons(frame, DETECTOR)


def test_clipping_leaves_out_what_is_bright():
    rng = np.random.default_rng(1)
    values = rng.normal(30.0, 5.0, 200_000)
    values[:300] = 5e4
    mean, sigma = clipped(values)
    assert mean == pytest.approx(30.0, abs=5 * 5 / np.sqrt(200_000)) and sigma == pytest.approx(5.0, rel=0.02)
    assert clipped(np.full(5, 3.0)) == (3.0, 0.0)


class Flat:
    """A WCS of one arcsec a pixel about the origin."""

    def pixel_to_world(self, x, y):
        return np.asarray(x) / 3600.0, np.asarray(y) / 3600.0


@pytest.fixture
def job(monkeypatch):
    monkeypatch.setattr("csstsim.recreate.objects.icrs", lambda ra, dec, observer: (np.asarray(ra), np.asarray(dec)))
    return SimpleNamespace(wcs=Flat(), observer=None, chip=SimpleNamespace(filter="r"))


def objects(**columns):
    return ObjectTable({name: np.asarray(values) for name, values in columns.items()})


def test_the_lens_is_taken_off_the_light(job):
    """mag is of the magnified light: it falls by 2.5 log10 of |det A|; g is reduced shear."""
    kappa, g = 0.2, 0.1
    notes = []
    found, left = own_table(
        objects(id=[5], obj_type=np.array([1], np.int8), x=[36.0], y=[72.0], mag=[20.0], size=[0.4], e1=[0.1], e2=[0.0],
                kappa=[kappa], g1=[g], g2=[0.0], bulgemass=[1.0], diskmass=[3.0]), job, BANDS, notes)  # fmt: skip
    det = (1 - kappa) ** 2 - (g * (1 - kappa)) ** 2
    assert found["mag_r"][0] == pytest.approx(20.0 - 2.5 * np.log10(det)) and found["gamma1"][0] == pytest.approx(0.08)
    assert found["bulge_frac"][0] == 0.25 and found["size_disk"][0] == found["size_bulge"][0] == 0.4
    assert found["ra"][0] == pytest.approx(0.01) and found["dec"][0] == pytest.approx(0.02)
    assert not left and notes == ["size: the same half-light radius for disk and bulge"]


def test_objects_without_much_of_a_catalogue(job):
    """Ids given twice are counted anew; blanks and placeholders are nothing; light of gratings is flat in f_nu."""
    notes = []
    job.chip.filter = "GV"
    found, left = own_table(
        objects(id=[7, 7, 7], obj_type=np.array([0, 2, 1], np.int8), ra=[1.0, 2.0, 3.0], dec=[0.0, 0.0, 0.0],
                mag=[20.0, 21.0, 22.0], e1=[-99.0, np.nan, 0.0]), job, BANDS, notes)  # fmt: skip
    assert list(found["id"]) == [1, 2] and list(found["ra"]) == [1.0, 2.0] and list(found["e1"]) == [0.0, 0.0]
    assert all(list(found[f"mag_{band}"]) == [20.0, 21.0] for band in BANDS)
    assert list(left.values()) == [[3]] and "a galaxy without size_disk" in left
    assert any(note.startswith("obj_ID") for note in notes) and any(note.startswith("xImage") for note in notes)


def scene(light=1.0, shift=0.0, level=30.0, noise=7.0, seed=1):
    """Thirty Gaussian stars of 2e5 e- on 400 x 400 px; returns (image, x, y)."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:400, :400]
    places = np.stack([v.ravel()[:30] + 0.3 for v in np.meshgrid(np.linspace(30, 360, 6), np.linspace(30, 360, 5))])
    image = rng.normal(level, noise, (400, 400)).astype(np.float32)
    for px, py in places.T:
        image += (light * 2e5 / (2 * np.pi * 1.44) * np.exp(-((x - px - shift) ** 2 + (y - py) ** 2) / 2.88)).astype(
            "f4"
        )
    return image, *places


@pytest.mark.parametrize(
    "change, differing",
    [
        ({}, set()), ({"light": 1.02}, {"light of points [e-]"}), ({"level": 31.0}, {"background [e-]"}),
        ({"noise": 7.3}, {"noise [e-]"}), ({"shift": 0.05}, {"places along x [px]", "places, median [px]"}),
    ],
)  # fmt: skip
def test_a_difference_is_found_where_it_is(monkeypatch, change, differing):
    """Of another noise; the number found is the one put in."""
    first, x, y = scene()
    frames = iter([first, scene(**change, seed=2)[0]])
    none = np.zeros((400, 400), bool)
    monkeypatch.setattr(side_by_side, "read_frame", lambda path: SimpleNamespace(chip=9))
    chips = {9: SimpleNamespace(kind="imaging")}
    monkeypatch.setattr(side_by_side, "load_camera", lambda folder: SimpleNamespace(detector=None, chips=chips))
    monkeypatch.setattr(
        side_by_side, "read_electrons",
        lambda *_: SimpleNamespace(electrons=next(frames), saturated=none, window=(100, 500, 0, 400)),
    )  # fmt: skip
    truth = objects(x=x + 100.0, y=y, mag=np.full(30, 20.0), obj_type=np.zeros(30, np.int8))
    monkeypatch.setattr(side_by_side, "read_objects", lambda path: truth)
    lines = {line.what: line for line in side_by_side.compared("a", "b", "c")}
    assert {what for what, line in lines.items() if line.verdict == side_by_side.DIFFERS} == differing
    assert lines["light of points [e-]"].difference == pytest.approx(change.get("light", 1.0) - 1, abs=1e-3)
    assert lines["places along x [px]"].difference == pytest.approx(change.get("shift", 0.0), abs=5e-3)
    assert lines["noise [e-]"].difference == pytest.approx(change.get("noise", 7.0) / 7 - 1, abs=1e-2)  # 4 sigma


def test_the_error_of_light_is_that_of_both_images_photons_and_noise_in_the_circle():
    """To 3%: the noise is measured beside the stars, and their light is within the circle to 1e-5."""
    noise, none = 300.0, np.zeros((400, 400), bool)
    pair = [scene(noise=noise, seed=seed)[0] for seed in (1, 2)]
    _, x, y = scene()
    levels = [side_by_side.clipped(image[~none]) for image in pair]
    [line] = side_by_side._Objects(pair, none, levels, x, y, np.zeros(30, np.int8)).light()
    electrons = 30 * 2e5
    variance = 2 * (electrons + 30 * np.pi * side_by_side.RADIUS**2 * noise**2)
    assert line.error == pytest.approx(np.sqrt(variance) / electrons, rel=0.03)


@pytest.mark.parametrize("kind, differing", [("imaging", 1), ("slitless", 0)])
def test_that_no_object_could_be_compared_is_said(monkeypatch, kind, differing):
    """Behind gratings objects are never compared."""
    camera = SimpleNamespace(detector=None, chips={9: SimpleNamespace(kind=kind)})
    flat = np.full((40, 40), 5.0, np.float32)
    found = SimpleNamespace(electrons=flat, saturated=flat < 0, window=(0, 40, 0, 40))
    monkeypatch.setattr(side_by_side, "load_camera", lambda folder: camera)
    monkeypatch.setattr(side_by_side, "read_frame", lambda path: SimpleNamespace(chip=9))
    monkeypatch.setattr(side_by_side, "read_electrons", lambda *_: found)
    monkeypatch.setattr(side_by_side, "read_objects", lambda path: objects(x=[900.0], y=[9.0], obj_type=[0]))
    said = []
    assert side_by_side.side_by_side("a", "b", "c.cat", said.append) == differing
    assert sum("no object of c.cat could be compared" in line for line in said) == differing


@pytest.mark.parametrize("chips, windows, words", [
    ((9, 8), [(0, 4, 0, 4)] * 2, "not frames of one chip"), ((77, 77), [(0, 4, 0, 4)] * 2, "not frames of one chip"),
    ((9, 9), [(0, 4, 0, 4), (4, 8, 0, 4)], "in windows apart"),
])  # fmt: skip
def test_frames_that_have_nothing_in_common(monkeypatch, chips, windows, words):
    camera = SimpleNamespace(detector=None, chips={9: SimpleNamespace(kind="slitless")})
    heads, cut = iter(SimpleNamespace(chip=chip) for chip in chips), iter(windows)
    flat = np.zeros((4, 4), np.float32)
    monkeypatch.setattr(side_by_side, "load_camera", lambda folder: camera)
    monkeypatch.setattr(side_by_side, "read_objects", lambda path: objects(x=[1.0], y=[1.0]))
    monkeypatch.setattr(side_by_side, "read_frame", lambda path: next(heads))
    monkeypatch.setattr(
        side_by_side, "read_electrons", lambda *_: SimpleNamespace(electrons=flat, saturated=flat > 0, window=next(cut))
    )
    with pytest.raises(InputError, match=words):
        side_by_side.compared("a", "b", "c")


@pytest.mark.parametrize("names", [("x", "y"), ("ra", "dec"), ("x", "y", "ra", "dec", "mag")])
@pytest.mark.parametrize("off", [0.0, 0.1, 5.0])  # deg
def test_objects_that_do_not_lie_near_the_frame(names, off):
    """By the places that the table has; one object near the frame is enough."""
    plane = SimpleNamespace(pixel_to_world=lambda x, y: (10.0 + 1e-5 * (x - 500.0), 1e-5 * (y - 500.0)))
    job = SimpleNamespace(
        chip=SimpleNamespace(id=9, filter="r"), window=SimpleNamespace(x0=0, x1=1000, y0=0, y1=1000), wcs=plane
    )
    far = np.array([0.0, off, off + 1.0]) if off < 1 else np.array([off, off + 1.0])
    places = {"x": 500.0 + far * 1e5, "y": 500.0 + 0 * far, "ra": 10.0 + far, "dec": 0 * far, "mag": 20.0 + 0 * far}
    table = ObjectTable({name: places[name] for name in names})
    if off < 1:
        check_frame(table, "a.cat", job)
    else:
        with pytest.raises(InputError, match="no object lies near the frame"):
            check_frame(table, "a.cat", job)
    if "x" not in names:
        check_frame(table, "a.cat", job, turned=False)
