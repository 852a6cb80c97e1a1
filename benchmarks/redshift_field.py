"""A field seen through GV and GI at two position angles: the frames and spectra from which redshifts are measured.

    PYTHONPATH=benchmarks python benchmarks/redshift_field.py [--folder FOLDER] [--window 0 9216 3100 6100]

The middle of a GV and of a GI chip looks at one place, at position angles 0 and 190 deg: the neighbours of a galaxy
along its spectrum are others. An exposure of 300 s stands for two of 150 s of the survey, whose full depth is four.
Galaxies to i = 23 are extracted twice: with neighbours known from the magnitudes of a catalogue and subtracted, and
with all light kept, the true contamination stated and no lines measured. Charge transfer, cosmic rays and defects are
off. What exists is not made again.
"""

import argparse
import time
from pathlib import Path

import numpy as np
import yaml

from csstsim.campaign.aiming import after, next_obsid, table_of
from csstsim.campaign.opened import OpenCampaign
from csstsim.campaign.sections import ContaminationConfig
from csstsim.catalog.table import GALAXY
from csstsim.instrument.camera import load_camera
from csstsim.optics.geometry.pointing_for import centred_exposure, light_on
from csstsim.stages import chip as chip_stage
from csstsim.stages import extract as extract_stage

ROOT = Path(__file__).resolve().parents[1]
PLACE = 60.15, -40.0  # deg, ICRS
ANGLES = 0.0, 190.0  # deg
CHIPS = {"GV": 2, "GI": 1}
EXPTIME, TIME = 300.0, "2027-11-20T01:20:00"
LIMIT = 24.5  # mag: fainter light is not drawn; a whole sky's is below a tenth of a pixel's noise
FAINTEST = {"mag_i": 23.0}
OFF = {"CTE_effect", "cosmic_rays", "detector_defects"}
NOISE = {"poisson_and_dark", "brighter_fatter", "readout_noise"}
WINDOW = 0, 9216, 0, 9232
WAYS = {"catalogue": ContaminationConfig(known_from="catalogue"), "kept": ContaminationConfig(subtract=False)}


def campaign(folder, window=WINDOW, place=PLACE, noiseless=False):
    """Write the campaign; return it opened."""
    folder.mkdir(parents=True, exist_ok=True)
    camera, found, obsid, start = load_camera(), {}, "10100000001", TIME
    for angle in ANGLES:
        for number in CHIPS.values():
            chip = camera.chips[number]
            (x, y), _ = light_on(camera, chip)
            middle = (window[0] + window[1] - 1) / 2 - x, (window[2] + window[3] - 1) / 2 - y
            pointing = centred_exposure(camera, chip, *place, pa=angle, time=start, exptime=EXPTIME, shift=middle)
            found[obsid] = pointing
            obsid, start = next_obsid(obsid), after(pointing)
    (folder / "survey_table.csv").write_text(table_of(found))
    layers = yaml.safe_load((ROOT / "config/observations/science.yaml").read_text())
    layers["layers"] = [layer for layer in layers["layers"] if not (OFF | NOISE if noiseless else OFF) & set(layer)]
    (folder / "science.yaml").write_text(yaml.safe_dump(layers, sort_keys=False))
    content = {
        "schema_version": 1, "name": "redshift_field", "survey_table": "survey_table.csv", "output": "out", "seed": 31,
        "select": {"types": ["SCIE"], "chips": list(CHIPS.values())}, "psf": {"grid": 4},
        "observations": {"SCIE": "science.yaml"}, "measurement": {"cti_passes": 0},
        "window": dict(zip(("x0", "x1", "y0", "y1"), map(int, window), strict=True)),
        "catalog": {"mag_limit": LIMIT, "lensing": {"field": "none"}, "structure": "none"},
    }  # fmt: skip
    content |= {"fidelity": "noise_free"} if noiseless else {}
    (folder / "campaign.yaml").write_text(yaml.safe_dump(content))
    return OpenCampaign(folder / "campaign.yaml")


def jobs_of(run):
    """Return the four jobs: each exposure with the chip that it is aimed with."""
    chips = list(CHIPS.values()) * len(ANGLES)
    obsids = sorted({job.obsid for job in run.jobs})
    return [run.job(obsid, chip) for obsid, chip in zip(obsids, chips, strict=True)]


def spectra_file(folder, job, way):
    """Return the table of spectra of a job, extracted in one of WAYS."""
    return folder / way / f"{job.obsid}_{job.chip.id:02d}.parquet"


def extracted(run, job, folder):
    """Extract the galaxies of a frame in each of WAYS."""
    from csstsim.measure.spectra.extract import extract_spectra
    from csstsim.measure.spectra.line_fluxes import LineFluxes

    for way, contamination in WAYS.items():
        path = spectra_file(folder, job, way)
        if path.exists():
            continue
        begin = time.process_time()
        truth, frame, orders, *others = extract_stage.spectra_of_frame(run, job, contamination)
        bright = np.all([truth[name] <= faintest for name, faintest in FAINTEST.items()], axis=0)
        ids = truth["id"][(truth["obj_type"] == GALAXY) & bright]
        lines = LineFluxes(np.where(truth["obj_type"] == GALAXY, truth["z"], np.nan))
        measured = lines if contamination.subtract else None
        table = extract_spectra(frame, orders, *others, snr_min=0.0, ids=ids, lines=measured)
        path.parent.mkdir(exist_ok=True)
        recipe = {"recipe": run.recipe(job, "measure")}
        lines.table().write(path.with_name(f"{path.stem}_lines.parquet"), recipe)
        table.write(path, table.meta | recipe)
        seconds = time.process_time() - begin
        print(f"{job.obsid} {job.chip.filter} {way}: {table.meta['spectra']} spectra, {seconds:.0f} CPU-s", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--folder", type=Path, default=ROOT / "results" / "redshift_field")
    parser.add_argument("--window", type=int, nargs=4, default=WINDOW)
    parser.add_argument("--place", type=float, nargs=2, default=PLACE, help="ra, dec [deg]")
    parser.add_argument("--noiseless", action="store_true", help="expected light alone: biases without their noise")
    options = parser.parse_args()
    run = campaign(options.folder, options.window, options.place, options.noiseless)
    for job in jobs_of(run):
        if not run.paths.level0(job).exists():
            begin = time.process_time()
            chip_stage.chip(run, job, say=print)
            print(f"{job.obsid} {job.chip.filter}: drawn, {time.process_time() - begin:.0f} CPU-s", flush=True)
        extracted(run, job, options.folder)


if __name__ == "__main__":
    main()
