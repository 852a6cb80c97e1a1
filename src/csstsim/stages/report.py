"""The report of a campaign, from its products: the page, and the verdict as JSON."""

from __future__ import annotations

import json
import os
import socket
import zlib
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote

from csstsim import __version__
from csstsim.base.commit import git_commit
from csstsim.base.errors import InputError
from csstsim.base.plural import number_of
from csstsim.base.process.one_thread import one_thread
from csstsim.base.process.progress import progress
from csstsim.base.release import check_recipe
from csstsim.campaign.products import kinds
from csstsim.campaign.running.run_times import run_times
from csstsim.io.paths import existing_product
from csstsim.measure.bricks.validation import verdict as verdicts
from csstsim.report.page import FrameSpectra, KindOfFiles
from csstsim.report.parts import Link
from csstsim.stages.parts.report_pictures import by_exposure, focal_plane, sky_pictures
from csstsim.stages.parts.sky_of_frames import sky_of_frames

if TYPE_CHECKING:
    from typing import Any

    from csstsim.campaign.job import Job
    from csstsim.campaign.opened import OpenCampaign

EMBEDDED = 1_500_000  # bytes of figures of bricks and spectra in the page; the others are linked
LINKED = 500  # files of a kind that the page links one by one
PNG = b"\x89PNG\r\n\x1a\n"  # its first bytes


@one_thread
def report(run: OpenCampaign) -> dict[str, Any]:
    """Write report/index.html and verdict.json of a campaign, and the files that make its bricks HATS catalogues.

    Prints the gates; returns the verdict (validation.verdict). Raises InputError if a product is missing or belongs to
    another campaign.
    """
    from csstsim.measure.bricks.hats import write_catalogue
    from csstsim.report.figures import sky_map
    from csstsim.report.page import ReportContent, write_report
    from csstsim.report.pictures import chart
    from csstsim.report.style import band_styles

    page = run.paths.report
    results = [_validation(run, pix) for pix in run.merge_bricks]
    merged = {pix: _merged(run, pix) for pix in run.merge_bricks}
    spectra = [gate for job in run.slitless_jobs for gate in _spectra_gates(run, job)]
    verdict = verdicts.verdict_of_results(results, spectra)
    budget = Budget(EMBEDDED)
    worst_first = sorted(results, key=lambda result: -verdicts.count(result["gates"])["fail"])
    pngs = {result["brick"]: run.paths.validate(result["brick"]).with_suffix(".png") for result in worst_first}
    shown = band_styles(run.camera.filters)
    science = run.science_jobs
    content = ReportContent(
        gates=verdict["gates"],
        sky=[part for part in sky_pictures(run) if part],
        exposures=_exposures(run),
        products=_products(run),
        figures={pix: figure for pix, path in pngs.items() if (figure := budget.read(path))},
        links={pix: _brick_links(run, pix, path) for pix, path in pngs.items()},
        sky_map=chart(
            sky_map(
                [(job.chip.filter.lower(), *job.footprint()) for job in science],
                list(run.merge_bricks),
                shown,
                sorted({(job.pointing.ra, job.pointing.dec) for job in science}),
            )
        )
        if science
        else None,
        mosaic=focal_plane(run, shown),
        stray_light=sky_of_frames(run, shown),
        spectra=[_spectra(run, job, budget) for job in progress(run.slitless_jobs, "spectra")],
        provenance=_provenance(run),
        layers=_layers(run),
        times=run_times(run),
        labels={band: style.label for band, style in shown.items()},
    )
    write_report(page, _summary(run), results, content)
    # After the page, which reads all else: nothing is written if a product cannot be used
    verdicts.write_verdict(page.with_name("verdict.json"), verdict, campaign=run.config.name, csstsim=__version__)
    if merged:
        write_catalogue(run.paths.merge_catalogue, run.config.name, merged)
    sky = {pix: run.paths.truth(pix) for pix in kinds(run)["truth"].made_for}
    if sky and all(path.is_file() for path in sky.values()):  # they may be removed when the campaign is done
        write_catalogue(run.paths.truth_catalogue, f"{run.config.name} truth", sky)
    print("\n".join([*verdicts.lines(verdict), str(page)]))
    return verdict


class Budget:
    """Reads figures until their total size in the page exceeds that allowed."""

    def __init__(self, size: int) -> None:
        self.left = size

    def read(self, path: Path) -> bytes | None:
        """Return a PNG as report.pictures.chart, or None if the size is exceeded.

        Raises InputError if it is missing or damaged.
        """
        from csstsim.report.pictures import chart

        try:
            png = path.read_bytes()
        except OSError as exc:
            raise InputError(f"cannot read a figure: {exc}", file=path) from None
        if self.left < 0:
            return None
        if not _is_png(png):
            raise InputError("the PNG is damaged; make it again", file=path)
        figure = chart(png)
        self.left -= len(figure)
        return figure if self.left >= 0 else None


def _is_png(data: bytes) -> bool:
    """Whether bytes are a whole PNG: its signature, chunks with the checksums they state, the last one IEND."""
    start = len(PNG)
    kind: bytes | None = None
    while len(data) >= start + 12 and kind != b"IEND":
        size = int.from_bytes(data[start : start + 4])
        kind = data[start + 4 : start + 8]
        content = data[start + 4 : start + 8 + size]
        start = start + 12 + size
        if zlib.crc32(content).to_bytes(4) != data[start - 4 : start]:
            return False
    return data.startswith(PNG) and kind == b"IEND" and start == len(data)


def _validation(run: OpenCampaign, pix: int) -> dict[str, Any]:
    from csstsim.measure.bricks.validation.result_file import read_result

    path = existing_product(run.paths.validate(pix), f"validate {run.file} --brick {pix}")
    result = read_result(path)
    limits = run.limits.model_dump(mode="json")
    check_recipe(path, result, run.brick_recipe(pix))
    if result.get("camera") != run.recipes.validation["camera"]:
        raise InputError("evaluated by other limits of the camera; validate the brick again", file=path, key="camera")
    if result["limits"] != limits:
        raise InputError(
            "evaluated by other thresholds; validate the brick again",
            file=path,
            key="limits",
            value=result["limits"],
            allowed=limits,
        )
    return result


def _merged(run: OpenCampaign, pix: int) -> Path:
    """Return the path of a merged brick. Raises InputError if it belongs to another campaign."""
    from csstsim.catalog.table import ObjectTable

    path = run.paths.merge(pix)
    check_recipe(path, ObjectTable.read(path, ["source_id"]).meta, run.brick_recipe(pix))
    return path


def _link(run: OpenCampaign, label: str, path: Path) -> Link:
    return Link(label, quote(os.path.relpath(path, run.paths.report.parent)))


def _brick_links(run: OpenCampaign, pix: int, png: Path) -> tuple[Link, Link, Link]:
    return (
        _link(run, "merged catalogue", run.paths.merge(pix)),
        _link(run, "validation", run.paths.validate(pix)),
        _link(run, "figure", png),
    )


def _spectra_gates(run: OpenCampaign, job: Job) -> list[dict[str, Any]]:
    """Return the gates of a spectroscopic frame. Raises InputError for spectra of an older version."""
    from csstsim.catalog.table import ObjectTable
    from csstsim.measure.bricks.validation.gates.register import evaluate

    path = run.paths.spectra(*job.key)
    meta = ObjectTable.read(path, ["id"]).meta
    check_recipe(path, meta, run.recipe(job, "measure"))
    if "checks" not in meta:
        raise InputError("spectra of an older version; extract them again", file=path, key="checks")
    band = job.chip.filter.lower()
    return evaluate("spectra", meta["checks"], run.limits, band, exposure=job.obsid, chip=job.chip.id)


def _spectra(run: OpenCampaign, job: Job, budget: Budget) -> FrameSpectra:
    """Return the FrameSpectra of a spectroscopic frame."""
    from csstsim.catalog.table import ObjectTable
    from csstsim.measure.spectra.line_fluxes import DETECTED, detectable

    path = run.paths.spectra(*job.key)
    meta = ObjectTable.read(path).meta
    figure = path.with_suffix(".png")
    check_recipe(path, meta, run.recipe(job, "measure"))
    count = number_of(meta["spectra"], "spectrum", "spectra")
    table = ObjectTable.read(run.paths.lines(*job.key), ["flux_true", "flux_err"])
    lines = table.meta
    title = f"exposure {job.obsid}, chip {job.chip.id} ({job.chip.filter}): {count} extracted"
    title += f", {lines['detected']} of {number_of(lines['lines'], 'line')} detected at S/N above {DETECTED:g}, "
    title += f"{detectable(table)} expected from the true fluxes"
    if lines["pull_width"] is not None:
        title += f"; {lines['isolated']} isolated lines differ from the truth by {lines['pull_width']:.2f} sigma (rms)"
    links = _link(run, "spectra", path), _link(run, "lines", run.paths.lines(*job.key)), _link(run, "figure", figure)
    return FrameSpectra(title, budget.read(figure), links)


def _products(run: OpenCampaign) -> list[KindOfFiles]:
    """Return the products by kind; more than LINKED files have one Link, to their folder."""
    file_kinds = []
    table = kinds(run)
    written = [Path(path) for path in table.pop("report").files()]  # after the page: their sizes are not known yet
    for kind in table.values():
        paths = [path for path in map(Path, kind.files()) if path.is_file()]
        if not paths:
            continue
        size = sum(path.stat().st_size for path in paths)
        file_links = [_link(run, f"{path.name} ({_size(path.stat().st_size)})", path) for path in paths[: LINKED + 1]]
        folder = run.paths.output / paths[0].relative_to(run.paths.output).parts[0]
        links = file_links if len(paths) <= LINKED else [_link(run, f"the folder {folder.name}", folder)]
        file_kinds.append(KindOfFiles(kind.name, len(paths), _size(size), tuple(links)))
    page_files = tuple(_link(run, path.name, path) for path in written if path != run.paths.report)
    folders = [run.paths.output / name for name in ("look", "logs")]
    folder_links = tuple(_link(run, f"the folder {folder.name}", folder) for folder in folders if folder.is_dir())
    count = len(page_files)
    return [
        *file_kinds,
        KindOfFiles("next to this page", count, "and other folders of the workflow", page_files + folder_links),
    ]


def _size(size: float) -> str:
    """Return a number of bytes as text of two or three digits."""
    for unit in ("bytes", "kB", "MB", "GB"):
        if size < 1000 or unit == "GB":
            return f"{size:.3g} {unit}" if size < 1000 else f"{size:.0f} {unit}"
        size /= 1000
    raise AssertionError("not reached: any size can be stated in GB")


def _provenance(run: OpenCampaign) -> dict[str, str | int | Path | None]:
    """Return {label: value} of the provenance of the campaign and of the report."""
    changes = run.camera.files.changes
    changed = {"camera changes": ", ".join(f"{k} = {v}" for k, v in changes.items())} if changes else {}
    layers = {f"layers of {kind}": ", ".join(s.keyword for s in steps.steps) for kind, steps in run.steps.items()}
    return {
        "csstsim": __version__,
        "commit": git_commit(),
        "report written": f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC",
        "host": socket.gethostname(),
        "campaign file": run.file,
        "survey table": run.config.survey_table.name,
        "campaign digest": run.config.digest(),
        "camera digest": run.camera.digest,
        **changed,
        "seed": run.config.seed,
        **layers,
    }


def _layers(run: OpenCampaign) -> list[tuple[str, str, str]]:
    """Return [(exposure type, layer, its parameters as JSON)] in order."""
    return [
        (kind, step.keyword, json.dumps(step.param.model_dump(mode="json"), sort_keys=True))
        for kind, steps in run.steps.items()
        for step in steps.steps
    ]


def _summary(run: OpenCampaign) -> dict[str, str | float | Link]:
    science = run.imaging_jobs + run.slitless_jobs
    reasons = "; ".join(f"{obsid} chip {chip}: {why}" for (obsid, chip), why in run.declared_missing.items())
    missing = {"declared missing": reasons} if reasons else {}
    variants_link = {"variants": _link(run, "side by side", run.paths.variants_page)} if run.variants else {}
    return {
        "name": run.title,
        "exposures": len(by_exposure(run)),
        "Level-0 files": len(run.jobs),
        "filters": ", ".join(f for f in run.camera.filters if any(job.chip.filter == f for job in science)),
        "bricks": len(run.merge_bricks),
        "faintest magnitude rendered": run.config.catalog.mag_limit or "the whole truth",
        "rendering": run.config.fidelity,
        **missing,
        **variants_link,
    }


def _exposures(run: OpenCampaign) -> list[dict[str, str | float | tuple[Link, ...]]]:
    return [
        {
            "obsid": jobs[0].obsid,
            "type": jobs[0].pointing.type,
            "ra [deg]": f"{jobs[0].pointing.ra:.6f}",
            "dec [deg]": f"{jobs[0].pointing.dec:.6f}",
            "pa [deg]": f"{jobs[0].pointing.pa:.4f}",
            "start [UTC]": jobs[0].pointing.time,
            "exposure [s]": jobs[0].pointing.exptime,
            "Level-0 of chip": tuple(
                _link(run, f"{job.chip.label} {job.chip.filter}", run.paths.level0(job)) for job in jobs
            ),
        }
        for jobs in by_exposure(run)
    ]
