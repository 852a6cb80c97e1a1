"""Stacks of bias, dark and LED-flat frames, every layer of the detector on, reduced with ccdproc: do they give back, for
each channel, what the camera's files say?

    pip install -e ".[bench]"
    python benchmarks/calibration_stacks.py [--rows 512] [--figures docs/figures]

Frames of chip 9, all its columns and `rows` rows on either side of the seam, are made by `csstsim chip`; from each file the
reduction takes IMAGE and the keywords of its geometry, nothing else. It prints, for each quantity and channel, what was
configured and what was found, and ends with 1 if anything is off by more than LIMIT sigma.
"""

import argparse
import sys
import tempfile
import time
from collections import namedtuple
from pathlib import Path

import ccdproc
import numpy as np
import yaml
from astropy import units as u
from astropy.io import fits
from astropy.modeling.models import Polynomial1D
from astropy.nddata import CCDData
from scipy import ndimage

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))
import stack_estimates as estimate

from csstsim.cli import main as csstsim
from csstsim.config import SHIPPED
from csstsim.detector import mask as bits
from csstsim.instrument.camera import load_camera

LIMIT = 5.0  # sigma
CHIP = 9
LAMPS = ["590", "670"]
SECONDS = (1.0, 2.5, 5.0, 8.0, 11.0, 15.0, 19.0)  # each of the lamps; 2960 e- per second
EACH = {"BIAS": 6, "DARK": 6, "FLAT": 4}  # frames; of flats, at each level
EXPTIME = {"BIAS": 0, "DARK": 150, "FLAT": 40}
SKIP = 5  # columns of the overscan beside the active ones
BAD, HOT, DEAD = 20.0, 8.0, 0.8  # DN of a column in the bias; sigma of a pixel in the dark; of the flat around

Row = namedtuple("Row", "quantity unit channel configured found error")


# --- frames ----------------------------------------------------------------------------------------------------------


def make_frames(folder, rows):
    """Yield (kind, seconds of light, IMAGE header, pixels from the window's first row on, MASK or None), file by file."""
    for number, (kind, seconds) in enumerate([("BIAS", 0.0), ("DARK", 0.0), *(("FLAT", s) for s in SECONDS)]):
        table = folder / "table.csv"
        obsids = [f"103000{number:02d}{n:03d}" for n in range(EACH[kind])]
        lines = [f"{o},{kind},0,0,0,2027-06-01T00:00:00,{EXPTIME[kind]}" for o in obsids]
        table.write_text("\n".join(["obsid,type,ra,dec,pa,time,exptime", *lines]) + "\n")
        campaign = {
            "name": "stacks", "survey_table": str(table), "output": str(folder / "out"), "seed": 9,
            "select": {"types": [kind], "chips": [CHIP]}, "observations": {kind: str(layers(folder, kind, seconds))},
            "window": {"x0": 0, "x1": 9216, "y0": 4616 - rows, "y1": 4616 + rows},
        }  # fmt: skip
        (folder / "campaign.yaml").write_text(yaml.safe_dump(campaign))
        for obsid in obsids:
            arguments = ["chip", str(folder / "campaign.yaml"), "--obsid", obsid, "--chip", str(CHIP)]
            csstsim(arguments, standalone_mode=False)
            [path] = (folder / "out" / "level0" / obsid).glob("*.fits")
            with fits.open(path) as file:
                image, first = file["IMAGE"], file["IMAGE"].header["READY0"] - 1
                marks = file["MASK"].data[first:].copy() if "MASK" in file else None
                yield kind, seconds, image.header.copy(), image.section[first:, :].astype(np.uint16), marks
            path.unlink()


def layers(folder, kind, seconds):
    """Write the shipped list of a kind, lamps lit for so long, a polynomial a channel; return its path."""
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


# --- reduction of a channel --------------------------------------------------------------------------------------------


class Channel:
    """The frames of one channel, its amplifier at the lower left, as ccdproc takes them."""

    def __init__(self, frames, number):
        self.frames, self.number, self.header = frames, number, frames[-1][2]
        pre, over, after = (self.header[k] for k in ("PSCAN1", "OSCAN1", "OSCAN2"))
        self.width = frames[0][3].shape[1] // self.header["NCHAN"]
        self.rows = len(frames[0][3]) - after
        self.active = np.s_[: self.rows, pre : self.width - over]
        self.behind = np.s_[self.rows :, pre : self.width - over]
        self.overscan = np.s_[:, self.width - over + SKIP :]

    def own(self, pixels):
        return pixels[:, (self.number - 1) * self.width : self.number * self.width]

    def raw(self, kind):
        return [self.own(f[3]).astype(float) for f in self.frames if f[0] == kind]

    def value(self, prefix):
        return self.header[f"{prefix}{self.number:02d}"]

    def reduced(self, kind):
        """Return CCDData of each frame, overscan subtracted (one constant), with its parallel overscan."""
        section = f"[{self.width - self.header['OSCAN1'] + SKIP + 1}:{self.width},:]"
        return [
            ccdproc.subtract_overscan(CCDData(raw, unit="adu"), fits_section=section, model=Polynomial1D(0))
            for raw in self.raw(kind)
        ]

    def trim(self, ccd):
        y, x = self.active
        return ccdproc.trim_image(ccd, fits_section=f"[{x.start + 1}:{x.stop},1:{y.stop}]")

    def truth(self, bit):
        [marks] = [f[4] for f in self.frames if f[4] is not None][:1]
        return (self.own(marks)[self.active] & bit) > 0


def stack(frames, noise):
    """Return (average of CCDData without cosmic rays, masks of the rays (n, ny, nx)).

    noise(median) [DN]: of a pixel of one frame. Rays are grown, as what their electrons diffuse into is below the clip.
    """
    combiner = ccdproc.Combiner(frames)
    level = noise(np.median([f.data for f in frames], axis=0))
    combiner.sigma_clipping(low_thresh=1e3, high_thresh=estimate.RAY, func=np.median, dev_func=lambda data, axis: level)
    rays = np.stack([ndimage.binary_dilation(mask, estimate.GROW) for mask in combiner.data_arr.mask])
    combiner.data_arr.mask = rays
    average = combiner.average_combine()
    # struck in each frame: a hot pixel's neighbour, say
    return CCDData(np.where(average.mask, np.nan, average.data), unit="adu"), rays


def mean_of(frames, good):
    """Return (mean, variance within a frame, number) of pixels `good`, the same in all frames or one array each."""
    values = [frame[ok] for frame, ok in zip(frames, np.broadcast_to(good, np.shape(frames)), strict=True)]
    number = sum(map(len, values))
    mean = sum(v.sum() for v in values) / number
    return mean, sum(((v - v.mean()) ** 2).sum() for v in values) / number, number


def masters(c):
    """Return (bias, dark) of a channel, each (master, frames, rays), and the noise of a pixel [DN]."""
    noise = np.mean([raw[c.overscan].std() for raw in c.raw("BIAS")])
    biases = [c.trim(ccd) for ccd in c.reduced("BIAS")]
    bias, bias_rays = stack(biases, lambda middle: noise)
    darks = [ccdproc.subtract_bias(c.trim(ccd), bias) for ccd in c.reduced("DARK")]
    # the master bias' own noise is the same in all of them, and falls out of what is beyond their median
    dark, dark_rays = stack(darks, lambda middle: np.sqrt(noise**2 + np.maximum(middle, 0)))
    return (bias, biases, bias_rays), (dark, darks, dark_rays), noise


def reduce_channel(c, bias, dark, noise, spoilt):
    """Return what the frames of a channel give, in DN, as a dictionary; spoilt (nx,): columns bad in either half."""
    (bias, biases, bias_rays), (dark, darks, dark_rays) = bias, dark
    spread = np.sqrt((noise**2 + np.nanmedian(dark.data)) / EACH["DARK"] + noise**2 / EACH["BIAS"])
    hot = (dark.data - np.nanmedian(dark.data) > HOT * spread) & ~spoilt
    still = ndimage.binary_dilation(hot, estimate.GROW) | spoilt | np.isnan(bias.data + dark.data)
    flats, behind = [], []
    for ccd in c.reduced("FLAT"):
        behind.append(ccd.data[c.behind][:, ~spoilt])
        flat = ccdproc.subtract_bias(c.trim(ccd), bias)
        flats.append(ccdproc.subtract_dark(
            flat, dark, dark_exposure=EXPTIME["DARK"] * u.s, data_exposure=EXPTIME["FLAT"] * u.s, scale=True).data)  # fmt: skip
    total = np.sum(flats, axis=0)
    dead = (total < DEAD * np.nanmedian(total)) & ~spoilt
    good = ~(still | dead)
    raw = c.raw("BIAS")
    level, scan = np.nanmedian(dark.data), raw[0][c.overscan].size
    # what the rays left, nothing elsewhere
    seen = [np.where(ray & ~still, frame.data - level, 0.0) for frame, ray in zip(darks, dark_rays, strict=True)]
    charge = sum(map(np.sum, seen)) + sum(b.data[r & ~still].sum() for b, r in zip(biases, bias_rays, strict=True))
    return {
        "overscan": mean_of([r[c.overscan] for r in raw], np.ones_like(raw[0][c.overscan], bool)),
        "active": mean_of([r[c.active] for r in raw], good & ~bias_rays),
        "bias": mean_of([b.data for b in biases], good & ~bias_rays),
        "dark": mean_of([d.data + bias.data for d in darks], good & ~dark_rays),
        "hot": hot, "dead": dead, "charge": charge, "searched": (~still).sum(),
    } | reduce_light(flats, good, noise, seen, scan) | reduce_trail(behind, noise, scan)  # fmt: skip


def reduce_light(flats, good, noise, seen, scan):
    """Return linearity, photon transfer and response of a channel's flats (n, ny, nx), two of a level one by one, in DN.

    seen: rays of the darks, as in `faint_rays`; scan: pixels of an overscan.
    """
    pairs = [(*flats[i : i + 2], estimate.struck_of_pair(*flats[i : i + 2], ~good)) for i in range(0, len(flats), 2)]
    kept = [good & ~rays for *_, rays in pairs]
    levels = [mean_of(pair[:2], np.stack([ok, ok])) for pair, ok in zip(pairs, kept, strict=True)]
    halves = [np.var((one - two)[ok]) / 2 for (one, two, _), ok in zip(pairs, kept, strict=True)]
    errors = [np.sqrt(v / number + noise**2 / scan / 2) for v, (_, _, number) in zip(halves, levels, strict=True)]
    means = np.array([mean for mean, *_ in levels])
    shape = 1 + levels[0][1] / means[0] ** 2 - halves[0] / means[0] ** 2
    (q, c), covariance = estimate.linearity(np.repeat(SECONDS, EACH["FLAT"] // 2), means, errors, shape)
    straight = [estimate.straightened(flat, q, c) for flat in flats]
    linear = np.array([(straight[2 * i][ok].mean() + straight[2 * i + 1][ok].mean()) / 2 for i, ok in enumerate(kept)])
    slope = 1 + linear * (2 * q + 3 * c * linear)
    variance = [np.var((straight[2 * i] - straight[2 * i + 1])[ok]) / 2 for i, ok in enumerate(kept)]
    spread = np.sqrt([straight[2 * i][ok].var() for i, ok in enumerate(kept)])
    rays = np.array([faint_rays(seen, estimate.RAY * np.sqrt(2 * v), noise, good) for v in variance])
    return {
        "linearity": (q, c), "linearity errors": np.sqrt(np.diag(covariance)), "level": linear, "spread": spread,
        "variance": np.array(variance) - noise**2 / slope**2, "rays": rays, "number": np.array([ok.sum() for ok in kept]),
        "pattern": estimate.pattern_rms(sum(straight[::2]), sum(straight[1::2]), np.all(kept, axis=0)),
    }  # fmt: skip


def faint_rays(seen, cut, noise, good):
    """Return the variance [DN^2] that rays too faint for `cut` [DN] leave in a flat, from those seen in the darks.

    seen: (ny, nx) charge of the rays of each dark, 0 elsewhere. They are taken out as those of the flats are.
    """
    left = 0.0
    for charge in seen:
        faint = (charge != 0) & ~ndimage.binary_dilation(charge > cut, estimate.GROW)
        left += (charge[faint] ** 2 - noise**2).sum()
    readout = 20.0  # s that a row waits on average
    return left / (good.sum() * len(seen)) * (EXPTIME["FLAT"] + readout) / (EXPTIME["DARK"] + readout)


def reduce_trail(behind, noise, scan):
    """Return the mean [DN] of each row of the parallel overscan of all flats, and the error of their sum.

    behind (n, rows, columns). The error is from the columns' sums, as each has its own number of traps, and from
    the zero of each frame.
    """
    mean, rows = np.mean(behind, axis=0), len(behind[0])
    error = np.hypot(mean.sum(axis=0).std() / np.sqrt(mean.shape[1]), rows * noise / np.sqrt(scan * len(behind)))
    return {"trail": mean.mean(axis=1), "trail error": error}


def bad_columns(c, bias):
    """Return (nx,) bool: columns whose last 400 rows, next to the seam, stand out of the master bias."""
    return np.nanmedian(bias.data[-400:], axis=0) > BAD


def reduce(frames):
    """Return the channels and what was found in each."""
    channels = [Channel(frames, number) for number in range(1, frames[0][2]["NCHAN"] + 1)]
    first = [masters(c) for c in channels]
    bad = [bad_columns(c, bias[0]) for c, (bias, _, _) in zip(channels, first, strict=True)]
    found = []
    for c, (bias, dark, noise), own, other in zip(channels, first, bad, bad[::-1], strict=True):
        # full columns bloom through the seam, and along rows
        spoilt = ndimage.binary_dilation(own | other, np.ones(3, bool))
        found.append(reduce_channel(c, bias, dark, noise, spoilt) | {"bad": own, "spoilt": spoilt})
    return channels, found


# --- what was configured beside what was found ---------------------------------------------------------------------------


def compare(channels, found, camera):
    """Return a list of Row, and the photon transfer (gains, area, its error)."""
    n = len(channels)
    means, variances, numbers, rays = (
        np.stack([f[k] for f in found], axis=1) for k in ("level", "variance", "number", "rays")
    )
    # rays are the same everywhere: one number from all channels is less noisy
    fitted, covariance = estimate.photon_transfer(means, variances - rays.mean(axis=1, keepdims=True), numbers)
    errors = np.sqrt(np.diag(covariance))
    rows = []
    for c, f, gain, error in zip(channels, found, fitted[:n], errors[:n], strict=True):
        f["gain"], f["relative"] = gain, error / gain
        parts = [*levels(c, f, camera), *light(c, f, fitted[n]), *counts(c, f, camera)]
        rows += [Row(*part[:2], c.number, *part[2:]) for part in parts]
    push = camera.detector.brighter_fatter
    rows.append(Row("pixel's own area", "1/e-", "all", push["scale"] * push["areas"][0][0], fitted[n], errors[n]))
    return rows, fitted[n]


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
    """Yield the same of flats; area: of the brighter-fatter effect."""
    gain, relative = f["gain"], f["relative"]
    for name, key, power in (("quadratic", "NLQ", 1), ("cubic", "NLC", 2)):
        found, error = (f[k][power - 1] / gain**power for k in ("linearity", "linearity errors"))
        unit = f"1/e-{'' if power == 1 else '^2'}"
        yield f"nonlinearity, {name}", unit, c.value(key), found, np.hypot(error, power * found * relative)
    electrons, (rms, error) = f["level"] * gain, f["pattern"]
    left = np.sqrt(estimate.deficit(area, (electrons**2).sum() / electrons.sum()))
    yield "PRNU, rms", "%", 100 * c.header["PRNURMS"], 100 * rms / left, 100 * error / left


def counts(c, f, camera):
    """Yield the same of trails, rays and defects. Of defects, `found` is what is there less what is not."""
    detector, gain = camera.detector, f["gain"]
    traps, rays = detector.traps, detector.cosmic_rays
    density, well = c.header["CTIDENS"] * np.array(traps.density), (traps.beta, traps.full_well, traps.notch)
    behind = detector.channel_ny, detector.parallel_overscan
    trails = [estimate.trail(x * gain, s * gain, density, traps.timescale, well, *behind)
              for x, s in zip(f["level"], f["spread"], strict=True)]  # fmt: skip
    f["trail wanted"] = np.mean(trails, axis=0)
    yield "trail of flats", "e-", f["trail wanted"].sum(), f["trail"].sum() * gain, f["trail error"] * gain
    sigma = np.log(10) * rays.log_energy_fwhm / np.sqrt(8 * np.log(2))
    charge = 10**rays.log_energy * np.exp(sigma**2 / 2)  # mean of a ray
    waited = f["searched"] * sum(EACH[k] * (EXPTIME[k] + detector.readout_time / 2) for k in ("BIAS", "DARK"))
    error = rays.rate * np.exp(sigma**2 / 2) / np.sqrt(rays.rate * waited)
    yield "cosmic rays", "1/s/px", rays.rate, f["charge"] * gain / charge / waited, error
    for name, bit in (("hot", bits.HOT), ("dead", bits.DEAD)):
        wanted, found = c.truth(bit) & ~f["spoilt"], f[name]
        yield f"{name} pixels", "", wanted.sum(), (found & wanted).sum() - (found & ~wanted).sum(), 0.0
    wanted, found = c.truth(bits.BAD_COLUMN)[-1], f["bad"]
    yield "bad columns", "", wanted.sum(), (found & wanted).sum() - (found & ~wanted).sum(), 0.0


def sigmas(row):
    """Return by how many of its errors a row is off; what has no error must be equal."""
    off = float(row.found - row.configured)
    return off / row.error if row.error else np.inf * np.sign(off) if off else 0.0


def show(rows):
    """Print each row, then a line for each quantity."""
    for row in rows:
        print(f"{row.quantity:24s}{row.channel!s:>4s}  configured {row.configured:<13.6g} found {row.found:<13.6g} "
              f"+- {row.error:<9.2g} {row.unit:7s}{sigmas(row):6.2f} sigma")  # fmt: skip
    print(f"\n{'quantity':24s}{'unit':8s}{'configured':>13s}{'found':>13s}{'error each':>12s}   sigma: rms  largest")
    for name in dict.fromkeys(row.quantity for row in rows):
        mine = [row for row in rows if row.quantity == name]
        middle = [np.mean([getattr(row, k) for row in mine]) for k in ("configured", "found", "error")]
        off = np.abs([sigmas(row) for row in mine])
        print(f"{name:24s}{mine[0].unit:8s}{middle[0]:13.6g}{middle[1]:13.6g}{middle[2]:12.2g}"
              f"{np.sqrt(np.mean(off**2)):13.2f}{off.max():9.2f}")  # fmt: skip


def main(options):
    began = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        frames = list(make_frames(Path(folder), options.rows))
    made = time.process_time()
    channels, found = reduce(frames)
    rows, area = compare(channels, found, load_camera(SHIPPED / "instrument"))
    show(rows)
    if options.figures:
        draw(rows, found, area, options.figures)
    print(
        f"CPU seconds: {made - began:.0f} to make {len(frames)} frames, {time.process_time() - made:.0f} to reduce them"
    )
    bad = [row for row in rows if not abs(sigmas(row)) <= LIMIT]
    for row in bad:
        print(f"OFF by more than {LIMIT:g} sigma: {row.quantity}, channel {row.channel}")
    sys.exit(1 if bad else 0)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", type=int, default=512, help="rows of each half")
    parser.add_argument("--figures", type=Path)
    main(parser.parse_args())
