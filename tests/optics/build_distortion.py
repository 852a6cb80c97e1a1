"""Builder of config/instrument/distortion.fits, the field distortion that simulations use (optics.geometry.distortion).

    python tests/optics/build_distortion.py [config/instrument]
    python tests/optics/build_distortion.py --placement SEED       prints placement rows for distortion.yaml

The model is fitted to 30 x 30 samples on each chip of what distortion.yaml describes
(csstsim.optics.geometry.focal_plane).
"""

import sys
from pathlib import Path

from csstsim.base.rng import stream
from csstsim.base.shipped import SHIPPED
from csstsim.instrument.camera import load_camera
from csstsim.optics.geometry.distortion import fit, write_distortion
from csstsim.optics.geometry.focal_plane import load_focal_plane, samples

ABOUT = [
    "Field distortion of the CSST Survey Camera: coefficients of csstsim.",
    "Splines of order 4 (B-splines on equal cells of box = x0, x1, y0, y1):",
    "GLOBAL displaces mosaic positions, CHIPS adds to it on each chip [px].",
    "Fitted to distortion.yaml, whose numbers are estimates but for the",
    "200 px at the edge: Wei et al. 2025, arXiv 2511.06970, section 5.2.",
    "Builder: tests/optics/build_distortion.py",
]
RMS = (1.0, 1.0, 5e-5, 5.0, 1e-4, 1e-4)  # px, px, rad, um, 1, 1


def build(folder, nodes=30, **options):
    """Fit the model to the data files of an instrument folder and write its distortion.fits."""
    folder = Path(folder)
    camera, plane = load_camera(folder), load_focal_plane(folder / "distortion.yaml")
    model = fit({n: samples(plane, chip, nodes) for n, chip in camera.chips.items()}, camera.chips, **options)
    write_distortion(folder / "distortion.fits", model, ABOUT)


def placement(seed):
    """Print one row a chip: id, shift x, y [px], turn [rad], height [um], slopes along x, y."""
    draws = stream(seed, "placement").normal(size=(30, 6)) * RMS
    for number, (*shift, turn, height, slope_x, slope_y) in enumerate(draws, 1):
        print(
            f"    - [{number}, {shift[0]:.2f}, {shift[1]:.2f}, {turn:.1e}, {height:.1f}, {slope_x:.1e}, {slope_y:.1e}]"
        )


if __name__ == "__main__":
    if sys.argv[1:2] == ["--placement"]:
        placement(int(sys.argv[2]))
    else:
        build(*(sys.argv[1:] or [SHIPPED / "instrument"]))
