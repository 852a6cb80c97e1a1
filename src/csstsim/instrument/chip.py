"""Chips: where each of the 30 science CCDs sits in the mosaic and what its detector is like (paper, section 2).

Left out: chip tilts, height differences and the other sensors of the focal plane.
"""

from dataclasses import dataclass, field
from typing import Any

from csstsim.instrument.cosmic_rays import CosmicRays
from csstsim.instrument.defects import Defects
from csstsim.instrument.telescope import Telescope
from csstsim.instrument.traps import Traps


@dataclass(frozen=True)
class Window:
    """A rectangle of active pixels, half-open: x0 <= column < x1, y0 <= row < y1."""

    x0: int
    x1: int
    y0: int
    y1: int

    @property
    def nx(self):
        """Columns [px]."""
        return self.x1 - self.x0

    @property
    def ny(self):
        """Rows [px]."""
        return self.y1 - self.y0

    @property
    def shape(self):
        """(ny, nx), as of the numpy image."""
        return self.ny, self.nx

    @property
    def slices(self):
        """Of the window in an image of the whole chip."""
        return slice(self.y0, self.y1), slice(self.x0, self.x1)

    def contains(self, x, y):
        """Whether positions (pixel, pixel centres at integers; float or arrays) fall on a pixel of the window."""
        return (x >= self.x0 - 0.5) & (x < self.x1 - 0.5) & (y >= self.y0 - 0.5) & (y < self.y1 - 0.5)


@dataclass(frozen=True)
class Detector:
    """What the 30 chips have in common; units in config/instrument/detector.yaml."""

    nx: int
    ny: int
    channels_x: int
    channels_y: int
    channel_nx: int
    channel_ny: int
    prescan: int
    overscan: int
    parallel_overscan: int
    pixel_um: float
    gain: float
    gain_spread: float
    bias: float
    bias_spread: float
    read_noise: float
    dark: float
    full_well: float
    bloom_row_share: float
    adc_max: int
    prnu: float
    nonlinearity_quadratic: float
    nonlinearity_cubic: float
    nonlinearity_spread: float
    readout_time: float
    temperature: float
    cosmic_rays: CosmicRays | None = None  # None: no such file in the instrument folder
    defects: Defects | None = None
    traps: Traps | None = None
    brighter_fatter: dict[str, Any] = field(default_factory=dict, hash=False)  # brighter_fatter.yaml

    @property
    def channels(self):
        """The number of readout channels."""
        return self.channels_x * self.channels_y


@dataclass(frozen=True)
class Chip:
    """One science CCD.

    `xc`, `yc` is the chip's centre in the mosaic [pixel, origin on the boresight, +x and +y as the chips'];
    `rotation` is the chip's own turn about that centre [deg, from mosaic +x towards +y].
    """

    id: int
    filter: str
    kind: str  # "imaging" or "slitless"
    row: int
    column: int
    xc: float
    yc: float
    rotation: float
    detector: Detector
    telescope: Telescope

    @property
    def label(self):
        """Two digits, as in file names."""
        return f"{self.id:02d}"

    @property
    def full_window(self):
        """The Window of all active pixels."""
        return Window(0, self.detector.nx, 0, self.detector.ny)
