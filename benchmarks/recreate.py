"""A whole chip rendered again from its header and its `.cat` (docs/recreate.md): both frames, three ways.

    python benchmarks/recreate.py                    # chip 9 of the demo's first r exposure: two CPU-minutes, 3 GB
    python benchmarks/recreate.py --window 2000      # the middle of it: half a minute

The frame is recreated as it is; as another exposure, so that only the camera is shared and no noise; and from a
header as the mission's files have it, without csstsim's own keywords. Exit code 1 if places, light, background or noise
differ by more than csstsim.studies.recreate.side_by_side allows.
"""

import argparse
from pathlib import Path

from evidence.record import Record

import yaml
from astropy.io import fits
from toy_sky import toy_sky

from csstsim.base.shipped import ROOT
from csstsim.campaign.opened import OpenCampaign
from csstsim.stages.chip import chip
from csstsim.studies.recreate.objects import read_objects
from csstsim.studies.recreate.recreate import recreate
from csstsim.studies.recreate.side_by_side import DIFFERS, LEVELS, compare_frames

OBSID, CHIP, SEED = "10100000004", 9, 5
OTHER = "10100000999"
# What readers of public files of the mission's Cycles 5 to 9 use (docs/recreate.md)
KEPT = {
    "OBJECT", "OBSID", "FILENAME", "FILETYPE", "INSTRUME", "DETECTOR", "FILTER", "DATE-OBS", "EXPSTART", "EXPTIME",
    "RA_OBJ", "DEC_OBJ", "RA_PNT0", "DEC_PNT0", "POS_ANG0", "CHIPLAB", "BUNIT",
    *(f"{kind}0_{axis}" for kind in ("POSI", "VELO") for axis in "XYZ"),
    *(f"{key}{n:02d}" for key in ("GAIN", "RON") for n in range(1, 17)),
    "CTYPE1", "CTYPE2", "CRPIX1", "CRPIX2", "CRVAL1", "CRVAL2", "CD1_1", "CD1_2", "CD2_1", "CD2_2",
}  # fmt: skip
WAYS = {
    "same": "as it is", "other": "as another exposure: no noise in common",
    "plain": "from the mission's keywords alone, with the seed",
}  # fmt: skip
# columns of the table: {what of a side_by_side.Line: heading}
SHOWN = {what: what.partition(" [")[0] for what in (*LEVELS, "flux of points [e-]", "flux of galaxies [e-]")}
SHOWN["positions, median [px]"] = "positions, median"
STRUCTURE = {"BSCALE", "BZERO", "EXTNAME"}


def as_the_missions(frame, path):
    """Write a frame with the keywords that the mission's files have, and no others."""
    with fits.open(frame) as file:
        for hdu in file:
            for name in set(hdu.header) - KEPT - STRUCTURE:
                if not name.startswith(("NAXIS", "BITPIX", "SIMPLE", "EXTEND", "XTENSION", "PCOUNT", "GCOUNT")):
                    hdu.header.remove(name, ignore_missing=True, remove_all=True)
        file.writeto(path, overwrite=True)
    return path


def drawn(folder):
    """Make the chip of a campaign's folder; return its Level-0 file."""
    text = (folder / "campaign.yaml").read_text()
    if "share:" not in text:  # the PSF set is the same
        (folder / "campaign.yaml").write_text(f"{text}\nshare: ../share\n")
    run = OpenCampaign(folder / "campaign.yaml")
    (job,) = run.jobs
    chip(run, job, log=lambda text: None)
    return run.paths.level0(job)


def first(folder, window, toy=False):
    """Write the campaign of the frame that is recreated; return its folder."""
    folder.mkdir(parents=True, exist_ok=True)
    data = {
        "schema_version": 1, "name": "first", "survey_table": str(ROOT / "survey_tables/demo.csv"), "output": "results",
        "seed": SEED, "select": {"obsids": [OBSID], "chips": [CHIP]}, "truth": ["parquet", "cat"],
    }  # fmt: skip
    if window:
        x0, y0 = (9216 - window) // 2, (9232 - window) // 2
        data["window"] = {"x0": x0, "x1": x0 + window, "y0": y0, "y1": y0 + window}
    if toy:
        data["catalog"] = toy_sky(folder, 60.112, -40.035)["catalog"]  # a campaign that is recreated has the full PSF
    (folder / "campaign.yaml").write_text(yaml.safe_dump(data))
    return folder


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("results/recreate"))
    parser.add_argument("--window", type=int, help="pixels along a side of the middle of the chip")
    with Record(parser) as record:
        redraw(record)


def redraw(record: Record) -> None:
    """Make the frames, and record the comparisons."""
    options = record.options
    if record.toy:
        options.output, options.window = record.results / "recreate", 400
    frame = drawn(first(options.output / "first", options.window, record.toy))
    truth, differs, rows = frame.with_suffix(".cat"), 0, []
    record.value("objects", len(read_objects(truth)["x"]), "objects of the frame's catalogue")
    plain = as_the_missions(frame, options.output / frame.name)
    for name, shown in zip(WAYS, (frame, frame, plain), strict=True):
        folder = options.output / name
        if name == "plain" and options.window:
            continue  # the mission's frames are whole chips
        if not (folder / "campaign.yaml").exists():
            recreate(shown, truth, folder, print, seed=SEED)
        if name == "other":
            for file in (folder / "campaign.yaml", folder / "survey_table.csv"):
                file.write_text(file.read_text().replace(OBSID, OTHER))
        print(name)
        lines = compare_frames(frame, drawn(folder), truth)
        for line in lines:
            print(f"{line.what:<24} {line.words}  {line.difference:+.4f} +- {line.error:.4f}  {line.verdict}")
        differs += sum(line.verdict == DIFFERS for line in lines)
        cells = {
            line.what: f"{line.difference:+.4f} px" if "[px]" in line.what else f"{line.difference:+.2%}"
            for line in lines
        }
        rows.append([WAYS[name], *(cells.get(what, "") for what in SHOWN)])
    record.table("frames", ["frame rendered again", *SHOWN.values()], rows)
    record.value("differing", int(differs), "comparisons that differ by more than is allowed", below=0)


if __name__ == "__main__":
    main()
