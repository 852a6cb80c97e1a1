"""Chips: the position of each science CCD in the mosaic, and its detector (paper, section 2).

Not modelled: chip tilts, height differences and the other sensors of the focal plane.
"""

from dataclasses import dataclass, field
from typing import Annotated, Any

from pydantic import AfterValidator, Field, ValidationInfo

from csstsim.base.model import Data, Number, Whole, between, require
from csstsim.base.types import BoolArray, Floats
from csstsim.instrument.cosmic_rays import CosmicRays
from csstsim.instrument.defects import Defects
from csstsim.instrument.maps.chip_maps import NO_MAPS, ChipMaps
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
    def nx(self) -> int:
        """Columns [px]."""
        return self.x1 - self.x0

    @property
    def ny(self) -> int:
        """Rows [px]."""
        return self.y1 - self.y0

    @property
    def shape(self) -> tuple[int, int]:
        """(ny, nx), the shape of the numpy image."""
        return self.ny, self.nx

    @property
    def slices(self) -> tuple[slice, slice]:
        """The window's slices (rows, columns) in an image of the full chip."""
        return slice(self.y0, self.y1), slice(self.x0, self.x1)

    def contains(self, x: Floats, y: Floats) -> bool | BoolArray:
        """Return whether positions [px, pixel centres at integers; floats or arrays] are on a pixel of the window."""
        return (x >= self.x0 - 0.5) & (x < self.x1 - 0.5) & (y >= self.y0 - 0.5) & (y < self.y1 - 0.5)


def _fits(axis: str) -> AfterValidator:
    """Return the check that the sizes of the channels along an axis add up to that of the chip."""

    def check(size: int, info: ValidationInfo) -> int:
        channels, n = (info.data.get(name) for name in (f"channels_{axis}", f"n{axis}"))
        if channels is not None and n is not None and channels * size != n:
            raise ValueError(f"does not fit: channels_{axis} * channel_n{axis} = {channels * size}, n{axis} = {n}")
        return size

    return AfterValidator(check)


Size = Annotated[Whole, Field(ge=1)]


@dataclass(frozen=True, eq=False, repr=False)
class DetectorNumbers(Data):
    """Parameters of detector.yaml, common to all chips; units are given there."""

    nx: Size
    ny: Size
    # each channel has a letter in the header
    channels_x: Annotated[
        Whole, between(2, 13), require(lambda n: n % 2 == 0, "must be even: half the columns are read out to each side")
    ]
    channels_y: Annotated[Whole, between(2, 2)]  # half the rows are read out to each side
    channel_nx: Annotated[Size, _fits("x")]
    channel_ny: Annotated[Size, _fits("y")]
    prescan: Annotated[Whole, Field(ge=0)]
    overscan: Annotated[Whole, Field(ge=0)]
    parallel_overscan: Annotated[Whole, Field(ge=0)]
    pixel_um: Annotated[Number, between(1, 100)]
    gain: Annotated[Number, between(0.01, 1000)]
    gain_spread: Annotated[Number, between(0, 0.5)]
    bias: Annotated[Number, between(0, 1e6)]
    bias_spread: Annotated[Number, between(0, 1e6)]
    read_noise: Annotated[Number, between(0, 1e4)]
    dark: Annotated[Number, between(0, 1e5)]
    full_well: Annotated[Number, between(1, 1e9)]
    bloom_row_share: Annotated[Number, between(0, 1)]
    adc_max: Annotated[Whole, between(1, 65535)]
    prnu: Annotated[Number, between(0, 0.2)]
    nonlinearity_quadratic: Number
    nonlinearity_cubic: Number
    nonlinearity_spread: Annotated[Number, between(0, 1)]
    readout_time: Annotated[Number, between(0, 1e4)]
    temperature: Annotated[Number, between(0, 400)]


@dataclass(frozen=True)
class Detector(DetectorNumbers):
    """Properties that the chips have in common: detector.yaml, and the effects with separate files."""

    cosmic_rays: CosmicRays | None = None  # None: the instrument folder has no such file
    defects: Defects | None = None
    traps: Traps | None = None
    brighter_fatter: dict[str, Any] = field(default_factory=dict, hash=False)  # brighter_fatter.yaml

    @property
    def channels(self) -> int:
        """The number of readout channels."""
        return self.channels_x * self.channels_y


@dataclass(frozen=True, eq=False, repr=False)
class ChipEntry(Data):
    """An entry of chips.yaml: number (two digits in file names), filter, and position of the chip."""

    id: Annotated[Whole, between(1, 99)]
    filter: str
    row: Size
    column: Size
    xc: Number
    yc: Number
    rotation: Number


@dataclass(frozen=True)
class Chip(ChipEntry):
    """One science CCD.

    `xc`, `yc` are the chip's centre in the mosaic [pixel, origin on the boresight, axes along the chips' x and y];
    `rotation` is the chip's rotation about that centre [deg, from mosaic +x towards +y].
    """

    kind: str  # "imaging" or "slitless"
    detector: Detector
    telescope: Telescope
    maps: ChipMaps = field(default=NO_MAPS, repr=False, compare=False)  # laboratory maps

    @property
    def label(self) -> str:
        """The number with two digits, as in file names."""
        return f"{self.id:02d}"

    @property
    def full_window(self) -> Window:
        """The Window of all active pixels."""
        return Window(0, self.detector.nx, 0, self.detector.ny)
