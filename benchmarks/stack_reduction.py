"""Reduction of the stacks of benchmarks/calibration_stacks.py, channel by channel, with ccdproc; numbers in DN."""

import numpy as np
from astropy import units as u
from astropy.modeling.models import Polynomial1D
from astropy.nddata import CCDData
from scipy import ndimage

try:
    import ccdproc
except ImportError:
    ccdproc = None
from support import stack_estimates as estimate

SECONDS = (1.0, 2.5, 5.0, 8.0, 11.0, 15.0, 19.0)  # of light of both lamps; 2960 e- per second
EACH = {"BIAS": 6, "DARK": 6, "FLAT": 4}  # number of frames; of flats at each level
EXPTIME = {"BIAS": 0, "DARK": 150, "FLAT": 40}  # s
SKIP = 5  # columns of the overscan next to the active ones, not used
BAD, HOT, DEAD = 20.0, 8.0, 0.8  # DN of a column in the bias; sigma of a pixel in the dark; share of the flat around


class Channel:
    """The frames of one channel in ccdproc's form, its amplifier at the lower left."""

    def __init__(self, frames, number):
        self.frames, self.number, self.header = frames, number, frames[-1][2]
        pre, over, after = (self.header[k] for k in ("PSCAN1", "OSCAN1", "OSCAN2"))
        self.width = frames[0][3].shape[1] // self.header["NCHAN"]
        self.rows = len(frames[0][3]) - after
        self.active = np.s_[: self.rows, pre : self.width - over]
        self.behind = np.s_[self.rows :, pre : self.width - over]
        self.overscan = np.s_[:, self.width - over + SKIP :]
        self.waits = self.header["READTIME"] / 2  # s that a row waits to be read, on average

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

    noise(median) [DN]: of a pixel of one frame. Masks are grown: pixels with diffused electrons are below the clip.
    """
    combiner = ccdproc.Combiner(frames)
    level = noise(np.median([f.data for f in frames], axis=0))
    combiner.sigma_clipping(low_thresh=1e3, high_thresh=estimate.RAY, func=np.median, dev_func=lambda data, axis: level)
    rays = np.stack([ndimage.binary_dilation(mask, estimate.GROW) for mask in combiner.data_arr.mask])
    combiner.data_arr.mask = rays
    average = combiner.average_combine()
    # NaN: masked in all frames, as next to a hot pixel
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
    # The master bias's noise is the same in all of them, so it does not affect deviations from their median
    dark, dark_rays = stack(darks, lambda middle: np.sqrt(noise**2 + np.maximum(middle, 0)))
    return (bias, biases, bias_rays), (dark, darks, dark_rays), noise


def reduce_channel(c, bias, dark, noise, spoilt):
    """Return the results of a channel's frames, in DN, as a dictionary; spoilt (nx,): columns bad in either half."""
    (bias, biases, bias_rays), (dark, darks, dark_rays) = bias, dark
    spread = np.sqrt((noise**2 + np.nanmedian(dark.data)) / EACH["DARK"] + noise**2 / EACH["BIAS"])
    hot = (dark.data - np.nanmedian(dark.data) > HOT * spread) & ~spoilt
    still = ndimage.binary_dilation(hot, estimate.GROW) | spoilt | np.isnan(bias.data + dark.data)
    flats, behind = [], []
    for ccd in c.reduced("FLAT"):
        behind.append(ccd.data[c.behind][:, ~spoilt])
        flat = ccdproc.subtract_bias(c.trim(ccd), bias)
        times = {"dark_exposure": EXPTIME["DARK"] * u.s, "data_exposure": EXPTIME["FLAT"] * u.s}
        flats.append(ccdproc.subtract_dark(flat, dark, scale=True, **times).data)
    total = np.sum(flats, axis=0)
    dead = (total < DEAD * np.nanmedian(total)) & ~spoilt
    good = ~(still | dead)
    raw = c.raw("BIAS")
    level, scan = np.nanmedian(dark.data), raw[0][c.overscan].size
    # charge of the rays, 0 elsewhere
    seen = [np.where(ray & ~still, frame.data - level, 0.0) for frame, ray in zip(darks, dark_rays, strict=True)]
    charge = sum(map(np.sum, seen)) + sum(b.data[r & ~still].sum() for b, r in zip(biases, bias_rays, strict=True))
    waited = (EXPTIME["FLAT"] + c.waits) / (EXPTIME["DARK"] + c.waits)

    def faint(cut):
        return waited * faint_rays(seen, cut, noise) / good.sum()

    return {
        "overscan": mean_of([r[c.overscan] for r in raw], np.ones_like(raw[0][c.overscan], bool)),
        "active": mean_of([r[c.active] for r in raw], good & ~bias_rays),
        "bias": mean_of([b.data for b in biases], good & ~bias_rays),
        "dark": mean_of([d.data + bias.data for d in darks], good & ~dark_rays),
        "hot": hot, "dead": dead, "charge": charge, "searched": (~still).sum(),
    } | reduce_light(flats, good, noise, faint, scan) | reduce_trail(behind, noise, scan)  # fmt: skip


def reduce_light(flats, good, noise, faint, scan):
    """Return linearity, photon transfer and response, in DN, of a channel's flats (n, ny, nx), in pairs of one level.

    faint(cut [DN]): variance that undetected rays leave; scan: pixels of an overscan.
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
    rays = np.array([faint(estimate.RAY * np.sqrt(2 * v)) for v in variance])
    return {
        "linearity": (q, c), "linearity errors": np.sqrt(np.diag(covariance)), "level": linear, "spread": spread,
        "variance": np.array(variance) - noise**2 / slope**2, "rays": rays,
        "number": np.array([ok.sum() for ok in kept]),
        "pattern": estimate.pattern_rms(sum(straight[::2]), sum(straight[1::2]), np.all(kept, axis=0)),
    }  # fmt: skip


def faint_rays(seen, cut, noise):
    """Return the squared charge [DN^2] per frame of rays too faint for `cut` [DN], from those seen in the darks.

    seen: (ny, nx) charge of the rays of each dark, 0 elsewhere. They are removed in the same way as those of the flats.
    """
    left, rng = 0.0, np.random.default_rng(1)
    for charge in seen:
        found = charge + cut / estimate.RAY * rng.standard_normal(charge.shape) > cut
        faint = (charge != 0) & ~ndimage.binary_dilation(found & (charge != 0), estimate.GROW)
        left += (charge[faint] ** 2 - noise**2).sum() / len(seen)
    return left


def reduce_trail(behind, noise, scan):
    """Return the mean [DN] of each row of the parallel overscan of all flats, and the error of their sum.

    behind (n, rows, columns). The error is from the scatter of the columns' sums, as each has its own number of traps,
    and from the zero of each frame.
    """
    mean, rows = np.mean(behind, axis=0), len(behind[0])
    error = np.hypot(mean.sum(axis=0).std() / np.sqrt(mean.shape[1]), rows * noise / np.sqrt(scan * len(behind)))
    return {"trail": mean.mean(axis=1), "trail error": error}


def bad_columns(c, bias):
    """Return (nx,) bool: columns whose last 400 rows, next to the seam, deviate in the master bias."""
    return np.nanmedian(bias.data[-400:], axis=0) > BAD


def reduce(frames):
    """Return the channels and the results of each."""
    channels = [Channel(frames, number) for number in range(1, frames[0][2]["NCHAN"] + 1)]
    first = [masters(c) for c in channels]
    bad = [bad_columns(c, bias[0]) for c, (bias, _, _) in zip(channels, first, strict=True)]
    found = []
    for c, (bias, dark, noise), own, other in zip(channels, first, bad, bad[::-1], strict=True):
        # full columns bloom across the seam, and along rows
        spoilt = ndimage.binary_dilation(own | other, np.ones(3, bool))
        found.append(reduce_channel(c, bias, dark, noise, spoilt) | {"bad": own, "spoilt": spoilt})
    return channels, found
