"""Docstrings of the public interface state source, shapes, units and errors. ruff's D1 requires that they exist.

They are read from the source, without importing it. A function must state
    units    if it calculates
    shapes   if it makes an array or uses the shape of one
    errors   if it raises one that a caller may meet, itself or in a private helper of its module
and a module its source: the paper's section, an equation, a reference or a data file. Methods count as functions, and
__init__ as its class. The test cannot tell whether a statement is true; that is for review.
"""

import ast
import importlib.util
import re
from pathlib import Path

import pytest

from csstsim.simulation.layer_contract import SOURCE, UNIT

SRC = Path(importlib.util.find_spec("csstsim").origin).parent
# What an extension, a notebook or a reader of the files meets; a folder stands for its modules.
SURFACE = (
    "api", "base/errors", "base/rng", "catalog/base", "catalog/contract", "catalog/flags", "catalog/mock_object",
    "catalog/own_table", "catalog/table", "detector", "detector/charge_transfer", "instrument", "io/calibrated",
    "io/level0", "io/level0_writing", "io/orders", "io/truth", "layers", "optics/geometry/wcs", "optics/psf/psf_set",
    "simulation/frame", "simulation/layer_contract", "simulation/sim_steps", "simulation/state",
)  # fmt: skip
# Taken from nowhere: they are csstsim's own ways
NO_SOURCE = {"catalog/contract", "catalog/flags", "detector/mask", "base/errors", "simulation/layer_contract"}
MODULE = re.compile(r"\b(?:csstsim\.)?((?:catalog|detector|instrument|io|layers|optics|render|sky)(?:\.\w+)+)")
SHAPE = re.compile(
    r"\bshapes?\b|\blength\b|\bcorners\b|\(\w+,\)|\(\w[\w \-+*/]*,[^()]*\)|len\(|\b(a|an|one|each|every|of the|as many)"
    r" \w*\s*(window|frame|image|number|rows?|columns?|pixels?|map|objects?|chip|channels?|species|half)\b",
    re.I,
)  # fmt: skip
ERRORS = {"InputError", "ValueError", "TypeError", "KeyError"}
RAISES = re.compile(r"\braises?\b|Error\b", re.I)
MAKES = {
    "arange", "array", "asarray", "broadcast_to", "concatenate", "cumsum", "diff", "empty", "empty_like", "flatnonzero",
    "full", "full_like", "indices", "linspace", "meshgrid", "ones", "outer", "repeat", "stack", "tile", "where",
    "zeros", "zeros_like",
}  # fmt: skip
ARITHMETIC = ast.Mult, ast.Div, ast.Sub, ast.Pow


def surface():
    """Return {name: file} of the public modules that are there."""
    files = {}
    for name in SURFACE:
        folder = sorted((SRC / name).glob("*.py")) if (SRC / name).is_dir() else [SRC / f"{name}.py"]
        files |= {file.relative_to(SRC).with_suffix("").as_posix(): file for file in folder}
    return {name: file for name, file in files.items() if file.exists()}


def faults(source, name="module"):
    """Return what the docstrings of a module's source text lack, one line each."""
    tree = ast.parse(source)
    found = []
    if name not in NO_SOURCE and not name.endswith("__init__") and not _sourced(ast.get_docstring(tree) or ""):
        found.append(f"{name}: names no source")
    helpers = {node.name: node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)}
    for title, node, text in _public(tree):
        found += [f"{name}.{title}: {lack}" for lack in _lacks(node, text, helpers)]
    return found


def _sourced(text):
    """Whether a module's docstring names a source, or a module of csstsim that does."""
    others = [SRC / f"{name.replace('.', '/')}.py" for name in MODULE.findall(text)]
    texts = [ast.get_docstring(ast.parse(file.read_text())) or "" for file in others if file.exists()]
    return any(SOURCE.search(found) for found in (text, *texts))


def _public(tree):
    """Yield (title, function, docstring) of public functions and methods; __init__ has its class's docstring."""
    for node in tree.body:
        if isinstance(node, ast.FunctionDef) and not node.name.startswith("_"):
            yield node.name, node, ast.get_docstring(node) or ""
        elif isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            about = ast.get_docstring(node) or ""
            for part in node.body:
                if isinstance(part, ast.FunctionDef) and part.name in ("__init__", "__post_init__"):
                    yield node.name, part, about
                elif isinstance(part, ast.FunctionDef) and not part.name.startswith("_"):
                    own = ast.get_docstring(part) or ""
                    yield f"{node.name}.{part.name}", part, about + own if _is_property(part) else own


def _is_property(node):
    return any("property" in ast.unparse(decorator) for decorator in node.decorator_list)


def _lacks(node, text, helpers):
    """Yield what a function's docstring does not say."""
    body = [inner for part in node.body for inner in ast.walk(part)]
    calculates = any(isinstance(n, ast.BinOp) and isinstance(n.op, ARITHMETIC) and not _is_text(n) for n in body)
    calls = {n.func.attr for n in body if isinstance(n, ast.Call) and isinstance(n.func, ast.Attribute)}
    if calculates and not UNIT.search(text):
        yield "says no unit"
    arrays = calls & MAKES or any(isinstance(n, ast.Attribute) and n.attr == "shape" for n in body)
    if arrays and not SHAPE.search(text):
        yield "says no shape"
    names = {n.attr if isinstance(n, ast.Attribute) else n.id for n in body if isinstance(n, (ast.Attribute, ast.Name))}
    near = [helpers[called] for called in names if called.startswith("_") and called in helpers]
    if any(_raises(function) for function in [node, *near]) and not RAISES.search(text):
        yield "does not say what it raises"


def _is_text(node):
    """Whether an operation is one of texts or of paths, not of numbers."""
    texts = any(isinstance(n, ast.JoinedStr) or isinstance(getattr(n, "value", None), str) for n in ast.walk(node))
    return texts or (isinstance(node.op, ast.Div) and re.search(r"\b(folder|path|parent)\b", ast.unparse(node.left)))


def _raises(function):
    """Whether a function raises an error that its caller may meet."""
    raised = [n.exc for n in ast.walk(function) if isinstance(n, ast.Raise) and isinstance(n.exc, ast.Call)]
    return any(isinstance(exc.func, ast.Name) and exc.func.id in ERRORS for exc in raised)


@pytest.mark.parametrize("name", surface())
def test_docstrings_say_what_they_must(name):
    assert not faults(surface()[name].read_text(), name)


def test_nothing_is_missing_from_the_surface():
    missing = {name for name in SURFACE if not ((SRC / name).is_dir() or (SRC / f"{name}.py").exists())}
    assert not missing
    assert len(surface()) > 45


SOUND = '''"""Flats (paper, section 5)."""
import numpy as np

class Flat:
    """A flat [e-] of shape (ny, nx). Raises ValueError if empty."""

    def __init__(self, image):
        self.image = _checked(image)

    @property
    def half(self):
        """Half of it."""
        return self.image[: self.image.shape[0] // 2] / 2

    def scaled(self, factor):
        """Return a (ny, nx) image of so many [e-]."""
        return np.zeros(3) + factor * self.image

def level(image):
    """Return the level [DN] of an image. Raises ValueError if it is empty."""
    return 2 * _checked(image).mean()

def _checked(image):
    if not image.size:
        raise ValueError("empty")
    return image
'''
SPOILT = {
    "names no source": ("(paper, section 5)", "of ours"),
    "spoilt.Flat: does not say what it raises": (" Raises ValueError if empty.", ""),
    "spoilt.Flat.half: says no shape": ("of shape (ny, nx)", "as is"),
    "spoilt.Flat.half: says no unit": ("[e-] of", "of"),
    "spoilt.Flat.scaled: says no shape": ("a (ny, nx) image of so many", "it as"),
    "spoilt.Flat.scaled: says no unit": ("so many [e-]", "that much"),
    "spoilt.level: says no unit": ("[DN] ", ""),
    "spoilt.level: does not say what it raises": (" Raises ValueError if it is empty.", ""),
}  # fmt: skip


def test_a_sound_module_has_no_faults():
    assert not faults(SOUND, "spoilt")


@pytest.mark.parametrize("fault", SPOILT)
def test_each_fault_is_found(fault):
    old, new = SPOILT[fault]
    assert SOUND.count(old) == 1
    assert [line for line in faults(SOUND.replace(old, new), "spoilt") if fault in line]


def test_a_source_may_be_that_of_another_module():
    assert not faults('"""Rows, as detector.charge_transfer.cti has columns."""', "rows")
    assert faults('"""Rows, as detector.mask has columns."""', "rows") == faults('"""As detector.nothing."""', "rows")
