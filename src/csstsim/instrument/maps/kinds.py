"""The kinds of laboratory maps, and the allowed values of each.

    led_flats    internal flat at an LED's wavelength, without the response of single pixels; 1: the mosaic's mean level
    prnu         response of each pixel relative to its neighbours
    bad_pixels   bits HOT, DEAD and BAD_COLUMN of the truth mask; 0: a good pixel
    bias         structure of the bias in electrons, in addition to the levels of the channels

A pixel with response 0 could not be calibrated, so dead pixels are listed in bad_pixels only.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from csstsim.base.types import AnyArray

if TYPE_CHECKING:
    from csstsim.instrument.chip import Detector

DEFECTS = {"HOT": 8, "DEAD": 16, "BAD_COLUMN": 32}  # as in detector.mask, which depends on numpy only


@dataclass(frozen=True)
class MapKind:
    """The format of a kind of map, and the limits of its values and of their mean.

    The mean of bad_pixels is the fraction of bad pixels. loss: the map multiplies flux, so its header must have
    DATAMAX.
    """

    name: str
    stored: str  # numpy type in the FITS file
    low: float
    high: float
    mean_low: float
    mean_high: float
    unit: str
    loss: bool = False
    readout: bool = False  # it covers the readout frame, not only the active pixels

    def shapes(self, detector: "Detector") -> dict[tuple[int, int], str]:
        """Return {(ny, nx): layout} of the allowed shapes."""
        if not self.readout:
            return {(detector.ny, detector.nx): "active"}
        ny = detector.channel_ny + detector.parallel_overscan
        nx = detector.prescan + detector.channel_nx + detector.overscan
        mosaic = ny * detector.channels_y, nx * detector.channels_x
        return {(ny, nx * detector.channels): "channels", mosaic: "mosaic"}  # as in detector.channels.LAYOUTS

    def mean(self, values: AnyArray) -> float:
        """Return the mean of values (ny, nx) that mean_low and mean_high limit."""
        return float((values > 0).mean() if self.name == "bad_pixels" else values.mean(dtype=float))


KINDS = {
    kind.name: kind
    for kind in (
        MapKind("led_flats", ">f4", 0.1, 2.0, 0.5, 1.5, "relative", loss=True),
        MapKind("prnu", ">f4", 0.1, 2.0, 0.95, 1.05, "relative", loss=True),
        MapKind("bad_pixels", "u1", 0, sum(DEFECTS.values()), 0.0, 0.1, "bits of the truth mask"),
        MapKind("bias", ">f4", -1000.0, 1000.0, -1.0, 1.0, "e-", readout=True),
    )
}
