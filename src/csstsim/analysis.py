"""After Level-0: measure each frame, merge and validate each brick (paper, section 6)."""

import json
from dataclasses import replace

import numpy as np

from csstsim import __version__
from csstsim.calibration import calibrated_frame
from csstsim.campaign import OpenCampaign
from csstsim.catalog.table import GALAXY
from csstsim.config import SHIPPED
from csstsim.errors import InputError
from csstsim.io.paths import made
from csstsim.one_thread import one_thread
from csstsim.prepare import open_psf
from csstsim.progress import progress
from csstsim.release import check_recipe
from csstsim.yaml_file import read_yaml

LIMITS = SHIPPED / "limits.yaml"
LIMIT_SECONDS = 150.0  # of the limiting magnitudes there and in filters.yaml


@one_thread
def measure(run, job):
    """Detect and measure the sources of a Level-0 file."""
    from csstsim.measure.catalogue import measure_frame

    file, calibrated = calibrated_frame(run, job)
    table = measure_frame(
        calibrated, open_psf(run, job.chip), job.wcs, file.observer, chip=job.chip,
        filter=run.camera.filters[job.chip.filter], telescope=run.camera.telescope, pointing=job.pointing,
        window=job.window,
    )  # fmt: skip
    table.write(run.paths.measure(*job.key), table.meta | {"recipe": run.measure_recipe(job)})
    print(f"{len(table)} sources, 5 sigma at {table.meta['depth_5sigma']:.2f} AB")


@one_thread
def extract(run, job):
    """Extract the first-order spectra of a Level-0 file of a spectroscopic chip, and draw some of them."""
    from csstsim.atomic import atomic_path
    from csstsim.measure.extract import extract_spectra
    from csstsim.measure.spectra_figures import spectra_figure

    truth, frame, orders, *others = spectra_of_frame(run, job)
    table = extract_spectra(frame, orders, *others)
    path = run.paths.spectra(*job.key)
    with atomic_path(path.with_suffix(".png")) as temporary:
        temporary.write_bytes(spectra_figure(truth, frame, orders, table))
    table.write(path, table.meta | {"recipe": run.measure_recipe(job)})
    print(f"{table.meta['spectra']} spectra of S/N {table.meta['snr_min']:g} and more in a resolution element")


def spectra_of_frame(run, job):
    """Return (truth, *what measure.extract.extract_spectra takes) of a job's Level-0 file and its tables.

    Raises InputError, also for a chip without a grating.
    """
    from csstsim.in_memory import object_spectra
    from csstsim.io.orders import check_orders, read_orders
    from csstsim.measure.extract import Frame, Sources
    from csstsim.measure.spectral_model import make_model
    from csstsim.optics.beyond import read_beyond

    if not run.has_orders(job):
        chips = ", ".join(str(chip.id) for chip in run.camera.slitless_chips)
        raise InputError(
            "has no spectra", file=run.file, key="chip", value=job.chip.id, allowed=f"{chips}, in SCIE exposures"
        )
    file, calibrated = calibrated_frame(run, job)
    path, truth, psf = run.paths.level0_orders(job.pointing, job.chip.id), truth_of(run, job), open_psf(run, job.chip)
    gratings = run.camera.gratings[job.chip.id]
    orders = read_orders(path)
    check_recipe(path, orders.meta, run.recipe(job))
    check_orders(path, orders, len(truth), gratings)
    truth.meta["truth_hash"] = file.header0.get("TRUTHASH")  # a catalogue is opened again only if it is the same
    sources = Sources(_shapes(truth, job.wcs), object_spectra(run, job, truth), run.disperser(job).edges)
    middle = 0.5 * (job.window.x0 + job.window.x1), 0.5 * (job.window.y0 + job.window.y1)
    wing, photons = read_beyond(psf).wing, run.camera.telescope.area_m2 * job.pointing.exptime
    model = make_model(gratings, photons, psf.at(*middle), psf.oversampling, psf.wavelength, wing)
    frame = Frame.of(calibrated, job.window)
    others = model.image(orders, sources.shapes, sources.spectra, sources.edges, job.window, frame.faintest)
    return truth, replace(frame, others=others), orders, sources, model, psf, wing


def _shapes(truth, wcs):
    """Return the measure.line_profile.Shapes of the objects of a truth table."""
    from csstsim.measure.line_profile import Shapes
    from csstsim.render.scene import shape_matrix

    galaxy = truth["obj_type"] == GALAXY
    bulge = np.where(galaxy, truth["bulge_frac"].astype(float), 0.0)
    sizes = np.where(galaxy[:, None], np.stack([truth["size_disk"], truth["size_bulge"]], axis=1), 0.0)
    return Shapes.of(shape_matrix(truth, wcs), np.stack([1 - bulge, bulge], axis=1), sizes)


@one_thread
def merge(run, pix):
    """Merge the measurements of a brick: one row per source."""
    from csstsim.bricks.merge import DETECTION_COLUMNS, merge_brick, write_merged

    jobs = _jobs_on(run, pix)
    sources, detections = merge_brick(pix, (_measured(run, job, DETECTION_COLUMNS) for job in progress(jobs, "frames")))
    metadata = {
        "product": "merged brick", "csstsim": __version__, "campaign": run.config.name, "brick": pix,
        "recipe": run.brick_recipe(pix), "frames": len(jobs),
    }  # fmt: skip
    write_merged(run.paths.merge(pix), sources, detections, metadata)
    print(f"{len(sources)} sources from {len(detections)} detections")


@one_thread
def validate(run, pix):
    """Compare a merged brick with the truth of the frames on it."""
    from csstsim.atomic import atomic_path
    from csstsim.bricks.figures import brick_figure
    from csstsim.bricks.result_file import write_result
    from csstsim.bricks.validate import Frame, validate_brick
    from csstsim.bricks.verdict import NAMES, sentence
    from csstsim.catalog.table import ObjectTable
    from csstsim.frame_facts import frame_facts

    seam = run.camera.detector.channel_ny
    frames = (
        Frame(truth_of(run, job), _measured(run, job), seam, _depth(run, job), frame_facts(run, job))
        for job in progress(_jobs_on(run, pix), "frames")
    )
    merged = ObjectTable.read(made(run.paths.merge(pix), f"merge {run.file} --brick {pix}"))
    check_recipe(run.paths.merge(pix), merged.meta, run.brick_recipe(pix))
    result, arrays = validate_brick(pix, merged, frames, run.config.validation)
    result |= {
        "csstsim": __version__,
        "recipe": run.brick_recipe(pix),
        "limits": run.config.validation.model_dump(mode="json"),
    }
    path, limits = run.paths.validate(pix), run.config.validation
    with atomic_path(path.with_suffix(".png")) as temporary:
        temporary.write_bytes(brick_figure(result, arrays, threshold=limits.completeness_min, snr_min=limits.snr_min))
    write_result(path, result)
    for gate in result["gates"]:
        sources = "" if gate["n"] is None else f", {gate['n']} sources"
        print(f"{NAMES[gate['passed']]}: {sentence({'brick': pix, **gate})}{sources}")


def _depth(run, job):
    """Return (low, high): the 5-sigma magnitudes known of the filter, scaled to the exposure's time, or None."""
    computed = read_yaml(LIMITS)["computed"]["values"].get(job.chip.filter)
    if computed is None:
        return None
    stated = run.camera.filters[job.chip.filter].limiting_mag
    return tuple(np.sort([stated, computed]) + 1.25 * np.log10(job.pointing.exptime / LIMIT_SECONDS))


def _measured(run, job, columns=None):
    from csstsim.catalog.table import ObjectTable

    path = made(run.paths.measure(*job.key), f"measure {run.file} {job.options}")
    table = ObjectTable.read(path, columns)
    check_recipe(path, table.meta, run.measure_recipe(job))
    return table


def truth_of(run, job):
    """Return the truth table beside a job's Level-0 file (io.truth.read_truth). Raises InputError."""
    from csstsim.io.truth import read_truth

    path = made(run.paths.level0_truth(job.pointing, job.chip.id), f"chip {run.file} {job.options}")
    table = read_truth(path)
    check_recipe(path, table.meta, run.recipe(job))
    return table


def _jobs_on(run, pix):
    if pix not in run.merge_bricks:
        raise InputError(
            "not touched by a measured frame of this campaign", file=run.file, key="brick", value=pix,
            allowed=", ".join(map(str, run.merge_bricks)) or "none",
        )  # fmt: skip
    return run.merge_bricks[pix]


@one_thread
def shear(files, output, say):
    """Print m and c of finished twin campaigns (bricks.shear), write them as JSON; return whether no gate fails.

    Raises InputError for campaigns that are not pairs, or too few galaxies.
    """
    from csstsim.atomic import atomic_path
    from csstsim.bricks.shear import calibration, judge, pair_means
    from csstsim.bricks.verdict import NAMES

    runs = [OpenCampaign(file) for file in files]
    shears, means = [], []
    for lensing, twins in _twins(runs).items():
        means.append(pair_means(*(_shapes_on(run) for run in twins)))
        kappa, *gamma = lensing
        shears.append([value / (1 - kappa) for value in gamma])
        say(f"g = {shears[-1][0]:+.4f}, {shears[-1][1]:+.4f}: {len(means[-1])} galaxies in both twins")
    try:
        fits = calibration(shears, means)
    except ValueError as exc:
        raise InputError(str(exc), file=runs[0].file, key="catalog") from None
    limits = runs[0].config.validation
    gates = judge(fits, limits.shear_m_max, limits.shear_c_max)
    for gate in gates:
        name, axis = gate["name"].split()[1]
        if gate["value"] is not None:
            error, verdict = fits[int(axis) - 1][f"{name}_err"], NAMES[gate["passed"]]
            limit = f"at most {gate['threshold']}, 5 sigma forgiven"
            say(f"{gate['name']} = {gate['value']:+.4f} +- {error:.4f}, {limit}: {verdict}")
    if output:
        with atomic_path(output) as temporary:
            temporary.write_text(json.dumps({"fits": fits, "gates": gates}, indent=1) + "\n")
    return not any(gate["passed"] is False for gate in gates)


def _twins(runs):
    """Return {(kappa, gamma1, gamma2): (campaign, the one with shapes turned)}."""
    found = {}
    for run in runs:
        catalog = run.config.catalog
        if catalog.lensing.field != "constant":
            raise InputError(
                "no constant shear", file=run.file, key="catalog.lensing.field", value=catalog.lensing.field,
                allowed="constant",
            )  # fmt: skip
        key = catalog.lensing.kappa, catalog.lensing.gamma1, catalog.lensing.gamma2
        pair = found.setdefault(key, {})
        if catalog.shapes in pair:
            raise InputError(
                f"shear and shapes of {pair[catalog.shapes].file}, too", file=run.file, key="catalog.shapes",
                value=catalog.shapes, allowed="normal and rotated90, one of each",
            )  # fmt: skip
        pair[catalog.shapes] = run
    for pair in found.values():
        first, *rest = pair.values()
        if not rest or _but_shapes(first) != _but_shapes(rest[0]):
            raise InputError(
                "has no twin of the same seed, camera, exposures and shear", file=first.file, key="catalog.shapes",
                value=first.config.catalog.shapes, allowed="normal and rotated90, one of each",
            )  # fmt: skip
    return {key: (pair["normal"], pair["rotated90"]) for key, pair in found.items()}


def _but_shapes(run):
    """Return what twins share: all that decides their pixels and measurements but `catalog.shapes`."""
    config = run.config.model_copy(update={"catalog": run.config.catalog.model_copy(update={"shapes": "normal"})})
    recipes = [run.measure_recipe(job) | {"campaign": config.digest()} for job in run.imaging_jobs]
    return run.universe.digest if run.embedded else None, run.rendering, recipes


def _shapes_on(run):
    """Return bricks.shear.shapes of each measured frame of a campaign."""
    from csstsim.bricks.shear import shapes
    from csstsim.bricks.validate import Frame, usable

    seam, out = run.camera.detector.channel_ny, []
    for job in progress(run.imaging_jobs, "frames"):
        frame = Frame(truth_of(run, job), _measured(run, job), seam)
        out.append(shapes(frame, usable(frame)))
    return out
