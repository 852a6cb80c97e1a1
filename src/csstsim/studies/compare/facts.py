"""Facts: differences between two products, one line each, and how large they are between arrays."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from csstsim.base.types import AnyArray, BoolArray, FloatArray

if TYPE_CHECKING:
    from h5py import Dataset

NAMED = 5  # differing values or names that are listed


class Fact(NamedTuple):
    """One difference, as text; `provenance`: its name if it only says how the product was made, else None."""

    text: str
    provenance: str | None = None


class Difference:
    """How much two arrays differ, added up a piece at a time.

    Values are compared bit by bit (0.0 is not -0.0), but NaN is NaN. Sizes are absolute, in `unit`; the rms is that of
    the values that differ. `things`: what a value is called.
    """

    def __init__(self, things: str, unit: str = "") -> None:
        self.things = things
        self.unit = f" {unit}" if unit else ""
        self.count = self.total = self.sized = self.odd = 0
        self.largest = self.squares = 0.0
        self.first = ""

    def add(self, a: AnyArray, b: AnyArray, place: Callable[[int], str]) -> None:
        """Add two arrays of one shape and dtype; place(index): where the element of the flat array is, in words."""
        a = np.ravel(a)
        b = np.ravel(b)
        self.total += a.size
        where = np.flatnonzero(_unlike(a, b))
        if not where.size:
            return
        self.count += where.size
        a = a[where]
        b = b[where]
        if not self.first:
            self.first = f"first {place(int(where[0]))}: {shown(a[0])} and {shown(b[0])}"
        if a.dtype.kind in "biuf":
            size = _size(a, b)
            finite = np.isfinite(size)
            self.odd += int((~finite).sum())
            size = size[finite]
            self.sized += size.size
            self.largest = max(self.largest, size.max(initial=0.0))
            self.squares += float((size**2).sum())

    def text(self) -> str:
        """Return the difference in words; "" if there is none."""
        if not self.count:
            return ""
        parts = [f"{self.count} of {self.total} {self.things} {'differs' if self.count == 1 else 'differ'}"]
        if self.sized:
            rms = (self.squares / self.sized) ** 0.5
            parts.append(f"by at most {self.largest:.6g}{self.unit}, rms {rms:.6g}{self.unit}")
        if self.odd:
            parts.append(f"{self.odd} of them by NaN or infinity")
        return ", ".join([*parts, self.first])


def array_facts(
    name: str,
    a: AnyArray | Dataset,
    b: AnyArray | Dataset,
    *,
    things: str,
    unit: str = "",
    place: Callable[..., str],
    step: int = 1 << 22,
) -> Iterator[Fact]:
    """Yield Facts about two arrays: dtype, shape, values; place(*index): where an element is, in words."""
    if a.shape != b.shape:
        yield Fact(f"{name}: shape {a.shape} and {b.shape}")
        return
    difference = Difference(things, unit)
    numbers = a.dtype.kind in "biuf" and b.dtype.kind in "biuf"
    if a.dtype == b.dtype or numbers:
        rows = max(1, step // max(1, a[:1].size)) if a.ndim else 1
        for start in range(0, len(a), rows) if a.ndim else (0,):
            parts = [np.asarray(x[start : start + rows] if a.ndim else x) for x in (a, b)]
            if a.dtype != b.dtype:
                parts = [part.astype(np.float64) for part in parts]
            offset = start * (a[:1].size if a.ndim else 1)
            one, other = parts

            def where(i: int, offset: int = offset) -> str:
                return place(*np.unravel_index(i + offset, a.shape))

            difference.add(one, other, where)
    if a.dtype != b.dtype:
        same = ", the same values" if numbers and not difference.count else ""
        yield Fact(f"{name}: {_kind(a)} and {_kind(b)}{same}")
    if difference.count:
        yield Fact(f"{name}: {difference.text()}")


def alone(what: str, a: Collection[str | int], b: Collection[str | int]) -> Iterator[Fact]:
    """Yield Facts about names (or ids) that only one of A and B has, sorted as they come."""
    for side, mine, other in (("A", a, b), ("B", b, a)):
        known = set(other)
        names = [name for name in mine if name not in known]
        if names:
            more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
            yield Fact(f"only {side} has the {what} {', '.join(map(str, names[:NAMED]))}{more}")


def shown(value: object) -> str:
    """Return a value as text, cut to a readable length."""
    text = repr(value.item() if isinstance(value, np.generic) else value)
    return text if len(text) <= 60 else f"{text[:56]} ..."


def _kind(array: AnyArray | Dataset) -> str:
    return "text" if array.dtype.kind == "O" else str(array.dtype)


def _unlike(a: AnyArray, b: AnyArray) -> BoolArray:
    if a.dtype.kind != "f":
        return a != b
    bits = f"u{a.itemsize}"
    return (np.ascontiguousarray(a).view(bits) != np.ascontiguousarray(b).view(bits)) & ~(np.isnan(a) & np.isnan(b))


def _size(a: AnyArray, b: AnyArray) -> FloatArray:
    """Return |a - b| as float64; of integers exact before it is rounded."""
    if a.dtype.kind == "f":
        with np.errstate(invalid="ignore", over="ignore"):
            return np.abs(a.astype(np.float64) - b.astype(np.float64))
    low = np.minimum(a, b)
    high = np.maximum(a, b)
    return (high.astype(np.uint64) - low.astype(np.uint64)).astype(np.float64)
