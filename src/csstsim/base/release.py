"""Checks that refuse products of another release or campaign."""

from __future__ import annotations

from typing import TYPE_CHECKING

from csstsim import __version__
from csstsim.base.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Mapping
    from typing import Any

    from csstsim.base.types import PathLike


def release(version: object = __version__) -> str:
    """Return the first two numbers of a version. Versions of one release make the same products, bit by bit."""
    return ".".join(str(version).split(".")[:2])


def check_release(path: PathLike, version: object) -> None:
    """Raise InputError for a product of another release. version: what the product records, or None."""
    if version is None or release(version) != release():
        raise InputError(
            "made by another release of csstsim, whose products cannot be mixed with those of this one; remove it and "
            "make it again, or use the release that made it",
            file=path,
            key="csstsim",
            value=version,
            allowed=f"{release()}.*",
        )


def check_recipe(path: PathLike, meta: Mapping[str, Any], recipe: object) -> None:
    """Raise InputError for a file that records another recipe than `recipe`, or another release."""
    found = meta.get("recipe")
    if found != recipe:
        check_release(path, (found if isinstance(found, dict) else meta).get("csstsim"))
        raise InputError("made for another campaign; remove it", file=path, key="recipe", value=found, allowed=recipe)
