"""What `compress: true` saves and costs: Level-0 files stored as RICE tiles, compared with gzip.

    python benchmarks/rice.py [FILE...]

FILE: Level-0 files that are not compressed; default: one a filter of the release.

For each file: its size; the size as RICE tiles of one row (csstsim.io.fits.compress) and of all pixels through gzip
(level 1); bits per pixel, with those that the noise alone needs; CPU seconds to write and to read a frame, both ways.

The noise of a Gaussian of sigma DN has log2(sigma sqrt(2 pi e)) bits of entropy: no lossless code of independent pixels
of such noise is shorter. Copies are written to a temporary folder.
"""

import argparse
import shutil
import tempfile
import time
import zlib
from collections import Counter
from pathlib import Path

from evidence.record import Record

import numpy as np
from toy_campaign import made_frames

from csstsim.base.shipped import ROOT
from csstsim.campaign.opened import OpenCampaign
from csstsim.io.fits_writing import compress
from csstsim.io.level0 import read_level0

CYCLE9 = 73_260  # Level-0 files


def timed(work):
    """Return what `work` returns, and its CPU seconds."""
    start = time.process_time()
    found = work()
    return found, time.process_time() - start


def entropy(frame):
    """Return the bits a pixel of the background's noise, from the differences along a row without outliers."""
    row = frame[frame.shape[0] // 4].astype(float)
    step = np.diff(row[row > 0])
    sigma = 1.4826 * np.median(np.abs(step))
    sigma = np.std(step[np.abs(step) < 4 * sigma]) / np.sqrt(2)
    return float(np.log2(sigma * np.sqrt(2 * np.pi * np.e)))


def main() -> None:
    """Compress copies of the files."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="*", type=Path)
    with Record(parser) as record:
        if record.toy:
            _, run = made_frames(record.results / "rice")
        else:
            run = OpenCampaign(ROOT / "examples" / "release.yaml")
        first = {job.chip.filter: run.paths.level0(job) for job in reversed(run.jobs)}
        files = dict.fromkeys(record.options.files, 1)
        counts = Counter(job.chip.filter for job in run.jobs)
        compare(files or {path: counts[name] for name, path in first.items()}, record)


def compare(files: dict[Path, int], record: Record) -> None:
    """Record what compression saves and costs, by file; files: {path: how many chips it stands for}."""
    rows, fractions, costs, same = [], [], [], True
    for path in files:
        plain, reading = timed(lambda path=path: read_level0(path, verify=True).frame())
        level0 = read_level0(path)
        zipped = len(zlib.compress(level0.frame().tobytes(), 1)) / plain.nbytes
        with tempfile.TemporaryDirectory() as folder:
            copy = Path(shutil.copy(path, folder))
            before = copy.stat().st_size
            _, writing = timed(lambda copy=copy: compress(copy))
            after = copy.stat().st_size
            packed, unpacking = timed(lambda copy=copy: read_level0(copy, verify=True).frame())
        same &= np.array_equal(plain, packed)
        fractions.append(after / before)
        costs.append((before, after, writing))
        cells = [level0.header["CHIPLAB"], level0.header["FILTER"], f"{before / 1e6:.1f}", f"{after / 1e6:.1f}"]
        cells += [f"{after / before:.3f}", f"{16 * after / before:.2f}", f"{entropy(plain):.2f}", f"{zipped:.3f}"]
        rows.append([*cells, *(f"{t:.1f}" for t in (writing, reading, unpacking))])
    header = ["chip", "filter", "MB", "RICE MB", "fraction", "bits a px", "of noise", "gzip fraction", "write, CPU-s"]
    record.table("files", [*header, "read", "read RICE"], rows)
    record.value("fraction_min", min(fractions), "size of a compressed file over that of the plain one, minimum")
    record.value("fraction_max", max(fractions), "the same, maximum")
    plain, packed, cpu = np.average(costs, axis=0, weights=list(files.values())) * CYCLE9
    record.value("cycle9_plain", plain / 1e12, f"the {CYCLE9:,} files of Cycle 9", unit="TB")
    record.value("cycle9", packed / 1e12, "the same, compressed", unit="TB")
    record.value("cycle9_cpu", cpu / 3600, "compressing them", unit="CPU hours")
    record.value("same", int(same), "pixels of compressed files are the same (1: all)", above=1)


if __name__ == "__main__":
    main()
