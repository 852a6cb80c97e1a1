"""Checks of the installation: libraries and their versions, csstsim's data, compiled code."""

from __future__ import annotations

import importlib
import importlib.metadata
import os
import platform
import sys
from pathlib import Path
from typing import TYPE_CHECKING, cast

from csstsim import __version__
from csstsim.base.shipped import ROOT
from csstsim.command_line.doctor import OK, PROBLEM, WARNING, Finding
from csstsim.command_line.doctor.machine import write_fault

if TYPE_CHECKING:
    from collections.abc import Iterator

    from packaging.requirements import Requirement

MODULES = {"pillow": "PIL", "pyerfa": "erfa", "pyyaml": "yaml"}  # libraries imported by another name
PACKAGE = Path(__file__).parents[2]


def libraries() -> Iterator[Finding]:
    """Each library that csstsim requires is installed, in a version that fits, and can be imported."""
    yield Finding(OK, "csstsim", f"{__version__} in {PACKAGE}, Python {platform.python_version()}")
    needed = requirements()
    faults = {each: fault for each in needed if (fault := _fault(each) or _import_fault(each.name))}
    for each, fault in faults.items():
        yield Finding(PROBLEM, f"library {each.name}", f"{fault}: pip install '{each}'")
    if not faults:
        yield Finding(OK, "libraries", f"the {len(needed)} that csstsim needs are there and can be imported")


def requirements() -> list[Requirement]:
    """Return the packaging.requirements.Requirement of csstsim, without its extras."""
    from packaging.requirements import Requirement

    found = map(Requirement, importlib.metadata.requires("csstsim") or ())
    return [each for each in found if each.marker is None or each.marker.evaluate({"extra": ""})]


def _fault(requirement: Requirement) -> str | None:
    """Return why a requirement is not met, or None."""
    try:
        found = importlib.metadata.version(requirement.name)
    except importlib.metadata.PackageNotFoundError:
        return "missing"
    return None if requirement.specifier.contains(found, prereleases=True) else f"{found} is there"


def _import_fault(name: str) -> str | None:
    """Return why a library cannot be imported, or None."""
    try:
        importlib.import_module(MODULES.get(name, name))
    except Exception as error:  # of libraries that do not fit each other: anything
        return f"its import fails with {type(error).__name__}: {' '.join(str(error).split())[:200]}"
    return None


def data() -> Iterator[Finding]:
    """The files that come with csstsim can be read, and fit each other."""
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
    """Where compiled code is kept, and whether some is there."""
    todo = "set NUMBA_CACHE_DIR to a folder that can be written"
    try:
        from csstsim.base.counter import object_keys
    except RuntimeError as error:  # numba found no place
        yield Finding(PROBLEM, "numba cache", f"{error}: {todo}")
        return
    folder = Path(cast("str", object_keys.stats.cache_path))
    asked = os.environ.get("NUMBA_CACHE_DIR")
    root = PACKAGE if folder.is_relative_to(PACKAGE) else folder.parent
    if fault := write_fault(folder):
        yield Finding(PROBLEM, "numba cache", f"{folder}: {fault}; each process would compile anew: {todo}")
    elif asked and root != Path(asked):
        yield Finding(WARNING, "numba cache", f"NUMBA_CACHE_DIR={asked} cannot be used, {root} is instead: {todo}")
    else:
        ending = f".py{sys.version_info.major}{sys.version_info.minor}.nbi"
        count = sum(path.name.endswith(ending) for path in root.rglob("*.nbi"))
        compiled = f"{count} compiled" if count else "nothing is compiled yet: the first runs take 90 CPU s more"
        yield Finding(OK, "numba cache", f"{root}: {compiled}")
