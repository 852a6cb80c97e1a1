"""State: what a layer takes and returns (paper, section 4.3)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from csstsim.detector.sparse_plane import SparsePlane
from csstsim.optics.throughput.flat import FlatField
from csstsim.optics.throughput.response import response_map

if TYPE_CHECKING:  # names alone: a stage imports what it uses
    from csstsim.base.rng import Streams
    from csstsim.base.types import FloatArray, IntArray
    from csstsim.catalog.light.object_spectra import Spectra
    from csstsim.catalog.table import ObjectTable
    from csstsim.detector.charge_transfer.transfer import Trails
    from csstsim.optics.psf.psf_file import PsfSet
    from csstsim.render.psf_table import PsfTable
    from csstsim.simulation.exposure import Exposure


@dataclass
class State:
    """The simulation of one exposure of one chip, between two layers.

    `image` is float32, changed in place: expected electrons until `poisson_and_dark`, then charge, then DN
    (units in `unit`). Before `prescan_overscan` its shape is that of `window`; after it, that of the window's readout
    frame (detector.channels). `header` is what layers add to the Level-0 header, the user's own layers to its HISTORY:
    {name: value}, JSON-like values only. chip, filter, telescope, pointing, window and wcs are the exposure's.
    """

    exposure: Exposure
    image: np.ndarray
    catalog: ObjectTable | None = None  # objects that reach the window
    spectra: Spectra | None = None  # theirs, of a slitless chip
    psf: PsfSet | None = None
    tables: PsfTable | None = None  # of `psf`; the reference renderer needs none
    mask: np.ndarray | None = None  # uint8 of the image's shape (detector.mask)
    trailed: Trails | None = None  # charge that trails into the overscan
    cosmic_rays: tuple[np.ndarray, np.ndarray] | None = None  # (flat indices in the window, electrons) to be written
    unit: str = "electron"
    header: dict[str, Any] = field(default_factory=dict)
    truth: ObjectTable | None = None  # rendered objects
    orders: ObjectTable | None = None  # those of a slitless chip, order by order (io.orders)
    _counted: IntArray | SparsePlane | None = None
    _response: FloatArray | None = None  # what `response` gave last, if it was asked for
    _response_made: bool = False

    chip = property(lambda self: self.exposure.chip, doc="instrument.chip.Chip")
    filter = property(lambda self: self.exposure.filter, doc="instrument.filter.Filter")
    telescope = property(lambda self: self.exposure.telescope, doc="instrument.telescope.Telescope")
    pointing = property(lambda self: self.exposure.pointing, doc="instrument.pointing.Pointing")
    window = property(lambda self: self.exposure.window, doc="instrument.chip.Window")
    wcs = property(lambda self: self.exposure.wcs, doc="optics.geometry.wcs.ChipWCS")

    @classmethod
    def blank(cls, exposure: Exposure, objects: ObjectTable | None = None) -> Self:
        """Return the State of an Exposure before its first layer: planes of the window (ny, nx) without light.

        objects: its catalogue, or None.
        """
        shape = exposure.window.shape
        mask = np.zeros(shape, np.uint8) if exposure.mask else None
        return cls(exposure, np.zeros(shape, np.float32), objects, mask=mask)

    @property
    def counted(self) -> IntArray | None:
        """Electrons that are already Poisson, (ny, nx) int32 as `image`; None: there are none.

        `poisson_and_dark` merges them. They may be set to a SparsePlane, and are kept as one until they are asked for.
        """
        if isinstance(self._counted, SparsePlane):
            self._counted = self._counted.dense()
        return self._counted

    @counted.setter
    def counted(self, plane: IntArray | SparsePlane | None) -> None:
        self._counted = plane

    def response(self, rng: Streams) -> FloatArray | None:
        """Return the response_map (optics.throughput) of this exposure, made once for all layers that ask.

        rng: the asking layer's rng.Streams.
        """
        if not self._response_made:
            asked = self.exposure
            losses = asked.losses
            self._response = response_map(
                asked.chip,
                asked.window,
                asked.filter,
                asked.exptime,
                flat=FlatField(asked.camera.leds, rng.camera) if losses.flat else None,
                shutter=losses.shutter,
                prnu=rng.chip_key("prnu") if losses.prnu else None,
            )
            self._response_made = True
        return self._response

    def electrons(self) -> float:
        """Return the electrons in both planes, a float64 sum."""
        return sum(float(plane.sum(dtype=np.float64)) for plane in (self.image, self.counted) if plane is not None)

    def add_counted(self, pixel: IntArray, electrons: IntArray) -> None:
        """Add electrons (n,) int32 to the counted ones, at ascending flat indices (n,) of the window."""
        if isinstance(self._counted, np.ndarray):
            self._counted.reshape(-1)[pixel] += electrons
        else:
            held = self._counted or SparsePlane(self.window.shape, *np.zeros((2, 0), np.int32))
            self._counted = held.plus(pixel.astype(np.int32), electrons)

    def take_counted(self) -> IntArray | SparsePlane | None:
        """Return the counted electrons as they are kept, an array, a SparsePlane or None; none are left."""
        taken = self._counted
        self._counted = None
        return taken

    def forget(self) -> None:
        """Drop what is kept only to save time."""
        self._response = None
        self._response_made = False
