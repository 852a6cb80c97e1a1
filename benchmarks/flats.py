"""Shutter, vignetting, internal flats and lamps: their values with the shipped numbers, and their cost.

    python benchmarks/flats.py [--seed 9]

Prints the response (vignetting x internal flat x shutter, 150 s) of each band; its errors from the rotation of a
grating chip and from the coarse grid; the electrons of the shipped LED list in each band; and the CPU time of each part
on a full chip. Draws the vignetting, the flats of the lamps and the shutter's motion and profile.
"""

import argparse
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

from evidence.record import Record

import numpy as np

from csstsim.base.rng import Streams, stream
from csstsim.base.shipped import SHIPPED
from csstsim.instrument.camera import Camera, load_camera
from csstsim.instrument.chip import Chip, Window
from csstsim.layers import led_calib_model
from csstsim.optics.geometry.wcs import chip_plane
from csstsim.optics.throughput.coarse_grid import expand, grid_pixels
from csstsim.optics.throughput.flat import FlatField
from csstsim.optics.throughput.response import response_map, response_maximum
from csstsim.optics.throughput.shutter import deficit, exposed
from csstsim.simulation.exposure import Exposure
from csstsim.simulation.sim_steps import SimSteps
from csstsim.simulation.state import State

EXPTIME = 150.0


def places(chip, nodes=24):
    """Return mosaic positions x, y [px from the boresight] of a grid over a chip."""
    rotation, origin = chip_plane(chip)
    x, y = grid_pixels(chip, nodes)
    return [row[0] * (x - origin[0]) + row[1] * (y - origin[1]) for row in rotation]


def camera_numbers(seed: int) -> Callable:
    """Return the generators of the camera's fixed patterns by name."""
    return partial(stream, seed, "camera")


def report_response(camera: Camera, seed: int, record: Record) -> None:
    """Record the response of all pixels of each band's chips (every 16th)."""
    rows = []
    for name, filter_ in camera.filters.items():
        values, highest = [], 0.0
        for chip in [c for c in camera.chips.values() if c.filter == name][: 1 if record.toy else None]:
            flat = FlatField(camera.leds, camera_numbers(seed))
            full = response_map(chip, chip.full_window, filter_, EXPTIME, flat=flat, shutter=True)
            values.append(full[::16, ::16].ravel())
            highest = max(highest, response_maximum(chip, filter_, flat))
        values = np.concatenate(values)
        numbers = values.mean(), values.min(), values.max(), highest
        record.value(
            f"under_maximum_{name}",
            values.max() / highest,
            f"largest response in {name} over the declared one",
            below=1,
        )
        rows.append([name, *(f"{number:.4f}" for number in numbers)])
    record.table("response", ["band", "mean", "minimum", "maximum", "declared maximum"], rows)


def report_limits(camera: Camera, seed: int, record: Record) -> None:
    """Record the errors from a turned chip and from the coarse grid."""
    chip = camera.chips[30]
    rotation, origin = chip_plane(chip)
    x = np.arange(0, 9216, 32.0)
    column = exposed(chip, chip.full_window, EXPTIME)[::32]
    mosaic_x = (rotation[0, 0] * (x - origin[0]) + rotation[0, 1] * (y - origin[1]) for y in (0, 9231))
    off = max(np.abs(1 - deficit(0.01 * each, camera.telescope) / EXPTIME - column).max() for each in mosaic_x)
    record.value("turned_shutter", off, "shutter by columns on a grating chip turned by 1 deg: largest error")
    field, filter_ = FlatField(camera.leds, camera_numbers(seed)), camera.filters["GI"]
    made = expand(field.external_grid(chip, filter_), chip, Window(0, 9216, 4600, 4700))[50]
    place = [row[0] * (np.arange(9216) - origin[0]) + row[1] * (4650 - origin[1]) for row in rotation]
    weights = field.weights(filter_.wavelength, filter_.throughput)
    direct = field.vignetting(*place) * field.internal(chip, *place, weights)
    record.value("coarse_grid", np.abs(made / direct - 1).max(), "grid of 65 x 65 nodes: largest error", below=1e-3)


def report_lamps(camera: Camera, seed: int, record: Record) -> None:
    """Record the electrons of config/observations/led_flat.yaml, mean of a chip."""
    steps = SimSteps(SHIPPED / "observations" / "led_flat.yaml", "FLAT")
    layer = next(step for step in steps.stage("render") if step.name == "led_calib_model")
    rows = []
    for name in camera.filters:
        state = blank(camera, next(c for c in camera.chips.values() if c.filter == name), Window(0, 9216, 4600, 4610))
        layer.module.apply(state, layer.param, Streams(seed, "1", state.chip.id, layer.name))
        rows.append([name, f"{state.image.mean(dtype=float):.0f}"])
    record.table("lamps", ["band", "electrons"], rows)


def blank(camera: Camera, chip: Chip, window: Window) -> State:
    """Return the blank state of an exposure of EXPTIME."""
    pointing = type("Lit", (), {"exptime": EXPTIME, "obsid": "1"})
    return State.blank(Exposure(pointing, chip, window, None, camera))


def report_cost(camera: Camera, seed: int, record: Record) -> None:
    """Record the CPU seconds of each part on a full chip, best of 3."""
    chip = camera.chips[9]
    window = Window(0, 9216, 4600, 4900) if record.toy else chip.full_window
    filter_, streams = camera.filters["r"], Streams(seed, "1", 9, "x")
    param = led_calib_model.Param(LED_TYPE=["590", "670"], LED_TIME=[10.0, 10.0])
    state = blank(camera, chip, window)

    def response() -> np.ndarray:
        flat = FlatField(camera.leds, streams.camera)
        return response_map(chip, window, filter_, EXPTIME, flat=flat, shutter=True)

    share = response()
    image = np.full(window.shape, 31.0, np.float32)
    parts = {
        "response map, flat and shutter": response,
        "image x map": lambda: np.multiply(image, share, out=image),
        "led_calib_model": lambda: led_calib_model.apply(state, param, streams),
    }
    rows = []
    for name, part in parts.items():
        times = []
        for _ in range(3):
            start = time.process_time()
            part()
            times.append(time.process_time() - start)
        rows.append([name, f"{min(times):.2f}"])
    record.table("costs", ["on a whole chip", "CPU-s"], rows)


def draw(camera: Camera, seed: int, record: Record) -> None:
    """Draw the vignetting, the flats of the lamps and the shutter."""
    import matplotlib

    matplotlib.use("agg")
    import matplotlib.pyplot as plt

    field = FlatField(camera.leds, camera_numbers(seed))

    def show(axis, values, low, high, label=False):
        for chip in camera.chips.values():
            image = axis.imshow(
                values(chip), origin="lower", vmin=low, vmax=high, cmap="viridis", aspect="equal",
                extent=[chip.xc - 4608, chip.xc + 4608, chip.yc - 4616, chip.yc + 4616],
            )  # fmt: skip
            if label:
                axis.text(
                    chip.xc, chip.yc, f"{chip.id}\n{chip.filter}", ha="center", va="center", fontsize=7, color="w"
                )
        axis.set(xlim=(-30500, 30500), ylim=(-25500, 25500), xticks=[], yticks=[])
        return image

    figure, axes = plt.subplots(1, 2, figsize=(10, 4), constrained_layout=True)
    image = show(axes[0], lambda chip: field.vignetting(*places(chip)), 0.95, 1.0, label=True)
    figure.colorbar(image, ax=axes[0], shrink=0.8)
    axes[0].set_title(f"external flat: vignetting, seed {seed}", fontsize=9)

    def response(chip):
        filter_ = camera.filters[chip.filter]
        flat = FlatField(camera.leds, camera_numbers(seed))
        return response_map(chip, chip.full_window, filter_, EXPTIME, flat=flat, shutter=True)[::384, ::384]

    image = show(axes[1], response, 0.92, 1.04)
    figure.colorbar(image, ax=axes[1], shrink=0.8)
    axes[1].set_title("vignetting x internal flat of the band x shutter, 150 s", fontsize=9)
    save(figure, record.figure("flat_field.png"))

    figure, axes = plt.subplots(3, 4, figsize=(8, 5.4), constrained_layout=True)
    for axis, row, wavelength in zip(axes.flat, np.eye(len(field.wavelengths)), field.wavelengths, strict=True):
        image = show(axis, lambda chip, row=row: field.internal(chip, *places(chip, 12), row), 0.93, 1.07)
        axis.set_title(f"{wavelength:.0f} nm", fontsize=9)
    figure.colorbar(image, ax=axes, shrink=0.7, label="internal flat")
    save(figure, record.figure("flat_leds.png"))

    t_s, half = camera.telescope.shutter_time, camera.telescope.shutter_span_mm / 2
    t = np.linspace(0, t_s, 300)
    figure, axes = plt.subplots(1, 3, figsize=(11, 3.3), constrained_layout=True)
    motion = {
        "acceleration [rad/s$^2$]": np.pi**2 / t_s**2 * np.sin(2 * np.pi * t / t_s),
        "velocity [rad/s]": np.pi / (2 * t_s) * (1 - np.cos(2 * np.pi * t / t_s)),
        "angle [rad]": np.pi / (2 * t_s) * (t - t_s / (2 * np.pi) * np.sin(2 * np.pi * t / t_s)),
    }
    for name, values in motion.items():
        axes[0].plot(t, values, label=name)
    axes[0].set(xlabel="time from the start of opening [s]")
    axes[0].legend(fontsize=7)
    axes[1].plot(half * (1 - np.cos(motion["angle [rad]"])), t)
    axes[1].set(xlabel="distance of the leaf's edge from the middle [mm]", ylabel="time it passes [s]")
    x = np.linspace(-half, half, 4001)
    axes[2].plot(x / 0.01, deficit(x, camera.telescope))
    spans = {(chip.xc - 4608, chip.xc + 4608, chip.kind) for chip in camera.chips.values()}
    for left, right, kind in sorted(spans):
        axes[2].axvspan(left, right, ymax=0.04, color="C1" if kind == "imaging" else "C2", alpha=0.5, lw=0)
    axes[2].set(xlabel="mosaic x [pixel]", ylabel="missed of the exposure [s]", ylim=(0, 2.7))
    axes[2].set_title("orange: imaging chips, green: slitless", fontsize=8)
    save(figure, record.figure("shutter.png"))


def save(figure, path: Path) -> None:
    """Write a picture."""
    figure.savefig(path, dpi=75)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=9)
    with Record(parser) as record:
        camera, seed = load_camera(SHIPPED / "instrument"), record.options.seed
        for part in (report_response, report_limits, report_lamps, report_cost, draw):
            part(camera, seed, record)
