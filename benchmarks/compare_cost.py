"""CPU seconds and memory of `csstsim compare` of two large files that differ in one value: a frame, and tables.

    python benchmarks/compare_cost.py

The start of the command is part of both.
"""

import argparse
import os
import subprocess
import sys
from pathlib import Path

from evidence.record import Record

import numpy as np
from astropy.io import fits

from csstsim.catalog.table import ObjectTable

SHAPE, TOY_SHAPE = (9232, 9216), (300, 300)  # px
ROWS, TOY_ROWS, COLUMNS = 1_000_000, 1000, 71


def cost(a: Path, b: Path) -> tuple[float, float]:
    """Return CPU seconds and memory [GB] of `csstsim compare` of two files that differ."""
    process = subprocess.Popen([Path(sys.executable).parent / "csstsim", "compare", a, b])
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode != 1:
        sys.exit(f"csstsim compare ended with {process.returncode}, not with 1: a difference")
    return used.ru_utime + used.ru_stime, used.ru_maxrss / 1e6


def main() -> None:
    """Write the files and compare them."""
    with Record(argparse.ArgumentParser(description=__doc__.splitlines()[0])) as record:
        folder, rng = record.results / "compare_cost", np.random.default_rng(1)
        folder.mkdir(parents=True, exist_ok=True)
        shape, count = (TOY_SHAPE, TOY_ROWS) if record.toy else (SHAPE, ROWS)
        image = rng.random(shape, np.float32)
        names = [folder / f"{name}.fits" for name in "ab"]
        for path in names:
            fits.PrimaryHDU(image).writeto(path, overwrite=True)
            image[shape[0] // 2, shape[1] // 2] += 1
        pairs = {f"a frame of {shape[1]} x {shape[0]} float32": names}
        table = {"id": np.arange(count)} | {f"column_{k}": rng.random(count) for k in range(1, COLUMNS)}
        tables = [folder / f"{name}.parquet" for name in ("a", "b", "less")]
        for path in tables:
            ObjectTable(table).write(path)
            table["column_1"] = table["column_1"].copy()
            table["column_1"][count // 2] += 1
            if path == tables[1]:
                table = {name: values[1:] for name, values in table.items()}
        size = tables[0].stat().st_size / 1e9
        pairs[f"tables of {count:,} rows, {COLUMNS} columns, {size:.1f} GB each"] = tables[:2]
        pairs["the same, a row less, matched by id"] = [tables[0], tables[2]]
        rows = [[what, *cost(*pair)] for what, pair in pairs.items()]
        record.table("costs", ["two files", "CPU-s", "memory, GB"], [[w, f"{c:.1f}", f"{m:.2f}"] for w, c, m in rows])
        for path in {*names, *tables}:
            path.unlink()


if __name__ == "__main__":
    main()
