"""The kinds of laboratory maps, and what the values of each may be.

    led_flats    internal flat of an LED's wavelength, without the pixels' own response; 1: the mosaic's mean level
    prnu         response of each pixel relative to its neighbours
    bad_pixels   bits HOT, DEAD and BAD_COLUMN of the truth mask; 0: a good pixel
    bias         structure of the bias in electrons, in addition to the levels of the channels

A response of 0 would make light of a pixel unknowable, so dead pixels belong into bad_pixels alone.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from csstsim.base.types import AnyArray

if TYPE_CHECKING:
    from csstsim.instrument.chip import Detector

DEFECTS = {"HOT": 8, "DEAD": 16, "BAD_COLUMN": 32}  # as of detector.mask, which knows arrays only


@dataclass(frozen=True)
class Kind:
    """What a map of a kind holds: its numpy type as FITS stores it, and bounds of its values and of their mean.

    loss: it multiplies light, so its header must declare DATAMAX; a bad_pixels map's mean is its share of bad pixels.
    """

    name: str
    stored: str
    low: float
    high: float
    mean_low: float
    mean_high: float
    unit: str
    loss: bool = False
    readout: bool = False  # it covers the readout frame, not the active pixels alone

    def shapes(self, detector: "Detector") -> dict[tuple[int, int], str]:
        """Return {(ny, nx): layout} of the shapes that a map may have."""
        if not self.readout:
            return {(detector.ny, detector.nx): "active"}
        ny = detector.channel_ny + detector.parallel_overscan
        nx = detector.prescan + detector.channel_nx + detector.overscan
        mosaic = ny * detector.channels_y, nx * detector.channels_x
        return {(ny, nx * detector.channels): "channels", mosaic: "mosaic"}  # as of detector.channels.LAYOUTS

    def mean(self, values: AnyArray) -> float:
        """Return what the mean's bounds are for."""
        return float((values > 0).mean() if self.name == "bad_pixels" else values.mean(dtype=float))


KINDS = {
    kind.name: kind
    for kind in (
        Kind("led_flats", ">f4", 0.1, 2.0, 0.5, 1.5, "relative", loss=True),
        Kind("prnu", ">f4", 0.1, 2.0, 0.95, 1.05, "relative", loss=True),
        Kind("bad_pixels", "u1", 0, sum(DEFECTS.values()), 0.0, 0.1, "bits of the truth mask"),
        Kind("bias", ">f4", -1000.0, 1000.0, -1.0, 1.0, "e-", readout=True),
    )
}
