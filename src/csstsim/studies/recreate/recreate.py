"""`csstsim recreate FRAME TRUTH --output DIR`: a campaign that draws again what a frame and its catalogue describe.

The header gives exposure, chip, window, seed, layers and numbers of the camera (recreate.frame), the catalogue the
objects (recreate.objects). Of a frame that does not log how bright its sky is, the pixels do. What none of them says is
assumed, and said.
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
from csstsim.studies.recreate.objects import check_frame, own_table, read_objects
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
_FAINT = 5.0  # S/N below which an object's light lies in the background, as the clipped mean sees it
_APERTURE = 50  # pixels whose noise such an object has to exceed
# px about one object that are left out of the background; fraction to be left
_NEAR = 10.0
_FAR = 300.0
_FREE_MIN = 0.05


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

    instrument: the camera's folder, None the shipped one; seed: where the header has none. `log` gets each assumption,
    each reason why objects are left out, and what to do next. Raises InputError for files that cannot be used; then
    nothing is written.
    """
    folder = Path(folder)
    existing = next((name for name in (*FILES, *WORKFLOW) if (folder / name).exists()), None)
    if existing or (folder.exists() and not folder.is_dir()):
        raise InputError("exists already; name another folder", file=folder / existing if existing else folder)
    head = read_frame(frame)
    objects = read_objects(truth)
    data, layers, table = described(head, instrument, seed)
    run, job = opened(head.path, data, layers, table)
    digest = run.recipe(job)["camera"]
    if head.keys.get(RECIPE["camera"], digest) != digest:
        head.notes.append("CAMHASH: made with other numbers of the camera than those taken here (--instrument)")
    if not len(objects):
        raise InputError("the catalogue has no rows", file=truth)
    check_frame(objects, truth, job, turned=ANGLE_IF_NONE not in head.notes)
    head.notes += _of_maps(head.camera_maps(), job.chip.maps.record)
    columns, left = own_table(objects, job, run.camera.bands, head.notes)
    if not len(columns["id"]):
        raise InputError("no object of it can be drawn", file=truth, value="; ".join(left))
    if head.number("SKYRATE") is None and job.chip.kind == "slitless":
        head.notes.append("SKYRATE: the sky of the camera's filter")
    elif head.number("SKYRATE") is None:
        data["instrument"] |= {f"filters.{job.chip.filter}.sky": _sky(head, run, job, columns)}
        make_campaign(data, folder / "campaign.yaml")
    _write(folder, data, layers, table, columns)
    if objects.meta.get("types"):
        head.notes.append(f"obj_type: numbers, taken as {objects.meta['types']}")
    for note in head.notes:
        log(f"assumed  {note}")
    for reason, ids in left.items():
        few = ", ".join(map(str, ids[:SHOWN])) + (", ..." if len(ids) > SHOWN else "")
        log(f"left out {number_of(len(ids), 'object')}: {reason} ({few})")
    [obsid] = data["select"]["obsids"]
    drawn = number_of(len(columns["id"]), "object")
    log(f"{folder}: {drawn} of exposure {obsid}, chip {job.chip.id} ({job.chip.filter})")
    file = shlex.quote(str(folder / "campaign.yaml"))
    log(f"\nNext:  csstsim chip {file} --obsid {obsid} --chip {job.chip.id}")
    files = shlex.join([str(frame), str(job_file(folder, run, job)), "--truth", str(truth)])
    log(f"       csstsim compare {files}")


def job_file(folder: PathLike, run: OpenCampaign, job: Job) -> Path:
    """Return where the Level-0 file of a recreated job will be."""
    return Path(folder) / run.config.output / run.paths.level0(job).relative_to(run.paths.output)


def described(head: FrameHeader, instrument: PathLike | None, seed: int | None) -> Description:
    """Return the Description by a frame's header."""
    camera = load_camera(instrument)
    changes = head.camera_changes() if head.ours else _camera_of(head, camera.detector)
    if head.chip not in camera.chips:
        raise InputError("no such chip of the camera", file=head.path, key="DETECTOR", value=head.chip)
    filter_ = camera.chips[head.chip].filter
    named = str(head.get("FILTER") or "")
    if named and named.lower() != filter_.lower():
        raise InputError(
            "the camera's chip has another filter", file=head.path, key="FILTER", value=named, allowed=filter_
        )
    layers = head.layers() or _shipped_layers()
    exposure = head.exposure
    window = head.window(camera.detector)
    known = head.number("SIMSEED") if seed is None else seed
    if known is None:
        what = f"seed {SEED_IF_NONE}: flat field, gains, defects, rays and noise are others than the frame's"
        known = head.assumed("SIMSEED", SEED_IF_NONE, what)
    if known < 0 or known != int(known):
        raise InputError("no seed", file=head.path, key="SIMSEED", value=known, allowed="a whole number from 0 on")
    data: dict[str, Any] = {
        "schema_version": 1,
        "name": "recreated",
        "survey_table": "survey_table.csv",
        "output": "results",
        "seed": int(known),
        "select": {"types": ["SCIE"], "obsids": [exposure["obsid"]], "chips": [head.chip]},
        "observations": {"SCIE": "science.yaml"},
        "instrument": dict(changes),
        "catalog": {"kind": "csstsim.catalog.own_table:TableCatalog", "options": {"file": "objects.fits"}},
        "truth": ["parquet", "cat"],
    }
    if window:
        data["window"] = dict(zip(("x0", "x1", "y0", "y1"), window, strict=True))
    if "EPHEM" in head.keys:
        data["astrometry"] = {"ephemeris": head.keys["EPHEM"], "planets": bool(head.keys.get("LDPLANET", False))}
    if instrument:
        data["instrument"]["folder"] = str(Path(instrument).resolve())
    if any("poisson_and_dark" in layer for layer in layers):
        head.notes.append("psf, fidelity: those of a campaign file that does not name them")
    else:
        data["fidelity"] = "noise_free"
        head.notes.append("fidelity: noise_free, for the header's layers lack poisson_and_dark")
        head.notes.append("psf: that of a campaign file that does not name it")
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([exposure, [_written(v) for v in exposure.values()]])
    return Description(data, layers, text.getvalue())


def _written(value: str | float) -> str:
    return repr(value) if isinstance(value, float) else str(value)


def _camera_of(head: FrameHeader, detector: Detector) -> dict[str, float]:
    """Return {number of the camera: value} that a frame of others states, means over its channels."""
    found = {}
    for name, keywords, usual in (
        ("gain", ("GAIN", "GAIN1"), detector.gain),
        ("read_noise", ("RON", "RDNOIS", "RDNOISE1"), detector.read_noise),
    ):
        value = _mean(head, keywords)
        first, *_ = keywords
        found[f"detector.{name}"] = head.assumed(f"{first}01", usual, f"{usual:g}") if value is None else value
    level = _mean(head, ("DETBIA", "BIAS"))
    if level is not None:
        found["detector.bias"] = level * found["detector.gain"]
    return found


def _mean(head: FrameHeader, keywords: Sequence[str]) -> float | None:
    channels = [head.number(f"{key}{n:02d}") for key in keywords for n in range(1, 17)]
    known = [v for v in [*channels, *(head.number(key) for key in keywords)] if v is not None and v > 0]
    return float(np.mean(known)) if known else None


def _shipped_layers() -> list[Any]:
    return yaml.safe_load((ROOT / "config/observations/science.yaml").read_text())["layers"]


def opened(frame: PathLike, data: Mapping[str, Any], layers: list[Any], table: str) -> tuple[OpenCampaign, Job]:
    """Return the campaign that is described, opened without files, its objects among them, and its job.

    Raises InputError that names the frame, whose header has the value: the campaign's files are not there yet.
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


def _of_maps(stated: Mapping[str, str], taken: Mapping[str, str]) -> Iterator[str]:
    """Yield what is said of each laboratory map that a frame was made with: its pixels are not in the header."""
    for name, record in stated.items():
        here = taken.get(f"maps.{name}")
        if here is None:
            yield f"maps.{name}: none, for the camera taken here has no such map; the frame's was {record}"
        elif here == record:
            yield f"maps.{name}: the map of the camera taken here, {here}, as in the frame"
        else:
            yield f"maps.{name}: the map of the camera taken here, {here}; the frame's was {record}"


def _sky(head: FrameHeader, run: OpenCampaign, job: Job, columns: Mapping[str, AnyArray]) -> float:
    """Return the sky [e-/s/px] of the frame's background: without dark current and objects too faint to be seen."""
    from csstsim.optics.throughput.flat import FlatField
    from csstsim.optics.throughput.response import response_map

    pixels = read_electrons(head, run.camera.detector)
    if pixels.saturated.all():
        raise InputError("every pixel is saturated", file=head.path)
    _, noise = clipped(pixels.electrons[~pixels.saturated])
    mag = columns[f"mag_{job.chip.filter.lower()}"]
    light = job.exposure.exptime * 10 ** (0.4 * (job.exposure.filter.zeropoint(run.camera.telescope) - mag))
    limit = _FAINT * max(noise, 1.0) * np.sqrt(_APERTURE)
    free = ~pixels.saturated & ~_around(job, columns, light / limit)
    level, _ = clipped(pixels.electrons[free if free.mean() > _FREE_MIN else ~pixels.saturated])
    losses = run.steps["SCIE"].losses
    response = response_map(
        job.chip,
        job.window,
        job.exposure.filter,
        job.exposure.exptime,
        flat=FlatField(run.camera.leds, run.streams(job).camera) if losses.flat else None,
        shutter=losses.shutter,
    )
    share = 1.0 if response is None else float(response.mean())
    faint = light[light < limit].sum() / pixels.electrons.size
    dark = run.camera.detector.dark * job.exposure.exptime
    rate = (level - dark) / share - faint
    sky = max(float(rate) / job.exposure.exptime, 0.0)
    head.notes.append(f"SKYRATE: sky of the frame's background, {level:.2f} e-: {sky:.4f} e-/s/px")
    return sky


def _around(job: Job, columns: Mapping[str, AnyArray], times: FloatArray) -> BoolArray:
    """Return (ny, nx) bool: pixels about objects that are seen, `times` as bright as the faintest of them."""
    import sep

    seen = times > 1
    at_x, at_y = job.wcs.world_to_pixel(*apparent(columns["ra"][seen], columns["dec"][seen], job.observer))
    x = np.ascontiguousarray(at_x - job.window.x0)
    y = np.ascontiguousarray(at_y - job.window.y0)
    mask = np.zeros(job.window.shape, bool)
    radius = np.minimum(_NEAR * np.cbrt(times[seen]), _FAR)
    sep.mask_ellipse(mask, x, y, radius, radius, np.zeros(len(x)), 1.0)
    return mask


def _write(
    folder: Path, data: Mapping[str, Any], layers: list[Any], table: str, columns: Mapping[str, AnyArray]
) -> None:
    from astropy.table import Table

    told = {key: value for key, value in data.items() if value != {}}
    content = {
        "campaign.yaml": yaml.safe_dump(told, sort_keys=False).encode(),
        "science.yaml": yaml.safe_dump({"layers": layers}, sort_keys=False).encode(),
        "survey_table.csv": table.encode(),
    } | {name: (ROOT / source).read_bytes() for name, source in WORKFLOW.items()}
    for name, data_ in content.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        with atomic_path(folder / name) as temporary:
            Path(temporary).write_bytes(data_)
    with atomic_path(folder / "objects.fits") as temporary:
        Table(columns).write(temporary, format="fits", overwrite=True)
