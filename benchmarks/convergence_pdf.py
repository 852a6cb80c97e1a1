"""Distribution and skewness of convergence compared with those of ray-tracing through N-body simulations.

    python benchmarks/convergence_pdf.py [--patches 6] [--seed 1]                            (4 CPU-minutes a patch)

The published distribution is that of full-sky maps of Takahashi et al. 2017 without smoothing
(published_convergence.yaml). Ours is made with their cosmology and source redshift, in points of 0.2 arcmin. Which of
their resolutions was counted is not said. A resolution leaves 1 / (1 + (l / l_r)^2) of the power, as they give it. Our
maps are smoothed alike, with the l_r that leaves the published dispersion. Errors are from the scatter of patches at
that l_r. The goal: the skewness differs by at most 10% and two errors. Patches are kept in results/convergence_pdf.
"""

import argparse
from pathlib import Path

from evidence.record import Record

import numpy as np
from peaks import above, convergence, matter_field
from scipy.optimize import brentq
from structure_lensing import centres, kept_folder, patch_grid

from csstsim.instrument.load import read_data

SIZE, TOY_SIZE = 1680, 140  # steps along a side of a patch
PIXEL = 0.2  # arcmin, a step
BORDER = 40  # steps left out, where the smoothing lacks points
ABOVE, VOID = (-0.02, 0.0, 0.02, 0.05, 0.1, 0.2), -0.03  # convergence
TOY_LIMIT = 20_000  # the multipole of the resolution at toy size, where few maps have another dispersion
MOST = 0.1  # difference of the skewness besides two errors


def smoothed(kappa, limit):
    """Return a map with the power that a resolution of multipole `limit` leaves, without its border."""
    ell = 2 * np.pi * np.hypot(*np.meshgrid(*[np.fft.fftfreq(len(kappa), np.radians(PIXEL / 60))] * 2))
    kept = np.fft.ifft2(np.fft.fft2(kappa) / np.sqrt(1 + (ell / limit) ** 2)).real
    return kept[BORDER:-BORDER, BORDER:-BORDER]


def moments(fractions: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return dispersion, skewness and excess kurtosis of fractions (..., n) at values (n,)."""
    total = fractions.sum(axis=-1)
    mean = (fractions * values).sum(axis=-1) / total
    second, third, fourth = ((fractions * (values - mean[..., None]) ** n).sum(axis=-1) / total for n in (2, 3, 4))
    return np.sqrt(second), third / second**1.5, fourth / second**2 - 3


def main(record: Record) -> None:
    asked, size = record.options, TOY_SIZE if record.toy else SIZE
    published = read_data(Path(__file__).with_name("published_convergence.yaml"))
    fractions = np.array(published["shares"])
    edges = published["first"] + published["width"] * np.arange(len(fractions) + 1)
    middles = 0.5 * (edges[1:] + edges[:-1])
    wanted = moments(fractions, middles)
    field, maps, folder = matter_field(asked.seed, published["cosmology"]), [], kept_folder(record, "convergence_pdf")
    for n, centre in enumerate(centres(1 if record.toy else asked.patches)):
        grid = patch_grid(*centre, size * PIXEL / 60, size)
        maps.append(convergence(field, grid, (published["z"],), folder / f"{asked.seed}_{n}.npy")[0])

    def variance(limit: float) -> float:
        return np.mean([smoothed(kappa, limit).var() for kappa in maps])

    spread = wanted[0] ** 2 - published["width"] ** 2 / 12  # without that of the bins
    spread = variance(TOY_LIMIT) if record.toy else spread
    limit = brentq(lambda at: variance(at) - spread, 2e3, 2e5, rtol=1e-3)
    kept = [smoothed(kappa, limit) for kappa in maps]
    counted = np.array([np.histogram(kappa - np.mean(kept), edges)[0] / kappa.size for kappa in kept])
    ours = moments(counted.mean(axis=0), middles)
    each = [moments(np.delete(counted, n, axis=0).mean(axis=0), middles) for n in range(len(counted))]
    errors = np.std(each, axis=0) * np.sqrt(len(each) - 1)  # jackknife
    record.value("limit", limit, "multipole l_r of the resolution that leaves the published dispersion")
    record.value("dispersion", ours[0], f"dispersion of convergence, published {wanted[0]:.5f}", error=errors[0])
    met = bool(abs(ours[1] / wanted[1] - 1) <= MOST + 2 * errors[1] / wanted[1])
    record.value("skewness", ours[1], f"skewness, published {wanted[1]:.2f}", error=errors[1], goal=met)
    lack, error = 1 - ours[1] / wanted[1], errors[1] / wanted[1]
    record.value("lack", lack, "what the skewness lacks of the published one", error=error)
    record.value("kurtosis", ours[2], f"excess kurtosis, published {wanted[2]:.2f}", error=errors[2])
    own, theirs = np.array([above(one, edges, ABOVE) for one in counted]), above(fractions, edges, ABOVE)
    ratio = own / theirs
    error = ratio.std(axis=0, ddof=1) / np.sqrt(len(ratio))
    rows = [
        ["fraction of our sky", *(f"{v:.2g}" if v < 0.1 else f"{v:.3f}" for v in own.mean(axis=0))],
        ["over ray-tracing", *(f"{r:.2f} ± {e:.2f}" for r, e in zip(ratio.mean(axis=0), error, strict=True))],
    ]
    record.table("above", ["convergence above", *(f"{kappa:g}" for kappa in ABOVE)], rows)
    for name, whose, counts in (("void", "our", counted.mean(axis=0)), ("void_theirs", "the published", fractions)):
        record.value(name, 1 - above(counts, edges, VOID), f"fraction of {whose} sky with convergence below {VOID:g}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--patches", type=int, default=6, help="at least 2")
    parser.add_argument("--seed", type=int, default=1)
    with Record(parser) as record:
        main(record)
