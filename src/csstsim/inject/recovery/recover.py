"""`csstsim recover`: an injected frame and its original measured, and how well the injected objects were recovered."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.plural import number_of
from csstsim.base.process.one_thread import one_thread
from csstsim.inject.calibrated import Planes, check_planes
from csstsim.inject.frames import LEVEL0, OTHER, job_of, kind_of
from csstsim.inject.recovery.bins import AGAINST, POINT_SIZE, QUANTITIES, binned, of_rows
from csstsim.inject.recovery.recovered import WHY, recovered
from csstsim.inject.request import log_or_say, realisations
from csstsim.io.paths import TRUTH
from csstsim.io.truth import read_truth
from csstsim.stages.calibrate import calibrated_of, known_corrections
from csstsim.stages.psf import missing_psf, open_psf

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from typing import Any

    from csstsim.base.types import PathLike
    from csstsim.campaign.job import Job
    from csstsim.campaign.opened import OpenCampaign
    from csstsim.catalog.table import ObjectTable
    from csstsim.inject.recovery.bins import Bin, Number
    from csstsim.measure.calibration.calibrate import Calibrated

PULL = "_pull"  # columns that end so are reported for all objects: values in px and mag depend too much on the flux
TABLE = ".recovered.parquet"
FIGURE = ".recovered.png"


def recover(
    injected: PathLike,
    original: PathLike,
    log: Callable[[str], object] = print,
    output: PathLike | None = None,
    truth: PathLike | None = None,
    **options: Any,
) -> ObjectTable:
    """Measure an injected frame and its original, and compare the measurements with the injected objects.

    The bins are logged. A table and a figure are written next to the injected frame or into `output`.

    Parameters
    ----------
    injected : str or Path
        Level-0 file or calibrated image with injected objects.
    original : str or Path
        The same exposure without them, a file of the same kind.
    log : callable
        Function that gets each line.
    output : str or Path, optional
        Folder of the table and the figure; by default that of `injected`.
    truth : str or Path, optional
        Truth table that `inject` wrote; by default the one next to `injected`.
    **options : object
        campaign, instrument and cache, as csstsim.inject.frames.job_of takes them.

    Returns
    -------
    ObjectTable
        One row per injected object (csstsim.inject.recovery.recovered).

    Raises
    ------
    InputError
        For frames that cannot be compared, or if no injected object is on the frame.
    """
    log = log_or_say(log, options)
    injected = Path(injected)
    original = Path(original)
    _check_order(injected, original)
    objects = _injected_objects(Path(truth or injected.with_suffix(TRUTH)), injected, original)
    run, job = job_of(injected, log=log, **options)
    kind = kind_of(injected)
    for path in (injected, original):
        if kind_of(path) == OTHER or kind_of(path) != kind:
            message = "is not measured: both must be Level-0 files, or both calibrated images, of csstsim"
            raise InputError(message, file=path, allowed="for images of other telescopes, a program of your own")
    _, other = job_of(original, log=lambda text: None, **options)
    if other.key != job.key or job.chip.kind != "imaging":
        raise InputError("not an imaging frame of the same exposure", file=original, value=other.key, allowed=job.key)
    missing_psf(run, job.chip, log)
    sources = measured(run, job, injected, kind)
    before = measured(run, job, original, kind)
    table = recovered(objects, sources, before, job.window, run.camera.telescope.pixel_scale)
    if not len(table):
        raise InputError("no injected object lies on the frame", file=injected)
    folder = Path(output) if output else injected.parent
    folder.mkdir(parents=True, exist_ok=True)
    table.write(folder / f"{injected.stem}{TABLE}", table.meta | {"injected": injected.name, "original": original.name})
    for line in lines(table):
        log(line)
    from csstsim.inject.recovery.figure import draw

    draw(table, folder / f"{injected.stem}{FIGURE}")
    log(f"{folder / (injected.stem + FIGURE)}, and the table next to it")
    return table


def _check_order(injected: Path, original: Path) -> None:
    """Raise InputError unless `injected` has all that was injected into `original`, and more."""
    first = realisations(injected)
    second = realisations(original)
    if not second < first:
        raise InputError(
            "has no injected objects that the original lacks",
            file=injected,
            key="realisations in HISTORY",
            value=f"{sorted(first)}; of {original}: {sorted(second)}",
            allowed="INJECTED ORIGINAL, in this order",
        )


def _injected_objects(truth: Path, injected: Path, original: Path) -> ObjectTable:
    """Return the ObjectTable of a truth table. Raises InputError unless the original lacks its injection."""
    objects = read_truth(truth)
    allowed = {str(number) for number in realisations(injected) - realisations(original)}
    realisation = objects.meta.get("realisation") if "injected" in objects.meta else None
    if realisation not in allowed:
        raise InputError(
            "not the truth table of the injected objects",
            file=truth,
            key="--truth",
            value="no injection" if realisation is None else f"realisation {realisation}",
            allowed=f"realisation {' or '.join(sorted(allowed))}: the table next to the frame that `inject` wrote",
        )
    return objects


@one_thread
def measured(run: OpenCampaign, job: Job, path: Path, kind: str) -> ObjectTable:
    """Return the measured table (measure.catalogue) of a job's Level-0 file or calibrated image."""
    from csstsim.measure.catalogue import FrameFacts, measure_frame

    frame = _of_level0(run, job, path) if kind == LEVEL0 else _of_image(run, job, path)
    return measure_frame(
        frame,
        open_psf(run, job.chip),
        job.wcs,
        job.observer,
        FrameFacts.of(job),
    )


def _of_level0(run: OpenCampaign, job: Job, path: Path) -> Calibrated:
    from csstsim.io.level0 import read_level0

    return calibrated_of(run, job, read_level0(path, verify=True))


def _of_image(run: OpenCampaign, job: Job, path: Path) -> Calibrated:
    """Return the Calibrated of a calibrated image: its electrons with the median of the subtracted background."""
    from csstsim.detector.channels import ReadoutFrame
    from csstsim.io.fits import image_header, open_fits, read_pixels
    from csstsim.measure.calibration.calibrate import Calibrated

    with open_fits(path) as file:
        header = image_header(file["SCI"], path)
        planes = Planes(*(read_pixels(file[name], path) for name in ("SCI", "ERR", "DQ")))
    check_planes(path, planes, header, job.window)
    readout = ReadoutFrame.of(run.camera.detector, job.window)
    noise = {block.channel: header["RDNOISE"] for block in readout.blocks}
    electrons = (planes.sci + np.float32(header["BACKMED"])) * np.float32(job.pointing.exptime)
    response = known_corrections(run, job).response
    return Calibrated(electrons, planes.dq, dict.fromkeys(noise, 0.0), noise, readout, response)


def lines(table: ObjectTable) -> Iterator[str]:
    """Yield the lines that `recover` prints: all objects, then bins against magnitude, size and density."""
    yield from left_out(table)
    every = np.ones(len(table), bool)
    for name, rows in (("points", table["point"]), ("galaxies", ~table["point"])):
        if rows.any():
            yield from _of_kind(name, of_rows(table, every & rows, 0.0, 0.0, table["mag"]))
    for against, label in AGAINST.items():
        yield ""
        yield f"{label:<28} objects   found            magnitude              position x [px]        shape g1"
        for one in binned(table, against):
            p, low, high = one.completeness
            cells = [_cell(one.numbers[name]) for name in ("d_mag", "d_x", "d_g1")]
            span = "points" if one.high <= POINT_SIZE else f"{one.low:.3g} to {one.high:.3g}"
            yield f"{span:<28} {one.objects:>7}   {p:.3f} {low:.3f}-{high:.3f}  {'  '.join(cells)}"


def left_out(table: ObjectTable) -> Iterator[str]:
    """Yield a line for each reason why injected objects are not in the table, or found ones not in its means."""
    for name, reason in (("outside", "are outside the frame"), ("dark", "have no flux in the frame")):
        if count := table.meta[name]:
            yield f"{number_of(count, 'injected object')} left out: they {reason}"
    found = table["found"]
    for flag, reason in WHY.items():
        if count := int((found & (table["flags"] & flag != 0)).sum()):
            yield f"{number_of(count, 'found object')} left out of all means: {reason}"
    for key, label in QUANTITIES.items():
        if not key.endswith(PULL):
            rows = table["clean"] & (~table["point"] if key in ("d_g1", "d_g2") else True)
            if count := int((rows & ~np.isfinite(table[key])).sum()):
                yield f"{number_of(count, 'found object')} left out of the means of {label}: not measured"


def _of_kind(name: str, one: Bin) -> Iterator[str]:
    p, low, high = one.completeness
    yield f"{one.objects} {name}: {one.found} found, {p:.3f} ({low:.3f} to {high:.3f})"
    for key, label in QUANTITIES.items():
        number = one.numbers[key]
        if key.endswith(PULL) and np.isfinite(number.mean):
            yield (
                f"  {label:<14} bias {number.mean:+.4f} +- {number.mean_error:.4f}, scatter {number.scatter:.4f} +- "
                f"{number.scatter_error:.4f}, of {number.n}, outliers {number.outliers}"
            )


def _cell(number: Number) -> str:
    return f"{number.mean:+.4f}+-{number.mean_error:.4f}".ljust(21) if np.isfinite(number.mean) else "-".ljust(21)
