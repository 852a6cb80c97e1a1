"""The unit of work: one exposure of one chip."""

from contextlib import contextmanager
from dataclasses import dataclass

from csstsim.base.digest import digest
from csstsim.simulation.exposure import Exposure


@dataclass(frozen=True)
class Job:
    """An Exposure of a campaign, with the name that commands, files and random streams use for it.

    The layers get the exposure alone. chip, pointing, window, wcs, observer and footprint are its.
    """

    obsid: str
    exposure: Exposure

    chip = property(lambda self: self.exposure.chip, doc="instrument.chip.Chip")
    pointing = property(lambda self: self.exposure.pointing, doc="instrument.pointing.Pointing")
    window = property(lambda self: self.exposure.window, doc="instrument.chip.Window")
    wcs = property(lambda self: self.exposure.wcs, doc="optics.geometry.wcs.ChipWCS")
    observer = property(lambda self: self.exposure.observer, doc="catalog.astrometry.ephemeris.Observer")
    footprint = property(lambda self: self.exposure.footprint, doc="Exposure.footprint")

    @property
    def key(self):
        """(obsid, chip number)."""
        return self.obsid, self.chip.id

    @property
    def options(self):
        """The command-line options that name the job."""
        return f"--obsid {self.obsid} --chip {self.chip.id}"

    @property
    def digest(self):
        """16 hex digits of the row of the survey table, the window and the chip."""
        row = {"obsid": self.obsid} | vars(self.pointing)
        if self.pointing.survey == "WIDE":  # said of deep exposures alone: other products keep their digest
            del row["survey"]
        text = f"Pointing({', '.join(f'{name}={value!r}' for name, value in row.items())})"  # as products record it
        return digest([text, str(self.window), self.chip.id])

    @contextmanager
    def named(self):
        """Annotate an exception inside with obsid and chip."""
        try:
            yield
        except Exception as exc:
            exc.add_note(f"in obsid {self.obsid}, chip {self.chip.id}")
            raise
