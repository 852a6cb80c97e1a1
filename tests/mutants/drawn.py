"""Mutations drawn by rules from the code as it is, so that no test can have been written for them.

A rule changes one node of a function's syntax tree: an operator, a comparison, a constant, two arguments, a dropped
statement. Some of what is drawn changes nothing that matters, so no fraction of them is asked for; the survivors are to
be read.
"""

import ast
import random
from collections.abc import Iterator
from pathlib import Path

from entries import PACKAGE, ROOT, Mutation, load, mirror

_SWAPPED = {
    ast.Add: "-", ast.Sub: "+", ast.Mult: "/", ast.Div: "*", ast.Lt: ">=", ast.GtE: "<", ast.Gt: "<=", ast.LtE: ">",
    ast.Eq: "!=", ast.NotEq: "==", ast.And: "or", ast.Or: "and",
}  # fmt: skip
_LEAST = 8  # candidates of a module that takes part


def draw(seed: int, count: int, folders: tuple[str, ...] = (), root: Path = ROOT) -> list[Mutation]:
    """Return `count` Mutations by a seed, as evenly over the folders of the package as can be.

    Modules take part that have tests of their own: by name, or in the set.
    """
    rng, tests, found = random.Random(seed), {}, {}
    for one in load(root=root):
        tests.setdefault(one.file, one.tests)
    for path in sorted((root / PACKAGE).rglob("*.py")):
        file = path.relative_to(root / PACKAGE)
        own = tuple(mirror(str(file), root)) or tests.get(str(file))
        if own and len(file.parts) > 1 and (not folders or file.parts[0] in folders):
            places = list(_places(text := path.read_text(encoding="utf-8")))
            if len(places) >= _LEAST:
                found.setdefault(file.parts[0], []).append((str(file), own, text, places))
    drawn = []
    while found and len(drawn) < count:
        for folder in rng.sample(sorted(found), min(len(found), count - len(drawn))):
            modules = found[folder]
            one = None
            while one is None:
                [(file, own, text, places)] = rng.choices(modules, [len(module[3]) for module in modules])
                one = _mutation(file, own, text, rng.choice(places), root)
            drawn.append(one)
    return drawn


def _places(text: str) -> Iterator[tuple]:
    """Yield what `_changes` yields of a module's functions."""
    lines = text.split("\n")
    for function in ast.walk(ast.parse(text)):
        if isinstance(function, ast.FunctionDef):
            for node in _nodes(function):
                yield from _changes(node, lines)


def _mutation(file: str, tests: tuple, text: str, place: tuple, root: Path) -> Mutation | None:
    """Return the Mutation at a place; None if it changes nothing, or its line cannot be told from others."""
    lines, (start, end, new) = text.split("\n"), place
    row, line = start[0] - 1, lines[start[0] - 1]
    old, changed = line[start[1] : end[1]], line[: start[1]] + new + line[end[1] :]
    first = _unique(text, lines, row)
    if first is None or changed == line:
        return None
    above = "".join(f"{one}\n" for one in lines[first:row])
    what = f"line {start[0]}: {line.strip()!r} with {new!r} for {old!r}"
    one = Mutation(Path(file).parts[0], file, f"{above}{line}\n", f"{above}{changed}\n", what, tests)
    return None if one.fault(root) else one


def _nodes(function: ast.FunctionDef) -> Iterator[ast.AST]:
    """Yield the nodes of a function's body, but for messages, annotations and texts."""
    waiting = list(function.body[ast.get_docstring(function) is not None :])
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.Raise | ast.JoinedStr | ast.Import | ast.ImportFrom | ast.FunctionDef | ast.arguments):
            continue
        yield node
        waiting += [child for child in ast.iter_child_nodes(node) if not isinstance(child, ast.expr_context)]


def _changes(node: ast.AST, lines: list[str]) -> Iterator[tuple]:
    """Yield (start, end, text) of what a rule puts in place of a part of one line; places are (line, column)."""
    if getattr(node, "lineno", None) is None or node.lineno != node.end_lineno or not lines[node.lineno - 1].isascii():
        return
    place = (node.lineno, node.col_offset), (node.end_lineno, node.end_col_offset)
    line = lines[node.lineno - 1]
    if isinstance(node, ast.BinOp | ast.Compare | ast.BoolOp):
        pairs = {
            ast.BinOp: lambda: [(node.left, node.op, node.right)],
            ast.Compare: lambda: zip([node.left, *node.comparators[:-1]], node.ops, node.comparators, strict=True),
            ast.BoolOp: lambda: [(node.values[0], node.op, node.values[1])],
        }[type(node)]()
        for left, op, right in pairs:
            if type(op) in _SWAPPED and left.end_lineno == right.lineno == node.lineno:
                between = line[left.end_col_offset : right.col_offset]
                word = between.strip(" ()")
                at = left.end_col_offset + between.index(word)
                yield (node.lineno, at), (node.lineno, at + len(word)), _SWAPPED[type(op)]
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.Not):
        yield place[0], (node.lineno, node.operand.col_offset), ""
    elif isinstance(node, ast.Constant) and type(node.value) in (int, float):
        yield *place, "1" if node.value == 0 else repr(node.value * 2)
    elif (
        isinstance(node, ast.Call) and len(node.args) > 1 and not any(isinstance(a, ast.Starred) for a in node.args[:2])
    ):
        one, two = (line[a.col_offset : a.end_col_offset] for a in node.args[:2])
        if node.args[0].end_lineno == node.args[1].end_lineno == node.lineno:
            yield (node.lineno, node.args[0].col_offset), (node.lineno, node.args[1].end_col_offset), f"{two}, {one}"
    elif isinstance(node, ast.Expr | ast.AugAssign):
        yield *place, "pass"


def _unique(text: str, lines: list[str], row: int) -> int | None:
    """Return the first row of the shortest run of lines, up to `row`, that the text has once; None if there is none."""
    for first in range(row, max(row - 6, -1), -1):
        if text.count("\n".join(lines[first : row + 1]) + "\n") == 1:
            return first
    return None
