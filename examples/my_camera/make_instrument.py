"""Write what follows from formulae: filters, the grating, field distortion, header keywords and the survey table.

    python make_instrument.py [folder]      [default: the folder of this file]

The other files of instrument/ are written by hand. Everything made here is kept beside them, so that the campaign runs
without this script; run it again after a change of telescope, chips or detector.
"""

import shutil
import sys
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
from astropy.io import fits

from csstsim.base.shipped import ROOT, SHIPPED
from csstsim.catalog.astrometry.ephemeris import observer
from csstsim.catalog.astrometry.reduction import apparent
from csstsim.instrument.axe import axe_text, sensitivity_file
from csstsim.instrument.camera import load_camera, load_telescope
from csstsim.instrument.filter import GRID, sample_curve
from csstsim.instrument.grating import sensitivity
from csstsim.instrument.load import read_data, sections
from csstsim.instrument.pointing import mjd_utc
from csstsim.optics.geometry.focal_plane import load_focal_plane, samples

sys.path.append(str(ROOT / "builders"))
from build_distortion import fit, write_distortion

# name: kind, blue and red edge [angstrom], throughput between them
FILTERS = {
    "Blue": ("imaging", 4000, 5400, 0.55), "Green": ("imaging", 5400, 6800, 0.65),
    "Red": ("imaging", 6800, 8400, 0.60), "Prism": ("slitless", 4500, 8000, 0.40),
}  # fmt: skip
EDGE = 60  # angstrom, over which a curve rises
SKY = 22.5  # AB mag / arcsec2 in every band
PIXELS = 13.0  # whose noise a star's light meets
LIMIT_S = 150.0  # exposure time of limiting magnitudes
GRATING, ANGSTROM_PER_PX = "P1", 12.0
ORDERS = {0: 0.1, 1: 1.0}  # order: its light over that of the first
AWAY = 250.0  # px, of the middle of the first order from where light would fall without the grating
TARGET = 90.0000, -23.1556  # deg, ICRS: the middle of a HEALPix brick, so that one truth brick serves all
START, GAP, EXPTIME = datetime(2027, 11, 20, 1), timedelta(minutes=4), 150.0

KEYWORDS = {
    "TELESCOP, constant: CSST": "TELESCOP, constant: MINE", "INSTRUME, constant: MSC": "INSTRUME, constant: FOUR",
    "instrument: Survey Camera": "instrument: my camera",
}  # fmt: skip


def curve(blue, red, top):
    """Return the nodes (angstrom, throughput) of a band with soft edges."""
    return [[blue, 0], [blue + EDGE, top], [(blue + red) / 2, round(1.05 * top, 4)], [red - EDGE, top], [red, 0]]


def filters(telescope, detector):
    """Return the text of filters.yaml: curves, and the sky and the limits that follow from them."""
    lines = ["# Throughput from the aperture to the electron, sky and limits: make_instrument.py."]
    for name, (kind, *edges) in FILTERS.items():
        nodes = curve(*edges)
        light = np.trapezoid(sample_curve(nodes) / GRID, GRID)  # of 0 mag: 3631 Jy / h of photons a unit of ln lambda
        zero = 2.5 * np.log10(telescope.area_m2 * 3631e-26 / 6.62607015e-34 * light)
        sky = 10 ** (-0.4 * (SKY - zero)) * telescope.pixel_scale**2
        noise = np.sqrt(PIXELS * ((sky + detector["dark"]) * LIMIT_S + detector["read_noise"] ** 2))
        faint, bright = (zero - 2.5 * np.log10(n / LIMIT_S) for n in (5 * noise, 10 * detector["full_well"]))
        lines += [
            f"{name}:", f"  kind: {kind}", '  source: "made up: soft-edged box; sky of 22.5 mag / arcsec2, 5 sigma"',
            "  confidence: E", f"  nodes: {nodes}", f"  sky: {sky:.4f} # e- / s / pixel",
            f"  saturation_mag: {bright:.2f} # AB, 150 s", f"  limiting_mag: {faint:.2f}",
        ]  # fmt: skip
    return "\n".join(lines) + "\n"


def grating(camera):
    """Return {file name: text or FITS HDUs} of the grating: traces, and the sensitivity of each order."""
    filter_, orders, files = camera.filters["Prism"], {}, {}
    middle = float(GRID @ filter_.throughput / filter_.throughput.sum())
    used = np.flatnonzero(filter_.throughput)[[0, -1]]
    for order, share in ORDERS.items():
        step = ANGSTROM_PER_PX / order if order else 1e5  # the zeroth order is nearly a point
        at = np.arange(used[0] - used[0] % 10, used[1] + 20, 10)
        begin, end = sorted((GRID[used] - middle) / step + AWAY * order)
        numbers = {
            "xoff": 0.0,
            "yoff": 0.0,
            "a0": 0.0,
            "a1": 0.01,
            "alpha0": middle - AWAY * order * step,
            "alpha1": step,
        }
        orders[order] = {name: np.array([value, 0, 0, 0, 0, 0.0]) for name, value in numbers.items()}
        orders[order] |= {
            "extent": (np.floor(begin) - 1, np.ceil(end) + 1),
            "sensitivity": sensitivity_file(GRATING, order),
        }
        values = sensitivity(GRID[at], share * filter_.throughput[at], camera.telescope)
        columns = [fits.Column(n, "E", array=v) for n, v in (("WAVELENGTH", GRID[at]), ("SENSITIVITY", values))]
        files[sensitivity_file(GRATING, order)] = fits.BinTableHDU.from_columns(columns)
    return files | {f"{GRATING}.conf": axe_text(orders, ["Made up: 12 angstrom a pixel, along x."])}


def gratings_yaml(camera):
    """Return the text of gratings.yaml: which grating stands before the chip, and how far its light may come from."""
    nx = camera.detector.nx
    return f"""# The one grating covers both sides of its chip. Its numbers are in gratings/, in aXe's form.
chips:
  source: "made up"
  confidence: E
  unit: px
  values:
    4: {{left: {GRATING}, right: {GRATING}, split: {nx // 2}, reach: [500, 76, 68, 500]}}
"""


def survey_table(camera):
    """Return four exposures of one field, the mosaic turned by 90 degrees from each to the next."""
    rows = ["obsid,type,ra,dec,pa,time,exptime"]
    for number in range(4):
        start = f"{START + number * GAP:%Y-%m-%dT%H:%M:%S}"
        state = camera.orbit.state(start)
        ra, dec = apparent(*TARGET, observer(mjd_utc(start), *state))  # a boresight is where light comes from
        rows.append(f"3010000000{number + 1},SCIE,{ra:.6f},{dec:.6f},{45 + 90 * number},{start},{EXPTIME:g}")
    return "\n".join(rows) + "\n"


def make(folder):
    """Write all files below an example's folder; telescope, chips and detector are read from it."""
    folder = Path(folder)
    here = folder / "instrument"
    (here / "gratings").mkdir(exist_ok=True)
    shutil.copy(SHIPPED / "instrument" / "sky.yaml", here)  # Sun and zodiacal light, which are every camera's
    keywords = (SHIPPED / "instrument" / "level0_keywords.yaml").read_text()
    for old, new in KEYWORDS.items():
        keywords = keywords.replace(old, new)
    (here / "level0_keywords.yaml").write_text(keywords)
    telescope, _ = load_telescope(here / "telescope.yaml")
    (here / "filters.yaml").write_text(filters(telescope, sections(read_data(here / "detector.yaml"))))
    camera = load_camera(here)
    (here / "gratings.yaml").write_text(gratings_yaml(camera))
    for name, content in grating(camera).items():
        path = here / "gratings" / name
        path.write_text(content) if isinstance(content, str) else content.writeto(path, overwrite=True)
    plane = load_focal_plane(here / "distortion.yaml")
    write_distortion(
        here / "distortion.fits", fit({n: samples(plane, chip) for n, chip in camera.chips.items()}, camera.chips)
    )
    (folder / "survey_table.csv").write_text(survey_table(camera))


if __name__ == "__main__":
    make(*(sys.argv[1:] or [Path(__file__).parent]))
