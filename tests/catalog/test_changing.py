"""What moves and varies, without pixels: light curves, great circles, the embedded sky's laws, and wrong tables."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import Table
from csst import BANDS
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq

from csstsim.base.errors import InputError
from csstsim.base.rng import stream
from csstsim.base.shipped import SHIPPED
from csstsim.catalog.astrometry.ephemeris import observer
from csstsim.catalog.base import Region
from csstsim.catalog.changing.light_curves import LightCurves, mean_mag
from csstsim.catalog.changing.motion import Interval, Motion, crosses
from csstsim.catalog.own_table import TableCatalog
from csstsim.catalog.table import ObjectTable
from csstsim.instrument.chip import Window
from csstsim.universe.changing import asteroids, satellites, variable_quasars, variable_stars
from csstsim.universe.changing.numbers import numbers_of

UNIVERSE = SHIPPED / "universe"
REGION = Region((), (), (), BANDS)
INTERVAL = Interval(61000.0, 150.0)


def catalogue(**columns):
    made = {"ra": [10.0, 11.0], "dec": [0.0, 1.0], "mag_r": [20.0, 20.0]} | columns
    options = {name: made.pop(name) for name in ("light_curves",) if name in made}
    return TableCatalog({"columns": {k: np.asarray(v) for k, v in made.items()}} | options, REGION)


def test_a_sine_is_averaged_over_the_exposure(camera):
    """Against an average over a thousand times; a period of two exposures and one of a day; the other is constant."""
    for period in (300.0 / 86400, 1.0):
        found = catalogue(var_period=[period, np.nan], var_amplitude=[0.5, np.nan], var_phase=[0.1, np.nan])
        dmag = found.dimming([0, 1], INTERVAL, camera.filters["r"])
        t = 61000.0 + 150.0 * (np.arange(1000) + 0.5) / 1000 / 86400
        light = 10 ** (-0.4 * 0.5 * np.sin(2 * np.pi * (t / period + 0.1)))
        assert dmag[0] == pytest.approx(-2.5 * np.log10(light.mean()), abs=1e-4) and dmag[1] == 0
    assert catalogue().dimming([0, 1], INTERVAL, camera.filters["r"]) is None
    assert mean_mag(np.array([[0.0, np.inf]]), np.array([0.5, 0.5]))[0] == pytest.approx(2.5 * np.log10(2))


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.floats(-1.5, 4.0), st.floats(0.0, 3.0), st.floats(0.0, 1.0), st.integers(0, 12), st.integers(0, 2**31),
    st.sampled_from([1.0, 150.0, 3000.0]),
)  # fmt: skip
def test_any_change_is_integrated_over_the_exposure(
    camera, tmp_path_factory, log_period, size, phase, points, seed, exptime
):
    """A sine and a curve with points in the exposure: a sum over fifty times as many times; 1e-3 mag.

    The period is 0.03 to 10,000 exposures; the curve jumps by up to 6 mag within a hundredth of an exposure.
    """
    period, rng = exptime * 10**log_period / 86400, np.random.default_rng(seed)
    at = np.sort(np.unique(np.round(rng.uniform(-0.2, 1.2, points + 2), 4)))
    mjd, mags = 61000.0 + at * exptime / 86400, rng.uniform(-3, 3, len(at))
    path = tmp_path_factory.mktemp("curve") / "c.csv"
    Table({"curve": ["a"] * len(mjd), "mjd": mjd, "dmag": mags}).write(path)
    found = catalogue(
        light_curve=["a", ""], light_curves=str(path), var_period=[period, np.nan], var_amplitude=[size, np.nan],
        var_phase=[phase, np.nan],
    )  # fmt: skip
    dmag = found.dimming([0, 1], Interval(61000.0, exptime), camera.filters["r"])[0]
    n = max(400 * len(at), int(40 / 10**log_period))
    t = np.unique(np.concatenate([np.linspace(0, 1, 50 * n + 1), at[(at > 0) & (at < 1)]]))
    mag = np.interp(t, at, mags) + size * np.sin(2 * np.pi * ((61000.0 + t * exptime / 86400) / period + phase))
    assert dmag == pytest.approx(-2.5 * np.log10(np.trapezoid(10 ** (-0.4 * mag), t)), abs=1e-3)


@pytest.mark.parametrize("size", [0.1, 1.0, 5.0])
def test_a_sine_of_many_cycles_counts_by_its_mean_light(camera, size):
    """Thousands of cycles in an exposure: the mean light of one, by a sum."""
    found = catalogue(var_period=[0.05 / 86400, np.nan], var_amplitude=[size, np.nan], var_phase=[0.1, np.nan])
    dmag = found.dimming([0, 1], INTERVAL, camera.filters["r"])[0]
    light = 10 ** (-0.4 * size * np.sin(2 * np.pi * np.arange(4096) / 4096))
    assert dmag == pytest.approx(-2.5 * np.log10(light.mean()), abs=1e-3 * size)


def test_a_curve_is_read_by_name_and_band(camera, tmp_path):
    path = tmp_path / "curves.csv"
    text = "curve,mjd,dmag,dmag_r\nnova,60999,0,0\nnova,61001,2,4\nflat,61000,1,1\n"
    path.write_text(text)
    found = catalogue(light_curve=["nova", "flat"], light_curves=str(path))
    for band, rise in (("r", 2.0), ("i", 1.0)):
        dmag = found.dimming([0, 1], INTERVAL, camera.filters[band])
        assert dmag == pytest.approx([rise * (1 + 75 / 86400), 1.0], abs=1e-6)
    late = found.dimming([0, 1], Interval(62000.0, 150.0), camera.filters["i"])
    assert late == pytest.approx([2.0, 1.0])
    assert found.files({"light_curves": str(path)}) == (str(path),)


def test_blanks_and_numbers_as_names_of_curves(camera, tmp_path):
    """A column with blanks makes floats of the names 1, 2, ..."""
    path = tmp_path / "curves.csv"
    path.write_text("curve,mjd,dmag\n1,60999,1\n1,61001,1\n")
    dmag = catalogue(light_curve=[1.0, np.nan], light_curves=str(path)).dimming([0, 1], INTERVAL, camera.filters["r"])
    assert dmag == pytest.approx([1.0, 0.0])
    assert catalogue(light_curve=[np.nan, np.nan]).table["light_curve"].tolist() == ["", ""]


@pytest.mark.parametrize(
    ("columns", "word"),
    [
        ({"rate_ra": [1.0, 0.0], "rate_dec": [0.0, 0.0]}, "rate_mjd"),
        ({"var_amplitude": [0.1, 0.0]}, "var_period"),
        ({"var_amplitude": [0.1, 0.0], "var_period": [-1.0, 1.0]}, "var_period"),
        ({"rate_ra": [np.inf, 0.0], "rate_mjd": [61000.0] * 2}, "not finite"),
        ({"rate_ra": [1.0, 0.0], "rate_mjd": [61000.0] * 2, "trail_width": [2.0, 0.0]}, "satellites"),
        ({"light_curve": ["a", ""]}, "light_curves"),
        ({"rate_Ra": [1.0, 0.0]}, "rate_ra"),
    ],
)
def test_a_row_that_cannot_change_as_it_says_is_refused(columns, word):
    with pytest.raises(InputError, match=word):
        catalogue(**columns)


@pytest.mark.parametrize(
    "text",
    [
        "curve,mjd\na,1\n",
        "curve,dmag\na,1\n",
        "curve,mjd,dmag\na,1,\n",
        "curve,mjd,dmag\na,1,0\na,1,2\n",
        "curve,mjd,dmag\n",
    ],
)
def test_a_wrong_file_of_curves_is_refused(tmp_path, text):
    path = tmp_path / "curves.csv"
    path.write_text(text)
    with pytest.raises(InputError, match="curves"):
        catalogue(light_curve=["a", ""], light_curves=str(path))
    with pytest.raises(InputError, match="dmag_i"):
        LightCurves({"curve": ["a"], "mjd": [1.0], "dmag_r": [0.0]}, "here").at("a", [1.0], "i")


@pytest.mark.parametrize("name, message", [
    ("dmag_r,dmag_R", "dmag_r: two columns for one band"),
    ("dmag,dmag_q", r"dmag_q: of no band of the camera .*allowed: dmag, dmag_nuv.*dmag_gv"),
    ("dmag_", "dmag_: of no band of the camera"),
])  # fmt: skip
def test_curves_are_of_bands_of_the_camera_once_each(tmp_path, name, message):
    path = tmp_path / "curves.csv"
    path.write_text(f"curve,mjd,{name}\na,1{',0' * len(name.split(','))}\n")
    with pytest.raises(InputError, match=message.replace(" .*", ".*")):
        catalogue(light_curve=["a", ""], light_curves=str(path))


def test_curves_of_a_grating_and_of_a_band(tmp_path):
    path = tmp_path / "curves.csv"
    path.write_text("curve,mjd,dmag_GV,dmag_r\na,1,0,0\n")
    assert catalogue(light_curve=["a", ""], light_curves=str(path)).table["light_curve"].tolist() == ["a", ""]


def test_units_of_a_rate_are_converted():
    table = Table({"ra": [10.0], "dec": [0.0], "mag_r": [20.0], "rate_ra": [0.5] * u.deg / u.s, "rate_mjd": [61000.0]})
    from csstsim.catalog.object_table import object_table, plain_columns

    made = object_table(plain_columns(table), BANDS, "table")
    assert made["rate_ra"][0] == pytest.approx(0.5 * 3600 * 3600) and made["rate_dec"][0] == 0


@pytest.mark.parametrize(("ra", "dec"), [(0.0001, 0.0), (200.0, 89.99), (120.0, -60.0)])
def test_motion_is_a_great_circle(ra, dec):
    """Places after an hour, RA 0 and the pole among them, against astropy; and when it is near a place."""
    for angle in (0.0, 77.0, 260.0):
        rate = 5000.0
        columns = {"ra": [ra], "dec": [dec], "rate_ra": [rate * np.sin(np.radians(angle))],
                   "rate_dec": [rate * np.cos(np.radians(angle))], "rate_mjd": [61000.0 - 1 / 24]}  # fmt: skip
        motion = Motion(ObjectTable(columns), INTERVAL)
        start = SkyCoord(ra * u.deg, dec * u.deg)
        for t in (0.0, 150.0):
            away = rate * (1 + t / 3600) * u.arcsec
            there = start.directional_offset_by(angle * u.deg, away)
            place = [v[0] for v in motion.place(np.array([t]))]
            assert there.separation(SkyCoord(*place * u.deg)).arcsec < 1e-4
        middle = [float(v[0]) for v in motion.place(np.array([75.0]))]
        first, last = motion.near(middle, np.radians(50.0 / 3600))
        assert first[0] == pytest.approx(75 - 36.0, abs=1e-3) and last[0] == pytest.approx(75 + 36.0, abs=1e-3)
        assert np.isnan(motion.near((middle[0], -middle[1] / 2), np.radians(0.001))[0][0])


def test_a_trail_crosses_a_window_or_passes_it():
    window = Window(0, 100, 0, 100)
    ends = np.array(
        [[-50, 50, 150, 50], [-50, -50, 150, -60], [-50, 90, 20, 170], [10, 10, 10, 10], [-500, 50, -300, 50]]
    )
    places = {f"trail_{name}": ends[:, k].astype(float) for k, name in enumerate(("x0", "y0", "x1", "y1"))}
    assert crosses(places, np.zeros(5), window).tolist() == [True, False, False, True, False]
    assert crosses(places, np.full(5, 60.0), window).tolist() == [True, True, True, True, False]


def test_quasars_walk_as_macleod_2010_says():
    """Structure functions of 400 quasars at three lags; any epoch alone is the same; the rms in u above that in z."""
    numbers = numbers_of(UNIVERSE, "variable_quasars")
    n = 400
    table = ObjectTable({"id": np.arange(n), "z": np.full(n, 1.0, np.float32), "coeff0": np.full(n, -25.0, np.float32)})
    times = 61000.0 + np.array([0.0, 30.0, 300.0, 3000.0])
    mags = variable_quasars.quasar_changes(1, table, times, 6200.0, numbers)
    alone = variable_quasars.quasar_changes(1, table.take(np.array([7])), times[2:3], 6200.0, numbers)
    assert alone[0, 0] == pytest.approx(mags[7, 2], abs=1e-12)
    normal = np.array([stream(1, "quasar light", k).standard_normal() for k in range(n)])
    rms, tau = np.transpose([variable_quasars.walk_of(1.0, -25.0, x, 6200.0, numbers) for x in normal])
    for k in (1, 2, 3):
        lag = times[k] - times[0]
        expected = 2 * rms**2 * (1 - np.exp(-lag / (2 * tau)))
        ratio = ((mags[:, k] - mags[:, 0]) ** 2 / expected).mean()
        assert ratio == pytest.approx(1.0, abs=5 * np.sqrt(2 / n))
    # SF of a quasar of M_i -26.5, 1e9 solar masses, at 4000 A in the rest frame: the published coefficients by hand
    m1450 = -26.5 - numbers["walk"]["shift"]
    mean, width = (a + b * -26.5 for a, b in (numbers["mass"]["mean"], numbers["mass"]["width"]))
    rms, tau = variable_quasars.walk_of(0.0, m1450, (9.0 - mean) / width, 4000.0, numbers)
    assert rms * np.sqrt(2) == pytest.approx(10 ** (-0.51 - 0.131 * 3.5)) and tau == pytest.approx(
        10 ** (2.4 - 0.03 * 3.5)
    )
    blue, red = (variable_quasars.walk_of(1.0, -25.0, 0.0, w, numbers)[0] for w in (3600.0, 9000.0))
    assert blue / red == pytest.approx((3600 / 9000) ** -0.479)


def test_shares_of_variable_stars_are_those_of_the_file():
    numbers = numbers_of(UNIVERSE, "variable_stars")
    n = 20000
    for teff, logg, some, share in ((5800.0, 4.4, ("eclipsing", "spots_g"), 0.2), (6800.0, 2.8, ("rr_lyrae",), 0.8)):
        table = ObjectTable({"id": np.arange(n) + (7 << 22), "teff": np.full(n, teff), "logg": np.full(n, logg)})
        mags = variable_stars.star_changes(3, table, 61000.0 + np.linspace(0, 100, 400), 5500.0, numbers)
        vary = np.ptp(mags, axis=1) > 0
        left = 1 - numbers["classes"]["share"][0]
        expected = left * share
        assert (np.abs(mags) > 0).any(axis=1).mean() >= expected - 0.02 and vary.mean() < expected + 0.03, some
    saw = variable_stars._FORMS["saw"](np.linspace(0, 1, 100001)[:-1])
    assert saw.mean() == pytest.approx(0.0, abs=1e-3) and np.ptp(saw) == pytest.approx(2.0, abs=1e-3)
    assert variable_stars._FORMS["eclipse"](np.array([0.0, 0.5])).tolist() == [2.0, 0.0]


@pytest.fixture(scope="module")
def belt():
    """Asteroids within half a degree of opposition, brighter than V = 22: few, so quick."""
    numbers = {**numbers_of(UNIVERSE, "asteroids"), "faintest": 22.0}
    craft = observer(61700.0, (6778.0, 0.0, 0.0), (0.0, 7.0, 3.0))
    sun = craft.astrom["eh"] * craft.astrom["em"]
    return numbers, sun, asteroids.asteroids_near(1, 61700.0, sun, sun / np.linalg.norm(sun), np.radians(1.0), numbers)


def test_asteroids_move_as_main_belt_asteroids_do(belt):
    """At opposition backwards by 25 to 50 arcsec an hour; a later search finds them where their orbits lead."""
    numbers, sun, found = belt
    assert len(found["id"]) > 100 and (found["V"] <= 22).all()
    assert np.unique(found["id"]).size == len(found["id"])
    hours = 2.0
    craft = observer(61700.0 + hours / 24, (6778.0, 0.0, 0.0), (0.0, 7.0, 3.0))
    later = craft.astrom["eh"] * craft.astrom["em"]
    seen, _ = asteroids.seen_from(found["orbit"], found["H"], 61700.0 + hours / 24, later, numbers["phase_slope"])
    speed = np.degrees(np.arccos(np.clip((seen * found["vector"]).sum(axis=1), -1, 1))) * 3600 / hours
    assert 25 < np.median(speed) < 50
    again = asteroids.asteroids_near(
        1, 61700.0 + hours / 24, later, sun / np.linalg.norm(sun), np.radians(1.0), numbers
    )
    both, one, other = np.intersect1d(found["id"], again["id"], return_indices=True)
    assert len(both) > 0.9 * len(found["id"])
    assert np.abs(seen[one] - again["vector"][other]).max() < 1e-9


@pytest.mark.slow
def test_their_number_at_opposition_is_that_of_heinze_2019():
    """697 +- 15 deg-2 of R < 25.0 (R = V - 0.4) on the ecliptic, within that and the chance of a field; 20 s."""
    numbers = {**numbers_of(UNIVERSE, "asteroids"), "faintest": 25.4}
    craft = observer(61700.0, (6778.0, 0.0, 0.0), (0.0, 7.0, 3.0))
    sun = craft.astrom["eh"] * craft.astrom["em"]
    found = asteroids.asteroids_near(1, 61700.0, sun, sun / np.linalg.norm(sun), np.radians(1.0), numbers)
    assert len(found["id"]) / np.pi == pytest.approx(697.0, abs=2 * np.hypot(15.0, np.sqrt(697 / np.pi)))


def test_an_orbit_is_keplers(belt):
    """The equation of the orbit and equal areas, against a period's closed form and vis-viva by differences."""
    _, _, found = belt
    orbit = found["orbit"][:, :5]
    a, e = orbit[0], orbit[1]
    period = 365.2568983 * a**1.5
    place = np.stack([asteroids.positions(orbit, 100.0 + t) for t in (-1e-3, 0.0, 1e-3)])
    speed = np.linalg.norm(place[2] - place[0], axis=1) / 2e-3
    r = np.linalg.norm(place[1], axis=1)
    assert speed == pytest.approx(0.01720209895 * np.sqrt(2 / r - 1 / a), rel=1e-7)
    for k in range(5):
        one = orbit[:, k : k + 1]
        back = asteroids.positions(one, 100.0 + period[k])
        assert np.abs(back - asteroids.positions(one, 100.0)).max() < 1e-5
    assert ((r >= a * (1 - e) - 1e-9) & (r <= a * (1 + e) + 1e-9)).all()


def test_an_asteroid_is_seen_where_its_light_left_it():
    """Light that arrives now left the orbit when it was as far away as light has gone since; to 1e-3 arcsec."""
    rng, count, now = np.random.default_rng(8), 20, 800.0
    angles = rng.uniform(0.0, 2 * np.pi, (3, count))
    orbit = np.stack(
        [rng.uniform(2.0, 5.2, count), rng.uniform(0.0, 0.3, count), rng.uniform(0.0, 0.4, count), *angles]
    )
    observer = np.array([0.6, -0.8, 0.0])
    seen, _ = asteroids.observed(orbit, np.full(count, 15.0), asteroids.EPOCH + now, observer, 0.15)
    for k in range(count):
        one = orbit[:, k : k + 1]

        def early(time, one=one):
            return np.linalg.norm(asteroids.positions(one, time)[0] - observer) - (now - time) * asteroids.LIGHT_DAY_AU

        left = asteroids.positions(one, brentq(early, now - 1.0, now))[0] - observer
        assert np.linalg.norm(np.cross(seen[k], left / np.linalg.norm(left))) < np.radians(1e-3 / 3600)


def test_satellites_cross_at_the_published_rate():
    numbers = numbers_of(UNIVERSE, "satellites")
    radius, n = np.radians(0.8), 2000
    counts = []
    for k in range(n):
        found = satellites.crossing(5, 61000.0 + k / 100, 150.0, (30.0, 80.0), radius, 2.0, numbers)
        counts.append(len(found["id"]))
        there = SkyCoord(found["ra"] * u.deg, found["dec"] * u.deg)
        assert (there.separation(SkyCoord(30 * u.deg, 80 * u.deg)).deg <= 0.8 + 1e-9).all()
    expected = -np.log(1 - 0.043) / (660 * 257) * 2 * np.degrees(radius) * 3600 * 150
    assert np.mean(counts) == pytest.approx(expected, abs=5 * np.sqrt(expected / n))
    again = satellites.crossing(5, 61000.0, 150.0, (30.0, 80.0), radius, 2.0, numbers)
    first = satellites.crossing(5, 61000.0, 150.0, (30.0, 80.0), radius, 2.0, numbers)
    assert all((again[name] == first[name]).all() for name in again)
    # The track is square to the line from the boresight: that is its nearest place
    for k in range(50):
        found = satellites.crossing(6, 61000.0 + k, 3000.0, (30.0, 80.0), radius, 2.0, numbers)
        there = SkyCoord(found["ra"] * u.deg, found["dec"] * u.deg)
        towards = there.position_angle(SkyCoord(30 * u.deg, 80 * u.deg)).deg
        assert np.abs((found["angle"] - towards) % 180 - 90).max() < 1e-6


@pytest.mark.parametrize("row", ["a,2461729,3", "a,61000,-100", "a,61000,1e4", "a,,1", "a,inf,1"])
def test_points_of_a_curve_out_of_range_are_refused(tmp_path, row):
    """A Julian date is no MJD; a change of a hundred magnitudes no light curve."""
    path = tmp_path / "curves.csv"
    path.write_text(f"curve,mjd,dmag\na,60999,0\n{row}\n")
    with pytest.raises(InputError, match=r"(mjd|dmag), row 2: blank, not finite or out of range"):
        catalogue(light_curve=["a", ""], light_curves=str(path))


@pytest.mark.parametrize("name", ["0012", "1e5", "1.50", "1234567", "007"])
@pytest.mark.parametrize("blank", [True, False])
def test_numbers_as_names_of_curves_are_what_was_written(tmp_path, name, blank):
    curves, objects = tmp_path / "curves.csv", tmp_path / "objects.csv"
    curves.write_text(f"curve,mjd,dmag\n{name},60999,1\n{name},61001,1\n")
    objects.write_text(f"ra,dec,mag_r,light_curve\n10,0,20,{name}\n11,1,20,{'' if blank else name}\n")
    found = TableCatalog({"file": str(objects), "light_curves": str(curves)}, REGION)
    assert found.table["light_curve"].tolist() == [name, "" if blank else name]
