"""Records compared: mappings and lists of plain values, from headers, metadata, JSON files and attributes."""

from collections.abc import Iterator
from typing import Any

from csstsim.studies.compare.facts import LISTED_MAX, Fact, short_repr
from csstsim.studies.compare.varying import is_provenance, varies


def record_facts(prefix: str, a: object, b: object) -> Iterator[Fact]:
    """Yield Facts about two records, except values that vary between runs; prefix: before each name."""
    try:
        facts = [Fact(f"{prefix}{text}", provenance) for text, provenance in _differing_values("", a, b)]
    except RecursionError:
        yield Fact(f"{prefix}nested too deep to be compared")
        return
    yield from (fact for fact in facts if fact.provenance)
    counted = [fact for fact in facts if not fact.provenance]
    yield from counted[:LISTED_MAX]
    if len(counted) > LISTED_MAX:
        yield Fact(f"{prefix}and {len(counted) - LISTED_MAX} more values")


def _differing_values(name: str, a: object, b: object, provenance: str | None = None) -> Iterator[Fact]:
    """Yield the Fact of each value that differs; name: of the record, with those of all records that it is in."""
    if isinstance(a, dict) and isinstance(b, dict):
        for key in [*a, *(key for key in b if key not in a)]:
            if varies(key):
                continue
            inner = f"{name}.{key}" if name else key
            made_by = provenance or (key if is_provenance(key) else None)
            if key in a and key in b:
                yield from _differing_values(inner, a[key], b[key], made_by)
            else:
                value = short_repr(a.get(key, b.get(key)))
                yield Fact(f"{inner}: only {'A' if key in a else 'B'} has it: {value}", made_by)
    elif isinstance(a, list) and isinstance(b, list):
        if len(a) != len(b):
            yield Fact(f"{name}: {len(a)} and {len(b)} values", provenance)
        for i, (x, y) in enumerate(zip(a, b, strict=False)):
            yield from _differing_values(f"{name}[{i}]", x, y, provenance)
    elif type(a) is not type(b) or repr(a) != repr(b):  # repr: NaN is NaN, 0.0 is not -0.0
        text = f"{name}: {short_repr(a)} and {short_repr(b)}"
        if size := _absolute_difference(a, b):
            text += f", differ by {size:.6g}"
        yield Fact(text, provenance)


def _absolute_difference(a: Any, b: Any) -> float | None:
    """Return |a - b| of two numbers; None if one is not a number, or too large."""
    if any(isinstance(x, bool) or not isinstance(x, int | float) for x in (a, b)):
        return None
    try:
        return float(abs(a - b))
    except OverflowError:
        return None
