"""Header values of the orbit and of the channels, against closed forms and by name."""

from datetime import UTC, datetime
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from astropy.io import fits

from csstsim import __version__
from csstsim.base.errors import InputError
from csstsim.base.units import EARTH_GM_KM3_S2, EARTH_RADIUS_KM
from csstsim.instrument.chip import Window
from csstsim.io.keywords import (
    _exposure,
    _readout_speed,
    header_cards,
    header_values,
    recorded_recipe,
)
from csstsim.io.level0 import Level0
from csstsim.optics.sky.directions import telescope_axes


@pytest.mark.parametrize("exptime", [0.0, 150.0, 1500.0])
def test_a_circular_orbit_goes_on_during_the_exposure(make_pointing, exptime):
    """By its mean motion: position, velocity and height at the end, to a metre."""
    radius = EARTH_RADIUS_KM + 400.0
    speed = np.sqrt(EARTH_GM_KM3_S2 / radius)
    pointing = make_pointing(
        exptime=exptime, sat_position=(radius, 0.0, 0.0), sat_velocity=(0.0, 0.6 * speed, 0.8 * speed)
    )
    values = _exposure(pointing)
    turn = speed / radius * exptime
    position = radius * np.array([np.cos(turn), 0.6 * np.sin(turn), 0.8 * np.sin(turn)])
    velocity = speed * np.array([-np.sin(turn), 0.6 * np.cos(turn), 0.8 * np.cos(turn)])
    for k, axis in enumerate("xyz"):
        assert values[f"position_end_{axis}"] == pytest.approx(position[k], abs=1e-3)
        assert values[f"velocity_end_{axis}"] == pytest.approx(velocity[k], abs=1e-6)
        assert values[f"position_start_{axis}"] == pointing.sat_position[k]
    assert values["altitude_start"] == pytest.approx(400.0) and values["altitude_end"] == pytest.approx(400.0, abs=1e-3)
    assert (values["mjd_end"] - values["mjd_start"]) * 86400 == pytest.approx(exptime, abs=1e-4)


def test_a_bias_in_electrons_is_said_in_dn(camera, make_pointing):
    state = SimpleNamespace(
        header={"bias": [500.0, 480.0], "gain": [1.1, 1.2]}, pointing=make_pointing(), chip=camera.chips[9],
        window=SimpleNamespace(x0=0, x1=10, y0=5, y1=20), mask=None, telescope=camera.telescope,
        wcs=SimpleNamespace(distortion=None),
    )  # fmt: skip
    values = header_values(state, {}, "channels")
    assert values["bias_adu"] == pytest.approx([500 / 1.1, 400.0])
    assert [values[f"window_{end}"] for end in ("x_first", "x_last", "y_first", "y_last")] == [1, 10, 6, 20]


def test_the_terms_of_the_nonlinearity_are_told_apart():
    header = {"NLQ01": -1e-7, "NLC01": 2e-13, "NLQ02": -3e-7, "NLC02": 4e-13, "NLQ03": 1.0, "GAIN01": 1.1}
    file = Level0(Path("x.fits"), {}, header, SimpleNamespace(n_channels=3), "channels", None)
    assert file.nonlinearity == {1: (-1e-7, 2e-13), 2: (-3e-7, 4e-13)}
    assert file.gain == {1: 1.1}


PLACES = [(0.0, 0.0), (359.9999999, -89.99), (60.0, -40.0), (244.98765, 12.00001), (0.0, 90.0), (15.0, -0.001)]


@pytest.mark.parametrize(("ra", "dec"), PLACES)
def test_the_target_is_the_designation_of_the_place(make_pointing, ra, dec):
    """Truncated, as the IAU wants it: against astropy, whose digits are rounded, within one of the last."""
    from astropy import units as u
    from astropy.coordinates import SkyCoord

    found = _exposure(make_pointing(ra=ra, dec=dec))["target"]
    parts = found[1:3], found[3:5], found[5:9], found[9:12], found[12:14], found[14:]
    position = SkyCoord("{} {} {} {} {} {}".format(*parts), unit=(u.hourangle, u.deg))
    assert found[0] == "J" and len(found) == 16
    assert 0 <= ra - position.ra.deg < 0.1 / 240 + 1e-7
    assert 0 <= abs(dec) - abs(position.dec.deg) < 1 / 3600 + 1e-7
    assert (found[9] == "-") is (dec < 0)


@pytest.mark.parametrize(("ra", "dec"), PLACES)
@pytest.mark.parametrize("pa", [0.0, -113.4333, 180.0])
def test_the_attitude_turns_the_axes_onto_the_telescope(make_pointing, ra, dec, pa):
    """By scipy's rotations: x to the boresight, y to mosaic +x, z to mosaic +y."""
    from scipy.spatial.transform import Rotation

    values = _exposure(make_pointing(ra=ra, dec=dec, pa=pa))
    turn = Rotation.from_euler("ZYX", [values[f"euler_{k}"] for k in (1, 2, 3)], degrees=True).as_matrix()
    np.testing.assert_allclose(turn.T[[1, 2, 0]], telescope_axes(ra, dec, pa), atol=1e-12)


def test_a_channel_is_read_in_the_readout_time(camera):
    detector = camera.detector
    assert _readout_speed(detector) * detector.readout_time == pytest.approx(1250 * 4700 / 1e6)


@pytest.mark.parametrize("kind", ["SCIE", "BIAS", "DARK", "FLAT"])
def test_the_shutter_opens_to_the_sky_alone(make_pointing, kind):
    assert _exposure(make_pointing(type=kind))["shutter"] is (kind == "SCIE")


@pytest.fixture
def small_state(small, make_pointing):
    """A window of one channel's corner, of a frame that has a mask."""
    return SimpleNamespace(
        header={}, pointing=make_pointing(), chip=small.chips[9], window=Window(40, 50, 5, 9), mask=np.zeros((4, 10)),
        telescope=small.telescope, wcs=SimpleNamespace(distortion="some"),
    )  # fmt: skip


def test_what_is_said_of_the_exposure(make_pointing):
    moved = {"sat_position": (7000.0, -300.0, 20.0), "sat_velocity": (1.0, 5.0, -6.0)}
    values = _exposure(make_pointing(type="DARK", survey="DEEP", exptime=150.25, **moved))
    stated = {name: values[name] for name in ("type", "ra", "dec", "pa", "exptime", "survey", "time_start", "time_end")}
    assert stated == {
        "type": "DARK", "ra": 60.0, "dec": -40.0, "pa": -113.4333, "exptime": 150.25, "survey": "DEEP",
        "time_start": "2027-06-26T20:35:58.000", "time_end": "2027-06-26T20:38:28.250",
    }  # fmt: skip
    assert [values[f"{what}_start_{axis}"] for what in ("position", "velocity") for axis in "xyz"] == [
        7000.0, -300.0, 20.0, 1.0, 5.0, -6.0,
    ]  # fmt: skip
    assert values["altitude_start"] == pytest.approx(np.sqrt(7000**2 + 300**2 + 20**2) - 6378.137)
    assert values["mjd_start"] == pytest.approx(61582 + (20 * 3600 + 35 * 60 + 58) / 86400, abs=1e-8)
    assert _exposure(make_pointing())["survey"] is None


def test_what_is_said_of_the_detector(small_state):
    """By the numbers of mini.py, those of x unlike those of y."""
    values = header_values(small_state, {}, "channels")
    detector = small_state.chip.detector
    assert (detector.nx, detector.ny, detector.channels_x, detector.channels_y) == (256, 64, 8, 2)
    wanted = {
        "detector_size": "[1:256,1:64]", "channels": 16, "prescan": 3, "overscan": 7, "parallel_overscan": 4,
        "window_x_first": 41, "window_x_last": 50, "window_y_first": 6, "window_y_last": 9, "extensions": 2,
        "chip_label": "09", "filter": "r", "layout": "channels", "field_dist": True, "bias_adu": None,
        "temperature": detector.temperature, "readout_time": detector.readout_time, "adc_max": 65535,
        "pixel_scale": 0.074, "pixel_um": 10.0,
    }  # fmt: skip
    assert {name: values[name] for name in wanted} == wanted
    small_state.mask, small_state.wcs.distortion = None, None
    values = header_values(small_state, {}, "chip")
    assert (values["extensions"], values["field_dist"], values["overscan"], values["prescan"]) == (1, False, 0, 0)


def test_what_is_said_of_the_simulation(small_state):
    """Each part of the provenance under its own name; what is not given is None."""
    provenance = {
        "recipe": {"campaign": "1", "camera": "2", "layers": "3", "exposure": "4"}, "obsid": "5", "filename": "6",
        "campaign_name": "7", "seed": 8, "truth_hash": "9", "psf_hash": "10", "ephemeris": "11", "planets": True,
        "layers": [{"a": {"y": 1, "x": None}}, {"b": None}], "camera": {"detector.gain": 1.5},
        "stages": [["select", 1.00049, 2.0], ["readout", 3.0, 4.0006]],
    }  # fmt: skip
    small_state.header = {"own": ["mine"], "mine": [1, 2], "gain": [1.5], "saturated": 3}
    values = header_values(small_state, provenance, "channels")
    wanted = {
        "campaign_hash": "1", "camera_hash": "2", "layers_hash": "3", "exposure_hash": "4", "obsid": "5",
        "filename": "6", "campaign_name": "7", "seed": 8, "truth_hash": "9", "psf_hash": "10", "ephemeris": "11",
        "planets": True, "wall_select": 1.0, "cpu_select": 2.0, "wall_readout": 3.0, "cpu_readout": 4.001,
        "wall_render": None, "cpu_level0": None, "saturated": 3, "bias": None, "bias_adu": None,
        "version": __version__, "software": f"csstsim {__version__}",
        "layers": [
            'layer a {"x": null, "y": 1}', "layer b null", "camera detector.gain = 1.5", "value mine = [1, 2]",
        ],
    }  # fmt: skip
    assert {name: values[name] for name in wanted} == wanted
    header = {"CAMPHASH": "1", "CAMHASH": "2", "LAYHASH": "3", "EXPHASH": "4", "SIMVER": "0.7.12"}
    assert recorded_recipe(header) == provenance["recipe"] | {"csstsim": "0.7"}
    assert recorded_recipe({}) == dict.fromkeys(("campaign", "camera", "layers", "exposure", "csstsim"))


def test_the_date_is_that_of_now_in_utc(small_state):
    before = datetime.now(UTC).replace(microsecond=0, tzinfo=None)
    date = datetime.fromisoformat(header_values(small_state, {}, "channels")["date"])
    assert before <= date <= datetime.now(UTC).replace(tzinfo=None)


def test_the_cards_of_a_table_in_its_order():
    """Of one HDU alone, a list's values under their channels' numbers, those without a value left out."""
    table = [
        {"hdu": 1, "keyword": "OTHER", "constant": 1}, {"hdu": 0, "block": "Of the chip"},
        {"hdu": 0, "keyword": "Z", "constant": 2.5, "comment": "of it"}, {"hdu": 0, "keyword": "NONE", "from": "none"},
        {"hdu": 0, "keyword": "CH", "from": "list", "repeat": True, "comment": "each"},
        {"hdu": 0, "keyword": "HISTORY", "from": "lines"},
    ]  # fmt: skip
    values = {"none": None, "list": [7, None, 9], "lines": ["one", "two"]}
    header = fits.Header.fromstring("".join(header_cards(table, values, 0)))
    assert [card.keyword for card in header.cards] == [*["COMMENT"] * 3, "Z", "CH01", "CH03", *["HISTORY"] * 2]
    assert (header["Z"], header["CH01"], header["CH03"]) == (2.5, 7, 9) and header.comments["CH03"] == "each"
    assert list(header["COMMENT"])[1] == " Of the chip" and list(header["HISTORY"]) == [" one", " two"]
    assert "OTHER" in header_cards(table, values, 1)[0] and len(header_cards(table, values, 1)) == 1


def test_a_faulty_entry_is_named_by_its_number_from_1():
    good, bad = {"hdu": 0, "keyword": "A", "constant": 1}, {"hdu": 0, "keyword": "B", "from": "nonsense"}
    with pytest.raises(InputError, match=r"table.yaml: entry 2, B: unknown quantity.*'nonsense'.*allowed: one, two"):
        header_cards([good, bad], {"two": 2, "one": 1}, 1, "table.yaml")
    with pytest.raises(InputError, match="entry 1, A: A: a FITS card cannot hold"):
        header_cards([{"hdu": 0, "keyword": "A", "from": "x"}], {"x": float("nan")}, 0)


SHIPPED_NAMES = {
    "SKYRATE": "sky_rate", "SKYZODI": "sky_zodiacal", "SKYEARTH": "sky_earth", "SKYSUN": "sky_sun",
    "SKYMOON": "sky_moon", "SKYPLAN": "sky_planets", "SKYSTAR": "sky_stars", "SUNANGL0": "sun_angle_start",
    "SUNANGL1": "sun_angle_end", "MOONANG1": "moon_angle_end", "LIMBANG0": "limb_angle_start", "NHOT": "hot_pixels",
    "LIMBSUN1": "limb_sun_angle_end", "SHTOPEN0": "shutter_open_0", "SHTOPEN1": "shutter_open_1",
    "SHTCLOS0": "shutter_close_0", "SHTCLOS1": "shutter_close_1", "NDEAD": "dead_pixels", "NBADCOL": "bad_columns",
    "CRTRACKS": "cosmic_tracks", "CRCOUNT": "cosmic_pixels", "CRCHARGE": "cosmic_electrons", "NSATUR": "saturated",
    "BLOOMOUT": "bloom_lost", "DARKEL": "dark_electrons", "CTITRAP": "cti_trapped", "CTISTRAP": "cti_serial_trapped",
    "CLIPHIGH": "clipped_high", "CLIPLOW": "clipped_low", "GAIN1": "one_gain", "RDNOISE1": "one_read_noise",
    "PRNURMS": "prnu_rms", "BFEAREA": "bfe_area", "CTIDENS": "cti_density",
}  # fmt: skip


def test_each_layers_number_is_under_its_keyword(camera, small_state):
    """Numbers that differ, so that no keyword can state another's; without them the keywords are left out."""
    assert not set(SHIPPED_NAMES) & {card[:8].strip() for k in (0, 1) for card in cards_of(camera, small_state, k)}
    small_state.header = {name: float(number) for number, name in enumerate(SHIPPED_NAMES.values(), 1)}
    headers = [fits.Header.fromstring("".join(cards_of(camera, small_state, k))) for k in (0, 1)]
    found = {key: header[key] for header in headers for key in SHIPPED_NAMES if key in header}
    assert found == {key: float(number) for number, key in enumerate(SHIPPED_NAMES, 1)}


def cards_of(camera, state, hdu):
    return header_cards(camera.keywords, header_values(state, {}, "channels"), hdu)
