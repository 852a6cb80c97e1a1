"""The unit of work: one exposure of one chip."""

from csstsim.simulation.exposure import Exposure


class Job(Exposure):
    """An Exposure that a campaign asks for, by the names that commands and files have for it."""

    @property
    def key(self):
        """(obsid, chip number)."""
        return self.pointing.obsid, self.chip.id

    @property
    def options(self):
        """How a command is told of the job."""
        return f"--obsid {self.pointing.obsid} --chip {self.chip.id}"
