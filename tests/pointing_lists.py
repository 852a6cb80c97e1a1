"""Lists of pointings as others write them, in four formats, and what astropy says their rows are.

The true exposures are drawn first, in ICRS with a spacecraft's state that sees the sky; each format then states them in
its own units and senses. `expected` goes the way back with astropy alone.
"""

import astropy.units as u
import numpy as np
from astropy.coordinates import GCRS, BarycentricMeanEcliptic, CartesianRepresentation, SkyCoord, get_body
from astropy.io import fits
from astropy.table import Table
from astropy.time import Time, TimeDelta

from csstsim.base.units import EARTH_RADIUS_KM

FORMATS = "sexagesimal CSV", "ecliptic ECSV", "FITS", "strategy list"
EAST_OF_NORTH = 90.0  # deg: the FITS list's angle is that of +x, and +x is a quarter turn from +y
SPEED = 7.67  # km/s


def exposures(count, seed=11):
    """Return a Table of exposures whose spacecraft has the sky in front of it, over a year."""
    rng = np.random.default_rng(seed)
    lon, lat = rng.uniform(0, 360, count), np.degrees(np.arcsin(rng.uniform(-1, 1, count)))
    lon[:3], lat[:3] = (0.0, 359.9999999, 180.0), (0.0, -89.5, 89.5)
    there = SkyCoord(lon * u.deg, lat * u.deg)
    away = there.cartesian.xyz.value.T + 0.3 * rng.normal(size=(count, 3))  # the zenith is near the boresight
    zenith = away / np.linalg.norm(away, axis=1)[:, None]
    along = np.cross(zenith, rng.normal(size=(count, 3)))
    velocity = SPEED * along / np.linalg.norm(along, axis=1)[:, None]
    start = Time("2027-06-01T00:00:00", scale="utc") + TimeDelta(np.sort(rng.uniform(0, 365.25, count)), format="jd")
    return Table(
        {
            "ra": lon, "dec": lat, "pa": rng.uniform(0, 360, count), "time": start,
            "exptime": rng.choice([150.0, 250.0, 33.3], count), "deep": rng.uniform(size=count) < 0.2,
            "position": (EARTH_RADIUS_KM + 400.0) * zenith, "velocity": velocity,
            "obsid": 10100000001 + np.arange(count),
        }
    )  # fmt: skip


def bodies(truth):
    """Return {body: (n, 3) positions [km], geocentric GCRS} by astropy's ephemeris."""
    return {name: get_body(name, truth["time"]).cartesian.xyz.to_value(u.km).T for name in ("sun", "moon")}


def write(kind, truth, folder):
    """Write the list of one of FORMATS; return (file, arguments of csstsim import-pointings)."""
    return {
        "sexagesimal CSV": _sexagesimal, "ecliptic ECSV": _ecliptic, "FITS": _fits, "strategy list": _strategy,
    }[kind](truth, folder)  # fmt: skip


def _sexagesimal(truth, folder):
    """RA and DEC as 10:00:00.0, JD in TT, angle through west, minutes; deep by word."""
    there = SkyCoord(truth["ra"], truth["dec"], unit="deg")
    rows = zip(
        there.ra.to_string(u.hourangle, sep=":", precision=7, pad=True),
        there.dec.to_string(u.deg, sep=":", precision=6, pad=True, alwayssign=True),
        (-truth["pa"]) % 360.0 - 180.0, truth["time"].tt.to_value("jd", subfmt="decimal"), truth["exptime"] / 60.0,
        truth["deep"], strict=True,
    )  # fmt: skip
    lines = ["# of a planner", "RA,DEC,Angle,JD,Minutes,Deep"]
    lines += [
        f'{ra},{dec},{float(pa)!r},{jd:.12f},"{float(minutes)!r}",{"yes" if d else "no"}'
        for ra, dec, pa, jd, minutes, d in rows
    ]
    (folder / "plan.csv").write_text("\n".join(lines) + "\n")
    maps = "ra_hms=RA", "dec_dms=DEC", "pa=Angle", "time_jd_tt=JD", "exptime_min=Minutes", "deep=Deep"
    return folder / "plan.csv", [*_repeated("--map", maps), "--pa-sense", "west", "--pa-zero", "180"]


def _ecliptic(truth, folder):
    """Ecliptic coordinates and an angle from the ecliptic's north; ISO in TAI; m and m/s: units are the file's."""
    ecliptic = BarycentricMeanEcliptic(equinox="J2000")
    there = SkyCoord(truth["ra"], truth["dec"], unit="deg")
    north = there.transform_to(ecliptic).directional_offset_by(0 * u.deg, 0.01 * u.deg).icrs
    table = Table()
    table["ecl_lon"] = there.transform_to(ecliptic).lon.to(u.rad)
    table["ecl_lat"] = there.transform_to(ecliptic).lat.to(u.deg)
    table["pa"] = ((truth["pa"] - there.position_angle(north).deg) % 360.0) * u.deg
    table["start"] = np.char.replace(Time(truth["time"], precision=9).tai.iso, " ", "T")
    table["exptime"] = truth["exptime"] * u.s
    for k, axis in enumerate("xyz"):
        table[f"sat_{axis}"] = 1e3 * truth["position"][:, k] * u.m
        table[f"sat_v{axis}"] = 1e3 * truth["velocity"][:, k] * u.m / u.s
    table.write(folder / "plan.ecsv", format="ascii.ecsv", overwrite=True)
    return folder / "plan.ecsv", ["--map", "time_iso_tai=start", "--pa-north", "ecliptic"]


def _fits(truth, folder):
    """Decimal hours, MJD as two kinds of number, an angle of +x, the obsid a number, Sun and Moon angles."""
    there = SkyCoord(truth["ra"], truth["dec"], unit="deg")
    found = bodies(truth)
    columns = [
        fits.Column("ALPHA", "D", unit="hourangle", array=truth["ra"] / 15.0),
        fits.Column("DELTA", "D", unit="deg", array=truth["dec"]),
        fits.Column("ROT", "D", array=(truth["pa"] + EAST_OF_NORTH) % 360.0),
        fits.Column("START_MJD", "D", unit="d", array=truth["time"].mjd),
        fits.Column("EXP", "E", unit="s", array=truth["exptime"]),
        fits.Column("KIND", "8A", array=np.array(["scie"] * len(truth))),
        fits.Column("OBS", "K", array=truth["obsid"]),
        fits.Column("FLAG", "L", array=truth["deep"]),
    ]
    for body, place in found.items():
        seen = SkyCoord(CartesianRepresentation((place - truth["position"]).T * u.km), frame=GCRS())
        apart = SkyCoord(there.ra, there.dec, frame=GCRS()).separation(seen)
        columns.append(fits.Column(f"{body}_angle", "D", unit="deg", array=apart.deg))
    for k, name in enumerate(("sat_x", "sat_y", "sat_z")):
        columns.append(fits.Column(name, "D", unit="km", array=truth["position"][:, k]))
    for k, name in enumerate(("sat_vx", "sat_vy", "sat_vz")):
        columns.append(fits.Column(name, "D", unit="km/s", array=truth["velocity"][:, k]))
    fits.BinTableHDU.from_columns(columns).writeto(folder / "plan.fits", overwrite=True)
    maps = (
        "ra_hour=ALPHA",
        "dec=DELTA",
        "pa=ROT",
        "time=START_MJD",
        "exptime=EXP",
        "type=KIND",
        "obsid=OBS",
        "deep=FLAG",
    )
    return folder / "plan.fits", [*_repeated("--map", maps), "--pa-zero", f"{-EAST_OF_NORTH:g}"]


def _strategy(truth, folder):
    """The 21 columns of the CSST strategy's list, between blanks and without names."""
    there, found = SkyCoord(truth["ra"], truth["dec"], unit="deg"), bodies(truth)
    ecliptic = there.transform_to(BarycentricMeanEcliptic(equinox="J2000"))
    columns = [truth["ra"], truth["dec"], ecliptic.lon.deg, ecliptic.lat.deg, truth["pa"]]
    texts = [[f"{v:.9f}" for v in column] for column in columns]
    texts += [[f"{jd:.11f}" for jd in truth["time"].to_value("jd", subfmt="decimal")]]
    for place in (truth["position"], found["sun"], found["moon"], truth["velocity"]):
        texts += [[f"{v:.6f}" for v in column] for column in place.T]
    texts += [[f"{v:g}" for v in truth["exptime"]], ["3" if deep else "-1" for deep in truth["deep"]]]
    texts += [[str(obsid) for obsid in truth["obsid"]]]
    (folder / "plan.dat").write_text("".join("  ".join(row) + " \n" for row in zip(*texts, strict=True)))
    return folder / "plan.dat", ["--like", "csst"]


def _repeated(option, values):
    return [word for value in values for word in (option, value)]
