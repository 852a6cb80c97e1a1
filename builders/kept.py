"""What a builder does with a file: compare it with the one that is there, and replace that only if the two differ.

A builder that is run as a check must change nothing: frames name the digest of their camera, and a fit's rounding on
another machine would refuse them all. So each takes `--check`, which writes nothing and ends with exit code 1 if a file
differs, and a plain run writes only what differs by more than the builder's tolerance.
"""

import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from astropy.io import fits

from csstsim.base.files.atomic import atomic_path

Same = Callable[[Path, Path], bool]


def same_bytes(one: Path, other: Path) -> bool:
    """Tell whether two files are equal."""
    return one.read_bytes() == other.read_bytes()


def same_fits(relative: float) -> Same:
    """Return a comparison of FITS files: headers equal, data to `relative` of an array's largest value."""

    def same(one: Path, other: Path) -> bool:
        with fits.open(one) as first, fits.open(other) as second:
            if len(first) != len(second):
                return False
            pairs = list(zip(first, second, strict=True))
            return all(_cards(a.header) == _cards(b.header) and _close(a.data, b.data, relative) for a, b in pairs)

    return same


def _cards(header: fits.Header) -> list[tuple]:
    return [tuple(card) for card in header.cards]


def _close(one: np.ndarray | None, other: np.ndarray | None, relative: float) -> bool:
    if one is None or other is None:
        return one is other
    if one.dtype.names:
        return all(_close(np.asarray(one[name]), np.asarray(other[name]), relative) for name in one.dtype.names)
    if one.shape != other.shape or one.dtype.kind not in "fiu":
        return np.array_equal(one, other)
    if not one.size:
        return True
    return bool(np.allclose(one, other, rtol=0.0, atol=relative * np.nanmax(np.abs(one)), equal_nan=True))


class Keeper:
    """Writes files where they differ from what is there; with `check` it only says so."""

    def __init__(self, check: bool = False):
        self.check = check
        self.differing: list[Path] = []

    @contextmanager
    def file(self, path: Path, same: Same = same_bytes) -> Iterator[Path]:
        """Yield where to write a file; it takes the place of `path` if that is missing or not the same."""
        with tempfile.TemporaryDirectory() as folder:
            new = Path(folder) / path.name
            yield new
            if path.exists() and same(path, new):
                return
            self.differing.append(path)
            if not self.check:
                with atomic_path(path) as temporary:
                    temporary.write_bytes(new.read_bytes())

    def code(self) -> int:
        """Say what differed, or that nothing did; return the exit code."""
        for path in self.differing:
            print(f"{path}: {'differs' if self.check else 'written'}")
        if not self.differing:
            print("nothing differs by more than the tolerance; nothing is written")
        return int(self.check and bool(self.differing))
