"""What moves and varies, without pixels: light curves, great circles, the embedded sky's laws, and wrong tables."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import Table
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation
from scipy.special import ndtri
from scipy.stats import kstest
from support.csst import BANDS

from csstsim.base.errors import InputError
from csstsim.base.rng import stream
from csstsim.base.shipped import SHIPPED
from csstsim.base.units import ARCSEC_PER_RAD
from csstsim.catalog.astrometry.ephemeris import observer
from csstsim.catalog.astrometry.reduction import apparent
from csstsim.catalog.base import Region
from csstsim.catalog.changing.columns import completed, moves, reasons
from csstsim.catalog.changing.light_curves import LightCurves, mean_mag
from csstsim.catalog.changing.motion import Interval, Motion, crosses, positions_at, trails
from csstsim.catalog.own_table import TableCatalog
from csstsim.catalog.table import ObjectTable
from csstsim.instrument.chip import Window
from csstsim.optics.geometry.wcs import ChipWCS
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
            place = [v[0] for v in motion.position(np.array([t]))]
            assert there.separation(SkyCoord(*place * u.deg)).arcsec < 1e-4
        middle = [float(v[0]) for v in motion.position(np.array([75.0]))]
        first, last = motion.times_near(middle, np.radians(50.0 / 3600))
        assert first[0] == pytest.approx(75 - 36.0, abs=1e-3) and last[0] == pytest.approx(75 + 36.0, abs=1e-3)
        assert np.isnan(motion.times_near((middle[0], -middle[1] / 2), np.radians(0.001))[0][0])


def test_a_trail_crosses_a_window_or_passes_it():
    window = Window(0, 100, 0, 100)
    ends = np.array(
        [[-50, 50, 150, 50], [-50, -50, 150, -60], [-50, 90, 20, 170], [10, 10, 10, 10], [-500, 50, -300, 50]]
    )
    places = {f"trail_{name}": ends[:, k].astype(float) for k, name in enumerate(("x0", "y0", "x1", "y1"))}
    assert crosses(places, np.zeros(5), window).tolist() == [True, False, False, True, False]
    assert crosses(places, np.full(5, 60.0), window).tolist() == [True, True, True, True, False]


def test_trails_from_anywhere_to_anywhere_by_many_places_on_them():
    """Against 4001 places of each of 400 trails; those that pass a corner within a pixel are not asked."""
    rng = np.random.default_rng(5)
    window, far = Window(300, 420, 50, 110), rng.uniform(0, 30, 400)
    x0, x1 = rng.uniform(150, 570, (2, 400))
    y0, y1 = rng.uniform(-100, 260, (2, 400))
    x1[:20], y1[20:40] = x0[:20], y0[20:40]  # along the axes
    places = {"trail_x0": x0, "trail_y0": y0, "trail_x1": x1, "trail_y1": y1}
    along = np.linspace(0, 1, 4001)[:, None]
    x, y = x0 + along * (x1 - x0), y0 + along * (y1 - y0)
    outside = np.max([299.5 - far - x, x - 419.5 - far, 49.5 - far - y, y - 109.5 - far], axis=0).min(axis=0)
    clear = np.abs(outside) > 1
    assert (outside[clear] < 0).sum() > 100 and (outside[clear] > 0).sum() > 100
    np.testing.assert_array_equal(crosses(places, far, window)[clear], outside[clear] < 0)


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
    rms, tau = np.transpose([variable_quasars.walk_parameters(1.0, -25.0, x, 6200.0, numbers) for x in normal])
    for k in (1, 2, 3):
        lag = times[k] - times[0]
        expected = 2 * rms**2 * (1 - np.exp(-lag / (2 * tau)))
        ratio = ((mags[:, k] - mags[:, 0]) ** 2 / expected).mean()
        assert ratio == pytest.approx(1.0, abs=5 * np.sqrt(2 / n))
    # SF of a quasar of M_i -26.5, 1e9 solar masses, at 4000 A in the rest frame: the published coefficients by hand
    m1450 = -26.5 - numbers["walk"]["shift"]
    mean, width = (a + b * -26.5 for a, b in (numbers["mass"]["mean"], numbers["mass"]["width"]))
    rms, tau = variable_quasars.walk_parameters(0.0, m1450, (9.0 - mean) / width, 4000.0, numbers)
    assert rms * np.sqrt(2) == pytest.approx(10 ** (-0.51 - 0.131 * 3.5)) and tau == pytest.approx(
        10 ** (2.4 - 0.03 * 3.5)
    )
    blue, red = (variable_quasars.walk_parameters(1.0, -25.0, 0.0, w, numbers)[0] for w in (3600.0, 9000.0))
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
    saw = variable_stars._LIGHT_CURVES["saw"](np.linspace(0, 1, 100001)[:-1])
    assert saw.mean() == pytest.approx(0.0, abs=1e-3) and np.ptp(saw) == pytest.approx(2.0, abs=1e-3)
    assert variable_stars._LIGHT_CURVES["eclipse"](np.array([0.0, 0.5])).tolist() == [2.0, 0.0]


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


@pytest.mark.thorough
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


RATE = {"rate_ra": [3.0], "rate_dec": [-4.0], "rate_mjd": [61000.0], "trail_width": [0.0]}


@pytest.mark.parametrize("columns, words", [
    ({}, None), ({"rate_ra": [0.0], "rate_dec": [0.0], "rate_mjd": [np.nan]}, None), ({"rate_mjd": [-1e6]}, None),
    ({"rate_ra": [1e8], "rate_dec": [0.0], "trail_width": [60.0]}, None),
    ({"rate_ra": [0.0], "rate_dec": [-216_000.0], "trail_width": [0.1]}, None),
    ({"var_period": [0.1], "var_amplitude": [30.0], "var_phase": [-7.0]}, None),
    ({"var_period": [np.nan], "var_amplitude": [0.0]}, None),
    ({"rate_dec": [np.nan]}, "rate_ra or rate_dec is not finite"),
    ({"rate_mjd": [np.nan]}, "a rate of motion without rate_mjd"),
    ({"rate_mjd": [-1.1e6]}, "rate_mjd is beyond 1e+06"), ({"rate_mjd": [1.1e6]}, "rate_mjd is beyond"),
    ({"rate_ra": [8e7], "rate_dec": [8e7]}, "a rate of motion above 1e+08 arcsec / hour"),
    ({"rate_ra": [3e5], "trail_width": [60.1]}, "trail_width is not within 0..60 arcsec"),
    ({"trail_width": [-0.1]}, "trail_width is not within"), ({"trail_width": [np.nan]}, "trail_width is not within"),
    ({"rate_ra": [1.5e5], "rate_dec": [1.5e5], "trail_width": [0.1]}, "a trail_width, but slower than 1 arcmin / s"),
    ({"var_period": [0.0], "var_amplitude": [0.1]}, "a var_amplitude without a var_period above 0"),
    ({"var_period": [1.0], "var_phase": [np.inf]}, "var_phase is not finite"),
    ({"var_period": [1.0], "var_amplitude": [30.1]}, "var_amplitude is not within 0..30 mag"),
    ({"var_period": [1.0], "var_amplitude": [-0.1]}, "var_amplitude is not within"),
])  # fmt: skip
def test_changes_at_the_limits_and_beyond(columns, words):
    found = [reason for reason, mask in reasons(ObjectTable(RATE | columns)).items() if mask.any()]
    assert len(found) == (words is not None) and all(reason.startswith(words) for reason in found)


def test_columns_of_changes_are_completed():
    """One rate brings them all; blanks are the default, of a time no number; a table without any has none."""
    assert completed({"ra": np.zeros(2)}, 2) == {}
    made = completed({"rate_dec": np.array([5, -3])}, 2)
    assert list(made) == ["rate_ra", "rate_dec", "rate_mjd", "trail_width"]
    assert made["rate_dec"].tolist() == [5.0, -3.0] and made["rate_ra"].tolist() == [0.0, 0.0]
    assert np.isnan(made["rate_mjd"]).all() and not made["trail_width"].any()
    made = completed({"var_amplitude": np.array([0.2, np.nan]), "var_period": np.array([np.nan, 3.0])}, 2)
    assert set(made) == {"var_amplitude", "var_period"} and made["var_amplitude"].tolist() == [0.2, 0.0]
    assert np.isnan(made["var_period"][0]) and made["var_period"][1] == 3.0
    assert completed({"light_curve": np.array([2.0, np.nan, 1.5])}, 3)["light_curve"].tolist() == ["2", "", "1.5"]


def test_who_moves():
    table = ObjectTable({"rate_ra": np.array([0.0, -1.0, 0.0, np.nan]), "rate_dec": np.array([0.0, 0.0, 2.0, 1.0])})
    assert moves(table).tolist() == [False, True, True, False]
    assert moves(ObjectTable({"ra": np.zeros(3)})).tolist() == [False] * 3


def test_columns_are_exposed_between_the_leaves():
    interval = Interval(61000.25, 150.0, lambda x: 0.001 * np.asarray(x))
    assert interval.middle == pytest.approx(61000.25 + 75.0 / 86400, abs=1e-10)
    first, last = interval.exposed(np.array([0.0, 2000.0, 9000.0]))
    assert first.tolist() == [0.0, 1.0, 4.5] and last.tolist() == [150.0, 149.0, 145.5]
    first, last = Interval(61000.25, 150.0).exposed(np.array([5.0, 6.0]))
    assert first.tolist() == [0.0, 0.0] and last.tolist() == [150.0, 150.0]


def test_the_direction_of_a_motion_is_that_of_its_great_circle():
    """Far from where it began: against astropy's bearing of the place a second later, and times of several columns."""
    columns = {"ra": [120.0, 359.99], "dec": [-60.0, 80.0], "rate_ra": [4e5, -1e5], "rate_dec": [2e5, 3e5],
               "rate_mjd": [61000.0 - 0.02, 61000.002]}  # fmt: skip
    motion = Motion(ObjectTable({name: np.array(v) for name, v in columns.items()}), INTERVAL)
    assert motion.speed == pytest.approx(np.hypot([4e5, -1e5], [2e5, 3e5]) / 3600)
    t = np.array([30.0, 120.0])
    here, there = (SkyCoord(*(v * u.deg for v in motion.position(at))) for at in (t, t + 1.0))
    assert motion.position_angle(t) == pytest.approx(here.position_angle(there).deg, abs=1e-3 + 0.01)
    assert here.separation(there).arcsec == pytest.approx(motion.speed, rel=1e-6)
    many = motion.position(np.stack([t, t + 1.0], axis=1))
    np.testing.assert_allclose(many[0][:, 1], there.ra.deg, rtol=1e-12)


def test_beyond_a_quarter_of_a_turn_an_object_is_nowhere():
    """In front of its place by 80 deg it is near a place there, by 100 deg it is not, and so behind."""
    speed = 3.6e6  # arcsec / hour: a degree in 3.6 s
    for degrees, seen in ((80.0, True), (100.0, False), (-80.0, True), (-100.0, False)):
        columns = {"ra": [30.0], "dec": [0.0], "rate_ra": [speed], "rate_dec": [0.0],
                   "rate_mjd": [61000.0 - (degrees * 3.6 - 75.0) / 86400]}  # fmt: skip
        motion = Motion(ObjectTable({name: np.array(v) for name, v in columns.items()}), INTERVAL)
        first, last = motion.times_near((30.0 + degrees, 0.0), np.radians(0.5))
        assert np.isfinite(first[0]) == seen
        if seen:
            assert [first[0], last[0]] == pytest.approx([75.0 - 1.8, 75.0 + 1.8], abs=1e-3)


def test_a_trail_is_where_its_object_is_while_the_column_is_exposed(camera, make_pointing, observe):
    """Slow and fast, and one elsewhere: places by the WCS, length by the speed, angle by astropy, times by leaves."""
    pointing = make_pointing()
    wcs, craft = ChipWCS(camera.chips[9], pointing), observe(pointing)
    window, interval = Window(4000, 4600, 3000, 3500), Interval(pointing.mjd, 150.0, lambda x: 2.0 + 0 * x)
    from csstsim.catalog.astrometry.reduction import icrs

    ra, dec = (float(v) for v in icrs(*wcs.pixel_to_world(4300.0, 3250.0), craft))
    columns = {"ra": [ra, ra, ra + 5], "dec": [dec] * 3, "rate_ra": [30.0, 2e5, 30.0], "rate_dec": [40.0, -5e5, 0.0],
               "rate_mjd": [interval.middle, interval.start + 20.0 / 86400, interval.middle]}  # fmt: skip
    table = ObjectTable({name: np.array(v) for name, v in columns.items()})
    found, motion = trails(table, wcs, craft, window, interval, 100.0), Motion(table, interval)
    assert all(np.isnan(values[2]) for values in found.values())
    first, last = found["trail_start"][:2], found["trail_end"][:2]
    assert [first[0], last[0]] == pytest.approx([1.0, 149.0])
    half = (0.5 * np.hypot(600, 500) + 100) * 0.074 / (np.hypot(2e5, 5e5) / 3600)  # s
    assert [first[1], last[1]] == pytest.approx([20 - half, 20 + half], abs=0.02)
    assert found["trail_length"][:2] == pytest.approx(motion.speed[:2] * (last - first))
    angle = np.degrees(np.arctan2(columns["rate_ra"], columns["rate_dec"])) % 360
    assert found["trail_angle"][:2] == pytest.approx(angle[:2], abs=0.01)
    for k, t in ((0, found["trail_start"]), (1, found["trail_end"])):
        seen = wcs.world_to_pixel(*apparent(*motion.position(t), craft))
        assert found[f"trail_x{k}"][:2] == pytest.approx(seen[0][:2]) and found[f"trail_y{k}"][:2] == pytest.approx(
            seen[1][:2]
        )
    middle = positions_at(motion, wcs, craft, 0.5 * (found["trail_start"] + found["trail_end"]))
    for name, values in middle._asdict().items():
        np.testing.assert_array_equal(found[name], values)
    assert [found["x"][0], found["y"][0]] == pytest.approx([4300.0, 3250.0], abs=1e-3)
    assert found["ra_epoch"][0] == pytest.approx(ra, abs=1e-9) and abs(found["ra"][0] - ra) > 1e-4


def test_orbits_lie_as_their_angles_say():
    """Perihelion and a quarter of the anomaly by turns about z, x, z of scipy; the mean motion is forwards."""
    a, e, i, node, peri = 2.5, 0.2, 0.3, 1.1, 2.3
    turn = Rotation.from_euler("ZXZ", [node, i, peri])
    at = asteroids.positions(np.array([[a], [e], [i], [node], [peri], [0.0]]), 0.0)[0]
    np.testing.assert_allclose(at, turn.apply([a * (1 - e), 0.0, 0.0]), atol=1e-12)
    mean = 1.7
    eccentric = brentq(lambda x: x - e * np.sin(x) - mean, 0.0, np.pi)
    place = [a * (np.cos(eccentric) - e), a * np.sqrt(1 - e * e) * np.sin(eccentric), 0.0]
    days = 400.0
    anomaly = mean - days * 0.01720209895 / a**1.5
    at = asteroids.positions(np.array([[a], [e], [i], [node], [peri], [anomaly]]), days)[0]
    np.testing.assert_allclose(at, turn.apply(place), atol=1e-9)


def test_the_ecliptic_is_that_of_astropy():
    pole = SkyCoord(0 * u.deg, 90 * u.deg, frame="barycentricmeanecliptic").icrs.cartesian.xyz.value
    east = SkyCoord(90 * u.deg, 0 * u.deg, frame="barycentricmeanecliptic").icrs.cartesian.xyz.value
    made = asteroids._to_equator(np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0]]))
    np.testing.assert_allclose(made, [pole, east], atol=1e-6)
    np.testing.assert_allclose(asteroids._to_ecliptic(made), [[0, 0, 1], [0, 1, 0]], atol=1e-15)


@pytest.mark.parametrize("phase", [0.0, 30.0, 110.0])
def test_brightness_falls_with_both_distances_and_the_phase(phase):
    """H, G of Bowell et al. 1989, G 0.15, at 2.5 au from the Sun and 1.5 au from us; light time moves it a little."""
    orbit, angle = np.array([[2.5], [0.0], [0.0], [0.0], [0.0], [np.pi / 2]]), np.radians(phase)
    place = np.array([1.5 * np.sin(angle), 2.5 - 1.5 * np.cos(angle), 0.0])
    _, v = asteroids.observed(orbit, np.array([14.0]), asteroids.EPOCH, place, 0.15)
    half = np.tan(angle / 2)
    dims = -2.5 * np.log10(0.85 * np.exp(-3.33 * half**0.63) + 0.15 * np.exp(-1.87 * half**1.22))
    assert v[0] == pytest.approx(14.0 + 5 * np.log10(2.5 * 1.5) + dims, abs=5e-3)


def test_numbers_of_asteroids_are_read_both_ways():
    """Slopes beyond the table's ends, and lines within; the inverse returns."""
    law = asteroids.NumberLaw(np.array([11.0, 15.0, 18.1]), np.array([2.95, 4.9, 6.28]), 0.5, 0.28)
    h = np.array([9.0, 11.0, 13.0, 16.55, 18.1, 20.1])
    wanted = [2.95 - 1.0, 2.95, 3.925, 5.59, 6.28, 6.28 + 0.56]
    assert asteroids._log_number(h, law) == pytest.approx(wanted)
    assert [asteroids._log_number_of(x, law) for x in h] == pytest.approx(wanted)
    assert [asteroids._magnitude_of(n, law) for n in wanted] == pytest.approx(h)


def test_cells_of_asteroids_hold_all_that_can_be_seen():
    """Shares of zones at one limit of H; the faintest at opposition and perihelion; width of inclinations in rad."""
    numbers = {**numbers_of(UNIVERSE, "asteroids"), "faintest": 22.0}
    made, zones = asteroids.population(numbers), numbers["zones"]
    assert len(made.number) == 5 * 6 * 12 and (made.limit, made.slope) == (22.0, 0.15)
    share = made.number / 10 ** asteroids._log_number(made.faintest_h, made.law)
    of_zone = [share[made.zone == k].sum() for k in range(5)]
    assert of_zone == pytest.approx(zones["share"], rel=0.02)
    assert made.law.log_number == pytest.approx(np.array(numbers["counts"]["log_number"]) + np.log10(0.43))
    for k, (first, last) in enumerate(zones["a"]):
        mine = made.zone == k
        assert (made.a_min[mine].min(), made.a_max[mine].max()) == pytest.approx((first, last))
        assert made.e_min[mine].min() == 0.0 and made.e_max[mine].max() == 0.35
        assert made.inclination[mine] == pytest.approx(np.radians(zones["i"][k]))
        inner = mine & (made.e_max < 0.15)
        wanted = -np.expm1(-0.5 * (made.e_max[inner].max() / zones["e"][k]) ** 2)
        wanted /= -np.expm1(-0.5 * (0.35 / zones["e"][k]) ** 2)
        assert share[inner].sum() / zones["share"][k] == pytest.approx(wanted, rel=0.03)
    nearest = made.a_min * (1 - made.e_max)
    brightest = made.faintest_h + 5 * np.log10(nearest * np.maximum(nearest - 1.017, 0.05))
    assert brightest == pytest.approx(np.full(len(brightest), 22.0))


@pytest.mark.parametrize("ecliptic", [(40.0, 3.0), (200.0, -25.0)])
def test_no_asteroid_is_left_out_by_the_search(monkeypatch, ecliptic):
    """With and without the shortcut by longitude and inclination, away from opposition."""
    numbers = {**numbers_of(UNIVERSE, "asteroids"), "faintest": 18.8}
    sun = np.array([0.3, -0.95, 0.1])
    lon, lat = np.radians(ecliptic)
    towards = asteroids._to_equator(np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)]))
    asked = 2, 61800.0, sun, towards, np.radians(9.0), numbers
    quick = asteroids.asteroids_near(*asked)
    monkeypatch.setattr(asteroids, "_window", lambda *_: asteroids.Window(0.0, 0.0, np.pi))
    every = asteroids.asteroids_near(*asked)
    assert len(every["id"]) > 10 and quick["id"].tolist() == every["id"].tolist()
    apart = np.arccos(np.clip(every["vector"] @ towards, -1, 1))
    assert apart.max() <= np.radians(9.0) and every["V"].max() <= 18.8
    first = np.array([zone[0] for zone in numbers["zones"]["a"]])[every["zone"]]
    last = np.array([zone[1] for zone in numbers["zones"]["a"]])[every["zone"]]
    assert ((every["a"] >= first) & (every["a"] <= last)).all()


def test_satellites_are_as_far_fast_wide_and_bright_as_said():
    """A thousand tracks: laws by KS tests, widths and magnitudes in closed form; growth multiplies their number."""
    numbers = numbers_of(UNIVERSE, "satellites")
    radius, orbits = np.radians(0.8), numbers["orbits"]
    many = satellites.crossing(5, 61000.0, 150.0, (30.0, -40.0), radius, 2.0, {**numbers, "growth": 5000.0})
    assert len(many["id"]) == 1000 == len(np.unique(many["id"]))
    (near, far), km = orbits["distance"], many["distance"]
    assert kstest(np.log(km / near) / np.log(far / near), "uniform").pvalue > 1e-4
    assert kstest(many["speed"] / ARCSEC_PER_RAD * km, "uniform", (4.0, 10.0)).pvalue > 1e-4
    assert kstest(many["time"], "uniform", (0.0, 150.0)).pvalue > 1e-4
    assert many["width"] == pytest.approx((2.0 + 3.0) / (1000 * km) * 206264.806)
    middle, scatter = orbits["magnitude"]
    assert kstest((many["V"] - 5 * np.log10(km / 1000) - middle) / scatter, "norm").pvalue > 1e-4
    assert kstest(many["angle"], "uniform", (0.0, 360.0)).pvalue > 1e-4
    there, centre = SkyCoord(many["ra"] * u.deg, many["dec"] * u.deg), SkyCoord(30 * u.deg, -40 * u.deg)
    assert kstest(centre.separation(there).deg / 0.8, "uniform").pvalue > 1e-4
    assert kstest(centre.position_angle(there).deg, "uniform", (0.0, 360.0)).pvalue > 1e-4
    assert abs(np.corrcoef(many["speed"] * km, many["time"])[0, 1]) < 0.16  # 5 sigma
    tripled = {**numbers, "growth": 60.0}
    counts = [
        len(satellites.crossing(5, 61000.0 + k, 150.0, (30.0, 0.0), radius, 2.0, tripled)["id"]) for k in range(99)
    ]
    expected = 60 * -np.log(1 - 0.043) / (660 * 257) * 2 * 0.8 * 3600 * 150
    assert np.mean(counts) == pytest.approx(expected, abs=5 * np.sqrt(expected / 99))


def test_classes_of_stars_take_them_in_turn():
    """Ranges from the lower limit on, shares, and period, amplitude and phase of the class that takes the star."""
    classes = {
        "names": ["a", "b"], "teff": [[4000, 6000], [5000, 7000]], "logg": [[1.0, 4.0], [2.0, 5.0]],
        "share": [0.5, 0.3], "period": [[1.0, 100.0], [0.1, 10.0]], "amplitude": [[0.2, 0.5], [0.01, 0.1]],
    }  # fmt: skip
    teff = np.array([4000, 6000, 5500, 5500, 5500, 5500, 3999, 7000, 5500, 5500.0])
    logg = np.array([3.0, 3.0, 3.0, 3.0, 4.0, 0.9, 3.0, 3.0, 1.0, 2.0])
    draws = np.full((10, 16), 0.4)
    draws[:, 0], draws[:, 1], draws[:, -1], draws[:, -2], draws[:, -3] = 0.49, 0.29, 0.25, 0.9, 0.7
    draws[2, 0], draws[3, :2] = 0.5, (0.5, 0.3)
    stars = variable_stars.assign_classes({"teff": teff, "logg": logg}, draws, classes)
    assert stars.kind.tolist() == [0, 1, 1, -1, 1, -1, -1, -1, 0, 0]
    assert stars.period[[0, 1]] == pytest.approx([100**0.25, 0.1 * 100**0.25])
    assert stars.amplitude[[0, 1]] == pytest.approx([0.2 * 10 ** (0.5 * ndtri(0.9)), 0.01 * 10 ** (0.1 * ndtri(0.9))])
    assert (stars.phase == 0.7).all()


def test_forms_of_changes():
    """A sine rises first; a saw brightens in 0.15 of its period from 1 to -1; an eclipse takes a tenth, 2 deep."""
    forms = variable_stars._LIGHT_CURVES
    assert forms["sine"](np.array([0.0, 0.25, 0.5, 0.75])) == pytest.approx([0.0, 1.0, 0.0, -1.0], abs=1e-12)
    assert forms["saw"](np.array([0.0, 0.075, 0.15, 0.575])) == pytest.approx([1.0, 0.0, -1.0, 0.0])
    assert forms["eclipse"](np.array([0.0, 0.025, 0.975, 0.05, 0.95, 0.0499])) == pytest.approx(
        [2.0, 1.0, 1.0, 0.0, 0.0, 0.0], abs=1e-4
    )


def test_a_star_s_change_follows_its_period_and_the_wavelength():
    """Of a class of one: the period's turns, the amplitude by wavelength, another curve for another seed."""
    numbers = {"classes": {
        "names": ["one"], "teff": [[0, 9e4]], "logg": [[-9, 9]], "share": [1.0], "period": [[2.0, 2.0]],
        "amplitude": [[0.3, 0.0]], "slope": [-0.9], "form": ["sine"],
    }}  # fmt: skip
    table = ObjectTable({"id": np.arange(3) + 5, "teff": np.full(3, 5e3), "logg": np.full(3, 4.0)})
    times = 61000.0 + np.linspace(0, 4, 401)
    mags = variable_stars.star_changes(1, table, times, 5500.0, numbers)
    np.testing.assert_allclose(mags[:, :200], mags[:, 200:400], atol=1e-9)
    assert np.abs(mags).max(axis=1) == pytest.approx([0.3] * 3, rel=1e-3)
    blue = variable_stars.star_changes(1, table, times, 2750.0, numbers)
    np.testing.assert_allclose(blue, 2**0.9 * mags, rtol=1e-12)
    assert np.ptp(mags[:, 0]) > 1e-3  # phases of their own
    assert not np.allclose(variable_stars.star_changes(2, table, times, 5500.0, numbers), mags)


def test_before_its_start_a_quasar_stands_still_and_its_walk_begins_as_it_goes_on():
    """Variance from the first day on; half way between days the mean of both; a longer search is the same walk."""
    numbers = numbers_of(UNIVERSE, "variable_quasars")
    start, n = numbers["start"], 600
    table = ObjectTable({"id": np.arange(n), "z": np.full(n, 0.5), "coeff0": np.full(n, -24.0)})
    times = start + np.array([-500.0, 0.0, 10.0, 10.5, 11.0])
    mags = variable_quasars.quasar_changes(1, table, times, 5000.0, numbers)
    np.testing.assert_array_equal(mags[:, 0], mags[:, 1])
    np.testing.assert_allclose(mags[:, 3], 0.5 * (mags[:, 2] + mags[:, 4]), atol=1e-12)
    alone = variable_quasars.quasar_changes(1, table.take(np.array([3])), times[1:2], 5000.0, numbers)
    assert alone[0, 0] == pytest.approx(mags[3, 1], abs=1e-12)
    normal = np.array([stream(1, "quasar light", k).standard_normal() for k in range(n)])
    rms = np.array([variable_quasars.walk_parameters(0.5, -24.0, x, 5000.0, numbers)[0] for x in normal])
    assert ((mags[:, 1] / rms) ** 2).mean() == pytest.approx(1.0, abs=5 * np.sqrt(2 / n))
    assert abs((mags[:, 1] / rms).mean()) < 5 / np.sqrt(n)


def test_columns_of_bands_and_gratings_are_found_in_any_case():
    curves = LightCurves({"curve": ["a", "a"], "mjd": [1.0, 3.0], "dmag_GV": [0.0, 2.0], "dmag_nuv": [1.0, 1.0],
                          "dmag": [5.0, 7.0]}, "here", ("NUV", "r", "GV"))  # fmt: skip
    for band, wanted in (("GV", [0.0, 1.0, 2.0]), ("NUV", [1.0, 1.0, 1.0]), ("r", [5.0, 6.0, 7.0])):
        assert curves.at("a", [0.0, 2.0, 9.0], band).tolist() == wanted


def test_points_of_curves_may_be_in_any_order_of_rows():
    """Curves interleaved and backwards; a time twice is refused in one curve, not in two."""
    columns = {"curve": ["b", "a", "b", "a"], "mjd": [3.0, 9.0, 1.0, 1.0], "dmag": [6.0, 0.9, 2.0, 0.1]}
    curves = LightCurves(columns, "here")
    assert curves.at("b", [2.0], "r")[0] == 4.0 and curves.at("a", [5.0], "r")[0] == pytest.approx(0.5)
    curves.check(["a", "", "b"])
    with pytest.raises(InputError, match=r"no such curve .*'c'.*allowed: a, b"):
        curves.check(["a", "c"])
    with pytest.raises(InputError, match="curve a has a time twice"):
        LightCurves(columns | {"mjd": [3.0, 1.0, 1.0, 1.0]}, "here")
