"""The report of a campaign, from its products: the page, and the verdict beside it as JSON."""

import os
import zlib
from urllib.parse import quote

from csstsim import __version__
from csstsim.base.errors import InputError
from csstsim.base.one_thread import one_thread
from csstsim.base.plural import number_of
from csstsim.base.progress import progress
from csstsim.base.release import check_recipe
from csstsim.bricks import verdict as verdicts
from csstsim.campaign.costs import PICTURES
from csstsim.campaign.run_times import run_times
from csstsim.io.paths import made
from csstsim.report.parts import Link

EMBEDDED = 5_000_000  # bytes of figures of bricks and spectra in the page; the others are linked
PNG = b"\x89PNG\r\n\x1a\n"  # its first bytes


@one_thread
def report(run):
    """Write report/index.html and verdict.json of a campaign, and the files that make its bricks HATS catalogues.

    Prints the gates; returns the verdict (bricks.verdict). Raises InputError if a product is missing or belongs to
    another campaign.
    """
    from csstsim.bricks.hats import write_catalogue
    from csstsim.report.figures import sky_map
    from csstsim.report.page import write_report
    from csstsim.report.style import looks

    page, results = run.paths.report, [_validation(run, pix) for pix in run.merge_bricks]
    merged = {pix: _merged(run, pix) for pix in run.merge_bricks}
    verdict, budget = verdicts.judge(results), Budget(EMBEDDED)
    worst_first = sorted(results, key=lambda result: -verdicts.count(result["gates"])["fail"])
    pngs = {result["brick"]: run.paths.validate(result["brick"]).with_suffix(".png") for result in worst_first}
    shown = looks(run.camera.filters)
    science = run.science_jobs
    write_report(
        page, _summary(run), results,
        exposures=_exposures(run),
        files=[("verdict on the gates, JSON", "verdict.json")],
        figures={pix: png for pix, path in pngs.items() if (png := budget.read(path))},
        links={pix: _brick_links(run, pix, path) for pix, path in pngs.items()},
        sky_map=sky_map(
            [(job.chip.filter.lower(), *job.footprint()) for job in science], list(run.merge_bricks),
            shown, sorted({(job.pointing.ra, job.pointing.dec) for job in science}),
        ) if science else None,
        mosaic=_mosaic(run, shown),
        spectra=[_spectra(run, job, budget) for job in progress(run.slitless_jobs, "spectra")],
        provenance={
            "csstsim": __version__, "campaign file": run.file, "campaign digest": run.config.digest(),
            "camera digest": run.camera.digest, **_changed(run), "seed": run.config.seed,
        },
        times=run_times(run),
        labels={band: look.label for band, look in shown.items()},
    )  # fmt: skip
    # After the page, which reads all else: nothing is written if a product cannot be used
    verdicts.write_verdict(page.with_name("verdict.json"), verdict, campaign=run.config.name, csstsim=__version__)
    if merged:
        write_catalogue(run.paths.merge_catalogue, run.config.name, merged)
    sky = {pix: run.paths.truth(pix) for pix in run.sky_bricks}
    if sky and all(path.is_file() for path in sky.values()):  # they may be removed when the campaign is done
        write_catalogue(run.paths.truth_catalogue, f"{run.config.name} truth", sky)
    print("\n".join([*verdicts.lines(verdict), str(page)]))
    return verdict


class Budget:
    """Reads figures while there is room for them in the page."""

    def __init__(self, size):
        self.left = size

    def read(self, path):
        """Return a PNG's bytes, or None when there is no room left. Raises InputError if it is missing or damaged."""
        try:
            self.left -= path.stat().st_size
            figure = path.read_bytes() if self.left >= 0 else None
        except OSError as exc:
            raise InputError(f"cannot read a figure: {exc}", file=path) from None
        if figure is not None and not _is_png(figure):
            raise InputError("the PNG is damaged; make it again", file=path)
        return figure


def _is_png(data):
    """Whether bytes are a whole PNG: its signature, chunks with the checksums they state, the last one IEND."""
    start, kind = len(PNG), None
    while len(data) >= start + 12 and kind != b"IEND":
        size, kind = int.from_bytes(data[start : start + 4]), data[start + 4 : start + 8]
        content, start = data[start + 4 : start + 8 + size], start + 12 + size
        if zlib.crc32(content).to_bytes(4) != data[start - 4 : start]:
            return False
    return data.startswith(PNG) and kind == b"IEND" and start == len(data)


def _validation(run, pix):
    from csstsim.bricks.result_file import read_result

    path = made(run.paths.validate(pix), f"validate {run.file} --brick {pix}")
    result, limits = read_result(path), run.limits.model_dump(mode="json")
    check_recipe(path, result, run.brick_recipe(pix))
    if result.get("camera") != run.recipes.validation["camera"]:
        raise InputError("judged by other limits of the camera; validate the brick again", file=path, key="camera")
    if result["limits"] != limits:
        raise InputError(
            "judged by other thresholds; validate the brick again", file=path, key="limits", value=result["limits"],
            allowed=limits,
        )  # fmt: skip
    return result


def _merged(run, pix):
    """Return the path of a merged brick. Raises InputError if it belongs to another campaign."""
    from csstsim.catalog.table import ObjectTable

    path = run.paths.merge(pix)
    check_recipe(path, ObjectTable.read(path, ["source_id"]).meta, run.brick_recipe(pix))
    return path


def _link(run, label, path):
    return Link(label, quote(os.path.relpath(path, run.paths.report.parent)))


def _brick_links(run, pix, png):
    return (
        _link(run, "merged catalogue", run.paths.merge(pix)),
        _link(run, "validation", run.paths.validate(pix)),
        _link(run, "figure", png),
    )


def _spectra(run, job, budget):
    """Return (title, PNG bytes or None, *Links) of a spectroscopic frame for the report."""
    from csstsim.catalog.table import ObjectTable

    path = run.paths.spectra(*job.key)
    meta, figure = ObjectTable.read(path).meta, path.with_suffix(".png")
    check_recipe(path, meta, run.recipe(job, "measure"))
    count = number_of(meta["spectra"], "spectrum", "spectra")
    title = f"exposure {job.pointing.obsid}, chip {job.chip.id} ({job.chip.filter}): {count} extracted"
    return title, budget.read(figure), _link(run, "spectra", path), _link(run, "figure", figure)


def _mosaic(run, looks):
    """Return the focal plane of the exposures with the most chips, science before calibration."""
    from csstsim.io.level0 import read_level0
    from csstsim.report.mosaic import mosaic, take_exposure

    taken, exposures = 0, []
    for jobs in sorted(_by_exposure(run), key=lambda jobs: (jobs[0].pointing.type != "SCIE", -len(jobs))):
        if exposures and taken + len(jobs) > PICTURES:
            break
        taken += len(jobs)
        pointing, filters = jobs[0].pointing, ", ".join(dict.fromkeys(job.chip.filter for job in jobs))
        title = f"{pointing.obsid} ({pointing.type}, {pointing.exptime:g} s, {filters})"
        files = ((job.chip, read_level0(run.paths.level0(pointing, job.chip.id))) for job in progress(jobs, "frames"))
        exposures.append(take_exposure(title, pointing.pa, files))
    return mosaic(list(run.camera.chips.values()), exposures, looks)


def _by_exposure(run):
    """Return the jobs as a list of lists, one for each exposure."""
    exposures = {}
    for job in run.jobs:
        exposures.setdefault(job.pointing.obsid, []).append(job)
    return list(exposures.values())


def _changed(run):
    """Return {"camera changes": text} of the camera's numbers that the campaign changes, or {}."""
    changes = run.camera.files.changes
    return {"camera changes": ", ".join(f"{k} = {v}" for k, v in changes.items())} if changes else {}


def _summary(run):
    science = run.imaging_jobs + run.slitless_jobs
    return {
        "name": run.config.name,
        "exposures": len(_by_exposure(run)),
        "Level-0 files": len(run.jobs),
        "filters": ", ".join(f for f in run.camera.filters if any(job.chip.filter == f for job in science)),
        "bricks": len(run.merge_bricks),
        "faintest magnitude drawn": run.config.catalog.mag_limit or "the whole truth",
        "rendering": run.config.fidelity,
    }


def _exposures(run):
    return [
        {
            "obsid": jobs[0].pointing.obsid, "type": jobs[0].pointing.type, "ra [deg]": f"{jobs[0].pointing.ra:.6f}",
            "dec [deg]": f"{jobs[0].pointing.dec:.6f}", "pa [deg]": f"{jobs[0].pointing.pa:.4f}",
            "start [UTC]": jobs[0].pointing.time, "exposure [s]": jobs[0].pointing.exptime,
            "Level-0 of chip": tuple(
                _link(run, f"{job.chip.label} {job.chip.filter}", run.paths.level0(job.pointing, job.chip.id))
                for job in jobs
            ),
        }
        for jobs in _by_exposure(run)
    ]  # fmt: skip
