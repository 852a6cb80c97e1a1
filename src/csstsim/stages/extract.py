"""Extract: spectra of a Level-0 file of a spectroscopic chip, along the traces of its truth."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.plural import number_of
from csstsim.base.process.one_thread import one_thread
from csstsim.base.release import check_recipe
from csstsim.catalog.table import GALAXY
from csstsim.stages.calibrate import calibrated_frame
from csstsim.stages.level0 import truth_of
from csstsim.stages.parts.contamination import catalogued_light
from csstsim.stages.parts.shapes import shapes_of
from csstsim.stages.parts.shared import copied
from csstsim.stages.parts.spectra_checks import spectra_checks
from csstsim.stages.psf import open_psf

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from csstsim.base.types import FloatArray
    from csstsim.campaign.job import Job
    from csstsim.campaign.opened import OpenCampaign
    from csstsim.campaign.sections import ContaminationConfig
    from csstsim.catalog.table import ObjectTable
    from csstsim.measure.spectra.extract import DispersedImage, Sources
    from csstsim.measure.spectra.spectral_model import SpectralModel
    from csstsim.optics.psf.psf_file import PsfSet
    from csstsim.optics.scatter.halo import Wing

SNR_MIN = 5.0  # of the workflow's spectra


class ExtractionInput(NamedTuple):
    """Truth table of a frame, and the first arguments of measure.spectra.extract.extract_spectra, in their order."""

    truth: ObjectTable
    frame: DispersedImage
    orders: ObjectTable
    sources: Sources
    model: SpectralModel
    psf: PsfSet
    wing: Wing | None


@one_thread
def extract(
    run: OpenCampaign,
    job: Job,
    snr_min: float = SNR_MIN,
    ids: Sequence[int] | None = None,
    contamination: ContaminationConfig | None = None,
    image: bool = False,
) -> None:
    """Extract the first-order spectra of a Level-0 file of a spectroscopic chip, and plot some of them.

    snr_min: minimum S/N; ids: of these objects only; contamination: campaign.sections.ContaminationConfig instead of
    the campaign's; image: also write the expected light of all orders. A choice that differs from the workflow's is
    written to separate files, in `chosen/`. Raises InputError, also for an id that has no order in the truth.
    """
    from csstsim.base.files.atomic import atomic_path
    from csstsim.measure.spectra.chosen_orders import LEFT_OUT, Choice
    from csstsim.measure.spectra.extract import extract_spectra
    from csstsim.measure.spectra.line_fluxes import LineFluxes, compared_with_truth
    from csstsim.measure.spectra.spectra_figures import spectra_figure

    usual = run.config.measurement.contamination
    contamination = contamination or usual
    workflows = snr_min == SNR_MIN and ids is None and contamination == usual and not image
    if workflows and copied(run.base_files(job, "extract")):
        return
    given = spectra_of_frame(run, job, contamination)
    truth = given.truth
    unknown = [] if ids is None else sorted(set(ids) - set(given.orders["id"].tolist()))
    if unknown:
        raise InputError("no object of this chip's table of orders", key="--ids", value=unknown[0])
    lines = LineFluxes(np.where(truth["obj_type"] == GALAXY, truth["z"], np.nan))
    choice = Choice(snr_min=snr_min, ids=ids)
    table = extract_spectra(
        given.frame, given.orders, given.sources, given.model, given.psf, given.wing, choice=choice, lines=lines
    )
    paths: Sequence[Path] = (run.paths.spectra(*job.key), run.paths.lines(*job.key))
    chosen = run.paths.output / "chosen"
    if not workflows:
        paths = [chosen / path.name for path in paths]
        chosen.mkdir(parents=True, exist_ok=True)
    path = paths[0]
    with atomic_path(path.with_suffix(".png")) as temporary:
        temporary.write_bytes(spectra_figure(truth, given.frame, given.orders, table))
    recipe = {"recipe": run.recipe(job, "measure")}
    if workflows:
        table.meta["checks"] = spectra_checks(run, job, truth, table)
    table.write(path, table.meta | recipe)
    line_table = lines.table()
    line_table.write(paths[1], compared_with_truth(line_table) | recipe)
    count = number_of(table.meta["spectra"], "spectrum", "spectra")
    print(f"{count} of S/N {snr_min:g} and more, in a resolution element or a line: {path}")
    if table.meta["cut"]:
        print(f"warning: the window cuts {table.meta['cut']} of them: see wave_min and wave_max of the orders' table")
    for name, count in table.meta["left_out"].items():
        if count:
            print(f"left out: {count}, {LEFT_OUT[name]}")
    if image:
        _write_image(chosen / f"{path.stem}_contamination.fits", run, job, given.frame, contamination)


def _write_image(
    path: Path, run: OpenCampaign, job: Job, frame: DispersedImage, contamination: ContaminationConfig
) -> None:
    """Write the expected electrons of all orders of all objects in the window: plane LIGHT.

    The contamination of an order is this image minus the electrons of the order itself.
    """
    from csstsim.base.files.atomic import atomic_path
    from csstsim.io.fits_writing import card, write_hdus

    known = "truth" if contamination.known_from == "truth" else str(contamination.table or "bands of the truth")
    primary = [card("OBSID", job.obsid), card("CHIP", job.chip.id), card("KNOWN", known, "from where the light is")]
    window = job.window
    plane = [
        card("BUNIT", "electron"),
        card("FAINTEST", frame.faintest, "[electron] less in a pixel is left out"),
        card("X0", window.x0, "first column, on the chip, from 0"),
        card("Y0", window.y0, "first row"),
    ]
    assert callable(frame.others)  # from spectra_of_frame
    with atomic_path(path) as temporary:
        light = frame.others(faintest=frame.faintest)
        write_hdus(temporary, [("", primary, None), ("LIGHT", plane, light)])
    print(f"expected light of all orders: {path}")


def spectra_of_frame(run: OpenCampaign, job: Job, contamination: ContaminationConfig | None = None) -> ExtractionInput:
    """Return the truth and the input of measure.spectra.extract.extract_spectra for a job's Level-0 file.

    Parameters
    ----------
    run : OpenCampaign
        The campaign.
    job : Job
        Exposure and chip, one of `run.jobs`.
    contamination : ContaminationConfig, optional
        Instead of that of the campaign (campaign.sections).

    Returns
    -------
    ExtractionInput
        Truth table, frame, orders, sources, model, PSF set, wing of the PSF.

    Raises
    ------
    InputError
        For a chip without a grating, and for missing, damaged or foreign files.
    """
    from csstsim.io.orders import check_orders, read_orders
    from csstsim.measure.spectra.extract import DispersedImage, Sources
    from csstsim.measure.spectra.spectral_model import make_model
    from csstsim.optics.scatter.scattered_light import read_scattered
    from csstsim.stages.render import object_spectra

    if not run.has_orders(job):
        chips = ", ".join(str(chip.id) for chip in run.camera.slitless_chips)
        raise InputError(
            "has no spectra",
            file=run.file,
            key="chip",
            value=job.chip.id,
            allowed=f"{chips}, in SCIE exposures with the layer scie_obs",
        )
    file, calibrated = calibrated_frame(run, job)
    path = run.paths.level0_orders(job)
    truth = truth_of(run, job)
    psf = open_psf(run, job.chip)
    gratings = run.camera.gratings[job.chip.id]
    orders = read_orders(path)
    check_recipe(path, orders.meta, run.recipe(job))
    check_orders(path, orders, len(truth), gratings)
    truth.meta["truth_hash"] = file.header0.get("TRUTHASH")  # a catalogue is opened again only if it is the same
    shapes = shapes_of(truth, job.wcs)
    spectra = object_spectra(run, job, truth)
    disperser = run.disperser(job)
    assert spectra is not None and disperser is not None  # of a spectroscopic chip
    sources = Sources(shapes, spectra, disperser.edges)
    middle = 0.5 * (job.window.x0 + job.window.x1), 0.5 * (job.window.y0 + job.window.y1)
    wing = read_scattered(psf).wing
    photons = run.camera.telescope.area_m2 * job.pointing.exptime
    model = make_model(gratings, photons, psf.at(*middle), psf.oversampling, psf.wavelength, wing)
    frame = DispersedImage.of(calibrated, job.window)
    settings = contamination or run.config.measurement.contamination
    image_of_one = None
    others: Callable[..., FloatArray]
    if settings.known_from == "truth":
        others = partial(model.image, orders, shapes, spectra, sources.edges, job.window)
    else:
        light = catalogued_light(run, job, truth, sources, orders, model, settings)
        others, image_of_one = light.functions(job.window)
    frame = replace(frame, others=others, image_of_one=image_of_one, subtract=settings.subtract)
    return ExtractionInput(truth, frame, orders, sources, model, psf, wing)
