"""Shear: m and c of finished twin campaigns (paper, section 5.3.1)."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from csstsim.base.errors import InputError
from csstsim.base.plural import number_of
from csstsim.base.process.one_thread import one_thread
from csstsim.base.process.progress import progress
from csstsim.campaign.opened import OpenCampaign
from csstsim.stages.level0 import truth_of
from csstsim.stages.measure import measured_table

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from csstsim.base.types import FloatArray, PathLike
    from csstsim.render.settings import Numbers


@one_thread
def shear(files: Iterable[PathLike], output: PathLike | None, log: Callable[[str], object]) -> bool:
    """Log m and c of finished twin campaigns (validation.shear), write them as JSON; return whether all gates pass.

    Raises InputError for campaigns that are not pairs, or too few galaxies.
    """
    from csstsim.base.files.atomic import atomic_path
    from csstsim.measure.bricks.validation.shear import calibration, pair_means, shear_gates
    from csstsim.measure.bricks.validation.verdict import NAMES

    runs = [OpenCampaign(file) for file in files]
    shears = []
    means = []
    for lensing, twins in _twins(runs).items():
        means.append(pair_means(*(_shapes_on(run) for run in twins)))
        kappa, *gamma = lensing
        shears.append([value / (1 - kappa) for value in gamma])
        count = number_of(len(means[-1]), "galaxy", "galaxies")
        log(f"g = {shears[-1][0]:+.4f}, {shears[-1][1]:+.4f}: {count} in both twins")
    try:
        fits = calibration(shears, means)
    except ValueError as exc:
        raise InputError(str(exc), file=runs[0].file, key="catalog") from None
    gates = shear_gates(fits, runs[0].config.validation)
    for gate in gates:
        name, axis = gate["name"].split()[1]
        if gate["value"] is not None:
            error = fits[int(axis) - 1][f"{name}_err"]
            verdict = NAMES[gate["passed"]]
            limit = f"at most {gate['threshold']}, 5 sigma forgiven"
            log(f"{gate['name']} = {gate['value']:+.4f} +- {error:.4f}, {limit}: {verdict}")
    if output:
        with atomic_path(output) as temporary:
            temporary.write_text(json.dumps({"fits": fits, "gates": gates}, indent=1) + "\n")
    return not any(gate["passed"] is False for gate in gates)


def _twins(runs: Iterable[OpenCampaign]) -> dict[tuple[float, float, float], tuple[OpenCampaign, OpenCampaign]]:
    """Return {(kappa, gamma1, gamma2): (campaign, the twin with rotated shapes)}."""
    found: dict[tuple[float, float, float], dict[str, OpenCampaign]] = {}
    for run in runs:
        catalog = run.config.catalog
        if catalog.lensing.field != "constant":
            raise InputError(
                "the shear is not constant",
                file=run.file,
                key="catalog.lensing.field",
                value=catalog.lensing.field,
                allowed="constant",
            )
        key = catalog.lensing.kappa, catalog.lensing.gamma1, catalog.lensing.gamma2
        pair = found.setdefault(key, {})
        if catalog.shapes in pair:
            raise InputError(
                f"has the same shear and shapes as {pair[catalog.shapes].file}",
                file=run.file,
                key="catalog.shapes",
                value=catalog.shapes,
                allowed="normal and rotated90, one of each",
            )
        pair[catalog.shapes] = run
    for pair in found.values():
        first, *rest = pair.values()
        if not rest or _but_shapes(first) != _but_shapes(rest[0]):
            raise InputError(
                "has no twin of the same seed, camera, exposures and shear",
                file=first.file,
                key="catalog.shapes",
                value=first.config.catalog.shapes,
                allowed="normal and rotated90, one of each",
            )
    return {key: (pair["normal"], pair["rotated90"]) for key, pair in found.items()}


def _but_shapes(run: OpenCampaign) -> tuple[str | None, Numbers, list[dict[str, str]]]:
    """Return what is equal for twins: all that determines their pixels and measurements, except `catalog.shapes`."""
    config = run.config.model_copy(update={"catalog": run.config.catalog.model_copy(update={"shapes": "normal"})})
    recipes = [run.recipe(job, "measure") | {"campaign": config.digest()} for job in run.imaging_jobs]
    return run.universe.digest if run.embedded else None, run.rendering, recipes


def _shapes_on(run: OpenCampaign) -> list[dict[int, FloatArray]]:
    """Return validation.shear.shapes of each measured frame of a campaign."""
    from csstsim.measure.bricks.validation.measured_frame import MeasuredFrame, truth_inside
    from csstsim.measure.bricks.validation.shear import shapes

    seam = run.camera.detector.channel_ny
    out = []
    for job in progress(run.imaging_jobs, "frames"):
        frame = MeasuredFrame(truth_of(run, job), measured_table(run, job), seam, run.camera.telescope.pixel_scale)
        out.append(shapes(frame, truth_inside(frame)))
    return out
