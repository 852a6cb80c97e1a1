"""Products that several campaigns share: made once, linked or copied into the output folder of each.

Truth bricks and PSF sets are shared by campaigns that name one folder, finished frames by a base and its variants.

The file in the shared folder is whole when it appears there and is never written again. A campaign that is removed, or
that makes its own anew, leaves it as it is.
"""

from __future__ import annotations

import os
import shutil
from typing import TYPE_CHECKING

from csstsim.base.errors import InputError
from csstsim.base.files.atomic import atomic_path

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from csstsim.campaign.opened import OpenCampaign


def make_or_link(
    run: OpenCampaign,
    path: Path,
    make: Callable[[], object],
    check: Callable[[Path], object],
    say: Callable[[str], object],
) -> None:
    """Make a product of the output folder, or link it to the one in the campaign's shared folder, if it has one.

    make(): writes the product to `path`; check(file): raises InputError if the file is not what this campaign would
    make. A product that is not in the shared folder is made and linked there. Raises InputError.
    """
    common = run.in_share(path)
    if common is None:
        make()
        return
    if not common.exists():
        make()
        common.parent.mkdir(parents=True, exist_ok=True)
        try:
            os.link(path, common)
            return
        except FileExistsError:
            pass  # of two campaigns at a time, the other was first
    try:
        check(common)
    except InputError as error:
        raise InputError(f"{error}; or share another folder", file=run.file, key="share") from None
    with atomic_path(path) as temporary:
        os.link(common, temporary)
    say(f"shared, not made: {common}")


def copied(pairs: Sequence[tuple[Path, Path]], say: Callable[[str], object] = print) -> bool:
    """Copy what the base of a variant has made to the variant's folder; return whether there is anything to copy.

    pairs: those of OpenCampaign.base_files. No links: Snakemake dates what a job leaves anew, and the base's
    measurements would be older than their frame.
    """
    for theirs, own in pairs:
        with atomic_path(own) as temporary:
            shutil.copyfile(theirs, temporary)
    if pairs:
        say(f"equal in the base, not made: {pairs[0][0]}")
    return bool(pairs)
