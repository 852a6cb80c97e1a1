"""Distribution and skewness of convergence beside those of ray-tracing through N-body simulations.

    PYTHONPATH=benchmarks python benchmarks/convergence_pdf.py [--patches 6] [--seed 1]        (4 CPU-minutes a patch)

The published distribution is that of full-sky maps of Takahashi et al. 2017 without smoothing
(published_convergence.yaml). Ours is made with their cosmology and source redshift, in points of 0.2 arcmin. Which of
their resolutions was counted is not said. A resolution leaves 1 / (1 + (l / l_r)^2) of the power, as they give it. Our
maps are smoothed alike, with the l_r that leaves the published dispersion. Prints l_r, skewness, kurtosis and shares of
the sky above a convergence; errors are from the scatter of patches at that l_r. Exit code 1 if the skewness differs by
more than 10% and two errors. Patches are kept in results/convergence_pdf.
"""

import argparse
import sys
from pathlib import Path

import numpy as np
from peaks import above, convergence, matter_field
from scipy.optimize import brentq
from structure_lensing import centres, patch_grid

from csstsim.instrument.load import read_data

ROOT = Path(__file__).resolve().parents[1]
DEGREES, SIZE = 5.6, 1680  # of a patch, and steps along a side
BORDER = 40  # steps left out, where the smoothing lacks points
ABOVE = (-0.03, -0.02, -0.01, 0.0, 0.01, 0.02, 0.03, 0.05, 0.07, 0.1, 0.15, 0.2)


def smoothed(kappa, limit):
    """Return a map with the power that a resolution of multipole `limit` leaves, without its border."""
    ell = 2 * np.pi * np.hypot(*np.meshgrid(*[np.fft.fftfreq(len(kappa), np.radians(DEGREES) / SIZE)] * 2))
    kept = np.fft.ifft2(np.fft.fft2(kappa) / np.sqrt(1 + (ell / limit) ** 2)).real
    return kept[BORDER:-BORDER, BORDER:-BORDER]


def moments(shares, values):
    """Return dispersion, skewness and excess kurtosis of shares (..., n) at values (n,)."""
    total = shares.sum(axis=-1)
    mean = (shares * values).sum(axis=-1) / total
    second, third, fourth = ((shares * (values - mean[..., None]) ** n).sum(axis=-1) / total for n in (2, 3, 4))
    return np.sqrt(second), third / second**1.5, fourth / second**2 - 3


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--patches", type=int, default=6, help="at least 2")
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    published = read_data(Path(__file__).with_name("published_convergence.yaml"))
    shares = np.array(published["shares"])
    edges = published["first"] + published["width"] * np.arange(len(shares) + 1)
    middles = 0.5 * (edges[1:] + edges[:-1])
    wanted = moments(shares, middles)
    field = matter_field(asked.seed, published["cosmology"])
    maps = []
    for n, centre in enumerate(centres(asked.patches)):
        path = ROOT / "results" / "convergence_pdf" / f"{asked.seed}_{n}.npy"
        maps.append(convergence(field, patch_grid(*centre, DEGREES, SIZE), (published["z"],), path)[0])
    spread = wanted[0] ** 2 - published["width"] ** 2 / 12  # without that of the bins
    limit = brentq(lambda at: np.mean([smoothed(kappa, at).var() for kappa in maps]) - spread, 2e3, 2e5, rtol=1e-3)
    kept = [smoothed(kappa, limit) for kappa in maps]
    counted = np.array([np.histogram(kappa - np.mean(kept), edges)[0] / kappa.size for kappa in kept])
    print(f"{asked.patches} patches of {DEGREES} deg, l_r {limit:.0f}, dispersion {wanted[0]:.5f}")
    ours = moments(counted.mean(axis=0), middles)
    each = [moments(np.delete(counted, n, axis=0).mean(axis=0), middles) for n in range(len(counted))]
    errors = np.std(each, axis=0) * np.sqrt(len(each) - 1)  # jackknife
    for name, found, error, value in zip(("dispersion", "skewness", "kurtosis"), ours, errors, wanted, strict=True):
        print(f"{name:10s} ours {found:8.4f} +- {error:.4f}   published {value:8.4f}   {found / value:.3f}")
    print("share of the sky above a convergence, ours, published, and their ratio")
    own, theirs = np.array([above(one, edges, ABOVE) for one in counted]), above(shares, edges, ABOVE)
    for kappa, value, ratio in zip(ABOVE, theirs, (own / theirs).T, strict=True):
        error = ratio.std(ddof=1) / np.sqrt(len(ratio))
        print(f"{kappa:5.2f}  {ratio.mean() * value:9.3e} {value:9.3e}   {ratio.mean():.3f} +- {error:.3f}")
    sys.exit(int(abs(ours[1] / wanted[1] - 1) > 0.1 + 2 * errors[1] / wanted[1]))


if __name__ == "__main__":
    main()
