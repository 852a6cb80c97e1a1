"""PSF: the set of one chip, computed or taken from a library, and the tables from which photons are sampled."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from csstsim.base.errors import InputError
from csstsim.base.help_page import explained
from csstsim.base.process.one_thread import one_thread
from csstsim.base.process.progress import make_missing
from csstsim.base.release import check_release
from csstsim.stages.parts.shared import make_or_link

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

    from csstsim.base.types import FloatArray, PathLike
    from csstsim.campaign.opened import OpenCampaign
    from csstsim.instrument.camera import Camera
    from csstsim.instrument.chip import Chip
    from csstsim.optics.psf.psf_file import PsfSet


@one_thread
def psf(run: OpenCampaign, chip_id: int, log: Callable[[str], object] = print) -> None:
    """Make the PSF set of one chip, or take it from the campaign's library; then the tables for sampling photons."""
    camera = run.camera
    if chip_id not in camera.chips:
        allowed = ", ".join(map(str, camera.chips))
        raise InputError("not a chip of the camera", file=run.file, key="chip", value=chip_id, allowed=allowed)
    chip = camera.chips[chip_id]
    make = partial(_make_set, run, chip)
    if run.config.psf.library:
        make()  # fast, and not shared: the file does not state its library
    else:
        make_or_link(run, run.paths.psf(chip_id), make, partial(_open, run, chip), log)
    psf_tables(run, chip, log)


def _make_set(run: OpenCampaign, chip: Chip) -> None:
    """Write the PSF set of a chip."""
    from csstsim.optics.psf.psf_c9 import convert
    from csstsim.optics.psf.psf_set import PsfSampling, make_psf
    from csstsim.optics.scatter.scattered_light import scattered_light

    camera = run.camera
    config = run.config.psf
    path = run.paths.psf(chip.id)
    filter_ = camera.filters[chip.filter]
    digest = camera.digest_for("psf")
    if library := run.psf_library:
        convert(library, path, chip, filter_, sample=config.library_sample, camera_digest=digest)
    else:
        make_psf(
            path,
            chip,
            filter_,
            camera.psf,
            PsfSampling(config.grid, config.oversampling, nodes_uv=_nodes_uv(camera, chip, config.grid)),
            scattered=scattered_light(camera, filter_),
            camera_digest=digest,
        )


@one_thread
def psf_tables(run: OpenCampaign, chip: Chip, log: Callable[[str], object] = print) -> None:
    """Make the tables from which photons are sampled, for an existing PSF set."""
    from csstsim.render.psf_table import read_tables, write_tables

    path = run.paths.psf_tables(chip.id)
    psf_set = _open(run, chip)
    make = partial(write_tables, path, psf_set)
    if run.config.psf.library:
        make()
    else:
        make_or_link(run, path, make, partial(read_tables, psf=psf_set), log)


def _nodes_uv(camera: Camera, chip: Chip, grid: int) -> FloatArray | None:
    """Return the field positions of the nodes of a chip's PSF set; None for a camera without distortion.yaml."""
    from csstsim.optics.geometry.focal_plane import load_focal_plane, samples

    file = camera.folder / "distortion.yaml"
    return samples(load_focal_plane(file), chip, grid)[:, :2] if file.exists() else None


@explained("instrument")
def check_psf(run: OpenCampaign) -> None:
    """Check psf.yaml, or the layout of the library's files, for the campaign's chips. Raises InputError."""
    from csstsim.optics.psf.chip_errors import chip_coefficients
    from csstsim.optics.psf.diffraction import check_blur
    from csstsim.optics.psf.psf_c9 import check_library
    from csstsim.optics.psf.sampling import oversampling_of
    from csstsim.optics.psf.wavefront import load_wavefront

    if library := run.psf_library:
        with explained("campaign"):
            for chip in (run.camera.chips[number] for number in run.sky_chips):
                check_library(library, chip, run.camera.filters[chip.filter])
    if library or not run.sky_chips:
        return
    numbers = run.camera.psf
    cell = run.camera.telescope.pixel_scale
    try:
        wavefront = load_wavefront(numbers)
        check_blur(numbers, cell, run.camera.detector.pixel_um)
        for chip in [run.camera.chips[number] for number in run.sky_chips]:
            chip_coefficients(wavefront, numbers, chip, 0.0, 0.0)
            oversampling_of(chip.filter, numbers, run.config.psf.oversampling)
    except InputError as error:
        raise InputError(str(error), file=run.camera.folder) from None


def missing_psf(run: OpenCampaign, chip: Chip, log: Callable[[str], object]) -> None:
    """Make the PSF set of a chip and its tables, if they are missing."""
    sets = {
        run.paths.psf(chip.id): partial(psf, run, chip.id, log),
        run.paths.psf_tables(chip.id): partial(psf_tables, run, chip, log),
    }
    make_missing(sets, log)


def open_psf(run: OpenCampaign, chip: Chip) -> PsfSet:
    """Return the checked PsfSet of a chip, with the campaign's interpolation."""
    config = run.config.psf
    return _open(run, chip, method=config.interpolation, beta=config.beta, neighbours=config.neighbours)


def _open(run: OpenCampaign, chip: Chip, path: PathLike | None = None, **interpolation: Any) -> PsfSet:
    from csstsim.optics.psf.psf_file import PsfSet
    from csstsim.optics.psf.sampling import oversampling_of

    config = run.config.psf
    expected: dict[str, Any] = {}
    if not config.library:
        oversampling = oversampling_of(chip.filter, run.camera.psf, config.oversampling)
        expected = {"grid": config.grid, "oversampling": oversampling}
    psf = PsfSet(
        path or run.paths.psf(chip.id),
        chip=chip.id,
        filter=chip.filter,
        camera_digest=run.camera.digest_for("psf"),
        **interpolation,
        **expected,
    )
    check_release(psf.path, psf.attributes["version"])
    return psf


def psf_box(run: OpenCampaign, chip: Chip) -> float:
    """Return half the side of a chip's stored PSF [pixel]."""
    from csstsim.optics.psf.sampling import CELLS, LIBRARY_PX, oversampling_of

    config = run.config.psf
    half_side = CELLS / 2 / oversampling_of(chip.filter, run.camera.psf, config.oversampling)
    return LIBRARY_PX / 2 if config.library else half_side
