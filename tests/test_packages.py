"""The docstring of each package says what it may import, as the contract in pyproject.toml has it."""

import importlib
import tomllib
from graphlib import TopologicalSorter
from pathlib import Path

import grimp
import pytest

ROOT = Path(__file__).parents[1]
CONTRACT = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"][0]
# from the top down; several in one line do not import each other
LAYERS = [[name.strip().split(".")[1] for name in line.split("|")] for line in CONTRACT["layers"]]
PACKAGES = sorted(path.parent.name for path in (ROOT / "src" / "csstsim").glob("*/__init__.py"))


def below(package: str) -> list[str]:
    """Return the packages below the highest line of this one, from the top down."""
    first = next(i for i, names in enumerate(LAYERS) if package in names)
    return list(dict.fromkeys(name for names in LAYERS[first + 1 :] for name in names if name != package))


@pytest.mark.parametrize("package", PACKAGES)
def test_docstring_says_what_a_package_may_import(package):
    text = " ".join(importlib.import_module(f"csstsim.{package}").__doc__.split())
    allowed = below(package)
    assert text.endswith(f"May import: {', '.join(allowed)}." if allowed else "May import no other part.")


def test_no_modules_import_each_other():
    """Also not through others, nor within functions; imports for annotations alone do not count."""
    graph = grimp.build_graph("csstsim", exclude_type_checking_imports=True, cache_dir=None)
    TopologicalSorter({name: graph.find_modules_directly_imported_by(name) for name in graph.modules}).prepare()
