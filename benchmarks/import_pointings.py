"""A thousand pointings in each of four formats, imported and compared with astropy; broken rows and their reasons.

    python benchmarks/import_pointings.py [--rows 1000]

Prints, for each format, the largest difference of the survey table's rows from the exposures that the list was written
of, and CPU time; then the reason given for each kind of broken row. Exit code 1 if a row is lost, a difference exceeds
its limit, or a broken row is not refused.
"""

import argparse
import csv
import tempfile
import time
from pathlib import Path

from evidence.record import Record

import numpy as np
from astropy.coordinates import SkyCoord
from astropy.time import Time
from support.pointing_lists import BROKEN, FORMATS, exposures, write

from csstsim.campaign.pointing_lists.import_pointings import import_pointings
from csstsim.campaign.survey_table import load_survey_table
from csstsim.command_line.main import main as command

LIMITS = {"position [mas]": 0.01, "angle [deg]": 1e-6, "time [us]": 2.0, "state [m]": 1e-3}


def imported(file, output, arguments):
    """Import as the command does; return the CPU seconds of the import."""
    with command.make_context("csstsim", ["import-pointings", str(file), "--output", str(output), *arguments]) as ctx:
        _, verb, rest = command.resolve_command(ctx, [*ctx._protected_args, *ctx.args])
        with verb.make_context("import-pointings", rest, parent=ctx) as inner:
            options = {name: value for name, value in inner.params.items() if name not in ("file", "output")}
    start = time.process_time()
    import_pointings(file, output, lambda said: None, **options)
    return time.process_time() - start


def differences(table, truth):
    """Return {what: largest difference of the table's rows from the true exposures}."""
    rows = list(table.values())
    there = SkyCoord([p.ra for p in rows], [p.dec for p in rows], unit="deg")
    turn = np.array([p.pa for p in rows]) - truth["pa"]
    moved = np.array([p.sat_position for p in rows]) - truth["position"]
    return {
        "position [mas]": there.separation(SkyCoord(truth["ra"], truth["dec"], unit="deg")).mas.max(),
        "angle [deg]": np.abs((turn + 180.0) % 360.0 - 180.0).max(),
        "time [us]": 1e6 * np.abs((Time([p.time for p in rows], scale="utc") - truth["time"]).sec).max(),
        "state [m]": 1e3 * np.abs(moved).max(),
    }


def formats(folder, count, record):
    """Record the table of formats; return the number of faults."""
    truth, faults, lines, largest = exposures(count), 0, [], {}
    for number, kind in enumerate(FORMATS):
        file, arguments = write(kind, truth, folder)
        seconds = imported(file, folder / f"table{number}.csv", arguments)
        table = load_survey_table(folder / f"table{number}.csv")
        if len(table) != count:
            print(f"{kind}: {len(table)} rows of {count}")
            faults += 1
            continue
        found = differences(table, truth)
        if "sat_x" not in (folder / f"table{number}.csv").read_text():
            found["state [m]"] = None  # the model orbit's: the list has none
        faults += sum(value is not None and not value <= LIMITS[what] for what, value in found.items())
        for what, value in found.items():
            largest[what] = max(largest.get(what, 0.0), value or 0.0)
        shown = ["-" if value is None else f"{value:.2g}" for value in found.values()]
        lines.append([kind, len(table), *shown, f"{1e3 * seconds / count:.2f}"])
    record.table("formats", ["format", "rows", *LIMITS, "CPU ms a row"], lines)
    for what, value in largest.items():
        name, unit = what.removesuffix("]").split(" [")
        record.value(name, value, f"{name}: largest difference, all formats", unit=unit, below=LIMITS[what])
    return faults


def broken(folder, record):
    """Record the reason of each broken row; return the number that were not refused for it."""
    faults, lines = 0, []
    for number, (what, (head, good, bad, reason)) in enumerate(BROKEN.items()):
        file, output = folder / f"broken{number}.csv", folder / f"broken{number}_table.csv"
        file.write_text(f"{head}\n{good}\n{bad}\n")
        imported(file, output, ["--map", "time_mjd=mjd"] if "mjd" in head else [])
        _, *rows = csv.reader(output.with_suffix(".rejected.csv").read_text().splitlines())
        right = (
            len(rows) == 1 and rows[0][0] == "line 3" and reason in rows[0][1] and len(load_survey_table(output)) == 1
        )
        faults += not right
        lines.append([what, f"{rows[0][1] if rows else 'not refused'}{'' if right else ' (WRONG)'}"])
    record.table("broken", ["broken", "refused because"], lines)
    return faults


def main() -> None:
    """Run both."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", type=int, default=1000)
    with Record(parser) as record, tempfile.TemporaryDirectory() as folder:
        count = 50 if record.toy else record.options.rows
        faults = formats(Path(folder), count, record) + broken(Path(folder), record)
        record.value("faults", faults, "rows lost, off, or not refused", below=0)


if __name__ == "__main__":
    main()
