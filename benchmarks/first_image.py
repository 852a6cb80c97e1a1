"""A new user's first image, timed: from `pip install` of the wheel to a picture of ten objects of their own.

    python benchmarks/first_image.py [--keep FOLDER]

The wheel is built from this clone and installed, with requirements.lock as constraints, into a bare virtual environment
outside of it. Then, with nothing but that environment on the path: `csstsim doctor`, a table of ten objects,
`csstsim init --catalogue`, `csstsim check`, `csstsim chip`, `csstsim show`, and the dry run of the whole workflow in
that folder. Fails if a step fails, if a file of the clone is used, or if an object of the table is not in the truth.
Compiled code, PSF set and all else are made from nothing, but pip may use its cache.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from evidence.record import Record

ROOT = Path(__file__).resolve().parents[1]
OBJECTS = """\
ra,dec,mag_g,mag_r,type,size,e1,e2
150.1000,2.2000,19.2,18.6,star,,,
150.1030,2.2010,20.1,19.4,star,,,
150.0980,2.1990,,20.0,star,,,
150.1010,2.2035,21.0,20.2,galaxy,0.6,0.2,0.0
150.0960,2.2020,20.5,19.9,galaxy,0.9,0.0,-0.3
150.1040,2.1970,22.0,21.3,galaxy,0.4,0.1,0.1
150.1005,2.1960,23.0,22.1,galaxy,0.5,-0.2,0.1
150.0990,2.2040,19.0,18.8,quasar,,,
150.1025,2.2005,22.5,22.0,galaxy,0.3,0.0,0.0
150.0970,2.1975,21.5,21.2,star,,,
"""
LOOK = "import csstsim, sys; print(csstsim.__file__); from csstsim.base.shipped import ROOT; print(ROOT)"
COUNT = "import sys; from csstsim.catalog.table import ObjectTable; print(len(ObjectTable.read(sys.argv[1])))"


class Stranger:
    """Runs commands in a folder with a bare environment, and prints the time of each."""

    def __init__(self, home):
        self.home, self.total = home, 0.0
        kept = {name: value for name, value in os.environ.items() if name.startswith("PIP_")}
        self.environment = kept | {"HOME": str(home), "PATH": f"{home}/venv/bin:/usr/local/bin:/usr/bin:/bin"}

    def run(self, *line, folder=None, counted=True):
        """Run a command, print its seconds if they are counted, return what it printed; end if it fails."""
        start, line = time.perf_counter(), [str(word) for word in line]
        done = subprocess.run(
            line, cwd=folder or self.home, env=self.environment, capture_output=True, text=True, check=False
        )
        seconds = time.perf_counter() - start
        if done.returncode:
            sys.exit(f"{' '.join(line)}\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}")
        if counted:
            self.total += seconds
            print(f"{seconds:6.1f} s  {Path(line[0]).name} {' '.join(line[1:])}"[:110], flush=True)
        return done.stdout


def main() -> None:
    """Go the way of a new user."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--keep", type=Path, help="folder that receives the wheel")
    with Record(parser) as record:
        go(record)


def go(record: Record) -> None:
    """Install, make the image, look at it; record the time. At toy size the wheel is installed, but not used."""
    keep = record.options.keep
    with tempfile.TemporaryDirectory() as home:
        home = Path(home)
        who = Stranger(home)
        who.run(sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "-w", home, ROOT, counted=False)
        who.run(sys.executable, "-m", "venv", "venv", counted=False)
        [wheel] = home.glob("*.whl")
        few = ["--no-deps", "--no-compile"] if record.toy else []
        who.run("venv/bin/pip", "install", "-q", *few, "--constraint", ROOT / "requirements.lock", wheel)
        programs = Path(sys.executable).parent if record.toy else home / "venv" / "bin"
        places = who.run(programs / "python", "-c", LOOK, counted=False).split()
        if any(not place.startswith(str(home)) for place in places) and not record.toy:
            sys.exit(f"files of the clone are used: {places}")
        who.run(programs / "csstsim", "doctor")
        (home / "objects.csv").write_text(OBJECTS)
        who.run(programs / "csstsim", "init", "mysky", "--catalogue", "objects.csv")
        sky = home / "mysky"
        who.run(programs / "csstsim", "check", "campaign.yaml", folder=sky)
        who.run(
            programs / "csstsim", "chip", "campaign.yaml", "--obsid", "10100000002", "--chip", "9", folder=sky,
        )  # fmt: skip
        [image] = sky.glob("results/level0/*/*_L0_V01.fits")
        who.run(
            programs / "csstsim", "show", image.relative_to(sky), "--truth", "--subtract-overscan",
            "--size", "500", "--output", "look.png", folder=sky,
        )  # fmt: skip
        record.value("seconds", who.total, "from pip install to a picture that one looks at", unit="s", below=300)
        count = int(who.run(programs / "python", "-c", COUNT, image.with_suffix(".truth.parquet"), counted=False))
        if count != OBJECTS.count("\n") - 1:
            sys.exit(f"{count} objects in the truth table")
        who.run(programs / "snakemake", "--cores", "2", "--dry-run", "--quiet", "rules", folder=sky)
        shutil.copy(sky / "look.png", record.figure("first_image.png"))
        if keep:
            keep.mkdir(parents=True, exist_ok=True)
            shutil.copy(wheel, keep)


if __name__ == "__main__":
    main()
