"""Facts: differences between two products, one line each, and the size of differences between arrays."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from csstsim.base.types import AnyArray, BoolArray, FloatArray

if TYPE_CHECKING:
    from h5py import Dataset

LISTED_MAX = 5  # number of differing values or names that are listed


class Fact(NamedTuple):
    """One difference, as text; provenance: its name if it concerns only how the product was made, else None."""

    text: str
    provenance: str | None = None


class Difference:
    """The difference of two arrays, accumulated piece by piece.

    Values are compared bit by bit (0.0 is not -0.0), but any NaN equals any NaN. Differences are absolute, in `unit`;
    the rms is over the values that differ. noun: what the values are called, in the plural.
    """

    def __init__(self, noun: str, unit: str = "") -> None:
        self.noun = noun
        self.unit = f" {unit}" if unit else ""
        self.count = self.total = self.n_finite = self.n_not_finite = 0
        self.largest = self.squares = 0.0
        self.first_difference = ""

    def add(self, a: AnyArray, b: AnyArray, position: Callable[[int], str]) -> None:
        """Add two arrays of one shape and dtype; position(flat index): the position of an element, in words."""
        a = np.ravel(a)
        b = np.ravel(b)
        self.total += a.size
        differing = np.flatnonzero(_differs(a, b))
        if not differing.size:
            return
        self.count += differing.size
        a = a[differing]
        b = b[differing]
        if not self.first_difference:
            self.first_difference = f"first {position(int(differing[0]))}: {short_repr(a[0])} and {short_repr(b[0])}"
        if a.dtype.kind in "biuf":
            differences = _absolute_difference(a, b)
            finite = np.isfinite(differences)
            self.n_not_finite += int((~finite).sum())
            differences = differences[finite]
            self.n_finite += differences.size
            self.largest = max(self.largest, differences.max(initial=0.0))
            self.squares += float((differences**2).sum())

    def text(self) -> str:
        """Return the difference in words; "" if there is none."""
        if not self.count:
            return ""
        parts = [f"{self.count} of {self.total} {self.noun} {'differs' if self.count == 1 else 'differ'}"]
        if self.n_finite:
            rms = (self.squares / self.n_finite) ** 0.5
            parts.append(f"by at most {self.largest:.6g}{self.unit}, rms {rms:.6g}{self.unit}")
        if self.n_not_finite:
            parts.append(f"{self.n_not_finite} of them by NaN or infinity")
        return ", ".join([*parts, self.first_difference])


def array_facts(
    name: str,
    a: AnyArray | Dataset,
    b: AnyArray | Dataset,
    *,
    noun: str,
    unit: str = "",
    position: Callable[..., str],
    step: int = 1 << 22,
) -> Iterator[Fact]:
    """Yield Facts about two arrays: dtype, shape, values; position(*index): the position of an element, in words."""
    if a.shape != b.shape:
        yield Fact(f"{name}: shape {a.shape} and {b.shape}")
        return
    difference = Difference(noun, unit)
    is_numeric = a.dtype.kind in "biuf" and b.dtype.kind in "biuf"
    if a.dtype == b.dtype or is_numeric:
        rows = max(1, step // max(1, a[:1].size)) if a.ndim else 1
        for start in range(0, len(a), rows) if a.ndim else (0,):
            parts = [np.asarray(array[start : start + rows] if a.ndim else array) for array in (a, b)]
            if a.dtype != b.dtype:
                parts = [part.astype(np.float64) for part in parts]
            offset = start * (a[:1].size if a.ndim else 1)
            one, other = parts

            def position_of(i: int, offset: int = offset) -> str:
                return position(*np.unravel_index(i + offset, a.shape))

            difference.add(one, other, position_of)
    if a.dtype != b.dtype:
        suffix = ", the same values" if is_numeric and not difference.count else ""
        yield Fact(f"{name}: {_type_name(a)} and {_type_name(b)}{suffix}")
    if difference.count:
        yield Fact(f"{name}: {difference.text()}")


def only_in_one(what: str, a: Collection[str | int], b: Collection[str | int]) -> Iterator[Fact]:
    """Yield Facts about names (or ids) that only one of A and B has, in the given order."""
    for side, own, other in (("A", a, b), ("B", b, a)):
        known = set(other)
        names = [name for name in own if name not in known]
        if names:
            more = f" and {len(names) - LISTED_MAX} more" if len(names) > LISTED_MAX else ""
            yield Fact(f"only {side} has the {what} {', '.join(map(str, names[:LISTED_MAX]))}{more}")


def short_repr(value: object) -> str:
    """Return a value as text, cut to a readable length."""
    text = repr(value.item() if isinstance(value, np.generic) else value)
    return text if len(text) <= 60 else f"{text[:56]} ..."


def _type_name(array: AnyArray | Dataset) -> str:
    return "text" if array.dtype.kind == "O" else str(array.dtype)


def _differs(a: AnyArray, b: AnyArray) -> BoolArray:
    if a.dtype.kind != "f":
        return a != b
    bits = f"u{a.itemsize}"
    return (np.ascontiguousarray(a).view(bits) != np.ascontiguousarray(b).view(bits)) & ~(np.isnan(a) & np.isnan(b))


def _absolute_difference(a: AnyArray, b: AnyArray) -> FloatArray:
    """Return |a - b| as float64; for integers it is exact before rounding."""
    if a.dtype.kind == "f":
        with np.errstate(invalid="ignore", over="ignore"):
            return np.abs(a.astype(np.float64) - b.astype(np.float64))
    low = np.minimum(a, b)
    high = np.maximum(a, b)
    return (high.astype(np.uint64) - low.astype(np.uint64)).astype(np.float64)
