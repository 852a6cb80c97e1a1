"""Builder of config/instrument/distortion.fits, the field distortion that simulations use (optics.geometry.distortion).

    python builders/build_distortion.py [config/instrument]             writes it if it differs
    python builders/build_distortion.py --check [config/instrument]     writes nothing; exit code 1 if it differs
    python builders/build_distortion.py --placement SEED       prints placement rows for distortion.yaml

The model is fitted to 30 x 30 samples on each chip of the focal plane described by distortion.yaml
(csstsim.optics.geometry.focal_plane). Two files are the same if coefficients are equal to 1e-8 of the largest: 2e-6 px.
"""

import argparse
import sys
from pathlib import Path

import fitsio
import numpy as np
from kept import Keeper, same_fits
from numba import njit

from csstsim.base.files.atomic import atomic_path
from csstsim.base.process.one_thread import one_thread
from csstsim.base.rng import stream
from csstsim.base.shipped import SHIPPED
from csstsim.instrument.camera import load_camera
from csstsim.optics.geometry import spline
from csstsim.optics.geometry.distortion import FieldDistortion, chip_layout
from csstsim.optics.geometry.focal_plane import load_focal_plane, samples
from csstsim.optics.geometry.spline import ORDER
from csstsim.optics.geometry.wcs import chip_plane, mosaic_cd

ABOUT = [
    "Field distortion of the CSST Survey Camera: coefficients of csstsim.",
    "Splines of order 4 (B-splines on equal cells of box = x0, x1, y0, y1):",
    "GLOBAL displaces mosaic positions, CHIPS adds to it on each chip [px].",
    "Fitted to distortion.yaml, whose numbers are estimates but for the",
    "200 px at the edge: Wei et al. 2025, arXiv 2511.06970, section 5.2.",
    "Builder: builders/build_distortion.py",
]
MARGIN_PX = 2600.0  # around the chip: light of objects up to 2048 px off, moved by up to 214 px, may reach it
CELLS = (2, 2)  # of the global spline, and of each chip's
RELATIVE = 1e-8
RMS = (1.0, 1.0, 5e-5, 5.0, 1e-4, 1e-4)  # px, px, rad, um, 1, 1


def build(folder, nodes=30, keeper=None, **options):
    """Fit the model to the data files of an instrument folder and write its distortion.fits, if it differs."""
    folder = Path(folder)
    camera, plane = load_camera(folder), load_focal_plane(folder / "distortion.yaml")
    model = fit({n: samples(plane, chip, nodes) for n, chip in camera.chips.items()}, camera.chips, **options)
    with (keeper or Keeper()).file(folder / "distortion.fits", same_fits(RELATIVE)) as new:
        write_distortion(new, model, ABOUT)


@one_thread
def fit(samples, chips, cells=CELLS, chip_cells=CELLS, margin=MARGIN_PX):
    """Return the FieldDistortion fitted to samples.

    samples: {chip id: (n, 4)} of u, v [deg, intermediate world coordinates at position angle 0], x, y [0-based pixel]
    (optics.geometry.focal_plane.samples). chips: {id: Chip}. cells: of the splines, along x and y. margin: px around
    the samples. Raises ValueError for fewer samples than coefficients. The result depends on the rounding of the linear
    algebra library, so it is computed once and stored.
    """
    ideal, place, moved = {}, {}, {}
    for number, (u, v, x, y) in ((n, np.transpose(rows)) for n, rows in samples.items()):
        rotation, origin = chip_plane(chips[number])
        to_mosaic = np.linalg.inv(mosaic_cd(0.0, chips[number].telescope))
        place[number] = np.einsum("ij,jn->in", to_mosaic, [u, v])
        ideal[number] = np.einsum("ji,jn->in", rotation, place[number]) + origin[:, None]
        moved[number] = np.einsum("ij,jn->in", rotation, [x, y] - ideal[number])
    everywhere = np.concatenate([*place.values()], axis=1)
    box = _around(everywhere, margin)
    whole = box, fit_spline(*everywhere, np.concatenate([*moved.values()], axis=1).T, box, cells)
    residual = {}
    for number in samples:
        rotation, _ = chip_plane(chips[number])
        left = np.einsum("ji,nj->ni", rotation, moved[number].T - spline.values(*whole, *place[number]))
        box = _around(ideal[number], margin)
        residual[number] = box, fit_spline(*ideal[number], left, box, chip_cells)
    return FieldDistortion(whole, residual, {n: chip_layout(chips[n]) for n in samples})


def _around(points, margin):
    return np.array([points[0].min() - margin, points[0].max() + margin,
                     points[1].min() - margin, points[1].max() + margin])  # fmt: skip


def write_distortion(path, field, about=()):
    """Write a FieldDistortion as FITS: tables GLOBAL (one row) and CHIPS; `about` are lines for the header."""
    order = sorted(field.chips)
    boxes, coefficients = (np.stack([field.chips[n][i] for n in order]) for i in (0, 1))
    names = {"chip": np.array(order, np.int16), "layout": np.array([field.layout[n] for n in order])}
    with atomic_path(path) as temporary, fitsio.FITS(temporary, "rw", clobber=True) as file:
        file.write({"box": field.whole[0][None], "coefficients": field.whole[1][None]}, extname="GLOBAL")
        for line in about:
            file["GLOBAL"].write_comment(line)
        file.write(names | {"box": boxes, "coefficients": coefficients}, extname="CHIPS")


@njit(cache=True)
def _design(x, y, box, cells_x, cells_y):
    rows = np.zeros((x.size, (cells_y + ORDER) * (cells_x + ORDER)))
    work = np.empty((4, ORDER + 1))
    for n in range(x.size):
        i, _ = spline._axis(x[n], box[0], box[1], cells_x, work[0], work[1])
        j, _ = spline._axis(y[n], box[2], box[3], cells_y, work[2], work[3])
        for row in range(ORDER + 1):
            start = (j + row) * (cells_x + ORDER) + i
            rows[n, start : start + ORDER + 1] = work[2, row] * work[0]
    return rows


def fit_spline(x, y, wanted, box, cells):
    """Return the coefficients of the least-squares spline to `wanted` (n, 2) at points x, y (n,).

    cells: (along x, along y). Raises ValueError for fewer points than coefficients, which would not determine it.
    """
    cells_x, cells_y = cells
    if len(x) < (needed := (cells_x + ORDER) * (cells_y + ORDER)):
        raise ValueError(f"{len(x)} samples are too few for a spline of {needed} coefficients")
    matrix = _design(np.asarray(x, float), np.asarray(y, float), np.asarray(box, float), cells_x, cells_y)
    solution, *_ = np.linalg.lstsq(matrix, wanted, rcond=1e-12)
    return solution.reshape(cells_y + ORDER, cells_x + ORDER, 2)


def placement(seed):
    """Print one row per chip: id, shift x, y [px], rotation [rad], height [um], slopes along x, y."""
    draws = stream(seed, "placement").normal(size=(30, 6)) * RMS
    for number, (*shift, turn, height, slope_x, slope_y) in enumerate(draws, 1):
        print(
            f"    - [{number}, {shift[0]:.2f}, {shift[1]:.2f}, {turn:.1e}, {height:.1f}, {slope_x:.1e}, {slope_y:.1e}]"
        )


def main() -> int:
    """Do what is asked for; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", type=Path, default=SHIPPED / "instrument")
    parser.add_argument("--check", action="store_true", help="write nothing; exit code 1 if the file differs")
    parser.add_argument("--placement", type=int, metavar="SEED", help="print placement rows for distortion.yaml")
    options = parser.parse_args()
    if options.placement is not None:
        placement(options.placement)
        return 0
    keeper = Keeper(options.check)
    build(options.folder, keeper=keeper)
    return keeper.code()


if __name__ == "__main__":
    sys.exit(main())
