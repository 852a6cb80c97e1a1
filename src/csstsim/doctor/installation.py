"""What of csstsim is installed: versions, libraries, optional parts, its data, compiled code."""

import base64
import hashlib
import importlib
import importlib.metadata
import os
import platform
import shutil
import sys
from pathlib import Path

from csstsim import __version__
from csstsim.doctor.finding import OK, PROBLEM, WARNING, Finding
from csstsim.doctor.machine import free_memory, gb, write_fault
from csstsim.shipped import ROOT

MODULES = {"pillow": "PIL", "pyerfa": "erfa", "pyyaml": "yaml"}  # libraries imported by another name
PACKAGE = Path(__file__).parents[1]
EXTRAS = {"de440": "astrometry.ephemeris: de440", "slurm": "profiles/slurm", "bench": "peers in benchmarks"}
PROGRAMS = {
    ("sbatch",): "profiles/slurm",
    ("source-extractor", "sex"): "benchmarks/source_extractor.py",
    ("chromium", "chromium-browser", "google-chrome"): "the test of the report's page",
}


def python():
    """Python's version, and whether this csstsim is the one that is installed."""
    from packaging.specifiers import SpecifierSet

    try:
        about = importlib.metadata.metadata("csstsim")
    except importlib.metadata.PackageNotFoundError:
        yield Finding(PROBLEM, "csstsim", f"{__version__}, not installed: pip install . in its folder")
        return
    same = about["Version"] == __version__
    yield Finding(
        OK if same else WARNING, "csstsim", f"{__version__} in {PACKAGE}" if same else
        f"{__version__} runs, {about['Version']} is installed: pip install it again",
    )  # fmt: skip
    found, needed = platform.python_version(), about["Requires-Python"]
    good = SpecifierSet(needed or "").contains(found, prereleases=True)
    yield Finding(
        OK if good else PROBLEM, "python", f"{found}" if good else f"{found}; csstsim needs Python {needed}"
    )  # fmt: skip


def libraries():
    """Each library that csstsim requires: there, of a version that will do, and does not fail when imported."""
    count, bad = 0, False
    for requirement in requirements():
        count += 1
        fault = _fault(requirement) or _import_fault(requirement.name)
        if fault:
            bad = True
            yield Finding(PROBLEM, f"library {requirement.name}", f"{fault}: pip install '{requirement}'")
    if not bad:
        yield Finding(OK, "libraries", f"the {count} that csstsim needs are there and can be imported")


def requirements(extra=None):
    """Return the packaging.requirements.Requirement of csstsim; those of one of its extras only, if it is named."""
    from packaging.requirements import Requirement

    found = map(Requirement, importlib.metadata.requires("csstsim") or ())
    if extra is None:
        return [r for r in found if r.marker is None or r.marker.evaluate({"extra": ""})]
    return [
        r for r in found if r.marker and r.marker.evaluate({"extra": extra}) and not r.marker.evaluate({"extra": ""})
    ]


def _fault(requirement):
    """Return why a requirement is not met, or None."""
    try:
        found = importlib.metadata.version(requirement.name)
    except importlib.metadata.PackageNotFoundError:
        return "missing"
    return None if requirement.specifier.contains(found, prereleases=True) else f"{found} is there"


def _import_fault(name):
    """Return why a library cannot be imported, or None."""
    try:
        importlib.import_module(MODULES.get(name, name))
    except Exception as error:  # of libraries that do not fit each other: anything
        return f"its import fails with {type(error).__name__}: {' '.join(str(error).split())[:200]}"
    return None


def extras():
    """The optional parts: absent is no fault."""
    for name, use in EXTRAS.items():
        missing = [r.name for r in requirements(name) if _fault(r)]
        text = f"absent ({', '.join(missing)}); for it: pip install 'csstsim[{name}]'" if missing else "present"
        yield Finding(OK, f"extra {name} ({use})", text)


def programs():
    """Programs that optional parts call: absent is no fault."""
    for names, use in PROGRAMS.items():
        found = next(filter(None, map(shutil.which, names)), None)
        yield Finding(OK, f"program {names[0]} ({use})", found or "absent")


def data():
    """The files that come with csstsim: read and checked, and in an installed package as its wheel had them."""
    from csstsim.config import SHIPPED
    from csstsim.costs import load_costs
    from csstsim.instrument.camera import load_camera
    from csstsim.universe.numbers import load_universe

    spoiled = [] if ROOT.name != "_shipped" else sorted(_spoiled())
    for name in spoiled[:5]:
        yield Finding(PROBLEM, "data", f"{name} is missing or not as installed: pip install --force-reinstall csstsim")
    load_costs()
    camera, universe = load_camera(SHIPPED / "instrument"), load_universe(SHIPPED / "universe")
    universe.check()
    if not spoiled:
        yield Finding(OK, "data", f"{ROOT}: camera {camera.digest[:8]}, universe {universe.digest[:8]}")


def _spoiled():
    """Yield the installed files whose SHA-256 is not what the wheel said."""
    for file in importlib.metadata.files("csstsim") or ():
        if file.hash and "_shipped" in file.parts:
            path = Path(file.locate())
            found = hashlib.new(file.hash.mode, path.read_bytes()).digest() if path.is_file() else b""
            if base64.urlsafe_b64encode(found).rstrip(b"=").decode() != file.hash.value:
                yield path


def numba_cache():
    """Where compiled code is kept, and whether some is there."""
    todo = "set NUMBA_CACHE_DIR to a folder that can be written"
    try:
        from csstsim.counter import object_keys
    except RuntimeError as error:  # numba found no place
        yield Finding(PROBLEM, "numba cache", f"{error}: {todo}")
        return
    folder, asked = Path(object_keys.stats.cache_path), os.environ.get("NUMBA_CACHE_DIR")
    root = PACKAGE if folder.is_relative_to(PACKAGE) else folder.parent
    if fault := write_fault(folder):
        yield Finding(PROBLEM, "numba cache", f"{folder}: {fault}; each process would compile anew: {todo}")
    elif asked and root != Path(asked):
        yield Finding(WARNING, "numba cache", f"NUMBA_CACHE_DIR={asked} cannot be used, {root} is instead: {todo}")
    else:
        ending = f".py{sys.version_info.major}{sys.version_info.minor}.nbi"
        count = sum(path.name.endswith(ending) for path in root.rglob("*.nbi"))
        compiled = (
            f"{count} function{'s are' if count > 1 else ' is'} compiled"
            if count
            else ("nothing is compiled yet: the first run takes 20 CPU s more")
        )
        yield Finding(OK, "numba cache", f"{root}: {compiled}")


def transforms():
    """GalSim, which `fidelity: reference` draws with, refuses Fourier transforms larger than this."""
    import galsim

    from csstsim.render.reference import FFT_LOOSE, GSPARAMS

    sides = GSPARAMS["maximum_fft_size"], FFT_LOOSE
    sizes = " and ".join(f"{side} px ({gb(2 * 8 * side * side)})" for side in sides)
    few = (
        "" if (free := free_memory()) > 2 * 8 * FFT_LOOSE**2 else f"; {gb(free)} of memory are free: draw with another"
    )
    yield Finding(
        WARNING if few else OK,
        "GalSim",
        f"{galsim.__version__}; transforms of `fidelity: reference` up to {sizes}{few}",
    )
