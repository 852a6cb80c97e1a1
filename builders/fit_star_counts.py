"""Fit of the Galaxy's densities and lengths in config/universe/stars.yaml to the counts of Gaia (gaia_counts.csv).

    PYTHONPATH=builders python builders/fit_star_counts.py

Least squares of ln counts in nine steps of G from 12.1 to 20, in all directions but those kept for the test, with an
uncertainty of 4% (8% below |b| = 25 deg, where dust matters, and in the first step). Each parameter has a published
value as prior. The 25 stars i < 27 of the HUDF (Pirzkal et al. 2005, ApJ 622, 319; 11.97 arcmin2) hold the halo's far
side. Prints the parameters to enter in stars.yaml, beside their priors, and the residuals. Two minutes.
"""

import copy
from pathlib import Path

import numpy as np
from astropy.table import Table
from scipy.optimize import least_squares
from star_count_model import StarCounts

from csstsim.base.shipped import SHIPPED
from csstsim.universe.parameters import load_universe
from csstsim.universe.stars.milky_way import equatorial

TABLE = Path(__file__).with_name("gaia_counts.csv")
G = ("gaiadr2-G", 0.105)  # filter, AB - Vega (Evans et al. 2018, A&A 616, A4)
PRIOR = {  # value, uncertainty; slopes: of the mass function from 0.5 to 1 Msun, the halo's of all below 1 Msun
    "ln thick": (np.log(1.34), 0.35), "hz": (0.75, 0.05), "radial": (2.8, 0.5), "xl": (0.4, 0.05),
    "ln halo": (np.log(0.00932), 0.35), "power": (-2.3, 0.1), "flat": (0.59, 0.04), "break": (27.0, 2.0),
    "outer": (-4.6, 0.3), "disc": (2.7, 0.1), "eps": (0.85, 0.03), "slope": (-1.6, 0.05), "halo slope": (-0.5, 0.15),
    "flare": (0.1, 0.1),
}  # fmt: skip
EPS = [0.0268, 0.0375, 0.0551, 0.0696, 0.0785, 0.0791]  # thin2 ... thin7, Robin et al. 2003
HUDF = (53.16, -27.79), 25, 11.97  # RA, Dec, stars, arcmin2
OFFSETS = [(0, 0), (2.5, 0), (-2.5, 0), (0, 2.5), (0, -2.5)]  # deg: a direction is the mean of these places


def places(table):
    """Return ra, dec [deg], (directions, places), of the rows of gaia_counts.csv."""
    lon, lat = (np.asarray(table[name], float)[:, None] for name in ("l", "b"))
    aside, up = np.array(OFFSETS).T
    lat = np.where(np.abs(lat) > 85, np.sign(lat) * (87 - np.abs(up)), lat + up)
    return equatorial(lon + aside / np.cos(np.radians(lat)), lat)


def counts(table):
    """Return the limits of G and the counts (directions, steps) [deg-2]."""
    names = [name for name in table.colnames if name.startswith("G")]
    return [float(name[1:]) for name in names], np.array([table[name] for name in names], float).T


def steps(model, ra, dec, limits, *changed):
    """Return the model's counts (directions, steps) at places ra, dec."""
    many = model.brighter(ra.ravel(), dec.ravel(), limits, *changed).reshape(*ra.shape, -1)
    return np.diff(many.mean(axis=1), axis=1, prepend=0)


def changed(numbers, values):
    """Return numbers with the parameters `values`, and the changes of the mass functions' slopes."""
    new, tilts = copy.deepcopy(numbers), {}
    v = dict(zip(PRIOR, values, strict=True))
    thin = iter(EPS)
    for row, old in zip(new["components"]["rows"], numbers["components"]["rows"], strict=True):
        name, own = row[0], old[-1]
        if name.startswith("thin"):
            row[5] = row[5] if name == "thin1" else v["eps"] * next(thin)
            tilts[name] = (0.0, v["slope"] - own[1], 0.0)
        elif name in ("thick", "halo"):
            row[4] = np.exp(v[f"ln {name}"])
    row = next(row for row in new["components"]["rows"] if row[0] == "halo")
    tilts["halo"] = (v["halo slope"] - row[-1][0], v["halo slope"] - row[-1][1], 0.0)
    row[5] = v["flat"]
    laws = new["laws"]
    laws["thick"], laws["disc"] = [v["radial"], v["hz"], v["xl"]], [v["disc"], laws["disc"][1]]
    laws["flare"] = [laws["flare"][0], v["flare"]]
    laws["halo"] = [v["power"], laws["halo"][1], v["break"], v["outer"]]
    return new, tilts


def main():
    """Fit and print."""
    universe, table = load_universe(SHIPPED / "universe"), Table.read(TABLE, format="ascii.csv", comment="#")
    numbers, table = universe.numbers["stars"], table[table["use"] != "tested"]
    (limits, seen), (ra, dec) = counts(table), places(table)
    gaia, deep = StarCounts(numbers, universe, *G), StarCounts(numbers, universe, "sdss2010-i", beam=0.1)
    sigma = np.where(np.abs(table["b"])[:, None] < 25, 0.08, 0.04) * np.where(np.arange(len(limits)) == 0, 2.0, 1.0)
    start, spread = np.array(list(PRIOR.values())).T

    def residuals(values):
        change = changed(numbers, values)
        many = np.log(steps(gaia, ra, dec, limits, *change) / seen) / sigma
        far = deep.brighter(*HUDF[0], [27.0], *change)[0, 0] * HUDF[2] / 3600
        return np.concatenate([many.ravel(), (values - start) / spread, [3 * np.log(far / HUDF[1]) * np.sqrt(HUDF[1])]])

    fit = least_squares(residuals, start, diff_step=0.01, x_scale=spread, loss="soft_l1", max_nfev=10)
    for name, value, prior in zip(PRIOR, fit.x, start, strict=True):
        unlog = np.exp if name.startswith("ln ") else float
        print(f"{name:10s} {unlog(value):9.5g}   prior {unlog(prior):9.5g}")
    print("eps of thin2 ... thin7:", np.round(fit.x[list(PRIOR).index("eps")] * np.array(EPS), 4).tolist())
    ratio = steps(gaia, ra, dec, limits, *changed(numbers, fit.x)) / seen
    print("rms of ln(model / Gaia) by step:", np.sqrt((np.log(ratio) ** 2).mean(axis=0)).round(3))


if __name__ == "__main__":
    main()
