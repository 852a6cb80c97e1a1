"""A campaign of one small field: bright, faint and saturated stars, galaxies, and blends, in two filters."""

import csv

import numpy as np
import yaml

from csstsim.base.rng import stream
from csstsim.campaign.opened import OpenCampaign
from csstsim.catalog.astrometry.reduction import icrs
from support.mini_campaign import write_campaign

SIDE = 1216  # px of the chips
GEOMETRY = {
    "nx": SIDE, "ny": SIDE, "channel_nx": SIDE // 4, "channels_x": 4, "channel_ny": SIDE // 2, "prescan": 4,
    "overscan": 48, "parallel_overscan": 4,
}  # fmt: skip
CENTRE, TIME = (60.1172, -40.0330), "2027-11-20T01:{:02d}:00"
# Chip, position angle [deg], dither [px] of each exposure
EXPOSURES = (
    (9, 20.0, (0, 0)), (9, 20.0, (23, -14)), (9, 110.0, (-9, 31)), (9, 110.0, (17, 12)),
    (8, 20.0, (5, 8)), (8, 110.0, (-13, -6)),
)  # fmt: skip
STEP = 48  # px between objects on a shaken lattice
FULL_WELL = 8000.0  # e-: stars of 18 mag are saturated, whose wings leave room for others
KINDS = {  # number, r magnitude of the brightest and the faintest
    "saturated": (30, 17.8, 18.2), "star": (240, 19.4, 22.9), "galaxy": (300, 21.0, 22.7), "blend": (100, 21.5, 25.0),
}  # fmt: skip
SIZE = 0.12, 0.35  # half-light radii of galaxies, arcsec


def write_field(folder, seed, **changes):
    """Write the campaign of a seed, with its own sky, noise and detector; return its file."""
    folder.mkdir(parents=True, exist_ok=True)
    plain = {"geometry": GEOMETRY, "seed": seed, "select": {"types": ["SCIE"], "chips": [8, 9]}} | changes
    first = _write(folder, _rows([CENTRE] * len(EXPOSURES)), **plain)
    pointings = [
        _aimed(OpenCampaign(first).job(_obsid(k), chip), dither) for k, (chip, _, dither) in enumerate(EXPOSURES)
    ]
    aimed = _write(folder, _rows(pointings), **plain)
    _write_objects(folder / "objects.csv", OpenCampaign(aimed).job(_obsid(0), EXPOSURES[0][0]), seed)
    region = {"ra": CENTRE[0], "dec": CENTRE[1], "radius": 0.1}  # arcmin: chooses the chip that was aimed
    table = {"kind": "csstsim.catalog.own_table:TableCatalog", "options": {"file": str(folder / "objects.csv")}}
    return _write(
        folder, _rows(pointings), **plain | {"select": plain["select"] | {"region": region}, "catalog": table}
    )


def _write(folder, pointings, **changes):
    """Write the campaign with the smaller full well; return its file."""
    file = write_campaign(folder, pointings, **changes)
    path = folder / "instrument" / "detector.yaml"
    numbers = yaml.safe_load(path.read_text())
    numbers["charge"]["full_well"]["value"] = FULL_WELL
    path.write_text(yaml.safe_dump(numbers))
    return file


def _obsid(k):
    return f"1010000000{k + 1}"


def _rows(pointings):
    return [
        f"{_obsid(k)},SCIE,{ra:.7f},{dec:.7f},{pa},{TIME.format(4 * k + 8)},150"
        for k, ((ra, dec), (_, pa, _)) in enumerate(zip(pointings, EXPOSURES, strict=True))
    ]


def _aimed(job, dither):
    """Return the boresight (ra, dec) that puts CENTRE on the middle of a job's chip, plus a dither; to some pixels."""
    ra, dec = CENTRE
    seen = icrs(*job.wcs.pixel_to_world(SIDE / 2 + dither[0], SIDE / 2 + dither[1]), job.observer)
    return 2 * ra - float(seen[0]), 2 * dec - float(seen[1])


def _write_objects(path, job, seed):
    rng, middle = stream(seed, "field"), (SIDE - 1) / 2
    line = np.arange(-SIDE // 2 - STEP, SIDE // 2 + STEP, STEP)
    places = rng.permutation(np.stack([v.ravel() for v in np.meshgrid(line, line)], axis=1))
    places = places + rng.uniform(-6.0, 6.0, places.shape)
    rows, start = [], 0
    for kind, (count, bright, faint) in KINDS.items():
        if kind == "blend":  # anywhere
            at = rng.uniform(-SIDE / 2, SIDE / 2, (count, 2))
        else:
            at, start = places[start : start + count], start + count
        mag, size = rng.uniform(bright, faint, count), rng.uniform(*SIZE, count)
        e = 0.25 * rng.standard_normal((2, count)).clip(-2, 2)
        sky = icrs(*job.wcs.pixel_to_world(middle + at[:, 0], middle + at[:, 1]), job.observer)
        wide = np.full(count, kind == "galaxy") | ((kind == "blend") & (rng.uniform(size=count) < 0.7))
        for k in range(count):
            shape = (size[k], *e[:, k]) if wide[k] else (0.0, 0.0, 0.0)
            name = "galaxy" if wide[k] else "star"
            rows.append((name, *(repr(float(v[k])) for v in sky), round(mag[k] + 0.5, 4), round(mag[k], 4), *shape))
    with path.open("w", newline="") as file:
        csv.writer(file).writerows([("type", "ra", "dec", "mag_g", "mag_r", "size", "e1", "e2"), *rows])
