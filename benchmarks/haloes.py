"""Numbers of haloes against the mass function, and the mean shear about them against simulations.

    python benchmarks/haloes.py [--seed 1] [--bricks 12] [--area 100] [--caps 4]                          (8 CPU-min)

The expected tangential shear about haloes of this sky, in closed form, over the usual halo model: an NFW sphere and
bias x linear matter; and over that of simulations, by the package dark_emulator (dark_quest). In caps of 12 deg haloes
about haloes of one shell are counted, and compared with the correlation of that closed form. Haloes in bricks around
a place, by mass and redshift, are compared with the integral of Tinker et al. 2008.
"""

import argparse
from itertools import pairwise

from evidence.record import Record

import healpy
import numpy as np
from dark_quest import delta_sigma, emulator
from scipy.spatial import cKDTree
from scipy.special import jv

from csstsim.base.healpix import BRICKS, NSIDE
from csstsim.universe.parameters import Universe, load_universe
from csstsim.universe.structure.halo_profile import (
    disc_radius,
    disc_transform,
    halo_transform,
    nfw_transform,
    whole_mass,
)
from csstsim.universe.structure.intensity import excess, series
from csstsim.universe.structure.matter_field import MatterField

AREA_DEG2 = 4 * 180**2 / np.pi / BRICKS
DEPTHS = ((0.05, 0.5), (0.5, 1.0), (1.0, 1.5), (1.5, 3.5))  # redshifts between which haloes are counted
CLUSTERS = ((14.0, 14.3), (14.3, 15.5))  # log10 solar masses
LENSES = ((12.4771, 13.301), (13.301, 14.0), (14.0, 15.5))
REDSHIFTS, SHOWN = (0.15, 0.3, 0.5, 0.8), 0.3  # of the mean shear
MASSES, TOY_MASSES = (12.7, 13.0, 13.5, 14.0, 14.5, 14.8), (14.5,)
MULTIPOLES, TOY_MULTIPOLES = 60_000, 4000  # in which the shear is integrated
RADIUS = np.array([0.1, 0.2, 0.5, 1, 2, 3, 5, 7, 10, 15, 20])  # Mpc, comoving
HEAVY, OUTER, MOST = 13.5, 0.5, 0.1  # log10 solar mass and Mpc from which the shear is evaluated; largest difference
CAP, TOY_CAP = 12.0, 4.0  # deg
TOY_AREA, TOY_BRICKS, TOY_CAPS = 0.2, 1, 1


def counts(matter, bricks, lowest):
    """Return z and log mass of the haloes of `bricks`."""
    found = [matter.haloes.near(int(p), lambda z, log_mass: 0 * (z + log_mass), lowest) for p in bricks]
    return (np.concatenate([one[name] for one in found]) for name in ("z", "log_mass"))


def expected(matter, z_range, low, high):
    """Haloes per brick of a range of redshift and log mass."""
    z, mass = np.linspace(*z_range, 200), np.geomspace(10**low, 10**high, 80)
    number = np.trapezoid(matter.mass_function.dn_dlnm(mass, z[:, None]), np.log(mass), axis=1)
    chi = matter.shells.cosmology.comoving_distance(z)
    return 4 * np.pi / BRICKS * np.trapezoid(number * chi**2, chi)


def report_counts(record: Record, name: str, matter: MatterField, bricks: np.ndarray, bins: tuple) -> None:
    z, log_mass = counts(matter, bricks, bins[0][0])
    rows = []
    for near, far in DEPTHS:
        cells = [f"{near:g} to {far:.1f}"]
        for low, high in bins:
            found = ((z >= near) & (z < far) & (log_mass >= low) & (log_mass < high)).sum()
            cells += [f"{found:,}", f"{len(bricks) * expected(matter, (near, far), low, high):,.0f}"]
        rows.append(cells)
    names = [f"log mass {low:.1f} to {high:.1f}" for low, high in bins[:-1]] + [f"above {bins[-1][0]:.1f}"]
    record.table(name, ["z", *(word for each in names for word in (each, "expected"))], rows)
    record.value(f"{name}_area", len(bricks) * AREA_DEG2, "area in which these are counted", unit="deg2")


def profiles(
    matter: MatterField, z: float, emulated, masses: tuple[float, ...], multipoles: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return Delta Sigma (masses, RADIUS) of this sky's haloes, in closed form, over the halo model's and simulations'.

    Without an emulator the latter are NaN.
    """
    spectra, haloes, numbers = matter.spectra, matter.mass_function, matter.numbers["haloes"]
    chi = float(matter.shells.cosmology.comoving_distance(z))
    shell = int(np.searchsorted(matter.shells.edges, chi)) - 1
    thickness = np.diff(matter.shells.edges)[shell]
    ell = np.geomspace(1, 3e5, multipoles)
    k = (ell + 0.5) / chi
    step = np.gradient(np.log(ell)) * k**2 / (2 * np.pi)
    bessel = jv(2, np.outer(RADIUS, k)) * np.exp(-((k / 60.0) ** 2)) * step  # Delta Sigma / rho of a power spectrum
    tiers = np.array(numbers["tiers"])
    inside = np.minimum(ell, 1e5)
    over_model, over_simulations = np.full((2, len(masses), len(RADIUS)), np.nan)
    for row, log_mass in enumerate(masses):
        mass = 10.0**log_mass
        tier = int(np.searchsorted(tiers, mass, side="right")) - 1
        lens = tier - int(np.searchsorted(tiers, numbers["lens_mass"]))
        bias, volume = haloes.bias(mass, z), mass / haloes.density
        c = matter.haloes.mean_concentration(mass, z)
        radii, cuts = haloes.virial_radius(mass), numbers["cuts"]
        own = halo_transform(k, radii, c, cuts) - disc_transform(k, disc_radius(haloes, mass, numbers))
        own *= volume * whole_mass(c, cuts)
        around = spectra.around(inside, matter.amplitude, shell, lens, bias) * chi**2 * thickness
        usual = bessel @ (volume * nfw_transform(k, radii, c) + bias * matter.shells.power.linear(k, z))
        shear = bessel @ (own + around)
        over_model[row] = shear / usual
        if emulated:
            simulated = delta_sigma(emulated, mass, z, RADIUS, haloes.cosmology.h0 / 100) / haloes.density
            over_simulations[row] = shear / simulated
    return over_model, over_simulations


def report_profiles(record: Record, matter: MatterField, emulated, redshifts: tuple[float, ...]) -> None:
    masses, multipoles = (TOY_MASSES, TOY_MULTIPOLES) if record.toy else (MASSES, MULTIPOLES)
    found, rows = {z: profiles(matter, z, emulated, masses, multipoles) for z in redshifts}, []
    for log_mass, model, simulations in zip(masses, *found[SHOWN], strict=True):
        rows.append([f"{log_mass:.1f}, halo model", *(f"{v:.2f}" for v in model)])
        rows.append(["simulations", *(f"{v:.2f}" for v in simulations)])
    radii = [f"{r:g}" for r in RADIUS]
    record.table("profiles", ["log mass [solar], over", f"{radii[0]} Mpc", *radii[1:]], rows)
    heavy, outer = np.array(masses) >= HEAVY, RADIUS >= OUTER
    if emulated is None and not record.toy:
        return  # at toy size they are NaN
    off = max(np.abs(simulations[heavy][:, outer] - 1).max() for _, simulations in found.values())
    what = f"largest departure of the shear from simulations' from 10^{HEAVY:g} solar masses and {OUTER:g} Mpc on"
    record.value("departure", off, what, below=MOST)
    model, simulations = found[SHOWN]
    lack = 1 - (simulations / model)[:, (RADIUS >= 2) & (RADIUS <= 10)].min()
    record.value("halo_model", lack, f"what the halo model lacks of simulations' shear at 2 to 10 Mpc, z = {SHOWN:g}")


def report_pairs(record: Record, universe: Universe, caps: int, degrees: float, shell: int = 8) -> None:
    """Record haloes of 3e12 to 2e13 about heavier ones in a shell of caps of the sky against what is expected."""
    radius, angle = np.array([1, 2, 3, 4, 6, 8, 12, 17, 23, 30]), np.radians(degrees)
    ratios, tiers = {}, range(1, len(universe.numbers["structure"]["haloes"]["tiers"]) - 1)
    for seed in range(1, caps + 1):
        matter = universe.matter_field(seed)
        chi = matter.shells.edges[shell : shell + 2].mean()
        theta, centre = radius / chi, healpy.ang2vec(60 + 40 * seed, 20, lonlat=True)
        light, *heavy = (cap_haloes(matter, tier, shell, centre, angle) for tier in tiers)
        light = cKDTree(light["vector"])
        density = next(
            n[shells == shell].sum() for shells, _, n in matter.haloes._depths[1].values() if shell in shells
        )
        for lens, some in enumerate(heavy, 1):
            some = {name: v[some["vector"] @ centre > np.cos(angle - theta[-1])] for name, v in some.items()}
            if not len(some["z"]):
                continue
            near = light.count_neighbors(cKDTree(some["vector"]), 2 * np.sin(theta / 2))
            wanted = 2 * np.pi * np.diff(1 - np.cos(theta)) * density * len(some["z"])
            linear, whole = expected_pairs(matter, shell, lens, some, theta)
            ratios.setdefault(lens, []).append((len(some["z"]), np.diff(near) / wanted - 1, linear, whole))
    print(f"haloes of 3e12 to 2e13 solar masses about others at z {np.interp(chi, *matter.shells.distances):.2f}, over")
    print(f"the mean less 1, between {radius} Mpc")
    rows = []
    for lens, parts in ratios.items():
        count = np.array([n for n, *_ in parts])
        found, linear, whole = (np.average([p[k] for p in parts], axis=0, weights=count) for k in (1, 2, 3))
        error = np.std([p[1] for p in parts], axis=0, ddof=1) / np.sqrt(len(parts))
        lightest = f"{matter.numbers['haloes']['tiers'][lens + 1]:.0e}"
        print(f"tier from {lightest}: {count.sum()} haloes")
        for name, values in (("drawn", found), ("error", error), ("expected", whole), ("linear part", linear)):
            print(f"{name:>14} " + " ".join(f"{v:6.3f}" for v in values))
        rows.append([lightest, f"{count.sum():,}", f"{np.abs((found - whole) / error).max():.1f}"])
    header = ["haloes from [solar masses]", "number", "largest departure of haloes about them, in errors"]
    record.table("pairs", header, rows)


def cap_haloes(matter, tier, shell, centre, angle):
    """Return the haloes of a tier and a shell within `angle` [rad] of a direction."""
    haloes = matter.haloes
    order = next(o for o, (shells, _, _) in haloes._depths[tier].items() if shell in shells)
    cells = healpy.query_disc(2 ** haloes._cell_order(tier, order), centre, angle, inclusive=True, nest=True)
    parts = [haloes.cell(tier, order, int(cell)) for cell in cells]
    columns = {name: np.concatenate([part[name] for part in parts]) for name in ("z", "log_mass", "vector")}
    chi = matter.shells.cosmology.comoving_distance(columns["z"])
    near, far = matter.shells.edges[shell : shell + 2]
    keep = (chi >= near) & (chi < far) & (columns["vector"] @ centre > np.cos(angle))
    return {name: values[keep] for name, values in columns.items()}


def expected_pairs(matter, shell, lens, some, theta):
    """Return the correlation, linear part and whole, of haloes `some` with lighter ones in annuli between `theta`."""
    spectra = matter.spectra
    wide, at = spectra.wide()[:, shell], np.geomspace(0.5 * theta[0], 2 * theta[-1], 200)
    power = (spectra.weights[shell] * matter.amplitude[shell] / matter.shells.kernel()[shell]) ** 2
    ell = np.geomspace(1, 1e5, 20000)
    step = np.gradient(np.log(ell)) * ell**2 / (2 * np.pi)
    kernels = np.einsum("lt,ls->ts", jv(0, np.outer(ell, at)) * step[:, None], matter.powers(ell))
    shared = (power * wide[lens] * wide[0] * kernels).sum(axis=1)
    sigma = np.sqrt((power * wide**2 * (step @ matter.powers(ell))).sum(axis=1))
    z = some["z"].mean()
    mass = np.geomspace(*matter.numbers["haloes"]["tiers"][1:3], 40)
    number = matter.mass_function.dn_dlnm(mass, z)
    light = series(np.average(matter.mass_function.bias(mass, z), weights=number) * sigma[0])
    heavy = series(matter.mass_function.bias(10 ** some["log_mass"], some["z"]) * sigma[lens]).mean(axis=1)
    r = shared / (sigma[0] * sigma[lens])
    curves = light[1] * heavy[1] * r, light[1] * heavy[1] * r + excess(heavy, light, r)
    inside = [np.linspace(a, b, 20) for a, b in pairwise(theta)]
    return [np.array([np.average(np.interp(x, at, curve), weights=x) for x in inside]) for curve in curves]


def main(record: Record) -> None:
    asked, toy = record.options, record.toy
    universe = load_universe()
    matter, emulated = universe.matter_field(asked.seed), emulator(universe.numbers["cosmology"])
    if emulated is None:
        record.skip("simulations", "dark_emulator is not installed")
    report_profiles(record, matter, emulated, (SHOWN,) if toy else REDSHIFTS)
    report_pairs(record, universe, TOY_CAPS if toy else asked.caps, TOY_CAP if toy else CAP)
    some = np.random.default_rng(1).integers(0, BRICKS, TOY_BRICKS if toy else asked.bricks)
    report_counts(record, "lenses", matter, some, LENSES)
    radius = np.sqrt(np.radians(1) ** 2 * (TOY_AREA if toy else asked.area) / np.pi)
    wide = healpy.query_disc(NSIDE, healpy.ang2vec(150.0, -65.0, lonlat=True), radius, nest=True)
    report_counts(record, "clusters", matter, wide, CLUSTERS)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--bricks", type=int, default=12, help="in which all lensing haloes are counted")
    parser.add_argument("--area", type=float, default=100.0, help="deg2 in which clusters are counted")
    parser.add_argument("--caps", type=int, default=4, help="with a seed each, in which pairs are counted; at least 2")
    with Record(parser) as record:
        main(record)
