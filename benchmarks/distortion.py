"""Numbers of the field distortion: fit residuals, inverse, speed, SIP; and its figure.

    PYTHONPATH=builders python benchmarks/distortion.py [--figure docs/figures/distortion.png]

Residuals are model - optics at 500 random points per chip that the fit did not use, on the chip and beyond its edge;
the paper's model (Wei et al. 2025, section 5.2) is the same pair of splines. CPU times are those of one core.
"""

import argparse
import time

import numpy as np
from astropy.io import fits
from astropy.wcs import WCS
from build_distortion import fit

from csstsim.base.shipped import SHIPPED
from csstsim.instrument.camera import load_camera
from csstsim.instrument.pointing import Pointing
from csstsim.optics.geometry import spline
from csstsim.optics.geometry.distortion import load_distortion
from csstsim.optics.geometry.focal_plane import load_focal_plane, samples
from csstsim.optics.geometry.sip import sip_header
from csstsim.optics.geometry.wcs import ChipWCS, chip_plane

FOLDER = SHIPPED / "instrument"


def places(chip, beyond=0.0, n=500):
    rng = np.random.default_rng(chip.id)
    size = chip.detector.nx, chip.detector.ny
    return tuple(rng.uniform(-0.5 - beyond, s - 0.5 + beyond, n) for s in size)


def distance(one, other):
    return np.hypot(*np.subtract(one, other))


def residuals(camera, plane, field):
    print("residual on held-out points, px, 30 chips      rms       largest")
    for beyond in (0, 600, 1300, 2048, 2500):
        off = np.concatenate([
            distance(field.on(c).forward(*places(c, beyond)), plane.forward(c, *places(c, beyond)))
            for c in camera.chips.values()
        ])  # fmt: skip
        print(f"  to {beyond:4d} px beyond the edge              {np.sqrt((off**2).mean()):9.1e} {off.max():9.1e}")
    moved = [spline.values(*field.whole, *_mosaic(c, *places(c))) for c in camera.chips.values()]
    true = [_mosaic_shift(plane, c) for c in camera.chips.values()]
    off = np.hypot(*(np.concatenate(moved) - np.concatenate(true)).T)
    print(f"  global spline alone                        {np.sqrt((off**2).mean()):9.1e} {off.max():9.1e}")
    print(f"  no model (the linear WCS)                  {'':9} {np.hypot(*np.concatenate(true).T).max():9.1f}")


def _mosaic(chip, x, y):
    rotation, origin = chip_plane(chip)
    return rotation @ (np.stack([x, y]) - origin[:, None])


def _mosaic_shift(plane, chip):
    x, y = places(chip)
    rotation, _ = chip_plane(chip)
    return (rotation @ (np.array(plane.forward(chip, x, y)) - [x, y])).T


def cells(camera, plane):
    """Print how the residual depends on the number of cells of the splines."""
    data = {n: samples(plane, c) for n, c in camera.chips.items()}
    print("\ncells: global, of a chip     on the chip    to 1300 px beyond (largest, px)")
    for whole, own in ((1, 1), (2, 1), (2, 2), (3, 2), (4, 3), (6, 3)):
        model, off = fit(data, camera.chips, (whole, whole), (own, own)), []
        for beyond in (0, 1300):
            chips = ((c, places(c, beyond)) for c in camera.chips.values())
            off.append(max(distance(model.on(c).forward(*at), plane.forward(c, *at)).max() for c, at in chips))
        print(f"  {whole} x {whole}, {own} x {own}              {off[0]:9.1e}      {off[1]:9.1e}")


def speed(camera, field):
    chip = field.on(camera.chips[1])
    x, y = places(camera.chips[1], n=200_000)
    chip.inverse(x[:1], y[:1]), chip.forward(x[:1], y[:1])
    print("\n200,000 points of one chip, CPU s")
    for name in ("forward", "inverse", "jacobian"):
        start = time.process_time()
        getattr(chip, name)(x, y)
        print(f"  {name:10} {time.process_time() - start:.2f}")
    print(f"  inverse and forward again: {distance(chip.forward(*chip.inverse(x, y)), (x, y)).max():.0e} px")


def sip(camera, field):
    pointing = Pointing(
        type="SCIE", ra=60.0, dec=-40.0, pa=-113.4333, time="2027-06-26T20:35:58", exptime=150.0,
        sat_position=(6778.0, 0.0, 0.0), sat_velocity=(0.0, 7.0, 3.0),
    )  # fmt: skip
    print("\nSIP header read by astropy, largest of 30 chips, px")
    for order in (2, 3, 4, 5):
        off = []
        for chip in camera.chips.values():
            wcs, (x, y) = ChipWCS(chip, pointing, field), places(chip)
            theirs = WCS(fits.Header(sip_header(wcs, order)))
            off.append(distance(theirs.all_world2pix(*wcs.pixel_to_world(x, y), 0, tolerance=1e-6), (x, y)).max())
        print(f"  order {order}: {max(off):.1e}")


def figure(camera, plane, field, path):
    """Draw the offsets over the mosaic; what the CCDs' positions add; the ellipticity given to a round source."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

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
    fig.savefig(path, dpi=68)
    print(f"\n{path}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--figure")
    options = parser.parse_args()
    camera, plane = load_camera(FOLDER), load_focal_plane(FOLDER / "distortion.yaml")
    field = load_distortion(FOLDER / "distortion.fits")
    residuals(camera, plane, field)
    cells(camera, plane)
    speed(camera, field)
    sip(camera, field)
    if options.figure:
        figure(camera, plane, field, options.figure)
