"""A campaign small enough to be broken and resumed many times, and checks of its products.

One science exposure of one chip in the middle of a brick: one truth brick, one PSF set, four stages, measure, merge,
validate, report. It always runs in the same folder, so that its files can be compared byte for byte.
"""

import os
import shutil
import signal
import subprocess
from functools import cached_property

import fitsio
import healpy
from support.mini_campaign import write_campaign
from support.workflow_run import ROOT, command

from csstsim.campaign.opened import OpenCampaign
from csstsim.catalog.table import ObjectTable
from csstsim.io.frames import load_frame
from csstsim.stages import level0 as level0_stage
from csstsim.stages import measure as measure_stage
from csstsim.stages import merge as merge_stage
from csstsim.stages import psf as psf_stage
from csstsim.stages import readout as readout_stage
from csstsim.stages import render as render_stage
from csstsim.stages import report as campaign_report
from csstsim.stages import select as select_stage
from csstsim.stages import truth as truth_stage
from csstsim.stages import validate as validate_stage
from csstsim.studies.compare.varying import steady_page, varies

BRICK, OBSID, CHIP = 550615, "10100000001", 9
RESUME = "--profile", str(ROOT / "profiles" / "default"), "--cores", "1"  # docs/faults.md
# Each rule in the order of the chain: what it makes, by the beginning of the path, and the stage itself
CHAIN = {
    "truth": (("truth/",), lambda run, job: truth_stage.truth(run, BRICK)),
    "psf": (("psf/",), lambda run, job: psf_stage.psf(run, CHIP)),
    "select": ((f"chips/{OBSID}_09/select",), select_stage.select),
    "render": ((f"chips/{OBSID}_09/render", f"chips/{OBSID}_09/drawn"), render_stage.render),
    "readout": ((f"chips/{OBSID}_09/readout",), readout_stage.readout),
    "level0": (("level0/",), level0_stage.level0),
    "measure": (("measure/",), measure_stage.measure),
    "merge": (("merge/dataset/Norder=8/",), lambda run, job: merge_stage.merge(run, BRICK)),
    "validate": (("validate/",), lambda run, job: validate_stage.validate(run, BRICK)),
    "report": (("report/", "merge/"), lambda run, job: campaign_report.report(run)),
}


class SmallRun:
    """The campaign in `folder`, beside it what an undisturbed run made; `wanted` {name: bytes} are its products."""

    def __init__(self, folder):
        self.folder, self.kept = folder / "campaign", folder / "kept"
        self.out = self.folder / "out"
        self.folder.mkdir()
        ra, dec = healpy.pix2ang(256, BRICK, nest=True, lonlat=True)
        pointing = f"{OBSID},SCIE,{ra:.4f},{dec:.4f},-113.4333,2027-11-20T01:08:00,150"
        self.file = write_campaign(self.folder, [pointing])
        self.resume("--notemp")  # tests that damage intermediates need them
        shutil.copytree(self.folder, self.kept)
        self.wanted = self.products()

    def back_before(self, rule, intermediates=()):
        """Make the folder what it was before a rule: what it and the later ones made has never been.

        Of the intermediates made before it those named are there; the others were used and dropped.
        """
        shutil.rmtree(self.folder)
        shutil.copytree(self.kept, self.folder)
        rules = list(CHAIN)
        later = tuple(name for rule in rules[rules.index(rule) :] for name in CHAIN[rule][0])
        kept = tuple(name for rule in rules[: rules.index(rule)] for name in CHAIN[rule][0])
        for path in self.files():
            name = self.name(path)
            drop = name.startswith("chips/") and path.stem not in intermediates
            if drop or (name.startswith(later) and not name.startswith(kept)):
                path.unlink()

    def name(self, path):
        return str(path.relative_to(self.out))

    def files(self):
        """Return every file of the output folder but logs."""
        folders = [path for path in self.out.iterdir() if path.name != "logs"]
        return sorted(p for folder in folders for p in (folder, *folder.rglob("*")) if p.is_file())

    def temporaries(self):
        """Return the names of what writers left half-written."""
        return [self.name(path) for path in self.files() if ".tmp" in path.name]

    def products(self):
        """Return {name: bytes} of every product, without dates and timings."""
        return {self.name(p): steady(p) for p in self.files() if "chips" not in p.parts and ".tmp" not in p.name}

    def steady_files(self):
        """Return {name: bytes} of every file, intermediates too; of these the pixels and columns, not the timings."""
        return {self.name(p): pixels_and_columns(p) if "chips" in p.parts else steady(p) for p in self.files()}

    @cached_property
    def opened(self):
        """The campaign and its one job."""
        run = OpenCampaign(self.file)
        return run, run.job(OBSID, CHIP)

    def stage(self, rule):
        """Run a rule's stage in this process."""
        CHAIN[rule][1](*self.opened)

    def start(self, *arguments, folder=None, file=None, profile=RESUME):
        """Start the documented command in a process group of its own; return (process, file of what it says)."""
        line, environment = command(file or self.file, "chips=stages", *arguments, *profile)
        if folder:  # another working directory
            line[line.index("--directory") + 1] = str(folder)
        said = (folder or self.folder) / "said.txt"
        with open(said, "w") as out:
            process = subprocess.Popen(line, env=environment, stdout=out, stderr=out, start_new_session=True)
        return process, said

    def run(self, *arguments, **where):
        """Run the documented command to its end; return (exit code, what it said)."""
        process, said = self.start(*arguments, **where)
        return ended(process), said.read_text()

    def resume(self, *arguments):
        """Run the documented command, which must succeed."""
        code, said = self.run(*arguments)
        assert code == 0, said

    def refused(self, *words):
        """Run the documented command, which must fail, say these words and show no traceback."""
        code, said = self.run()
        assert code == 1 and all(word in said for word in words) and "Traceback" not in said, said

    def assert_as_undisturbed(self):
        """Every product is there and the undisturbed run's to the bit; nothing else is."""
        self.assert_nothing_wrong()
        assert sorted(self.products()) == sorted(self.wanted)
        assert self.temporaries() == [] and not list(self.out.glob("chips/*/*"))

    def assert_nothing_wrong(self, but=None):
        """What stands under a product's name is the undisturbed run's to the bit; `but`: a name left out."""
        found = self.products()
        assert [name for name in found if found[name] != self.wanted.get(name) and name != but] == []


def ended(process, seconds=600):
    """Return the exit code of a process that must end; its group is killed if it does not."""
    try:
        return process.wait(timeout=seconds)
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()


def steady(path):
    """Return what must be the same in two runs of a product: its bytes, but for dates and timings."""
    if path.suffix == ".fits":  # what varies is in Level-0's first HDU
        with fitsio.FITS(path) as file:
            start = file["IMAGE"].get_offsets()["header_start"]
            cards = file[0].read_header().records()
        cards = [(c["name"], c["value"], c["comment"]) for c in cards if not varies(str(c["name"]))]
        return repr(cards).encode() + path.read_bytes()[start:]
    if path.name.endswith(".truth.parquet"):
        table = ObjectTable.read(path)
        return repr((_columns(table), table.meta)).encode()
    if path.suffix == ".html":
        return "".join(steady_page(path.read_text())).encode()
    return path.read_bytes()


def pixels_and_columns(path):
    """Return what the next stage takes of an intermediate, as text."""
    if path.suffix == ".fits":
        planes, _ = load_frame(path)
        return repr({name: plane.tobytes() for name, plane in planes.items()})
    return repr(_columns(ObjectTable.read(path)))


def _columns(table):
    return {name: table[name].tolist() for name in table if not varies(name)}
