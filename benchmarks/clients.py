"""Other teams' programs on the mock's frames: their input, their results, and the results against the truth.

    apt-get install source-extractor psfex scamp swarp
    pip install ccdproc                                # for the sections; --early needs healpy and joblib, too
    python benchmarks/clients.py --chips 9             # one r chip, four dithered exposures: six CPU-minutes
    python benchmarks/clients.py --chips imaging --coadd 9   # the whole pointing, 18 chips: an hour of CPU time
    python benchmarks/clients.py --only early --early CSST [--small]

scamp     the frames' distortion, against a reference catalogue of the mock's stars (client_codes/scamp.py)
swarp     the coadd of the middle of a chip, with SCAMP's solution: depth and PSF, by psfex (client_codes/coadd.py)
ccdproc   sections, overscan and trimming of each channel (client_codes/ccd.py)
early     the survey's early public pipeline on a frame of layout `chip`; FOLDER is a checkout of github.com/csster/csst
          (client_codes/early.py)

A part whose program is not installed is left out, with a line that says so. What is made is kept in --output, and an
interrupted run goes on. Exit code 1 if a residual, a distortion, a depth or a PSF exceeds its limit; 2 for bad input.
"""

import argparse
import importlib.util
import shutil
import sys
from pathlib import Path

from evidence.record import Record

import numpy as np
from client_codes import ccd, coadd, early, scamp
from client_codes.figure import draw
from client_codes.frames import frames_of, pointing, run_csstsim, stars
from source_extractor import emptied

from csstsim.base.errors import CsstsimError
from csstsim.campaign.opened import OpenCampaign

ROOT = Path(__file__).parents[1]
PARTS = "scamp", "swarp", "ccdproc", "early"
PLACE_MAX, DISTORTION_MAX = 2.0, 0.05  # mas rms by axis of stars' mean places, S/N 20 to 200; px
DEPTH_MAX, WIDTH_MAX, LIGHT_MAX = 0.05, 0.03, 0.01  # relative; relative; share of the light
FEWEST = 30  # stars of a chip whose scatter is judged
EARLY = "the early pipeline", "what came out"
SNRS = (20, 30), (100, 200)  # of the stars whose scatter in one exposure is shown


def absent(part, given):
    """Return why a part cannot run, or None."""
    programs = {"scamp": ("source-extractor", "scamp"), "swarp": ("source-extractor", "scamp", "SWarp", "psfex")}
    missing = [name for name in programs.get(part, ()) if shutil.which(name) is None]
    if part == "ccdproc" and importlib.util.find_spec("ccdproc") is None:
        missing = ["ccdproc"]
    if part == "early" and given.early is None:
        return "--early names no checkout of github.com/csster/csst"
    return f"not installed: {', '.join(missing)}" if missing else None


def astrometry(run, given, swarp, record):
    """Run SCAMP on all frames and record its residuals by chip; return (frames, stars, judgements by chip, passed).

    swarp: whether images are needed afterwards.
    """
    frames = frames_of(run, given.output / "frames", (coadd_of(run, given),) if swarp else (), given.keep)
    true = stars(run, frames)
    said = scamp.run_scamp(frames, true)
    for name, what in (("internal", "exposures about their mean"), ("external", "that mean about the reference")):
        every, _, number = scamp.reported(said)[name]
        record.value(f"scamp_{name}", every, f"SCAMP's own rms by axis of {number} positions, {what}", unit="mas")
    passed, judged, rows, worst = True, {}, [], []
    for chip in sorted({frame.job.chip.id for frame in frames}):
        of_chip = [frame for frame in frames if frame.job.chip.id == chip]
        found = [scamp.judge(frame, true) for frame in of_chip]
        judged[chip] = found
        east, north = (np.concatenate([each[name] for each in found]) for name in ("dx", "dy"))
        single = [scamp.clipped_rms(v) for v in (east, north)]
        *means, number = scamp.mean_places(found)
        rms = [scamp.clipped_rms(v) for v in means]
        off = np.array([each["off"] for each in found])
        good = max(rms) < PLACE_MAX and off.max() < DISTORTION_MAX and number >= FEWEST
        passed &= good
        snr = np.concatenate([each["snr"] for each in found])
        by_snr = []
        for low, high in SNRS:
            some = (snr > low) & (snr < high)
            both = scamp.clipped_rms(np.concatenate([east[some], north[some]])) if some.any() else np.nan
            by_snr.append(f"{both:.2f}")
        cells = f"{single[0]:.2f}, {single[1]:.2f}", *by_snr, number, f"{rms[0]:.2f}, {rms[1]:.2f}"
        fit = f"{np.sqrt(np.mean(off**2)):.3f}, {off.max():.3f}"
        rows.append([f"{chip} ({of_chip[0].job.chip.filter})", len(east), *cells, fit])
        worst.append((max(rms), off.max()))
    by_snr = [f"S/N {low} to {high}" for low, high in SNRS]
    last = "stars", "mean of all", "fit less true WCS [px], rms, largest"
    record.table("scamp", ["chip", "positions", "one exposure, east and north [mas]", *by_snr, *last], rows)
    place, fit = np.max(worst, axis=0)
    what = f"SCAMP's mean positions of stars less true ones, rms, worst of {len(rows)} chips"
    record.value("scamp_worst", place, what, unit="mas", below=PLACE_MAX)
    record.value("wcs_worst", fit, "SCAMP's WCS less the true one, largest", unit="px", below=DISTORTION_MAX)
    return frames, true, judged, passed


def coadd_of(run, given):
    """Return the number of the chip that is co-added."""
    return given.coadd or run.jobs[0].chip.id


def coadded(run, chip, frames, true, record):
    """Run SWarp and psfex on a chip and record depth and PSF; return (results by chip, passed)."""
    of_chip = [frame for frame in frames if frame.job.chip.id == chip]
    image, weight = coadd.coadd(of_chip)
    measured, expected, count = coadd.depth(image, of_chip, run, np.random.default_rng(chip))
    shapes, number = coadd.psfs(image, weight, of_chip, run, true)
    theory, found = (np.array(shapes[f"the coadd, {name}"]) for name in ("theory", "psfex"))
    good = abs(measured / expected - 1) < DEPTH_MAX and abs(found[0] / theory[0] - 1) < WIDTH_MAX
    good &= bool((abs(found[1:] - theory[1:]) < LIGHT_MAX).all())
    what = f"SWarp, chip {chip}: rms of {count} empty apertures of {coadd.APERTURE:g} px over theory"
    error = 1.17 / (2 * count) ** 0.5  # of a median absolute deviation
    record.value("coadd_noise", measured / expected, what, error=error)
    for name, psf in (("psfex", found), ("theory", theory)):
        record.value(f"coadd_fwhm_{name}", psf[0], f"FWHM of the coadd's PSF by {name}", unit="px")
    what = "flux within 2, 3, 5 px of the coadd's PSF, psfex less theory, largest"
    record.value("coadd_light", abs(found[1:] - theory[1:]).max(), what, below=LIGHT_MAX)
    rows = [[n, f"{w:.3f}", ", ".join(f"{part:.4f}" for part in light)] for n, (w, *light) in shapes.items()]
    record.table("coadd_psf", [f"PSF ({number} stars)", "FWHM [px]", "flux within 2, 3, 5 px of that within 6"], rows)
    return {chip: {"noise": (measured, expected), "psf": shapes}}, good


def sections(run: OpenCampaign, record: Record) -> None:
    """Reduce a Level-0 file with ccdproc, and record how it agrees."""
    job = run.jobs[0]
    if not run.paths.level0(job).is_file():
        run_csstsim("chip", run.file, "--obsid", job.obsid, "--chip", job.chip.id)
    found = ccd.channels(run.paths.level0(job))
    what = "channels trimmed by ccdproc by their sections: their pixels are those of our reader"
    record.value("channels", found["channels"], what, goal=found["trimmed"])
    record.value("overscan", found["bias"], "overscan by BIASSEC less DETBIA, largest", unit="DN", below=1)


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--chips", default="9", help="numbers, separated by commas, or `imaging` [default: 9]")
    parser.add_argument("--coadd", type=int, help="the chip that SWarp co-adds [default: the first]")
    parser.add_argument("--only", choices=PARTS, nargs="+", default=PARTS, help="these parts only")
    parser.add_argument("--early", metavar="FOLDER", help="a checkout of github.com/csster/csst")
    parser.add_argument("--small", action="store_true", help="early: on a chip a quarter as wide, to try its steps")
    parser.add_argument("--keep", action="store_true", help="keep Level-0 and calibrated images, 1 GB a chip")
    parser.add_argument("--output", type=Path, default=ROOT / "results" / "clients")
    with Record(parser) as record:
        clients(record)


def clients(record: Record) -> None:
    """Run the programs, and record what came out."""
    given = record.options
    if record.toy:
        given.output, given.small = record.results / ("clients_early" if given.only == ["early"] else "clients"), True
        shutil.rmtree(given.output / "frames", ignore_errors=True)
        emptied(given.output / "out")
    chips = given.chips if given.chips == "imaging" else [int(number) for number in given.chips.split(",")]
    wanted = []
    for part in given.only:
        if why := absent(part, given):
            if part != "early" or given.only == [part]:  # the early pipeline is a command of its own
                record.skip(part, why)
                if part == "early" and record.toy:
                    record.table("early", EARLY, [])
        else:
            wanted.append(part)
    passed = True
    try:
        run = pointing(given.output, chips, toy=record.toy)
        if "ccdproc" in wanted:
            sections(run, record)
        if {"scamp", "swarp"} & set(wanted):
            frames, true, judged, good = astrometry(run, given, "swarp" in wanted, record)
            results, deep = (
                coadded(run, coadd_of(run, given), frames, true, record) if "swarp" in wanted else ({}, True)
            )
            passed &= good and deep
            draw(record.figure("clients.png"), judged, results)
        if "early" in wanted:
            chip = chips[0] if isinstance(chips, list) else 9
            found = early.pipeline(given.early, given.output / "early", chip, given.small)
            record.table("early", EARLY, list(found.items()))
    except CsstsimError as error:
        print(error, file=sys.stderr)
        sys.exit(2)
    record.value("passed", int(passed), "all residuals, depths and PSFs are within their limits (1: all)", above=1)


if __name__ == "__main__":
    main()
