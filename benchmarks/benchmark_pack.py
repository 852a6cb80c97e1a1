"""A catalogue from a pack's README alone: python benchmarks/benchmark_pack.py PACK [--output DIR].

PACK is made by `csstsim release pack`. The columns and the command of source-extractor are read from the README's own
blocks, and run in the folder that a stranger gets; so is the command that scores the catalogue. The traces of bright
sources' spectra are computed by the README's formula. Needs `apt-get install source-extractor`. Prints score and time.
Exit code 1 if a star of S/N above 10 in ten is not found, the magnitudes of points are off by more than 0.25, or the
traces of spectra by 0.3 px.
"""

import argparse
import csv
import json
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
from astropy.io import fits
from astropy.table import Table
from astropy.wcs import WCS

LEAST, MOST = 0.9, 0.25  # of points of S/N above 10; mag, of Kron magnitudes without a correction
TRACE = 0.3  # px
WAVES = {"GU": (2700.0, 3900.0), "GV": (4300.0, 6000.0), "GI": (6600.0, 9500.0)}  # angstrom, well inside each band


def blocks(text):
    """Return the indented blocks of a README, without their indent."""
    found = re.findall(r"(?:^ {4}.*\n)+", text, flags=re.M)
    return [re.sub(r"^ {4}", "", block, flags=re.M).strip() for block in found]


def follow(pack, output):
    """Do what the README says; return the score and seconds."""
    begin = time.monotonic()
    public = Path(pack) / "public"
    columns, command, score = blocks((public / "README.md").read_text())
    work = Path(output)
    work.mkdir(parents=True, exist_ok=True)
    (work / "first.param").write_text(columns + "\n")
    (work / "calibrated").unlink(missing_ok=True)
    (work / "calibrated").symlink_to((public / "calibrated").resolve())
    (work / "truth").unlink(missing_ok=True)
    (work / "truth").symlink_to((Path(pack) / "truth").resolve())
    for line in (command, score):
        if not shutil.which(line.split()[0]):
            sys.exit(f"{line.split()[0]} is not installed")
        subprocess.run(["bash", "-c", line], cwd=work, check=True)
    return json.loads((work / "score" / "score.json").read_text()), time.monotonic() - begin


def traces(pack, catalogue, brightest=12):
    """Return (n,) px: where the first orders of bright sources lie, less where the README's formula puts them."""
    public = Path(pack) / "public"
    rows = list(csv.DictReader((public / "frames.csv").open()))
    chips = {row["chip"]: row for row in csv.DictReader((public / "gratings" / "chips.csv").open())}
    table = Table.read(catalogue, format="ascii.sextractor")
    table.sort("MAG_AUTO")
    found = []
    for row in (row for row in rows if row["kind"] == "slitless"):
        with fits.open(public / row["calibrated"]) as file:
            image, header = file["SCI"].data, file["SCI"].header
        x, y = WCS(header).all_world2pix(table["ALPHA_J2000"], table["DELTA_J2000"], 0)
        corner, chip = (header["READX0"] - 1, header["READY0"] - 1), chips[row["chip"]]
        for m, n in list(zip(x + corner[0], y + corner[1], strict=True))[:brightest]:
            grating = chip["left"] if m < float(chip["split"]) else chip["right"]
            at = _trace(
                (public / "gratings" / f"{grating}.conf").read_text(), m, n, np.linspace(*WAVES[row["filter"]], 30)
            )
            found.append(_offset(image, at[0] - corner[0], at[1] - corner[1]))
    return np.array(found)


def _trace(text, m, n, waves):
    """Return x, y on the chip, from 0, of wavelengths in the first order of an object at (m, n)."""
    powers = np.array([1.0, m, n, m * m, m * n, n * n])
    values = {}
    for name in ("XOFF_A", "YOFF_A", "DYDX_A_0", "DYDX_A_1", "DLDP_A_0", "DLDP_A_1"):
        numbers = np.array(re.search(rf"^{name}[ \t]+([^#\n]+)", text, flags=re.M)[1].split(), float)
        values[name] = numbers @ powers[: len(numbers)]
    x0, y0, a0, a1, l0, l1 = values.values()
    x = x0 + (waves - l0) / l1 / np.sqrt(1 + a1 * a1)
    return m + x, n + y0 + a0 + a1 * (x - x0)


def _offset(image, x, y, reach=7):
    """Return by how much light lies above a trace, px: the centroid about the peak; NaN outside of the image."""
    ny, nx = image.shape
    inside = (x > 2) & (x < nx - 3) & (y > reach + 1) & (y < ny - reach - 2)
    if not inside.all():
        return np.nan
    parts = [
        image[round(b) - reach : round(b) + reach + 1, round(a) - 2 : round(a) + 3] for a, b in zip(x, y, strict=True)
    ]
    profile = np.sum([np.median(part, axis=1) for part in parts], axis=0)
    profile = np.clip(profile - np.median(profile), 0, None)
    near = slice(max(profile.argmax() - 2, 0), profile.argmax() + 3)
    return (profile[near] @ np.arange(-reach, reach + 1)[near]) / profile[near].sum() - np.mean(y - np.rint(y))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("pack")
    parser.add_argument("--output", default="results/benchmark_pack")
    given = parser.parse_args()
    made, seconds = follow(given.pack, given.output)
    points = made["completeness"]["points"]
    off = made["photometry"][made["band"]]["points"]["mean"]
    print(f"{seconds:.0f} s; points found {points['completeness']:.3f} of {points['n']}, magnitudes {off:+.3f}")
    good = points["completeness"] >= LEAST and abs(off) <= MOST
    if (Path(given.pack) / "public" / "gratings").is_dir():
        away = traces(given.pack, Path(given.output) / "first.cat")
        away = away[np.isfinite(away)]
        most = np.abs(away).max()
        print(f"traces of {len(away)} spectra: {np.median(away):+.2f} px in the median, all within {most:.2f}")
        good = good and abs(np.median(away)) <= TRACE
    sys.exit(not good)


if __name__ == "__main__":
    main()
