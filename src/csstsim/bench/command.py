"""The command `csstsim bench`: setting, cases, sweep, table, chart."""

import time
from pathlib import Path

from csstsim.bench.cases import make_cases
from csstsim.bench.chart import draw_chart
from csstsim.bench.methods import METHODS
from csstsim.bench.setting import make_setting
from csstsim.bench.summary import summarise, text, write
from csstsim.bench.sweep import sweep
from csstsim.errors import InputError

FULL = {"seconds": 0.2, "electrons": 3e7}
QUICK = {"seconds": 0.01, "electrons": 1e6}
OBJECTS, OBJECTS_QUICK, LARGEST_QUICK = 320, 24, 0.5  # number, number, arcsec


def chosen(names):
    """Return the Methods whose names begin with these (comma-separated text), or all. Raises InputError."""
    if not names:
        return METHODS
    found = []
    for name in (part.strip() for part in names.split(",")):
        same = [method for method in METHODS if name and method.name.lower().startswith(name.lower())]
        if not same:
            allowed = ", ".join(f'"{method.name}"' for method in METHODS)
            raise InputError("unknown method", key="--methods", value=name, allowed=allowed)
        found += [method for method in same if method not in found]
    return tuple(found)


def bench(folder, band, names, quick, objects, seed, say):
    """Run the benchmark into `folder`: cases.csv (every object and method), speed_accuracy.csv and .png."""
    methods, folder = chosen(names), Path(folder)
    start = time.process_time()
    setting = make_setting(folder, band)
    say(f"chip {setting.chip.id}, {band} band: PSF set and tables ready, {time.process_time() - start:.0f} CPU s")
    how = {"largest": LARGEST_QUICK} if quick else {}
    cases = make_cases(setting, objects or (OBJECTS_QUICK if quick else OBJECTS), seed, **how)
    rows = sweep(setting, cases, methods, **(QUICK if quick else FULL))
    lines = summarise(rows)
    write(folder / "cases.csv", rows)
    write(folder / "speed_accuracy.csv", lines)
    note = f"{band} band, {setting.exptime:.0f} s, {len(cases)} objects"
    draw_chart(folder / "speed_accuracy.png", rows, methods, note)
    for line in text(lines):
        say(line)
    say(f"{time.process_time() - start:.0f} CPU s in all; {folder}/speed_accuracy.png, speed_accuracy.csv, cases.csv")
