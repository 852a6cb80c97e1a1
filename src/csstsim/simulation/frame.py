"""Frame: one chip of one exposure as numpy arrays, astropy tables, WCS and header (csstsim.api makes them).

io.level0 describes the header, io.truth the columns of the truth.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.plural import number_of

if TYPE_CHECKING:
    from astropy.io.fits import Header
    from astropy.table import Table
    from astropy.wcs import WCS

    from csstsim.base.types import AnyArray, FloatArray
    from csstsim.campaign.job import Job
    from csstsim.catalog.table import ObjectTable
    from csstsim.detector.channels import ReadoutFrame
    from csstsim.instrument.chip import Window
    from csstsim.simulation.state import State


@dataclass(frozen=True, eq=False)
class Frame:
    """One chip of one exposure, as arrays; pixel (0, 0) of each is the first of the window.

    Attributes
    ----------
    image : (ny, nx) array
        uint16 [DN] from `Simulation.chip`, float32 [electron] from `Simulation.light`.
    truth : Table
        Astropy Table, one row per object (docs: Products). xImage and yImage count from 1 on the whole chip, so
        `truth["xImage"] - 1 - window.x0` is the column of `image`.
    wcs : WCS
        Astropy WCS of `image` with the field distortion, ICRS at the epoch: ra_epoch, dec_epoch of the truth.
    window : Window
        x0, x1, y0, y1 [pixel] on the chip.
    header : Header or None
        Astropy Header, both headers of the Level-0 file in one; None from `light`.
    raw : (rows, columns) array of uint16 or None
        The window as read [DN], with prescan and overscan; None from `light`.
    orders : Table or None
        Astropy Table, the truth of a slitless chip, one row per order; None for an imaging chip.
    readout : ReadoutFrame or None
        Channels of `raw` (csstsim.detector.channels); None from `light`.
    key : (str, int) or None
        Observation id and number of the chip.
    """

    image: np.ndarray
    truth: Table
    wcs: WCS
    window: Window
    header: Header | None = None
    raw: np.ndarray | None = None
    orders: Table | None = None
    readout: ReadoutFrame | None = None
    key: tuple[str, int] | None = None

    def __repr__(self) -> str:
        obsid, chip = self.key or ("-", "-")
        w = self.window
        rows = f"{number_of(len(self.truth), 'object')} in truth"
        return (
            f"<Frame: exposure {obsid}, chip {chip}, x {w.x0} to {w.x1}, y {w.y0} to {w.y1}, "
            f"{self.image.dtype} [{'electron' if self.header is None else 'DN'}], {rows}>"
        )

    @cached_property
    def electrons(self) -> FloatArray:
        """(ny, nx) float32 [electron]: bias subtracted and gain applied in each channel; nothing else is corrected.

        Raises
        ------
        ValueError
            For a frame from `light`, or if the header lacks bias or gain because their layers were omitted.
        """
        if self.readout is None or self.header is None:
            raise ValueError("`image` of Simulation.light is in electrons already")
        result = np.empty(self.image.shape, np.float32)
        for block in self.readout.blocks:
            bias = self.header.get(f"DETBIA{block.channel:02d}")
            gain = self.header.get(f"GAIN{block.channel:02d}")
            if bias is None or gain is None:
                raise ValueError("the header lacks the channels' bias and gain: the list of layers leaves them out")
            result[block.image] = (self.image[block.image] - np.float32(bias)) * np.float32(gain)
        return result


def frame_of(
    job: Job,
    state: State,
    image: AnyArray,
    *,
    header: Header | None = None,
    raw: AnyArray | None = None,
    readout: ReadoutFrame | None = None,
) -> Frame:
    """Return the Frame of a job.Job: its image (ny, nx), and the truth that is in its State; the others: of a Frame."""
    from csstsim.io.orders import orders_table
    from csstsim.io.truth import truth_table

    assert state.truth is not None  # the objects are rendered
    truth = shown_table(truth_table(state.truth, job.chip))
    orders = None if state.orders is None else shown_table(orders_table(state.orders))
    return Frame(
        image=image,
        truth=truth,
        wcs=_wcs(job),
        window=job.window,
        header=header,
        raw=raw,
        orders=orders,
        readout=readout,
        key=job.key,
    )


def shown_table(table: ObjectTable) -> Table:
    """Return an ObjectTable as an astropy Table that prints well."""
    from astropy.table import Table

    shown = Table({name: table[name] for name in table.names})
    for column in shown.itercols():
        if column.dtype.kind == "f":
            column.info.format = ".9g"  # on the screen
    return shown


def _wcs(job: Job) -> WCS:
    """Return the astropy WCS of a job's window in ICRS: aberration and deflection are undone."""
    from astropy.wcs import WCS

    from csstsim.optics.geometry.icrs_header import icrs_header

    return WCS(icrs_header(job.wcs, job.observer, job.window))
