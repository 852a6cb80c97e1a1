"""Compiled code that comes with the package: nothing is compiled where it fits.

builders/build_kernels.py compiles it for one version of Python, numba and llvmlite, and for a processor that most
machines include (`about.json`). A function is taken from it if all of these fit and its sources, and those that they
reach by imports, have the content of which it was compiled. All else is compiled here, and what was compiled here comes
first. The results are the same bits: both are compiled of the same operations, none of which is reordered or fused.

The folder is `_kernels` of the package, or CSSTSIM_KERNELS; with an empty CSSTSIM_KERNELS, no such code is used.
"""

from __future__ import annotations

import json
import os
import platform
import sys
from functools import cache
from typing import Any, NamedTuple

PACKAGE = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
VARIABLE = "CSSTSIM_KERNELS"
KERNELS = "_kernels"
ABOUT = "about.json"
# The level x86-64-v3 of the System V ABI (Intel since 2013, AMD since 2015), as llvmlite names its features
PROCESSOR = "x86-64-v3"
FEATURES = "avx", "avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe", "popcnt", "sse4.2", "xsave"


class Shipped(NamedTuple):
    """Compiled code that this machine can use: its folder, numba's words for its processor, the number of functions."""

    folder: str
    target: tuple[str, str, str]
    functions: int


def versions() -> dict[str, str]:
    """Return what must be the same where the code is compiled and where it is used."""
    import llvmlite
    import numba

    return {
        "Python": str(sys.implementation.cache_tag),
        "numba": numba.__version__,
        "llvmlite": llvmlite.__version__,
        "machine": f"{sys.platform} {platform.machine()}",
    }


@cache
def shipped_kernels() -> Shipped | str | None:
    """Return the compiled code that comes with the package, or why it cannot be used here; None: there is none."""
    folder = os.environ.get(VARIABLE, os.path.join(PACKAGE, KERNELS))
    try:
        with open(os.path.join(folder, ABOUT)) as stream:
            about = json.load(stream)
    except FileNotFoundError:
        return None
    for name, value in versions().items():
        if about["versions"][name] != value:
            return f"{name} is {value}, it is for {about['versions'][name]}"
    from llvmlite.binding import get_host_cpu_features

    has = get_host_cpu_features()
    missing = [name for name in about["features"] if not has.get(name)]
    if missing:
        return f"the processor has no {', '.join(missing)}"
    return Shipped(folder, tuple(about["target"]), about["functions"])


def leave_out_shipped() -> None:
    """Use no code that comes with the package from now on, in this process and those that it starts."""
    os.environ[VARIABLE] = ""
    shipped_kernels.cache_clear()


def shipped_folder(source: str, folder: str) -> str | None:
    """Return the folder below `folder` of the code that is compiled of a source file; None: not of the package."""
    inside = os.path.relpath(os.path.dirname(os.path.abspath(source)), PACKAGE)
    return None if inside.startswith(os.pardir) else os.path.join(folder, inside)


def load_shipped(source: str, filename_base: str, digest: str, key: tuple[Any, Any, Any]) -> Any:
    """Return numba's data of a function compiled for a signature; None if it does not come with the package.

    source: the function's file; filename_base: numba's name of its files; digest: of
    base.process.reached_sources.sources_digest; key: numba's, (signature, processor, code of the function).
    """
    from numba.core.caching import IndexDataCacheFile

    shipped = shipped_kernels()
    if not isinstance(shipped, Shipped):
        return None
    folder = shipped_folder(source, shipped.folder)
    if folder is None:
        return None
    signature, _, code = key
    return IndexDataCacheFile(folder, filename_base, digest).load((signature, shipped.target, code))
