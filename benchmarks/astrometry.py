"""Astrometry against ERFA's own chain, astropy and DE440, and its speed.

    python benchmarks/astrometry.py

Prints the largest differences over the whole sky [microarcsecond] for one spacecraft state, and CPU seconds for 200,000
objects.
"""

import argparse
import time

from evidence.record import Record

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


def main(record):
    rng, n = np.random.default_rng(1), 2000 if record.toy else N
    ra, dec = rng.uniform(0, 360, n), np.degrees(np.arcsin(rng.uniform(-1, 1, n)))
    motion = {"pmra": rng.normal(0, 500, n), "pmdec": rng.normal(0, 500, n), "parallax": rng.exponential(20, n)}
    motion["rv"] = rng.normal(0, 150, n)
    craft, many = observer(*STATE), observer(*STATE, planets=True)
    epoch, seconds = timed(at_epoch, ra, dec, craft, **motion)
    seen, more = timed(apparent, *epoch, craft)
    record.value("forward_cpu", seconds + more, f"{N:,} positions to the apparent direction", unit="CPU-s")
    back, seconds = timed(icrs, *seen, craft)
    record.value("back_cpu", seconds, f"{N:,} apparent directions to ICRS", unit="CPU-s")

    def largest(name, one, other, what, below, where=None):
        apart = separation(one, other)
        record.value(name, (apart if where is None else apart[where]).max(), what, unit="uas", below=below)

    star = (
        np.radians(ra), np.radians(dec), np.radians(motion["pmra"] / 3.6e6) / np.cos(np.radians(dec)),
        np.radians(motion["pmdec"] / 3.6e6), motion["parallax"] / 1e3, motion["rv"],
    )  # fmt: skip
    largest("atciq", seen, np.degrees(erfa.atciq(*star, craft.astrom)), "against erfa.atciq", 0.01)
    far = separation((ra, dec), np.degrees(erfa.c2s(-craft.astrom["eh"]))) > 3.6e9  # 1 deg: fade-outs differ
    theirs = np.degrees(erfa.atciqn(*star, many.astrom, np.concatenate([many.bodies, sun()])))
    planets = apparent(*epoch, many)
    largest("atciqn", planets, theirs, "against erfa.atciqn with planets, > 1 deg from the Sun", 1, far)
    still = apparent(*at_epoch(ra, dec, craft, parallax=motion["parallax"]), craft)
    theirs = by_astropy(ra, dec, motion["parallax"])
    largest("astropy", still, theirs, "against astropy, ICRS to GCRS (no proper motion)", 1)
    largest("round_trip", back, epoch, "round trip, apparent to ICRS", 0.01)
    j2000 = at_j2000(*back, craft, **motion)
    largest("round_trip_j2000", j2000, (ra, dec), "apparent to J2000, |dec| < 88 deg", 1, np.abs(dec) < 88)
    largest("planets", seen, planets, "planets against the Sun alone", None)
    try:
        other = observer(*STATE, ephemeris="de440")
    except InputError as exc:
        record.skip("DE440", str(exc))
        return
    seen_there = apparent(*at_epoch(ra, dec, other, **motion), other)
    largest("de440", seen, seen_there, "epv00 against DE440, > 1 deg from the Sun", 2, far)


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
    with Record(argparse.ArgumentParser(description=__doc__.splitlines()[0])) as record:
        main(record)
