"""Maps of the visible error of photons and stamps, and a check that the policy uses each only where it is accurate.

    python benchmarks/stability_maps.py [--electrons 1e7]

The maps are: galaxies (disk, bulge; |e| = 0.4) over half-light radius and light, by both methods; stamps of stars over
reach and light; stamps of galaxies of 1e5 electrons over Sersic index and half-light radius. All are at a node of the
PSF set, in r, 150 s. Truth is the reference renderer on the same PSF set, or direct optics (bench.imaging.truth) for
the map over Sersic indices. Errors are in units of the object's own noise (bench.imaging.measures, `visible`). A photon
image has `--electrons` electrons. Photons' maps are upper limits: the root of the squared error plus two of its
standard deviations, which dominate for bright objects. Recorded is how often an error is above eps,
or above the bound that the policy states, where the policy chooses that method.
"""

import argparse
from dataclasses import dataclass, replace
from pathlib import Path

from evidence.record import Record

import numpy as np
from bench_setting import setting_of
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from csstsim.base.counter import object_keys
from csstsim.base.rng import stream
from csstsim.catalog.profiles.sersic import sersic_b
from csstsim.catalog.selection.reach import STAR_MIN
from csstsim.render.canvas import Canvas
from csstsim.render.drawing import Drawing
from csstsim.render.imaging.methods.photons import PHOTONS
from csstsim.render.imaging.methods.stamps import STAMPS
from csstsim.render.imaging.photons import shoot_scene
from csstsim.render.imaging.register import METHODS
from csstsim.render.imaging.stamps import draw_scene
from csstsim.render.method import Targets
from csstsim.render.policy import choose
from csstsim.render.settings import load_numbers
from csstsim.studies.bench.imaging.cases import make_case
from csstsim.studies.bench.imaging.measures import errors
from csstsim.studies.bench.imaging.methods import standard
from csstsim.studies.bench.imaging.truth import Truth
from csstsim.studies.bench.setting import Setting

SIZES = np.geomspace(0.05, 5.0, 7)  # arcsec
LIGHT = np.geomspace(10, 1e7, 7)  # electrons
REACHES = np.array([4, 8, 12, 16, 24, 32])  # px
INDICES = np.array([1.0, 1.5, 2.2, 3.0, 4.0, 5.0, 6.2])
SMALL = np.geomspace(0.05, 1.5, 6)  # arcsec, for the map over indices
MIDDLE = 1e5  # electrons, for the same
E = 0.4
EPS = load_numbers().presets["standard"].eps
# Every third of the axes, and electrons of a photon image, at the size of seconds
TOY_STEP, TOY_ELECTRONS = 3, 1e5


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
    """Return (code of the method, stated bound) of the policy."""
    drawing = Drawing(setting.wcs, setting.psf, setting.exptime, variance=setting.variance)
    made = choose(Targets(case.scene.sized(case.row["reach"]), drawing), METHODS)
    return made.method[0], made.error[0]


@dataclass(frozen=True)
class Axes:
    """Where errors are measured: SIZES, LIGHT, REACHES, INDICES and SMALL, or every so many of them."""

    step: int = 1

    def __getattr__(self, name: str) -> np.ndarray:
        return globals()[name.upper()][:: -self.step][::-1]


def galaxies(setting, bulge, electrons, axes):
    """Return {method: (4, size, light)}: visible error, its chance, whether the policy chooses it, its stated bound."""
    found = {method: np.zeros((4, len(axes.sizes), len(axes.light))) for method in (PHOTONS, STAMPS)}
    for i, size in enumerate(axes.sizes):
        cases = [case_of(setting, light, bulge=bulge, size=size, e=E) for light in axes.light]
        widest = max(cases, key=lambda case: case.half)
        truth, shot = standard(setting, widest) / widest.electrons, photons(setting, widest, electrons)
        for j, case in enumerate(cases):
            cut = slice(widest.half - case.half, widest.half + case.half + 1)
            method, bound = choice_of(setting, case)
            images = {PHOTONS: (shot[cut, cut], electrons), STAMPS: (stamp(setting, case), np.inf)}
            for kind, (image, drawn) in images.items():
                error, chance = visible(setting, case, image, truth[cut, cut], drawn)
                found[kind][:, i, j] = error, chance, method == kind.code, bound
    return found


def stars(setting, axes):
    """Return the visible errors of stamps, (reach, light)."""
    error = np.zeros((len(axes.reaches), len(axes.light)))
    for j, light in enumerate(axes.light):
        case = case_of(setting, light)
        truth = standard(setting, case) / case.electrons
        error[:, j] = [visible(setting, case, stamp(setting, case, reach), truth)[0] for reach in axes.reaches]
    return error


def indices(setting, axes):
    """Return the visible errors of stamps, (size, index), against direct optics."""
    error, truth = np.zeros((len(axes.small), len(axes.indices))), Truth(setting)
    response = truth.psf(*(case_of(setting, MIDDLE).row[name][0] for name in "xy"))
    truth.psf = lambda x, y: response  # all have the same position
    for i, size in enumerate(axes.small):
        case = case_of(setting, MIDDLE, bulge=1.0, size=size, e=E)
        for j, index in enumerate(axes.indices):
            sersic = case.scene.sersic.copy()
            sersic[0, 1, :2] = index, sersic_b(index)
            other = replace(case, scene=replace(case.scene, sersic=sersic))
            error[i, j] = visible(setting, other, stamp(setting, other), truth(other))[0]
    return error


def measure(setting: Setting, electrons: float, axes: Axes) -> dict:
    """Return {name: maps}."""
    return {
        "disks": galaxies(setting, 0.0, electrons, axes), "bulges": galaxies(setting, 1.0, electrons, axes),
        "stars": stars(setting, axes), "indices": indices(setting, axes),
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


def passes(light: np.ndarray, error: np.ndarray) -> float:
    """Return the least light at which the error of any size passes eps, between the map's own by power laws."""
    found = []
    for line in error:
        above = int((line > EPS).argmax())
        if line[above] > EPS and above:
            x, y = np.log(light[above - 1 : above + 1]), np.log(line[above - 1 : above + 1])
            found.append(np.exp(x[0] + (np.log(EPS) - y[0]) * (x[1] - x[0]) / (y[1] - y[0])))
    return min(found, default=np.nan)


def report(record: Record, found: dict, axes: Axes) -> None:
    """Record where a chosen method's error is above eps or its bound, and limits of what the maps show."""
    rows, limits, over = [], [], 0
    for name in ("disks", "bulges"):
        for kind, (error, chance, chosen, bound) in found[name].items():
            mine = chosen > 0
            signed, noise = (error * np.abs(error))[mine], 2 * chance[mine] ** 2
            above = [int((signed > limit**2 + noise).sum()) for limit in (EPS, np.maximum(bound[mine], EPS))]
            over += above[1]
            most = f"{bound[mine].max(initial=0):.2f}", f"{chance[mine].max(initial=0):.2f}"
            rows.append([kind.name, name, f"{mine.sum()} of {mine.size}", *above, *most])
        shot, chance = found[name][PHOTONS][:2]
        limits.append(np.sqrt(np.maximum(shot * np.abs(shot), 0) + 2 * chance**2).max(axis=0))
        least, what = (
            passes(axes.light, found[name][STAMPS][0]),
            f"minimum flux of {name} whose stamp is above eps",
        )
        record.value(f"{name}_from", least, what, unit="electrons")
    head = ["method", "galaxies", "chosen", "above eps", "above eps and bound", "bound, at most", "chance, at most"]
    record.table("chosen", head, rows)
    record.value("over", over, "positions where the chosen method's error is above eps and the stated bound", below=0)
    lines = zip(axes.light, np.max(limits, axis=0), found["stars"][-1], strict=True)
    record.table("by_light", ["electrons", "photons of galaxies, upper limit", "stamps of stars, full box"], [
        [f"{light:.0e}".replace("e+0", "e"), f"{limit:.2g}", f"{star:.2g}"] for light, limit, star in lines
    ])  # fmt: skip
    steep = found["indices"][:, axes.indices >= 4]
    record.value("steep", steep.max(), f"stamps of galaxies of {MIDDLE:.0e} electrons, n = 4 to 6.2: largest error")


def draw(found: dict, path: Path, axes: Axes) -> None:
    """Draw the maps."""
    figure = Figure(figsize=(9.5, 11.5), layout="constrained")
    panels, light, radius = figure.subplots(3, 2), "electrons", "half-light radius [arcsec]"
    for row, name in zip(panels, ("disks", "bulges"), strict=False):
        for axis, (kind, (error, chance, chosen, _)) in zip(row, found[name].items(), strict=True):
            title = f"{kind.name}: {name}" + (", upper limits" if chance.any() else "")
            panel(axis, axes.light, axes.sizes, error, title, (light, radius), chosen, chance)
    chosen = np.broadcast_to(axes.reaches[:, None] >= STAR_MIN, found["stars"].shape)
    panel(panels[2, 0], axes.light, axes.reaches, found["stars"], "stamp: stars", (light, "reach [pixel]"), chosen)
    title = f"stamp: galaxies of {MIDDLE:.0e} electrons"
    mesh = panel(panels[2, 1], axes.indices, axes.small, found["indices"], title, ("Sersic index", radius))
    figure.colorbar(mesh, ax=panels, label="visible error [noise of the object]", shrink=0.5, extend="both")
    figure.savefig(path, dpi=75)


def main(record: Record) -> None:
    """Measure, record and draw the maps."""
    axes, electrons = (Axes(TOY_STEP), TOY_ELECTRONS) if record.toy else (Axes(), record.options.electrons)
    found = measure(setting_of(record, "r"), electrons, axes)
    report(record, found, axes)
    draw(found, record.figure("stability.png"), axes)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--electrons", type=float, default=1e7, help="electrons of a photon image")
    with Record(parser) as record:
        main(record)
