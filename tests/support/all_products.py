"""Run every stage of a small campaign in one process and digest each product: a program for tests of equal bits.

python all_products.py FOLDER: makes campaigns in FOLDER (one science exposure of an imaging and a grating chip in the
middle of a brick, and bias, dark and lamp exposures) and prints {name of a product: digest} as JSON.
"""

import hashlib
import json
import sys
from contextlib import redirect_stdout
from importlib import import_module
from io import StringIO
from pathlib import Path

import fitsio
import healpy
from faults.small_run import pixels_and_columns, steady

from csstsim.campaign.opened import OpenCampaign
from csstsim.stages import calibrate as calibrate_stage
from csstsim.stages import chip as chip_stage
from csstsim.stages import extract as extract_stage
from csstsim.stages import masters as masters_stage
from csstsim.stages import measure as measure_stage
from csstsim.stages import merge as merge_stage
from csstsim.stages import psf as psf_stage
from csstsim.stages import report as report_stage
from csstsim.stages import truth as truth_stage
from csstsim.stages import validate as validate_stage
from csstsim.studies.compare.varying import varies
from support.mini_campaign import write_campaign

BRICK, IMAGING, GRATING = 550615, 9, 29
CALIBRATION = [
    *(f"1030000000{i},BIAS,0,0,0,2027-06-01T00:0{i}:00,0" for i in range(1, 4)),
    *(f"1070000000{i},DARK,0,0,0,2027-06-01T00:1{i}:00,150" for i in range(1, 4)),
    *(f"1000000000{i},FLAT,0,0,0,2027-06-01T00:2{i}:00,150" for i in range(1, 5)),
]


def science(folder, **changes):
    """Write the campaign of the science exposure in `folder`, made if missing; return it opened."""
    Path(folder).mkdir(parents=True, exist_ok=True)
    ra, dec = healpy.pix2ang(256, BRICK, nest=True, lonlat=True)
    pointing = f"10100000001,SCIE,{ra:.4f},{dec:.4f},-113.4333,2027-11-20T01:08:00,150"
    chips = {"types": ["SCIE"], "chips": [IMAGING, GRATING]}
    return OpenCampaign(write_campaign(folder, [pointing], **{"select": chips} | changes))


def exposures(folder):
    """Write the campaign of the calibration exposures in `folder`; return it opened."""
    Path(folder).mkdir(parents=True, exist_ok=True)
    select = {"types": ["BIAS", "DARK", "FLAT"], "chips": [IMAGING]}
    return OpenCampaign(write_campaign(folder, CALIBRATION, select=select))


def chain(run):
    """Yield (stage, call) of every stage of a campaign of `science`, in order."""
    for pix in sorted({pix for job in run.jobs for pix in run.truth_bricks(job)}):
        yield "truth", lambda pix=pix: truth_stage.truth(run, pix, log=str)
    for job in run.jobs:
        yield "psf", lambda job=job: psf_stage.psf(run, job.chip.id)
        for name in ("select", "render", "readout", "level0"):
            yield name, lambda name=name, job=job: getattr(import_module(f"csstsim.stages.{name}"), name)(run, job)
    for job in run.slitless_jobs:
        yield "extract", lambda job=job: extract_stage.extract(run, job)
    for job in run.imaging_jobs:
        yield "calibrate", lambda job=job: calibrate_stage.calibrate(run, job)
        yield "measure", lambda job=job: measure_stage.measure(run, job)
    for pix in run.merge_bricks:
        yield "merge", lambda pix=pix: merge_stage.merge(run, pix)
        yield "validate", lambda pix=pix: validate_stage.validate(run, pix)
    yield "report", lambda: report_stage.report(run)


def calibration_chain(run):
    """Yield (stage, call) of every stage of a campaign of `exposures`, in order."""
    for job in run.jobs:
        yield "chip", lambda job=job: chip_stage.chip(run, job, log=str)
    yield "masters", lambda: masters_stage.masters(run, IMAGING)


def digests(run):
    """Return {name: digest} of what is in a campaign's output folder, but for dates and timings."""
    out, found = run.paths.output, {}
    for path in sorted(p for p in out.rglob("*") if p.is_file()):
        found[str(path.relative_to(out))] = hashlib.sha256(_content(path)).hexdigest()[:16]
    return found


def _content(path):
    if "chips" in path.parts:
        return pixels_and_columns(path).encode()
    if path.suffix != ".fits" or "level0" in path.parts:
        return steady(path)
    with fitsio.FITS(path) as file:
        cards = [repr([c for c in hdu.read_header().records() if not varies(str(c["name"]))]) for hdu in file]
        return "".join(cards).encode() + b"".join(hdu.read().tobytes() for hdu in file if hdu.has_data())


def main(folder):
    """Make everything in `folder`; return {name: digest}."""
    sky, lamps = science(Path(folder) / "sky"), exposures(Path(folder) / "lamps")
    with redirect_stdout(StringIO()):
        for _, call in (*chain(sky), *calibration_chain(lamps)):
            call()
    return digests(sky) | digests(lamps)


if __name__ == "__main__":
    print(json.dumps(main(sys.argv[1])))
