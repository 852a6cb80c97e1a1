"""The frames of one pointing: four exposures a few arc seconds apart, made, calibrated, and given to other programs.

The images that other programs get have the linear WCS of Level-0 (apparent directions, no distortion), so that they
must find the distortion themselves.
"""

import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import astromatic
import numpy as np
import yaml
from astropy.io import fits
from toy_sky import toy_sky

from csstsim.campaign.opened import OpenCampaign
from csstsim.catalog.table import STAR
from csstsim.io.truth import read_truth

RA, DEC, PA, EXPTIME = 300.0, -60.0, -113.4333, 150.0  # in field W5, where stars are many
DITHERS = (0.0, 0.0), (12.3, 4.1), (-5.2, -11.6), (7.9, -9.4)  # arcsec, east and north
TIMES = "2027-07-21T01:00:00", "2027-07-21T01:04:00", "2027-07-21T02:32:00", "2027-07-21T02:36:00"
EPOCH = 2027.55  # Julian year of the exposures, to a day
_LINEAR = ("CTYPE1", "CTYPE2", "CUNIT1", "CUNIT2", "CRVAL1", "CRVAL2", "CRPIX1", "CRPIX2", "CD1_1", "CD1_2", "CD2_1",
           "CD2_2")  # fmt: skip


@dataclass(frozen=True)
class Frame:
    """One chip of one exposure as other programs get it: {stem}.fits, {stem}.rms.fits, {stem}.flag.fits."""

    job: object  # campaign.job.Job
    stem: Path

    @property
    def image(self):
        """The image [e-/s], background subtracted."""
        return self.stem.with_suffix(".fits")

    @property
    def planes(self):
        """The image, the noise of its background, and its flags."""
        return self.image, self.stem.with_suffix(".rms.fits"), self.stem.with_suffix(".flag.fits")

    @property
    def catalogue(self):
        """The sources that source-extractor found in it, FITS_LDAC."""
        return self.stem.with_suffix(".cat")

    @property
    def head(self):
        """The world coordinates that SCAMP fits."""
        return self.stem.with_suffix(".head")


def pointing(output, chips, toy=False):
    """Write the campaign of four exposures of `chips` to a folder and return it opened; toy: small windows of two."""
    output.mkdir(parents=True, exist_ok=True)
    rows = ["obsid,type,ra,dec,pa,time,exptime"]
    for number, ((east, north), time) in enumerate(zip(DITHERS, TIMES, strict=True), start=1):
        ra, dec = RA + east / 3600 / np.cos(np.radians(DEC)), DEC + north / 3600
        rows.append(f"1010590000{number},SCIE,{ra:.6f},{dec:.6f},{PA},{time},{EXPTIME:.0f}")
    (output / "pointing.csv").write_text("\n".join(rows) + "\n")
    content = {
        "schema_version": 1, "name": "clients", "survey_table": "pointing.csv", "output": "out", "seed": 27,
        "select": {"types": ["SCIE"], "chips": chips},
    }  # fmt: skip
    file = output / "campaign.yaml"
    if toy:
        content["window"] = {"x0": 3000, "x1": 4500, "y0": 3000, "y1": 4500}
        content["select"]["obsids"] = ["10105900001", "10105900002"]
    file.write_text(yaml.safe_dump(content, sort_keys=False))
    run = OpenCampaign(file)
    if toy:
        ra, dec = (float(corner.mean()) for corner in run.jobs[0].footprint())
        sky = toy_sky(output, ra, dec, count=800, radius=0.018)
        file.write_text(yaml.safe_dump(content | sky, sort_keys=False))
        run = OpenCampaign(file)
    return run


def run_csstsim(*arguments):
    """Run a csstsim command; its output goes to stderr. Ends with its exit code if that is not 0."""
    command = [str(part) for part in (Path(sys.executable).parent / "csstsim", *arguments)]
    if code := subprocess.run(command, stdout=sys.stderr, check=False).returncode:
        sys.exit(code)


def frames_of(run, folder, images, keep=False):
    """Return the Frames of all jobs of a campaign, files in `folder`; what is missing is made.

    Of each, the catalogue stays. images: the chips whose images stay, too (0.8 GB a frame). keep: the Level-0 files and
    calibrated images stay (1 GB a frame).
    """
    folder.mkdir(parents=True, exist_ok=True)
    frames = []
    for job in sorted(run.jobs, key=lambda job: (job.chip.id, job.obsid)):
        frame = Frame(job, folder / f"{job.obsid}_{job.chip.id:02d}")
        needed = job.chip.id in images
        if not frame.catalogue.is_file() or (needed and not frame.image.is_file()):
            calibrated = run.paths.calibrated(*job.key)
            if not calibrated.is_file():
                if not run.paths.level0(job).is_file():
                    run_csstsim("chip", run.file, "--obsid", job.obsid, "--chip", job.chip.id)
                run_csstsim("calibrate", run.file, "--obsid", job.obsid, "--chip", job.chip.id)
            _write(frame, calibrated)
            _extract(frame)
            gone = () if keep else (calibrated, run.paths.level0(job))
            for path in gone if needed else (*gone, *frame.planes):
                path.unlink(missing_ok=True)
        frames.append(frame)
    return frames


def stars(run, frames):
    """Return the mock's stars seen in the frames as {name: array}: id, ra, dec [deg], mag, electrons, snr.

    ra, dec: ICRS at the epoch, with proper motion and parallax, which hardly change between the exposures.
    """
    names = "obj_id", "ra", "dec", "mag", "electrons", "snr"
    parts = {name: [] for name in names}
    for frame in frames:
        truth = read_truth(run.paths.level0_truth(frame.job))
        kept = truth["obj_type"] == STAR
        columns = truth["id"], truth["ra_epoch"], truth["dec_epoch"], truth["mag"], truth["electrons"], truth["snr"]
        for name, column in zip(names, columns, strict=True):
            parts[name].append(np.asarray(column)[kept])
    found = {name: np.concatenate(values) for name, values in parts.items()}
    _, first = np.unique(found["obj_id"], return_index=True)
    return {name: values[first] for name, values in found.items()}


def _write(frame, calibrated):
    job, wcs = frame.job, frame.job.wcs.header()
    image, rms, quality, old = astromatic.planes(calibrated, EXPTIME)
    header = fits.Header()
    for name in _LINEAR:
        if name in wcs:
            header[name] = wcs[name]
    header["CRPIX1"], header["CRPIX2"] = (
        header[f"CRPIX{i}"] - old[f"READ{axis}0"] + 1 for i, axis in ((1, "X"), (2, "Y"))
    )
    header["RADESYS"] = "ICRS"
    header["FILTER"], header["EXPTIME"], header["CHIP"] = job.chip.filter, EXPTIME, job.chip.id
    header["GAIN"], header["MJD-OBS"] = EXPTIME, job.pointing.mjd
    header["DATE-OBS"], header["OBJECT"], header["INSTRUME"] = job.pointing.time, "W5", f"MSC{job.chip.id:02d}"
    for path, plane in zip(frame.planes, (image, rms, quality), strict=True):
        fits.writeto(path, plane, header, overwrite=True)


_COLUMNS = (
    "NUMBER", "X_IMAGE", "Y_IMAGE", "XWIN_IMAGE", "YWIN_IMAGE", "ERRAWIN_IMAGE", "ERRBWIN_IMAGE", "ERRTHETAWIN_IMAGE",
    "FLUX_AUTO", "FLUXERR_AUTO", "FLUX_APER(1)", "FLUXERR_APER(1)", "SNR_WIN", "FLUX_RADIUS", "ELONGATION", "FLAGS",
    "IMAFLAGS_ISO",
)  # fmt: skip


def _extract(frame):
    """Let source-extractor find the brighter sources; only usable ones of S/N 20 and more stay in the table."""
    settings = {
        "CATALOG_NAME": frame.catalogue.name, "CATALOG_TYPE": "FITS_LDAC", "DETECT_THRESH": 5, "ANALYSIS_THRESH": 3,
        "DETECT_MINAREA": 3, "WEIGHT_TYPE": "MAP_RMS", "WEIGHT_IMAGE": frame.planes[1].name,
        "FLAG_IMAGE": frame.planes[2].name, "RESCALE_WEIGHTS": "N", "BACK_SIZE": 256,
        "SATUR_LEVEL": 1e9, "GAIN": EXPTIME, "PIXEL_SCALE": 0.074, "PHOT_APERTURES": 12, "VERBOSE_TYPE": "QUIET",
        "STARNNW_NAME": "/usr/share/source-extractor/default.nnw",
    }  # fmt: skip
    kernel = astromatic.gauss()
    find(frame.image.parent, frame.stem.name, frame.image.name, settings, _COLUMNS, kernel)
    with fits.open(frame.catalogue) as file:
        table = file[2].data
        good = (table["SNR_WIN"] > 20) & (table["FLAGS"] == 0) & (table["IMAFLAGS_ISO"] == 0)
        file[2].data = table[good]
        file.writeto(frame.catalogue, overwrite=True)


def find(folder, name, image, settings, columns, kernel):
    """Run source-extractor on an image of `folder` with a kernel; RuntimeError has what it said."""
    rows = "\n".join(" ".join(f"{value:.7f}" for value in row) for row in kernel / kernel.sum())
    (folder / f"{name}.conv").write_text(f"CONV NORM\n{rows}\n")
    (folder / f"{name}.param").write_text("\n".join(columns) + "\n")
    settings = settings | {"FILTER_NAME": f"{name}.conv", "PARAMETERS_NAME": f"{name}.param"}
    program(folder, ["source-extractor", image], name, settings)


def program(folder, command, name, settings):
    """Run an AstrOmatic program in `folder` with settings {key: value}; return its output. RuntimeError has its end."""
    (folder / f"{name}.settings").write_text("".join(f"{key} {value}\n" for key, value in settings.items()))
    done = subprocess.run(
        [*command, "-c", f"{name}.settings"], cwd=folder, capture_output=True, text=True, check=False
    )  # fmt: skip
    if done.returncode:
        raise RuntimeError(f"{command[0]}: {(done.stdout + done.stderr)[-2000:]}")
    return done.stdout + done.stderr
