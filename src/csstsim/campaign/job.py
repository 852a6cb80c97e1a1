"""The unit of work: one exposure of one chip."""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

from csstsim.base.digest import digest
from csstsim.simulation.exposure import Exposure

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from csstsim.base.types import FloatArray
    from csstsim.catalog.astrometry.ephemeris import Observer
    from csstsim.instrument.chip import Chip, Window
    from csstsim.instrument.pointing import Pointing
    from csstsim.optics.geometry.wcs import ChipWCS


@dataclass(frozen=True)
class Job:
    """An Exposure of a campaign, with the obsid that commands, files and random streams use for it.

    The layers get the exposure only. chip, pointing, window, wcs, observer and footprint are those of the exposure.
    """

    obsid: str
    exposure: Exposure

    @property
    def chip(self) -> Chip:
        """instrument.chip.Chip."""
        return self.exposure.chip

    @property
    def pointing(self) -> Pointing:
        """instrument.pointing.Pointing."""
        return self.exposure.pointing

    @property
    def window(self) -> Window:
        """instrument.chip.Window."""
        return self.exposure.window

    @property
    def wcs(self) -> ChipWCS:
        """optics.geometry.wcs.ChipWCS."""
        return self.exposure.wcs

    @property
    def observer(self) -> Observer:
        """catalog.astrometry.ephemeris.Observer."""
        return self.exposure.observer

    @property
    def footprint(self) -> Callable[..., tuple[FloatArray, FloatArray]]:
        """Exposure.footprint."""
        return self.exposure.footprint

    @property
    def key(self) -> tuple[str, int]:
        """(obsid, chip number)."""
        return self.obsid, self.chip.id

    @property
    def options(self) -> str:
        """The command-line options that name the job."""
        return f"--obsid {self.obsid} --chip {self.chip.id}"

    @property
    def digest(self) -> str:
        """16 hex digits of the row of the survey table, the window and the chip."""
        row = {"obsid": self.obsid} | vars(self.pointing)
        if self.pointing.survey == "WIDE":  # in digests of deep exposures only: those of others stay as they were
            del row["survey"]
        text = f"Pointing({', '.join(f'{name}={value!r}' for name, value in row.items())})"  # as products record it
        return digest([text, str(self.window), self.chip.id])

    @contextmanager
    def named(self) -> Iterator[None]:
        """Annotate an exception inside with obsid and chip."""
        try:
            yield
        except Exception as exc:
            exc.add_note(f"in obsid {self.obsid}, chip {self.chip.id}")
            raise
