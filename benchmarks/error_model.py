"""The error model of the render policy (render/error_model.py): fitted to one sample of objects, tested on another.

    python benchmarks/error_model.py [--objects 160] [--filter r] [--output results/bench]
    python benchmarks/error_model.py --bright       # bound over visible error of bright galaxies, drawn as stamps

Truth is the reference renderer on the same PSF set, with a stamp as wide as the window
(bench.imaging.methods.standard). The coefficients of stamps come from a 97% quantile regression (none negative) of
visible error / S/N. Photons are drawn from the same density as points' stamps, so they share `psf`. The fitted numbers
are printed for config/render.yaml. The test uses those in the file: at most 5% of objects may exceed their bound. A
photon image of 2e7 electrons has an error of its own, so an object exceeds its bound only if the squared error is above
the squared bound by more than twice that error. Pooled over all objects, squared error over squared bound must be below
1.
"""

import argparse
from itertools import product

import numpy as np
from scipy.optimize import linprog

from csstsim.base.rng import stream
from csstsim.bench.imaging.cases import BULGE_MAX, make_case, make_cases
from csstsim.bench.imaging.measures import errors
from csstsim.bench.imaging.methods import METHODS, standard
from csstsim.bench.setting import make_setting
from csstsim.bench.sweep import measured
from csstsim.render.error_model import TERMS, predicted, terms
from csstsim.render.policy import noise
from csstsim.render.settings import load_numbers

QUANTILE = 0.97
ELECTRONS, SECONDS = 2e7, 0.3
LARGEST = 2.5  # arcsec
NAMES = {"photons": "photons", "stamp": "stamps"}  # {the policy's name: the benchmark's}


def sample(setting, count, seed):
    """Return [(case, S/N, {method: (visible error, its chance), both over S/N})]."""
    methods = {mine: next(m for m in METHODS if m.name == name) for mine, name in NAMES.items()}
    box, rows = setting.psf.image.shape[-1] / 2 / setting.psf.oversampling, []
    for case in make_cases(setting, count, seed, LARGEST):
        wanted = standard(setting, case) / case.electrons
        snr = (case.electrons / noise(case.scene, np.array([case.electrons]), setting.variance))[0]
        seen = {}
        for name, method in methods.items():
            image, _, drawn = measured(method, setting, case, SECONDS if name == "photons" else 0.0, ELECTRONS)
            value, chance = errors(image, wanted, setting.variance, case.electrons, drawn, box=box)
            seen[name] = value[-1] / snr, chance[-1] / snr
        rows.append((case, snr, seen))
    return rows


def bright(setting, numbers):
    """Print S/N and the range of bound over visible error of stamps, for each number of electrons and profile."""
    rng, stamps = stream(3, "bright"), next(m for m in METHODS if m.name == NAMES["stamp"])
    box, found = setting.psf.image.shape[-1] / 2 / setting.psf.oversampling, {}
    shapes = product((0.1, 0.3, 0.6, 1.0, 2.0), (0.0, 1.0), (0.0, 0.5), (1e6, 3e7, 2e8))
    for i, (size, bulge, e, electrons) in enumerate(shapes):
        if size > BULGE_MAX and bulge:
            continue
        case = make_case(setting, rng, 2 * i, electrons, bulge, size, e)
        snr = electrons / noise(case.scene, np.array([electrons]), setting.variance)
        wanted, (image, _, drawn) = standard(setting, case) / electrons, measured(stamps, setting, case, 0.0, 0.0)
        seen = errors(image, wanted, setting.variance, electrons, drawn, box=box)[0][-1]
        bound = predicted("stamp", case.scene, case.row["reach"], snr, numbers, setting.psf.oversampling)[0]
        found.setdefault((electrons, bulge), []).append(bound / seen)
        about = f'{electrons:.0e} e-, bulge {bulge}, {size}", |e| {e}: S/N {snr[0]:.0f}'
        print(f"{about}, seen {seen:.3f}, bound {bound:.3f}")
    for (electrons, bulge), ratio in sorted(found.items()):
        print(f"{electrons:.0e} e-, bulge {bulge}: bound over visible error {min(ratio):.2f} to {max(ratio):.2f}")


def columns(rows, method, numbers, cells):
    """Return (terms (n, 3), bound / S/N, visible error / S/N, chance / S/N, whether a star)."""
    x = np.concatenate([terms(case.scene, case.row["reach"], np.array([snr]), numbers) for case, snr, _ in rows])
    bound = [
        predicted(method, case.scene, case.row["reach"], np.array([snr]), numbers, cells)[0] / snr
        for case, snr, _ in rows
    ]
    seen, chance = np.array([seen[method] for _, _, seen in rows]).T
    return x, np.array(bound), seen, chance, np.array([case.star for case, _, _ in rows])


def fit(x, y):
    """Return non-negative coefficients of the linear quantile regression of y (n,) on x (n, k)."""
    n, k = x.shape
    weights = np.r_[np.zeros(k), np.full(n, QUANTILE), np.full(n, 1 - QUANTILE)]
    return linprog(weights, A_eq=np.hstack([x, np.eye(n), -np.eye(n)]), b_eq=y).x[:k]


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--objects", type=int, default=160, help="in each sample, half of them stars")
    parser.add_argument("--output", default="results/bench", help="folder of the PSF set, as of csstsim bench")
    parser.add_argument("--filter", default="r", help="imaging filter")
    parser.add_argument("--bright", action="store_true", help="bright galaxies instead")
    args = parser.parse_args()
    setting, numbers = make_setting(args.output, args.filter), load_numbers().error
    if args.bright:
        return bright(setting, numbers)
    cells = setting.psf.oversampling
    x, _, seen, _, star = columns(sample(setting, args.objects, 11), "stamp", numbers, cells)
    whole = star & (x[:, 0] == x[star, 0].min())  # stars whose stamp is the box
    psf = np.quantile(seen[whole], QUANTILE)
    left = np.maximum(seen - psf, 0.0)
    points, rest = fit(x[star & ~whole][:, :1], left[star & ~whole]), fit(x[~star][:, 1:], left[~star])
    print(f"psf of {cells} cells {psf:.2e}; in the file {numbers.psf[cells]}")
    for name, value in zip(TERMS, (*points, *rest), strict=True):
        print(f"stamp {name:6s} {value:.2e}; in the file {getattr(numbers.stamp, name)}")
    print("fresh sample:  method  kind      n  exceed  share   squared error / squared bound, pooled")
    fresh = sample(setting, args.objects, 12)
    for method in NAMES:
        _, bound, seen, chance, star = columns(fresh, method, numbers, cells)
        signed = np.sign(seen) * seen**2
        over = signed > bound**2 + 2 * chance**2
        for kind, mine in (("stars", star), ("galaxies", ~star)):
            ratio = signed[mine] / bound[mine] ** 2
            error = chance[mine] ** 2 / bound[mine] ** 2
            weight = 1 / (error**2 + 0.01)
            pooled, pooled_error = (
                np.average(ratio, weights=weight),
                np.sqrt((weight**2 * error**2).sum()) / weight.sum(),
            )
            print(
                f"               {method:7s} {kind:8s} {mine.sum():3d} {over[mine].sum():5d}  {over[mine].mean():6.1%}"
                f"   {pooled:.2f} +- {pooled_error:.2f}"
            )


if __name__ == "__main__":
    main()
