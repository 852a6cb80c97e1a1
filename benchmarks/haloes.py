"""Numbers of haloes drawn against the mass function, and the mean shear about them against the halo model.

    PYTHONPATH=benchmarks python benchmarks/haloes.py [--seed 1] [--bricks 12] [--area 100]        (two CPU-minutes)

Counts haloes in bricks around a place, by mass and redshift, beside the integral of Tinker et al. 2008; the last column
is the difference in units of the Poisson error, which leaves out clustering. Then it prints the expected tangential
shear about haloes of this sky, in closed form, over the usual halo model: an NFW sphere and bias x linear matter. With
the package dark_emulator (dark_quest) it prints it over that of simulations, too.
"""

import argparse

import healpy
import numpy as np
from dark_quest import delta_sigma, emulator
from scipy.special import jv

from csstsim.base.healpix import BRICKS, NSIDE
from csstsim.universe.parameters import load_universe
from csstsim.universe.structure.halo_profile import disc_transform, nfw_transform

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
    inside = np.minimum(ell, matter.ell[-1])
    response = spectra.response(inside)[shell]
    weight = spectra.weights[shell]
    powers = matter.amplitude[shell] ** 2 * matter.powers(ell) / matter.shells.kernel()[shell] ** 2
    print(f"\nDelta Sigma at z {z} over the halo model, at {radius} Mpc (comoving)")
    for log_mass in log_masses:
        mass = 10.0**log_mass
        tier = int(np.searchsorted(tiers, mass, side="right")) - 1
        wide = spectra.wide()[:, shell]
        lens = tier - (len(tiers) - 1 - len(wide))
        bias, volume = haloes.bias(mass, z), mass / haloes.density
        c = matter.haloes.mean_concentration(mass, z)
        sphere = nfw_transform(k, haloes.virial_radius(mass), c)
        own = volume * (sphere - disc_transform(k, numbers["compensation"] * haloes.lagrangian_radius(mass)))
        around = (
            bias
            * (powers * wide[lens] * weight * (1 + weight * np.einsum("ts,tl->ls", wide, response))).sum(axis=1)
            * chi**2
            * thickness
        )
        usual = bessel @ (volume * sphere + bias * matter.shells.power.linear(k, z))
        shear = bessel @ (own + around)
        print(f"log M {log_mass}: " + " ".join(f"{v:5.2f}" for v in shear / usual))
        if emulated:
            simulated = delta_sigma(emulated, mass, z, radius, haloes.cosmology.h0 / 100) / haloes.density
            print(" simulated: " + " ".join(f"{v:5.2f}" for v in shear / simulated))


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--bricks", type=int, default=12, help="in which all lensing haloes are counted")
    parser.add_argument("--area", type=float, default=100.0, help="deg2 in which clusters are counted")
    asked = parser.parse_args()
    matter = load_universe().matter_field(asked.seed)
    emulated = emulator(load_universe().numbers["cosmology"])
    for z in (0.15, 0.3, 0.5, 0.8):
        tell_profiles(matter, z, (12.7, 13.0, 13.5, 14.0, 14.5), emulated)
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
