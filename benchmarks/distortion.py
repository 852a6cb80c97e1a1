"""Numbers of the field distortion: fit residuals, inverse, speed, SIP; and its figure.

    python benchmarks/distortion.py

Residuals are model - optics at 500 random points per chip that the fit did not use, on the chip and beyond its edge;
the paper's model (Wei et al. 2025, section 5.2) is the same pair of splines. CPU times are those of one core.
"""

import argparse
import time

from evidence.record import Record

import matplotlib
import numpy as np
from astropy.io import fits
from astropy.wcs import WCS
from build_distortion import fit

from csstsim.base.shipped import SHIPPED
from csstsim.instrument.camera import Camera, load_camera
from csstsim.instrument.pointing import Pointing
from csstsim.optics.geometry import spline
from csstsim.optics.geometry.distortion import FieldDistortion, load_distortion
from csstsim.optics.geometry.focal_plane import FocalPlane, load_focal_plane, samples
from csstsim.optics.geometry.sip import sip_header
from csstsim.optics.geometry.wcs import ChipWCS, chip_plane

matplotlib.use("agg")
from matplotlib import pyplot as plt

FOLDER = SHIPPED / "instrument"
N = 200_000  # positions, for the speed


def places(chip, beyond=0.0, n=500):
    rng = np.random.default_rng(chip.id)
    size = chip.detector.nx, chip.detector.ny
    return tuple(rng.uniform(-0.5 - beyond, s - 0.5 + beyond, n) for s in size)


def distance(one, other):
    return np.hypot(*np.subtract(one, other))


def residuals(camera: Camera, plane: FocalPlane, field: FieldDistortion, record: Record) -> None:
    """Record the model's residuals on and beyond the chips, and those of less."""
    for beyond in (0, 600, 1300, 2048, 2500):
        off = np.concatenate([
            distance(field.on(c).forward(*places(c, beyond)), plane.forward(c, *places(c, beyond)))
            for c in camera.chips.values()
        ])  # fmt: skip
        where = f"to {beyond} px beyond the edge" if beyond else "on the chip"
        limit = {0: 1e-4, 1300: 1e-3, 2048: 1e-2}.get(beyond)
        record.value(f"residual_{beyond}", off.max(), f"model - optics, largest, {where}", unit="px", below=limit)
    moved = [spline.values(*field.whole, *_mosaic(c, *places(c))) for c in camera.chips.values()]
    true = [_mosaic_shift(plane, c) for c in camera.chips.values()]
    off = np.hypot(*(np.concatenate(moved) - np.concatenate(true)).T)
    record.value("global_rms", np.sqrt((off**2).mean()), "global spline without those of the CCDs, rms", unit="px")
    record.value("global_largest", off.max(), "global spline without those of the CCDs, largest", unit="px")


def _mosaic(chip, x, y):
    rotation, origin = chip_plane(chip)
    return rotation @ (np.stack([x, y]) - origin[:, None])


def _mosaic_shift(plane, chip):
    x, y = places(chip)
    rotation, _ = chip_plane(chip)
    return (rotation @ (np.array(plane.forward(chip, x, y)) - [x, y])).T


def cells(camera: Camera, plane: FocalPlane, record: Record) -> None:
    """Record how the residual depends on the number of cells of the splines."""
    data = {n: samples(plane, c) for n, c in camera.chips.items()}
    rows = []
    for whole, own in ((1, 1), (2, 1), (2, 2), (3, 2), (4, 3), (6, 3)):
        model, off = fit(data, camera.chips, (whole, whole), (own, own)), []
        for beyond in (0, 1300):
            chips = ((c, places(c, beyond)) for c in camera.chips.values())
            off.append(max(distance(model.on(c).forward(*at), plane.forward(c, *at)).max() for c, at in chips))
        rows.append([f"{whole} x {whole}, {own} x {own}", *(f"{1e5 * each:.0f}" for each in off)])
    header = ["cells: global, of a CCD", "on the chip, largest [1e-5 px]", "to 1300 px beyond its edge [1e-5 px]"]
    record.table("cells", header, rows)


def speed(camera: Camera, field: FieldDistortion, record: Record) -> None:
    """Record CPU seconds of the maps, and the round trip."""
    chip = field.on(camera.chips[1])
    x, y = places(camera.chips[1], n=2000 if record.toy else N)
    chip.inverse(x[:1], y[:1]), chip.forward(x[:1], y[:1])
    names = {"forward": "pixel of the light", "inverse": "ideal pixel", "jacobian": "Jacobian"}
    for name, what in names.items():
        start = time.process_time()
        getattr(chip, name)(x, y)
        record.value(f"{name}_cpu", time.process_time() - start, f"{N:,} positions: {what}", unit="CPU-s")
    off = distance(chip.forward(*chip.inverse(x, y)), (x, y)).max()
    record.value("round_trip", off, "inverse map, and forward again", unit="px", below=1e-9)


def sip(camera: Camera, field: FieldDistortion, record: Record) -> None:
    """Record the error of SIP headers as astropy reads them."""
    pointing = Pointing(
        type="SCIE", ra=60.0, dec=-40.0, pa=-113.4333, time="2027-06-26T20:35:58", exptime=150.0,
        sat_position=(6778.0, 0.0, 0.0), sat_velocity=(0.0, 7.0, 3.0),
    )  # fmt: skip
    for order in (2, 3, 4, 5):
        off = []
        for chip in camera.chips.values():
            wcs, (x, y) = ChipWCS(chip, pointing, field), places(chip)
            theirs = WCS(fits.Header(sip_header(wcs, order)))
            off.append(distance(theirs.all_world2pix(*wcs.pixel_to_world(x, y), 0, tolerance=1e-6), (x, y)).max())
        limit = 1e-3 if order == 4 else None  # the order of the option
        what = f"SIP header of order {order} read by astropy, largest"
        record.value(f"sip_{order}", max(off), what, unit="px", below=limit)


def figure(camera: Camera, plane: FocalPlane, field: FieldDistortion, record: Record) -> None:
    """Draw the offsets over the mosaic; what the CCDs' positions add; the ellipticity given to a round source."""
    fig, axes = plt.subplots(1, 3, figsize=(15, 5.3), layout="constrained", sharex=True, sharey=True)
    titles = ("offset of the light", "offset - global spline, CCD by CCD", "shape of a round source")
    for ax in axes:
        ax.set_aspect("equal")
        ax.set_xlabel("mosaic x [1000 px]")
    axes[0].set_ylabel("mosaic y [1000 px]")
    peak = [0.0, 0.0, 0.0]
    for chip in camera.chips.values():
        nx, ny = chip.detector.nx, chip.detector.ny
        here = field.on(chip)
        rotation, _ = chip_plane(chip)
        corner = _mosaic(chip, np.array([0, nx, nx, 0, 0]), np.array([0, 0, ny, ny, 0])) / 1000
        x, y = (a.ravel() for a in np.meshgrid((np.arange(4) + 0.5) * nx / 4, (np.arange(4) + 0.5) * ny / 4))
        at = _mosaic(chip, x, y)
        moved = rotation @ (np.array(here.forward(x, y)) - [x, y])
        left = moved - spline.values(*field.whole, *at).T
        jacobian = rotation @ here.jacobian(x, y) @ rotation.T
        trace = jacobian[:, 0, 0] + jacobian[:, 1, 1]
        g1, g2 = (jacobian[:, 0, 0] - jacobian[:, 1, 1]) / trace, (jacobian[:, 0, 1] + jacobian[:, 1, 0]) / trace
        g, angle = np.hypot(g1, g2), np.arctan2(g2, g1) / 2
        sticks = g * np.stack([np.cos(angle), np.sin(angle)])
        style = {"angles": "xy", "scale_units": "xy", "width": 0.003, "color": "tab:blue"}
        axes[0].quiver(*at / 1000, *moved * 15, scale=1000, **style)
        axes[1].quiver(*at / 1000, *left * 1500, scale=1000, **style)
        ends = np.stack([at / 1000 - sticks * 300, at / 1000 + sticks * 300])
        axes[2].plot(ends[:, 0], ends[:, 1], lw=1.2, color="tab:blue")
        for ax in axes:
            ax.plot(*corner, lw=0.6, color="0.6")
        peak = [max(p, v) for p, v in zip(peak, (np.hypot(*moved).max(), np.hypot(*left).max(), g.max()), strict=True)]
    most = (
        f"to {peak[0]:.0f} px, arrows x 15",
        f"to {peak[1]:.1f} px, x 1500",
        f"shear to {peak[2]:.4f}, x 600,000 px",
    )
    for ax, title, text in zip(axes, titles, most, strict=True):
        ax.set_title(f"{title}\n{text}", fontsize=10)
    fig.savefig(record.figure("distortion.png"), dpi=68)
    corners, areas = [], []
    for chip in camera.chips.values():
        nx, ny = chip.detector.nx, chip.detector.ny
        at = np.array([-0.5, nx - 0.5, nx - 0.5, -0.5]), np.array([-0.5, -0.5, ny - 0.5, ny - 0.5])
        corners.append(distance(field.on(chip).forward(*at), at).max())
        areas.append(np.linalg.det(field.on(chip).jacobian(*at)))
    record.value("offset", max(corners), "largest offset from the linear WCS (corner of the mosaic)", unit="px")
    smaller = 1 - np.min(areas) / np.max(areas)
    record.value("area", smaller, "largest less smallest area of a pixel on the sky over the mosaic, over the largest")
    record.value("shear", peak[2], "largest shear that the distortion gives a round source, at 16 positions on a chip")


if __name__ == "__main__":
    with Record(argparse.ArgumentParser(description=__doc__.splitlines()[0])) as record:
        camera, plane = load_camera(FOLDER), load_focal_plane(FOLDER / "distortion.yaml")
        field = load_distortion(FOLDER / "distortion.fits")
        residuals(camera, plane, field, record)
        cells(camera, plane, record)
        speed(camera, field, record)
        sip(camera, field, record)
        figure(camera, plane, field, record)
