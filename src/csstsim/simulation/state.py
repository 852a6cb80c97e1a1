"""State: what a layer gets and gives back (paper, section 4.3)."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from csstsim.optics.throughput.response import response_map


@dataclass
class State:
    """The simulation of one exposure on one chip, as it stands between two layers.

    `image` is float32, changed in place: expected electrons until `poisson_and_dark`, then charge, then DN
    (units in `unit`). Before `prescan_overscan` its shape is that of `window`; after it, that of the
    window's readout frame (detector.channels). `counted` holds electrons that are already Poisson
    (int32, same shape) or None; `poisson_and_dark` merges it. `mask`, if the layers' list asks for one, is uint8 of the
    image's shape (detector.mask). `trailed` is charge that trails into the overscan (detector.charge_transfer).
    `header` gathers what layers add to the Level-0 header as {name: value}, JSON-like values only; `truth` is the table
    of drawn objects.
    """

    chip: Any  # instrument.chip.Chip
    filter: Any  # instrument.filter.Filter
    telescope: Any  # instrument.telescope.Telescope
    pointing: Any  # instrument.pointing.Pointing
    catalog: Any  # catalog.table.ObjectTable of this chip, or None
    window: Any  # instrument.chip.Window
    wcs: Any  # optics.geometry.wcs.ChipWCS
    image: np.ndarray
    counted: np.ndarray | None = None
    mask: np.ndarray | None = None
    trailed: Any = None  # detector.charge_transfer.transfer.Trails, or None
    cosmic_rays: tuple | None = None  # (flat indices in the window, electrons) to be written, if asked for
    psf: Any = None  # optics.psf.psf_set.PsfSet, or None for exposures without objects
    tables: Any = None  # render.psf_table.PsfTable of `psf`; None for the reference renderer
    fidelity: str = "standard"  # the campaign's: how objects are drawn
    unit: str = "electron"
    header: dict = field(default_factory=dict)
    truth: Any = None
    orders: Any = None  # truth of a slitless chip, order by order (io.orders), or None
    prnu: bool = False  # light meets the pixels' response (PRNU_effect is in the list)
    leds: Any = None  # leds.yaml as instrument.load.read_data gives it, for flat fields and lamps
    gratings: Any = None  # instrument.grating.Gratings of a slitless chip
    spectra: Any = None  # catalog.light.object_spectra.Spectra of the objects of a slitless chip
    sky: Any = None  # sky.yaml as instrument.load.read_data gives it, for the stray-light model
    _response: tuple = (None, None)  # what `response` gave last

    def response(self, exptime, rng, *, flat, shutter):
        """Return the response_map (optics.throughput) of this chip and window, made once for layers that ask the same.

        rng: the asking layer's rng.Streams.
        """
        wanted = exptime, flat, shutter
        if self._response[0] != wanted:
            made = response_map(
                self.chip, self.window, self.filter, exptime, self.leds, rng.camera, flat=flat, shutter=shutter,
                prnu=rng.chip_key("prnu") if self.prnu else None,
            )  # fmt: skip
            self._response = wanted, made
        return self._response[1]

    def electrons(self):
        """Return the electrons in both planes, a float64 sum."""
        return sum(float(plane.sum(dtype=np.float64)) for plane in (self.image, self.counted) if plane is not None)

    def forget(self):
        """Drop what is kept only to save time."""
        self._response = None, None
