"""How each layer is shown in the gallery (layer_gallery.py): the layers before it, its scales, a measured number."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from layer_stamp import OBJECTS

from csstsim.base.shipped import SHIPPED
from csstsim.instrument.camera import load_camera
from csstsim.studies.bench.setting import EXPTIME

DETECTOR = load_camera(SHIPPED / "instrument").detector
LIGHT = ("scie_obs", "sky_background")
CHARGE = (*LIGHT, "poisson_and_dark")
FRAME = (*CHARGE, "prescan_overscan")
SCENE = 15, 20, 3e3


@dataclass(frozen=True)
class Cell:
    """The cell of one layer. `number` is a function of (before, after, difference, header of the layer)."""

    base: tuple  # layers that run before it
    what: str
    number: Callable
    grey: tuple  # lowest, width of the linear part, highest of an asinh scale; width None: linear
    colour: tuple  # width and highest; the lowest is its negative
    label: str = "after \u2212 before [e\u207b]"
    difference: Callable = lambda before, after: after - before
    part: tuple = np.s_[:, :]  # the part of the images that is shown


GALLERY = {
    "scie_obs": Cell(
        (), "stars and galaxies of the catalogue, as expected electrons",
        lambda b, a, d, h: f"{d.sum():,.0f} e\u207b of {len(OBJECTS)} objects", (0, 10, 1e5), (10, 1e5),
    ),
    "sky_background": Cell(
        ("scie_obs",), "the sky, reduced by flat field and shutter",
        lambda b, a, d, h: f"{d.mean():.1f} e\u207b, {1 - d.mean() / EXPTIME / h['sky_rate']:.1%} lost",
        (0, 10, 1e5), (None, 80),
    ),
    "led_calib_model": Cell(
        (), "lamps behind the closed shutter (calibration)",
        lambda b, a, d, h: f"{a.mean():,.0f} e\u207b", (0, None, 4e4), (None, 0.02),
        "after / mean \u2212 1 [%]", lambda before, after: 100 * (after / after.mean() - 1),
    ),
    "prnu_effect": Cell(
        LIGHT, "each pixel's own, constant response",
        lambda b, a, d, h: f"rms {np.std(a / b):.2%}", SCENE, (0.5, 300),
    ),
    "cosmic_rays": Cell(
        LIGHT, "straight tracks, diffused by 0.2 px",
        lambda b, a, d, h: f"{h['cosmic_electrons']:,} e\u207b in {h['cosmic_pixels']} px", SCENE, (10, 1e3),
    ),
    "poisson_and_dark": Cell(
        LIGHT, "dark current, and light counted in whole electrons",
        lambda b, a, d, h: f"variance / mean {((d - h['dark_electrons'])**2 / (b + h['dark_electrons'])).mean():.2f}",
        SCENE, (10, 1e3),
    ),
    "brighter_fatter": Cell(
        CHARGE, "charge pushes the boundaries between pixels; a part of the stamp",
        lambda b, a, d, h: f"{abs(d).sum() / 2:,.0f} e\u207b moved", (15, 20, 1e5), (3, 1e4), part=np.s_[33:81, 26:74],
    ),
    "detector_defects": Cell(
        CHARGE, "hot and dead pixels, bad columns",
        lambda b, a, d, h: f"{h['hot_pixels']} hot, {h['dead_pixels']} dead, {h['bad_columns']} column",
        (0, 20, 3e3), (10, 1e4),
    ),
    "blooming": Cell(
        CHARGE, "charge above the full well spills along columns; a part of the stamp",
        lambda b, a, d, h: f"{abs(d).sum() / 2:,.0f} e\u207b from {h['saturated']} px", (15, 20, 1e6), (300, 1e6),
        part=np.s_[16:64, 8:56],
    ),
    "cte_effect": Cell(
        CHARGE, "traps delay electrons on their way down",
        lambda b, a, d, h: f"{-d[d < 0].sum():,.0f} e\u207b held back", SCENE, (3, 1e3),
    ),
    "prescan_overscan": Cell(
        (*CHARGE, "cte_effect"), "empty pixels; those above hold charge deferred by CTE_effect",
        lambda b, a, d, h: f"{a.size - b.size:,} px, {d.sum():,.0f} e\u207b", (0, 20, 3e3), (1, 30),
    ),
    "nonlinearity": Cell(
        CHARGE, "the signal is not proportional to the charge",
        lambda b, a, d, h: f"{(-d / b)[b < 9e4].max():.1%} at {b[b < 9e4].max():,.0f} e\u207b", SCENE, (0.3, 1e4),
    ),
    "bias": Cell(
        FRAME, "an offset for each channel",
        lambda b, a, d, h: "{:.1f} and {:.1f} e\u207b".format(*h["bias"]), (0, None, 800), (None, 10),
        f"after \u2212 before \u2212 {DETECTOR.bias:g} [e\u207b]", lambda before, after: after - before - DETECTOR.bias,
    ),
    "readout_noise": Cell(
        FRAME, "Gaussian noise in every pixel that is read",
        lambda b, a, d, h: f"rms {d.std():.2f} e\u207b", (-20, 20, 3e3), (None, 20),
    ),
    "gain": Cell(
        FRAME, "electrons become DN, a factor for each channel",
        lambda b, a, d, h: "{:.3f} and {:.3f} e\u207b/DN".format(*h["gain"]), (0, 20, 3e3), (0.1, 1e3),
        f"{DETECTOR.gain:g} after \u2212 before [e\u207b]", lambda before, after: DETECTOR.gain * after - before,
    ),
    "quantization_and_output": Cell(
        (*FRAME, "gain"), "whole numbers of 16 bits, 0 to 65535",
        lambda b, a, d, h: f"rms {d[(d != 0) & (abs(d) < 1)].std():.2f} DN, {h['clipped_high']} px held",
        (0, 20, 3e3), (0.05, 1e5), "after \u2212 before [DN]",
    ),
}  # fmt: skip
