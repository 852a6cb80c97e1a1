"""Truth: bricks of the embedded universe, shared by all chips on them."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from csstsim.base.errors import InputError
from csstsim.base.process.one_thread import one_thread
from csstsim.base.process.progress import make_missing
from csstsim.stages.parts.shared import make_or_link

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from typing import Any

    from csstsim.campaign.opened import OpenCampaign


@one_thread
def truth(run: OpenCampaign, pix: int, log: Callable[[Any], object] = print) -> None:
    """Make one brick of the embedded universe."""
    from csstsim.catalog.truth_bricks import brick_meta, read_brick, write_brick

    if not run.embedded:
        raise InputError(
            "the campaign has a user's catalogue", file=run.file, key="catalog.kind", value=run.config.catalog.kind
        )
    run.open_truth()
    path = run.paths.truth(pix)
    key = run.universe_key()
    check = partial(read_brick, expect=brick_meta(pix=pix, **key))
    make_or_link(run, path, partial(write_brick, path, pix, **key), check, log)
    log(path)


def missing_bricks(run: OpenCampaign, bricks: Iterable[int], log: Callable[[str], object]) -> None:
    """Make those of `bricks` of the embedded universe that are missing; none for a user's catalogue."""
    if run.embedded:
        make_missing({run.paths.truth(pix): partial(truth, run, pix, log) for pix in bricks}, log)
