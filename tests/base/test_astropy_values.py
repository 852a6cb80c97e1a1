"""SkyCoord, Quantity and Time against the plain numbers that they stand for, and against astropy's own motion."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import AltAz, Angle, SkyCoord
from astropy.table import QTable, Table
from astropy.time import Time

from csstsim.base.astropy_values import direction, number, position_columns, utc_text
from csstsim.base.errors import InputError
from csstsim.catalog.astrometry.reduction import moved
from csstsim.catalog.object_table import object_table, plain_columns

BANDS = ["r"]


@pytest.mark.parametrize(
    "given, unit, wanted",
    [
        (2.5, "deg", 2.5),
        ("text", "deg", "text"),
        (90 * u.arcmin, "deg", 1.5),
        (Angle("1h"), "deg", pytest.approx(15.0)),
        (2 * u.min, "s", 120.0),
        (np.float32(0.5) * u.deg, "deg", 0.5),
    ],
)
def test_numbers_in_a_unit(given, unit, wanted):
    assert number(given, unit, "pa") == wanted


@pytest.mark.parametrize("given", [1 * u.s, [1, 2] * u.deg, 1 * u.dimensionless_unscaled])
def test_a_quantity_that_does_not_fit_is_named(given):
    with pytest.raises(InputError, match="pa"):
        number(given, "deg", "pa")


def test_directions():
    sky = SkyCoord(l=150.1, b=40.2, unit="deg", frame="galactic")
    ra, dec = direction(sky, None)
    assert sky.separation(SkyCoord(ra, dec, unit="deg")).arcsec < 1e-6
    assert direction(10.0, -5) == (10.0, -5)
    assert direction(Angle("2h"), 30 * u.arcmin) == (pytest.approx(30.0), 0.5)


@pytest.mark.parametrize(
    "ra, dec, message",
    [
        (10.0, None, "dec"),
        (SkyCoord(1, 2, unit="deg"), 9, "its own"),
        (SkyCoord([1, 2], [2, 3], unit="deg"), None, "one position"),
        (SkyCoord(az=10, alt=20, unit="deg", frame=AltAz()), None, "altaz"),
    ],
)
def test_what_is_no_direction_is_refused(ra, dec, message):
    with pytest.raises(InputError, match=message):
        direction(ra, dec)


def test_times_are_utc_to_the_microsecond():
    text = "2027-11-20T01:20:00.123456"
    assert utc_text(Time(text, scale="utc")) == text
    assert utc_text(Time(text, scale="utc").tdb) == text
    assert utc_text(text) == text
    with pytest.raises(InputError, match="one time"):
        utc_text(Time([text, text]))


@pytest.mark.parametrize("dec", [-89.9, 0.0, 60.0])
@pytest.mark.parametrize("epoch", [1990.0, 2016.0])
def test_moving_positions_come_to_j2000(dec, epoch):
    sky = SkyCoord(
        359.9999 * u.deg, dec * u.deg, pm_ra_cosdec=800 * u.mas / u.yr, pm_dec=-900 * u.mas / u.yr,
        obstime=Time(epoch, format="jyear", scale="tdb"),
    )  # fmt: skip
    columns = position_columns(sky.reshape(1), "sky", "table")
    ra, dec = moved(sky.ra.deg, sky.dec.deg, 800.0, -900.0, 2000.0 - epoch)
    found = SkyCoord(columns["ra"], columns["dec"], unit="deg")
    assert found.separation(SkyCoord(ra, dec, unit="deg")).mas[0] < 0.01  # of 12 to 20 arcsec
    assert np.hypot(columns["pmra"], columns["pmdec"])[0] == pytest.approx(np.hypot(800, 900), rel=1e-6)


def test_distances_and_velocities_are_columns():
    sky = SkyCoord(
        [10] * u.deg, [20] * u.deg, distance=[50] * u.pc, pm_ra_cosdec=[3] * u.mas / u.yr, pm_dec=[4] * u.mas / u.yr,
        radial_velocity=[-12] * u.km / u.s,
    )  # fmt: skip
    columns = {name: float(values[0]) for name, values in position_columns(sky, "sky", "table").items()}
    wanted = {"ra": 10, "dec": 20, "pmra": 3, "pmdec": 4, "rv": -12, "parallax": 20}
    assert columns == {name: pytest.approx(value) for name, value in wanted.items()}


def test_a_frame_without_icrs_positions_is_refused():
    with pytest.raises(InputError, match="altaz"):
        position_columns(SkyCoord(az=[10], alt=[20], unit="deg", frame=AltAz()), "sky", "table")


@pytest.mark.parametrize("kind", [Table, QTable])
def test_a_table_may_have_a_sky_coord(kind, tmp_path):
    sky = SkyCoord([10, 350], [-80, 5], unit="deg").galactic
    table = kind({"where": sky, "mag_r": [20.0, 21.0]})
    for given in (table, _written(table, tmp_path / "objects.ecsv")):
        objects = object_table(plain_columns(given), BANDS, "table")
        assert np.allclose(objects["ra"], [10, 350], atol=1e-9, rtol=0)
        assert np.allclose(objects["dec"], [-80, 5], atol=1e-9, rtol=0)


def _written(table, path):
    table.write(path)
    return Table.read(path)


def test_columns_that_are_given_come_first():
    sky = SkyCoord([1] * u.deg, [2] * u.deg, pm_ra_cosdec=[3] * u.mas / u.yr, pm_dec=[4] * u.mas / u.yr)
    columns = plain_columns(Table({"sky": sky, "pmra": [7.0], "mag_r": [20.0]}))
    assert columns["pmra"] == [7.0] and columns["pmdec"] == [4.0]
    own = plain_columns(Table({"sky": sky, "ra": [5.0], "dec": [6.0]}))
    assert own["ra"] == [5.0] and own["dec"] == [6.0] and "pmra" not in own


def test_two_sky_coords_are_refused():
    sky = SkyCoord([1], [2], unit="deg")
    with pytest.raises(InputError, match="here, there"):
        plain_columns(Table({"here": sky, "there": sky, "mag_r": [20.0]}))


def test_times_of_a_motion_are_mjd():
    times = Time([61000.25, 61001.5], format="mjd", scale="utc")
    for given in (times, times.tai):
        columns = plain_columns(Table({"ra": [1.0, 2], "dec": [1.0, 2], "rate_mjd": given}))
        assert np.allclose(columns["rate_mjd"], times.mjd, rtol=0, atol=1e-9)
