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


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--runs", type=int, default=15)
    runs, slow = parser.parse_args().runs, False
    print("| process | CPU s, median | least to most | allowed |\n|---|---|---|---|")
    for name, (code, most) in TAKES.items():
        cpu_seconds(code)  # the first, which compiles, does not count
        took = [cpu_seconds(code) for _ in range(runs)]
        median = statistics.median(took)
        slow |= most is not None and median > most
        print(f"| `{name}` | {median:.3f} | {min(took):.3f} to {max(took):.3f} | {'' if most is None else most} |")
    sys.exit(1 if slow else 0)


if __name__ == "__main__":
    main()
