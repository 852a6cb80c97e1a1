"""The unit of work: one exposure of one chip."""

from csstsim.simulation.exposure import Exposure


class Job(Exposure):
    """An Exposure of a campaign, with the names that commands and files use for it."""

    @property
    def key(self):
        """(obsid, chip number)."""
        return self.pointing.obsid, self.chip.id

    @property
    def options(self):
        """The command-line options that name the job."""
        return f"--obsid {self.pointing.obsid} --chip {self.chip.id}"
