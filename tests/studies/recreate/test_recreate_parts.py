"""What headers say, pixels of every form, objects as a table, and two frames side by side: against closed forms."""

from types import SimpleNamespace

import numpy as np
import pytest
from astropy.io import fits
from support.csst import BANDS
from support.recreated_headers import PLACES, header, pieces

from csstsim.base.errors import InputError
from csstsim.catalog.astrometry.ephemeris import observer
from csstsim.catalog.astrometry.reduction import apparent
from csstsim.catalog.object_table import BRIGHTEST, FAINTEST
from csstsim.catalog.table import ObjectTable
from csstsim.detector.channels import ReadoutFrame
from csstsim.inject.request import Request, record
from csstsim.studies.recreate import recreate, side_by_side
from csstsim.studies.recreate.frame import read_frame
from csstsim.studies.recreate.objects import campaign_table, check_frame
from csstsim.studies.recreate.pixels import Level, clipped, read_electrons
from csstsim.studies.recreate.recreate import _injection_notes, _map_notes

DETECTOR = SimpleNamespace(
    nx=64, ny=16, channels_x=8, channels_y=2, channel_nx=8, channel_ny=8, prescan=3, overscan=12, parallel_overscan=4,
    gain=1.1, bias=550.0, adc_max=65535,
)  # fmt: skip
NAME = "CSST_MSC_MS_WIDE_20270810081950_20270810082220_10160000004_09_L0_V01.fits"


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
    same, other, none = _map_notes({"bias": "b", **maps, "dark": "d"}, {"maps.prnu": "new", "maps.bias": maps["bias"]})
    assert "as in the frame" in same and "new; the frame's was prnu_01" in other and "no such map" in none
    with pytest.raises(InputError, match="not a camera parameter"):
        header(pieces("camera detector.gain = many")).camera_changes()


def test_injected_objects_of_all_calls_are_counted():
    """By the entries that `csstsim inject` writes, one for each call. A layer's text is none of them."""
    request = Request({"ra": np.array([1.0])}, "a table with a long name.csv")
    entries = [f"injected {text}" for count in (2, 0, 1) for text in record(request, count)["history"]]
    head = header(pieces('layer mylab.glint {"note": "injected 7 objects of "}', *entries, "injected by hand"))
    assert head.injected() == 3 and header(pieces("layer bias {}")).injected() == 0
    assert list(_injection_notes(0, False)) == list(_injection_notes(0, True)) == []
    [lacking] = _injection_notes(1, False)
    assert lacking == "HISTORY: the frame has 1 injected object, which TRUTH does not contain"
    assert list(_injection_notes(2, True)) == ["HISTORY: TRUTH contains injected objects only, not the frame's own"]


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
    """DN of known levels and gains, another for each channel; deferred charge next to the active pixels is left out."""
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
    monkeypatch.setattr(
        "csstsim.studies.recreate.objects.icrs", lambda ra, dec, observer: (np.asarray(ra), np.asarray(dec))
    )
    return SimpleNamespace(wcs=Flat(), observer=None, chip=SimpleNamespace(filter="r"))


def objects(**columns):
    return ObjectTable({name: np.asarray(values) for name, values in columns.items()})


def test_the_lens_is_taken_off_the_light(job):
    """mag is of the magnified light: it falls by 2.5 log10 of |det A|; g is reduced shear."""
    kappa, g = 0.2, 0.1
    notes = []
    found, left = campaign_table(
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
    found, left = campaign_table(
        objects(id=[7, 7, 7], obj_type=np.array([0, 2, 1], np.int8), ra=[1.0, 2.0, 3.0], dec=[0.0, 0.0, 0.0],
                mag=[20.0, 21.0, 22.0], e1=[-99.0, np.nan, 0.0]), job, BANDS, notes)  # fmt: skip
    assert list(found["id"]) == [1, 2] and list(found["ra"]) == [1.0, 2.0] and list(found["e1"]) == [0.0, 0.0]
    assert all(list(found[f"mag_{band}"]) == [20.0, 21.0] for band in BANDS)
    assert list(left.values()) == [[3]] and "a galaxy without size_disk (or size)" in left
    assert any(note.startswith("obj_ID") for note in notes) and any(note.startswith("xImage") for note in notes)


def scene(light=1.0, shift=0.0, level=30.0, noise=7.0, seed=1):
    """Thirty Gaussian stars of 2e5 e- on 400 x 400 px; returns (image, x, y)."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:400, :400]
    positions = np.stack([v.ravel()[:30] + 0.3 for v in np.meshgrid(np.linspace(30, 360, 6), np.linspace(30, 360, 5))])
    image = rng.normal(level, noise, (400, 400)).astype(np.float32)
    for px, py in positions.T:
        image += (light * 2e5 / (2 * np.pi * 1.44) * np.exp(-((x - px - shift) ** 2 + (y - py) ** 2) / 2.88)).astype(
            "f4"
        )
    return image, *positions


@pytest.mark.parametrize(
    "change, differing",
    [
        ({}, set()), ({"light": 1.02}, {"flux of points [e-]"}), ({"level": 31.0}, {"background [e-]"}),
        ({"noise": 7.3}, {"noise [e-]"}), ({"shift": 0.05}, {"positions along x [px]", "positions, median [px]"}),
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
    lines = {line.what: line for line in side_by_side.compare_frames("a", "b", "c")}
    assert {what for what, line in lines.items() if line.verdict == side_by_side.DIFFERS} == differing
    assert lines["flux of points [e-]"].difference == pytest.approx(change.get("light", 1.0) - 1, abs=1e-3)
    assert lines["positions along x [px]"].difference == pytest.approx(change.get("shift", 0.0), abs=5e-3)
    assert lines["noise [e-]"].difference == pytest.approx(change.get("noise", 7.0) / 7 - 1, abs=1e-2)  # 4 sigma


def test_the_error_of_light_is_that_of_both_images_photons_and_noise_in_the_circle():
    """To 3%: the noise is measured next to the stars, and their flux is within the circle to 1e-5."""
    noise, none = 300.0, np.zeros((400, 400), bool)
    pair = [scene(noise=noise, seed=seed)[0] for seed in (1, 2)]
    _, x, y = scene()
    levels = [side_by_side.clipped(image[~none]) for image in pair]
    [line] = side_by_side._Objects(pair, none, levels, x, y, np.zeros(30, np.int8)).fluxes()
    electrons = 30 * 2e5
    variance = 2 * (electrons + 30 * np.pi * side_by_side.RADIUS**2 * noise**2)
    assert line.error == pytest.approx(np.sqrt(variance) / electrons, rel=0.03)


def test_the_error_of_positions_is_that_of_the_mean():
    """Means of 30 stars along two axes, in eight pairs of images, scatter by their errors: 1 +- 0.18, to 3 sigma."""
    none = np.zeros((400, 400), bool)
    _, x, y = scene()
    pulls = []
    for seed in range(8):
        pair = [scene(noise=30.0, seed=2 * seed + image)[0] for image in range(2)]
        levels = [side_by_side.clipped(image[~none]) for image in pair]
        lines = side_by_side._Objects(pair, none, levels, x, y, np.zeros(30, np.int8)).positions()
        pulls += [line.difference / line.error for line in lines if "along" in line.what]
    assert len(pulls) == 16 and 0.46 < np.sqrt(np.mean(np.square(pulls))) < 1.54


def test_fluxes_are_those_above_each_frames_own_background():
    """Of 30 and 500 e- a pixel: in the circles the difference is a quarter of a star's flux."""
    none = np.zeros((400, 400), bool)
    pair = [scene(level=level, noise=5.0, seed=seed)[0] for seed, level in ((1, 30.0), (2, 500.0))]
    _, x, y = scene()
    levels = [clipped(image) for image in pair]
    [line] = side_by_side._Objects(pair, none, levels, x, y, np.zeros(30, np.int8)).fluxes()
    assert line.difference == pytest.approx(0.0, abs=2e-3)


@pytest.mark.parametrize("kind, differing", [("imaging", 1), ("slitless", 0)])
def test_that_no_object_could_be_compared_is_reported(monkeypatch, kind, differing):
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
    ((9, 9), [(0, 4, 0, 4), (4, 8, 0, 4)], "windows of the frames do not overlap"),
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
        side_by_side.compare_frames("a", "b", "c")


@pytest.mark.parametrize("names", [("x", "y"), ("ra", "dec"), ("x", "y", "ra", "dec", "mag")])
@pytest.mark.parametrize("off", [0.0, 0.1, 5.0])  # deg
def test_objects_that_do_not_lie_near_the_frame(names, off):
    """By the positions that the table has; one object near the frame is enough."""
    plane = SimpleNamespace(pixel_to_world=lambda x, y: (10.0 + 1e-5 * (x - 500.0), 1e-5 * (y - 500.0)))
    job = SimpleNamespace(
        chip=SimpleNamespace(id=9, filter="r"), window=SimpleNamespace(x0=0, x1=1000, y0=0, y1=1000), wcs=plane
    )
    far = np.array([0.0, off, off + 1.0]) if off < 1 else np.array([off, off + 1.0])
    positions = {"x": 500.0 + far * 1e5, "y": 500.0 + 0 * far, "ra": 10.0 + far, "dec": 0 * far, "mag": 20.0 + 0 * far}
    table = ObjectTable({name: positions[name] for name in names})
    if off < 1:
        check_frame(table, "a.cat", job)
    else:
        with pytest.raises(InputError, match="no object lies near the frame"):
            check_frame(table, "a.cat", job)
    if "x" not in names:
        check_frame(table, "a.cat", job, angle_known=False)


@pytest.mark.parametrize(("at", "near"), [((8500, 7200), True), ((8100, 7000), True), ((500, 200), False)])
def test_objects_lie_near_the_window_that_was_read(at, near):
    """Not near the same window at the chip's corner: half a degree away, by their pixels as by the sky."""
    plane = SimpleNamespace(pixel_to_world=lambda x, y: (10.0 + 1e-4 * np.asarray(x), 1e-4 * np.asarray(y)))
    window = SimpleNamespace(x0=8000, x1=9000, y0=7000, y1=7400)
    job = SimpleNamespace(chip=SimpleNamespace(id=9, filter="r"), window=window, wcs=plane)
    x, y = (np.array([float(v)]) for v in at)
    for table in (objects(x=x, y=y), objects(**dict(zip(("ra", "dec"), plane.pixel_to_world(x, y), strict=True)))):
        if near:
            check_frame(table, "a.cat", job)
        else:
            with pytest.raises(InputError, match="no object lies near the frame"):
                check_frame(table, "a.cat", job)


@pytest.mark.parametrize("names", [("ra", "dec"), ("x", "y")])
def test_objects_are_seen_where_the_catalogue_has_them(names):
    """Apparent directions, or pixels, become ICRS positions that this observer sees there: aberration is 20 arcsec."""
    seer = observer(61700.0, (6778.0, 0.0, 0.0), (0.0, 7.0, 3.0))
    job = SimpleNamespace(wcs=Sky(), observer=seer, chip=SimpleNamespace(filter="r"))
    seen = {"ra": np.array([60.1, 60.3]), "dec": np.array([-40.2, -39.9])}
    given = seen if names == ("ra", "dec") else {"x": seen["ra"] * 100, "y": seen["dec"] * 100}
    found, _ = campaign_table(
        objects(id=[1, 2], obj_type=np.zeros(2, np.int8), mag=[20.0, 21.0], **given), job, BANDS, []
    )
    again = apparent(found["ra"], found["dec"], seer)
    for one, other in zip(again, seen.values(), strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-8)
    moved = 3600 * np.hypot((found["ra"] - seen["ra"]) * np.cos(np.radians(40)), found["dec"] - seen["dec"])
    assert (moved > 1).all() and (moved < 25).all()


class Sky:
    """A WCS of 100 pixels a degree."""

    def pixel_to_world(self, x, y):
        return np.asarray(x) / 100, np.asarray(y) / 100


@pytest.mark.parametrize(
    ("mags", "left"),
    [((20.0, 21.0), None), ((20.0, np.nan), None), ((np.nan, np.nan), "no magnitude"),
     ((20.0, FAINTEST + 1), "a magnitude outside"), ((BRIGHTEST - 1, 20.0), "a magnitude outside")],
)  # fmt: skip
def test_an_object_needs_one_magnitude_and_none_that_cannot_be(job, mags, left):
    found, why = campaign_table(
        objects(id=[4], obj_type=np.zeros(1, np.int8), x=[1.0], y=[2.0], mag=[20.0], mag_g=mags[:1], mag_r=mags[1:]),
        job, BANDS, [],
    )  # fmt: skip
    assert found["id"].tolist() == ([] if left else [4])
    assert [reason.startswith(left) for reason in why] == [True] if left else not why


def test_a_frame_that_states_no_bias_has_that_of_the_camera_in_dn(tmp_path):
    """550 e- at 1.1 e-/DN are 500 DN; the gain is that of the channel, or else of all, or else the camera's."""
    dn = np.full((16, 64), 800, np.uint16)
    for number, (keys, wanted) in enumerate((
        ({}, 300 * 1.1), ({"GAIN": 2.0}, 300 * 2.0), ({"GAIN": 2.0, "GAIN1": 3.0}, 300 * 3.0),
        ({"BIAS": 420.0, "GAIN1": 3.0}, 380 * 3.0),
    )):  # fmt: skip
        frame = write(tmp_path / f"{number}.fits", dn, **keys)
        assert read_electrons(frame, DETECTOR).electrons == pytest.approx(wanted, rel=1e-6)
        assert [note for note in frame.notes if "the level is the camera's, 500.0 DN" in note] == frame.notes
        assert bool(frame.notes) is ("BIAS" not in keys)
    some = write(tmp_path / "some.fits", dn, DETBIA01=400.0, GAIN02=2.0)
    found = read_electrons(some, DETECTOR).electrons
    first, second = ReadoutFrame.of(DETECTOR, None).blocks[:2]
    assert found[first.image] == pytest.approx(400 * 1.1) and found[second.image] == pytest.approx(300 * 2.0)


@pytest.mark.parametrize(("keys", "first"), [({}, 65535), ({"SATURATE": 60000.0}, 60000), ({"SATURATE": 1e6}, 65535)])
def test_pixels_at_the_converters_end_or_the_stated_one_are_saturated(tmp_path, keys, first):
    dn = np.full((16, 64), 800, np.uint16)
    dn[3, 40:42] = first - 1, first
    saturated = read_electrons(write(tmp_path / "a.fits", dn, BIAS=500.0, **keys), DETECTOR).saturated
    assert np.argwhere(saturated).tolist() == [[3, 41]]


def test_an_overscan_of_few_columns_is_taken_whole(tmp_path):
    """Of six columns two would be left without deferred charge: their mean is that of all."""
    detector = SimpleNamespace(**(vars(DETECTOR) | {"overscan": 6}))
    readout = ReadoutFrame.of(detector, None)
    frame = np.full(readout.shape, 400, np.uint16)
    for block in readout.blocks:
        frame[block.serial_overscan][:, -1 if block.flip_x else 0] = 402
    found = read_electrons(write(tmp_path / "a.fits", readout.to_stored(frame, "channels"), GAIN=3.0), detector)
    assert found.electrons == pytest.approx(-1.0, abs=1e-3)


def test_a_window_that_no_chip_has_is_refused(tmp_path):
    frame = write(tmp_path / "a.fits", np.zeros((16, 64), np.uint16), READX0=1, READX1=900, READY0=1, READY1=4)
    with pytest.raises(InputError, match=r"READX0\.\.READY1"):
        read_electrons(frame, DETECTOR)


def test_clipping_goes_on_until_nothing_is_far():
    """100 lies within 3 sigma while 10000 is there."""
    mean, sigma = clipped([*range(11), 100.0, 10_000.0])
    assert (mean, sigma) == pytest.approx((5.0, np.sqrt(10)))


def test_the_image_of_a_frame_is_its_extension_image_or_the_first_plane(tmp_path):
    """Its header's values stand for those of the primary; HISTORY is the primary's."""
    small, cube, wide = np.zeros((3, 5), np.int16), np.zeros((2, 2, 2), np.int16), np.zeros((4, 7), np.int16)
    primary = fits.PrimaryHDU()
    primary.header.update({"DETECTOR": "05", "GAIN": 1.0, "FILETYPE": "WIDE"})
    primary.header.add_history(" layer bias {}")
    other, image = fits.ImageHDU(small, name="OTHER"), fits.ImageHDU(wide, name="IMAGE")
    other.header["GAIN"], image.header["GAIN"] = 2.0, 3.0
    fits.HDUList([primary, fits.ImageHDU(cube), other, image]).writeto(tmp_path / "named.fits")
    fits.HDUList([primary, fits.ImageHDU(cube), other]).writeto(tmp_path / "first.fits")
    named, first = (read_frame(tmp_path / name) for name in ("named.fits", "first.fits"))
    assert (named.shape, named.number("GAIN")) == ((4, 7), 3.0) and (first.shape, first.number("GAIN")) == ((3, 5), 2.0)
    assert named.chip == 5 and named.layers() == [{"bias": {}}] and not named.by_csstsim
    fits.HDUList([primary, fits.ImageHDU(cube)]).writeto(tmp_path / "none.fits")
    with pytest.raises(InputError, match="holds no image"):
        read_frame(tmp_path / "none.fits")
    primary.header["FILETYPE"] = "FLAT"
    fits.HDUList([primary, image]).writeto(tmp_path / "flat.fits")
    with pytest.raises(InputError, match="FILETYPE: not an exposure of the sky"):
        read_frame(tmp_path / "flat.fits")


def test_an_exposure_has_every_column_of_its_header():
    state = dict(zip(("POSI0_X", "POSI0_Y", "POSI0_Z", "VELO0_X", "VELO0_Y", "VELO0_Z"),
                     (6700.0, 100.0, -200.0, 0.5, 7.0, -3.0), strict=True))  # fmt: skip
    head = header(
        OBSID="10160000004", **{"DATE-OBS": "2027-01-02T03:04:05"}, EXPTIME=250.0, POS_ANG0=12.5, SURVEY="deep",
        **PLACES, **state,
    )  # fmt: skip
    assert head.exposure == {
        "obsid": "10160000004", "type": "SCIE", "ra": 11.0, "dec": 21.0, "pa": 12.5, "time": "2027-01-02T03:04:05",
        "exptime": 250.0, "sat_x": 6700.0, "sat_y": 100.0, "sat_z": -200.0, "sat_vx": 0.5, "sat_vy": 7.0,
        "sat_vz": -3.0, "survey": "DEEP",
    }  # fmt: skip
    assert not head.notes


@pytest.mark.parametrize("left", range(4))
def test_the_position_is_that_of_the_first_keywords_which_exist(left):
    head = header(**dict(list(PLACES.items())[2 * left :]))
    assert (head.exposure["ra"], head.exposure["dec"]) == (11.0 + left, 21.0 + left)


@pytest.mark.parametrize(("radius", "taken"), [(6300.0, False), (6400.0, True), (49_000.0, True), (51_000.0, False)])
def test_an_orbit_lies_between_the_earth_and_50000_km(radius, taken):
    keys = dict(POSI0_X=0.0, POSI0_Y=0.6 * radius, POSI0_Z=0.8 * radius, VELO0_X=0.0, VELO0_Y=0.0, VELO0_Z=1.0)
    assert ("sat_x" in header(CRVAL1=1.0, CRVAL2=2.0, **keys).exposure) is taken


def test_what_is_assumed_of_an_empty_header():
    """Each assumption is the value that the documentation names, and is reported."""
    head = header(CRVAL1=-30.0, CRVAL2=2.0, OBSID="x7", EXPTIME=0.0, CD1_1=0.0, CD1_2=0.0)
    assert head.exposure == {
        "obsid": "10100000001", "type": "SCIE", "ra": 330.0, "dec": 2.0, "pa": 0.0, "time": "2027-11-20T01:08:00",
        "exptime": 150.0,
    }  # fmt: skip
    said = [note.split(":")[0] for note in head.notes]
    assert said == ["OBSID", "POS_ANG0", "DATE-OBS", "EXPTIME", "POSI0_*, VELO0_*"]
    assert header(name=NAME, OBSID="x7").obsid == "10160000004"
    assert header(CRVAL1=1.0, CRVAL2=2.0, POS_ANG0=np.nan, POS_ANG1=7.0).exposure["pa"] == 7.0
    with pytest.raises(InputError, match="no position of the boresight"):
        _ = header(CRVAL1=1.0, CRVAL2="here").exposure
    assert header(pieces("layer bias {not json")).layers() is None


@pytest.mark.parametrize(("ends", "found"), [((1, 64, 1, 16), None), ((3, 64, 1, 16), (2, 64, 0, 16)),
                                             ((1, 64, 1, 15), (0, 64, 0, 15))])  # fmt: skip
def test_the_window_that_was_read(ends, found):
    keys = dict(zip(("READX0", "READX1", "READY0", "READY1"), ends, strict=True))
    assert header(**keys).window(DETECTOR) == found
    assert header(**{name: keys[name] for name in list(keys)[:3]}).window(DETECTOR) is None


def test_shear_and_magnitudes_of_a_lensed_galaxy_and_of_a_strong_lens(job):
    """Both components differ; every magnitude of the table is taken through the lens; |det A| where det A < 0."""
    kappa, g1, g2 = np.array([0.2, 1.6]), np.array([0.1, 0.05]), np.array([-0.3, 0.2])
    table = dict(id=[5, 6], obj_type=np.array([1, 1], np.int8), x=[36.0, 72.0], y=[72.0, 9.0], mag=[20.0, 21.0],
                 mag_r=[20.5, 21.5], mag_g=[22.0, 23.0], size=[0.4, 0.7], e1=[0.1, -0.2], e2=[0.3, 0.15], kappa=kappa,
                 g1=g1, g2=g2, z=[0.5, -99.0])  # fmt: skip
    found, left = campaign_table(objects(**table), job, BANDS, [])
    det = (1 - kappa) ** 2 * (1 - g1**2 - g2**2)
    for name in ("mag_r", "mag_g"):
        assert found[name] == pytest.approx(np.array(table[name]) - 2.5 * np.log10(det))
    assert found["gamma1"] == pytest.approx([0.08, -0.03]) and found["gamma2"] == pytest.approx([-0.24, -0.12])
    assert list(found["e1"]) == [0.1, -0.2] and list(found["e2"]) == [0.3, 0.15] and not left
    assert list(found["size_disk"]) == [0.4, 0.7] and not found["bulge_frac"].any()
    assert found["z"][0] == 0.5 and np.isnan(found["z"][1]) and "mag_i" not in found
    dark = objects(**(table | {"g1": [3.0, 0.05]}))
    assert campaign_table(dark, job, BANDS, [])[0]["mag_r"][0] == pytest.approx(
        20.5 - 2.5 * np.log10(abs(0.64 * (1 - 9 - 0.09)))
    )


def test_a_truth_table_has_the_sizes_of_both_components(job):
    """Of galaxies alone; ids may be whole floats; a bright and a dark object are named, and none is of an image."""
    notes = []
    found, left = campaign_table(
        objects(
            id=[7.0, 8.0, 9.0, 10.0], obj_type=np.array([1, 0, 0, 0], np.int8), x=[1.0, 2.0, 3.0, 4.0], y=[0.0] * 4,
            mag=[20.0, 21.0, -20.0, np.nan], size_disk=[0.4] * 4, size_bulge=[0.2] * 4, bulge_frac=[0.3] * 4,
            n_disk=[1.5] * 4, n_bulge=[3.0] * 4, knots=[6] * 4, knots_frac=[0.1] * 4, image_file=["a.fits", "", "", ""],
            **{name: np.zeros(4) for name in ("e1", "e2", "kappa", "g1", "g2")},
        ), job, BANDS, notes,
    )  # fmt: skip
    assert found["id"].tolist() == [7, 8] and found["id"].dtype == np.int64
    for name, of_galaxy, of_star in (
        ("size_disk", 0.4, 0.0), ("size_bulge", 0.2, 0.0), ("bulge_frac", 0.3, 0.0), ("n_disk", 1.5, 1.0),
        ("n_bulge", 3.0, 4.0), ("knots", 6, 0), ("knots_frac", 0.1, 0.0),
    ):  # fmt: skip
        assert found[name].tolist() == [of_galaxy, of_star], name
    assert {reason: list(ids) for reason, ids in left.items()} == {
        "no magnitude": [10.0],
        f"a magnitude outside {BRIGHTEST:g} to {FAINTEST:g}": [9.0],
    }
    assert notes == ["image_file: galaxies of an image are disks of its size"]


def test_the_bulges_fraction_is_that_of_masses_which_are_known(job):
    found, _ = campaign_table(
        objects(id=[1, 2, 3, 4], obj_type=np.array([1, 1, 1, 0], np.int8), x=[1.0] * 4, y=[1.0] * 4, mag=[20.0] * 4,
                size=[0.5] * 4, bulgemass=[3.0, -5.0, -99.0, 3.0], diskmass=[1.0, 2.0, np.nan, 1.0]),
        job, BANDS, [],
    )  # fmt: skip
    assert found["bulge_frac"].tolist() == [0.75, 0.0, 0.0, 0.0] and found["size_disk"].tolist() == [0.5, 0.5, 0.5, 0.0]


@pytest.mark.parametrize(("chip", "filter_", "fault"), [
    ("09", "R", None), ("9.0", "r", None), ("-", "", None), ("", "none", None), ("19", "r", "ID_chip"),
    ("9", "i", "filter"),
])  # fmt: skip
def test_a_catalogue_is_of_the_frames_chip_and_filter(chip, filter_, fault):
    plane = SimpleNamespace(pixel_to_world=lambda x, y: (10.0 + 1e-5 * x, 1e-5 * y))
    job = SimpleNamespace(
        chip=SimpleNamespace(id=9, filter="r"), window=SimpleNamespace(x0=0, x1=100, y0=0, y1=90), wcs=plane
    )
    table = objects(x=[5.0, 6.0], y=[5.0, 6.0], chip=["9", chip], filter=["r", filter_])
    if fault is None:
        return check_frame(table, "a.cat", job)
    with pytest.raises(InputError, match=f"{fault}: not of this frame"):
        check_frame(table, "a.cat", job)


@pytest.mark.parametrize("number", [1, 9, 10, 20, 30])
def test_a_chips_number_has_any_zeros_before_it_and_none_is_lost(number):
    plane = SimpleNamespace(pixel_to_world=lambda x, y: (10.0 + 1e-5 * x, 1e-5 * y))
    window = SimpleNamespace(x0=0, x1=100, y0=0, y1=90)
    job = SimpleNamespace(chip=SimpleNamespace(id=number, filter="r"), window=window, wcs=plane)
    for text in (f"{number}", f"{number:02d}", f"{number}.0", f"{number:03d}"):
        check_frame(objects(x=[5.0], y=[5.0], chip=[text]), "a.cat", job)
    for other in {number + 1, number * 10, number // 10 or 2}:
        with pytest.raises(InputError, match="ID_chip: not of this frame"):
            check_frame(objects(x=[5.0], y=[5.0], chip=[f"{other}"]), "a.cat", job)


@pytest.mark.parametrize(("difference", "error", "verdict"), [
    (0.01, 1.0, "same"), (-0.01, 0.0, "same"), (0.03, 0.01, "cannot be told"), (-0.03, 0.0099, "DIFFERS"),
    (0.011, 0.0, "DIFFERS"), (np.nan, 0.1, "DIFFERS"),
])  # fmt: skip
def test_a_difference_beyond_two_errors_and_what_is_allowed_differs(difference, error, verdict):
    assert side_by_side.Line("x", "", difference, error, 0.01).verdict == verdict


def test_background_and_noise_are_compared_relative_to_the_first_frame():
    """Relative to an electron where the level is less; the error is that of both means."""
    level, noise = side_by_side._backgrounds([Level(40.0, 3.0), Level(41.0, 4.0)], 100)
    assert (level.difference, level.error, level.allowed) == pytest.approx((1 / 40, 0.5 / 40, 0.01))
    assert (noise.difference, noise.error) == pytest.approx((1 / 3, 0.5 / 3)) and level.words.split() == [
        "40.000", "41.000",
    ]  # fmt: skip
    assert next(side_by_side._backgrounds([Level(0.2, 3.0), Level(-0.3, 4.0)], 25)).difference == pytest.approx(-0.5)


def test_values_beyond_five_robust_sigmas_are_outliers():
    near = [-2.0] * 4 + [0.0] + [2.0] * 4  # the median deviation is 2: five sigmas are 14.826
    kept = side_by_side._without_outliers(10 + np.array([*near, 14.8, -14.9]))
    assert kept.tolist() == [True] * 10 + [False]
    assert side_by_side._without_outliers(np.array([1.0, 1.0, 1.0, 9.0])).all()


@pytest.fixture
def compare(monkeypatch):
    """Return a function that compares two (image, saturated, window) at objects."""

    def of(one, other, truth):
        frames = iter(SimpleNamespace(electrons=a, saturated=b, window=c) for a, b, c in (one, other))
        camera = SimpleNamespace(detector=None, chips={9: SimpleNamespace(kind="imaging")})
        monkeypatch.setattr(side_by_side, "read_frame", lambda path: SimpleNamespace(chip=9))
        monkeypatch.setattr(side_by_side, "load_camera", lambda folder: camera)
        monkeypatch.setattr(side_by_side, "read_electrons", lambda *_: next(frames))
        monkeypatch.setattr(side_by_side, "read_objects", lambda path: truth)
        return {line.what: line for line in side_by_side.compare_frames("a", "b", "c")}

    return of


def test_frames_of_two_windows_are_compared_where_both_have_pixels(compare):
    """One scene, cut twice, with a little noise: nothing differs, and stars near the common edge are not compared.

    A star saturated in one frame alone, one twice as bright in it, and one near the edge count nowhere.
    """
    image, x, y = scene()
    none = np.zeros(image.shape, bool)
    brighter = image + np.random.default_rng(5).normal(0, 1, image.shape).astype(np.float32)
    full, kinds = none.copy(), np.where(np.arange(30) < 12, 1, 0).astype(np.int8)
    full[round(y[14]), round(x[14])] = True
    brighter[round(y[20]) - 5 : round(y[20]) + 6, round(x[20]) - 5 : round(x[20]) + 6] *= 2
    truth = objects(x=x + 1000.0, y=y + 200.0, mag=np.full(30, 20.0), obj_type=kinds)
    one = image[15:400, :390], none[15:400, :390], (1000, 1390, 215, 600)
    other = brighter[:, 25:], full[:, 25:], (1025, 1400, 200, 600)
    lines = compare(one, other, truth)
    inside = (x > 25 + 12) & (x < 390 - 13) & (y > 15 + 12) & (y < 387)
    assert 0 < inside.sum() < 30 and inside[[14, 20]].all()
    galaxies = (inside & (kinds == 1)).sum()
    assert lines["flux of galaxies [e-]"].words.endswith(f"of {galaxies}")
    assert lines["flux of points [e-]"].words.endswith(f"of {inside.sum() - galaxies - 2}")
    for what, most in (
        ("flux of points [e-]", 1e-4), ("flux of galaxies [e-]", 1e-4), ("positions along x [px]", 1e-3),
        ("positions along y [px]", 1e-3), ("positions, median [px]", 2e-3), ("background [e-]", 2e-3),
    ):  # fmt: skip
        assert lines[what].difference == pytest.approx(0, abs=most), what


def test_position_differences_are_second_frame_minus_first(compare):
    """Down by 0.04 px and galaxies 3% fainter, in frames of little noise."""
    first, y, x = scene(noise=1.0)
    second = scene(noise=1.0, shift=-0.04, light=0.97, seed=2)[0]
    none, window = np.zeros(first.shape, bool), (0, 400, 0, 400)
    truth = objects(x=x, y=y, mag=np.full(30, 20.0), obj_type=np.ones(30, np.int8))
    one, other = ((np.ascontiguousarray(image.T), none, window) for image in (first, second))
    lines = compare(one, other, truth)
    assert lines["positions along y [px]"].difference == pytest.approx(-0.04, abs=2e-3)
    assert lines["positions along x [px]"].difference == pytest.approx(0.0, abs=2e-3)
    assert lines["positions, median [px]"].difference == pytest.approx(0.04, abs=2e-3)
    assert lines["flux of galaxies [e-]"].difference == pytest.approx(-0.03, abs=1e-3)
    total, after, _, number = lines["flux of galaxies [e-]"].words.split()
    assert float(total) == pytest.approx(30 * 2e5, rel=2e-3) and float(after) == pytest.approx(0.97 * 6e6, rel=2e-3)
    assert number == "30"


@pytest.mark.parametrize(("keys", "angle"), [
    ({"POS_ANG0": 10.0, "POS_ANG1": 20.0}, 10.0), ({"POS_ANG1": 20.0}, 20.0),
    ({"POS_ANG0": "x", "POS_ANG1": 20.0}, 20.0),
    ({"POS_ANG0": 0.0, "CD1_1": 0.0, "CD1_2": 1.0}, 0.0), ({"CD1_1": 0.0, "CD1_2": 0.0}, 0.0),
])  # fmt: skip
def test_the_angle_is_that_of_the_start(keys, angle):
    """A stated one counts before the matrix; a matrix of zeros has none."""
    assert header(CRVAL1=1.0, CRVAL2=2.0, **keys).exposure["pa"] == angle


def test_the_edge_of_an_image_that_is_not_square():
    """Objects more than 12 px from what was read, along both axes; 80 x 50 px."""
    images = [np.random.default_rng(k).normal(0, 1, (50, 80)).astype(np.float32) for k in (1, 2)]
    x, y = np.array([12.1, 11.9, 66.9, 67.1, 40, 40, 40, 40]), np.array([25, 25, 25, 25, 12.1, 11.9, 36.9, 37.1])
    seen = side_by_side._Objects(
        images, np.zeros((50, 80), bool), [Level(0.0, 1.0)] * 2, x, y, np.arange(8, dtype=np.int8)
    )
    assert seen._kinds.tolist() == [0, 2, 4, 6]


@pytest.mark.parametrize(("noises", "compared"), [((1.0, 1.0), True), ((1.0, 30.0), False), ((30.0, 1.0), False)])
def test_an_object_is_compared_if_both_frames_show_it(noises, compared):
    """2000 electrons in a circle of 113 px: an S/N of 43 at a noise of 1, of 6 at one of 30."""
    image = np.zeros((60, 60), np.float32)
    image[30, 30] = 2000.0
    levels = [Level(0.0, noise) for noise in noises]
    at = np.array([30.0])
    lines = side_by_side._Objects([image, image], image < 0, levels, at, at, np.zeros(1, np.int8)).fluxes()
    assert bool(list(lines)) is compared


def test_the_sky_is_the_background_less_dark_current_and_faint_objects(monkeypatch):
    """Levels by hand: 100 e-, 3 of them dark current, 0.8 of the light counted, 1 e- of objects too faint to be seen.

    With a noise of 4 e- objects below 5 x 4 x sqrt(50) = 141 e- are; one of 15,000 e- lies in the left quarter.
    """
    electrons = np.where(np.indices((60, 60)).sum(axis=0) % 2, 104.0, 96.0).astype(np.float32)
    electrons[20:40, 5:15] += 5000.0
    electrons[0, :5] = 1e5
    seen = SimpleNamespace(electrons=electrons, saturated=electrons > 5e4)
    monkeypatch.setattr(recreate, "read_electrons", lambda head, detector: seen)
    asked, lost = {}, {}
    monkeypatch.setattr(
        "csstsim.optics.throughput.response.response_map", lambda *_, **how: lost.update(how) or np.array([0.7, 0.9])
    )

    def around(job, columns, times):
        asked["times"] = times
        return np.indices((60, 60))[1] < 15

    monkeypatch.setattr(recreate, "_object_mask", around)
    filter_ = SimpleNamespace(zeropoint=lambda telescope: 25.0)
    job = SimpleNamespace(
        chip=SimpleNamespace(filter="R"), window=None, exposure=SimpleNamespace(exptime=150.0, filter=filter_)
    )
    camera = SimpleNamespace(detector=SimpleNamespace(dark=0.02), telescope=None, leds=None)
    steps = {"SCIE": SimpleNamespace(losses=SimpleNamespace(flat=True, shutter=True))}
    run = SimpleNamespace(camera=camera, steps=steps, streams=lambda job: SimpleNamespace(camera=None))
    head = SimpleNamespace(notes=[], path="x.fits")
    mags = 25.0 - 2.5 * np.log10(np.array([15_000.0, *[100.0] * 36]) / 150)
    rate = recreate._sky(head, run, job, {"mag_r": mags})
    assert rate == pytest.approx((97 / 0.8 - 1.0) / 150, rel=1e-6)
    assert asked["times"][[0, 1]] == pytest.approx([15_000 / 141.42, 100 / 141.42], rel=0.02)
    assert head.notes == [f"SKYRATE: sky of the frame's background, 100.00 e-: {rate:.4f} e-/s/px"]
    seen.electrons[~seen.saturated] = 100.0  # a frame without noise counts as one of 1 e-
    recreate._sky(head, run, job, {"mag_r": mags})
    assert asked["times"][[0, 1]] == pytest.approx(np.array([15_000, 100]) / (5 * 1.0 * np.sqrt(50)), rel=1e-9)
    monkeypatch.setattr(recreate, "_object_mask", lambda *_: np.ones((60, 60), bool))
    crowded = recreate._sky(head, run, job, {"mag_r": mags})  # no pixel is away from objects: all are taken
    assert crowded == pytest.approx(97 / 0.8 / 150, rel=1e-6)
    for flat, shutter in ((True, False), (False, True)):
        steps["SCIE"].losses = SimpleNamespace(flat=flat, shutter=shutter)
        recreate._sky(head, run, job, {"mag_r": mags})
        assert (lost["flat"] is not None, lost["shutter"]) == (flat, shutter)
    seen.saturated[:] = True
    with pytest.raises(InputError, match="every pixel is saturated"):
        recreate._sky(head, run, job, {"mag_r": mags})
