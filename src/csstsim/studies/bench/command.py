"""The command `csstsim bench`: setting, cases, sweep, table, chart."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from csstsim.base.errors import InputError
from csstsim.instrument.camera import load_camera
from csstsim.studies.bench.chart import draw_chart
from csstsim.studies.bench.setting import make_setting
from csstsim.studies.bench.summary import read, summarise, text, write
from csstsim.studies.bench.sweep import sweep

if TYPE_CHECKING:
    from csstsim.base.types import PathLike
    from csstsim.studies.bench.imaging.methods import Method
    from csstsim.studies.bench.sweep import Bench, CaseT

FULL = {"seconds": 0.2, "electrons": 3e7}
QUICK = {"seconds": 0.01, "electrons": 1e6}
OBJECTS = 320
OBJECTS_SHAPES = 48
OBJECTS_SLITLESS = 24
OBJECTS_QUICK = 24
# arcsec, half-light radius
SIZE_MAX = 5.0
SIZE_MAX_QUICK = 0.5


def choose_methods(names: str | None, methods: tuple[Method[CaseT], ...]) -> tuple[Method[CaseT], ...]:
    """Return the `methods` whose names begin with one of `names` (comma-separated text), or all. Raises InputError."""
    if not names:
        return methods
    selected: list[Method[CaseT]] = []
    for name in (part.strip() for part in names.split(",")):
        matching = [method for method in methods if name and method.name.lower().startswith(name.lower())]
        if not matching:
            allowed = ", ".join(f'"{method.name}"' for method in methods)
            raise InputError("unknown method", key="--methods", value=name, allowed=allowed)
        selected += [method for method in matching if method not in selected]
    return tuple(selected)


def bench(
    folder: PathLike,
    band: str,
    names: str | None,
    quick: bool,
    objects: int | None,
    seed: int,
    log: Callable[[str], object],
    shapes: bool = False,
) -> None:
    """Run the benchmark into `folder`: cases.csv (every object and method), speed_accuracy.csv and .png.

    band: name of the filter; names: of methods, comma-separated; shapes: of galaxies of any index, with knots, of
    images (bench.imaging.shapes).
    """
    folder = Path(folder)
    start = time.process_time()
    dispersed = band in {chip.filter for chip in load_camera().slitless_chips}
    if shapes and dispersed:
        raise InputError("is for imaging filters", key="--shapes", value=band)
    benchmark: Bench[Any]
    if shapes:
        from csstsim.studies.bench.imaging.benchmark import SHAPES as benchmark
    elif not dispersed:
        from csstsim.studies.bench.imaging.benchmark import IMAGING as benchmark
    else:
        from csstsim.studies.bench.slitless.benchmark import SLITLESS as benchmark
    methods = choose_methods(names, benchmark.methods)
    setting = make_setting(folder, band)
    log(f"chip {setting.chip.id}, {band} band: PSF set and tables ready, {time.process_time() - start:.0f} CPU s")
    default = OBJECTS_SHAPES if shapes else OBJECTS if setting.disperser is None else OBJECTS_SLITLESS
    count = objects or (OBJECTS_QUICK if quick else default)
    largest = SIZE_MAX_QUICK if quick else SIZE_MAX
    cases = benchmark.make_cases(setting, count, seed, largest)
    rows = sweep(benchmark, setting, cases, methods, **(QUICK if quick else FULL))
    lines = summarise(rows, benchmark, band)
    write(folder / "cases.csv", rows)
    write(folder / "speed_accuracy.csv", lines)
    draw_chart(folder / "speed_accuracy.png", [lines])
    for line in text(lines, benchmark):
        log(line)
    log(f"{time.process_time() - start:.0f} CPU s in all; {folder}/speed_accuracy.png, speed_accuracy.csv, cases.csv")


def chart(folder: PathLike, tables: Iterable[PathLike], log: Callable[[str], object]) -> None:
    """Draw the tables (paths of speed_accuracy.csv) of several runs as one chart. Raises InputError."""
    summaries = []
    for path in tables:
        try:
            summaries.append(read(path))
            _ = [(line["filter"], line["cpu_us"] + line["visible_median"], line["limit"]) for line in summaries[-1]]
        except (KeyError, TypeError):
            raise InputError("is not a table of csstsim bench", file=path, allowed="a speed_accuracy.csv") from None
    draw_chart(Path(folder) / "speed_accuracy.png", summaries)
    log(f"{folder}/speed_accuracy.png")
