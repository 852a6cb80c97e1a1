"""The light of injected objects on a chip of csstsim, as its own renderer draws it, and the electrons that are counted.

The objects are a table (catalog.own_table). They are selected, drawn and lost to flat, shutter and pixel response as a
campaign's are (stages.select, layers.scie_obs). What was drawn as photons has its Poisson noise. The expected light of
stamps gets it here, pixel by pixel.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.rng import Streams
from csstsim.base.types import FloatArray, IntArray
from csstsim.catalog.object_table import plain_columns, read_table
from csstsim.catalog.own_table import COLUMNS_KEY, TableCatalog
from csstsim.catalog.row_files import file_paths
from csstsim.catalog.table import FILE_COLUMNS
from csstsim.inject.shot import places, shot
from csstsim.simulation.state import State
from csstsim.stages.psf import missing_psf, open_psf
from csstsim.stages.select import selected

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from astropy.table import Table

    from csstsim.base.types import PathLike
    from csstsim.campaign.job import Job
    from csstsim.campaign.opened import OpenCampaign
    from csstsim.catalog.table import ObjectTable
    from csstsim.detector.sparse_plane import SparsePlane

SAME = 0  # the realisation whose photons are those of a simulation of the same ids
SHOT_MOST = 1e9  # electrons in a pixel that are drawn as integers


@dataclass(frozen=True, eq=False)
class Light:
    """Injected light on a window, before the detector.

    pixel: (n,) int64, rising flat indices of the pixels that have some; electrons: (n,) float32, counted (Poisson noise
    included; expected where the frame has none); nominal: (n,) float32, with the noise of photons alone, as
    Simulation.light gives; truth: ObjectTable of the drawn objects; orders: that of a slitless chip or None; streams:
    rng.Streams of this injection.
    """

    pixel: IntArray
    electrons: FloatArray
    nominal: FloatArray
    truth: ObjectTable
    orders: ObjectTable | None
    streams: Streams

    def plane(self, shape: tuple[int, ...]) -> FloatArray:
        """Return the counted electrons as float32 of `shape`."""
        out = np.zeros(shape, np.float32)
        out.reshape(-1)[self.pixel] = self.electrons
        return out


def table_of(given: Table | Mapping[str, Any] | PathLike) -> dict[str, Any]:
    """Return {name: values} of a table of objects: a file's path, an astropy Table or a mapping. Raises InputError."""
    if hasattr(given, "colnames"):
        return plain_columns(given)
    if isinstance(given, dict):
        if scalars := [name for name, values in given.items() if np.ndim(values) != 1]:
            raise InputError("must have a value for each row", key=scalars[0], value=given[scalars[0]])
        return dict(given)
    if not isinstance(given, str | Path):
        allowed = "an astropy Table, {name: values} or the path of a file"
        raise InputError("not a table of objects", key="table", value=type(given).__name__, allowed=allowed)
    columns = read_table(given)
    return columns | {name: file_paths(columns, name, given) for name in FILE_COLUMNS if name in columns}


def catalogue_of(
    run: OpenCampaign,
    job: Job,
    columns: Mapping[str, Any],
    light_curves: PathLike | None = None,
    file: PathLike | None = None,
) -> TableCatalog:
    """Return the TableCatalog of {name: values} for a job of an OpenCampaign. Raises InputError.

    light_curves: file of the curves that the column light_curve names (catalog.changing.light_curves); file: which the
    columns were read from, for errors.
    """
    options = {"columns": columns} | ({"light_curves": light_curves} if light_curves else {})
    if run.config.instrument is not None:
        options["instrument"] = run.config.instrument
    try:
        return TableCatalog(options, run.region(job.exposure))
    except InputError as exc:
        if file is None or exc.file != COLUMNS_KEY:
            raise
        named_by_file = InputError(exc.message, file=file, key=exc.key, value=exc.value, allowed=exc.allowed)
        named_by_file.page = exc.page
        raise named_by_file from None


def light_of(
    run: OpenCampaign, job: Job, catalogue: TableCatalog, realisation: int = 1, say: Callable[[str], object] = print
) -> Light:
    """Return the Light of a catalogue's objects in a job's frame.

    realisation: number of the noise; SAME gives the photons of a simulation of the same ids, and so those of the
    frame's own objects of these ids. A missing PSF set is made first. Raises InputError, also where the frame's layers
    draw no objects.
    """
    step = run.steps[job.pointing.type].step("scie_obs")
    if step is None:
        raise InputError("the layers of the frame draw no objects: scie_obs is not among them", file=run.file)
    streams = Streams(run.config.seed, job.obsid, job.chip.id, f"inject {realisation}")
    objects = selected(run, job.exposure, catalogue)
    missing_psf(run, job.chip, say)
    state = _prepared(run, job, objects, catalogue)
    state = step.module.apply(state, step.param, streams.layer(step.name) if realisation == SAME else streams)
    noisy = run.steps[job.pointing.type].step("poisson_and_dark") is not None
    return _counted(state, streams, noisy)


def _prepared(run: OpenCampaign, job: Job, objects: ObjectTable, catalogue: TableCatalog) -> State:
    """Return the State with which the renderer begins."""
    state = State.blank(replace(job.exposure, mask=False), objects)
    state.psf = open_psf(run, job.chip)
    if job.exposure.fidelity != "reference":
        from csstsim.render.psf_table import read_tables

        state.tables = read_tables(run.paths.psf_tables(job.chip.id), state.psf)
    if job.chip.kind == "slitless":
        from csstsim.catalog.light.object_spectra import catalog_spectra

        state.spectra = catalog_spectra(objects, catalogue)
    return state


def _counted(state: State, streams: Streams, noisy: bool) -> Light:
    expected = state.image.reshape(-1)
    counted = state.take_counted()
    lit = np.flatnonzero(expected)
    mean = expected[lit]
    if noisy:
        drawn = shot(mean, places(lit, state.window, state.chip.detector.nx), streams.exposure_key("shot"))
    else:
        drawn = mean
    assert state.truth is not None  # scie_obs leaves it
    at, electrons = _of(counted)
    if not len(lit):
        same = electrons.astype(np.float32)
        return Light(at, same, same, state.truth, state.orders, streams)
    both = np.sort(np.concatenate([lit, at]), kind="stable")  # of two rising lists: quick
    pixel = both[np.r_[True, np.diff(both) > 0]]
    sums = np.zeros((2, len(pixel)), np.float32)
    sums[:, np.searchsorted(pixel, lit)] = drawn, mean
    sums[:, np.searchsorted(pixel, at)] += electrons
    noisy_sum, nominal = sums
    return Light(pixel, noisy_sum, nominal, state.truth, state.orders, streams)


def _of(counted: IntArray | SparsePlane | None) -> tuple[IntArray, IntArray]:
    """Return (flat indices, electrons) of a plane of counted electrons, dense, sparse or None."""
    if counted is None:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    if isinstance(counted, np.ndarray):
        at = np.flatnonzero(counted)
        return at, counted.reshape(-1)[at]
    return counted.pixel.astype(np.int64), counted.electrons
