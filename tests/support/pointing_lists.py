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


# Lists of two rows, the second of which is broken.
DAY = "61729.125"  # 2027-11-20T03:00:00
HEAD = "ra,dec,pa,mjd,exptime"
GOOD = f"60,-40,10,{DAY},150"
STATE = ",sat_x_km,sat_y_km,sat_z_km,sat_vx,sat_vy,sat_vz"
ABOVE = "60,40,10,61729.125,150,2596.6,4497.4,4357.5,-6.6,3.8,0"  # the zenith is at ra 60, dec 40
MOON = 71.68  # deg from there at that time
BROKEN = {  # what is wrong: (heading, sound row, broken row, the reason)
    "pole": (HEAD, GOOD, f"60,-90.001,10,{DAY},150", "column dec: out of range: -90.001 deg (got '-90.001')"),
    "longitude": (HEAD, GOOD, f"360.5,-40,10,{DAY},150", "column ra: out of range: 360.5 deg"),
    "infinite": (HEAD, GOOD, f"inf,-40,10,{DAY},150", "column ra: not a finite number (got 'inf')"),
    "NaN": (HEAD, GOOD, f"60,nan,10,{DAY},150", "column dec: not a finite number (got 'nan')"),
    "word": (HEAD, GOOD, f"60,south,10,{DAY},150", "column dec: not a number (got 'south')"),
    "empty": (HEAD, GOOD, f"60,-40,,{DAY},150", "column pa: no value"),
    "sexagesimal": (HEAD, GOOD, f"04:00:00,-40,10,{DAY},150", "column ra: not a number (got '04:00:00'); allowed"),
    "JD for MJD": (HEAD, GOOD, "60,-40,10,2461729.6,150", "column mjd: out of range (got '2461729.6'); allowed: a"),
    "angle": (HEAD, GOOD, f"60,-40,-361,{DAY},150", "column pa: out of range: -361 deg"),
    "no exposure": (HEAD, GOOD, f"60,-40,10,{DAY},0", "column exptime: zero exposure time"),
    "negative": (HEAD, GOOD, f"60,-40,10,{DAY},-150", "column exptime: out of range (got '-150')"),
    "short": (HEAD, GOOD, "60,-40,10,61729.1", "4 cells under 5 columns"),
    "long": (HEAD, GOOD, GOOD + ",7", "6 cells under 5 columns"),
    "open quote": (HEAD, GOOD, f'"60,-40,10,{DAY},150', "not a line of CSV"),
    "30 February": (HEAD.replace("mjd", "time"), "60,-40,10,2027-11-20 03:00:00,150",
                    "60,-40,10,2027-02-30T03:00:00,150", "column time: not a time (got '2027-02-30T03:00:00')"),
    "twice": (HEAD + ",obsid", GOOD + ",10100000001", GOOD + ",10100000001", "allowed: once; line 2 has it"),
    "obsid": (HEAD + ",obsid", GOOD + ",10100000001", GOOD + ",12", "column obsid: not an observation id (got '12')"),
    "type": (HEAD + ",type", GOOD + ",scie", GOOD + ",ARC", "column type: unknown exposure type (got 'ARC')"),
    "deep": (HEAD + ",deep", GOOD + ",yes", GOOD + ",perhaps", "column deep: neither deep nor wide (got 'perhaps')"),
    "deep bias": (HEAD + ",deep,type", GOOD + ",no,BIAS", GOOD + ",yes,BIAS", "column deep: allowed for science"),
    "number": (HEAD + ",number", GOOD + ",7", GOOD + ",7.5", "column number: not a whole number (got '7.5')"),
    "half a state": (HEAD + STATE, ABOVE, ABOVE.rsplit(",", 1)[0] + ",", "column sat_vz: no value"),
    "in m": (HEAD + STATE, ABOVE, ABOVE.replace("2596.6", "2596600"), "column sat_x_km: out of range"),
    "underground": (HEAD + STATE, ABOVE, ABOVE.replace("4497.4", "44.9"), "from the Earth's centre [km] out of"),
    "Earth in the way": (HEAD + STATE, ABOVE, ABOVE.replace("60,40,10", "240,-40,10"), "[deg]: looks at the Earth"),
    "ecliptic": (HEAD + ",ecl_lon,ecl_lat", GOOD + ",42.663,-58.609", GOOD + ",42.663,58.609", "two directions, 117"),
    "Moon": (HEAD + ",moon_angle" + STATE, ABOVE.replace(",150,", f",150,{MOON},"),
             ABOVE.replace(",150,", f",150,{MOON + 3},"), f"the list says {MOON + 3:.3f} deg from the Moon"),
}  # fmt: skip


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
