"""A field in three colours: 24 exposures in g, r and i through every layer, aligned by their WCS and co-added.

    python benchmarks/colour_field.py

The sky is the embedded universe around RA, DEC. A cluster of galaxies at z = 0.3, three large galaxies and a star
of 13.5 mag are added: the sky is that of `structure: none`, which has no clusters. The exposures are dithered, so the
median of them has no cosmic rays and no defects.
"""

import argparse
import tempfile
from pathlib import Path

from evidence.record import Record

import numpy as np
from astropy.table import Table, vstack
from astropy.visualization import make_lupton_rgb
from PIL import Image
from scipy.interpolate import RectBivariateSpline
from scipy.ndimage import map_coordinates, maximum_filter
from toy_sky import TOY_PSF

import csstsim
from csstsim.catalog.table import GALAXY, STAR, ObjectTable

RA, DEC, PA, CHIPS = 300.0, -60.0, 0.0, {"g": 8, "r": 9, "i": 7}
NX, NY, EXPOSURES, EXPTIME = 1800, 1250, 8, 250.0  # px of the picture; of each band; s
SCALE, DITHER, EDGE = 0.074, 4.0, 300  # arcsec / px; arcsec, rms of the positions; px of the frames beyond the picture
FAINTEST = 28.0  # i magnitude of the embedded objects that are drawn
WEIGHTS, LOW, STRETCH, Q = {"i": 1.05, "r": 0.97, "g": 1.5}, -0.012, 0.09, 9.0  # Lupton et al. 2004; electrons / s
SATURATED = 150.0  # electrons / s: shown white, for charge that bleeds has no colour
KIND = {STAR: "star", GALAXY: "galaxy"}


def offset(dx, dy):
    """Return ra, dec [deg] of places dx east and dy north [arcsec] of the field's middle."""
    return RA + np.asarray(dx) / 3600 / np.cos(np.radians(DEC)), DEC + np.asarray(dy) / 3600


def cluster(rng, x, y, members=180):
    """Return the Table of a cluster at z = 0.3 about x, y [arcsec]: a giant elliptical, and a red sequence."""
    r = 17.0 + np.concatenate([[0.0], np.sort(1.6 + 6.0 * rng.power(1.9, members - 1))])
    radius = 70.0 * rng.power(1.0, members) ** 1.6
    radius[0], angle = 0.0, rng.uniform(0, 2 * np.pi, members)
    ra, dec = offset(x + radius * np.cos(angle), y + 0.7 * radius * np.sin(angle))
    colour = rng.normal(0.0, 0.03, members) - 0.02 * (r - 17.0)  # the red sequence is bluer for faint members
    blue = rng.random(members) < 0.15
    blue[0] = False
    e, turn = rng.beta(2, 6, members), rng.uniform(0, np.pi, members)
    e[0] = 0.18
    return Table({
        "ra": ra, "dec": dec, "type": ["galaxy"] * members, "mag_g": r + np.where(blue, 0.7, 1.45) + colour, "mag_r": r,
        "mag_i": r - np.where(blue, 0.25, 0.52) - 0.3 * colour, "size": 3.0 * 10 ** (-0.13 * (r - 17.0)),
        "bulge_frac": np.where(blue, 0.1, rng.uniform(0.5, 1.0, members)), "e1": e * np.cos(2 * turn),
        "e2": e * np.sin(2 * turn),
    })  # fmt: skip


def foreground():
    """Return the Table of what lies in front: two disks, one nearly edge-on, an elliptical, and a bright star."""
    x, y = np.array([(46.0, -25.0), (-52.0, 22.0), (37.0, 32.0), (-38.0, -26.0)]).T
    ra, dec = offset(x, y)
    return Table({
        "ra": ra, "dec": dec, "type": ["galaxy"] * 3 + ["star"], "mag_g": [16.5, 17.4, 17.5, 13.6],
        "mag_r": [16.0, 17.0, 16.7, 13.5], "mag_i": [15.75, 16.75, 16.35, 13.45], "size": [4.5, 3.4, 1.8, 0.0],
        "bulge_frac": [0.2, 0.08, 1.0, 0.0], "e1": [0.2, -0.45, 0.1, 0.0], "e2": [0.22, 0.4, -0.1, 0.0],
    })  # fmt: skip


def embedded(cache):
    """Return the Table of the embedded universe's stars and galaxies of the bricks that the field needs."""
    sim = csstsim.Simulation(cache=cache).aim(RA, DEC, CHIPS["r"], size=max(NX, NY), pa=PA)
    sim.replace(catalog={"structure": "none", "mag_limit": 15.0}).light("10100000001", CHIPS["r"])  # makes the bricks
    rows = ObjectTable.concat([ObjectTable.read(path) for path in Path(cache).rglob("Npix=*.parquet")])
    x, y = (rows["ra"] - RA) * np.cos(np.radians(DEC)), rows["dec"] - DEC
    keep = (np.hypot(x, y) < 0.025) & (rows["mag_i"] < FAINTEST) & np.isfinite(rows["mag_g"])
    keep &= np.isin(rows["obj_type"], list(KIND))
    kept = Table({name: rows[name][keep] for name in (
        "ra", "dec", "mag_g", "mag_r", "mag_i", "size_disk", "size_bulge", "bulge_frac", "e1", "e2"
    )})  # fmt: skip
    kept["type"] = [KIND[kind] for kind in rows["obj_type"][keep]]
    return kept


def scene(cache):
    """Return the Table of all objects."""
    rng = np.random.default_rng(3)
    added = vstack([cluster(rng, -6.0, 2.0), foreground()])
    added["size_disk"], added["size_bulge"] = added["size"], added["size"]
    added.remove_column("size")
    return vstack([embedded(cache), added])


def resampled(frame):
    """Return a frame's electrons less their median on the picture's pixels (NY, NX), x to the east, y to the north."""
    nodes = [np.linspace(0.0, n - 1.0, 20) for n in (NX, NY)]
    x, y = np.meshgrid(*((at - (n - 1) / 2) * SCALE for at, n in zip(nodes, (NX, NY), strict=True)))
    smooth = frame.wcs.all_world2pix(*offset(x, y), 0)
    px, py = (RectBivariateSpline(nodes[1], nodes[0], at)(np.arange(NY), np.arange(NX)) for at in smooth)
    image = frame.electrons
    return map_coordinates(image - np.median(image), [py, px], order=1, cval=np.nan, prefilter=False)


def band(sim, table, chip, exposures):
    """Return the median [electron / s] of a band's exposures on the picture's pixels."""
    rng, parts = np.random.default_rng(chip), []
    for k in range(exposures):
        ra, dec = offset(*rng.normal(0.0, DITHER, 2))
        obsid, time = str(10100000000 + 100 * chip + k), f"2027-11-20T{k:02d}:20:00"
        one = sim.aim(ra, dec, chip, size=NX + EDGE, pa=PA, time=time, exptime=EXPTIME, obsid=obsid)
        w, cut = one.config.window, (NX - NY) // 2
        one = one.replace(catalog=table, window=(w.x0, w.x1, w.y0 + cut, w.y1 - cut))
        parts.append(resampled(one.chip(obsid, chip)) / EXPTIME)
        print(obsid, chip, flush=True)
    return np.nanmedian(parts, axis=0)


def field(cache, exposures, **keys):
    """Return {filter: image (NY, NX) [electron / s]}. keys: of the simulation."""
    table, sim = scene(cache), csstsim.Simulation(cache=cache).replace(**keys)
    return {name: band(sim, table, chip, exposures) for name, chip in CHIPS.items()}


def coloured(bands):
    """Return the picture (NY, NX, 3) uint8 of {filter: image}, north up, east to the left."""
    full = maximum_filter(np.maximum.reduce(list(bands.values())), 3) > SATURATED
    red, green, blue = (np.where(full, 4 * SATURATED, WEIGHTS[name] * bands[name]) for name in "irg")
    return make_lupton_rgb(red, green, blue, minimum=LOW, stretch=STRETCH, Q=Q)[::-1, ::-1]


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--exposures", type=int, default=EXPOSURES, help="of each band")
    with Record(parser) as record, tempfile.TemporaryDirectory() as cache:
        if record.toy:
            global NX, NY, FAINTEST
            NX, NY, FAINTEST = 200, 150, 22.0
        bands = field(cache, 1, psf=TOY_PSF) if record.toy else field(cache, record.options.exposures)
        Image.fromarray(coloured(bands)).save(record.figure("colour_field.jpg"), quality=85, optimize=True)


if __name__ == "__main__":
    main()
