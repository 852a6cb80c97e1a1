"""Drawing: the optics, exposure time and fidelity with which the objects of a chip are rendered."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from csstsim.catalog.astrometry.ephemeris import Observer
from csstsim.catalog.changing.motion import Interval
from csstsim.optics.geometry.wcs import ChipWCS
from csstsim.optics.psf.psf_file import PsfSet
from csstsim.optics.scatter.scattered_light import Scattered
from csstsim.render.psf_mixture import Mixer
from csstsim.render.psf_table import PsfTable

if TYPE_CHECKING:
    from csstsim.optics.scatter.ghosts import Ghosts
    from csstsim.optics.scatter.halo import Wing


@dataclass(frozen=True, eq=False)
class Drawing:
    """Everything that the image of an object depends on besides the object itself."""

    wcs: ChipWCS
    psf: PsfSet
    exptime: float  # s
    scattered: Scattered | None = None  # light beyond the PSF's box; None: only stamps are rendered
    fidelity: str = "standard"  # a preset of config/render.yaml, or "reference"
    variance: float = 0.0  # of a pixel without objects [e-^2]
    key: np.uint64 | None = None  # of the exposure's random numbers, for photons
    tables: PsfTable | None = None  # of the PSF, for photons
    observer: Observer | None = None  # with interval, for objects that move
    interval: Interval | None = None
    cached_mixer: Mixer | None = None  # of the PSF; a second call with it takes about 10 ms less

    @cached_property
    def mixer(self) -> Mixer:
        """The Mixer of the PSF."""
        return self.cached_mixer or Mixer(self.psf)

    @property
    def wing(self) -> Wing | None:
        """The PSF's wing, or None."""
        return None if self.scattered is None else self.scattered.wing

    @property
    def ghosts(self) -> Ghosts | None:
        """The filter's ghosts, or None."""
        return None if self.scattered is None else self.scattered.ghosts
