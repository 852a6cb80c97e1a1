"""Builder of gaia_counts.csv: stars per square degree in steps of Gaia's G, in directions fitted and kept for the test.

    python builders/build_gaia_counts.py g_rp_internal_completeness.npz gaia_healpix_density.pq builders/gaia_counts.csv

The first file is Gaia DR2's counts to G = 15.1 in HEALPix pixels of NSIDE 64 (github.com/jan-rybizki/gdr2_completeness,
folder data; Rybizki et al. 2021, MNRAS 500, 397), the second DR3's to whole magnitudes, NSIDE 32
(github.com/c3-time-domain/SeeChange, folder share/gaia_density). A direction is the median of the pixels within 4 deg:
clusters do not count. Objects other than stars (`OTHER`: quasars and galaxies, round figures after Gaia Collaboration,
Bailer-Jones et al. 2023, A&A 674, A41) are taken off. Directions near the Magellanic Clouds, the Sagittarius dwarf
galaxy, Orion, Perseus and Ophiuchus are left out.
"""

import sys

import healpy
import numpy as np
import pyarrow.parquet
from astropy.table import Table

from csstsim.base.sphere import angle, unit_vectors
from csstsim.universe.dust.dust_map import galactic

LIMITS = [12.1, 13.1, 14.1, 15.1, 16.0, 17.0, 18.0, 19.0, 20.0]
OTHER = [0, 0, 0, 0, 0, 0.5, 2, 7, 20]  # deg-2
SHOWN = [(0, 90), (90, 30), (180, -30), (0, -45), (270, 45), (180, 60)]
TESTED = [(0, -90), (180, 30), (0, 60), (240, -30), (135, -45), (45, 30)]
RINGS = [(20, 40), (-20, 40), (30, 45), (-30, 45), (45, 60), (-45, 60), (60, 90), (-60, 90), (75, 120), (-75, 120)]
CLOUDS = [
    (280.5, -32.9, 14),
    (302.8, -44.3, 8),
    (5.6, -14, 12),
    (210, -18, 12),
    (121, -21.6, 6),
    (135, 18, 9),
    (309, 15, 6),
]
NEAR, RADIUS = 12.0, 4.0  # deg
NSIDE = 32


def directions():
    """Return rows of l, b [deg] and use: "shown" in the figure and fitted, "tested" (not fitted), "fitted"."""
    rows = [(*spot, "shown") for spot in SHOWN] + [(*spot, "tested") for spot in TESTED]
    taken = [(*spot, NEAR) for spot in SHOWN + TESTED] + CLOUDS
    for b, step in RINGS:
        for lon in np.arange(15, 375, step) % 360:
            here = unit_vectors(float(lon), float(b))
            if all(angle(here, unit_vectors(x, y)) > far for x, y, far in taken):
                rows.append((int(lon), b, "fitted"))
    return rows


def main(second_release, third_release, out):
    """Write the table."""
    bright = np.load(second_release)
    cumulative = bright["arr_1"].reshape(12 * NSIDE**2, 4, -1).sum(axis=1).cumsum(axis=1)
    faint = pyarrow.parquet.read_table(third_release)
    # A bin of the first file is centred on its magnitude and 0.2 wide
    columns = [cumulative[:, np.abs(bright["arr_2"] + 0.1 - g).argmin()] for g in LIMITS[:4]]
    columns += [faint[f"{g:.0f}"].to_numpy() for g in LIMITS[4:]]
    counts = np.diff(np.stack(columns, axis=1), axis=1, prepend=0) / healpy.nside2pixarea(NSIDE, degrees=True)
    places = unit_vectors(*galactic(*healpy.pix2ang(NSIDE, np.arange(12 * NSIDE**2), nest=True, lonlat=True)))
    table = []
    for lon, lat, use in directions():
        near = angle(places, unit_vectors(float(lon), float(lat))) < RADIUS
        table.append((lon, lat, use, *np.round(np.median(counts[near], axis=0) - OTHER, 2)))
    names = ["l", "b", "use", *(f"G{g:g}" for g in LIMITS)]
    Table(rows=table, names=names).write(out, format="ascii.csv", overwrite=True)
    with open(out) as file:
        text = file.read()
    with open(out, "w") as file:
        file.write(
            "# Stars per deg2 up to the limits of G named, from the limit before; made by build_gaia_counts.py\n" + text
        )


if __name__ == "__main__":
    main(*sys.argv[1:])
