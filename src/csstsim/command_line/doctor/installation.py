"""Checks of the installation: libraries and their versions, csstsim's data, compiled code."""

from __future__ import annotations

import importlib
import importlib.metadata
import os
import platform
import sys
from pathlib import Path
from typing import TYPE_CHECKING, cast

from csstsim.base.commit import version_with_commit
from csstsim.base.process.shipped_kernels import Shipped, shipped_kernels
from csstsim.base.shipped import ROOT
from csstsim.command_line.doctor.finding import OK, PROBLEM, WARNING, Finding
from csstsim.command_line.doctor.machine import write_fault

if TYPE_CHECKING:
    from collections.abc import Iterator

    from packaging.requirements import Requirement

MODULES = {"pillow": "PIL", "pyerfa": "erfa", "pyyaml": "yaml"}  # modules with another name than their library
PACKAGE = Path(__file__).parents[2]


def libraries() -> Iterator[Finding]:
    """Check that each required library is installed in a suitable version and can be imported."""
    yield Finding(OK, "csstsim", f"{version_with_commit()} in {PACKAGE}, Python {platform.python_version()}")
    needed = requirements()
    faults = {library: fault for library in needed if (fault := _version_fault(library) or _import_fault(library.name))}
    for library, fault in faults.items():
        yield Finding(PROBLEM, f"library {library.name}", f"{fault}: pip install '{library}'")
    if not faults:
        yield Finding(OK, "libraries", f"all {len(needed)} required libraries are installed and can be imported")


def requirements() -> list[Requirement]:
    """Return the packaging.requirements.Requirement of csstsim, without its extras."""
    from packaging.requirements import Requirement

    every = map(Requirement, importlib.metadata.requires("csstsim") or ())
    return [library for library in every if library.marker is None or library.marker.evaluate({"extra": ""})]


def _version_fault(requirement: Requirement) -> str | None:
    """Return why a requirement is not met, or None."""
    try:
        version = importlib.metadata.version(requirement.name)
    except importlib.metadata.PackageNotFoundError:
        return "missing"
    return None if requirement.specifier.contains(version, prereleases=True) else f"version {version} is installed"


def _import_fault(name: str) -> str | None:
    """Return why a library cannot be imported, or None."""
    try:
        importlib.import_module(MODULES.get(name, name))
    except Exception as error:  # of any type, if libraries are incompatible
        return f"its import fails with {type(error).__name__}: {' '.join(str(error).split())[:200]}"
    return None


def data() -> Iterator[Finding]:
    """Check that the data files that come with csstsim can be read and are consistent."""
    from csstsim.base.shipped import SHIPPED
    from csstsim.campaign.costs import load_costs
    from csstsim.instrument.camera import load_camera
    from csstsim.universe.parameters import load_universe

    load_costs()
    camera = load_camera(SHIPPED / "instrument")
    universe = load_universe(SHIPPED / "universe")
    universe.check()
    yield Finding(OK, "data", f"{ROOT}: camera {camera.digest[:8]}, universe {universe.digest[:8]}")


def numba_cache() -> Iterator[Finding]:
    """Check that the folder of compiled code can be written, and count the compiled functions."""
    remedy = "set NUMBA_CACHE_DIR to a writable folder"
    try:
        from csstsim.base.counter import object_keys
    except RuntimeError as error:  # numba has no folder that it can write
        yield Finding(PROBLEM, "numba cache", f"{error}: {remedy}")
        return
    folder = Path(cast("str", object_keys.stats.cache_path))
    requested = os.environ.get("NUMBA_CACHE_DIR")
    root = PACKAGE if folder.is_relative_to(PACKAGE) else folder.parent
    if fault := write_fault(folder):
        yield Finding(PROBLEM, "numba cache", f"{folder}: {fault}; each process would compile again: {remedy}")
    elif requested and root != Path(requested):
        message = f"NUMBA_CACHE_DIR={requested} cannot be used, {root} is used instead: {remedy}"
        yield Finding(WARNING, "numba cache", message)
    else:
        suffix = f".py{sys.version_info.major}{sys.version_info.minor}.nbi"
        count = sum(path.name.endswith(suffix) for path in root.rglob("*.nbi"))
        shipped = shipped_kernels()
        if isinstance(shipped, Shipped):
            state = f"{count} compiled here; {shipped.functions} come with csstsim"
        else:
            state = f"{count} compiled" if count else "nothing is compiled yet: the first runs take 90 CPU s longer"
        yield Finding(OK, "numba cache", f"{root}: {state}")
        if isinstance(shipped, str):
            yield Finding(OK, "numba cache", f"compiled code that comes with csstsim is not used: {shipped}")
