"""Truth: bricks of the embedded universe, shared by all chips on them."""

from functools import partial

from csstsim.base.errors import InputError
from csstsim.base.process.one_thread import one_thread
from csstsim.base.process.progress import make_missing


@one_thread
def truth(run, pix, say=print):
    """Make one brick of the embedded universe."""
    from csstsim.catalog.truth_bricks import write_brick

    if not run.embedded:
        raise InputError(
            "the campaign brings its own catalogue", file=run.file, key="catalog.kind", value=run.config.catalog.kind
        )
    run.open_truth()
    write_brick(run.paths.truth(pix), pix, **run.universe_key())
    say(run.paths.truth(pix))


def missing_bricks(run, bricks, say):
    """Make the missing ones of some bricks of the embedded universe; none for a user's catalogue."""
    if run.embedded:
        make_missing({run.paths.truth(pix): partial(truth, run, pix, say) for pix in bricks}, say)
