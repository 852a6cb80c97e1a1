"""The light of injected objects on a chip of csstsim, rendered by csstsim, and the electrons that are counted.

The objects are a table (catalog.own_table). They are selected and rendered as a campaign's, with the losses of flat,
shutter and pixel response (stages.select, layers.scie_obs). Objects rendered as photons have their Poisson noise; the
expected electrons of stamps get it here, pixel by pixel.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numba
import numpy as np

from csstsim.base.counter import poisson, word
from csstsim.base.errors import InputError
from csstsim.base.rng import Streams
from csstsim.base.types import FloatArray, IntArray
from csstsim.catalog.object_table import plain_columns, read_table
from csstsim.catalog.own_table import COLUMNS_KEY, TableCatalog
from csstsim.catalog.row_files import file_paths
from csstsim.catalog.table import FILE_COLUMNS
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
    from csstsim.instrument.chip import Window

SAME_PHOTONS = 0  # the realisation with the photons of a simulation of objects with the same ids
_ZERO = np.uint64(0)


@dataclass(frozen=True, eq=False)
class Light:
    """Injected light on a window, before the detector.

    pixel: (n,) int64, increasing flat indices of the lit pixels; electrons: (n,) float32, counted, with Poisson noise
    (expected electrons if the frame has no noise); nominal: (n,) float32, with the noise of photons only, as
    Simulation.light gives; truth: ObjectTable of the rendered objects; orders: that of a slitless chip or None;
    streams: rng.Streams of this injection.
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


def table_of(table: Table | Mapping[str, Any] | PathLike) -> dict[str, Any]:
    """Return {name: values} of a table of objects: a file's path, an astropy Table or a mapping. Raises InputError."""
    if hasattr(table, "colnames"):
        return plain_columns(table)
    if isinstance(table, dict):
        if not_columns := [name for name, values in table.items() if np.ndim(values) != 1]:
            raise InputError("must have a value for each row", key=not_columns[0], value=table[not_columns[0]])
        from astropy.table import Table

        return plain_columns(Table(table))
    if not isinstance(table, str | Path):
        allowed = "an astropy Table, {name: values} or the path of a file"
        raise InputError("not a table of objects", key="table", value=type(table).__name__, allowed=allowed)
    columns = read_table(table)
    return columns | {name: file_paths(columns, name, table) for name in FILE_COLUMNS if name in columns}


def catalogue_of(
    run: OpenCampaign,
    job: Job,
    columns: Mapping[str, Any],
    light_curves: PathLike | None = None,
    file: PathLike | None = None,
) -> TableCatalog:
    """Return the TableCatalog of {name: values} for a job of an OpenCampaign. Raises InputError.

    light_curves: file of the curves that the column light_curve names (catalog.changing.light_curves); file: the file
    of the columns, for errors.
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
    run: OpenCampaign, job: Job, catalogue: TableCatalog, realisation: int = 1, log: Callable[[str], object] = print
) -> Light:
    """Return the Light of a catalogue's objects in a job's frame.

    realisation: number of the noise; SAME_PHOTONS gives the photons of a simulation of objects with the same ids, so
    an object of the frame with such an id has the same photons. A missing PSF set is made first. Raises InputError,
    also if the frame's layers render no objects.
    """
    step = run.steps[job.pointing.type].step("scie_obs")
    if step is None:
        raise InputError("the layers of the frame render no objects: scie_obs is not among them", file=run.file)
    streams = Streams(run.config.seed, job.obsid, job.chip.id, f"inject {realisation}")
    objects = selected(run, job.exposure, catalogue)
    missing_psf(run, job.chip, log)
    state = _initial_state(run, job, objects, catalogue)
    state = step.module.apply(state, step.param, streams.layer(step.name) if realisation == SAME_PHOTONS else streams)
    noisy = run.steps[job.pointing.type].step("poisson_and_dark") is not None
    return _counted(state, streams, noisy)


def _initial_state(run: OpenCampaign, job: Job, objects: ObjectTable, catalogue: TableCatalog) -> State:
    """Return the State before rendering."""
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
    """Return the Light of a rendered State; noisy: draw the Poisson noise of expected electrons."""
    expected = state.image.reshape(-1)
    counted = state.take_counted()
    lit = np.flatnonzero(expected)
    mean = expected[lit]
    if noisy:
        index = chip_index(lit, state.window, state.chip.detector.nx)
        electrons_drawn = shot_noise(mean, index, streams.exposure_key("shot"))
    else:
        electrons_drawn = mean
    assert state.truth is not None  # scie_obs leaves it
    counted_pixels, counted_electrons = _as_list(counted)
    if not len(lit):
        same = counted_electrons.astype(np.float32)
        return Light(counted_pixels, same, same, state.truth, state.orders, streams)
    indices = np.sort(np.concatenate([lit, counted_pixels]), kind="stable")  # fast, because both are sorted
    pixel = indices[np.r_[True, np.diff(indices) > 0]]
    sums = np.zeros((2, len(pixel)), np.float32)
    sums[:, np.searchsorted(pixel, lit)] = electrons_drawn, mean
    sums[:, np.searchsorted(pixel, counted_pixels)] += counted_electrons
    noisy_sum, nominal = sums
    return Light(pixel, noisy_sum, nominal, state.truth, state.orders, streams)


def _as_list(counted: IntArray | SparsePlane | None) -> tuple[IntArray, IntArray]:
    """Return (flat indices, electrons) of a plane of counted electrons, dense, sparse or None."""
    if counted is None:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    if isinstance(counted, np.ndarray):
        pixel = np.flatnonzero(counted)
        return pixel, counted.reshape(-1)[pixel]
    return counted.pixel.astype(np.int64), counted.electrons


@numba.njit(cache=True)
def shot_noise(mean: FloatArray, index: IntArray, key: np.uint64) -> IntArray:
    """Return (n,) int64 Poisson numbers of means (n,) >= 0 [e-] at pixels of the chip; key: uint64.

    index: (n,) uint64, of `chip_index`. The number of a pixel depends only on key, index and mean, so it does not
    depend on other objects, the window or the order of work. The simulator's own Poisson numbers are drawn for whole
    rows (detector.random.poisson); injected light covers a few per cent of the pixels.
    """
    counts = np.empty(len(mean), np.int64)
    for i in range(len(mean)):
        counts[i] = poisson(np.float64(mean[i]), word(key, index[i]), _ZERO)[0]
    return counts


def chip_index(pixel: IntArray, window: Window, nx: int) -> IntArray:
    """Return flat indices (n,) uint64 on a chip of nx columns of flat indices (n,) in a Window [px]."""
    row, column = np.divmod(np.asarray(pixel, np.int64), window.nx)
    return ((row + window.y0) * nx + column + window.x0).astype(np.uint64)
