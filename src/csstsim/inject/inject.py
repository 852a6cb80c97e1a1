"""`csstsim inject`: objects of a table injected into copies of frames, with truth tables, in a new folder."""

from __future__ import annotations

from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.plural import number_of
from csstsim.base.process.one_thread import one_thread
from csstsim.base.process.progress import progress
from csstsim.inject.calibrated import Planes, check_planes, into_calibrated
from csstsim.inject.frames import CALIBRATED, LEVEL0, OTHER, job_of, kind_of
from csstsim.inject.level0 import into_level0
from csstsim.inject.light import catalogue_of, light_of, table_of
from csstsim.inject.others.render import prepared
from csstsim.inject.request import SAME_NOISE, Request, log_or_say, realisations, record
from csstsim.inject.rewritten import rewrite
from csstsim.io.level0 import read_level0
from csstsim.io.paths import ORDERS, TRUTH
from csstsim.io.truth import truth_table
from csstsim.stages.select import log_selected

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping
    from typing import Any

    from astropy.table import Table

    from csstsim.base.types import AnyArray, IntArray, PathLike
    from csstsim.campaign.job import Job
    from csstsim.campaign.opened import OpenCampaign
    from csstsim.catalog.own_table import TableCatalog
    from csstsim.catalog.table import ObjectTable
    from csstsim.inject.light import Light
    from csstsim.inject.request import Injector, Log
    from csstsim.io.level0 import Level0


def inject(
    frames: Iterable[PathLike],
    table: Table | Mapping[str, Any] | PathLike,
    folder: PathLike,
    log: Log = print,
    **options: Any,
) -> list[Path]:
    """Inject a table's objects into copies of frames, in a folder, each with its truth table.

    Every frame is opened and checked before the first is written. If one fails later, the copies of the call are
    removed.

    Parameters
    ----------
    frames : iterable of str or Path
        FITS files: Level-0 files, calibrated images, or images of other telescopes.
    table : Table, mapping, str or Path
        Astropy Table, {name: (n,) values}, or the path of a table's file; columns: csstsim.catalog.own_table.
    folder : str or Path
        Folder of the copies.
    log : callable
        Function that gets each message.
    **options : object
        Keywords of csstsim.inject.request.Request: realisation, campaign, instrument, cache, psf, zeropoint [mag] and
        light_curves.

    Returns
    -------
    list of Path
        The new files, in the order of `frames`.

    Raises
    ------
    InputError
        For a frame or table that cannot be used, or a file that exists.
    """
    log = log_or_say(log, options)
    folder = Path(folder)
    paths = [Path(frame) for frame in frames]
    targets = [folder / path.name for path in paths]
    for path, target in zip(paths, targets, strict=True):
        if target.exists() or paths.count(path) > 1 or targets.count(target) > 1:
            raise InputError("would be written twice, or exists already; name another folder", file=target)
    if folder.exists() and not folder.is_dir():
        raise InputError("is not a folder", file=folder)
    request = Request(table_of(table), table if isinstance(table, str | Path) else "a table", **options)
    _check_for_others(paths, request)
    for path in paths:
        _check_realisation(path, request.realisation)
    prepared = [_prepared(path, request, log) for path in paths]
    files = [file for target in targets for file in (target, target.with_suffix(TRUTH), target.with_suffix(ORDERS))]
    with _removed_on_failure([file for file in files if not file.exists()], None if folder.exists() else folder):
        for injector, path, target in progress(list(zip(prepared, paths, targets, strict=True)), "frames"):
            log(f"{target}: {injector(path, target, log)}")
    return targets


@contextmanager
def _removed_on_failure(files: list[Path], folder: Path | None) -> Iterator[None]:
    """Remove files, and then the folder if it is empty, if an exception is raised."""
    try:
        yield
    except Exception:
        for file in files:
            file.unlink(missing_ok=True)
        if folder is not None and folder.is_dir() and not any(folder.iterdir()):
            folder.rmdir()
        raise


def _check_for_others(frames: list[Path], request: Request) -> None:
    """Raise InputError if a PSF or a zero point is given but csstsim made all frames, whose campaign has them."""
    if all(kind_of(frame) != OTHER for frame in frames):
        for key, value in (("--psf", request.psf), ("--zeropoint", request.zeropoint)):
            if value is not None:
                message = "not for frames of csstsim, which have their campaign's"
                allowed = "frames of others"
                raise InputError(message, file=frames[0], key=key, value=str(value), allowed=allowed)


def _check_realisation(frame: Path, realisation: int) -> None:
    """Raise InputError if the frame has injected objects of this realisation, whose noise would be the same."""
    if realisation in realisations(frame):
        raise InputError(SAME_NOISE, file=frame, key="--realisation", value=realisation, allowed="another whole number")


def _prepared(frame: Path, request: Request, log: Log) -> Injector:
    """Return the Injector of a frame, after checking it. Raises InputError."""
    kind = kind_of(frame)
    if kind == OTHER:
        return prepared(frame, request)
    run, job = job_of(frame, request.campaign, request.instrument, request.cache, log)
    catalogue = catalogue_of(run, job, request.columns, request.light_curves, request.table)
    if kind == CALIBRATED:
        _read_calibrated(frame, job)
    inject_into = {LEVEL0: _inject_level0, CALIBRATED: _inject_calibrated}[kind]
    return lambda frame, target, log: inject_into(run, job, catalogue, request, frame, target, log)


@one_thread
def _inject_level0(
    run: OpenCampaign, job: Job, catalogue: TableCatalog, request: Request, frame: Path, target: Path, log: Log
) -> str:
    light = light_of(run, job, catalogue, request.realisation, log)
    log_selected(light.truth, log)
    file = read_level0(frame)
    injected = into_level0(run, job, file, light)
    planes = {"IMAGE": file.readout.to_stored(injected.frame, file.layout)}
    if injected.mask is not None:
        planes["MASK"] = _mask_of(file) | file.readout.to_stored(injected.mask, file.layout)
    _write(frame, target, planes, request, light, injected.truth, job)
    pixels = f"{injected.changed} pixels changed, {injected.saturated} more at the converter's end"
    return f"{_summary(injected.truth)}; {pixels}"


def _mask_of(file: Level0) -> IntArray:
    from csstsim.io.fits import open_fits, read_pixels

    with open_fits(file.path) as hdus:
        return read_pixels(hdus["MASK"], file.path)


@one_thread
def _inject_calibrated(
    run: OpenCampaign, job: Job, catalogue: TableCatalog, request: Request, frame: Path, target: Path, log: Log
) -> str:
    from csstsim.stages.calibrate import known_corrections

    light = light_of(run, job, catalogue, request.realisation, log)
    log_selected(light.truth, log)
    planes, header = _read_calibrated(frame, job)
    response = known_corrections(run, job).response
    row, column = np.divmod(light.pixel, job.window.nx)
    detector = run.camera.detector
    injected = into_calibrated(
        planes,
        light,
        job.pointing.exptime,
        background=header["BACKMED"],
        limit=min(detector.full_well, detector.adc_max * detector.gain - detector.bias),
        response=None if response is None else response.at(row, column),
    )
    _write(frame, target, dict(zip(("SCI", "ERR", "DQ"), injected, strict=True)), request, light, light.truth, job)
    return _summary(light.truth)


def _read_calibrated(frame: Path, job: Job) -> tuple[Planes, dict[str, Any]]:
    """Return ((SCI, ERR, DQ), header of SCI) of a calibrated image, checked. Raises InputError."""
    from csstsim.io.fits import image_header, open_fits, read_pixels

    with open_fits(frame) as file:
        header = image_header(file["SCI"], frame)
        planes = Planes(*(read_pixels(file[name], frame) for name in ("SCI", "ERR", "DQ")))
    check_planes(frame, planes, header, job.window)
    return planes, header


def _write(
    frame: Path,
    target: Path,
    planes: Mapping[str, AnyArray],
    request: Request,
    light: Light,
    truth: ObjectTable,
    job: Job,
) -> None:
    """Write the truth tables, then the frame: where the frame exists, its tables are complete."""
    target.parent.mkdir(parents=True, exist_ok=True)
    metadata = {"level0": target.name, "injected": request.name, "realisation": str(request.realisation)}
    truth_table(truth, job.chip).write(target.with_suffix(TRUTH), metadata)
    if light.orders is not None:
        from csstsim.io.orders import write_orders

        write_orders(target.with_suffix(ORDERS), light.orders, metadata)
    rewrite(frame, target, planes, record(request, len(truth)))


def _summary(truth: ObjectTable) -> str:
    count = int(np.count_nonzero(truth["drawn"] > 0))
    return f"{number_of(count, 'object')} injected, {truth['drawn'].sum():.6g} electrons"
