"""CPU seconds until csstsim is imported and until its help is printed, compared with those of Python and numpy.

    python benchmarks/start_up.py [--runs 15]

Prints the user and system time of one process each, with everything compiled before (Python's .pyc): median, least and
most. Exit code 1 if the package takes more than 0.5 CPU s, or the help more than 1.
"""

import argparse
import os
import statistics
import subprocess
import sys

from evidence.record import Record

HELP = "from csstsim.command_line.main import main; main(['--help'])"
TAKES = {  # name: (code, most CPU s in the median, or None)
    "python -c pass": ("pass", None),
    "import numpy": ("import numpy", None),
    "import csstsim": ("import csstsim", 0.5),
    "csstsim --help": (HELP, 1.0),
    "csstsim chip --help": (HELP.replace("'--help'", "'chip', '--help'"), 1.0),
}


def cpu_seconds(code):
    """Return user and system seconds of a Python process that runs `code`."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.DEVNULL, env=environment)
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        sys.exit(f"{code}: exit code {process.returncode}")
    return used.ru_utime + used.ru_stime


def main(record: Record) -> None:
    """Time each process."""
    runs, rows = 2 if record.toy else record.options.runs, []
    for name, (code, most) in TAKES.items():
        cpu_seconds(code)  # the first, which compiles, does not count
        took = [cpu_seconds(code) for _ in range(runs)]
        median = statistics.median(took)
        key = "_".join(name.replace("-", " ").replace("python", "").split())
        record.value(key, median, f"`{name}`, median of {runs} processes", unit="CPU-s", below=most)
        rows.append([f"`{name}`", f"{median:.3f}", f"{min(took):.3f} to {max(took):.3f}", "" if most is None else most])
    record.table("processes", ["process", "CPU-s, median", "minimum to maximum", "allowed"], rows)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=15)
    with Record(parser) as record:
        main(record)
