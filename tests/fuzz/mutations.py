"""How sound files are spoiled: hypothesis strategies that give the bytes of a hostile file from those of a sound one.

Each strategy takes the sound file's bytes. Places are drawn as whole numbers and counted modulo what there is, so that
hypothesis can shrink them.
"""

import copy
import io
import json
import math

import yaml
from hypothesis import strategies as st

PLACE = st.integers(0, 2**24)
NAMES = (
    "../../escaped",
    "/tmp/escaped",
    "a/b",
    "..",
    "x\ny",
    "x\x1b[31my",
    "\u202ename",
    "caf\u00e9",
    "%s{0}",
    "-rf",
    "a" * 5000,
)
NUMBERS = (
    0,
    -1,
    1,
    2,
    7,
    10**12,
    -(2**63),
    2**63,
    10**400,
    0.5,
    -0.0,
    1e-320,
    1e308,
    -1e308,
    math.nan,
    math.inf,
    -math.inf,
)
ODD = (None, True, False, "", " ", "1:30", "010", [], {}, [[]], [None], {"a": 1}, [1, 2, 3], {"": {}}, "yes", "nan")
CODE = (
    '!!python/object/apply:os.system ["touch escaped"]',
    "!!python/name:fuzz_tripwire.run",
    "!!python/module:fuzz_tripwire",
    "!!python/object/new:fuzz_tripwire.Run []",
    "!!binary AAAA",
    "!!set {a, b}",
    "!!timestamp 2027-13-45",
    "2027-01-01",
    "&a [*a]",
    "&a {b: *a}",
    "*nothing",
    "<<: *nothing",
    "? [a, b]\n: c",
    "0x7fffffffffffffffff",
    "1_000",
    "!!int x",
    "@",
    "%",
)


def values():
    """Values that do not belong: of another type, far too large, not finite, names that are paths."""
    nested = st.integers(1, 150).map(_nested)
    return st.sampled_from(NAMES + NUMBERS + ODD) | nested | st.text(max_size=20) | st.floats() | st.integers()


def _nested(depth):
    inner = 1
    for _ in range(depth):
        inner = [inner]
    return inner


def spoiled_bytes(sound):
    """Bytes changed, cut, grown, doubled or made zero."""
    change = st.tuples(st.sampled_from(("flip", "cut", "grow", "zero", "double", "put")), PLACE, st.binary(max_size=40))
    return st.lists(change, min_size=1, max_size=4).map(lambda changes: _apply_bytes(sound, changes))


def _apply_bytes(data, changes):
    data = bytearray(data)
    for kind, place, extra in changes:
        at = place % (len(data) + 1)
        if kind == "flip" and data:
            data[at % len(data)] ^= 1 + place % 255
        elif kind == "cut":
            del data[at:]
        elif kind == "grow":
            data += extra * (1 + place % 100)
        elif kind == "zero":
            data[at : at + 64] = bytes(len(data[at : at + 64]))
        elif kind == "double":
            data[at:at] = data[at : at + 500]
        else:
            data[at:at] = extra
    return bytes(data)


def spoiled_tree(tree):
    """JSON-like data with nodes replaced, removed, renamed or doubled."""
    change = st.tuples(st.sampled_from(("value", "value", "value", "drop", "rename", "more")), PLACE, values())
    return st.lists(change, min_size=1, max_size=3).map(lambda changes: _apply_tree(tree, changes))


def _apply_tree(tree, changes):
    tree = json.loads(json.dumps(tree))
    for kind, place, value in changes:
        places = list(_places(tree))
        if not places:
            return value
        value = copy.deepcopy(value)  # what is changed next must not be a constant of this module
        holder, key = places[place % len(places)]
        if kind == "value":
            holder[key] = value
        elif kind == "drop":
            del holder[key]
        elif kind == "rename" and isinstance(holder, dict):
            holder[str(value)[:50]] = holder.pop(key)
        elif isinstance(holder, list):
            holder.extend([holder[key]] * (place % 50))
        else:
            holder["more"] = value
    return tree


def _places(tree):
    """Yield (container, key) of every node below the root."""
    for key, value in list(tree.items() if isinstance(tree, dict) else enumerate(tree)):
        yield tree, key
        if isinstance(value, dict | list):
            yield from _places(value)


def spoiled_yaml(sound):
    """YAML with values that do not belong, tags that ask for code, doubled keys, bombs, bytes that are no text."""
    tree = spoiled_tree(yaml.safe_load(sound))
    text = st.tuples(
        st.sampled_from(("scalar", "line", "double", "front")), PLACE, st.sampled_from((*CODE, bomb(9), bomb(30)))
    )
    return st.one_of(
        tree.map(_dump_yaml),
        spoiled_bytes(sound),
        st.lists(text, min_size=1, max_size=2).map(lambda changes: _apply_text(sound.decode(), changes)),
    )


def _dump_yaml(tree):
    return yaml.safe_dump(tree, sort_keys=False, allow_unicode=True).encode("utf-8", "surrogatepass")


def bomb(levels):
    """Return a flow mapping of 9^levels scalars by aliases: "billion laughs"."""
    rows = ["l0: &l0 [x, x, x, x, x, x, x, x, x]"]
    rows += [f"l{i}: &l{i} [{', '.join([f'*l{i - 1}'] * 9)}]" for i in range(1, levels)]
    return "{" + ", ".join(rows) + "}"


def _apply_text(text, changes):
    lines = text.splitlines()
    for kind, place, piece in changes:
        at = place % len(lines)
        if kind == "scalar" and ":" in lines[at]:
            lines[at] = f"{lines[at].split(':')[0]}: {piece}"
        elif kind == "double":
            lines.insert(at, lines[at])
        elif kind == "front":
            lines.insert(0, f"zz{place % 3}: {piece}")
        else:
            lines.insert(at, piece)
    return "\n".join(lines).encode()


def spoiled_json(sound):
    """JSON with nodes that do not belong; NaN and Infinity as Python writes them."""
    return st.one_of(spoiled_tree(json.loads(sound)).map(lambda tree: json.dumps(tree).encode()), spoiled_bytes(sound))


def spoiled_csv(sound):
    """A table with cells that do not belong, rows doubled or dropped."""
    cell = st.sampled_from(
        (*map(str, NUMBERS[:9] + NUMBERS[10:] + NAMES), "nan", "1e999", '"', '"a,b"', "\u0661\u0662", "", "=1+1")
    )
    change = st.tuples(st.sampled_from(("cell", "cell", "drop", "double", "comma")), PLACE, cell | st.text(max_size=15))
    rows = st.lists(change, min_size=1, max_size=3).map(lambda changes: _apply_csv(sound.decode(), changes))
    return rows | spoiled_bytes(sound)


def _apply_csv(text, changes):
    rows = [line.split(",") for line in text.splitlines()]
    for kind, place, value in changes:
        row = rows[place % len(rows)] if rows else [""]
        if kind == "cell":
            row[place // 7 % len(row)] = value
        elif kind == "drop" and rows:
            rows.remove(row)
        elif kind == "double":
            rows.insert(place // 7 % (len(rows) + 1), list(row))
        else:
            row.append(value)
    return "\n".join(",".join(row) for row in rows).encode("utf-8", "surrogatepass")


def as_file(write):
    """Return the bytes that write(file object) writes."""
    file = io.BytesIO()
    write(file)
    return file.getvalue()
