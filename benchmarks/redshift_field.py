"""Fields seen through GV and GI at two position angles: the frames and spectra from which redshifts are measured.

    python benchmarks/redshift_field.py

The middle of a GV and of a GI chip looks at one place, at position angles 0 and 190 deg: the neighbours of a galaxy
along its spectrum are others. An exposure of 300 s stands for two of 150 s of the survey, whose full depth is four.
Galaxies to i = 23 are extracted twice: with neighbours known from the magnitudes of a catalogue and subtracted, and,
at the first places, with all light kept, the true contamination stated and no lines measured. Charge transfer, cosmic
rays and defects are off. A run that was stopped goes on where it was, in results/redshift_field.
"""

import argparse
import json
import shutil
import time
from pathlib import Path

from evidence import ROOT
from evidence.record import Record

import numpy as np
import yaml
from toy_sky import toy_sky

from csstsim.campaign.aiming import next_obsid, next_start, survey_table_text
from csstsim.campaign.opened import OpenCampaign
from csstsim.campaign.sections import ContaminationConfig
from csstsim.catalog.table import GALAXY
from csstsim.instrument.camera import load_camera
from csstsim.measure.spectra.chosen_orders import Choice
from csstsim.measure.spectra.extract import extract_spectra
from csstsim.measure.spectra.line_fluxes import LineFluxes
from csstsim.optics.geometry.pointing_for import aim_point, centred_exposure
from csstsim.stages import chip as chip_stage
from csstsim.stages import extract as extract_stage

PLACES = (60.15, -40.0), (60.95, -40.0), (61.75, -40.0), (60.15, -41.0), (60.95, -41.0), (61.75, -41.0), (60.55, -42.0)
KEPT = 2  # places whose spectra are also extracted with all light kept
ANGLES = 0.0, 190.0  # deg
CHIPS = {"GV": 2, "GI": 1}
EXPTIME, TIME = 300.0, "2027-11-20T01:20:00"
LIMIT = 24.5  # mag: fainter light is not drawn; a whole sky's is below a tenth of a pixel's noise
BAND, FAINTEST = "mag_i", 23.0  # of the galaxies
OFF = {"CTE_effect", "cosmic_rays", "detector_defects"}
WINDOW, TOY_WINDOW = (0, 9216, 0, 9232), (3100, 6100, 4500, 4700)
TOY_COUNT, TOY_RADIUS = 24, 0.006  # objects, deg
WAYS = {"catalogue": ContaminationConfig(known_from="catalogue"), "kept": ContaminationConfig(subtract=False)}


def fields(folder: Path, toy: bool) -> list[Path]:
    """Return the folders of the places; at toy size of one."""
    return [folder / str(k) for k in range(1, (1 if toy else len(PLACES)) + 1)]


def opened(folder: Path, toy: bool) -> OpenCampaign:
    """Write the campaign of a place, which the folder's name numbers; return it opened."""
    folder.mkdir(parents=True, exist_ok=True)
    camera, found, obsid, start = load_camera(), {}, "10100000001", TIME
    window, place = TOY_WINDOW if toy else WINDOW, PLACES[int(folder.name) - 1]
    for angle in ANGLES:
        for number in CHIPS.values():
            chip = camera.chips[number]
            x, y = aim_point(camera, chip).target
            middle = (window[0] + window[1] - 1) / 2 - x, (window[2] + window[3] - 1) / 2 - y
            pointing = centred_exposure(camera, chip, *place, pa=angle, time=start, exptime=EXPTIME, shift=middle)
            found[obsid] = pointing
            obsid, start = next_obsid(obsid), next_start(pointing)
    (folder / "survey_table.csv").write_text(survey_table_text(found))
    layers = yaml.safe_load((ROOT / "config/observations/science.yaml").read_text())
    layers["layers"] = [layer for layer in layers["layers"] if not OFF & set(layer)]
    (folder / "science.yaml").write_text(yaml.safe_dump(layers, sort_keys=False))
    content = {
        "schema_version": 1, "name": "redshift_field", "survey_table": "survey_table.csv", "output": "out", "seed": 31,
        "select": {"types": ["SCIE"], "chips": list(CHIPS.values())}, "psf": {"grid": 2 if toy else 4},
        "observations": {"SCIE": "science.yaml"}, "measurement": {"cti_passes": 0},
        "window": dict(zip(("x0", "x1", "y0", "y1"), window, strict=True)),
        "catalog": {"mag_limit": LIMIT, "lensing": {"field": "none"}, "structure": "none"},
    }  # fmt: skip
    if toy:
        content |= toy_sky(folder, *place, TOY_COUNT, TOY_RADIUS)
    (folder / "campaign.yaml").write_text(yaml.safe_dump(content))
    return OpenCampaign(folder / "campaign.yaml")


def jobs_of(run):
    """Return the four jobs: each exposure with the chip that it is aimed with."""
    chips = list(CHIPS.values()) * len(ANGLES)
    obsids = sorted({job.obsid for job in run.jobs})
    return [run.job(obsid, chip) for obsid, chip in zip(obsids, chips, strict=True)]


def emptied(folder: Path, record: Record) -> None:
    """Remove what another version of code and data made, and what a run at toy size did."""
    stamp, mine = folder / "depends.json", json.dumps(record.depends, indent=1)
    if folder.exists() and (record.toy or not stamp.exists() or stamp.read_text() != mine):
        shutil.rmtree(folder)
    folder.mkdir(parents=True, exist_ok=True)
    stamp.write_text(mine)


def made(folder: Path, toy: bool) -> OpenCampaign:
    """Draw the frames of a place and extract their spectra, but for what exists; return its campaign."""
    run = opened(folder, toy)
    kept = int(folder.name) <= KEPT
    for job in jobs_of(run):
        if not run.paths.level0(job).exists():
            begin = time.process_time()
            chip_stage.chip(run, job, log=lambda text: None)
            _spent(folder, job, "frame", time.process_time() - begin)
        for way in WAYS if kept else ["catalogue"]:
            _extract(run, job, folder, way, "mag_r" if toy else BAND)
    return run


def _extract(run: OpenCampaign, job, folder: Path, way: str, band: str) -> None:
    """Extract the galaxies of a frame in one of WAYS."""
    path = folder / way / run.paths.spectra(*job.key).name
    if path.exists():
        return
    begin, contamination = time.process_time(), WAYS[way]
    truth, frame, orders, *others = extract_stage.spectra_of_frame(run, job, contamination)
    ids = truth["id"][(truth["obj_type"] == GALAXY) & (truth[band] <= FAINTEST)]
    lines = LineFluxes(np.where(truth["obj_type"] == GALAXY, truth["z"], np.nan))
    measured = lines if contamination.subtract else None
    table = extract_spectra(frame, orders, *others, Choice(snr_min=0.0, ids=ids), measured)
    path.parent.mkdir(exist_ok=True)
    recipe = {"recipe": run.recipe(job, "measure")}
    lines.table().write(path.with_name(f"{path.stem}_lines.parquet"), recipe)
    table.write(path, table.meta | recipe)
    _spent(folder, job, way, time.process_time() - begin, table.meta["spectra"])


def _spent(folder: Path, job, what: str, seconds: float, spectra: int = 0) -> None:
    """Keep the CPU seconds of a part of the work."""
    file, key = folder / "spent.json", f"{job.obsid} {job.chip.filter} {what}"
    known = json.loads(file.read_text()) if file.exists() else {}
    file.write_text(json.dumps(known | {key: [seconds, spectra]}, indent=1))
    print(f"{folder.name}: {key}: {seconds:.1f} CPU-s", flush=True)


def spent(folders: list[Path], what: str) -> tuple[float, float]:
    """Return (CPU seconds, spectra) of the frames or of the extraction in one of WAYS, the mean of a place."""
    parts = [
        used for folder in folders for key, used in json.loads((folder / "spent.json").read_text()).items()
        if key.endswith(what)
    ]  # fmt: skip
    seconds, spectra = np.sum(parts, axis=0) / len(folders)
    return float(seconds), float(spectra)


def main() -> None:
    """Make the frames and spectra of all places; record what they cost."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    with Record(parser) as record:
        folder = record.results / "redshift_field"
        emptied(folder, record)
        folders = fields(folder, record.toy)
        for folder in folders:
            made(folder, record.toy)
        record.value("places", len(folders), "positions, each with four frames")
        record.value("frames_cpu", spent(folders, "frame")[0], "the four frames of a position", unit="CPU-s")
        seconds, spectra = spent(folders, "catalogue")
        record.value("extract_cpu", seconds, "extraction of the spectra of a position, with their lines", unit="CPU-s")
        record.value("spectra", round(spectra), "spectra in the four frames of a position")


if __name__ == "__main__":
    main()
