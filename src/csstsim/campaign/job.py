"""The unit of work: one exposure on one chip."""

from dataclasses import dataclass

from csstsim.catalog.places.astrometry import icrs


@dataclass(frozen=True)
class Job:
    """One exposure on one chip, and the window of it that is simulated."""

    pointing: object
    chip: object
    window: object
    wcs: object
    observer: object  # catalog.places.ephemeris.Observer, at the start of the exposure

    @property
    def key(self):
        """(obsid, chip number)."""
        return self.pointing.obsid, self.chip.id

    @property
    def options(self):
        """How a command is told of the job."""
        return f"--obsid {self.pointing.obsid} --chip {self.chip.id}"

    def footprint(self, margin_px=0.0):
        """Return ra[4], dec[4] of the window's corners, grown by a margin: ICRS at the epoch, not apparent."""
        return icrs(*self.wcs.footprint(self.window, margin_px), self.observer)
