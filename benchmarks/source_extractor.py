"""csstsim's measurement against source-extractor and psfex on the same frames: completeness, zero point, positions.

    apt-get install source-extractor psfex
    python benchmarks/source_extractor.py                      # r and i windows of the demo's field, full depth
    python benchmarks/source_extractor.py --campaign FILE      # the imaging science frames of a campaign

Level-0 files are made, those of a campaign of your own if they are missing. Each frame is calibrated and measured
(`csstsim calibrate`, `measure`), and the two programs detect and measure its sources as well
(benchmarks/astromatic.py). Both catalogues are compared with the truth as by `csstsim validate`: isolated objects, S/N
of the truth. Magnitudes are those of the measured over the true electrons, so 0 means all light. psfex's model ends
10 px from a star, and much light lies beyond. So the total light is taken as FLUX_PSF times the light of its model
within 6 px, over the fraction of csstsim's PSF there.

Exit code 1 if completeness above S/N 5 differs by more than 2% and two sigma of the number that only one code finds, or
a zero point by more than 0.02 mag; 2 if the input cannot be used or the programs are not installed.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from evidence.record import Record

import astromatic
import numpy as np
import yaml
from astropy.io import fits
from source_extractor_compare import Code, draw, report
from toy_sky import toy_sky

from csstsim.base.errors import CsstsimError, InputError
from csstsim.campaign.opened import OpenCampaign
from csstsim.catalog.table import STAR, ObjectTable
from csstsim.instrument.camera import load_telescope
from csstsim.io.truth import read_truth
from csstsim.measure.bricks.validation.measured_frame import MeasuredFrame, truth_inside
from csstsim.measure.light.apertures import KRON_MIN_RADIUS
from csstsim.optics.psf.psf_file import half_pixels, pixel_response
from csstsim.stages.psf import open_psf

ROOT = Path(__file__).parents[1]
FACTS = {
    "light_6": "light of csstsim's PSF within 6 px", "psfex": "light of psfex's model within 6 px",
    "light_kron": f"light of csstsim's PSF within {KRON_MIN_RADIUS} px, its minimum Kron radius",
    "failed": "fraction of source-extractor's detections whose fit of the PSF failed", "stars": "stars that psfex took",
}  # fmt: skip
FIELD = {"ra": 60.1172, "dec": -40.0330}  # the demo's
OBSIDS = [f"101000000{number}" for number in ("04", "05", "11", "12")]  # its field, in r and i, twice


def default_campaign(output, side, obsids=OBSIDS, toy=False):
    """Write the campaign of the default frames, `side` px wide, with perfect charge transfer; return its file.

    toy: of a table of objects.
    """
    output.mkdir(parents=True, exist_ok=True)
    scale = load_telescope(ROOT / "config/instrument/telescope.yaml").telescope.pixel_scale
    content = {
        "schema_version": 1, "name": "source_extractor", "survey_table": str(ROOT / "survey_tables/demo.csv"),
        "output": str(output.resolve()), "seed": 1,
        "select": {
            "types": ["SCIE"], "obsids": obsids, "filters": ["r", "i"],
            "region": FIELD | {"radius": round(0.5 * side * scale / 60, 4)},
        },
        "window": "region",
        "observations": {"SCIE": str(ROOT / "examples/quarter_brick/science_no_cti.yaml")},
    }  # fmt: skip
    if toy:
        content |= toy_sky(output, **FIELD, count=150, radius=0.5 * side * scale / 3600)
    path = output / "campaign.yaml"
    path.write_text("# Written by benchmarks/source_extractor.py\n" + yaml.safe_dump(content, sort_keys=False))
    return path


def emptied(output: Path) -> Path:
    """Remove what an earlier run made in a folder, but not PSF sets, which tell themselves whether they are current."""
    for path in output.glob("*"):
        if path.is_dir() and path.name != "psf":
            shutil.rmtree(path)
    return output


def csstsim(command, run, job):
    """Run a csstsim command on a job; return its CPU seconds."""
    return run_csstsim(command, run.file, "--obsid", job.obsid, "--chip", job.chip.id)


def run_csstsim(*arguments):
    """Run csstsim; return its CPU seconds. Its output goes to stderr; ends with its exit code if that is not 0."""
    process = subprocess.Popen(
        [str(part) for part in (Path(sys.executable).parent / "csstsim", *arguments)], stdout=sys.stderr
    )
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        sys.exit(process.returncode)
    return used.ru_utime + used.ru_stime


def our_psf(run, job):
    """Return csstsim's PSF in the middle of the window with the pixel response, in light per px^2 on steps of 0.5 px.

    It is the mean of its sub-bands, as in `measure`; all its light is 1.
    """
    psf, window = open_psf(run, job.chip), job.window
    cells = psf.at(0.5 * (window.x0 + window.x1 - 1), 0.5 * (window.y0 + window.y1 - 1))
    return pixel_response(half_pixels(cells, psf.oversampling).mean(axis=0, dtype=np.float64), 2)


def encircled(psf, radius):
    """Return the share of the light within `radius` px, of a PSF per px^2 on steps of half a px."""
    axis = 0.5 * (np.arange(len(psf)) - len(psf) // 2)
    inside = np.clip((radius - np.hypot(axis[:, None], axis)) / 0.5 + 0.5, 0.0, 1.0)  # of each sample's cell
    return float((psf * inside).sum() / 4.0)


def compare_frame(run, job, ours, theirs):
    """Measure a job's frame with both codes and add their results.

    Returns (the error of MAGZERO by each star [mag], {what: value} of PSF models and fits).
    """
    if not run.paths.level0_truth(job).is_file():
        csstsim("chip", run, job)
    cpu = {"calibrate": csstsim("calibrate", run, job), "measure": csstsim("measure", run, job)}
    exptime, calibrated = job.pointing.exptime, run.paths.calibrated(*job.key)
    with tempfile.TemporaryDirectory() as folder:
        extracted = astromatic.extract(calibrated, Path(folder), exptime)
    psf = our_psf(run, job)
    modelled, share = (encircled(model, 0.5 * astromatic.APERTURE) for model in (extracted.psf, psf))
    print(
        f"{job.obsid} chip {job.chip.id} {job.chip.filter}: {job.window.nx} x {job.window.ny} px; psfex took "
        f"{extracted.stars} stars; light within {0.5 * astromatic.APERTURE:g} px: "
        f"{modelled:.4f} in its model, {share:.4f} in csstsim's PSF",
        flush=True,
    )
    truth = read_truth(run.paths.level0_truth(job))
    chip = run.camera.detector.channel_ny, run.camera.telescope.pixel_scale
    measured = ObjectTable.read(run.paths.measure(*job.key))
    found = extracted.table
    facts = {"light_6": share, "light_kron": encircled(psf, KRON_MIN_RADIUS), "psfex": modelled}
    facts |= {"failed": float((found["flux_psf"] == 0).mean()), "stars": extracted.stars}
    found = found.with_columns(flux_psf=found["flux_psf"] * modelled / share)
    frames = MeasuredFrame(truth, measured, *chip), MeasuredFrame(truth, ObjectTable(dict(found), measured.meta), *chip)
    judged = truth_inside(frames[0])
    ours.add(judged, frames[0], astromatic.fwhm(psf, 0.5), cpu)
    theirs.add(judged, frames[1], astromatic.fwhm(extracted.psf, 0.5), extracted.cpu)
    star = judged["obj_type"] == STAR
    given = fits.getval(calibrated, "MAGZERO", "SCI") - 2.5 * np.log10(judged["electrons"][star] / exptime)
    return given - judged[f"mag_{frames[0].band}"][star], facts


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--campaign", type=Path, help="A campaign's file [default: one of the demo's field].")
    parser.add_argument(
        "--output", type=Path, default=ROOT / "results" / "source_extractor", help="... and its folder."
    )
    parser.add_argument("--side", type=int, default=4000, help="... side of its windows, px.")
    with Record(parser) as record:
        if absent := astromatic.missing():
            record.skip(", ".join(absent), "not installed; apt-get install source-extractor psfex")
        else:
            compare(record)


def compare(record: Record) -> None:
    """Measure the frames with both codes, and record how they compare."""
    given = record.options
    try:
        if record.toy:
            file = default_campaign(emptied(record.results / "source_extractor"), 800, OBSIDS[:2], toy=True)
        else:
            file = given.campaign or default_campaign(emptied(given.output), given.side)
        run = OpenCampaign(file)
        jobs = [job for job in run.jobs if job.chip.kind == "imaging" and job.pointing.type == "SCIE"]
        if not jobs:
            raise InputError("no science frame of an imaging chip", file=run.file, key="select")
        bands, facts = {}, {}
        for job in jobs:
            ours, theirs, header = bands.setdefault(job.chip.filter, (Code(), Code(), []))
            errors, fact = compare_frame(run, job, ours, theirs)
            header.extend(errors)
            facts.setdefault(job.chip.filter, []).append(fact)
    except CsstsimError as error:
        print(error, file=sys.stderr)
        sys.exit(2)
    draw(record.figure("source_extractor.png"), bands)
    for band, codes in bands.items():
        report(band, *codes, record)
        for key, what in FACTS.items():
            values = sorted({f"{fact[key]:.4g}" for fact in facts[band]})
            record.value(f"{band}_{key}", " to ".join((values[0], *values[1:][-1:])), f"{band}: {what}")


if __name__ == "__main__":
    main()
