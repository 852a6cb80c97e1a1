"""What a command depends on: the modules that it reaches by import, the data that these name, and digests of them.

Comments, docstrings, blank lines and the number of the version do not count. Modules are followed from the script
through those beside it (also of builders and tests) into csstsim, whose imports grimp knows. Two things are named, not
imported: layers, by SimSteps; and commands, by a script that starts processes: those of csstsim whose names stand in it
as words, and with Snakemake or pytest the whole package. Data files are those below config/, and beside the scripts,
whose path or top folder stands in a reached module as a string.
"""

import ast
import hashlib
import re
import shutil
from collections.abc import Iterable
from functools import cache
from pathlib import Path

from evidence import ROOT, SCRIPTS
from evidence.commands import Command

import grimp

PACKAGE = "csstsim"
BY_NAME = {"csstsim.simulation.sim_steps": "csstsim.layers"}  # a module that imports others by their names
COMMANDS = "csstsim.command_line"
PROCESSES = {"subprocess", "click.testing", COMMANDS, "snakemake"}  # importing it, a script may start commands
WHOLE = {"snakemake", "pytest"}  # a script with this word may reach the whole package
SELF = "evidence"  # how a record is written changes no figure
WORKFLOW = ("Snakefile", "workflow")
NO_CODE = ("#", "__version__ = ")
NO_DATA = (".md", ".pyc")
_HEX = 12


@cache
def _graph() -> grimp.ImportGraph:
    return grimp.build_graph(PACKAGE, cache_dir=None, exclude_type_checking_imports=True)


@cache
def _tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text())


@cache
def _nodes(path: Path) -> list[ast.AST]:
    return list(ast.walk(_tree(path)))


@cache
def code(path: Path) -> str:
    """Return a module's code without comments, docstrings, blank lines and the number of the version."""
    lines = path.read_text().split("\n")
    for node in _nodes(path):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            first = node.body[0] if node.body else None
            if ast.get_docstring(node, clean=False) is not None and first is not None:
                lines[first.lineno - 1 : first.end_lineno] = [""] * len(lines[first.lineno - 1 : first.end_lineno])
    return "\n".join(line.rstrip() for line in lines if line.strip() and not line.lstrip().startswith(NO_CODE))


@cache
def _imported(path: Path) -> frozenset[str]:
    """Return the dotted names that a module imports, at its top or within a function."""
    return frozenset(_imports(_nodes(path)))


def _imports(nodes: Iterable[ast.AST]) -> set[str]:
    """Return the dotted names that nodes of a module import."""
    names = set()
    for node in nodes:
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def _local(name: str) -> Path | None:
    """Return the file of a module that lies with the scripts."""
    for folder in SCRIPTS:
        for path in (folder / f"{name.replace('.', '/')}.py", folder / name.replace(".", "/") / "__init__.py"):
            if path.is_file():
                return path
    return None


def scripts(script: Path) -> list[Path]:
    """Return a script and the modules beside it, in builders and in tests that it reaches."""
    found, waiting = [], [script]
    while waiting:
        path = waiting.pop()
        if path not in found:
            found.append(path)
            names = (name for name in sorted(_imported(path)) if name.split(".")[0] != SELF)
            waiting += [file for name in names if (file := _local(name))]
    return sorted(found)


def _upstream(names: Iterable[str]) -> set[str]:
    """Return the modules of csstsim that are reached from some of its modules or packages, and these themselves."""
    graph, found, waiting = _graph(), set(), list(names)
    while waiting:
        name = waiting.pop()
        if name in graph.modules and name not in found:
            new = {name, *graph.find_upstream_modules(name)} - found
            found |= new
            for at in new & BY_NAME.keys():
                waiting += [BY_NAME[at], *graph.find_descendants(BY_NAME[at])]
    return found


def _is_command(node: ast.AST) -> bool:
    """Tell whether a function is a command: a decorator of it ends in `command` or `command()`."""
    marks = [mark.func if isinstance(mark, ast.Call) else mark for mark in getattr(node, "decorator_list", ())]
    return any(isinstance(mark, ast.Attribute) and mark.attr == "command" for mark in marks)


def _for_a_type_checker(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"


def _started(local: Iterable[Path], own: Iterable[str]) -> set[str]:
    """Return the modules that scripts reach that start processes and import `own` of csstsim.

    That is the command line without the commands whose names are no words of the scripts, or all.
    """
    words = {word for text in _constants(local) for word in re.findall(r"[a-zA-Z]+", text)}
    if words & WHOLE:
        return set(_graph().modules)
    modules = {COMMANDS, *_graph().find_descendants(COMMANDS)}
    reached = {name for name in own if name not in modules}
    for module in modules:
        commands = [node for node in _tree(_file(module)).body if _is_command(node)]
        left_out = [node for node in commands if not words.issuperset(node.name.split("_"))]
        nodes = [node for node in _tree(_file(module)).body if node not in left_out and not _for_a_type_checker(node)]
        reached |= {name for node in nodes for name in _imports(ast.walk(node))}
    return modules | _upstream(reached - modules)


def _file(module: str) -> Path:
    base = ROOT / "src" / module.replace(".", "/")
    return base / "__init__.py" if base.is_dir() else base.with_suffix(".py")


def _constants(paths: Iterable[Path]) -> set[str]:
    return set().union(*(_strings(path) for path in paths))


@cache
def _strings(path: Path) -> frozenset[str]:
    constants = (node.value for node in _nodes(path) if isinstance(node, ast.Constant))
    return frozenset(value for value in constants if isinstance(value, str))


@cache
def _data() -> dict[str, tuple[Path, ...]]:
    """Return the data of the repository by the names under which code speaks of them."""
    found = {}
    config = ROOT / "config"
    for path in sorted([*config.iterdir(), *(ROOT / "examples").iterdir(), *(ROOT / "survey_tables").iterdir()]):
        files = tuple(sorted(p for p in path.rglob("*") if p.is_file())) if path.is_dir() else (path,)
        files = tuple(p for p in files if p.suffix not in NO_DATA and "data" not in p.relative_to(ROOT).parts)
        for name in {str(path.relative_to(ROOT)), *([path.name] if path.parent == config else [])}:
            found[name] = files
    for path in sorted(p for folder in SCRIPTS[:2] for p in folder.iterdir() if p.suffix in (".yaml", ".csv")):
        if path.name != "commands.yaml":
            found[path.name] = (path,)
    return found


def _named(constants: set[str]) -> list[Path]:
    """Return the data files that strings of the code name."""
    data = _data()
    words = set()
    for text in (text for text in constants if len(text) < 200):
        parts = text.split("/")
        words |= {"/".join(parts[a:b]) for a, b in ((0, 1), (1, 2), (0, 2), (0, None))}
    return sorted({file for word in words & data.keys() for file in data[word]})


@cache
def _file_digest(path: Path, as_code: bool) -> bytes:
    """Return the digest of a file: of a module, that of its code."""
    return hashlib.sha256(code(path).encode() if as_code else path.read_bytes()).digest()


def _digest(parts: Iterable[bytes]) -> str:
    """Return the digest of digests, as text."""
    return hashlib.sha256(b"".join(parts)).hexdigest()[:_HEX]


@cache
def depends(command: Command) -> dict[str, str]:
    """Return the digest of each part that a command depends on: scripts, packages of csstsim, files of data."""
    local = scripts(ROOT / command.script)
    names = {name for path in local for name in _imported(path)} | set(command.reaches)
    starts = any(name.startswith(tuple(PROCESSES)) for name in names)
    own = [name for name in names if name.startswith(PACKAGE)]
    modules = _started(local, own) if starts else _upstream(own)
    files = {module: _file(module) for module in sorted(modules)}
    parts: dict[str, list[bytes]] = {}
    for path in local:
        parts.setdefault(str(path.relative_to(ROOT)), []).append(_file_digest(path, True))
    for module, path in files.items():
        parts.setdefault(".".join(module.split(".")[:2]), []).append(_file_digest(path, True))
    data = _named(_constants([*local, *files.values()]))
    extra = [ROOT / name for name in command.reaches if (ROOT / name).exists()]
    extra += [ROOT / name for name in WORKFLOW] if modules == _graph().modules else []
    data += [file for path in extra for file in (path.rglob("*") if path.is_dir() else [path])]
    for path in sorted(set(data)):
        if path.is_file() and path.suffix not in NO_DATA:
            parts.setdefault("/".join(path.relative_to(ROOT).parts[:2]), []).append(_file_digest(path, False))
    return {name: _digest(contents) for name, contents in sorted(parts.items())}


def combined(command: Command) -> str:
    """Return the one digest of all that a command depends on."""
    return _digest(hashlib.sha256(f"{name} {digest}".encode()).digest() for name, digest in depends(command).items())


def remove_old(command: Command) -> None:
    """Remove the folders that a command fills and uses again, if other code or data filled them."""
    now = combined(command)
    for name in command.makes:
        folder, stamp = ROOT / "results" / name, ROOT / "results" / "made_by" / name
        if not stamp.exists() or stamp.read_text() != now:
            shutil.rmtree(folder, ignore_errors=True)
        stamp.parent.mkdir(parents=True, exist_ok=True)
        stamp.write_text(now)


def changed(command: Command, recorded: dict[str, str]) -> list[str]:
    """Return the parts that differ from those that a record was made with."""
    now = depends(command)
    return sorted(name for name in now.keys() | recorded.keys() if now.get(name) != recorded.get(name))
