"""Injection into a Frame in memory (Simulation.inject)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from csstsim.base.errors import InputError
from csstsim.base.process.one_thread import one_thread
from csstsim.base.types import IntArray
from csstsim.inject.level0 import into_level0
from csstsim.inject.light import catalogue_of, light_of, table_of
from csstsim.inject.request import SAME_NOISE, Request, realisations_of, record
from csstsim.io.level0 import Level0
from csstsim.io.orders import orders_table
from csstsim.io.truth import truth_table
from csstsim.simulation.frame import Frame, shown_table

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from typing import Any

    from astropy.table import Table

    from csstsim.base.types import PathLike
    from csstsim.campaign.job import Job
    from csstsim.campaign.opened import OpenCampaign
    from csstsim.catalog.table import ObjectTable
    from csstsim.inject.light import Light


@dataclass(frozen=True, eq=False)
class BaseFrame(Level0):
    """A Level-0 frame in memory: `raw`, DN of the readout frame."""

    raw: IntArray | None = None

    def frame(self) -> IntArray:
        """Return a copy of the readout frame [DN]."""
        assert self.raw is not None  # a field after those with defaults
        return self.raw.copy()


@one_thread
def into_frame(
    run: OpenCampaign,
    frame: Frame,
    table: Table | Mapping[str, Any] | PathLike,
    realisation: int,
    log: Callable[[str], object],
    light_curves: PathLike | None = None,
) -> Frame:
    """Return a simulation.frame.Frame with a table's objects; its truth is that of the injected objects only.

    frame: of the campaign `run`. Raises InputError for a frame of another campaign, or if its header states injected
    objects of this realisation, whose noise would be the same.
    """
    if not isinstance(frame, Frame):
        raise InputError("not a Frame", key="frame", value=type(frame).__name__, allowed="of Simulation.chip or light")
    if frame.key is None:
        raise InputError("the frame does not state its exposure and chip", key="frame")
    job = run.job(*frame.key)
    if frame.window != job.window:
        raise InputError("the frame is of another window", key="frame", value=frame.window, allowed=job.window)
    if frame.header is not None and realisation in realisations_of("".join(frame.header.get("HISTORY", ""))):
        raise InputError(SAME_NOISE, key="realisation", value=realisation, allowed="another whole number")
    request = Request(table_of(table), "a table", realisation, light_curves=light_curves)
    file = table if isinstance(table, str | Path) else None
    light = light_of(run, job, catalogue_of(run, job, request.columns, light_curves, file), realisation, log)
    if frame.raw is None:
        image = frame.image.copy()
        image.reshape(-1)[light.pixel] += light.nominal
        return replace(frame, image=image, **_truth(light.truth, light, job))
    assert frame.header is not None and frame.readout is not None  # as `raw`
    header = frame.header.copy()
    base = BaseFrame(Path("frame"), header, header, frame.readout, "channels", None, frame.raw)
    injected = into_level0(run, job, base, light)
    header_record = record(request, len(injected.truth))
    for keyword, value, comment in header_record["cards"]:
        header[keyword] = value, comment
    for text in header_record["history"]:
        header.add_history(f" injected {text}")
    parts = {"image": frame.readout.active(injected.frame), "raw": injected.frame, "header": header}
    return replace(frame, **parts, **_truth(injected.truth, light, job))


def _truth(truth: ObjectTable, light: Light, job: Job) -> dict[str, Any]:
    """Return the Frame's tables of the injected objects, {"truth", "orders"}."""
    orders = None if light.orders is None else shown_table(orders_table(light.orders))
    return {"truth": shown_table(truth_table(truth, job.chip)), "orders": orders}
