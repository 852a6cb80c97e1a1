"""Do stacks of bias, dark and LED-flat frames, made with every detector layer and reduced with ccdproc, reproduce the
numbers of each channel in the camera's files?

    pip install -e ".[bench]"
    python benchmarks/calibration_stacks.py [--rows 512]

`csstsim chip` makes frames of chip 9 with all its columns and `rows` rows on either side of the seam. The reduction
(stack_reduction.py) uses only IMAGE and its geometry keywords from each file. Prints, for each quantity and channel,
the configured and the measured value; exit code 1 if any is off by more than LIMIT sigma.
"""

import argparse
import tempfile
import time
from collections import namedtuple
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

from evidence.record import Record

import numpy as np
import yaml
from astropy.io import fits
from stack_figure import draw
from stack_reduction import EACH, EXPTIME, SECONDS, ccdproc, estimate, reduce

from csstsim.base.shipped import SHIPPED
from csstsim.command_line.main import main as csstsim
from csstsim.detector import mask as bits
from csstsim.instrument.camera import load_camera

LIMIT = 5.0  # sigma
TOY_ROWS, TOY_EACH = 24, {"BIAS": 3, "DARK": 3, "FLAT": 2}
CHIP = 9
LAMPS = ["590", "670"]

Row = namedtuple("Row", "quantity unit channel configured found error")


def make_frames(folder, rows):
    """Yield (kind, seconds of light, IMAGE header, pixels from the window's first row on, MASK or None) by frame."""
    for number, (kind, seconds) in enumerate([("BIAS", 0.0), ("DARK", 0.0), *(("FLAT", s) for s in SECONDS)]):
        table = folder / "table.csv"
        obsids = [f"103000{number:02d}{n:03d}" for n in range(EACH[kind])]
        lines = [f"{o},{kind},0,0,0,2027-06-01T00:00:00,{EXPTIME[kind]}" for o in obsids]
        table.write_text("\n".join(["obsid,type,ra,dec,pa,time,exptime", *lines]) + "\n")
        campaign = {
            "schema_version": 1, "name": "stacks", "survey_table": str(table), "output": str(folder / "out"), "seed": 9,
            "select": {"types": [kind], "chips": [CHIP]}, "observations": {kind: str(layers(folder, kind, seconds))},
            "window": {"x0": 0, "x1": 9216, "y0": 4616 - rows, "y1": 4616 + rows},
        }  # fmt: skip
        (folder / "campaign.yaml").write_text(yaml.safe_dump(campaign))
        for obsid in obsids:
            arguments = ["chip", str(folder / "campaign.yaml"), "--obsid", obsid, "--chip", str(CHIP)]
            with redirect_stdout(StringIO()):
                csstsim(arguments, standalone_mode=False)
            [path] = (folder / "out" / "level0" / obsid).glob("*.fits")
            with fits.open(path) as file:
                image, first = file["IMAGE"], file["IMAGE"].header["READY0"] - 1
                marks = file["MASK"].data[first:].copy() if "MASK" in file else None
                yield kind, seconds, image.header.copy(), image.section[first:, :].astype(np.uint16), marks
            path.unlink()


def layers(folder, kind, seconds):
    """Write the shipped list of a kind, with lamps lit for `seconds` and a polynomial per channel; return its path."""
    name = {"BIAS": "bias", "DARK": "dark", "FLAT": "led_flat"}[kind]
    steps = yaml.safe_load((SHIPPED / "observations" / f"{name}.yaml").read_text())["layers"]
    for step in steps:
        for keyword, param in step.items():
            if keyword == "led_calib_model":
                param |= {"LED_TYPE": LAMPS, "LED_TIME": [seconds] * len(LAMPS)}
            elif keyword == "nonlinearity":
                param |= {"nonlinearity_16channel": True}
            elif keyword == "quantization_and_output":
                param |= {"mask": seconds == SECONDS[0]}
    path = folder / f"{name}.yaml"
    path.write_text(yaml.safe_dump({"layers": steps}))
    return path


def compare(channels, found, camera):
    """Return a list of Row, and the area of the brighter-fatter effect [1/e-]."""
    n, detector = len(channels), camera.detector
    means, numbers = (np.stack([f[k] for f in found], axis=1) for k in ("level", "number"))
    # Corrections of 1e-4 to 1e-3: cosmic rays not found in flats, equal in all channels; noise smoothed by traps
    rays = np.mean([f["rays"] for f in found], axis=0)
    for f in found:
        f["variance"] = (f["variance"] - rays) / (1 - smoothed(f["level"] * detector.gain, channels[0], detector))
    fitted, covariance = estimate.photon_transfer(means, np.stack([f["variance"] for f in found], axis=1), numbers)
    errors = np.sqrt(np.diag(covariance))
    rows = []
    for c, f, gain, error in zip(channels, found, fitted[:n], errors[:n], strict=True):
        f["gain"], f["relative"] = gain, error / gain
        parts = [*levels(c, f, camera), *light(c, f, fitted[n]), *counts(c, f, camera)]
        rows += [Row(*part[:2], c.number, *part[2:]) for part in parts]
    push = detector.brighter_fatter
    rows.append(Row("pixel's own area", "1/e-", "all", push["scale"] * push["areas"][0][0], fitted[n], errors[n]))
    return rows, fitted[n]


def traps_of(c, detector):
    """Return the traps in the form of stack_estimates: density, timescale, well, rows of a half."""
    traps = detector.traps
    density, well = c.header["CTIDENS"] * np.array(traps.density), (traps.beta, traps.full_well, traps.notch)
    return density, traps.timescale, well, detector.channel_ny


def smoothed(electrons, c, detector):
    return np.array([estimate.smoothed(mu, *traps_of(c, detector)) for mu in electrons])


def levels(c, f, camera):
    """Yield (quantity, unit, configured, found, error) of frames without light."""
    gain, relative, seconds = f["gain"], f["relative"], EXPTIME["DARK"]
    for name, region in (("overscan", "overscan"), ("active", "active")):
        mean, variance, number = f[region]
        yield f"bias, {name}", "DN", c.value("DETBIA"), mean, np.sqrt(variance / number)
    for name, region in (("overscan", "overscan"), ("active", "bias")):
        _, variance, number = f[region]
        noise = np.sqrt(variance - 1 / 12) * gain  # less the rounding to whole DN
        yield f"read noise, {name}", "e-", c.value("RON"), noise, noise * np.hypot(relative, np.sqrt(0.5 / number))
    yield "gain", "e-/DN", c.value("GAIN"), gain, gain * relative
    dark, scan = f["dark"][0] - f["bias"][0], f["overscan"][1] / f["overscan"][2] * EACH["BIAS"]
    error = np.sqrt(sum(f[k][1] / f[k][2] + scan / EACH[k.upper()] for k in ("dark", "bias")))
    found = dark * gain / seconds
    yield "dark current", "e-/s", camera.detector.dark, found, np.hypot(error * gain / seconds, found * relative)


def light(c, f, area):
    """Yield the same for flats; area: that of the brighter-fatter effect [1/e-]."""
    gain, relative = f["gain"], f["relative"]
    for name, key, power in (("quadratic", "NLQ", 1), ("cubic", "NLC", 2)):
        found, error = (f[k][power - 1] / gain**power for k in ("linearity", "linearity errors"))
        unit = f"1/e-{'' if power == 1 else '^2'}"
        yield f"nonlinearity, {name}", unit, c.value(key), found, np.hypot(error, power * found * relative)
    electrons, (rms, error) = f["level"] * gain, f["pattern"]
    left = np.sqrt(estimate.deficit(area, (electrons**2).sum() / electrons.sum()))
    yield "PRNU, rms", "%", 100 * c.header["PRNURMS"], 100 * rms / left, 100 * error / left


def counts(c, f, camera):
    """Yield the same for trails, rays and defects; for defects `found` is the true detections less the false ones."""
    detector, gain = camera.detector, f["gain"]
    rays = detector.cosmic_rays
    behind = *traps_of(c, detector), detector.parallel_overscan
    trails = [estimate.trail(x * gain, s * gain, *behind) for x, s in zip(f["level"], f["spread"], strict=True)]
    f["trail wanted"] = np.mean(trails, axis=0)
    yield "trail of flats", "e-", f["trail wanted"].sum(), f["trail"].sum() * gain, f["trail error"] * gain
    sigma = np.log(10) * rays.log_energy_fwhm / np.sqrt(8 * np.log(2))
    charge = 10**rays.log_energy * np.exp(sigma**2 / 2)  # mean of a ray
    waited = f["searched"] * sum(EACH[k] * (EXPTIME[k] + c.waits) for k in ("BIAS", "DARK"))
    error = rays.rate * np.exp(sigma**2 / 2) / np.sqrt(rays.rate * waited)
    yield "cosmic rays", "1/s/px", rays.rate, f["charge"] * gain / charge / waited, error
    for name, bit in (("hot", bits.HOT), ("dead", bits.DEAD)):
        wanted, found = c.truth(bit) & ~f["spoilt"], f[name]
        yield f"{name} pixels", "", wanted.sum(), (found & wanted).sum() - (found & ~wanted).sum(), 0.0
    wanted, found = c.truth(bits.BAD_COLUMN)[-1], f["bad"]
    yield "bad columns", "", wanted.sum(), (found & wanted).sum() - (found & ~wanted).sum(), 0.0


def sigmas(row):
    """Return by how many of its errors a row is off; values without an error must be equal."""
    off = float(row.found - row.configured)
    return off / row.error if row.error else np.inf * np.sign(off) if off else 0.0


def show(rows, record):
    """Print each row, then record a line for each quantity."""
    for row in rows:
        print(f"{row.quantity:24s}{row.channel!s:>4s}  configured {row.configured:<13.6g} found {row.found:<13.6g} "
              f"+- {row.error:<9.2g} {row.unit:7s}{sigmas(row):6.2f} sigma")  # fmt: skip
    lines = []
    for name in dict.fromkeys(row.quantity for row in rows):
        mine = [row for row in rows if row.quantity == name]
        middle = [np.mean([getattr(row, k) for row in mine]) for k in ("configured", "found", "error")]
        off = np.abs([sigmas(row) for row in mine])
        cells = [f"{middle[0]:.6g}", f"{middle[1]:.6g}", f"{middle[2]:.2g}", f"{np.sqrt(np.mean(off**2)):.2f}"]
        lines.append([name, mine[0].unit, *cells, f"{off.max():.2f}"])
    header = ["quantity", "unit", "configured", "found", "error of each", "sigma, rms", "largest"]
    record.table("quantities", header, lines)


def main(record: Record) -> None:
    """Make the frames, reduce them, and compare."""
    if record.toy:
        EACH.update(TOY_EACH)
    began = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        frames = list(make_frames(Path(folder), record.options.rows if not record.toy else TOY_ROWS))
    made = time.process_time()
    if ccdproc is None:
        record.skip("ccdproc", 'not installed: pip install -e ".[bench]"')
        return
    channels, found = reduce(frames)
    rows, area = compare(channels, found, load_camera(SHIPPED / "instrument"))
    show(rows, record)
    draw(rows, found, area, record.figure("calibration_stacks.png"))
    record.value("make_cpu", made - began, f"{len(frames)} frames made", unit="CPU-s")
    record.value("reduce_cpu", time.process_time() - made, "the frames reduced by ccdproc", unit="CPU-s")
    bad = [row for row in rows if not abs(sigmas(row)) <= LIMIT]
    record.value("numbers", len(rows), "numbers compared with those configured")
    record.value("off", len(bad), f"of them off by more than {LIMIT:g} sigma", below=0)
    for row in bad:
        print(f"OFF by more than {LIMIT:g} sigma: {row.quantity}, channel {row.channel}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", type=int, default=512, help="rows of each half")
    with Record(parser) as record:
        main(record)
