"""Brighter-fatter effect: spots against GalSim's SiliconSensor, photon transfer of flats, and cost of charge layers.

    python benchmarks/brighter_fatter.py [--seed 4]

Spots: sigma_x, sigma_y of a Gaussian against flux, as in the paper's figure. The peer is SiliconSensor lsst_e2v_50_8 (a
CCD250 of 100 um, 10 um pixels) without diffusion, which does not depend on flux. A kernel made from that sensor's own
pixel areas around a charge, as flats would show them, should agree with it. The shipped kernel is the third.
Photon transfer: variance and covariances of pairs of simulated flats, the prediction of the fit, and the fitted areas.
Costs: CPU seconds on 9216 x 9232 pixels, best of 3; numpy and scipy on a quarter of them, times four.
"""

import argparse
import time

from evidence.record import Record

import bfe_fit
import galsim
import numpy as np
from scipy.ndimage import convolve

from csstsim.base.rng import stream
from csstsim.base.shipped import SHIPPED
from csstsim.detector import bfe_kernel
from csstsim.detector.blooming import bloom
from csstsim.detector.brighter_fatter import move_charge
from csstsim.detector.nonlinearity import apply_nonlinearity
from csstsim.instrument.camera import load_camera

SENSOR = "lsst_e2v_50_8"
SIDE, SIGMA, SPOTS = 21, 0.9, 10  # pixels, pixels, averaged for each flux
FLUXES = np.array([25_000, 100_000, 200_000, 300_000, 400_000, 500_000])
LEVELS = np.array([1000.0, 10_000.0, 25_000.0, 50_000.0, 75_000.0])
FLAT, TOY_FLAT = 1500, 300  # pixels a side
PEAK = 0.166  # part of a spot's light in its brightest pixel
SHIPPED_KERNEL, NO_SKEW = "shipped kernel", "kernel of its areas without skew"


def sensor_areas():
    """Return the (3, 3) area changes [per e-] of SiliconSensor's pixels around one charged pixel, sides averaged."""
    charge, n = 50_000.0, 15
    image = galsim.ImageF(n, n, scale=1.0, init_value=0.0)
    sensor = galsim.SiliconSensor(name=SENSOR, rng=galsim.BaseDeviate(1))
    before = sensor.calculate_pixel_areas(image).array.astype(float)
    image.array[n // 2, n // 2] = charge
    after = sensor.calculate_pixel_areas(image).array.astype(float)
    middle = slice(n // 2 - 2, n // 2 + 3)
    return bfe_kernel.fold(((after - before) / before.mean() / charge)[middle, middle])


def widths(image):
    """Return (sigma_x, sigma_y) [pixels], unweighted."""
    image, total = image.astype(float), image.sum(dtype=float)
    axes = np.mgrid[: image.shape[0], : image.shape[1]][::-1]
    return [np.sqrt((image * (axis - (image * axis).sum() / total) ** 2).sum() / total) for axis in axes]


def spots(kernels, full_well, seed, fluxes, count=SPOTS):
    """Return {name: (fluxes, spots, 2)}: (sigma_x, sigma_y) of spots made of the same photons."""
    names = ["no effect", SENSOR, *kernels]
    found = {name: np.empty((len(fluxes), count, 2)) for name in names}
    for i, flux in enumerate(fluxes):
        for spot in range(count):
            rng = galsim.BaseDeviate(int(stream(seed, "spot", flux, spot).integers(1, 2**31)))
            shot = galsim.Gaussian(sigma=SIGMA, flux=float(flux)).shoot(int(flux), rng)
            silicon = galsim.SiliconSensor(name=SENSOR, rng=rng, nrecalc=2000, diffusion_factor=0.0)
            images = [galsim.ImageF(SIDE, SIDE, scale=1.0, init_value=0.0) for _ in range(2)]
            for image, sensor in zip(images, (galsim.Sensor(), silicon), strict=True):
                image.setCenter(0, 0)
                sensor.accumulate(shot, image)
            arrays = [image.array for image in images]
            for kernel in kernels.values():
                arrays.append(arrays[0].copy())
                move_charge(arrays[-1], *kernel, full_well)
            for name, array in zip(names, arrays, strict=True):
                found[name][i, spot] = widths(array)
    return found


def report_spots(found: dict[str, np.ndarray], fluxes: np.ndarray, record: Record) -> None:
    """Record how the widths of spots grow with flux, and compare the kernels with the sensor."""
    count, width = found["no effect"].shape[1], found["no effect"].mean()
    growth = {name: values - found["no effect"] for name, values in found.items() if name != "no effect"}
    print(f"growth of sigma_x, sigma_y [1e-3 pixel] of a spot of {width:.3f} pixels, {count} each")
    print("      flux  peak  " + "".join(f"{name:>34s}" for name in growth))
    for i, flux in enumerate(fluxes):
        cells = [
            f"{x:8.2f} {y:6.2f} +- {e:5.2f}  "
            for x, y, e in (
                (*(1e3 * g[i].mean(0)), 1e3 * g[i].std(0).max() / np.sqrt(g.shape[1] - 1)) for g in growth.values()
            )
        ]
        print(f"{flux:10.0f} {flux * PEAK:6.0f}" + "".join(f"{cell:>34s}" for cell in cells))
    slope = {name: (g * fluxes[:, None, None]).sum(0) / (fluxes**2.0).sum() for name, g in growth.items()}  # by spot
    rows = []
    for name, values in slope.items():
        cells = []
        for axis, number, sensors in zip("xy", values.T, slope[SENSOR].T, strict=True):
            ratio = number.mean() / sensors.mean()
            cells.append(f"{1e8 * number.mean():.2f}" + ("" if name == SENSOR else f" (x {ratio:.2f})"))
            if name != SENSOR:
                error = ratio * np.hypot(*(v.std() / v.mean() for v in (number, sensors))) / np.sqrt(count - 1)
                what = f"growth of sigma_{axis} with flux by the {name} over that of {SENSOR}"
                record.value(f"{name.replace(' ', '_')}_{axis}", ratio, what, error=error)
        rows.append([name, *cells])
    record.table("growth", ["growth with flux, 1e-8 pixel / e-", "sigma_x", "sigma_y"], rows)
    for axis, number in zip("xy", growth[SHIPPED_KERNEL][-1].mean(0), strict=True):
        what = f"growth of sigma_{axis} of a spot with {PEAK * fluxes[-1]:.0f} e- in its peak, shipped kernel"
        record.value(f"spot_{axis}", number / width, what)


def transfer(areas: np.ndarray, full_well: float, seed: int, record: Record) -> list[np.ndarray]:
    """Record variance and covariances of pairs of flats; return their means, covariances and errors."""
    kernel, measured, rows, side = bfe_kernel.kernel(areas), [], [], TOY_FLAT if record.toy else FLAT
    for level in LEVELS:
        pair = [stream(seed, "flat", level, i).poisson(level, (side, side)).astype(np.float32) for i in range(2)]
        for image in pair:
            move_charge(image, *kernel, full_well)
        measured.append(bfe_fit.measure(*pair))
        mean, cov, errors = measured[-1]
        wanted = bfe_fit.predict(areas, level)
        cells = (
            f"{cov[lag] / mean:.4f} ± {errors[lag] / mean:.4f} [{wanted[lag] / level:.4f}]"
            for lag in ((0, 0), (1, 0), (0, 1), (1, 1))
        )
        rows.append([f"{level:,.0f}", *cells])
    record.table("photon_transfer", ["mean, e-", "variance", "lag (1, 0)", "lag (0, 1)", "lag (1, 1)"], rows)
    return [np.array(part) for part in zip(*measured, strict=True)]


def report_fit(areas: np.ndarray, measured: list[np.ndarray], record: Record) -> None:
    """Record the areas that are fitted to the flats."""
    fitted, errors = bfe_fit.fit(*measured)
    print("areas [1e-8 per e-]: true, fitted, error")
    for dy in range(3):
        print("   ".join(" ".join(f"{1e8 * v:8.2f}" for v in table[dy]) for table in (areas, fitted, errors)))
    own = 1e8 * fitted[0, 0], 1e8 * errors[0, 0]
    record.value("own_area", own[0], "fitted change of a pixel's own area", unit="1e-8 per e-", error=own[1])
    off = (abs(fitted - areas) / errors).max()
    record.value("areas_off", off, "largest difference of a fitted area from that configured", unit="sigma", below=4)


def numpy_moved(image, kernel, skew, limit):
    """Move charge with whole-array numpy and scipy (single precision, as move_charge)."""
    push = np.minimum(image, np.float32(limit))
    phi, out = convolve(push, bfe_kernel.unfold(kernel).astype(np.float32), mode="nearest"), image.copy()
    for axis, own in ((0, skew), (1, -skew)):
        n = image.shape[axis]
        padded = np.pad(image, [(1, 1) if a == axis else (0, 0) for a in (0, 1)], mode="edge")
        parts = [slice(i, i + n - 1) for i in range(4)]
        before, p, q, after = (padded[part] if axis == 0 else padded[:, part] for part in parts)
        shift = -np.diff(phi + np.float32(own) * push, axis=axis)
        density = np.where(shift > 0, 5 * p + 2 * q - before, 5 * q + 2 * p - after) / 6
        flux = np.clip(shift * np.clip(density, np.minimum(p, q), np.maximum(p, q)), -q / 8, p / 8)
        low, high = (slice(None, -1), slice(1, None)) if axis == 0 else (np.s_[:, :-1], np.s_[:, 1:])
        out[low] -= flux
        out[high] += flux
    return out


def cpu(work, image):
    times = []
    for _ in range(3):
        given = image.copy()
        start = time.process_time()
        work(given)
        times.append(time.process_time() - start)
    return min(times)


def report_cost(kernel, full_well, seed, record):
    rng = stream(seed, "cost")
    shape = (1200, 1200) if record.toy else (9232, 9216)
    image = rng.poisson(40.0, shape).astype(np.float32)
    for x, y in zip(*rng.integers(0, shape[1] - 6, (2, 2000)), strict=True):
        image[y : y + 5, x : x + 5] = 3e5
    quarter, numbers = image[: shape[0] // 4].copy(), (*kernel, full_well)
    five = bfe_kernel.unfold(kernel[0]).astype(np.float32)

    seconds = {
        "`brighter_fatter`": cpu(lambda i: move_charge(i, *numbers), image),
        "numpy and scipy, the same": 4 * cpu(lambda i: numpy_moved(i, *numbers), quarter),
        "scipy.ndimage.convolve, 5 x 5 alone": 4 * cpu(lambda i: convolve(i, five), quarter),
        "`blooming`": cpu(lambda i: bloom(i, full_well, 0.01), image),
        "`nonlinearity`": cpu(lambda i: apply_nonlinearity(i, -5e-7, 0.0, full_well), image),
        "numpy, the polynomial alone": 4
        * cpu(lambda i: i + i**2 * np.float32(-5e-7) + i**3 * np.float32(1e-20), quarter),
    }
    rows = [[name, f"{value:.2f}"] for name, value in seconds.items()]
    record.table("costs", ["on a whole chip, 2000 saturated cores", "CPU-s"], rows)
    ours, numpys = list(seconds.values())[:2]
    record.value("times", numpys / ours, "CPU time of numpy and scipy over that of `brighter_fatter`")


def draw(found, fluxes, areas, measured, path):
    import matplotlib

    matplotlib.use("agg")
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4), constrained_layout=True)
    drawn = [name for name in found if name not in ("no effect", NO_SKEW)]
    styles = dict(zip(drawn, ("o", "s", "-"), strict=True))
    for axis, colour in ((0, "C0"), (1, "C3")):
        for name, style in styles.items():
            growth = (found[name] - found["no effect"]).mean(1)[:, axis]  # without the scatter of the photons
            hollow = {"mfc": "none", "ms": 8} if style == "s" else {}
            label = rf"$\sigma_{'xy'[axis]}$ {name}"
            left.plot(fluxes / 1e5, np.sqrt(SIGMA**2 + 1 / 12) + growth, style, color=colour, label=label, **hollow)
    left.set(xlabel="flux [10$^5$ e$^-$]", ylabel="width [pixel]")
    left.legend(fontsize=7)
    means, cov, errors = measured
    levels = np.linspace(0, LEVELS[-1], 50)[1:]
    wanted = np.array([bfe_fit.predict(areas, level) / level for level in levels])
    for i, (dy, dx) in enumerate(((1, 0), (0, 1), (1, 1), (0, 0))):
        minus = 1.0 if (dy, dx) == (0, 0) else 0.0
        label = "variance - 1" if minus else f"lag ({dy}, {dx})"
        right.errorbar(
            means / 1e3, 100 * (cov[:, dy, dx] / means - minus), 100 * errors[:, dy, dx] / means, fmt=".", color=f"C{i}"
        )
        right.plot(levels / 1e3, 100 * (wanted[:, dy, dx] - minus), color=f"C{i}", label=label)
    right.set(xlabel="mean of the flat [10$^3$ e$^-$]", ylabel="covariance / mean [%] (rows, columns)")
    right.legend(fontsize=7)
    figure.savefig(path, dpi=90)


def main(record: Record) -> None:
    """Measure spots, flats and costs, and draw them."""
    seed, toy = record.options.seed, record.toy
    detector = load_camera(SHIPPED / "instrument").detector
    areas = detector.brighter_fatter["scale"] * np.array(detector.brighter_fatter["areas"])
    own = sensor_areas()
    print(f"areas of {SENSOR} [1e-8 per e-]:\n{(1e8 * own).round(2)}\nshipped:\n{(1e8 * areas).round(2)}")
    own_kernel, shipped = bfe_kernel.kernel(own), bfe_kernel.kernel(areas)
    kernels = {"kernel of its areas": own_kernel, NO_SKEW: (own_kernel[0], 0.0), SHIPPED_KERNEL: shipped}
    fluxes, count = (FLUXES // 10, 2) if toy else (FLUXES, SPOTS)
    found = spots(kernels, detector.full_well, seed, fluxes, count)
    report_spots(found, fluxes, record)
    measured = transfer(areas, detector.full_well, seed, record)
    report_fit(areas, measured, record)
    report_cost(shipped, detector.full_well, seed, record)
    draw(found, fluxes, areas, measured, record.figure("brighter_fatter.png"))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=4)
    with Record(parser) as record:
        main(record)
