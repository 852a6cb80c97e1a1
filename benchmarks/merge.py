"""Merging a brick: CPU time and memory by the number of detections, and for a brick streamed from measured tables.

    python benchmarks/merge.py [--sizes 1e4 1e5 1e6] [--exposures 50] [--rows 20000]

The first cases are detections fabricated in memory, all in one brick: stars and galaxies seen by 50 exposures in seven
bands, scattered by their errors; then as many in a field so crowded that one in eight has a neighbour within 0.3
arcsec. The last is a brick whose exposures are parquet files: each of the four chips around it has about `--rows` rows,
some of them in the brick. Each row of the table runs in its own process, so that its memory (anonymous, above that
before the merge) is its own.
"""

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from evidence.record import Record

import healpy
import numpy as np
from private_memory import PrivateMemory

from csstsim.base.rng import stream
from csstsim.base.sphere import ra_dec, unit_vectors
from csstsim.catalog.table import ObjectTable
from csstsim.measure.bricks.merge import DETECTION_COLUMNS, merge_brick, write_merged

BANDS = ("nuv", "u", "g", "r", "i", "z", "y")
PIX = 550615
ARCSEC = np.pi / 180.0 / 3600.0
SIDE, CHIP = 13.0 * 60, 11.4 * 60  # arcsec: of a square inside the brick (rotated by half a right angle), of a chip
LIMIT = 4.0  # GB for the brick from its files
CROWDED = 0.45  # sources per square arcsecond; with 1e6 detections the others have 0.03 to 0.15


def sky(count, side, seed):
    """Return positions (count, 2) [arcsec] in a square around the brick's centre, and the sources' S/N."""
    rng = stream(seed, "merge", "sky")
    return rng.uniform(-side / 2, side / 2, (count, 2)), 4.0 * rng.uniform(size=count) ** (-1 / 0.9)


def exposure(number, places, snr, *, window=None):
    """Return the measured table of an exposure of sources: those of S/N > 3 within `window` (centre, half a side)."""
    rng = stream(1, "merge", "exposure", number)
    if window is not None:
        inside = (np.abs(places - window[0]) < window[1]).all(axis=1)
        places, snr = places[inside], snr[inside]
    seen = np.maximum(snr, 0) + rng.normal(size=len(snr))
    places, snr = places[seen > 3], seen[seen > 3]
    error = 0.065 / snr
    centre = unit_vectors(*healpy.pix2ang(256, PIX, nest=True, lonlat=True))
    east = np.cross([0.0, 0.0, 1.0], centre)
    east /= np.linalg.norm(east)
    # The brick is a square on its corner
    first, second = (east + np.cross(centre, east)) / 2**0.5, (east - np.cross(centre, east)) / 2**0.5
    moved = places + error[:, None] * rng.normal(size=places.shape)
    ra, dec = ra_dec(centre + moved * ARCSEC @ np.stack([first, second]))
    n = len(ra)
    columns = {
        "obsid": np.full(n, f"101{number:08d}"), "chip": np.full(n, 9), "filter": np.full(n, BANDS[number % 7]),
        "number": np.arange(n), "ra": ra, "dec": dec, "pos_err": error, "flux_psf": 40.0 * snr,
        "flux_psf_err": np.full(n, 40.0), "flux_kron": 40.0 * snr, "flux_kron_err": np.full(n, 60.0),
        "flux_total": 42.0 * snr, "flux_total_err": np.full(n, 70.0), "flux_gaap": 36.0 * snr,
        "flux_gaap_err": np.full(n, 55.0), "zeropoint": np.full(n, 31.0),
        "snr": snr, "star": snr > 20, "flags": np.zeros(n, np.int32),
    }  # fmt: skip
    return ObjectTable({name: np.asarray(columns[name], kind) for name, kind in DETECTION_COLUMNS.items()})


def in_memory(size, crowded):
    """Return (sources, tables) of about `size` detections in one brick."""
    exposures = 50
    count = int(1.35 * size / exposures)
    places, snr = sky(count, min(SIDE, (count / CROWDED) ** 0.5) if crowded else SIDE, 1)
    tables, left = [], size
    for number in range(exposures):
        table = exposure(number, places, snr)
        tables.append(table.take(slice(0, left)))
        left -= len(tables[-1])
    return tables


def measured(case, tables, pix=PIX):
    """Print CPU seconds, memory, sources and detections of merging `tables` and writing the brick."""
    merge_brick(pix, [exposure(k, *sky(10, 60.0, 1)) for k in range(2)], BANDS)  # compiles
    with PrivateMemory() as memory, tempfile.TemporaryDirectory() as folder:
        time.sleep(0.1)
        before, start = memory.largest, time.process_time()
        sources, detections = merge_brick(pix, tables, BANDS)
        merged = time.process_time() - start
        write_merged(Path(folder) / "brick.parquet", sources, detections, {})
        total, largest = time.process_time() - start, memory.largest
    near = sources.meta["detections"]["near"]
    print(f"{case}|{near}|{len(sources)}|{merged:.2f}|{total:.2f}|{largest - before:.2f}|{largest:.2f}")


def stream_brick(exposures, rows):
    """Merge a brick of `exposures` exposures, 4 chips each, whose tables are files of `rows` rows each."""
    with tempfile.TemporaryDirectory() as folder:
        paths = []
        places, snr = sky(int(1.35 * rows * (2 * CHIP + 60) ** 2 / CHIP**2), 2 * CHIP + 60, 2)
        for number in range(exposures):
            shift = stream(3, "merge", "dither", number).uniform(-200, 200, 2)
            for chip in range(4):
                corner = np.array([chip % 2, chip // 2]) * (CHIP + 20) - (CHIP + 20) / 2
                table = exposure(number * 4 + chip, places, snr, window=(corner + shift, CHIP / 2))
                paths.append(Path(folder) / f"{number}_{chip}.parquet")
                table.with_columns(chip=np.full(len(table), 8 + chip)).write(paths[-1])
        measured(f"streamed, {len(paths)} files", (ObjectTable.read(path, DETECTION_COLUMNS) for path in paths))


def main() -> None:
    """Run one case, or all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", nargs="+", type=float, default=[1e4, 1e5, 1e6])
    parser.add_argument("--exposures", type=int, default=50)
    parser.add_argument("--rows", type=int, default=20_000)
    parser.add_argument("--case", help=argparse.SUPPRESS)  # one row, in this process
    if "--case" in sys.argv:
        given = parser.parse_args()
        if given.case == "streamed":
            stream_brick(given.exposures, given.rows)
        else:
            measured(given.case, in_memory(int(given.sizes[0]), given.case == "crowded"))
        return
    with Record(parser) as record:
        if record.toy:
            record.options.sizes, record.options.exposures, record.options.rows = [1e3, 3e3], 3, 500
        table(record.options, record)


def table(given, record: Record) -> None:
    """Record all rows, each run in its own process, and how the time grows."""
    lines: list[list[str]] = []
    for case in ("usual", "crowded"):
        rows = [run(case, "--sizes", f"{size:.0f}") for size in given.sizes]
        if len(rows) > 1:
            log = np.log([[float(row[1]), float(row[3])] for row in rows])
            growth = (log[-1, 1] - log[-2, 1]) / (log[-1, 0] - log[-2, 0])
            record.value(f"growth_{case}", growth, f"{case}: power of detections as which time grows, last two sizes")
        for size, row in zip(given.sizes, rows, strict=True):
            record.value(
                f"cpu_{case}_{size:.0e}".replace("+0", ""),
                float(row[4]),
                f"{case}, {size:,.0f} detections",
                unit="CPU-s",
            )
        lines += rows
    lines.append(run("streamed", "--exposures", f"{given.exposures}", "--rows", f"{given.rows}"))
    record.value("streamed_detections", int(lines[-1][1]), "detections in reach of the brick from files")
    record.value("streamed_cpu", float(lines[-1][4]), "a brick from its files", unit="CPU-s")
    record.value("streamed_gb", float(lines[-1][5]), "memory for the brick from its files", unit="GB", below=LIMIT)
    header = ["case", "detections", "sources", "merge, CPU-s", "with the file, CPU-s", "memory, GB"]
    record.table("cases", [*header, "of the whole process, GB"], lines)


def run(case: str, *options: str) -> list[str]:
    """Run a case in a process of its own; return the cells of its row."""
    command = [sys.executable, __file__, "--case", case, *options]
    row = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout.strip().split("|")
    return row


if __name__ == "__main__":
    main()
