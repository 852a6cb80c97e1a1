"""Exposure: one exposure of one chip. Everything its layers look up is resolved once, before any work."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:  # names alone: a stage imports what it uses
    from csstsim.base.types import FloatArray
    from csstsim.catalog.astrometry.ephemeris import Observer
    from csstsim.catalog.changing.motion import Interval
    from csstsim.instrument.camera import Camera
    from csstsim.instrument.chip import Chip, Window
    from csstsim.instrument.filter import Filter
    from csstsim.instrument.grating import Gratings
    from csstsim.instrument.pointing import Pointing
    from csstsim.instrument.telescope import Telescope
    from csstsim.optics.geometry.wcs import ChipWCS


class Losses(NamedTuple):
    """Whether flux is lost in an exposure (optics.throughput.response), the same for every layer that adds electrons.

    Attributes
    ----------
    flat : bool
        By the flat field.
    shutter : bool
        By the shutter, which opens and closes over the chip.
    prnu : bool
        By the response of single pixels.
    """

    flat: bool = False
    shutter: bool = False
    prnu: bool = False


NO_LOSSES = Losses()


@dataclass(frozen=True)
class Exposure:
    """One exposure of one chip, and the window of it that is simulated.

    Attributes
    ----------
    pointing : Pointing
        With the exposure time that the layers request (SimSteps.timed).
    chip : Chip
        The detector and its position in the focal plane.
    window : Window
        x0, x1, y0, y1 [pixel] on the chip.
    wcs : ChipWCS
        Sky to pixels, with the field distortion of the layers.
    camera : Camera
        All chips, filters and the telescope.
    spacecraft : Observer or None
        At the start of the exposure; None for an exposure that was made without a campaign.
    losses : Losses
        Which losses of flux the layers have.
    mask : bool
        Whether a truth mask is made.
    fidelity : str
        The campaign's: how objects are rendered.
    """

    pointing: Pointing
    chip: Chip
    window: Window
    wcs: ChipWCS
    camera: Camera = field(repr=False, compare=False)
    spacecraft: Observer | None = None
    losses: Losses = NO_LOSSES
    mask: bool = False
    fidelity: str = "standard"

    @property
    def exptime(self) -> float:
        """Exposure time [s]."""
        return self.pointing.exptime

    @property
    def observer(self) -> Observer:
        """The spacecraft's position and velocity at the start of the exposure.

        Raises
        ------
        ValueError
            For an exposure that was made without a campaign.
        """
        if self.spacecraft is None:
            raise ValueError("the exposure was made without a campaign: no orbit is known")
        return self.spacecraft

    @property
    def filter(self) -> Filter:
        """The chip's filter or grating."""
        return self.camera.filters[self.chip.filter]

    @property
    def telescope(self) -> Telescope:
        """The camera's telescope."""
        return self.camera.telescope

    @cached_property
    def interval(self) -> Interval:
        """The exposure as catalog.changing.motion.Interval, with the shutter's times if the layers have them."""
        from functools import partial

        from csstsim.catalog.changing.motion import Interval
        from csstsim.optics.throughput.shutter import lost

        return Interval(self.pointing.mjd, self.exptime, partial(lost, self.chip) if self.losses.shutter else None)

    @cached_property
    def gratings(self) -> Gratings | None:
        """The gratings that disperse the light of the sky, or None."""
        dispersed = self.chip.kind == "slitless" and self.pointing.type == "SCIE"
        return self.camera.gratings[self.chip.id] if dispersed else None

    def footprint(self, margin_px: float = 0.0) -> tuple[FloatArray, FloatArray]:
        """Return the corners of the window on the sky: ICRS at the epoch, not apparent.

        Parameters
        ----------
        margin_px : float
            Margin around the window [pixel].

        Returns
        -------
        ra, dec : (4,) array of float
            Position of each corner [deg].
        """
        from csstsim.catalog.astrometry.reduction import icrs

        return icrs(*self.wcs.footprint(self.window, margin_px), self.observer)
