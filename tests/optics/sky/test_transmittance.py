"""Point-source transmittance and the aperture door: nodes, the laws between them, and closed forms."""

import math
from dataclasses import replace

import numpy as np
import pytest
from support.sky_geometry import AHEAD, numbers

from csstsim.base.errors import InputError
from csstsim.optics.sky.aperture_door import scattered, shade, solid_angle, zenith_angle
from csstsim.optics.sky.parameters import sky_numbers
from csstsim.optics.sky.transmittance import azimuth_from, total, transmittance

N = numbers()
DOOR = N.door


def beam(zenith, azimuth):
    z, a = np.radians(zenith), np.radians(azimuth)
    return np.stack([np.sin(z) * np.sin(a), np.sin(z) * np.cos(a), np.cos(z)], axis=-1)


def test_nodes_wrap_and_ends():
    zenith, azimuth = np.meshgrid(N.transmittance.zenith, N.transmittance.azimuth, indexing="ij")
    for turn in (0.0, 360.0, -360.0):
        assert np.allclose(transmittance(zenith, azimuth + turn, N), N.transmittance.matrix, rtol=1e-12)
    assert transmittance(np.array([0.0, 0.04]), np.zeros(2), N) == pytest.approx(N.transmittance.matrix[0, 0])
    assert transmittance(np.array([90.001, 180.0]), np.zeros(2), N).tolist() == [0.0, 0.0]


def test_bilinear_in_the_logarithm():
    middle = transmittance(math.sqrt(N.transmittance.zenith[4] * N.transmittance.zenith[5]), 45.0, N)
    assert middle == pytest.approx(np.exp(np.log(N.transmittance.matrix[4:6, 0:2]).mean()))
    (row,) = N.transmittance.matrix[N.transmittance.zenith == 5.0]
    across = transmittance(5.0, 315.0, N)  # between the last azimuth and the first
    assert across == pytest.approx(math.sqrt(row[3] * row[0]))


def test_falls_away_from_the_line_of_sight():
    value = transmittance(np.linspace(0.1, 90, 500), np.full(500, 10.0), N)
    assert (np.diff(value) < 0).all()


def test_door_shades_what_it_should():
    turn, size = math.radians(DOOR.opening_deg - 90), DOOR.length_m
    first = math.degrees(turn)  # parallel to the door
    last = math.degrees(math.atan((2 * DOOR.tube_radius_m + size * math.sin(turn)) / (size * math.cos(turn))))
    half = math.degrees(math.atan((DOOR.tube_radius_m + size * math.sin(turn)) / (size * math.cos(turn))))
    assert last < 50  # the survey's Sun limit
    assert shade(np.array([0, first, half, last, 89.9, 90.1, 180]), 30.0, 30.0, DOOR) == pytest.approx(
        [0, 0, 0.5, 1, 1, 0, 0], abs=1e-9
    )
    beside = DOOR.half_width_deg + 1
    assert shade(60.0, 30.0 + beside, 30.0, DOOR) == shade(60.0, 210.0, 30.0, DOOR) == 0


def test_door_scatters_what_meets_its_inside():
    behind = scattered(np.array([30.0, 60.0, 89.0, 120.0]), 0.0, 0.0, DOOR)
    assert behind.tolist() == [0.0] * 4  # from the door's own side, on its outside
    face_on = scattered(90.0 - (DOOR.opening_deg - 90), 180.0, 0.0, DOOR)
    assert face_on == pytest.approx(DOOR.albedo / math.pi * solid_angle(DOOR))
    below = scattered(np.array([95.0, 110.0, 130.0, 140.0, 179.0]), 180.0, 0.0, DOOR)
    assert (np.diff(below) <= 0).all() and below[0] > 0 and below[-2:].tolist() == [0.0, 0.0]  # the far rim's shadow


def test_doors_solid_angle_against_its_integral():
    """A flat rectangle 2R wide, integrated over its face: the formula for a small surface is good to 20%."""
    turn = math.radians(DOOR.opening_deg - 90)
    up, side = np.meshgrid((np.arange(200) + 0.5) / 200 * DOOR.length_m, ((np.arange(200) + 0.5) / 100 - 1))
    x, y, z = DOOR.tube_radius_m + up * math.sin(turn), side * DOOR.tube_radius_m, up * math.cos(turn)
    far = np.sqrt(x**2 + y**2 + z**2)
    cosine = (x * math.cos(turn) - z * math.sin(turn)) / far
    exact = np.mean(cosine / far**2) * 2 * DOOR.tube_radius_m * DOOR.length_m
    assert solid_angle(DOOR) == pytest.approx(exact, rel=0.2)


def test_total_is_direct_and_scattered():
    sources = beam(np.array([60.0, 60.0, 95.0, 60.0]), np.array([180.0, 0.0, 180.0, 90.0]))
    free, closed, below, beside = total(sources, AHEAD, 0.0, N)[0]
    off = transmittance(zenith_angle(DOOR), 0.0, N)
    assert closed == 0.0
    assert free == pytest.approx(transmittance(60.0, 180.0, N) + off * scattered(60.0, 180.0, 0.0, DOOR))
    assert below == pytest.approx(off * scattered(95.0, 180.0, 0.0, DOOR))
    assert beside == pytest.approx(transmittance(60.0, 90.0, N) + off * scattered(60.0, 90.0, 0.0, DOOR))


def test_angle_is_from_the_line_of_sight():
    """A source 1 deg off the boresight and 0.5 deg off a pixel's line of sight: inverse square, 4 times brighter."""
    one, other = total(beam(np.array([1.0]), np.array([0.0])), beam(np.array([0.0, 0.5]), np.zeros(2)), 180.0, N)
    assert other[0] / one[0] == pytest.approx(4.0, rel=0.02)


def test_moonlight_within_its_bounds():
    """Full Moon over zodiacal light of V 22.7 (3.03e-18 erg/s/cm2/A/arcsec2): at most 1 at 40 deg, 0.1 beyond 60."""
    sterad = 10 ** (0.4 * (12.73 + 22.7)) / 206264.806**2  # of such sky is as bright as the Moon
    beam_sterad = math.pi / 4 / 14.0**2  # of an f/14 beam: radiance to irradiance
    ratio = sterad / beam_sterad * transmittance(np.array([40.0, 60.0]), np.full(2, 90.0), N)
    assert ratio[0] < 1.0 and ratio[1] < 0.1


@pytest.mark.parametrize(
    ("section", "key", "value"),
    [
        ("transmittance", "zenith", [1.0, 0.5]),
        ("transmittance", "matrix", [[1.0, 2.0]]),
        ("zodiacal", "intensity", [[1.0, -2.0]]),
        ("door", "length_m", "long"),
        ("earth", "albedo", "white"),
    ],
)
def test_malformed_numbers(section, key, value):
    from support.sky_geometry import camera

    data = camera().sky
    with pytest.raises(InputError, match=r"sky\.yaml"):
        sky_numbers(data | {section: data[section] | {key: value}})
    with pytest.raises(InputError, match=r"sky\.yaml"):
        sky_numbers({name: v for name, v in data.items() if name != section})


def test_no_numbers():
    with pytest.raises(InputError, match="no sky parameters"):
        sky_numbers({})


def test_a_closed_door_width_is_respected():
    narrow = replace(DOOR, half_width_deg=10.0)
    assert shade(60.0, 20.0, 0.0, narrow) == 0 and shade(60.0, 20.0, 0.0, DOOR) > 0


def test_azimuths_are_those_seen_from_the_line_of_sight():
    """Of a source 0.5 deg from a pixel that is itself as far from the boresight: above it, not at 45 deg."""
    sight, source = beam(0.5, 90.0), beam(0.5, 90.0) + np.array([0.0, np.radians(0.5), 0.0])
    assert azimuth_from(sight[None], source[None])[0, 0] == pytest.approx(0.0, abs=1e-6)
    assert azimuth_from(AHEAD, source[None])[0, 0] == pytest.approx(45.0, abs=0.1)
    assert azimuth_from(sight[None], AHEAD)[0, 0] == pytest.approx(-90.0, abs=1e-6)


@pytest.mark.parametrize(
    ("zenith", "azimuth"), [(20.0, 180.0), (70.0, 130.0), (85.0, 230.0), (60.0, 95.0), (80.0, 0.0)]
)
def test_the_door_is_lit_as_its_normal_faces_the_beam(zenith, azimuth):
    """Hinge to rim (sin d, cos d) in the plane of azimuth 0: the inside's normal is (-cos d, sin d)."""
    turn = math.radians(DOOR.opening_deg - 90)
    onto = max(float(beam(zenith, azimuth) @ [0.0, -math.cos(turn), math.sin(turn)]), 0.0)
    found = float(scattered(zenith, azimuth + 77.0, 77.0, DOOR))
    assert found == pytest.approx(DOOR.albedo / math.pi * solid_angle(DOOR) * onto, abs=1e-15)


@pytest.mark.parametrize("zenith", [92.0, 100.0, 110.0, 125.0])
def test_the_far_rim_shades_the_foot_of_the_door(zenith):
    """A ray from below the aperture past the rim at -R is (2 R) / tan(zenith) higher at the door, of height D cos d."""
    turn = math.radians(DOOR.opening_deg - 90)
    height = 2 * DOOR.tube_radius_m * math.tan(math.radians(zenith - 90.0))
    lit = max(1.0 - height / (DOOR.length_m * math.cos(turn)), 0.0)
    onto = max(math.cos(turn) * math.sin(math.radians(zenith)) + math.sin(turn) * math.cos(math.radians(zenith)), 0.0)
    wanted = DOOR.albedo / math.pi * solid_angle(DOOR) * onto * lit
    assert float(scattered(zenith, 180.0, 0.0, DOOR)) == pytest.approx(wanted, abs=1e-15)


def test_the_doors_middle_is_seen_where_it_stands():
    turn, half = math.radians(DOOR.opening_deg - 90), DOOR.length_m / 2
    x, z = DOOR.tube_radius_m + half * math.sin(turn), half * math.cos(turn)
    assert zenith_angle(DOOR) == pytest.approx(math.degrees(math.atan2(x, z)))
    cosine = (x * math.cos(turn) - z * math.sin(turn)) / math.hypot(x, z)
    area = 2 * DOOR.tube_radius_m * DOOR.length_m
    assert solid_angle(DOOR) == pytest.approx(area * cosine / (x**2 + z**2))


@pytest.mark.parametrize(
    ("section", "change", "why"),
    [
        ("zodiacal", {"longitude": [0.0, 5.0, 5.0]}, "must rise"),
        ("transmittance", {"zenith": [0.0, 1.0]}, "must start above 0"),
        ("transmittance", {"azimuth": [0.0, 360.0]}, r"must lie in 0\.\.360"),
        ("transmittance", {"azimuth": [-1.0, 90.0]}, r"must lie in 0\.\.360"),
        ("transmittance", {"zenith": [0.1, 1.0]}, "rows and columns must fit its axes"),
        ("zodiacal", {"colour": [[1.0, 2.0], [3.0, 4.0]]}, r"shape \(2, 3\)"),
        ("bodies", {"planets": [[1.0] * 6]}, r"shape \(None, 7\)"),
        ("starlight", {"brightness": [-1.0, 2.0]}, "must not be negative"),
        ("starlight", {"temperature": 0.0}, "temperature"),
    ],
)
def test_what_is_wrong_with_numbers_is_said(section, change, why):
    from support.sky_geometry import camera

    data = camera().sky
    with pytest.raises(InputError, match=why):
        sky_numbers(data | {section: data[section] | change})


def test_stars_are_rows_of_a_text_or_lists():
    from support.sky_geometry import camera

    data = camera().sky
    rows = [[10.0, -20.0, 3.5, 4000.0], [350.5, 45.0, -1.4, 9900.0]]
    for stars in (rows, "10 -20 3.5 4000, 350.5 45 -1.4 9900"):
        assert sky_numbers(data | {"stars": stars}).stars.tolist() == rows
    with pytest.raises(InputError, match="stars"):
        sky_numbers(data | {"stars": "10 -20 3.5, 350.5 45 -1.4"})


def test_positive_tables_may_have_unknown_cells_but_no_zero():
    from support.sky_geometry import camera

    data = camera().sky
    table = np.array(data["transmittance"]["matrix"], float)
    for value, good in ((None, True), (0.0, False)):
        matrix = table.tolist()
        matrix[1][1] = value
        changed = data | {"transmittance": data["transmittance"] | {"matrix": matrix}}
        if good:
            assert np.isnan(sky_numbers(changed).transmittance.matrix[1, 1])
        else:
            with pytest.raises(InputError, match="must be positive"):
                sky_numbers(changed)
