"""The user's cache of truth bricks and PSF sets, outside the output of campaigns: for Python and for injection."""

from __future__ import annotations

import os
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from csstsim.base.digest import digest
from csstsim.base.errors import InputError
from csstsim.base.stage_records import STAGE_OF
from csstsim.io.paths import Paths

if TYPE_CHECKING:
    from csstsim.base.types import PathLike
    from csstsim.campaign.opened import OpenCampaign


def cache_folder(given: PathLike | None = None) -> Path:
    """Return the cache folder: `given`, $CSSTSIM_CACHE, or csstsim in the user's cache. It is made if it is missing.

    Raises InputError if it cannot be made.
    """
    folder = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    folder = Path(given or os.environ.get("CSSTSIM_CACHE") or Path(folder) / "csstsim").absolute()
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as exc:
        message = f"cannot be made: {exc.strerror}; give another folder, or set CSSTSIM_CACHE"
        raise InputError(message, file=folder, key="cache") from None
    return folder


class CachePaths(Paths):
    """Paths of an OpenCampaign with truth bricks and PSF sets in a cache, in folders named by digests of recipes."""

    def __init__(self, cache: Path, run: OpenCampaign) -> None:
        super().__init__(cache / "products")
        self._cache = cache
        self._recipes = run.recipes

    @cached_property
    def _truth(self) -> Paths:
        return Paths(self._cache / digest(self._recipes.truth))

    @cached_property
    def _psf(self) -> Paths:
        return Paths(self._cache / digest(self._recipes.psf))

    def find(self, name: str, **words: object) -> Path:
        """As Paths.find."""
        stage = STAGE_OF[name].name
        if stage == "truth":
            return self._truth.find(name, **words)
        return self._psf.find(name, **words) if stage == "psf" else super().find(name, **words)
