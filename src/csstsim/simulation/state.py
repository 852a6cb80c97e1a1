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

    chip, filter, telescope, pointing, window and wcs are those of the exposure.

    Attributes
    ----------
    exposure : Exposure
        The exposure. A layer must not replace it.
    image : array of float32
        Changed in place: expected electrons until `poisson_and_dark`, then charge [electron], then DN. Before
        `prescan_overscan` its shape (ny, nx) is that of `window`; after it, that of the window's readout frame
        (detector.channels).
    catalog : ObjectTable or None
        Objects that reach the window.
    spectra : Spectra or None
        Their spectra, on a slitless chip.
    psf : PsfSet or None
        The chip's PSFs.
    tables : PsfTable or None
        Tables of `psf` for rendering; the reference renderer needs none.
    mask : array of uint8 or None
        Bits of detector.mask, in the shape of `image`.
    trailed : Trails or None
        Charge that trails into the overscan.
    cosmic_rays : (array of int, array of float) or None
        Flat indices (n,) in the window, and electrons (n,), of cosmic rays that are to be written.
    unit : str
        Unit of `image`: "electron" or "DN".
    header : dict
        What layers add to the Level-0 header, and a user's own layers to its HISTORY: {name: JSON-like value}.
    truth : ObjectTable or None
        Rendered objects.
    orders : ObjectTable or None
        Those of a slitless chip, one row per order (io.orders).
    """

    exposure: Exposure
    image: np.ndarray
    catalog: ObjectTable | None = None
    spectra: Spectra | None = None
    psf: PsfSet | None = None
    tables: PsfTable | None = None
    mask: np.ndarray | None = None
    trailed: Trails | None = None
    cosmic_rays: tuple[np.ndarray, np.ndarray] | None = None
    unit: str = "electron"
    header: dict[str, Any] = field(default_factory=dict)
    truth: ObjectTable | None = None
    orders: ObjectTable | None = None
    _counted: IntArray | SparsePlane | None = None
    _response: FloatArray | None = None  # the last result of `response`, if it was called
    _response_made: bool = False

    chip = property(lambda self: self.exposure.chip, doc="instrument.chip.Chip")
    filter = property(lambda self: self.exposure.filter, doc="instrument.filter.Filter")
    telescope = property(lambda self: self.exposure.telescope, doc="instrument.telescope.Telescope")
    pointing = property(lambda self: self.exposure.pointing, doc="instrument.pointing.Pointing")
    window = property(lambda self: self.exposure.window, doc="instrument.chip.Window")
    wcs = property(lambda self: self.exposure.wcs, doc="optics.geometry.wcs.ChipWCS")

    @classmethod
    def blank(cls, exposure: Exposure, objects: ObjectTable | None = None) -> Self:
        """Return the State of an exposure before its first layer: planes of the window (ny, nx) that are zero.

        Parameters
        ----------
        exposure : Exposure
            The exposure.
        objects : ObjectTable, optional
            Its catalogue.

        Returns
        -------
        State
            Without electrons, header and truth.
        """
        shape = exposure.window.shape
        mask = np.zeros(shape, np.uint8) if exposure.mask else None
        return cls(exposure, np.zeros(shape, np.float32), objects, mask=mask)

    @property
    def counted(self) -> IntArray | None:
        """Electrons with Poisson noise, (ny, nx) int32 as `image`, or None.

        `poisson_and_dark` merges them. A SparsePlane may be assigned; it becomes an array when it is first read.
        """
        if isinstance(self._counted, SparsePlane):
            self._counted = self._counted.dense()
        return self._counted

    @counted.setter
    def counted(self, plane: IntArray | SparsePlane | None) -> None:
        self._counted = plane

    def response(self, rng: Streams) -> FloatArray | None:
        """Return the response map of this exposure (optics.throughput.response), computed once for all layers.

        Parameters
        ----------
        rng : Streams
            The random streams of the layer that asks.

        Returns
        -------
        (ny, nx) array of float32 or None
            Fraction of the nominal flux that each pixel detects; None if the layers have no losses.
        """
        if not self._response_made:
            exposure = self.exposure
            losses = exposure.losses
            self._response = response_map(
                exposure.chip,
                exposure.window,
                exposure.filter,
                exposure.exptime,
                flat=FlatField(exposure.camera.leds, rng.camera) if losses.flat else None,
                shutter=losses.shutter,
                prnu=rng.chip_key("prnu") if losses.prnu else None,
            )
            self._response_made = True
        return self._response

    def electrons(self) -> float:
        """Return the electrons in both planes.

        Returns
        -------
        float
            Sum of `image` and `counted`, in float64 [electron].
        """
        return sum(float(plane.sum(dtype=np.float64)) for plane in (self.image, self.counted) if plane is not None)

    def add_counted(self, pixel: IntArray, electrons: IntArray) -> None:
        """Add electrons with Poisson noise to `counted`.

        Parameters
        ----------
        pixel : (n,) array of int
            Flat indices in the window, ascending.
        electrons : (n,) array of int32
            Number of electrons to add [electron].
        """
        if isinstance(self._counted, np.ndarray):
            self._counted.reshape(-1)[pixel] += electrons
        else:
            plane = self._counted or SparsePlane(self.window.shape, *np.zeros((2, 0), np.int32))
            self._counted = plane.plus(pixel.astype(np.int32), electrons)

    def take_counted(self) -> IntArray | SparsePlane | None:
        """Return the counted electrons in the form in which they are stored, and set them to None.

        Returns
        -------
        (ny, nx) array of int32, SparsePlane or None
            The electrons [electron].
        """
        taken = self._counted
        self._counted = None
        return taken

    def forget(self) -> None:
        """Drop what is stored only to save time."""
        self._response = None
        self._response_made = False
