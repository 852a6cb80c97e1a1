"""Which compiled functions contain others, so that a change makes them stale in numba's cache.

numba compares a cached function with its own file alone; functions that it calls, or constants that it reads, in other
modules may change unnoticed. The graph is of names: which mentions which, through imports and module attributes.
"""

import ast
from collections import defaultdict
from pathlib import Path


class CodeGraph:
    """The top-level names of the modules of a package (folder `package`), and who mentions them."""

    def __init__(self, package):
        self._trees = {}
        for path in sorted(Path(package).rglob("*.py")):
            parts = path.relative_to(Path(package).parent).with_suffix("").parts
            name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
            self._trees[name] = ast.parse(path.read_text(encoding="utf-8"))
        self._users = defaultdict(set)
        for module, tree in self._trees.items():
            known = self._known(module, tree)
            for statement in tree.body:
                mentioned = set(self._mentioned(statement, known))
                for name in _defined(statement):
                    for target in mentioned:
                        self._users[target].add((module, name))

    def _known(self, module, tree):
        """Return what each name of a module stands for: (module, name), or (module, None) for a module."""
        known = {name: (module, name) for statement in tree.body for name in _defined(statement)}
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("csstsim"):
                for alias in node.names:
                    inner = f"{node.module}.{alias.name}"
                    target = (inner, None) if inner in self._trees else (node.module, alias.name)
                    known[alias.asname or alias.name] = target
        return known

    @staticmethod
    def _mentioned(statement, known):
        for node in _without_annotations(statement):
            if isinstance(node, ast.Name) and node.id in known:
                yield known[node.id]
            elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
                target = known.get(node.value.id)
                if target and target[1] is None:
                    yield target[0], node.attr

    def names_at(self, module, first, last):
        """Return the top-level names of a module whose text touches lines first to last (1 is the first)."""
        return {
            (module, name)
            for statement in self._trees[module].body
            if first <= statement.end_lineno and last >= _begin(statement)
            for name in _defined(statement)
        }

    def all_names(self, module):
        """Return all top-level names of a module."""
        return self.names_at(module, 1, 1 << 30) if module in self._trees else set()

    def users(self, names):
        """Return `names` and all that mention them, directly or through others."""
        seen, queue = set(names), list(names)
        while queue:
            for user in self._users[queue.pop()] - seen:
                seen.add(user)
                queue.append(user)
        return seen


def _begin(statement):
    return min([statement.lineno, *(d.lineno for d in getattr(statement, "decorator_list", []))])


def _defined(statement):
    if isinstance(statement, ast.FunctionDef | ast.ClassDef):
        return [statement.name]
    return [node.id for node in ast.walk(statement) if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)]


def forget(cache, names):
    """Delete the files of these names, (module, name) pairs, from a folder that was numba's cache."""
    stale = tuple({f"{module.split('.')[-1]}.{name}-" for module, name in names})
    for path in Path(cache).rglob("*.nb[ic]"):
        if path.name.startswith(stale):
            path.unlink()


def _without_annotations(statement):
    """Yield the nodes of a statement but for annotations of functions, which do nothing when it runs."""
    waiting = [statement]
    while waiting:
        node = waiting.pop()
        yield node
        for name, value in ast.iter_fields(node):
            if name != "returns" and not (name == "annotation" and isinstance(node, ast.arg)):
                waiting += [one for one in (value if isinstance(value, list) else [value]) if isinstance(one, ast.AST)]
