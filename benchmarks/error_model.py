"""The error model of the render policy (render/error_model.py): fitted to one sample of objects, tested on another.

    python benchmarks/error_model.py [--objects 160] [--filter r]
    python benchmarks/error_model.py --bright       # bound over visible error of bright galaxies, rendered as stamps

Truth is the reference renderer on the same PSF set, with a stamp as wide as the window
(bench.imaging.methods.standard). The coefficients of stamps come from a 97% quantile regression (none negative) of
visible error / S/N. Photons are drawn from the same density as points' stamps, so they share `psf`. The fitted numbers
are printed for config/render.yaml. The test uses those in the file: at most 5% of objects, and two sigma of their
number, may exceed their bound. A photon image of 2e7 electrons has an error of its own, so an object exceeds its bound
only if the squared error is above the squared bound by more than twice that error. Pooled over all objects, squared
error over squared bound must be below 1.
"""

import argparse
from itertools import product

from evidence.record import Record

import numpy as np
from bench_setting import setting_of
from scipy.optimize import linprog

from csstsim.base.rng import stream
from csstsim.render.error_model import TERMS, noise, psf_error, stamp_error, terms
from csstsim.render.settings import Error, load_numbers
from csstsim.studies.bench.imaging.cases import BULGE_MAX, make_case, make_cases
from csstsim.studies.bench.imaging.measures import errors
from csstsim.studies.bench.imaging.methods import METHODS, standard
from csstsim.studies.bench.setting import Setting
from csstsim.studies.bench.sweep import measure_case

QUANTILE = 0.97
ELECTRONS, SECONDS = 2e7, 0.3
LARGEST = 2.5  # arcsec
TOY_OBJECTS, TOY = 8, {"largest": 0.5, "photons": 3e5, "seconds": 0.01}
EXCEED = 0.05  # largest fraction of objects that may exceed their bound
SMALL = 0.05  # arcsec: n = 4 exceeds its bound
SIZES, BULGES, ELLIPTICITIES = (SMALL, 0.1, 0.3, 0.6, 1.0, 2.0), (0.0, 1.0), (0.0, 0.5)
LIGHT = 1e6, 3e7, 2e8  # electrons
PROFILES = {0.0: "exponential", 1.0: "n = 4"}
NAMES = {"photons": "photons", "stamp": "stamps"}  # {the policy's name: the benchmark's}


def sample(setting, count, seed, *, largest=LARGEST, photons=ELECTRONS, seconds=SECONDS):
    """Return [(case, S/N, {method: (visible error, its chance), both over S/N})]."""
    methods = {mine: next(m for m in METHODS if m.name == name) for mine, name in NAMES.items()}
    box, rows = setting.psf.image.shape[-1] / 2 / setting.psf.oversampling, []
    for case in make_cases(setting, count, seed, largest):
        wanted = standard(setting, case) / case.electrons
        snr = (case.electrons / noise(case.scene, np.array([case.electrons]), setting.variance))[0]
        seen = {}
        for name, method in methods.items():
            image, _, drawn = measure_case(method, setting, case, seconds if name == "photons" else 0.0, photons)
            value, chance = errors(image, wanted, setting.variance, case.electrons, drawn, box=box)
            seen[name] = value[-1] / snr, chance[-1] / snr
        rows.append((case, snr, seen))
    return rows


def bright(record: Record, setting: Setting, numbers: Error) -> None:
    """Record S/N and the range of bound over visible error of stamps, for each number of electrons and profile."""
    rng, stamps = stream(3, "bright"), next(m for m in METHODS if m.name == NAMES["stamp"])
    box, found, every, small = setting.psf.image.shape[-1] / 2 / setting.psf.oversampling, {}, {}, []
    shapes = product(SIZES[:3] if record.toy else SIZES, BULGES, ELLIPTICITIES, LIGHT[:2] if record.toy else LIGHT)
    for i, (size, bulge, e, electrons) in enumerate(shapes):
        if size > BULGE_MAX and bulge:
            continue
        case = make_case(setting, rng, 2 * i, electrons, bulge, size, e)
        snr = electrons / noise(case.scene, np.array([electrons]), setting.variance)
        wanted, (image, _, drawn) = standard(setting, case) / electrons, measure_case(stamps, setting, case, 0.0, 0.0)
        seen = errors(image, wanted, setting.variance, electrons, drawn, box=box)[0][-1]
        bound = stamp_error(case.scene, case.row["reach"], snr, numbers, setting.psf.oversampling)[0]
        if size == SMALL and bulge:
            small.append(seen / bound)
        else:
            found.setdefault((electrons, bulge), []).append((seen, bound))
        every.setdefault(electrons, []).append(snr[0])
        about = f'{electrons:.0e} e-, bulge {bulge}, {size}", |e| {e}: S/N {snr[0]:.0f}'
        print(f"{about}, seen {seen:.3f}, bound {bound:.3f}")
    rows = []
    for electrons, snr in every.items():
        ranges = [cell for bulge in PROFILES for cell in _ranges(found[electrons, bulge])]
        rows.append([f"{electrons:.0e}".replace("e+0", "e"), f"{min(snr):.0f} to {max(snr):.0f}", *ranges])
    whats = "visible error", "bound, at most", "bound over visible error"
    record.table(
        "bright", ["electrons", "S/N", *(f"{name}: {what}" for name in PROFILES.values() for what in whats)], rows
    )
    least = min(bound / seen for pairs in found.values() for seen, bound in pairs)
    record.value("least", least, f"bound over visible error of bright galaxies but n = 4 of {SMALL} arcsec", above=1)
    record.value("small", max(small), f"visible error over bound of n = 4 of {SMALL} arcsec, the largest")


def _ranges(pairs: list[tuple[float, float]]) -> list[str]:
    """Return the range of visible errors, the largest bound, and the range of bound over visible error, as text."""
    seen, bound = np.array(pairs).T
    ends = [f"{value:.{0 if value >= 10 else 1}f}" for value in (seen.min(), seen.max(), bound.max())]
    ratio = bound / seen
    return [f"{ends[0]} to {ends[1]}", ends[2], f"{ratio.min():.1f} to {ratio.max():.1f}"]


def bound_of(method, case, snr, numbers, cells):
    """Return the bound of the policy for a case, in units of its noise."""
    snr = np.array([snr])
    if method == "photons":
        return psf_error(snr, numbers, cells)[0]
    return stamp_error(case.scene, case.row["reach"], snr, numbers, cells)[0]


def columns(rows, method, numbers, cells):
    """Return (terms (n, 3), bound / S/N, visible error / S/N, chance / S/N, whether a star)."""
    x = np.concatenate([terms(case.scene, case.row["reach"], np.array([snr]), numbers) for case, snr, _ in rows])
    bound = [bound_of(method, case, snr, numbers, cells) / snr for case, snr, _ in rows]
    seen, chance = np.array([seen[method] for _, _, seen in rows]).T
    return x, np.array(bound), seen, chance, np.array([case.star for case, _, _ in rows])


def fit(x, y):
    """Return non-negative coefficients of the linear quantile regression of y (n,) on x (n, k)."""
    n, k = x.shape
    weights = np.r_[np.zeros(k), np.full(n, QUANTILE), np.full(n, 1 - QUANTILE)]
    return linprog(weights, A_eq=np.hstack([x, np.eye(n), -np.eye(n)]), b_eq=y).x[:k]


def fitted(record: Record, rows: list, numbers: Error, cells: int) -> None:
    """Record the coefficients that fit a sample, beside those of config/render.yaml."""
    x, _, seen, _, star = columns(rows, "stamp", numbers, cells)
    whole = star & (x[:, 0] == x[star, 0].min())  # stars whose stamp is the box
    psf = np.quantile(seen[whole], QUANTILE)
    left = np.maximum(seen - psf, 0.0)
    points, rest = fit(x[star & ~whole][:, :1], left[star & ~whole]), fit(x[~star][:, 1:], left[~star])
    lines = [[f"psf, {cells} cells per pixel", psf, numbers.psf[cells]]]
    lines += [[name, value, getattr(numbers.stamp, name)] for name, value in zip(TERMS, (*points, *rest), strict=True)]
    record.table("fitted", ["coefficient", "fitted", "config/render.yaml"], [
        [name, f"{value:.1e}", f"{kept:.1e}"] for name, value, kept in lines
    ])  # fmt: skip


def tested(record: Record, rows: list, numbers: Error, cells: int) -> None:
    """Record how many of a fresh sample exceed their bound, by method and kind."""
    for method in NAMES:
        _, bound, seen, chance, star = columns(rows, method, numbers, cells)
        signed = np.sign(seen) * seen**2
        over = signed > bound**2 + 2 * chance**2
        for kind, mine in (("stars", star), ("galaxies", ~star)):
            ratio, error = signed[mine] / bound[mine] ** 2, chance[mine] ** 2 / bound[mine] ** 2
            weight = 1 / (error**2 + 0.01)
            pooled = np.average(ratio, weights=weight)
            pooled_error = np.sqrt((weight**2 * error**2).sum()) / weight.sum()
            name, who = f"{method}_{kind}", f"{method}, {mine.sum()} {kind} of a fresh sample"
            most = EXCEED + 2 * np.sqrt(EXCEED * (1 - EXCEED) / mine.sum())
            record.value(f"{name}_exceed", over[mine].mean(), f"{who}: fraction above their bound", below=most)
            # It must stay below 1; chance may carry it above
            record.value(
                f"{name}_pooled", pooled, f"{who}: squared error over squared bound, pooled", error=pooled_error,
                goal=bool(pooled - 2 * pooled_error < 1),
            )  # fmt: skip


def main(record: Record) -> None:
    """Fit one sample and test another, or test bright galaxies."""
    options, numbers = record.options, load_numbers().error
    setting = setting_of(record, options.filter)
    if options.bright:
        return bright(record, setting, numbers)
    how = TOY if record.toy else {}
    count, cells = TOY_OBJECTS if record.toy else options.objects, setting.psf.oversampling
    fitted(record, sample(setting, count, 11, **how), numbers, cells)
    tested(record, sample(setting, count, 12, **how), numbers, cells)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--objects", type=int, default=160, help="in each sample, half of them stars")
    parser.add_argument("--filter", default="r", help="imaging filter")
    parser.add_argument("--bright", action="store_true", help="bright galaxies instead")
    with Record(parser) as record:
        main(record)
