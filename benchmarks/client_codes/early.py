"""The survey's early public Level-1 pipeline (github.com/csster/csst, 2022) on frames of layout `chip`, names C5.2.

A user's checkout is imported; none of it is part of csstsim. Its steps are: master frames (CsstMscRefProc), instrument
correction (CsstMscInstrumentProc), position calibration (CsstProcMscPositionCalibration: source-extractor, SCAMP, its
own settings), all on one chip. Cosmic rays are found by lacosmic, its alternative to a neural network; so torch and
deepCR, which it imports all the same, need not be installed. Its check of the places needs a reference with NaN, which
SCAMP 2.10 refuses; its flux calibration reads the truth as text, and its photometry needs that: the three are not run.
"""

import contextlib
import importlib
import importlib.util
import os
import shutil
import sys
import types
from pathlib import Path

import numpy as np
import yaml
from astropy.io import fits
from astropy.table import Table

from client_codes.frames import DEC, EXPTIME, PA, RA, TIMES, run_csstsim, stars
from client_codes.scamp import clipped_rms, distance, read_head, residuals
from csstsim.base.errors import InputError
from csstsim.base.shipped import SHIPPED
from csstsim.campaign.opened import OpenCampaign

FORM, NSIDE, RADIUS = "C5.2", 32, 2.0  # of names; HEALPix of its reference catalogue; deg within which it reads that
SETS = ("BIAS", 3), ("DARK", 3), ("FLAT", 3)
SMALL = {"detector.nx": 2304, "detector.ny": 2308, "detector.channel_nx": 288, "detector.channel_ny": 1154}
NEEDS = "healpy", "joblib", "ccdproc"
LIMIT = 25.0  # mag of the faintest star in the reference


def campaign(output, chip, small):
    """Write the campaign of a science exposure and its calibration frames, names and layout as the pipeline reads them.

    small: on a chip of 2304 x 2308 px without distortion, to try the steps quickly.
    """
    output.mkdir(parents=True, exist_ok=True)
    rows = ["obsid,type,ra,dec,pa,time,exptime", f"100000100,SCIE,{RA},{DEC},{PA},{TIMES[0]},{EXPTIME:.0f}"]
    for kind, count in SETS:
        for n in range(count):
            rows.append(f"{_obsid(kind, n)},{kind},0,0,0,{TIMES[0]},{0 if kind == 'BIAS' else EXPTIME:.0f}")
    (output / "table.csv").write_text("\n".join(rows) + "\n")
    names = {"SCIE": "science", "BIAS": "bias", "DARK": "dark", "FLAT": "led_flat"}
    for name in names.values():
        steps = yaml.safe_load((SHIPPED / "observations" / f"{name}.yaml").read_text())
        steps["layers"][-1]["quantization_and_output"]["layout"] = "chip"
        if small and name == "science":
            steps["layers"][0]["scie_obs"]["field_dist"] = False
        (output / f"{name}.yaml").write_text(yaml.safe_dump(steps, sort_keys=False))
    content = {
        "schema_version": 1, "name": "early", "survey_table": "table.csv", "output": "out", "seed": 27,
        "select": {"chips": [chip]}, "observations": {kind: f"{name}.yaml" for kind, name in names.items()},
        "level0_names": FORM,
    }  # fmt: skip
    if small:
        content["instrument"] = SMALL
    (output / "campaign.yaml").write_text(yaml.safe_dump(content, sort_keys=False))
    return OpenCampaign(output / "campaign.yaml")


def _obsid(kind, number):
    return f"{ {'BIAS': 103, 'DARK': 107, 'FLAT': 100}[kind] }00020{number}"


def pipeline(folder, output, chip, small=False):
    """Run the pipeline's steps on a chip; return {what: value} as the table of docs/clients.md has them.

    folder: the user's checkout. Raises InputError if it is not one or what it needs is not installed.
    """
    code = _imported(folder)
    run = campaign(output, chip, small)
    for job in run.jobs:
        if not run.paths.level0(job).is_file():
            run_csstsim("chip", run.file, "--obsid", job.obsid, "--chip", chip)
    jobs = {kind: [job for job in run.jobs if job.pointing.type == kind] for kind in ("SCIE", "BIAS", "DARK", "FLAT")}
    [science] = jobs["SCIE"]
    run.paths.level0_catalogue(science).touch()  # these steps look for the name alone
    masters, work, gaia = (output / name for name in ("masters", "work", "gaia"))
    for place in (masters, work, gaia):
        place.mkdir(exist_ok=True)
    files = [[str(run.paths.level0(job)) for job in jobs[kind]] for kind in ("BIAS", "DARK", "FLAT")]
    with _inside(work):
        if not list(masters.glob("MSC_CLF_*")):
            maker = code.ref_combine.CsstMscRefProc()
            maker.prepare(*files)
            for name, image in zip(("CLB", "CLD", "CLF"), maker.run(), strict=True):
                fits.writeto(masters / f"MSC_{name}_0_{chip:02d}_combine.fits", image.astype(np.float32))
        manager = code.data_manager.CsstMscDataManager(
            ver_sim=FORM, dir_l0=str(run.paths.level0(science).parent), dir_l1=str(work) + os.sep,
            dir_pcref=str(gaia) + os.sep, path_aux=str(masters / "MSC_{}_*_{:02d}_combine.fits"),
        )  # fmt: skip
        manager.set_ccd_ids([chip])
        planes = _corrected(code, manager, chip)
        _reference(gaia, run, science)
        places = code.calib_pos.CsstProcMscPositionCalibration(manager, n_jobs=1)
        _other_programs(work)
        places.join_data(*([plane] for plane in planes))
        places.run_sextractor(chip)
        places.combine_catalog()
        places.get_refcat(search_radius=RADIUS)
        places.run_scamp(wcs_refine=True)
        return _judged(planes, science, run, work)


def _corrected(code, manager, chip):
    """Return the image, weight and flags of the instrument correction; what an earlier run made is read."""
    names = [manager.l1_ccd(chip, post=f"{name}.fits") for name in ("img", "wht", "flg")]
    if not all(Path(name).is_file() for name in names):
        raw = code.data.CsstMscImgData.read(manager.l0_ccd(chip))
        step = code.inst_corr.CsstMscInstrumentProc()
        step.prepare(n_jobs=1, deepcr=False)
        step.set_num_threads(1)
        bias, dark, flat = (get(chip) for get in (manager.get_bias, manager.get_dark, manager.get_flat))
        for plane, name in zip(step.run(raw, bias, dark, flat, FORM), names, strict=True):
            plane.writeto(name, overwrite=True)
    return [code.data.CsstMscImgData.read(name) for name in names]


def _imported(folder):
    """Return the checkout's modules as attributes. Raises InputError."""
    folder = Path(folder).resolve()
    if not (folder / "csst" / "msc" / "inst_corr.py").is_file():
        raise InputError("not a checkout of github.com/csster/csst", file=folder, key="--early")
    if absent := [name for name in NEEDS if importlib.util.find_spec(name) is None]:
        raise InputError(f"needs {', '.join(absent)}: pip install {' '.join(absent)}", file=folder, key="--early")
    if importlib.util.find_spec("torch") is None:  # of the neural network, which is not used
        for name, attribute in (("torch", "set_num_threads"), ("deepCR", "deepCR")):
            sys.modules[name] = types.ModuleType(name)
            setattr(sys.modules[name], attribute, lambda *_, **__: None)
    sys.path.insert(0, str(folder))
    names = "ref_combine", "data_manager", "data", "inst_corr", "calib_pos"
    return types.SimpleNamespace(**{name: importlib.import_module(f"csst.msc.{name}") for name in names})


@contextlib.contextmanager
def _inside(folder):
    """Work in a folder, as the pipeline does; what it prints goes to its file `said`."""
    before = Path.cwd()
    with (folder / "said").open("w") as said, contextlib.redirect_stdout(said):
        os.chdir(folder)
        try:
            yield
        finally:
            os.chdir(before)


def _other_programs(folder):
    """Let `sex`, the name that the pipeline calls, be Debian's source-extractor, if it is not there."""
    if shutil.which("sex") is None:
        (folder / "bin").mkdir(exist_ok=True)
        (folder / "bin" / "sex").unlink(missing_ok=True)
        (folder / "bin" / "sex").symlink_to(shutil.which("source-extractor"))
        os.environ["PATH"] = f"{folder / 'bin'}{os.pathsep}{os.environ['PATH']}"


def _reference(folder, run, job):
    """Write the mock's stars as the pipeline has Gaia: a file a HEALPix pixel of NSIDE 32, J2000, mas and mas/yr."""
    import healpy

    from csstsim.catalog.table import STAR
    from csstsim.io.truth import read_truth

    truth = read_truth(run.paths.level0_truth(job))
    kept = (truth["obj_type"] == STAR) & (truth["mag"] < LIMIT)
    ra, dec = (truth[name][kept] for name in ("ra_orig", "dec_orig"))
    n = int(kept.sum())
    table = Table({
        "ra": ra, "dec": dec, "ra_error": np.full(n, 0.1), "dec_error": np.full(n, 0.1),
        "phot_g_mean_mag": truth["mag"][kept].astype(float), "pmra": truth["pmra"][kept].astype(float),
        "pmra_error": np.full(n, 0.1), "pmdec": truth["pmdec"][kept].astype(float), "pmdec_error": np.full(n, 0.1),
    })  # fmt: skip
    where = healpy.ang2pix(NSIDE, ra, dec, lonlat=True)
    for pixel in healpy.query_disc(NSIDE, healpy.ang2vec(RA, DEC, lonlat=True), np.radians(RADIUS)):
        table[where == pixel].write(folder / f"healpix-{pixel:05d}.fits", overwrite=True)


def _judged(planes, job, run, work):
    """Return {what: value} of the corrected image and of the places by SCAMP's header."""
    image, flags = planes[0][1].data, planes[2][1].data
    true = stars(run, [types.SimpleNamespace(job=job)])
    wcs = read_head(work / "combined_acat.head")
    table = fits.getdata(work / "combined_acat.fits", 2)
    good = (table["FLAGS"] == 0) & (table["SNR_WIN"] > 20) & (table["SNR_WIN"] < 200)
    east, north, _, _ = residuals(wcs, table[good], true)
    off = distance(wcs, job)
    return {
        "file": run.paths.level0(job).name, "image": f"{image.shape}, {image.dtype}, {planes[0][1].header['BUNIT']}",
        "sky [e-/s]": f"{np.median(image):.4f}", "flagged": f"{100 * (flags > 0).mean():.2f}%",
        "sources for SCAMP": len(table), "stars of S/N 20 to 200": len(east),
        "places, east and north [mas]": f"{clipped_rms(east):.2f}, {clipped_rms(north):.2f}",
        "fit less true WCS [px], rms, largest": f"{np.sqrt(np.mean(off**2)):.4f}, {off.max():.4f}",
    }  # fmt: skip
