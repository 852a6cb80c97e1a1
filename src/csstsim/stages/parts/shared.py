"""Products that several campaigns share: made once, linked or copied into the output folder of each.

Truth bricks and PSF sets are shared by campaigns that name the same folder, finished frames by a base and its variants.

A file in the shared folder is complete when it appears, and is never written again. It does not change if a campaign is
removed or makes its file again.
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
    log: Callable[[str], object],
) -> None:
    """Make a product of the output folder, or link it to the one in the campaign's shared folder, if it has one.

    make(): writes the product to `path`; check(file): raises InputError if the file differs from that of this campaign.
    A product that is not in the shared folder is made and linked there. Raises InputError.
    """
    shared_file = run.in_share(path)
    if shared_file is None:
        make()
        return
    if not shared_file.exists():
        make()
        shared_file.parent.mkdir(parents=True, exist_ok=True)
        try:
            os.link(path, shared_file)
            return
        except FileExistsError:
            pass  # another campaign made it at the same time
    try:
        check(shared_file)
    except InputError as error:
        raise InputError(f"{error}; or share another folder", file=run.file, key="share") from None
    with atomic_path(path) as temporary:
        os.link(shared_file, temporary)
    log(f"shared, not made: {shared_file}")


def copied(pairs: Sequence[tuple[Path, Path]], log: Callable[[str], object] = print) -> bool:
    """Copy files of the base of a variant to the variant's folder; return whether there are any.

    pairs (source, target): of OpenCampaign.base_files. No links: Snakemake updates the dates of the outputs of a job,
    and the base's measurements would be older than their frame.
    """
    for source, target in pairs:
        with atomic_path(target) as temporary:
            shutil.copyfile(source, temporary)
    if pairs:
        log(f"equal in the base, not made: {pairs[0][0]}")
    return bool(pairs)
