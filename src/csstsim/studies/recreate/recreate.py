"""`csstsim recreate FRAME TRUTH --output DIR`: a campaign that simulates a frame again.

The header gives exposure, chip, window, seed, layers and camera parameters (recreate.frame), the catalogue gives the
objects (recreate.objects). If the header does not have the brightness of the sky, it is measured from the pixels. What
none of them has is assumed and reported.
"""

from __future__ import annotations

import csv
import io
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import yaml

from csstsim.base.errors import InputError
from csstsim.base.files.atomic import atomic_path
from csstsim.base.plural import number_of
from csstsim.base.shipped import ROOT
from csstsim.campaign.config import make_campaign
from csstsim.campaign.opened import OpenCampaign
from csstsim.campaign.survey_table import exposures_of
from csstsim.catalog.astrometry.reduction import apparent
from csstsim.instrument.camera import load_camera
from csstsim.io.keywords import RECIPE
from csstsim.studies.recreate.frame import ANGLE_IF_NONE, SEED_IF_NONE, read_frame
from csstsim.studies.recreate.objects import campaign_table, check_frame, read_objects
from csstsim.studies.recreate.pixels import clipped, read_electrons

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence
    from typing import Any

    from csstsim.base.types import AnyArray, BoolArray, FloatArray, PathLike
    from csstsim.campaign.job import Job
    from csstsim.instrument.chip import Detector
    from csstsim.studies.recreate.frame import FrameHeader

FILES = "campaign.yaml", "science.yaml", "survey_table.csv", "objects.fits"
WORKFLOW = {"Snakefile": "config/starter/Snakefile", "profiles/default/config.yaml": "profiles/default/config.yaml"}
SHOWN = 3  # ids of objects that are left out, for each reason
_SNR_FAINT = 5.0  # S/N below which an object is part of the background: clipping does not remove it
_APERTURE = 50  # px, of the noise in this S/N
# px around an object that are excluded from the background, of the faintest and at most; minimum fraction that is left
_RADIUS_FAINT = 10.0
_RADIUS_MAX = 300.0
_BACKGROUND_MIN = 0.05


class Description(NamedTuple):
    """A campaign that a frame's header describes: its file as a mapping, its layers, its survey table as text."""

    data: dict[str, Any]
    layers: list[Any]
    table: str


def recreate(
    frame: PathLike,
    truth: PathLike,
    folder: PathLike,
    log: Callable[[str], object],
    instrument: PathLike | None = None,
    seed: int | None = None,
) -> None:
    """Write the campaign of a frame and its truth (`.cat`, or truth parquet) into a folder, new or empty.

    instrument: the camera's folder, None: the shipped one; seed: in place of the header's. Assumptions, reasons why
    objects are left out, and the next commands are passed to `log`. Raises InputError for files that cannot be used,
    before anything is written.
    """
    folder = Path(folder)
    existing = next((name for name in (*FILES, *WORKFLOW) if (folder / name).exists()), None)
    if existing or (folder.exists() and not folder.is_dir()):
        raise InputError("exists already; name another folder", file=folder / existing if existing else folder)
    header = read_frame(frame)
    objects = read_objects(truth)
    data, layers, table = describe_campaign(header, instrument, seed)
    run, job = open_described(header.path, data, layers, table)
    digest = run.recipe(job)["camera"]
    if header.keys.get(RECIPE["camera"], digest) != digest:
        header.notes.append("CAMHASH: made with other numbers of the camera than those taken here (--instrument)")
    if not len(objects):
        raise InputError("the catalogue has no rows", file=truth)
    check_frame(objects, truth, job, angle_known=ANGLE_IF_NONE not in header.notes)
    header.notes += _map_notes(header.camera_maps(), job.chip.maps.record)
    header.notes += _injection_notes(header.injected(), "injected" in objects.meta)
    columns, left_out = campaign_table(objects, job, run.camera.bands, header.notes)
    if not len(columns["id"]):
        raise InputError("none of its objects can be rendered", file=truth, value="; ".join(left_out))
    if header.number("SKYRATE") is None and job.chip.kind == "slitless":
        header.notes.append("SKYRATE: the sky of the camera's filter")
    elif header.number("SKYRATE") is None:
        data["instrument"] |= {f"filters.{job.chip.filter}.sky": _sky(header, run, job, columns)}
        make_campaign(data, folder / "campaign.yaml")
    _write(folder, data, layers, table, columns)
    if objects.meta.get("types"):
        header.notes.append(f"obj_type: numbers, taken as {objects.meta['types']}")
    for note in header.notes:
        log(f"assumed  {note}")
    for reason, ids in left_out.items():
        examples = ", ".join(map(str, ids[:SHOWN])) + (", ..." if len(ids) > SHOWN else "")
        log(f"left out {number_of(len(ids), 'object')}: {reason} ({examples})")
    [obsid] = data["select"]["obsids"]
    count = number_of(len(columns["id"]), "object")
    log(f"{folder}: {count} of exposure {obsid}, chip {job.chip.id} ({job.chip.filter})")
    campaign = shlex.quote(str(folder / "campaign.yaml"))
    log(f"\nNext:  csstsim chip {campaign} --obsid {obsid} --chip {job.chip.id}")
    arguments = shlex.join([str(frame), str(job_file(folder, run, job)), "--truth", str(truth)])
    log(f"       csstsim compare {arguments}")


def job_file(folder: PathLike, run: OpenCampaign, job: Job) -> Path:
    """Return the path that the Level-0 file of a recreated job will have."""
    return Path(folder) / run.config.output / run.paths.level0(job).relative_to(run.paths.output)


def describe_campaign(header: FrameHeader, instrument: PathLike | None, seed: int | None) -> Description:
    """Return the Description of the campaign that a frame's header describes; seed: in place of the header's."""
    camera = load_camera(instrument)
    changes = header.camera_changes() if header.by_csstsim else _stated_camera(header, camera.detector)
    if header.chip not in camera.chips:
        raise InputError("no such chip of the camera", file=header.path, key="DETECTOR", value=header.chip)
    filter_ = camera.chips[header.chip].filter
    filter_of_header = str(header.get("FILTER") or "")
    if filter_of_header and filter_of_header.lower() != filter_.lower():
        what = "the camera's chip has another filter"
        raise InputError(what, file=header.path, key="FILTER", value=filter_of_header, allowed=filter_)
    layers = header.layers() or _shipped_layers()
    exposure = header.exposure
    window = header.window(camera.detector)
    number = header.number("SIMSEED") if seed is None else seed
    if number is None:
        what = f"seed {SEED_IF_NONE}: flat field, gains, defects, rays and noise are others than the frame's"
        number = header.assume("SIMSEED", SEED_IF_NONE, what)
    if number < 0 or number != int(number):
        raise InputError("not a seed", file=header.path, key="SIMSEED", value=number, allowed="an integer from 0 on")
    data: dict[str, Any] = {
        "schema_version": 1,
        "name": "recreated",
        "survey_table": "survey_table.csv",
        "output": "results",
        "seed": int(number),
        "select": {"types": ["SCIE"], "obsids": [exposure["obsid"]], "chips": [header.chip]},
        "observations": {"SCIE": "science.yaml"},
        "instrument": dict(changes),
        "catalog": {"kind": "csstsim.catalog.own_table:TableCatalog", "options": {"file": "objects.fits"}},
        "truth": ["parquet", "cat"],
    }
    if window:
        data["window"] = dict(zip(("x0", "x1", "y0", "y1"), window, strict=True))
    if "EPHEM" in header.keys:
        data["astrometry"] = {"ephemeris": header.keys["EPHEM"], "planets": bool(header.keys.get("LDPLANET", False))}
    if instrument:
        data["instrument"]["folder"] = str(Path(instrument).resolve())
    if any("poisson_and_dark" in layer for layer in layers):
        header.notes.append("psf, fidelity: those of a campaign file that does not name them")
    else:
        data["fidelity"] = "noise_free"
        header.notes.append("fidelity: noise_free, for the header's layers lack poisson_and_dark")
        header.notes.append("psf: that of a campaign file that does not name it")
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([exposure, [_cell(v) for v in exposure.values()]])
    return Description(data, layers, text.getvalue())


def _cell(value: str | float) -> str:
    return repr(value) if isinstance(value, float) else str(value)


def _stated_camera(header: FrameHeader, detector: Detector) -> dict[str, float]:
    """Return {camera parameter: value} in the header of a frame not made by csstsim, means over its channels."""
    changes = {}
    for name, keywords, default in (
        ("gain", ("GAIN", "GAIN1"), detector.gain),
        ("read_noise", ("RON", "RDNOIS", "RDNOISE1"), detector.read_noise),
    ):
        value = _channel_mean(header, keywords)
        first, *_ = keywords
        changes[f"detector.{name}"] = header.assume(f"{first}01", default, f"{default:g}") if value is None else value
    level = _channel_mean(header, ("DETBIA", "BIAS"))
    if level is not None:
        changes["detector.bias"] = level * changes["detector.gain"]
    return changes


def _channel_mean(header: FrameHeader, keywords: Sequence[str]) -> float | None:
    channels = [header.number(f"{key}{n:02d}") for key in keywords for n in range(1, 17)]
    values = [v for v in [*channels, *(header.number(key) for key in keywords)] if v is not None and v > 0]
    return float(np.mean(values)) if values else None


def _shipped_layers() -> list[Any]:
    return yaml.safe_load((ROOT / "config/observations/science.yaml").read_text())["layers"]


def open_described(frame: PathLike, data: Mapping[str, Any], layers: list[Any], table: str) -> tuple[OpenCampaign, Job]:
    """Return the described campaign, opened without any file, and its job.

    An InputError names the frame, because its header has the value and the campaign's files do not exist yet.
    """
    file = Path("campaign.yaml")
    try:
        config = make_campaign({key: value for key, value in data.items() if key != "catalog"}, file)
        run = OpenCampaign(file, copied=True, config=config, layers={"SCIE": layers}, pointings=exposures_of(table))
        job, *_ = run.jobs
        return run, job
    except InputError as error:
        if error.file is not None and str(error.file) not in FILES:  # one of the camera's
            raise
        key = error.key and str(error.key).removeprefix("line 2, column ")
        what = f"the header's value cannot be used: {error.message}"
        raise InputError(what, file=frame, key=key, value=error.value, allowed=error.allowed) from None


def _map_notes(maps_of_frame: Mapping[str, str], maps_of_camera: Mapping[str, str]) -> Iterator[str]:
    """Yield the note on each laboratory map that a frame was made with, whose pixels are not in the header."""
    for name, of_frame in maps_of_frame.items():
        of_camera = maps_of_camera.get(f"maps.{name}")
        if of_camera is None:
            yield f"maps.{name}: none, for the camera taken here has no such map; the frame's was {of_frame}"
        elif of_camera == of_frame:
            yield f"maps.{name}: the map of the camera taken here, {of_camera}, as in the frame"
        else:
            yield f"maps.{name}: the map of the camera taken here, {of_camera}; the frame's was {of_frame}"


def _injection_notes(count: int, only_injected: bool) -> Iterator[str]:
    """Yield the note on a frame with injected objects: they are in a truth table of their own (only_injected)."""
    if count and only_injected:
        yield "HISTORY: TRUTH contains injected objects only, not the frame's own"
    elif count:
        yield f"HISTORY: the frame has {number_of(count, 'injected object')}, which TRUTH does not contain"


def _sky(header: FrameHeader, run: OpenCampaign, job: Job, columns: Mapping[str, AnyArray]) -> float:
    """Return the sky [e-/s/px] of the frame's background: without dark current and undetected objects."""
    from csstsim.optics.throughput.flat import FlatField
    from csstsim.optics.throughput.response import response_map

    pixels = read_electrons(header, run.camera.detector)
    if pixels.saturated.all():
        raise InputError("every pixel is saturated", file=header.path)
    _, noise = clipped(pixels.electrons[~pixels.saturated])
    mag = columns[f"mag_{job.chip.filter.lower()}"]
    electrons = job.exposure.exptime * 10 ** (0.4 * (job.exposure.filter.zeropoint(run.camera.telescope) - mag))
    limit = _SNR_FAINT * max(noise, 1.0) * np.sqrt(_APERTURE)
    background = ~pixels.saturated & ~_object_mask(job, columns, electrons / limit)
    level, _ = clipped(pixels.electrons[background if background.mean() > _BACKGROUND_MIN else ~pixels.saturated])
    losses = run.steps["SCIE"].losses
    response = response_map(
        job.chip,
        job.window,
        job.exposure.filter,
        job.exposure.exptime,
        flat=FlatField(run.camera.leds, run.streams(job).camera) if losses.flat else None,
        shutter=losses.shutter,
    )
    mean_response = 1.0 if response is None else float(response.mean())
    faint = electrons[electrons < limit].sum() / pixels.electrons.size
    dark = run.camera.detector.dark * job.exposure.exptime
    rate = (level - dark) / mean_response - faint
    sky = max(float(rate) / job.exposure.exptime, 0.0)
    header.notes.append(f"SKYRATE: sky of the frame's background, {level:.2f} e-: {sky:.4f} e-/s/px")
    return sky


def _object_mask(job: Job, columns: Mapping[str, AnyArray], flux_ratio: FloatArray) -> BoolArray:
    """Return (ny, nx) bool: pixels around detectable objects; flux_ratio (n,): flux over that of the faintest one."""
    import sep

    detectable = flux_ratio > 1
    at_x, at_y = job.wcs.world_to_pixel(*apparent(columns["ra"][detectable], columns["dec"][detectable], job.observer))
    x = np.ascontiguousarray(at_x - job.window.x0)
    y = np.ascontiguousarray(at_y - job.window.y0)
    mask = np.zeros(job.window.shape, bool)
    radius = np.minimum(_RADIUS_FAINT * np.cbrt(flux_ratio[detectable]), _RADIUS_MAX)
    sep.mask_ellipse(mask, x, y, radius, radius, np.zeros(len(x)), 1.0)
    return mask


def _write(
    folder: Path, data: Mapping[str, Any], layers: list[Any], table: str, columns: Mapping[str, AnyArray]
) -> None:
    from astropy.table import Table

    campaign = {key: value for key, value in data.items() if value != {}}
    files = {
        "campaign.yaml": yaml.safe_dump(campaign, sort_keys=False).encode(),
        "science.yaml": yaml.safe_dump({"layers": layers}, sort_keys=False).encode(),
        "survey_table.csv": table.encode(),
    } | {name: (ROOT / source).read_bytes() for name, source in WORKFLOW.items()}
    for name, content_of_file in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        with atomic_path(folder / name) as temporary:
            Path(temporary).write_bytes(content_of_file)
    with atomic_path(folder / "objects.fits") as temporary:
        Table(columns).write(temporary, format="fits", overwrite=True)
