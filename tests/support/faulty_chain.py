"""Faults for a campaign's chain: each is a context in which one step of one exposure goes wrong, as by a bug.

A fault changes the chain's own functions, never the products; `STAGE` is the first stage that it affects: chip, measure
or merge.
"""

from dataclasses import dataclass, replace
from typing import Any
from unittest.mock import patch

import numpy as np
from scipy.ndimage import convolve1d

from csstsim.base.rng import stream
from csstsim.instrument.filter import Filter
from csstsim.io import level0_writing
from csstsim.layers import gain, poisson_and_dark, readout_noise, scie_obs, sky_background
from csstsim.measure import catalogue
from csstsim.measure.bricks import merge
from csstsim.measure.bricks.validation.gates.register import gate_named
from csstsim.measure.calibration.bad_pixels import FULL
from csstsim.optics.geometry.wcs import ChipWCS
from csstsim.stages import calibrate as calibrate_stage
from csstsim.stages import measure as measure_stage


@dataclass(frozen=True)
class Fault:
    """What goes wrong in words; the context; its first stage; the gate that must fail."""

    words: str
    context: Any
    stage: str
    gate: str

    def __post_init__(self):
        gate_named(self.gate)  # KeyError for a gate that does not exist


def after(module, change):
    """Return a context in which layer `module` is followed by change(state)."""
    right = module.apply

    def wrong(state, param, rng):
        state = right(state, param, rng)
        change(state)
        return state

    return patch.object(module, "apply", wrong)


def more_noise(state):
    """Add noise until the frame's is twice that of sky, dark current and readout."""
    detector = state.chip.detector
    variance = (state.filter.sky + detector.dark) * state.pointing.exptime + detector.read_noise**2
    rng = stream(5, "noise doubled", state.pointing.time)
    state.image += np.sqrt(3 * variance) * rng.standard_normal(state.image.shape, np.float32)


def stated_gain(state):
    state.header["gain"] = [1.02 * value for value in state.header["gain"]]


def true_gain(state):
    state.image /= np.float32(1.02)


def half_gain(state):
    """The left half of the window counts 2% more electrons than there are; bias and overscan are right."""
    state.image[:, : state.image.shape[1] // 2] *= np.float32(1.02)


def dead_channel(state):
    """The amplifier of the frame's fourth channel gives its bias and noise alone."""
    from csstsim.detector.channels import ReadoutFrame

    frame = ReadoutFrame.of(state.chip.detector, state.window)
    block = frame.blocks[3]
    over = state.image[block.serial_overscan]
    rng = stream(5, "dead", state.pointing.time)
    state.image[block.active] = rng.normal(over.mean(), over.std(), state.image[block.active].shape)


def brighter_sky():
    right = sky_background.apply

    def wrong(state, param, rng):
        filter_, camera, exposure = state.filter, state.exposure.camera, state.exposure
        brighter = {filter_.name: replace(filter_, sky=1.05 * filter_.sky)}
        state.exposure = replace(exposure, camera=replace(camera, filters=camera.filters | brighter))
        state = right(state, param, rng)
        state.exposure = exposure
        return state

    return patch.object(sky_background, "apply", wrong)


def wider_psf():
    """Stars 5% wider: the expectation of all light, blurred by the second moment that is missing."""
    right = scie_obs.apply

    def wrong(state, param, rng):
        kept, state.exposure = state.exposure, replace(state.exposure, fidelity="noise_free")
        state = right(state, param, rng)
        state.exposure = kept
        share = 0.5 * (1.05**2 - 1) * PSF_SIGMA**2
        for axis in (0, 1):
            state.image = convolve1d(state.image, np.array([share, 1 - 2 * share, share], np.float32), axis=axis)
        return state

    return patch.object(scie_obs, "apply", wrong)


PSF_SIGMA = 1.0  # px, about that of stars in g and r


def header_wcs():
    right = level0_writing.wcs_cards

    class Shifted:
        def __init__(self, wcs):
            self.distortion, self._wcs = wcs.distortion, wcs

        def header(self):
            cards = self._wcs.header()
            return cards | {"CRPIX1": cards["CRPIX1"] + 0.3}

    def wrong(wcs, *others):
        return right(Shifted(wcs), *others)

    return patch.object(level0_writing, "wcs_cards", wrong)


def header_exptime():
    right = level0_writing.header_values

    def wrong(*arguments):
        values = right(*arguments)
        return values | {"exptime": values["exptime"] - 1.0}

    return patch.object(level0_writing, "header_values", wrong)


def code_wcs():
    right = ChipWCS.pixel_to_world
    return patch.object(ChipWCS, "pixel_to_world", lambda wcs, x, y: right(wcs, np.asarray(x) + 0.3, y))


def zero_point():
    right = Filter.zeropoint
    return patch.object(Filter, "zeropoint", lambda band, telescope: right(band, telescope) + 2.5 * np.log10(1.02))


def shear_sign():
    right = catalogue.measure_frame

    def wrong(*arguments, **named):
        table = right(*arguments, **named)
        return table.with_columns(g2=-table["g2"])

    return patch.object(catalogue, "measure_frame", wrong)


def galaxies_undetected():
    """A quarter of the galaxies are lost from the exposure's list."""
    right = catalogue.measure_frame

    def wrong(*arguments, **named):
        table = right(*arguments, **named)
        return table.take(table["star"] | (stream(5, "undetected").uniform(size=len(table)) > 0.25))

    return patch.object(catalogue, "measure_frame", wrong)


def no_saturation():
    right = calibrate_stage.calibrated_frame

    def wrong(*arguments):
        file, calibrated = right(*arguments)
        return file, replace(calibrated, marks=calibrated.marks & ~FULL)

    return patch.object(measure_stage, "calibrated_frame", wrong)


def small_errors():
    right = catalogue.measure_frame

    def wrong(*arguments, **named):
        table = right(*arguments, **named)
        return table.with_columns(flux_psf_err=0.33 * table["flux_psf_err"])

    return patch.object(catalogue, "measure_frame", wrong)


def lost_galaxies():
    """A tenth of the galaxies are lost from the merged catalogue."""
    right = merge.merge_brick

    def wrong(*arguments, **named):
        sources, detections = right(*arguments, **named)
        kept = (sources["star"] > 0.5) | (stream(5, "lost").uniform(size=len(sources)) > 0.1)
        row = np.cumsum(kept) - 1
        detections = detections.take(kept[detections["source"]])
        return sources.take(kept), detections.with_columns(source=row[detections["source"]])

    return patch.object(merge, "merge_brick", wrong)


def twice():
    """A tenth of the sources come apart in the merge: one detection of each stands alone."""
    right = merge.associate

    def wrong(vectors, errors, frame):
        source = right(vectors, errors, frame)
        count = int(source.max(initial=-1)) + 1
        first = np.unique(source, return_index=True)[1]
        some = first[stream(5, "twice").uniform(size=count) < 0.1]
        source = source.copy()
        source[some] = count + np.arange(len(some))
        return np.unique(source, return_inverse=True)[1]

    return patch.object(merge, "associate", wrong)


def layer(module, change):
    return lambda: after(module, change)


FAULTS = (
    Fault("noise doubled in one of two exposures", layer(readout_noise, more_noise), "chip",
          "noise over that of sky, dark and readout, less 1"),
    Fault("header's WCS 0.3 px off", header_wcs, "chip", "position by the header's WCS [px]"),
    Fault("GAIN of the header 2% wrong", layer(gain, stated_gain), "chip", "header: gain over the camera's, less 1"),
    Fault("code's WCS 0.3 px off in one of four exposures", code_wcs, "measure",
          "astrometric offset of an exposure [mas]"),
    Fault("amplifiers' true gain 2% off that stated", layer(gain, true_gain), "chip",
          "bias of the overscan less the header's [DN]"),
    Fault("2% of gain in the pixels of half a window", layer(poisson_and_dark, half_gain), "chip",
          "background of a channel over that of all, less 1"),
    Fault("sky 5% too bright", brighter_sky, "chip", "background over sky and dark, less 1"),
    Fault("one channel dead", layer(gain, dead_channel), "chip", "background over sky and dark, less 1"),
    Fault("zero point 2% off", zero_point, "measure", "zero point of an exposure [mag]"),
    Fault("PSF 5% too wide", wider_psf, "chip", "star size over PSF model, less 1"),
    Fault("EXPTIME of the header 1 s short", header_exptime, "chip",
          "header: exposure time over the campaign's, less 1"),
    Fault("sign of g2 turned", shear_sign, "measure", "shape response minus 1"),
    Fault("saturated pixels unknown", no_saturation, "measure", "saturated stars with the flag"),
    Fault("flux errors a third of what they are", small_errors, "measure", "width of stars' pulls"),
    Fault("a quarter of the galaxies undetected", galaxies_undetected, "measure", "completeness of galaxies"),
    Fault("a tenth of the galaxies lost in the merge", lost_galaxies, "merge",
          "galaxies found in an exposure, lost in the merge"),
    Fault("a tenth of the sources twice", twice, "merge", "sources counted twice"),
)  # fmt: skip
