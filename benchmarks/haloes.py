"""Numbers of haloes drawn against the mass function, and the mean shear about them against the halo model.

    PYTHONPATH=benchmarks python benchmarks/haloes.py [--seed 1] [--bricks 12] [--area 100] [--caps 4]   (8 CPU-min)

Counts haloes in bricks around a place, by mass and redshift, beside the integral of Tinker et al. 2008; the last column
is the difference in units of the Poisson error, which leaves out clustering. Before that it prints the expected
tangential shear about haloes of this sky, in closed form, over the usual halo model: an NFW sphere and bias x linear
matter. With the package dark_emulator (dark_quest) it prints it over that of simulations, too. In caps of 12 deg it
counts the haloes about haloes of one shell, beside the correlation of that closed form.
"""

import argparse
from itertools import pairwise

import healpy
import numpy as np
from dark_quest import delta_sigma, emulator
from scipy.spatial import cKDTree
from scipy.special import jv

from csstsim.base.healpix import BRICKS, NSIDE
from csstsim.universe.parameters import load_universe
from csstsim.universe.structure.halo_profile import (
    disc_radius,
    disc_transform,
    halo_transform,
    nfw_transform,
    whole_mass,
)
from csstsim.universe.structure.intensity import excess, series

AREA_DEG2 = 4 * 180**2 / np.pi / BRICKS


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


def tell_counts(matter, bricks, lowest, bins):
    z, log_mass = counts(matter, bricks, lowest)
    print(f"{len(bricks)} bricks, {len(bricks) * AREA_DEG2:.1f} deg2")
    for z_range in ((0.05, 0.5), (0.5, 1.0), (1.0, 1.5), (1.5, 3.5)):
        for low, high in bins:
            found = ((z >= z_range[0]) & (z < z_range[1]) & (log_mass >= low) & (log_mass < high)).sum()
            wanted = len(bricks) * expected(matter, z_range, low, high)
            print(f"z {z_range[0]:4.2f} to {z_range[1]:3.1f}  log M {low:5.2f} to {high:5.2f}   drawn {found:6d}"
                  f"  mass function {wanted:9.1f}   {(found - wanted) / np.sqrt(max(wanted, 1)):5.1f}")  # fmt: skip


def tell_profiles(matter, z, log_masses, emulated):
    """Print Delta Sigma of this sky's haloes, in closed form, over the halo model's and simulations', at `radius`."""
    spectra, haloes, numbers = matter.spectra, matter.mass_function, matter.numbers["haloes"]
    chi = float(matter.shells.cosmology.comoving_distance(z))
    shell = int(np.searchsorted(matter.shells.edges, chi)) - 1
    thickness = np.diff(matter.shells.edges)[shell]
    ell = np.geomspace(1, 3e5, 60000)
    k = (ell + 0.5) / chi
    radius = np.array([0.1, 0.2, 0.5, 1, 2, 3, 5, 7, 10, 15, 20])
    step = np.gradient(np.log(ell)) * k**2 / (2 * np.pi)
    bessel = jv(2, np.outer(radius, k)) * np.exp(-((k / 60.0) ** 2)) * step  # Delta Sigma / rho of a power spectrum
    tiers = np.array(numbers["tiers"])
    inside = np.minimum(ell, 1e5)
    print(f"\nDelta Sigma at z {z} over the halo model, at {radius} Mpc (comoving)")
    for log_mass in log_masses:
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
        print(f"log M {log_mass}: " + " ".join(f"{v:5.2f}" for v in shear / usual))
        if emulated:
            simulated = delta_sigma(emulated, mass, z, radius, haloes.cosmology.h0 / 100) / haloes.density
            print(" simulated: " + " ".join(f"{v:5.2f}" for v in shear / simulated))


def tell_pairs(universe, caps, shell=8):
    """Print haloes of 3e12 to 2e13 about heavier ones in a shell of caps of the sky, and what is expected of them."""
    radius, angle = np.array([1, 2, 3, 4, 6, 8, 12, 17, 23, 30]), np.radians(12)
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
            near = light.count_neighbors(cKDTree(some["vector"]), 2 * np.sin(theta / 2))
            wanted = 2 * np.pi * np.diff(1 - np.cos(theta)) * density * len(some["z"])
            linear, whole = expected_pairs(matter, shell, lens, some, theta)
            ratios.setdefault(lens, []).append((len(some["z"]), np.diff(near) / wanted - 1, linear, whole))
    print(
        f"\nhaloes of 3e12 to 2e13 solar masses about others at z {np.interp(chi, *matter.shells.distances):.2f}, over"
    )
    print(f"the mean less 1, between {radius} Mpc")
    for lens, parts in ratios.items():
        count = np.array([n for n, *_ in parts])
        found, linear, whole = (np.average([p[k] for p in parts], axis=0, weights=count) for k in (1, 2, 3))
        error = np.std([p[1] for p in parts], axis=0, ddof=1) / np.sqrt(len(parts))
        print(f"tier from {matter.numbers['haloes']['tiers'][lens + 1]:.0e}: {count.sum()} haloes")
        for name, values in (("drawn", found), ("error", error), ("expected", whole), ("linear part", linear)):
            print(f"{name:>14} " + " ".join(f"{v:6.3f}" for v in values))


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


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--bricks", type=int, default=12, help="in which all lensing haloes are counted")
    parser.add_argument("--area", type=float, default=100.0, help="deg2 in which clusters are counted")
    parser.add_argument("--caps", type=int, default=4, help="of 12 deg, with a seed each, in which pairs are counted")
    asked = parser.parse_args()
    universe = load_universe()
    matter, emulated = universe.matter_field(asked.seed), emulator(universe.numbers["cosmology"])
    for z in (0.15, 0.3, 0.5, 0.8):
        tell_profiles(matter, z, (12.7, 13.0, 13.5, 14.0, 14.5, 14.8), emulated)
    if asked.caps > 1:
        tell_pairs(universe, asked.caps)
    some = np.random.default_rng(1).integers(0, BRICKS, asked.bricks)
    tell_counts(
        matter, some, np.log10(matter.numbers["haloes"]["lens_mass"]), ((12.4771, 13.301), (13.301, 14.0), (14.0, 15.5))
    )
    wide = healpy.query_disc(
        NSIDE, healpy.ang2vec(150.0, -65.0, lonlat=True), np.sqrt(np.radians(1) ** 2 * asked.area / np.pi), nest=True
    )
    tell_counts(matter, wide, 14.0, ((14.0, 14.3), (14.3, 15.5)))


if __name__ == "__main__":
    main()
