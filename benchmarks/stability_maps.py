"""Maps of the visible error of photons and stamps, and a check that the policy uses each only where it is accurate.

    python benchmarks/stability_maps.py [--output results/bench] [--electrons 1e7]

The maps are: galaxies (disk, bulge; |e| = 0.4) over half-light radius and light, by both methods; stamps of stars over
reach and light; stamps of galaxies of 1e5 electrons over Sersic index and half-light radius. All are at a node of the
PSF set, in r, 150 s. Truth is the reference renderer on the same PSF set, or direct optics (bench.imaging.truth) for
the map over Sersic indices. Errors are in units of the object's own noise (bench.imaging.measures, `visible`). A photon
image has `--electrons` electrons. Photons' maps are upper limits: the root of the squared error plus two of its
standard deviations, which dominate for bright objects. Writes docs/figures/stability.png and prints how often an error
is above eps, or above the bound that the policy states, where the policy chooses that method.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from csstsim.base.counter import object_keys
from csstsim.base.rng import stream
from csstsim.bench.imaging.cases import make_case
from csstsim.bench.imaging.measures import errors
from csstsim.bench.imaging.methods import standard
from csstsim.bench.imaging.truth import Truth
from csstsim.bench.setting import make_setting
from csstsim.catalog.selection.reach import STAR_MIN
from csstsim.profiles.sersic import sersic_b
from csstsim.render import policy
from csstsim.render.canvas import Canvas
from csstsim.render.drawing import Drawing
from csstsim.render.imaging.photons import shoot_scene
from csstsim.render.imaging.stamps import draw_scene
from csstsim.render.settings import load_numbers

SIZES = np.geomspace(0.05, 5.0, 7)  # arcsec
LIGHT = np.geomspace(10, 1e7, 7)  # electrons
REACHES = np.array([4, 8, 12, 16, 24, 32])  # px
INDICES = np.array([1.0, 1.5, 2.2, 3.0, 4.0, 5.0, 6.2])
SMALL = np.geomspace(0.05, 1.5, 6)  # arcsec, for the map over indices
MIDDLE = 1e5  # electrons, for the same
E = 0.4
EPS = load_numbers().presets["standard"].eps
FIGURE = Path(__file__).parents[1] / "docs" / "figures" / "stability.png"


def case_of(setting, electrons, **shape):
    """Return a Case; all have the same position and orientation."""
    return make_case(setting, stream(3, "stability", "maps"), 0, electrons, **shape)


def visible(setting, case, image, truth, drawn=np.inf):
    """Return (visible error of an image of unit light, its part due to chance)."""
    box = setting.psf.image.shape[-1] / 2 / setting.psf.oversampling
    value, chance = errors(image, truth, setting.variance, case.electrons, drawn, box=box)
    return value[-1], chance[-1] if np.isfinite(drawn) else 0.0


def photons(setting, case, electrons):
    """Return the image of unit light on the case's window, drawn from `electrons` electrons."""
    canvas, bright = Canvas(None, case.window), case.brighter(electrons).scene
    canvas.count()
    shoot_scene(canvas, bright, object_keys(np.uint64(1), np.zeros(1, int)), setting.table)
    return canvas.counted / electrons


def stamp(setting, case, reach=None):
    """Return the image of unit light on the case's window."""
    canvas, reach = Canvas(np.zeros(case.window.shape), case.window), case.row["reach"] if reach is None else reach
    draw_scene(canvas, case.scene.sized(reach), setting.mixer)
    return canvas.expected / case.electrons


def choice_of(setting, case):
    """Return (method, stated bound) of the policy."""
    drawing = Drawing(setting.wcs, setting.psf, setting.exptime, variance=setting.variance)
    made = policy.choose(case.scene.sized(case.row["reach"]), drawing)
    return made.method[0], made.error[0]


def galaxies(setting, bulge, electrons):
    """Return {method: (4, size, light)}: visible error, its chance, whether the policy chooses it, its stated bound."""
    found = {method: np.zeros((4, len(SIZES), len(LIGHT))) for method in (policy.PHOTONS, policy.STAMP)}
    for i, size in enumerate(SIZES):
        cases = [case_of(setting, light, bulge=bulge, size=size, e=E) for light in LIGHT]
        widest = max(cases, key=lambda case: case.half)
        truth, shot = standard(setting, widest) / widest.electrons, photons(setting, widest, electrons)
        for j, case in enumerate(cases):
            cut = slice(widest.half - case.half, widest.half + case.half + 1)
            method, bound = choice_of(setting, case)
            images = {policy.PHOTONS: (shot[cut, cut], electrons), policy.STAMP: (stamp(setting, case), np.inf)}
            for kind, (image, drawn) in images.items():
                error, chance = visible(setting, case, image, truth[cut, cut], drawn)
                found[kind][:, i, j] = error, chance, method == kind, bound
    return found


def stars(setting):
    """Return the visible errors of stamps, (reach, light)."""
    error = np.zeros((len(REACHES), len(LIGHT)))
    for j, light in enumerate(LIGHT):
        case = case_of(setting, light)
        truth = standard(setting, case) / case.electrons
        error[:, j] = [visible(setting, case, stamp(setting, case, reach), truth)[0] for reach in REACHES]
    return error


def indices(setting):
    """Return the visible errors of stamps, (size, index), against direct optics."""
    error, truth = np.zeros((len(SMALL), len(INDICES))), Truth(setting)
    response = truth.psf(*(case_of(setting, MIDDLE).row[name][0] for name in "xy"))
    truth.psf = lambda x, y: response  # all have the same position
    for i, size in enumerate(SMALL):
        case = case_of(setting, MIDDLE, bulge=1.0, size=size, e=E)
        for j, index in enumerate(INDICES):
            sersic = case.scene.sersic.copy()
            sersic[0, 1, :2] = index, sersic_b(index)
            other = replace(case, scene=replace(case.scene, sersic=sersic))
            error[i, j] = visible(setting, other, stamp(setting, other), truth(other))[0]
    return error


def measure(setting, electrons):
    """Return {name: maps}."""
    return {
        "disks": galaxies(setting, 0.0, electrons), "bulges": galaxies(setting, 1.0, electrons),
        "stars": stars(setting), "indices": indices(setting),
    }  # fmt: skip


def panel(axis, x, y, error, title, labels, chosen=None, chance=0.0):
    """Draw one map: colour, the boundary where the error passes eps, rings where the policy chooses the method."""
    shown = np.sqrt(np.maximum(error * np.abs(error), 1e-8) + 2 * np.square(chance))
    mesh = axis.pcolormesh(x, y, shown, norm=LogNorm(1e-3, 10), cmap="viridis", shading="nearest")
    axis.contour(x, y, np.log(shown / EPS), levels=[0.0], colors="white", linewidths=2)
    if chosen is not None:
        rows, columns = np.nonzero(chosen)
        axis.plot(x[columns], y[rows], "o", ms=5, mfc="none", mec="#ff5d3b", mew=1.5)
    axis.set(yscale="log", title=title, xlabel=labels[0], ylabel=labels[1], xscale="log" if x[-1] > 10 else "linear")
    return mesh


def report(found):
    for name in ("disks", "bulges"):
        for kind, (error, chance, chosen, bound) in found[name].items():
            mine = chosen > 0
            signed, noise = (error * np.abs(error))[mine], 2 * chance[mine] ** 2
            above = [int((signed > limit**2 + noise).sum()) for limit in (EPS, np.maximum(bound[mine], EPS))]
            print(
                f"{policy.METHODS[kind]:8s} {name:7s} chosen {mine.sum():2d} of {mine.size}: {above[0]} above eps, "
                f"{above[1]} above eps and the stated bound; bound at most {bound[mine].max(initial=0):.2f}, "
                f"chance at most {chance[mine].max(initial=0):.2f}"
            )
    print(f"stars at the chosen reach: worst {found['stars'][-1].max():.2f}; indices: {found['indices'].max():.2f}")


def draw(found, path):
    figure = Figure(figsize=(9.5, 11.5), layout="constrained")
    axes, light, radius = figure.subplots(3, 2), "electrons", "half-light radius [arcsec]"
    for row, name in zip(axes, ("disks", "bulges"), strict=False):
        for axis, (kind, (error, chance, chosen, _)) in zip(row, found[name].items(), strict=True):
            title = f"{policy.METHODS[kind]}: {name}" + (", upper limits" if chance.any() else "")
            panel(axis, LIGHT, SIZES, error, title, (light, radius), chosen, chance)
    chosen = np.broadcast_to(REACHES[:, None] >= STAR_MIN, found["stars"].shape)
    panel(axes[2, 0], LIGHT, REACHES, found["stars"], "stamp: stars", (light, "reach [pixel]"), chosen)
    title = "stamp: galaxies of 1e5 electrons"
    mesh = panel(axes[2, 1], INDICES, SMALL, found["indices"], title, ("Sersic index", radius))
    figure.colorbar(mesh, ax=axes, label="visible error [noise of the object]", shrink=0.5, extend="both")
    figure.savefig(path, dpi=75)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--output", default="results/bench", help="folder of the PSF set, as of csstsim bench")
    parser.add_argument("--electrons", type=float, default=1e7, help="electrons of a photon image")
    args = parser.parse_args()
    found = measure(make_setting(args.output, "r"), args.electrons)
    report(found)
    draw(found, FIGURE)


if __name__ == "__main__":
    main()
