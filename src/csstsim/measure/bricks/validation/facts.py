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

LEAST = 256**2  # px: a smaller background has less than one mesh (measure.detection.background) and is not evaluated
FAINT = 5.0  # S/N: all light of fainter objects counts as background
OUTSIDE = 0.02  # share of brighter objects' light that may be unmasked: 1% of saturated stars' is
LARGE = 32.0  # px, half-light radius of galaxies of which as much as lies below a pixel's noise counts as background
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
    """A channel's background over expected, less 1 (`excess`), in a window (x0, x1, y0, y1) of so many pixels.

    light: what objects may add, the half of it taken off; chance: one sigma.
    """

    channel: int
    window: tuple[int, int, int, int]
    pixels: int
    excess: float
    light: float
    chance: float


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
        """Return the expected background [e- per pixel] after division by the counted share `response`."""
        assert self.sky is not None  # who asks has checked
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

    level, noise: measured over expected, less 1, of channels of LEAST px or more and of the whole frame (channel None);
    read_noise: the overscan's over the camera's, less 1; bias: the overscan's less the header's, DN. chance: one sigma.
    The level may include all light of FAINT objects (`truth`: io.truth.read_truth), a share OUTSIDE of the others', the
    faint outskirts of LARGE galaxies, and the light of objects beyond the frame's edge. uneven: a channel's level over
    expected, less that of all channels; half of such light is taken to be there, and may be by half more or less.
    pixel: its side [arcsec].
    """
    out: dict[str, list[Deviation]] = {
        "level": [],
        "noise": [],
        "read_noise": [],
        "bias": [],
        "uneven": [],
    }
    pixels = np.array([_size(part["window"]) for part in channels])
    levels = []
    parts = list(zip(channels, pixels, _wings(channels, pixels, truth, pixel), strict=True))
    for part, n, light in [*_whole(parts), *parts] if facts.sky is not None else ():
        if n < LEAST:
            continue
        expected = facts.level(part["response"])
        bias = facts.read_noise / np.sqrt(part["overscan"]) if part["overscan"] else 0.0
        sigma = np.hypot(part["noise"] / np.sqrt(n), bias)
        if part["channel"]:
            excess = (part["level"] - expected - light / 2) / expected
            levels.append(ChannelLevel(part["channel"], part["window"], n, excess, light / expected, sigma / expected))
        excess = part["level"] - expected
        excess = min(excess, 0.0) + max(excess - light, 0.0)
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

    Besides, of the halves of the frame less each other (channel None), in which chance is smaller. What objects' light
    may do to a difference is taken off its size.
    """
    if len(levels) < 2:
        return []
    pixels, excess, light, chance = (np.array([getattr(one, k) for one in levels]) for k in ChannelLevel._fields[2:])
    corners = np.array([(one.window[0], one.window[2]) for one in levels])
    everything = np.ones(len(levels), bool)
    pairs: list[tuple[int | None, BoolArray, BoolArray]] = [
        (one.channel, np.arange(len(levels)) == k, everything) for k, one in enumerate(levels)
    ]
    sides = (corners > corners.mean(axis=0)).T
    pairs += [(None, side, ~side) for side in sides if 0 < side.sum() < len(levels)]
    out: list[Deviation] = []
    for channel, *groups in pairs:
        off, other = (
            -np.diff([np.average(v[some], weights=pixels[some]) for some in groups])[0] for v in (excess, light)
        )
        sigma = np.hypot(*(np.sqrt(np.sum((pixels * chance)[some] ** 2)) / pixels[some].sum() for some in groups))
        size = max(abs(off) - abs(other) / 2, 0.0)
        out.append(Deviation(channel, float(np.copysign(size, off)), float(sigma)))
    return out


def _size(window: tuple[int, int, int, int]) -> int:
    x0, x1, y0, y1 = window
    return (x1 - x0) * (y1 - y0)


def _wings(channels: Sequence[Mapping[str, Any]], pixels: IntArray, truth: ObjectTable, pixel: float) -> FloatArray:
    """Return (n,): unmasked light of objects [e- per pixel] that each channel's level may include.

    It is the sum of two means: over the channel, of its own objects' light, and over the frame, of all objects' light.
    An object outside the window counts in the nearest channel, with all its light that falls into the window.
    """
    if not channels or "drawn" not in truth:
        return np.zeros(len(channels))
    drawn = np.nan_to_num(truth["drawn"].astype(float))
    share = np.maximum(OUTSIDE, _outskirts(truth, drawn, np.median([part["noise"] for part in channels]), pixel))
    windows = np.array([part["window"] for part in channels])
    x = np.clip(truth["x"], windows[:, 0].min(), windows[:, 1].max() - 1)
    y = np.clip(truth["y"], windows[:, 2].min(), windows[:, 3].max() - 1)
    outside = np.hypot(truth["x"] - x, truth["y"] - y) > 0.5
    light = np.where((truth["snr"] < FAINT) | outside, 1.0, share) * np.maximum(drawn, 0.0)
    own = [
        light[(x >= x0 - 0.5) & (x < x1 - 0.5) & (y >= y0 - 0.5) & (y < y1 - 0.5)].sum() for x0, x1, y0, y1 in windows
    ]
    return np.array(own) / pixels + light.sum() / pixels.sum()


def _outskirts(truth: ObjectTable, drawn: FloatArray, noise: float, pixel: float) -> FloatArray:
    """Return (n,): share of the light of LARGE galaxies where bulge or disk are fainter than `noise` [e- per pixel]."""
    share = np.zeros(len(drawn))
    for i in np.flatnonzero((half_light(truth) > LARGE * pixel) & (drawn > 0)):
        bulge = float(truth["bulge_frac"][i])
        for name, part, index in (("bulge", bulge, BULGE), ("disk", 1 - bulge, DISK)):
            size = float(truth[f"size_{name}"][i]) / pixel
            index = float(truth[f"n_{name}"][i]) if f"n_{name}" in truth else index
            if part * size > 0:
                radius = brightness_radius(noise * size**2 / (part * drawn[i]), index)
                share[i] += part * float(light_beyond(radius, 1.0, index))
    return share


def _whole(parts: Sequence[tuple[Mapping[str, Any], int, float]]) -> list[tuple[dict[str, Any], int, float]]:
    """Return [(figures, pixels, light)] of all channels together: means weighted with pixels; [] without channels."""
    if not parts:
        return []
    channels, pixels, light = zip(*parts, strict=True)
    names = "level", "noise", "response"
    means = {name: float(np.average([part[name] for part in channels], weights=pixels)) for name in names}
    overscan = sum(part["overscan"] for part in channels)
    return [(means | {"channel": None, "overscan": overscan}, sum(pixels), float(np.average(light, weights=pixels)))]


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
