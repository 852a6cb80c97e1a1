"""Expected values of a frame, and those in the header of its Level-0 file (made by stages.parts.frame_facts).

Pixels are compared with the expected values: the background is sky and dark current, its noise that of sky, dark
current, readout and rounding. The header's numbers are compared with the campaign's, its world coordinates with the
positions of stars.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from csstsim.base.types import BoolArray, FloatArray, IntArray
from csstsim.catalog.profiles.sersic import BULGE, DISK, brightness_radius, light_beyond
from csstsim.measure.bricks.validation.compare import half_light

if TYPE_CHECKING:
    from astropy.wcs import WCS

    from csstsim.catalog.table import ObjectTable
    from csstsim.optics.geometry.distortion import ChipDistortion

MIN_PIXELS = 256**2  # a smaller background has less than one mesh (measure.detection.background) and is not evaluated
SNR_FAINT = 5.0  # all flux of fainter objects counts as background
UNMASKED = 0.02  # fraction of brighter objects' flux that may be unmasked: 1% of saturated stars' is
LARGE = 32.0  # px, half-light radius of galaxies whose parts below a pixel's noise count as background
ROUNDING = 12**-0.5  # rms of rounding, in steps


@dataclass(frozen=True)
class HeaderWCS:
    """The world coordinates of a header: TAN, or TAN-SIP; 0-based pixels of the whole chip.

    distortion: that of the chip (optics.geometry.distortion) if the header's linear WCS leaves it out, else None.
    """

    cards: dict[str, Any]
    distortion: ChipDistortion | None = None

    @cached_property
    def _wcs(self) -> WCS:
        from astropy.io.fits import Header
        from astropy.wcs import WCS

        return WCS(Header(self.cards))

    def pixel_to_world(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the apparent ra, dec [deg] of pixels x, y (n,)."""
        if self.distortion is not None:
            x, y = self.distortion.inverse(x, y)
        return self._wcs.all_pix2world(x, y, 0)


class Deviation(NamedTuple):
    """By how much a value differs from the expected one, and its standard error; channel None: of the whole frame."""

    channel: int | None
    value: float
    sigma: float


class ChannelLevel(NamedTuple):
    """A channel's background over the expected one, less 1 (`excess`), in a window (x0, x1, y0, y1) of `pixels` px.

    objects: what the flux of objects may add to it, in the same unit; half of it is subtracted from `excess`. sigma:
    standard error of `excess`.
    """

    channel: int
    window: tuple[int, int, int, int]
    pixels: int
    excess: float
    objects: float
    sigma: float


@dataclass(frozen=True)
class Facts:
    """Expected values of one frame, and those in its file's header.

    exptime [s]; sky [e- per pixel, before all losses], None if a layer of the user's own may add light; dark [e- per
    pixel]; read_noise, full_well [e-]; gain {channel: e-/DN}; header {exptime, gain, read_noise, bias, pointing}: gain,
    read noise and bias are {channel: e-/DN, e-, DN}, pointing {keyword: arcsec off}, None or empty if the header has
    none; wcs: HeaderWCS or None; expected {"galaxies", "stars"}: numbers in the catalogue of the brick's objects on the
    window, empty if not known.
    """

    exptime: float
    sky: float | None
    dark: float
    read_noise: float
    full_well: float
    gain: dict[int, float]
    header: dict[str, Any] = field(default_factory=dict)
    wcs: HeaderWCS | None = None
    expected: dict[str, int] = field(default_factory=dict)

    def level(self, response: float) -> float:
        """Return the expected background [e- per pixel] after division by the counted fraction `response`."""
        assert self.sky is not None  # the caller has checked
        return self.sky + self.dark / response

    def noise(self, response: float, channel: int) -> float:
        """Return its expected noise [e- rms per pixel]: of sky, dark current, readout and rounding to whole DN."""
        assert self.sky is not None
        rounding = self.gain.get(channel, 0.0) * ROUNDING
        return np.sqrt(self.sky * response + self.dark + self.read_noise**2 + rounding**2) / response


def pixels_off(
    channels: Sequence[Mapping[str, Any]], facts: Facts, truth: ObjectTable, pixel: float
) -> dict[str, list[Deviation]]:
    """Return {name: deviations} of a frame's channels (measure.calibration).

    level, noise: measured over expected, less 1, of channels of MIN_PIXELS or more and of the whole frame (channel
    None); read_noise: the overscan's over the camera's, less 1; bias: the overscan's less the header's, DN. uneven: a
    channel's level over expected, less that of all channels. truth: io.truth.read_truth; pixel: its side [arcsec].

    The level may include all flux of objects below SNR_FAINT, a fraction UNMASKED of the others', the faint outskirts
    of LARGE galaxies, and the flux of objects beyond the frame's edge. `uneven` assumes that half of it is included,
    give or take a half.
    """
    out: dict[str, list[Deviation]] = {
        "level": [],
        "noise": [],
        "read_noise": [],
        "bias": [],
        "uneven": [],
    }
    pixels = np.array([_area(part["window"]) for part in channels])
    levels = []
    parts = list(zip(channels, pixels, _object_background(channels, pixels, truth, pixel), strict=True))
    for part, n, objects in [*_whole_frame(parts), *parts] if facts.sky is not None else ():
        if n < MIN_PIXELS:
            continue
        expected = facts.level(part["response"])
        bias = facts.read_noise / np.sqrt(part["overscan"]) if part["overscan"] else 0.0
        sigma = np.hypot(part["noise"] / np.sqrt(n), bias)
        if part["channel"]:
            excess = (part["level"] - expected - objects / 2) / expected
            levels.append(
                ChannelLevel(part["channel"], part["window"], n, excess, objects / expected, sigma / expected)
            )
        excess = part["level"] - expected
        excess = min(excess, 0.0) + max(excess - objects, 0.0)
        out["level"].append(Deviation(part["channel"], float(excess / expected), float(sigma / expected)))
        noise = facts.noise(part["response"], part["channel"] or channels[0]["channel"])
        out["noise"].append(Deviation(part["channel"], float(part["noise"] / noise - 1), float((2 * n) ** -0.5)))
    out["uneven"] = _uneven(levels)
    for part in channels:
        n = part["channel"]
        count = part["overscan"]
        if not count:  # without overscan (layout `chip`) both were taken from the header
            continue
        expected = np.hypot(facts.read_noise, facts.gain.get(n, 0.0) * ROUNDING)
        if expected > 0:
            out["read_noise"].append(Deviation(n, float(part["read_noise"] / expected - 1), (2 * count) ** -0.5))
        if n in facts.header.get("bias", {}):
            sigma = np.hypot(part["read_noise"] / facts.gain.get(n, 1.0), ROUNDING) / np.sqrt(count)
            out["bias"].append(Deviation(n, float(part["bias"] - facts.header["bias"][n]), float(sigma)))
    return out


def _uneven(levels: Sequence[ChannelLevel]) -> list[Deviation]:
    """Return the deviations of the excesses of ChannelLevels from their mean, of two channels or more.

    The halves of the frame are also compared with each other (channel None), because their errors are smaller. What the
    flux of objects may contribute to a deviation is subtracted from its size.
    """
    if len(levels) < 2:
        return []
    pixels, excess, objects, sigmas = (np.array([getattr(one, k) for one in levels]) for k in ChannelLevel._fields[2:])
    corners = np.array([(one.window[0], one.window[2]) for one in levels])
    everything = np.ones(len(levels), bool)
    pairs: list[tuple[int | None, BoolArray, BoolArray]] = [
        (one.channel, np.arange(len(levels)) == k, everything) for k, one in enumerate(levels)
    ]
    sides = (corners > corners.mean(axis=0)).T
    pairs += [(None, side, ~side) for side in sides if 0 < side.sum() < len(levels)]
    out: list[Deviation] = []
    for channel, *groups in pairs:
        difference, of_objects = (
            -np.diff([np.average(v[group], weights=pixels[group]) for group in groups])[0] for v in (excess, objects)
        )
        sigma = np.hypot(*(np.sqrt(np.sum((pixels * sigmas)[group] ** 2)) / pixels[group].sum() for group in groups))
        size = max(abs(difference) - abs(of_objects) / 2, 0.0)
        out.append(Deviation(channel, float(np.copysign(size, difference)), float(sigma)))
    return out


def _area(window: tuple[int, int, int, int]) -> int:
    x0, x1, y0, y1 = window
    return (x1 - x0) * (y1 - y0)


def _object_background(
    channels: Sequence[Mapping[str, Any]], pixels: IntArray, truth: ObjectTable, pixel: float
) -> FloatArray:
    """Return (n,): unmasked flux of objects [e- per pixel] that each channel's level may include.

    It is the sum of two means: over the channel, of the flux of its objects; over the frame, of that of all objects.
    An object outside the window counts in the nearest channel, with all its flux that falls into the window. LARGE
    galaxies are spread over the channels that their outskirts reach.
    """
    if not channels or "drawn" not in truth:
        return np.zeros(len(channels))
    drawn = np.nan_to_num(truth["drawn"].astype(float))
    unmasked = np.maximum(
        UNMASKED, _faint_fraction(truth, drawn, np.median([part["noise"] for part in channels]), pixel)
    )
    windows = np.array([part["window"] for part in channels])

    def nearest(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        x = np.clip(x, windows[:, 0].min(), windows[:, 1].max() - 1)
        return x, np.clip(y, windows[:, 2].min(), windows[:, 3].max() - 1)

    x, y = nearest(truth["x"], truth["y"])
    outside = np.hypot(truth["x"] - x, truth["y"] - y) > 0.5
    flux = np.where((truth["snr"] < SNR_FAINT) | outside, 1.0, unmasked) * np.maximum(drawn, 0.0)
    x, y, flux = _spread(truth["x"], truth["y"], flux, half_light(truth) / pixel)
    x, y = nearest(x, y)
    in_channel = [
        flux[(x >= x0 - 0.5) & (x < x1 - 0.5) & (y >= y0 - 0.5) & (y < y1 - 0.5)].sum() for x0, x1, y0, y1 in windows
    ]
    return np.array(in_channel) / pixels + flux.sum() / pixels.sum()


def _spread(
    x: FloatArray, y: FloatArray, flux: FloatArray, radius: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return positions and fluxes of points: objects, and LARGE galaxies as circles of one to three half-light radii.

    radius (n,): half-light radius [px], as x and y.
    """
    large = radius > LARGE
    angles = (np.arange(16) + 0.5) * np.pi / 8
    circles = np.outer([1.0, 1.5, 2.0, 3.0], np.exp(1j * angles)).ravel()

    def points(centre: FloatArray, offsets: FloatArray) -> FloatArray:
        return np.concatenate([centre[~large], (centre[large, None] + radius[large, None] * offsets).ravel()])

    fluxes = np.concatenate([flux[~large], np.repeat(flux[large] / len(circles), len(circles))])
    return points(x, circles.real), points(y, circles.imag), fluxes


def _faint_fraction(truth: ObjectTable, drawn: FloatArray, noise: float, pixel: float) -> FloatArray:
    """Return (n,): fraction of the flux of LARGE galaxies where bulge or disk are fainter than `noise` [e- per pixel].

    drawn (n,): their rendered electrons.
    """
    fraction = np.zeros(len(drawn))
    for i in np.flatnonzero((half_light(truth) > LARGE * pixel) & (drawn > 0)):
        bulge = float(truth["bulge_frac"][i])
        for name, part, index in (("bulge", bulge, BULGE), ("disk", 1 - bulge, DISK)):
            size = float(truth[f"size_{name}"][i]) / pixel
            index = float(truth[f"n_{name}"][i]) if f"n_{name}" in truth else index
            if part * size > 0:
                radius = brightness_radius(noise * size**2 / (part * drawn[i]), index)
                fraction[i] += part * float(light_beyond(radius, 1.0, index))
    return fraction


def _whole_frame(parts: Sequence[tuple[Mapping[str, Any], int, float]]) -> list[tuple[dict[str, Any], int, float]]:
    """Return [(figures, pixels, flux of objects)] of all channels together: means weighted with pixels, or []."""
    if not parts:
        return []
    channels, pixels, objects = zip(*parts, strict=True)
    names = "level", "noise", "response"
    means = {name: float(np.average([part[name] for part in channels], weights=pixels)) for name in names}
    overscan = sum(part["overscan"] for part in channels)
    return [(means | {"channel": None, "overscan": overscan}, sum(pixels), float(np.average(objects, weights=pixels)))]


def header_off(facts: Facts) -> dict[str, list[Deviation]]:
    """Return {name: deviations} of the header's numbers over the campaign's, less 1; their sigma is 0.

    pointing: by how much the keyword that is furthest off differs from the campaign's pointing [arcsec].
    """
    header = facts.header
    out: dict[str, list[Deviation]] = {
        "exptime": [],
        "gain": [],
        "read_noise": [],
        "pointing": [],
    }
    if header.get("pointing"):
        out["pointing"].append(Deviation(None, max(header["pointing"].values()), 0.0))
    if header.get("exptime") is not None and facts.exptime > 0:
        out["exptime"].append(Deviation(None, header["exptime"] / facts.exptime - 1, 0.0))
    for n, value in header.get("gain", {}).items():
        if n in facts.gain:
            out["gain"].append(Deviation(n, value / facts.gain[n] - 1, 0.0))
    for n, value in header.get("read_noise", {}).items():
        if facts.read_noise > 0:
            out["read_noise"].append(Deviation(n, value / facts.read_noise - 1, 0.0))
    return out
