"""A cluster of galaxies in g, r and i through every layer, compared with the same field without structure.

    python benchmarks/cluster_field.py

The cluster is the most massive one at z = 0.2 to 0.4 in 256 bricks of seed SEED that lies well inside its brick.
One exposure of each band is read out, without cosmic rays and defects, and aligned (benchmarks/colour_field.py).
"""

import argparse
import tempfile

from evidence.record import Record

import colour_field
import numpy as np
from PIL import Image, ImageDraw
from toy_sky import TOY_PSF

import csstsim
from csstsim.base.healpix import near_brick
from csstsim.universe.parameters import load_universe

SEED, FIRST, BRICKS = 7, 6400 * 64, 256
SIDE, EXPTIME, FAINTEST = 1100, 600.0, 27.5  # px; s; mag
MARGIN = 1.2 / 60  # deg, from the border of the brick
GAP = 12  # px between the two pictures


def find_cluster(bricks):
    """Return ra, dec [deg], z and log10 mass of the cluster."""
    matter = load_universe().matter_field(SEED, haloes=True)
    best = None
    for pix in range(FIRST, FIRST + bricks):
        haloes = matter.haloes.near(pix, lambda z, _: np.zeros(np.shape(z)), lowest=14.0)
        inside = np.ones(len(haloes["z"]), bool)
        for other in {*_around(pix)} - {pix}:
            inside &= ~near_brick(other, haloes["ra"], haloes["dec"], MARGIN)
        inside &= (haloes["z"] > 0.2) & (haloes["z"] < 0.4)
        for k in np.flatnonzero(inside):
            found = tuple(float(haloes[name][k]) for name in ("ra", "dec", "z", "log_mass"))
            best = found if best is None or found[-1] > best[-1] else best
    return best


def _around(pix):
    import healpy

    return [int(p) for p in healpy.get_all_neighbours(256, pix, nest=True) if p >= 0]


def picture(structure, place, cache, side, faintest, **keys):
    """Return the field (side, side, 3) uint8 under `catalog.structure`. keys: further ones of the simulation."""
    colour_field.RA, colour_field.DEC = place
    colour_field.NX = colour_field.NY = side
    sim = csstsim.Simulation(cache=cache).replace(
        seed=SEED, catalog={"structure": structure, "mag_limit": faintest, "lensing": {"field": "cosmic"}}, **keys
    )
    sim, bands = sim.replace(layers={"cosmic_rays": None, "detector_defects": None}), {}
    for name, chip in colour_field.CHIPS.items():
        obsid, size = str(10100000000 + chip), side + colour_field.EDGE
        one = sim.aim(*place, chip, size=size, pa=0.0, exptime=EXPTIME, obsid=obsid)
        bands[name] = colour_field.resampled(one.chip(obsid, chip)) / EXPTIME
        print(structure, name, flush=True)
    return colour_field.coloured(bands)


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    with Record(parser) as record:
        draw_both(record)


def draw_both(record: Record) -> None:
    """Find the cluster and draw it; at toy size one of two bricks, or else a place without, in a small picture."""
    bricks, side, faintest = (2, 100, 21.0) if record.toy else (BRICKS, SIDE, FAINTEST)
    keys = {"psf": TOY_PSF} if record.toy else {}
    ra, dec, z, log_mass = find_cluster(bricks) or (299.907, -60.245, 0.3, 14.0)  # the middle of a brick
    record.value("mass", 10 ** (log_mass - 14), "mass of the cluster", unit="1e14 solar masses")
    record.value("z", z, "its redshift")
    words = f"z = {z:.2f}, {10 ** (log_mass - 14):.1f} x 10^14 solar masses, ra {ra:.4f}, dec {dec:.4f}"
    print(words, flush=True)
    with tempfile.TemporaryDirectory() as cache:
        sides = [picture(structure, (ra, dec), cache, side, faintest, **keys) for structure in ("haloes", "none")]
    gap = np.full((side, GAP, 3), 255, np.uint8)
    image = Image.fromarray(np.concatenate([sides[0], gap, sides[1]], axis=1))
    draw = ImageDraw.Draw(image)
    draw.text((12, 10), f"structure: haloes   {words}", fill="white", font_size=26)
    draw.text((side + GAP + 12, 10), "structure: none", fill="white", font_size=26)
    image = image.resize((image.width // 2, image.height // 2), Image.Resampling.LANCZOS)
    image.save(record.figure("cluster_field.jpg"), quality=85, optimize=True)


if __name__ == "__main__":
    main()
