"""What jobs share and need beforehand: truth bricks, and the PSF set of each chip with its tables."""

from functools import partial

from csstsim.errors import InputError
from csstsim.one_thread import one_thread
from csstsim.progress import progress
from csstsim.release import check_release


@one_thread
def truth(run, pix, say=print):
    """Make one brick of the embedded universe."""
    from csstsim.universe.bricks import write_brick

    if not run.embedded:
        raise InputError(
            "the campaign brings its own catalogue", file=run.file, key="catalog.kind", value=run.config.catalog.kind
        )
    run.open_truth()
    write_brick(run.paths.truth(pix), pix, **run.universe_key())
    say(run.paths.truth(pix))


@one_thread
def psf(run, chip_id):
    """Make the PSF set of one chip, or take it from the campaign's library; then the tables photons are drawn from."""
    from csstsim.optics.beyond import beyond_box
    from csstsim.optics.psf import make_psf
    from csstsim.optics.psf_c9 import convert

    chip, camera, config = run.camera.chips[chip_id], run.camera, run.config.psf
    path, filter_, digests = run.paths.psf(chip_id), camera.filters[chip.filter], {"camera_digest": camera.digest}
    if config.library:
        convert(config.library, path, chip, filter_, sample=config.library_sample, **digests)
    else:
        make_psf(
            path, chip, filter_, camera.telescope, camera.psf, config.grid, oversampling=config.oversampling,
            beyond=beyond_box(camera, filter_), nodes_uv=_nodes_uv(camera, chip, config.grid), **digests,
        )  # fmt: skip
    psf_tables(run, chip)


@one_thread
def psf_tables(run, chip):
    """Make the tables photons are drawn from, of a PSF set that is there."""
    from csstsim.render.psf_table import write_tables

    write_tables(run.paths.psf_tables(chip.id), open_psf(run, chip))


def _nodes_uv(camera, chip, grid):
    """Where on the sky the nodes of a chip's PSF set lie; None for a camera without a description of its distortion."""
    from csstsim.optics.focal_plane import load_focal_plane, samples

    file = camera.folder / "distortion.yaml"
    return samples(load_focal_plane(file), chip, grid)[:, :2] if file.exists() else None


def missing(run, job, say):
    """Make what a job of the sky needs and is not there: bricks of the embedded universe, the chip's PSF set."""
    missing_bricks(run, job, say)
    missing_psf(run, job, say)


def missing_bricks(run, job, say):
    """Make the bricks of the embedded universe that a job needs and are not there."""
    if run.embedded and job.pointing.type == "SCIE":
        _make({run.paths.truth(pix): partial(truth, run, pix, say) for pix in run.truth_bricks(job)}, say)


def missing_psf(run, job, say):
    """Make the PSF set of a job of the sky and its tables, if they are not there."""
    chip, paths = job.chip, run.paths
    if job.pointing.type == "SCIE":
        sets = {
            paths.psf(chip.id): partial(psf, run, chip.id),
            paths.psf_tables(chip.id): partial(psf_tables, run, chip),
        }
        _make(sets, say)


def _make(wanted, say):
    for path in progress([path for path in wanted if not path.exists()], "made first"):
        if not path.exists():  # tables come with a new PSF set
            say(f"missing, made first: {path}")
            wanted[path]()


def open_psf(run, chip):
    """Return the checked PsfSet of a chip, with the campaign's interpolation."""
    from csstsim.optics.psf import PsfSet, oversampling_of

    config, own = run.config.psf, {}
    if not config.library:
        own = {
            "grid": config.grid,
            "oversampling": oversampling_of(chip.filter, run.camera.psf, config.oversampling),
        }
    psf = PsfSet(
        run.paths.psf(chip.id), chip=chip.id, filter=chip.filter, camera_digest=run.camera.digest,
        method=config.interpolation, beta=config.beta, neighbours=config.neighbours, **own,
    )  # fmt: skip
    check_release(psf.path, psf.attributes["version"])
    return psf


def psf_box(run, chip):
    """Half the side of a chip's stored PSF [pixel]."""
    from csstsim.optics.psf import CELLS, oversampling_of
    from csstsim.optics.psf_c9 import BOX_PX

    config = run.config.psf
    own = CELLS / 2 / oversampling_of(chip.filter, run.camera.psf, config.oversampling)
    return BOX_PX / 2 if config.library else own
