"""Frame: one chip of one exposure as numpy arrays, astropy tables, WCS and header (csstsim.api makes them).

io.level0 describes the header, io.truth the columns of the truth.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.astropy_values import is_sky_coord
from csstsim.base.plural import number_of
from csstsim.io.wcs_keywords import ANY_WCS

if TYPE_CHECKING:
    from astropy.coordinates import SkyCoord
    from astropy.io.fits import Header
    from astropy.nddata import CCDData
    from astropy.table import Table
    from astropy.wcs import WCS
    from numpy.typing import ArrayLike

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
    filter : str
        Name of the chip's filter.
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
    filter: str = "-"

    def __repr__(self) -> str:
        obsid, chip = self.key or ("-", "-")
        w = self.window
        rows = f"{number_of(len(self.truth), 'object')} in truth"
        return (
            f"<Frame: exposure {obsid}, chip {chip}, x {w.x0} to {w.x1}, y {w.y0} to {w.y1}, "
            f"{self.image.dtype} [{self.unit}], {rows}>"
        )

    def _repr_html_(self) -> str:
        from csstsim.simulation.frame_html import frame_html

        return frame_html(self)

    @property
    def unit(self) -> str:
        """Unit of `image`: "DN" from `Simulation.chip`, "electron" from `Simulation.light`."""
        return "electron" if self.header is None else "DN"

    def pixel_to_icrs(self, x: ArrayLike, y: ArrayLike) -> SkyCoord:
        """Return the directions of pixels at the epoch of the exposure.

        Parameters
        ----------
        x, y : float or array (...)
            Pixels of `image`; the centre of the first one is (0, 0).

        Returns
        -------
        SkyCoord
            Of shape (...), in ICRS.
        """
        return self.wcs.pixel_to_world(x, y)

    def icrs_to_pixel(self, ra: ArrayLike | SkyCoord, dec: ArrayLike | None = None) -> tuple[FloatArray, FloatArray]:
        """Return the pixels of directions at the epoch of the exposure.

        Parameters
        ----------
        ra, dec : float, array (...) or Quantity
            Directions [deg, ICRS]: ra_epoch, dec_epoch of the truth. A SkyCoord in place of both is converted to ICRS;
            its motion is not applied.

        Returns
        -------
        x, y : float or array (...)
            Pixels of `image`; the centre of the first one is (0, 0).
        """
        from astropy.coordinates import SkyCoord

        position = ra if is_sky_coord(ra) else SkyCoord(ra, dec, unit="deg")
        x, y = self.wcs.world_to_pixel(position)
        return x, y

    def to_ccddata(self) -> CCDData:
        """Return the image as CCDData of astropy, for ccdproc, photutils or a file.

        Returns
        -------
        CCDData
            `image` in adu or electron with `wcs`. Its `meta` is `header` without the apparent WCS of Level-0.
        """
        from astropy.io.fits import Header
        from astropy.nddata import CCDData

        cards = Header() if self.header is None else self.header.copy()
        for keyword in {keyword for keyword in cards if ANY_WCS.fullmatch(keyword)}:  # some are given twice
            del cards[keyword]
        cards.remove("POSKIND", ignore_missing=True)
        unit = "electron" if self.header is None else "adu"
        return CCDData(self.image, unit=unit, wcs=self.wcs, meta=cards)

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
        filter=job.chip.filter,
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
