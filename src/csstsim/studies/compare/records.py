"""Records compared: mappings and lists of plain values, from headers, metadata, JSON files and attributes."""

from collections.abc import Iterator
from typing import Any

from csstsim.studies.compare.facts import NAMED, Fact, shown
from csstsim.studies.compare.varying import is_provenance, varies


def record_facts(where: str, a: object, b: object) -> Iterator[Fact]:
    """Yield Facts about two records, except values that vary between runs; `where` precedes each name."""
    try:
        found = list(_leaves("", a, b))
    except RecursionError:
        yield Fact(f"{where}nested too deep to be compared")
        return
    for name, text, made in found:
        if made:
            yield Fact(f"{where}{name}: {text}", made)
    rest = [f"{where}{name}: {text}" for name, text, made in found if not made]
    yield from map(Fact, rest[:NAMED])
    if len(rest) > NAMED:
        yield Fact(f"{where}and {len(rest) - NAMED} more values")


def _leaves(name: str, a: object, b: object, made: str | None = None) -> Iterator[tuple[str, str, str | None]]:
    """Yield (name, what differs, name of the provenance or None) of each value that differs."""
    if isinstance(a, dict) and isinstance(b, dict):
        for key in [*a, *(key for key in b if key not in a)]:
            if varies(key):
                continue
            here = f"{name}.{key}" if name else key
            of = made or (key if is_provenance(key) else None)
            if key in a and key in b:
                yield from _leaves(here, a[key], b[key], of)
            else:
                yield here, f"only {'A' if key in a else 'B'} has it: {shown(a.get(key, b.get(key)))}", of
    elif isinstance(a, list) and isinstance(b, list):
        if len(a) != len(b):
            yield name, f"{len(a)} and {len(b)} values", made
        for i, (x, y) in enumerate(zip(a, b, strict=False)):
            yield from _leaves(f"{name}[{i}]", x, y, made)
    elif type(a) is not type(b) or repr(a) != repr(b):  # repr: NaN is NaN, 0.0 is not -0.0
        text = f"{shown(a)} and {shown(b)}"
        if size := _apart(a, b):
            text += f", differ by {size:.6g}"
        yield name, text, made


def _apart(a: Any, b: Any) -> float | None:
    """Return |a - b| of two numbers; None of what are no numbers, or too large."""
    if any(isinstance(x, bool) or not isinstance(x, int | float) for x in (a, b)):
        return None
    try:
        return float(abs(a - b))
    except OverflowError:
        return None
