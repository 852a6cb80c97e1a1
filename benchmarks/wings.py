"""The light of a bright star: the point-spread function out to the chip's size, its joins, ghosts and cost.

    python benchmarks/wings.py

Records, for r unless stated otherwise: the diffraction image against the closed form of its wing; the anchors of the
halo and its light in each band; the light of a star summed over a large image; the join of box and wing in units of
noise at magnitudes 5 to 20; the CPU time of a star by magnitude. Draws the profile and a 5th-magnitude star.
"""

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path

from evidence.record import Record

import matplotlib
import numpy as np

from csstsim.base.shipped import SHIPPED
from csstsim.catalog.selection.reach import wing_reach
from csstsim.catalog.selection.select import Noise
from csstsim.catalog.table import ObjectTable
from csstsim.instrument.camera import Camera, load_camera
from csstsim.instrument.chip import Window
from csstsim.instrument.pointing import Pointing
from csstsim.optics.geometry.wcs import ChipWCS
from csstsim.optics.psf.diffraction import Diffraction, blur
from csstsim.optics.psf.psf_file import PsfSet, pixel_response
from csstsim.optics.psf.psf_set import PsfSampling, make_psf
from csstsim.optics.psf.sampling import oversampling_of
from csstsim.optics.psf.wavefront import load_wavefront
from csstsim.optics.scatter.scattered_light import Scattered, read_scattered, scattered_light
from csstsim.render.canvas import Canvas
from csstsim.render.drawing import Drawing
from csstsim.render.imaging.reference import draw_objects
from csstsim.render.wings import FADE

matplotlib.use("agg")
from matplotlib import pyplot as plt

CHIP, EXPTIME = 9, 150.0
CELLS_PER_PIXEL = 2  # of the direct optics here
CENTRE = 4600.2, 4500.4  # px
LASER = 6328.0  # angstrom
REACH = 2048.0  # px, to which objects outside a window are drawn
GHOSTS = Window(4800, 7200, 4800, 7200)  # of the second picture
MAGNITUDES = (5, 8, 12, 15, 18, 20)


def diffraction(camera, wavelength, cells=1024):
    """Return (radius px, light per pixel) of the diffraction image alone on the boresight, from direct optics."""
    wavefront, cell = load_wavefront(camera.psf), camera.telescope.pixel_scale / CELLS_PER_PIXEL
    optics = Diffraction(wavelength, camera.telescope.diameter_m, cell, wavefront, cells)
    kernel = blur(camera.psf, cell, camera.detector.pixel_um / CELLS_PER_PIXEL)
    image = pixel_response(optics.image(optics.transfer(wavefront.coefficients(0, 0)), kernel), CELLS_PER_PIXEL)
    axis = (np.arange(cells - 1) - (cells - 2) / 2) / 2
    return np.hypot(axis, axis[:, None]), image


def ring(r, image, radius, width=0.05):
    """Return the mean over the ring `radius` * (1 +- width)."""
    return image[np.abs(r / radius - 1) < width].mean()


def report_diffraction(camera: Camera, record: Record) -> None:
    """Record ring means of the diffraction image over the closed form L / (pi^3 r^3) of its wing."""
    radii, wavelengths = (10, 20, 30, 45, 60, 100, 200), (2900.0, 4800.0, 6200.0, 9500.0)
    rows, far = [], []
    for wavelength in wavelengths[: 1 if record.toy else None]:
        r, image = diffraction(camera, wavelength)
        lam_d = np.degrees(wavelength * 1e-10 / camera.telescope.diameter_m) * 3600 / camera.telescope.pixel_scale
        model = np.divide(lam_d, (np.pi * r) ** 3, out=np.zeros_like(r), where=r > 0)
        ratios = [ring(r, image, k) / ring(r, model, k) for k in radii]
        far += ratios[radii.index(60) :]
        rows.append([f"{wavelength / 10:.0f}", *(f"{ratio:.3f}" for ratio in ratios)])
    record.table("diffraction", ["nm", *(f"{radius} px" for radius in radii)], rows)
    what = "direct optics over the closed form of its wing, 60 to 200 px"
    record.value("diffraction_minimum", min(far), f"{what}, minimum", above=0.99)
    record.value("diffraction_maximum", max(far), f"{what}, maximum", below=1.01)


def halo_alone(wing):
    return replace(wing, airy=0 * wing.airy)


def report_anchors(camera: Camera, record: Record) -> None:
    """Record the halo where the paper has figures, and the light beyond some radii in each band."""
    r, image = diffraction(camera, LASER, 512)
    wing = scattered_light(camera, camera.filters["r"]).wing
    scattered = wing.scattered.mean()
    peak = (1 - scattered) * image.max() + wing.halo(0.0).mean()
    for radius in (10, 100):
        where = f"at {radius} px, {LASER / 10} nm, over the peak of the pixel-integrated image"
        halo = wing.halo(float(radius)).mean() / peak
        published = 1e-2 / radius**2
        record.value(f"halo_{radius}", halo, f"halo {where}", below=1.1 * published, above=0.9 * published)
        direct = (1 - scattered) * ring(r, image, radius) / peak
        record.value(f"diffraction_{radius}", direct, f"diffraction image alone {where}")
    record.value("scattered", scattered, "light of the halo, r band")
    for radius, where in ((10, '10 px (0.74")'), (64, "64 px")):
        beyond = halo_alone(wing).light_beyond(float(radius)).mean()
        record.value(f"halo_beyond_{radius}", beyond, f"light of the halo beyond {where}, r band")
    rows, radii = [], (10, 32, 64, 1000, 10000)
    for name, band in camera.filters.items():
        wing = scattered_light(camera, band).wing
        rows.append([name, *(f"{wing.light_beyond(float(radius)).mean():.4f}" for radius in radii)])
    record.table("beyond", ["band", *(f"beyond {radius} px" for radius in radii)], rows)
    outside = [np.mean(scattered_light(camera, band).wing.light_beyond(32.0)) for band in camera.filters.values()]
    record.value("beyond_box_minimum", min(outside), "light beyond 32 px, halo and diffraction, minimum over bands")
    record.value("beyond_box_maximum", max(outside), "light beyond 32 px, halo and diffraction, maximum over bands")
    small = [name for name in camera.filters if oversampling_of(name, camera.psf) == 4]  # a box of 32 px, not 64
    between = {name: np.mean(np.subtract(*diffraction_beyond(camera, name, (32.0, 64.0)))) for name in small}
    for word, name in (("minimum", min(between, key=between.get)), ("maximum", max(between, key=between.get))):
        what = f"light of the diffraction image between 32 and 64 px, {word} over bands with 4 cells ({name})"
        record.value(f"between_boxes_{word}", between[name], what)


def report_ghosts(camera: Camera, record: Record) -> None:
    """Record the light of the ghosts, and the faintest star whose ghosts are rendered."""
    ghosts = {name: scattered_light(camera, band).ghosts for name, band in camera.filters.items()}
    light = {name: each.light.sum() for name, each in ghosts.items()}
    for word, name in (("minimum", min(light, key=light.get)), ("maximum", max(light, key=light.get))):
        record.value(f"ghosts_{word}", light[name], f"light of the ghosts over the star's, {word} over bands ({name})")
    for key, what, levels in (
        ("disc", "one disc", [each.level.max() for each in ghosts.values()]),
        ("overlap", "where all discs overlap", [each.level.sum() for each in ghosts.values()]),
    ):
        record.value(
            f"ghost_{key}", max(levels), f"light per pixel of a ghost over the star's, {what}, maximum over bands"
        )
    electrons = ghosts["r"].faintest / ghosts["r"].level.max()
    mag = camera.filters["r"].zeropoint(camera.telescope) - 2.5 * np.log10(electrons / EXPTIME)
    record.value("ghost_faintest", mag, f"faintest star whose ghosts are rendered, {EXPTIME:.0f} s", unit="r mag")


def diffraction_beyond(camera: Camera, name: str, radii: tuple[float, ...]) -> list[np.ndarray]:
    """Return the light of a band's mean diffraction wing, without any halo, beyond radii [px]."""
    wing = scattered_light(camera, camera.filters[name]).wing
    return [2 * wing.airy / (np.pi**2 * radius) for radius in radii]


class Scene:
    """One star on chip 9."""

    def __init__(self, camera, folder):
        self.camera, self.chip, self.filter = camera, camera.chips[CHIP], camera.filters["r"]
        path = Path(folder) / "psf.h5"
        make_psf(
            path, self.chip, self.filter, camera.psf, PsfSampling(2), camera_digest=camera.digest,
            scattered=scattered_light(camera, self.filter),
        )  # fmt: skip
        self.psf = PsfSet(path)
        self.box = self.psf.image.shape[-1] // (2 * self.psf.oversampling)  # px, half its side
        self.fade = tuple(round(part * self.box) for part in FADE)
        self.scattered = read_scattered(self.psf)
        self.wcs = ChipWCS(self.chip, Pointing("SCIE", 60.0, -40.0, 0.0, "2027-06-26T20:35:58", EXPTIME, None, None))
        self.noise = Noise(self.filter.sky, camera.detector.dark, camera.detector.read_noise).variance(EXPTIME)

    def draw(self, mag, window, centre=CENTRE, scattered=None):
        """Return (image, truth table) of one star of AB magnitude `mag`; `scattered` replaces the camera's."""
        electrons = EXPTIME * 10 ** (0.4 * (self.filter.zeropoint(self.camera.telescope) - mag))
        wing = wing_reach(np.array([electrons]), self.noise, self.scattered.wing)
        ra, dec = self.wcs.pixel_to_world(*(np.array([c]) for c in centre))
        columns = {f"flux{i}": np.array([electrons / EXPTIME / 4]) for i in range(4)}
        table = ObjectTable.complete(columns | {
            "id": np.arange(1), "obj_type": np.zeros(1, int), "ra": ra, "dec": dec, "ra_orig": ra, "dec_orig": dec,
            "x": np.array([centre[0]]), "y": np.array([centre[1]]), "reach": np.full(1, self.box), "lost": np.zeros(1),
            "wing": np.where(wing > self.box, wing, 0.0),
        }, ())  # fmt: skip
        canvas = Canvas(np.zeros(window.shape, np.float32), window)
        drawing = Drawing(self.wcs, self.psf, EXPTIME, scattered or self.scattered)
        return canvas.expected, draw_objects(canvas, table, drawing)


def around(half):
    x, y = (round(c) for c in CENTRE)
    return Window(x - half, x + half + 1, y - half, y + half + 1)


def distances(window):
    return np.hypot(np.arange(window.x0, window.x1) - CENTRE[0], np.arange(window.y0, window.y1)[:, None] - CENTRE[1])


def report_energy(scene: Scene, record: Record) -> None:
    """Record the light of a star within squares, and what the closed form has within the circle of the same area."""
    rows, off = [], []
    for mag, half in ((12, 200),) if record.toy else ((12, 500), (5, 1000), (5, 4000)):
        image, _ = scene.draw(mag, around(half))
        electrons = EXPTIME * 10 ** (0.4 * (scene.filter.zeropoint(scene.camera.telescope) - mag))
        ghosts = scene.scattered.ghosts.light.sum() * bool(scene.scattered.ghosts.visible(electrons))
        closed = 1 - scene.scattered.wing.light_beyond((2 * half + 1) / np.sqrt(np.pi)).mean()
        drawn = image.sum(dtype=float) / electrons - ghosts
        off.append(abs(drawn - closed))
        rows.append([f"r = {mag}", f"{2 * half + 1} px", f"{drawn:.5f}", f"{closed:.5f}"])
    record.table("light", ["star", "square", "flux rendered", "light of the closed form"], rows)
    record.value("light_off", max(off), "flux of a star rendered in a square less the closed form", below=1e-3)


def second_difference(image):
    """Return |second differences| along x, without the edges."""
    return np.abs(image[:, 2:] - 2 * image[:, 1:-1] + image[:, :-2])


def optics_texture(scene, inner, outer):
    """Return the largest second difference, over all light, of direct optics minus its mean wing between two radii."""
    waves = [diffraction(scene.camera, w, 512) for w in scene.filter.psf_wavelength]
    r, image = waves[0][0][1::2, 1::2], np.mean([image for _, image in waves], axis=0)[1::2, 1::2]
    mean = scene.scattered.wing.airy.mean() / (np.pi * np.maximum(r, 1)) ** 3
    return second_difference(image - mean)[((r > inner) & (r < outer))[:, 1:-1]].max()


def report_joins(scene: Scene, record: Record) -> None:
    """Record the join of box and wing, in units of the sky's noise.

    Second differences along x, less those of the smooth profile: the texture of rings and speckles, and of the optics
    there without any join. The step is that of a star without wing.
    """
    inner, outer = scene.fade
    record.value("fade_inner", inner, "the box fades into the wing from", unit="px")
    record.value("fade_outer", outer, "the box fades into the wing to", unit="px")
    rows, missing = [], []
    texture = optics_texture(scene, inner, outer)
    sky = np.sqrt(scene.noise)
    smooth = replace(scene.scattered, ghosts=None)
    for mag in MAGNITUDES[:2] if record.toy else MAGNITUDES:
        window = around(90)
        r = distances(window)
        image, truth = scene.draw(mag, window, scattered=smooth)
        boxed, _ = scene.draw(mag, around(scene.box), scattered=Scattered())
        electrons, reach = truth["electrons"][0], float(truth["wing"][0])
        model = electrons * smooth.wing.profile(np.maximum(r, 1.0)).mean(axis=0)
        joint = ((r > inner) & (r < outer))[:, 1:-1]
        excess = second_difference(image - model)[joint].max()
        bins = r.astype(int).ravel()
        rings = np.bincount(bins, (image - model).ravel()) / np.bincount(bins)
        mean = second_difference(rings[None, inner - 3 : outer + 3]).max()
        there = model[np.abs(r - 0.83 * scene.box) < 1].mean()
        optics = texture * electrons / sky
        missing.append((optics - excess / sky) * sky / np.sqrt(there + scene.noise))
        step = boxed[scene.box, 1] / sky
        rows.append([f"r = {mag}", f"{reach:.0f}", *(f"{n:.2g}" for n in (step, excess / sky, optics, mean / sky))])
    header = ["star", "wing above the noise to [px]", "step without a wing", "texture where the box fades"]
    record.table("joins", [*header, "texture of the optics there", "texture of rings' means"], rows)
    what = "texture that the join leaves out, in units of the noise of sky and star there, maximum over magnitudes"
    record.value("texture_missing", max(missing), what)
    record.value("sky_noise", sky, f"noise of the sky, r band, {EXPTIME:.0f} s", unit="e-")


def report_reach(scene: Scene, record: Record) -> None:
    """Record to which radius the wing of a star is above the noise, and the magnitude from which it leaves the box."""
    zero = scene.filter.zeropoint(scene.camera.telescope)

    def reach(mag: np.ndarray) -> np.ndarray:
        return wing_reach(EXPTIME * 10 ** (0.4 * (zero - mag)), scene.noise, scene.scattered.wing)

    for mag in (5.0, 12.0, 16.0):
        radius = reach(np.array([mag]))[0]
        record.value(f"reach_{mag:.0f}", radius, f"wing of a star of r = {mag:.0f} above the noise to", unit="px")
    for mag in (5, 9):
        electrons = EXPTIME * 10 ** (0.4 * (zero - mag))
        level = electrons * scene.scattered.wing.profile(REACH).mean() / np.sqrt(scene.noise)
        record.value(
            f"left_out_{mag}", level, f"light of a star of r = {mag} at {REACH:.0f} px", unit="noise of the sky"
        )
    grid = np.arange(15.0, 28.0, 0.05)
    faintest = grid[reach(grid) > scene.box].max()
    record.value("faintest", faintest, f"faintest star with a wing beyond {scene.box} px", unit="r mag")


def report_cost(scene: Scene, record: Record) -> None:
    """Record the CPU seconds of a star on the full chip."""
    window = around(500) if record.toy else scene.chip.full_window
    scene.draw(20, around(100))
    rows = []
    for mag in (*MAGNITUDES, 23):
        rows.append([f"r = {mag}", f"{scene.draw(mag, window)[1]['ms'][0] / 1000:.3f}"])
    record.table("costs", ["star", "on a whole chip, CPU-s"], rows)


def draw_profile(scene: Scene, path: Path, half: int) -> None:
    """Draw the profile of a star, `half` px to each side, and the light beyond radii."""
    figure, axes = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
    image, truth = scene.draw(5, around(half))
    r, electrons = distances(around(half)), truth["electrons"][0]
    edges = np.geomspace(1, 5600, 120)
    where = np.digitize(r, edges).ravel()
    count = np.bincount(where, minlength=121)
    seen = np.bincount(where, image.ravel() / electrons, 121) / np.maximum(count, 1)
    centres = np.sqrt(edges[1:] * edges[:-1])
    peak = float(image.max()) / electrons
    grid = np.geomspace(1, 1e4, 300)
    wing = scene.scattered.wing
    axes[0].loglog(centres, seen[1:120] / peak, "k.", ms=4, label="rendered, mean of rings (mag 5)")
    axes[0].loglog(grid, wing.halo(grid).mean(axis=0) / peak, label="halo")
    axes[0].loglog(grid, (wing.profile(grid) - wing.halo(grid)).mean(axis=0) / peak, label="mean diffraction wing")
    axes[0].loglog([10, 100], [1e-4, 1e-6], "r*", ms=10, label="Wei et al. 2025, scattered light")
    axes[0].axvspan(*scene.fade, color="0.85", label="box fades into wing")
    axes[0].set(xlabel="radius [px]", ylabel="light per pixel / peak", ylim=(1e-13, 2), xlim=(1, 1e4))
    axes[0].legend(fontsize=7)
    radii = np.geomspace(1, 1e4, 100)
    axes[1].semilogx(radii, wing.light_beyond(radii).mean(axis=0), label="halo and diffraction wing")
    axes[1].semilogx(radii, halo_alone(wing).light_beyond(radii).mean(axis=0), label="halo")
    axes[1].plot([0.75 / 0.074], [0.05], "r*", ms=10, label='HST: about 5% beyond 0.75"')
    axes[1].set(xlabel="radius [px]", ylabel="light beyond", ylim=(0, 0.12), xlim=(2, 1e4))
    axes[1].legend(fontsize=7)
    figure.savefig(path, dpi=80)


def draw_star(scene: Scene, path: Path, window: Window) -> None:
    """Draw a bright star in a window of the chip, and its ghosts."""
    figure, axes = plt.subplots(1, 2, figsize=(9.5, 4.6), layout="constrained")
    rng = np.random.default_rng(1)
    sky = (scene.filter.sky + 0.02) * EXPTIME
    image, _ = scene.draw(5, window, (6000.0, 6000.0))
    crop = image[GHOSTS.y0 - window.y0 : GHOSTS.y1 - window.y0, GHOSTS.x0 - window.x0 : GHOSTS.x1 - window.x0]
    noisy = rng.poisson(crop[::3, ::3] + sky) - sky
    for ax, part, extent, limits, title in (
        (
            axes[0],
            image[::12, ::12],
            (window.x0, window.x1, window.y0, window.y1),
            (-1, 4.5),
            "r = 5 on chip 9, expected light",
        ),
        (axes[1], noisy, (GHOSTS.x0, GHOSTS.x1, GHOSTS.y0, GHOSTS.y1), (0.5, 4), "its ghosts, with photon noise"),
    ):
        shown = ax.imshow(np.log10(np.maximum(part, 0.1)), origin="lower", extent=extent, cmap="magma")
        shown.set_clim(*limits)
        ax.set(title=title, xlabel="x [px]", ylabel="y [px]")
        figure.colorbar(shown, ax=ax, label="log10 electrons per pixel", shrink=0.8)
    figure.savefig(path, dpi=62)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--instrument", default=SHIPPED / "instrument", help="folder of the camera's data files")
    with Record(parser) as record, tempfile.TemporaryDirectory() as folder:
        camera = load_camera(record.options.instrument)
        report_diffraction(camera, record)
        report_anchors(camera, record)
        report_ghosts(camera, record)
        scene = Scene(camera, folder)
        for report in (report_energy, report_joins, report_reach, report_cost):
            report(scene, record)
        draw_profile(scene, record.figure("wings.png"), 300 if record.toy else 4000)
        draw_star(scene, record.figure("ghosts.png"), GHOSTS if record.toy else scene.chip.full_window)
