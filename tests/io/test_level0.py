"""Level-0 files: header, pixels in both layouts, windows, reading back, and fitsverify."""

import re
import shutil
import subprocess
import time

import numpy as np
import pytest
from astropy.io import fits
from astropy.time import Time
from support.readout_state import flat_state, plain_layers, run

from csstsim.base.errors import InputError
from csstsim.base.shipped import SHIPPED
from csstsim.catalog.astrometry.ephemeris import observer
from csstsim.detector.channels import LAYOUTS, ReadoutFrame
from csstsim.detector.mask import BITS, BLED, CLIPPED, HOT, SATURATED
from csstsim.io.fits import open_fits
from csstsim.io.keywords import header_cards, orbit_after
from csstsim.io.level0 import REQUIRED, read_level0
from csstsim.io.level0_writing import write_level0

STEM = "CSST_MSC_MS_WIDE_20270626203558_20270626203828"
PROVENANCE = {
    "obsid": "10160000004", "filename": f"{STEM}_10160000004_09_L0_V01",
    "recipe": {"campaign": "c0ffee", "camera": "cafe", "layers": "1ee7", "exposure": "beef"},
    "truth_hash": "7", "psf_hash": "9", "seed": 11,
    "campaign_name": "demo's", "layers": [{"scie_obs": {"exptime": None}}, {"gain": {"gain_16channel": True}}],
    "stages": [["render", 12.3456, 10.0], ["level0", 1.0, 0.5]],
}  # fmt: skip
# config/instrument/level0_keywords.yaml promises that two identical runs differ in no other value
VOLATILE = {
    "DATE",
    "CHECKSUM",
    *(f"{clock}_{stage}" for clock in ("CPU", "WALL") for stage in ("SEL", "REN", "RDO", "L0")),
}


def made(camera, path, layout, provenance=PROVENANCE, **fields):
    state = run(flat_state(camera, 300.0, **fields), plain_layers())
    write_level0(path, state, camera.keywords, provenance, layout)
    return state


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("window", [None, (100, 170, 10, 50)])
def test_mask_lies_as_the_image_does(small, tmp_path, layout, window):
    """A pixel of 3 bits, one that the digits clip, and the header's own words for them."""
    state = flat_state(small, 300.0, window=window)
    state.mask = np.zeros(state.image.shape, np.uint8)
    state.mask[3, 5] = SATURATED | BLED | HOT
    state.image[7, 2] = 1e6
    state = run(state, plain_layers())
    write_level0(tmp_path / "x.fits", state, small.keywords, PROVENANCE, layout)
    with fits.open(tmp_path / "x.fits", checksum=True) as hdus:
        assert [hdu.name for hdu in hdus] == ["PRIMARY", "IMAGE", "MASK"]
        assert hdus[0].header["NEXTEND"] == 2
        mask, image = hdus["MASK"].data, hdus["IMAGE"].data
        assert mask.dtype == np.uint8
        assert (image[mask == CLIPPED] == 65535).all()
        assert {hdus["MASK"].header[f"BIT{i}"]: 1 << i for i in range(7)} == BITS
    expected = np.zeros(state.window.shape, np.uint8)
    expected[3, 5], expected[7, 2] = SATURATED | BLED | HOT, CLIPPED
    file = read_level0(tmp_path / "x.fits", verify=True)
    assert np.array_equal(file.mask(), expected)
    assert (mask != 0).sum() == 2


@pytest.mark.parametrize("window", [None, (100, 170, 10, 50)])
def test_compressed_is_the_same(small, tmp_path, window):
    """To the bit, pixels, mask and header; read by our reader and by astropy."""
    state = flat_state(small, 300.0, window=window)
    state.mask = np.zeros(state.image.shape, np.uint8)
    state.mask[3, 5] = HOT
    state = run(state, plain_layers())
    for name, asked in (("plain", False), ("packed", True)):
        state.header["compress"] = asked
        write_level0(tmp_path / f"{name}.fits", state, small.keywords, PROVENANCE, "channels")
    plain, packed = (read_level0(tmp_path / f"{name}.fits", verify=True) for name in ("plain", "packed"))
    assert np.array_equal(plain.frame(), packed.frame())
    assert np.array_equal(plain.assembled(), packed.assembled())
    assert np.array_equal(plain.mask(), packed.mask())
    keys = set(plain.header) - VOLATILE - {"DATASUM", "XTENSION"}
    assert {key: plain.header[key] for key in keys} == {key: packed.header[key] for key in keys}
    time.sleep(1.1)  # nothing in the extensions says when they were written
    write_level0(tmp_path / "again.fits", state, small.keywords, PROVENANCE, "channels")
    with open_fits(tmp_path / "packed.fits") as file:
        first = file["IMAGE"].get_offsets()["header_start"]
    assert (tmp_path / "again.fits").read_bytes()[first:] == (tmp_path / "packed.fits").read_bytes()[first:]
    with fits.open(tmp_path / "plain.fits") as one, fits.open(tmp_path / "packed.fits", checksum=True) as two:
        assert isinstance(two["IMAGE"], fits.CompImageHDU)
        assert np.array_equal(one["IMAGE"].data, two["IMAGE"].data)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_header(small, tmp_path, layout):
    state = made(small, tmp_path / "x.fits", layout)
    with fits.open(tmp_path / "x.fits", checksum=True) as hdus:
        hdus.verify("exception")
        assert [hdu.name for hdu in hdus] == ["PRIMARY", "IMAGE"]
        assert hdus[0].data is None
        first, header = hdus[0].header, hdus[1].header
        assert hdus[1].data.dtype == np.uint16
        assert hdus[1].data.shape == {"channels": (36, 672), "mosaic": (72, 336), "chip": (64, 256)}[layout]
    assert re.fullmatch(r"CSST_MSC_MS_WIDE_\d{14}_\d{14}_10160000004_09_L0_V01", first["FILENAME"])
    assert (first["OBSID"], first["FILETYPE"], first["OBJECT"], first["NEXTEND"]) == (
        "10160000004",
        "SCIE",
        "demo's",
        1,
    )
    start, end = Time(first["DATE-OBS"], scale="utc"), Time(first["DATE-END"], scale="utc")
    assert abs(start.mjd - first["EXPSTART"]) * 86400 < 1e-4
    assert abs(end.mjd - first["EXPEND"]) * 86400 < 1e-4
    assert abs((end - start).sec - first["EXPTIME"]) < 1e-6
    assert (first["RA_PNT0"], first["DEC_PNT1"], first["POS_ANG0"]) == (60.0, -40.0, -113.4333)
    assert (first["SIMSEED"], first["CAMPHASH"], first["CPU_REN"], first["WALL_REN"]) == (11, "c0ffee", 10.0, 12.346)
    assert "CPU_SEL" not in first  # not measured in this run
    assert list(first["HISTORY"]) == [' layer scie_obs {"exptime": null}', ' layer gain {"gain_16channel": true}']
    assert [header[f"GAIN{i:02d}"] for i in range(1, 17)] == state.header["gain"]
    assert [header[f"RON{i:02d}"] for i in range(1, 17)] == [5.0] * 16
    bias = np.divide(state.header["bias"], state.header["gain"])
    assert np.allclose([header[f"DETBIA{i:02d}"] for i in range(1, 17)], bias, rtol=1e-12)
    assert (header["DETSIZE"], header["NCHAN"], header["LAYOUT"], header["BUNIT"]) == (
        "[1:256,1:64]",
        16,
        layout,
        "ADU",
    )
    says = "which is the stored array" if layout == "chip" else "not of the stored array"
    assert f" WCS of the assembled active frame (DETSIZE), {says}" in list(header["COMMENT"])
    assert (header["CLIPHIGH"], header["CLIPLOW"], header["SATURATE"]) == (0, 0, 65535)
    assert set(REQUIRED) <= set(header)


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("window", [None, (31, 34, 10, 40), (255, 256, 63, 64), (0, 256, 0, 32)])
def test_pixels_read_back(small, tmp_path, layout, window):
    path = tmp_path / "x.fits"
    state = made(small, path, layout, window=window)
    level0 = read_level0(path, verify=True)
    w = state.window
    assert level0.window == w
    written = state.image if layout != "chip" else ReadoutFrame.of(state.chip.detector, w).active(state.image)
    assert np.array_equal(level0.frame(), written)
    active = level0.readout.active(written)
    assert np.array_equal(level0.assembled(), active)
    whole = level0.assembled(full=True)
    assert whole.shape == (64, 256)
    assert np.array_equal(whole[w.y0 : w.y1, w.x0 : w.x1], active)
    assert np.count_nonzero(whole) == active.size
    canvas = np.zeros_like(whole)
    for channel, block in zip(level0.channels(), level0.readout.blocks, strict=True):
        c = channel.window
        canvas[c.y0 : c.y1, c.x0 : c.x1] = channel.active
        assert np.array_equal(channel.serial_overscan, written[block.serial_overscan])
        assert np.array_equal(channel.prescan, written[block.prescan])
        assert np.array_equal(channel.parallel_overscan, written[block.parallel_overscan])
        assert channel.gain == state.header["gain"][channel.number - 1] == level0.gain[channel.number]
        assert channel.read_noise == 5.0
    assert np.array_equal(canvas, whole)


def test_pixels_not_read_are_zero(small, tmp_path):
    made(small, tmp_path / "x.fits", "channels", window=(40, 50, 5, 9))
    data = fits.getdata(tmp_path / "x.fits", "IMAGE")
    assert np.count_nonzero(data) == (10 + 3 + 7) * (
        4 + 4
    )  # window + prescan + overscan columns x window + overscan rows
    assert not data[:, :42].any() and not data[:, 84:].any()  # only channel 2 was touched


def test_two_runs_differ_only_where_promised(small, tmp_path):
    later = PROVENANCE | {"stages": [["render", 2.0, 1.0], ["level0", 3.0, 2.0]]}
    for name, provenance in (("a", PROVENANCE), ("b", later)):
        made(small, tmp_path / f"{name}.fits", "channels", provenance)
    one, other = (fits.open(tmp_path / f"{name}.fits") for name in "ab")
    with one, other:
        differ = {k for k in one[0].header if str(one[0].header[k]) != str(other[0].header[k])}
        assert differ and differ <= VOLATILE
        assert repr(one[1].header) == repr(other[1].header)  # CHECKSUM and DATASUM included
        assert np.array_equal(one[1].data, other[1].data)


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("obsid", ["10160000004", "10109200100412"], ids=["11 digits", "14 digits"])
def test_fitsverify(small, tmp_path, layout, obsid):
    if shutil.which("fitsverify") is None:
        pytest.skip("fitsverify (Debian package of that name) is not installed")
    made(small, tmp_path / "x.fits", layout, PROVENANCE | {"obsid": obsid, "filename": f"{STEM}_{obsid}_09_L0_V01"})
    answer = subprocess.run(["fitsverify", tmp_path / "x.fits"], capture_output=True, text=True, check=False)
    assert "0 warning(s) and 0 error(s)" in answer.stdout, answer.stdout
    if len(obsid) == 14:  # its FILENAME needs a CONTINUE card
        assert fits.getheader(tmp_path / "x.fits")["FILENAME"].endswith("_10109200100412_09_L0_V01")


def test_files_that_cannot_be_read(small, tmp_path):
    with pytest.raises(InputError, match="no such file"):
        read_level0(tmp_path / "none.fits")
    made(small, tmp_path / "x.fits", "channels")
    content = (tmp_path / "x.fits").read_bytes()
    for length in (0, 500, 2880, len(content) - 2880, len(content) - 1):
        (tmp_path / "cut.fits").write_bytes(content[:length])
        with pytest.raises(InputError, match=r"cut.fits"):
            read_level0(tmp_path / "cut.fits")
    changed = bytearray(content)
    changed[-5000] ^= 4
    (tmp_path / "bit.fits").write_bytes(changed)
    read_level0(tmp_path / "bit.fits")
    with pytest.raises(InputError, match=r"bit.fits: HDU IMAGE: the file is damaged"):
        read_level0(tmp_path / "bit.fits", verify=True)
    foreign = fits.HDUList([fits.PrimaryHDU(), fits.ImageHDU(np.zeros((4, 4)), name="SCI")])
    foreign.writeto(tmp_path / "foreign.fits")
    with pytest.raises(InputError, match="no IMAGE extension"):
        read_level0(tmp_path / "foreign.fits")
    foreign[1].name = "IMAGE"
    foreign.writeto(tmp_path / "foreign.fits", overwrite=True)
    with pytest.raises(InputError, match=r"keywords are missing.*NCHAN"):
        read_level0(tmp_path / "foreign.fits")


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [("LAYOUT", "tiles", "unknown layout"), ("READX1", 999, "is inconsistent"), ("OSCAN1", 8, "not the pixels"),
     ("DETSIZE", "big", "is inconsistent")],
)  # fmt: skip
def test_headers_that_contradict_the_pixels(small, tmp_path, key, value, message):
    made(small, tmp_path / "x.fits", "channels")
    with fits.open(tmp_path / "x.fits", mode="update") as hdus:
        hdus["IMAGE"].header[key] = value
    with pytest.raises(InputError, match=message):
        read_level0(tmp_path / "x.fits")


def test_damaged_headers_are_input_errors(small, tmp_path):
    """40 headers with a byte or a card changed: read as they are, or refused; nothing else."""
    made(small, tmp_path / "x.fits", "channels")
    content, rng, refused = (tmp_path / "x.fits").read_bytes(), np.random.default_rng(4), 0
    with fits.open(tmp_path / "x.fits") as hdus:
        headers = [(info["hdrLoc"], info["datLoc"]) for info in (hdu.fileinfo() for hdu in hdus)]
    for _ in range(40):
        damaged, position = bytearray(content), rng.integers(*headers[rng.integers(2)])
        card = position // 80 * 80
        if rng.random() < 0.5:
            damaged[card + 10 : card + 80] = b"'spam'".ljust(70)
        else:
            damaged[position] |= 0x80  # no ASCII
        (tmp_path / "y.fits").write_bytes(damaged)
        try:
            file = read_level0(tmp_path / "y.fits")
            assert file.assembled().shape == file.window.shape and len(file.gain) <= 16
        except InputError as error:
            assert "y.fits" in str(error)
            refused += 1
    assert refused > 3


def test_undigitised_states_are_refused(small, tmp_path):
    state = run(flat_state(small), plain_layers(off=["quantization_and_output"]))
    with pytest.raises(ValueError, match="quantization_and_output is missing"):
        write_level0(tmp_path / "x.fits", state, small.keywords, PROVENANCE)
    assert not list(tmp_path.iterdir())


def test_layers_left_out_leave_their_keywords_out(small, tmp_path):
    state = run(flat_state(small), plain_layers(off=["readout_noise", "bias"]))
    write_level0(tmp_path / "x.fits", state, small.keywords, {})
    header = fits.getheader(tmp_path / "x.fits", "IMAGE")
    assert "GAIN01" in header and "RON01" not in header and "DETBIA01" not in header


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ({"hdu": 2, "keyword": "A", "constant": 1}, "entry 1"),
        ({"hdu": 0, "keyword": "A", "constant": 1, "x": 1}, "entry 1"),
        ({"hdu": 0, "keyword": "A"}, "constant or from"),
        ({"hdu": 0, "block": "A", "constant": 1}, "constant or from"),
        ({"hdu": 0, "keyword": "A", "from": "nonsense"}, "allowed: gain"),
        ({"hdu": 0, "keyword": "low", "constant": 1}, "keyword"),
    ],
)
def test_faulty_tables(entry, message):
    with pytest.raises(InputError, match=message):
        header_cards([entry], {"gain": [1.0]}, 0)


def test_every_shipped_entry_fits_one_card(small):
    """No comment of the shipped table is cut, and no keyword stands twice in an HDU."""
    names = [(e["hdu"], e["keyword"]) for e in small.keywords if "keyword" in e]
    assert len(names) == len(set(names))
    assert all(len(entry.get("comment", "")) <= 47 for entry in small.keywords)
    assert (SHIPPED / "instrument" / "level0_keywords.yaml").exists()


def test_satellite_at_the_end_of_the_exposure():
    """A circular orbit turns by its mean motion (1 m, 1 mm/s); an ellipse keeps energy and angular momentum."""
    radius, gm = 6778.137, 398_600.4418
    speed = np.sqrt(gm / radius)
    angle = speed / radius * 250.0
    position, velocity = orbit_after((radius, 0.0, 0.0), (0.0, 0.0, speed), 250.0)
    assert np.allclose(position, [radius * np.cos(angle), 0, radius * np.sin(angle)], atol=1e-3, rtol=0)
    assert np.allclose(velocity, [-speed * np.sin(angle), 0, speed * np.cos(angle)], atol=1e-6, rtol=0)
    start = np.array([7000.0, 100.0, -30.0]), np.array([0.5, 6.0, 5.0])
    assert orbit_after(*start, 0.0) == (tuple(start[0]), tuple(start[1]))
    r, v = (np.array(a) for a in orbit_after(*start, 300.0))
    energy = [u @ u / 2 - gm / np.linalg.norm(x) for x, u in (start, (r, v))]
    assert abs(energy[0] - energy[1]) < 1e-9
    assert np.allclose(np.cross(*start), np.cross(r, v), rtol=1e-11)


def test_the_spacecraft_is_in_the_header_or_missed(small, tmp_path):
    known = PROVENANCE | {"ephemeris": "builtin", "planets": True}
    pointing = made(small, tmp_path / "x.fits", "channels", provenance=known).pointing
    craft = read_level0(tmp_path / "x.fits").observer
    same = observer(pointing.mjd, pointing.sat_position, pointing.sat_velocity, "builtin", True)
    set_by_apcs = "eb", "eh", "em", "v"  # others hold whatever was in memory
    assert all((craft.astrom[name] == same.astrom[name]).all() for name in set_by_apcs) and len(craft.bodies) == 4
    made(small, tmp_path / "old.fits", "channels")
    with pytest.raises(InputError, match="EPHEM"):
        _ = read_level0(tmp_path / "old.fits").observer


def test_numbers_of_each_channel_are_its_own(small, tmp_path):
    """Each keyword of each channel has a number of its own; a channel without one is left out."""
    path = tmp_path / "x.fits"
    made(small, path, "channels", window=(30, 66, 30, 34))
    with fits.open(path, mode="update", checksum=True) as file:
        for n in range(1, 17):
            for k, name in enumerate(("GAIN", "DETBIA", "RON", "NLQ", "NLC")):
                file["IMAGE"].header[f"{name}{n:02d}"] = 100.0 * k + n
        del file["IMAGE"].header["RON02"], file["IMAGE"].header["NLQ16"], file["IMAGE"].header["GAIN03"]
    file = read_level0(path, verify=True)
    assert file.gain == {n: float(n) for n in range(1, 17) if n != 3}
    assert file.levels == {n: (100.0 + n, 200.0 + n) for n in range(1, 17) if n != 2}
    assert file.nonlinearity == {n: (300.0 + n, 400.0 + n) for n in range(1, 16)}
    wanted = {  # by hand: columns 30 to 65 of channels of 32 x 32, lower half from the left, upper from the right
        1: (30, 32, 30, 32), 2: (32, 64, 30, 32), 3: (64, 66, 30, 32), 14: (64, 66, 32, 34), 15: (32, 64, 32, 34),
        16: (30, 32, 32, 34),
    }  # fmt: skip
    channels = {channel.number: channel for channel in file.channels()}
    assert {n: (c.window.x0, c.window.x1, c.window.y0, c.window.y1) for n, c in channels.items()} == wanted
    assert (channels[3].gain, channels[3].bias, channels[3].read_noise) == (None, 103.0, 203.0)
    assert (channels[2].gain, channels[2].bias, channels[2].read_noise) == (2.0, 102.0, None)
    assert (channels[2].prescan.shape, channels[2].serial_overscan.shape) == ((2, 3), (2, 7))
    assert channels[2].parallel_overscan.shape == (4, 32)


@pytest.mark.parametrize(("key", "value"), [("GAIN05", "many"), ("NLC02", "x")])
def test_a_word_for_a_number_is_named(small, tmp_path, key, value):
    made(small, tmp_path / "x.fits", "channels")
    with fits.open(tmp_path / "x.fits", mode="update", checksum=True) as file:
        file["IMAGE"].header[key] = value
    file = read_level0(tmp_path / "x.fits")
    with pytest.raises(InputError, match=rf"x\.fits: {key}: must be a number \(got '{value}'\)"):
        file.per_channel(key[:-2])


def test_a_mask_of_another_shape_is_refused(small, tmp_path):
    made(small, tmp_path / "x.fits", "channels")
    assert read_level0(tmp_path / "x.fits").mask() is None
    fits.append(tmp_path / "x.fits", np.zeros((36, 671), np.uint8), fits.Header({"EXTNAME": "MASK"}))
    with pytest.raises(InputError, match=r"MASK: not of the image's shape \(got \(36, 671\)\)"):
        read_level0(tmp_path / "x.fits").mask()


@pytest.mark.parametrize("size", ["[1:256,1:64]", "256 x 64"])
def test_both_forms_of_the_size_are_read(small, tmp_path, size):
    made(small, tmp_path / "x.fits", "channels")
    with fits.open(tmp_path / "x.fits", mode="update") as file:
        file["IMAGE"].header["DETSIZE"] = size
    readout = read_level0(tmp_path / "x.fits").readout
    assert (readout.nx, readout.ny, readout.channel_nx, readout.channel_ny) == (256, 64, 32, 32)
    assert (readout.prescan, readout.overscan, readout.parallel_overscan, readout.n_channels) == (3, 7, 4, 16)


def test_the_sky_of_a_mosaics_channels_is_said_to_be_theirs(small, tmp_path):
    """Letters and names of channels, the remarks, and no letters where the distortion or the layout forbids them."""
    made(small, tmp_path / "x.fits", "mosaic")
    header = fits.getheader(tmp_path / "x.fits", "IMAGE")
    assert {header[f"WCSNAME{letter}"]: letter for letter in "ABCDEFGHIJKLMNOP"} == {
        f"channel {n}": "ABCDEFGHIJKLMNOP"[n - 1] for n in range(1, 17)
    }  # fmt: skip
    remarks = " ".join(header["COMMENT"])
    assert header["WCSNAME"] == "assembled frame" and "apparent" in remarks and "distortion" not in remarks
    made(small, tmp_path / "y.fits", "chip")
    assert "WCSNAMEA" not in fits.getheader(tmp_path / "y.fits", "IMAGE")
