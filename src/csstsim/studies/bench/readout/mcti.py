"""MCTI, the paper's own code of charge transfer, if a user has a checkout (github.com/ZunLuo/MCTI, in C).

Its functions are compiled with the user's `cc` into a temporary folder and called there; none of it is part of csstsim.
It reads an automatic variable that it never sets, so it is compiled with automatic variables set to zero, the value
that it needs.
"""

import contextlib
import ctypes
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.rng import stream
from csstsim.base.types import FloatArray, PathLike

ABSENT = "MCTI, the paper's code, is not compared: --mcti FOLDER names a checkout of github.com/ZunLuo/MCTI"
TRAPS_MAX = 10  # its maximum of a species in a pixel; one in 1e11 pixels has more at the paper's densities
_FLAGS = "-O3", "-w", "-shared", "-fPIC", "-ftrivial-auto-var-init=zero"
_FUNCTION = "CTI_simul"


class Mcti:
    """MCTI of the checkout in `folder`. Raises InputError if it is not one or does not compile."""

    def __init__(self, folder: PathLike) -> None:
        sources = sorted(map(str, Path(folder).rglob("*.c")))
        error: dict[str, object] = {"file": folder, "key": "--mcti"}
        if not sources:
            raise InputError("holds no C code", allowed="a checkout of github.com/ZunLuo/MCTI", **error)
        with tempfile.TemporaryDirectory() as folder_of_library:  # once loaded, a library does not need its file
            library = Path(folder_of_library) / "mcti.so"
            command = [os.environ.get("CC", "cc"), *_FLAGS, "-o", str(library), *sources, "-lm"]
            try:
                subprocess.run(command, capture_output=True, text=True, check=True)
                self._call = getattr(ctypes.CDLL(str(library)), _FUNCTION)
            except (OSError, AttributeError, subprocess.CalledProcessError) as exc:
                message = str(getattr(exc, "stderr", None) or exc).strip().splitlines()[-1]
                allowed = f"C with {_FUNCTION}, and a compiler cc"
                raise InputError(f"does not compile: {message}", allowed=allowed, **error) from None

    def transfer(
        self,
        image: FloatArray,
        density: Sequence[float] | FloatArray,
        timescale: Sequence[float] | FloatArray,
        well: tuple[float, float, float],
        overscan: int = 0,
        seed: int = 1,
    ) -> FloatArray:
        """Return `image` (ny, nx) [e-] after the transfer, float64 (ny + overscan, nx).

        density, timescale: arrays by species [traps/pixel, transfers]; well: (beta, full well, notch) as in cti.yaml;
        seed: of its traps and releases. Raises ValueError for a notch, which MCTI applies differently.
        """
        ny, nx = image.shape
        species = len(density)
        before = np.ascontiguousarray(image.T, np.float64)
        after = np.zeros((nx, ny + overscan))
        beta, full_well, notch = well
        if notch:
            raise ValueError(f"a notch of {notch} electrons; the comparison with MCTI is for 0")
        # named, because C's pointers do not keep the arrays alive
        density = np.array(density, np.float64)
        timescale = np.array(timescale, np.float64)
        chance = np.ones(species)
        # Negative seeds restart its generators. Adjacent seeds would give correlated traps.
        traps, releases, captures = np.split(
            -stream(seed, "mcti").integers(1, 2**31 - 1, species + 2), [species, species + 1]
        )
        seeds = (ctypes.c_int * species)(*traps.tolist())
        real = ctypes.c_double
        unused = 0, _rows(np.zeros((1, 1))), 0, real(0), real(0), 0  # injected charge and dark current
        with _silent():
            self._call(
                _rows(before), nx, ny, overscan, species, _doubles(density), _doubles(timescale), real(beta),
                real(full_well), real(0), TRAPS_MAX, 1, seeds, int(releases[0]), _doubles(chance), int(captures[0]),
                _rows(after), *unused,
            )  # fmt: skip
        return after.T


def _doubles(array: FloatArray) -> "ctypes._Pointer[ctypes.c_double]":
    """Return C's pointer to a float64 array, which must outlive it."""
    return array.ctypes.data_as(ctypes.POINTER(ctypes.c_double))


def _rows(array: FloatArray) -> "ctypes.Array[ctypes._Pointer[ctypes.c_double]]":
    """Return C's pointer to the rows of a float64 array, which must outlive it."""
    double = ctypes.POINTER(ctypes.c_double)
    return (double * len(array))(*(row.ctypes.data_as(double) for row in array))


@contextlib.contextmanager
def _silent() -> Iterator[None]:
    """Discard what C prints on the standard output."""
    sys.stdout.flush()
    stdout = os.dup(1)
    with open(os.devnull, "w") as nowhere:
        os.dup2(nowhere.fileno(), 1)
    try:
        yield
        ctypes.CDLL(None).fflush(None)
    finally:
        os.dup2(stdout, 1)
        os.close(stdout)
