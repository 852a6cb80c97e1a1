"""Astrometry against ERFA's own chain, astropy and DE440, and its speed: python benchmarks/astrometry.py

Prints the largest differences over the whole sky [microarcsecond] for one spacecraft state, and CPU seconds for 200,000
objects.
"""

import argparse
import time

import erfa
import numpy as np
from astropy import units as u
from astropy.coordinates import GCRS, ICRS, CartesianRepresentation, SkyCoord
from astropy.time import Time

from csstsim.base.errors import InputError
from csstsim.catalog.astrometry.ephemeris import mjd_tt, observer
from csstsim.catalog.astrometry.reduction import apparent, at_epoch, at_j2000, icrs

N = 200_000
STATE = (61577.858310185, (1200.0, -5300.0, 3980.0), (5.1, 3.7, 3.4))  # UTC MJD, km, km / s


def main():
    rng = np.random.default_rng(1)
    ra, dec = rng.uniform(0, 360, N), np.degrees(np.arcsin(rng.uniform(-1, 1, N)))
    motion = {"pmra": rng.normal(0, 500, N), "pmdec": rng.normal(0, 500, N), "parallax": rng.exponential(20, N)}
    motion["rv"] = rng.normal(0, 150, N)
    craft, many = observer(*STATE), observer(*STATE, planets=True)
    epoch, one = timed(at_epoch, ra, dec, craft, **motion)
    seen, two = timed(apparent, *epoch, craft)
    back, three = timed(icrs, *seen, craft)
    rows = {f"CPU s, {N:,} objects: at_epoch, apparent, icrs": f"{one:.3f}, {two:.3f}, {three:.3f}"}
    star = (
        np.radians(ra), np.radians(dec), np.radians(motion["pmra"] / 3.6e6) / np.cos(np.radians(dec)),
        np.radians(motion["pmdec"] / 3.6e6), motion["parallax"] / 1e3, motion["rv"],
    )  # fmt: skip
    rows["against erfa.atciq"] = separation(seen, np.degrees(erfa.atciq(*star, craft.astrom)))
    away = separation((ra, dec), np.degrees(erfa.c2s(-craft.astrom["eh"]))) > 3.6e9  # 1 deg: fade-outs differ
    theirs = np.degrees(erfa.atciqn(*star, many.astrom, np.concatenate([many.bodies, sun()])))
    rows["against erfa.atciqn with planets, > 1 deg from the Sun"] = separation(apparent(*epoch, many), theirs)[away]
    still = apparent(*at_epoch(ra, dec, craft, parallax=motion["parallax"]), craft)
    rows["against astropy, ICRS to GCRS (no proper motion)"] = separation(
        still, by_astropy(ra, dec, motion["parallax"])
    )
    rows["round trip, apparent to ICRS"] = separation(back, epoch)
    calm = np.abs(dec) < 88
    rows["round trip, apparent to J2000, |dec| < 88 deg"] = separation(at_j2000(*back, craft, **motion), (ra, dec))[
        calm
    ]
    rows["planets against the Sun alone"] = separation(seen, apparent(*epoch, many))
    try:
        other = observer(*STATE, ephemeris="de440")
        places = apparent(*at_epoch(ra, dec, other, **motion), other)
        rows["epv00 against DE440, > 1 deg from the Sun"] = separation(seen, places)[away]
    except InputError as exc:
        rows["epv00 against DE440"] = str(exc)
    for name, value in rows.items():
        print(f"{name:58}", value if isinstance(value, str) else f"{value.max():.4g} uas")


def timed(function, *arguments, **keywords):
    function(*arguments, **keywords)
    start = time.process_time()
    return function(*arguments, **keywords), time.process_time() - start


def separation(one, other):
    a, b = (erfa.s2c(*np.radians(place)) for place in (one, other))
    return np.degrees(np.linalg.norm(a - b, axis=-1)) * 3.6e9


def sun():
    helio, bary = erfa.epv00(2400000.5, mjd_tt(STATE[0]))
    body = np.zeros(1, erfa.dt_eraLDBODY)
    body["bm"], body["dl"] = 1.0, 6e-6
    for axis in "pv":
        body["pv"][axis] = bary[axis] - helio[axis]
    return body


def by_astropy(ra, dec, parallax):
    frame = GCRS(
        obstime=Time(STATE[0], format="mjd", scale="utc"),
        obsgeoloc=CartesianRepresentation(STATE[1], unit=u.km),
        obsgeovel=CartesianRepresentation(STATE[2], unit=u.km / u.s),
    )
    place = ICRS(ra * u.deg, dec * u.deg, distance=206264806.247096 / parallax * u.au)
    seen = SkyCoord(place).transform_to(frame)
    return seen.ra.deg, seen.dec.deg


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    main()
