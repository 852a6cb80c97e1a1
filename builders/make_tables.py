"""Make every table of survey_tables/, and measure the coverage of each field.

    python builders/make_tables.py [folder]             write the tables that differ (default: survey_tables/)
    python builders/make_tables.py --check [folder]     write nothing; exit code 1 if a table differs
    python builders/make_tables.py --coverage           print each filter's coverage of the 5 deg2 circles

Nothing is random: the same code and config/instrument/ give the same bytes. Tables are the same if numbers are equal to
two units of their last digit, which is left to another machine's rounding, and words and times are equal. Field
centres, sizes and numbers of exposures are those of the paper's Cycle-9 runs (Table 1); their real pointings are not
public.
"""

import argparse
import sys
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
from kept import Keeper
from year_of_visits import iso, visited

from csstsim.base.shipped import SHIPPED
from csstsim.catalog.astrometry.ephemeris import observer
from csstsim.catalog.astrometry.reduction import apparent, icrs
from csstsim.instrument.camera import load_camera
from csstsim.instrument.pointing import Pointing, mjd_utc
from csstsim.optics.geometry.pointing_for import pointing_for
from csstsim.optics.geometry.wcs import ChipWCS

PA = -113.4333  # deg, the roll of the published headers
EXPTIME = 150.0  # s, wide survey
CADENCE = timedelta(seconds=240)  # exposure 150, readout 40, slew and settle 50
RADIUS = np.sqrt(5.0 / np.pi)  # deg, of 5 deg2

# name: ra, dec, exposures (paper, Table 1), first night to try, when the field is far from the Sun
FIELDS = {
    "w1": (30.0, -48.0, 226, datetime(2027, 10, 10, tzinfo=UTC)),
    "w2": (170.0, -23.0, 228, datetime(2028, 3, 5, tzinfo=UTC)),
    "w3": (180.0, 60.0, 261, datetime(2028, 3, 20, tzinfo=UTC)),
    "w4": (240.0, 30.0, 266, datetime(2028, 5, 20, tzinfo=UTC)),
    "w5": (300.0, -60.0, 240, datetime(2027, 7, 15, tzinfo=UTC)),
}
DEMO_TARGET = (60.1172, -40.0330)  # the middle of HEALPix brick 550615, so that one truth brick serves the demo
RICH_TARGET = (300.0920, -59.8671)  # the middle of brick 732596 in W5: six times as many stars
DEMO_FIRST, RICH_FIRST = datetime(2027, 11, 20, tzinfo=UTC), datetime(2027, 7, 15, tzinfo=UTC)  # first nights to try
DEMO_CHIPS = (12, 14, 8, 9, 7, 11, 6)  # one for each of NUV u g r i z y
DEMO_DITHER = 200.0  # px
DEMO_SPECTRA = (29,)  # a GV chip
PACK_SPECTRA = (28, 29, 30)  # GU, GV, GI
SPECTRA_COLUMN = 2500.0  # whose left grating spreads all spectra over these chips

# Conditions of a slot; the first keeps the bright Earth's limb at least 55 deg away (400 km orbit)
ZENITH_MAX, SUN_MIN, MOON_MIN = 55.0, 50.0, 40.0  # deg


def slots(camera, ra, dec, first, count):
    """Return `count` start times, from `first` on, at which the spacecraft can observe ra, dec."""
    found, when = [], first
    target = _unit(ra, dec)
    while len(found) < count:
        clear = _sun_and_moon_clear(target, when)
        for _ in range(int(timedelta(days=1) / CADENCE)):
            ends = (when, when + timedelta(seconds=EXPTIME))
            up = all(_angle(target, np.array(camera.orbit.state(iso(t))[0])) < ZENITH_MAX for t in ends)
            if clear and up and len(found) < count:
                found.append(when)
            when += CADENCE
    return found


def _sun_and_moon_clear(target, day):
    from astropy.coordinates import get_body
    from astropy.time import Time

    time = Time((day + timedelta(hours=12)).replace(tzinfo=None), scale="tdb")
    limits = {"sun": SUN_MIN + 1.0, "moon": MOON_MIN + 8.0}  # they move up to 1 and 15 deg a day
    return all(_angle(target, get_body(name, time).cartesian.xyz.value) > limit for name, limit in limits.items())


def wide_field(camera, name, prefix):
    """Return the exposures of one field: a grid with a pitch below a chip's side, on the field's tangent plane.

    Camera axes stay parallel on that plane (pa follows the meridians), so neighbouring chips tile without wedges.
    Each chip then covers the circle without its rim, and the opposite chip of the same filter covers the rim.
    """
    ra, dec, count, first = FIELDS[name]
    chip = camera.chips[13]
    plane = ChipWCS(chip, _pointing(ra, dec, PA))
    reach = RADIUS + 0.17  # deg: beyond the circle, so that opposite chips cover its rim
    pitch = np.sqrt(np.pi * (reach * 3600 / camera.telescope.pixel_scale) ** 2 / count)
    steps = np.arange(-30, 31) * pitch
    x, y = (axis.ravel() for axis in np.meshgrid(steps, steps + pitch / 2))
    near = np.argsort(np.hypot(x, y).round(3), kind="stable")[:count]
    # Row by row in alternating directions, which keeps slews short
    row = np.round(y[near] / pitch - 0.5).astype(int)
    near = near[np.lexsort((np.where(row % 2, -1, 1) * x[near], row))]
    dither = 0.02 * pitch * np.cos(2.4 * np.arange(count)), 0.02 * pitch * np.sin(2.4 * np.arange(count))
    x0, y0 = plane.crpix - 1
    ras, decs = plane.pixel_to_world(x0 + x[near] + dither[0], y0 + y[near] + dither[1])
    up = np.linalg.inv(plane.jacobian(ras, decs))[..., :, 1]  # east, north of the plane's +y
    pas = np.degrees(np.arctan2(up[..., 0], up[..., 1]))
    times = slots(camera, ra, dec, first, count)
    return {
        f"{prefix}{i:06d}": _pointing(*where, time=iso(t))
        for i, (t, *where) in enumerate(zip(times, ras, decs, pas, strict=True), start=1)
    }


def spread_over_a_year(camera, exposures):
    """Return the exposures of `wide_field` at other times: the same places on the sky, in visits spread over a year."""
    places = []
    for e in exposures.values():
        seen_by = observer(mjd_utc(e.time), *camera.orbit.state(e.time))
        places.append(tuple(float(v) for v in icrs(e.ra, e.dec, seen_by)))
    moved = {}
    times = visited(camera.orbit, places, EXPTIME, CADENCE)
    for (obsid, e), place, (time, *state) in zip(exposures.items(), places, times, strict=True):
        ra, dec = apparent(*place, observer(mjd_utc(time), *state))
        moved[obsid] = _pointing(float(ra), float(dec), e.pa, time=time, state=tuple(state))
    return moved


def one_target(camera, target, first, spectra=DEMO_SPECTRA, turns=(PA,)):
    """Return exposures of one target: two a quarter turn apart on a chip of each imaging band, spectra after them.

    spectra: chips with gratings; turns: the position angles of their exposures.
    """
    exposures = {}
    times = slots(camera, *target, first, 2 * len(DEMO_CHIPS) + len(spectra) * len(turns))
    for pa in (PA, PA + 90.0):
        for chip_id in DEMO_CHIPS:
            chip = camera.chips[chip_id]
            i = len(exposures)
            angle = 2.4 * i
            x = (chip.detector.nx - 1) / 2 + DEMO_DITHER * np.cos(angle)
            y = (chip.detector.ny - 1) / 2 + DEMO_DITHER * np.sin(angle)
            exposure = _pointing(0.0, 0.0, pa, time=iso(times[i]))
            exposures[f"10100{i + 1:06d}"] = pointing_for(exposure, chip, target, (x, y))
    for pa in turns:
        for chip in (camera.chips[number] for number in spectra):
            i = len(exposures)
            place = SPECTRA_COLUMN, (chip.detector.ny - 1) / 2
            exposure = _pointing(0.0, 0.0, pa, time=iso(times[i]))
            exposures[f"10100{i + 1:06d}"] = pointing_for(exposure, chip, target, place)
    return exposures


def calibration():
    """Return five biases, three darks and three LED flats; the pointing is a parking position."""
    kinds = [("BIAS", "103", 5, 0.0), ("DARK", "107", 3, EXPTIME), ("FLAT", "100", 3, EXPTIME)]
    exposures, when = {}, datetime(2027, 6, 1, tzinfo=UTC)
    for kind, code, count, exptime in kinds:
        for i in range(1, count + 1):
            where = _pointing(0.0, 0.0, PA, time=iso(when), kind=kind, exptime=exptime)
            exposures[f"{code}{i:08d}"] = where
            when += CADENCE
    return exposures


def covered(camera, exposures, ra, dec, samples=4000):
    """Return {filter: times each of `samples` points, spread evenly over the 5 deg2 circle, is exposed}."""
    k = np.arange(samples)
    distance, turn = RADIUS * np.sqrt((k + 0.5) / samples), k * np.pi * (3 - np.sqrt(5))
    centre = ChipWCS(camera.chips[13], _pointing(ra, dec, 0.0))
    px = distance * 3600 / camera.telescope.pixel_scale
    x0, y0 = centre.crpix - 1
    point = centre.pixel_to_world(x0 + px * np.cos(turn), y0 + px * np.sin(turn))
    counts = {name: np.zeros(samples, dtype=int) for name in camera.filters}
    for exposure in exposures.values():
        for chip in camera.chips.values():
            counts[chip.filter] += chip.full_window.contains(*ChipWCS(chip, exposure).world_to_pixel(*point))
    return counts


def write_table(path, exposures, comment, states=False):
    """Write a survey table of {obsid: Pointing}; without spacecraft `states`, they follow from the orbit model."""
    lines = [f"# {comment}", "# made by make_tables.py; columns: README.md", "obsid,type,ra,dec,pa,time,exptime"]
    lines[-1] += ",sat_x,sat_y,sat_z,sat_vx,sat_vy,sat_vz" if states else ""
    for obsid, e in exposures.items():
        line = f"{obsid},{e.type},{e.ra:.6f},{e.dec:.6f},{e.pa:.4f},{e.time},{e.exptime:g}"
        state = [f"{x:.3f}" for x in e.sat_position] + [f"{v:.6f}" for v in e.sat_velocity]
        lines.append(",".join([line, *state] if states else [line]))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")


def same_table(one: Path, other: Path) -> bool:
    """Tell whether two tables have the same words, and numbers equal to two units of their last digit."""
    cells = [path.read_text(encoding="utf-8").replace("\n", ",\n,").split(",") for path in (one, other)]
    return len(cells[0]) == len(cells[1]) and all(map(_same_cell, *cells))


def _same_cell(one: str, other: str) -> bool:
    decimals = len(one.partition(".")[2])
    if one == other or not decimals or decimals != len(other.partition(".")[2]):
        return one == other
    try:
        return abs(float(one) - float(other)) <= 2.5 * 10.0**-decimals
    except ValueError:
        return False


def make_all(folder: Path, camera, keeper: Keeper | None = None) -> None:
    """Write all tables into `folder`, if they differ."""
    keeper = keeper or Keeper()

    def write(path, *about, **options):
        with keeper.file(path, same_table) as new:
            write_table(new, *about, **options)

    write(folder / "calibration.csv", calibration(), "bias, dark and LED flat exposures")
    comment = "one target, seven bands, two position angles each; one GV chip"
    write(folder / "demo.csv", one_target(camera, DEMO_TARGET, DEMO_FIRST), comment)
    write(folder / "rich_field.csv", one_target(camera, RICH_TARGET, RICH_FIRST), comment + "; among more stars")
    both = one_target(camera, RICH_TARGET, RICH_FIRST, PACK_SPECTRA, (PA, PA + 90.0))
    write(folder / "benchmark_pack.csv", both, "one target, seven bands and three gratings, two position angles each")
    for number, name in enumerate(FIELDS, start=1):
        ra, dec, count, _ = FIELDS[name]
        comment = f"{name.upper()}: 5 deg2 around ra {ra:g}, dec {dec:g}; {count} exposures (paper, Table 1)"
        dark = wide_field(camera, name, f"101{number:02d}")
        write(folder / f"{name}.csv", dark, comment)
        spread = spread_over_a_year(camera, dark)
        write(folder / f"{name}_straylight.csv", spread, comment + "; spread over a year", states=True)


NO_STATE = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))  # not written and not used


def _pointing(ra, dec, pa, time="2027-01-01T00:00:00", kind="SCIE", exptime=EXPTIME, state=NO_STATE):
    return Pointing(kind, float(ra), float(dec), float(pa), time, exptime, *state)


def _unit(ra, dec):
    a, d = np.radians([ra, dec])
    return np.array([np.cos(d) * np.cos(a), np.cos(d) * np.sin(a), np.sin(d)])


def _angle(a, b):
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), np.dot(a, b)))


def main() -> int:
    """Do what is asked for; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", type=Path, default=SHIPPED.parent / "survey_tables")
    parser.add_argument("--check", action="store_true", help="write nothing; exit code 1 if a table differs")
    parser.add_argument("--coverage", action="store_true", help="print each filter's coverage of the fields")
    options = parser.parse_args()
    camera = load_camera(SHIPPED / "instrument")
    if options.coverage:
        for name, (ra, dec, _, _) in FIELDS.items():
            counts = covered(camera, wide_field(camera, name, "10199"), ra, dec)
            print(f"{name}: part of the circle exposed once or more, twice or more; mean exposures of a point")
            for band, n in counts.items():
                print(f"  {band:4s}{(n > 0).mean():.4f}  {(n > 1).mean():.3f}  {n.mean():.2f}")
        return 0
    keeper = Keeper(options.check)
    make_all(options.folder, camera, keeper)
    return keeper.code()


if __name__ == "__main__":
    sys.exit(main())
